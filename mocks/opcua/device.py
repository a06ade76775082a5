"""The OPC UA device: the plant's address space, served to clients in journalling sessions."""

from __future__ import annotations

import socket
from collections.abc import Mapping
from typing import Any

from asyncua import ua

from ..device import Device
from .faults import FaultPlan
from .plant import NAMESPACE, Plant
from .server import PlantServer
from .session import PlantSession

__all__ = ["OpcUaDevice"]


class OpcUaDevice(Device):
    """Serves ``urn:otmcp:plant`` without security, to anybody."""

    protocol = "opcua"

    def __init__(self, server: PlantServer, plant: Plant) -> None:
        super().__init__()
        self.plant = plant
        self.faults = FaultPlan([])
        self._server = server

    async def serve(self, listener: socket.socket) -> None:
        class Session(PlantSession):
            device = self

        await self._server.listen(listener, Session, self._connection)

    def _connection(self, made: bool) -> None:
        self.journal.append(connection=0, direction="in", kind="CONNECTED" if made else "DISCONNECTED")

    async def aclose(self) -> None:
        """The process ends right after this; there is nothing to hand back."""

    def image(self) -> dict[str, Any]:
        plant = self.plant
        variables = {}
        for node, about in plant.variables.items():
            held = plant.data_value(node)
            value = held.Value.Value if held.Value is not None else None
            variables[node.to_string()] = {**about, "value": value, "status": held.StatusCode.name}
        return {
            "namespace": {"index": plant.namespace, "uri": NAMESPACE},
            "variables": variables,
            "folders": {name: node.to_string() for name, node in plant.folders.items()},
            "methods": {node.to_string(): {"calls": calls} for node, calls in plant.calls.items()},
        }

    async def poke(self, params: Mapping[str, Any]) -> None:
        """``{"node": browse name or node id, "value", "status" (symbol, default Good)}``."""
        status = str(params.get("status", "Good"))
        if not hasattr(ua.StatusCodes, status):
            raise ValueError(f"unknown status code {status!r}")
        await self.plant.put(str(params["node"]), params["value"], getattr(ua.StatusCodes, status))

    def fault(self, rules: list[dict[str, Any]]) -> list[int]:
        plan = FaultPlan(rules)
        hits, self.faults = self.faults.hits, plan
        return hits

    async def reset(self) -> None:
        self.faults = FaultPlan([])
        await self.plant.restore()

    async def tick(self) -> None:
        await self.plant.tick()
