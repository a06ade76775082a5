"""The OPC UA device: the plant's address space, served to clients in journalling sessions."""

from __future__ import annotations

import socket
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from asyncua import ua

from ..device import Device
from ..endpoint import OpenEndpoint
from .annex import Annex
from .faults import FaultPlan
from .limits import Limits
from .plant import NAMESPACE, Plant
from .values import to_json

if TYPE_CHECKING:
    from .server import PlantServer
    from .session import PlantSession

__all__ = ["OpcUaDevice"]


class OpcUaDevice(Device):
    """Serves ``urn:otmcp:plant`` without security, to anybody.

    Attributes:
        limits: what the server can take at once.
        sessions: the open sessions of clients.
    """

    protocol = "opcua"

    def __init__(self, server: PlantServer, plant: Plant) -> None:
        super().__init__()
        self.plant = plant
        self.faults = FaultPlan([])
        self.limits = Limits()
        self.sessions: set[PlantSession] = set()
        self._server = server
        self._annex = Annex(server, plant)

    async def serve(self, endpoints: Mapping[str, OpenEndpoint]) -> None:
        listener = endpoints["opcua"]
        assert isinstance(listener, socket.socket)
        await self._advertise()
        await self._server.listen(listener, self)

    async def aclose(self) -> None:
        """The process ends right after this; there is nothing to hand back."""

    def image(self) -> dict[str, Any]:
        """Return the plant's ``variables`` by node id, its ``folders`` by browse name, how often its ``methods`` were
        performed, what ``clients`` have open; and ``points``: node id to value."""
        plant = self.plant
        variables = {}
        for node, variable in plant.variables.items():
            held = plant.data_value(node)
            variables[node.to_string()] = {
                "browse_name": variable.browse_name,
                "parent": variable.parent.to_string(),
                "data_type": variable.kind.name,
                "writable": variable.writable,
                "value": to_json(held.Value.Value if held.Value is not None else None),
                "status": held.StatusCode.name,
            }
        return {
            "namespace": {"index": plant.namespace, "uri": NAMESPACE},
            "variables": variables,
            "points": {node: variable["value"] for node, variable in variables.items()},
            "folders": {name: node.to_string() for name, node in plant.folders.items()},
            "methods": {node.to_string(): {"calls": calls} for node, calls in plant.calls.items()},
            "clients": {
                "sessions": len(self.sessions),
                "continuation_points": sum(session.browser.open_points for session in self.sessions),
            },
        }

    async def poke(self, params: Mapping[str, Any]) -> None:
        """Set a value: ``{"node": browse name or node id, "value", "status" (symbol, default Good)}``; or add nodes,
        see :class:`Annex`: ``{"create": […]}``; or change what the server can take: ``{"limits": {…}}``."""
        if "limits" in params:
            self.limits = self.limits.changed(params["limits"])
            await self._advertise()
        elif "create" in params:
            await self._annex.create(params["create"])
        else:
            status = getattr(ua.StatusCodes, str(params.get("status", "Good")), None)
            if not isinstance(status, int):
                raise ValueError(f"unknown status code {params['status']!r}")
            await self.plant.put(str(params["node"]), params["value"], status)

    def fault(self, rules: list[dict[str, Any]]) -> list[int]:
        plan = FaultPlan(rules)
        hits, self.faults = self.faults.hits, plan
        return hits

    async def reset(self) -> None:
        self.faults = FaultPlan([])
        self.limits = Limits()
        await self._advertise()
        await self._annex.clear()
        await self.plant.restore()

    async def _advertise(self) -> None:
        for number, value in self.limits.advertised().items():
            await self._server.iserver.write_attribute_value(ua.NodeId(number), ua.DataValue(value))

    async def tick(self) -> None:
        await self.plant.tick()
