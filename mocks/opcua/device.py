"""The OPC UA device: the plant's address space, served to clients in journalling sessions."""

from __future__ import annotations

import socket
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from asyncua import ua

from ..accounts import Accounts
from ..device import Device
from ..endpoint import OpenEndpoint
from ..network import Network
from .certificates import USUAL, policies, presented
from .extra_nodes import ExtraNodes
from .faults import FaultPlan
from .limits import Limits
from .namespaces import Namespaces
from .plant import NAMESPACE, Plant
from .sample_nodes import sample
from .server import PlantServer
from .state import DeviceState
from .values import to_json

__all__ = ["OpcUaDevice"]

_TIMESTAMPS = ("source_timestamp", "server_timestamp")
_LARGEST_CODE = 2**32 - 1


class OpcUaDevice(Device):
    """The server ``urn:otmcp:mock``, for every client; without security unless it is given certificates."""

    protocol = "opcua"

    def __init__(self, server: PlantServer, plant: Plant) -> None:
        super().__init__()
        self._state = DeviceState(
            journal=self.journal, plant=plant, network=Network(self.journal), accounts=Accounts(self.journal)
        )
        self._server = server
        self._extra_nodes = ExtraNodes(server, plant)
        self._namespaces = Namespaces(server, self._state)
        self._certificates: Path | None = None

    def secure(self, folder: Path) -> None:
        self._certificates = folder
        self._state.accounts = Accounts(self.journal, folder)
        self._state.certificate = USUAL
        self._server.secure(presented(folder, USUAL), policies(USUAL))

    async def _present(self, name: object) -> None:
        if self._certificates is None or not isinstance(name, str):
            raise ValueError("a poke of TLS is {'tls': NAME}, of a device that was started with certificates")
        self._server.secure(presented(self._certificates, name), policies(name))
        await self._server.offer()
        self._state.certificate = name
        self.journal.event(connection=0, direction="out", kind="tls", origin="kit", certificate=name)
        self._state.network.close()

    @property
    def dead_connections(self) -> int:
        return self._state.network.dead

    async def serve(self, endpoints: Mapping[str, OpenEndpoint]) -> None:
        listener = endpoints["opcua"]
        assert isinstance(listener, socket.socket)
        await self._advertise()
        await self._server.listen(listener, self._state)

    async def aclose(self) -> None:
        """Do nothing: the process ends right after this."""

    def image(self) -> dict[str, Any]:
        """Return the plant's ``variables`` by node id, its ``folders`` by browse name, how often its ``methods`` were
        performed, the numbers of objects that ``clients`` have open; and ``points``: node id to value."""
        plant = self._state.plant
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
                "sessions": self._state.kept_by_clients,
                "withheld_notifications": self._state.withheld,
                "continuation_points": sum(session.browser.open_points for session in self._state.sessions),
            },
        }

    async def poke(self, params: Mapping[str, Any]) -> None:
        """Change the plant past the protocol, by one of:

        ==================================================  ===========================================================
        ``{"node", "value", "status": "Good"}``             the value of a variable, by browse name or node id, as
                                                            ``values.variant`` reads it; ``status`` is a symbol or a number,
                                                            ``source_timestamp`` and ``server_timestamp`` are times in ISO
                                                            8601, null for none, otherwise the present time
        ``{"create": […]}``                                 more nodes: :class:`ExtraNodes`
        ``{"nodes": "types"}``                              a set of nodes, or a list of sets: :mod:`.sample_nodes`
        ``{"limits": {…}}``                                 the limits of the server: :class:`Limits`
        ``{"subscriptions": "silent"}``                     what subscriptions send: :mod:`.state`
        ``{"sessions": "closed"}``                          every session is closed, the connections stay
        ``{"namespaces": ["urn:a"]}``                       namespaces before the plant's: :class:`Namespaces`
        ``{"network": "black_hole"}``                       see :mod:`..network`
        ``{"tls": "expired"}``                              another certificate: :mod:`.certificates`
        ``{"account": "required"}``                         who gets in: :mod:`..accounts`
        ==================================================  ===========================================================
        """
        if "tls" in params:
            await self._present(params["tls"])
            return
        if self._state.network.poke(params):
            return
        if "account" in params:
            self._state.accounts.become(params["account"])
            self._state.network.close()
        elif "limits" in params:
            self._state.limits = self._state.limits.changed(params["limits"])
            await self._advertise()
        elif "create" in params:
            await self._extra_nodes.create(params["create"])
        elif "nodes" in params:
            await self._extra_nodes.create(sample(params["nodes"]))
        elif "subscriptions" in params:
            self._state.subscribe(params["subscriptions"])
        elif "sessions" in params:
            await self._close_sessions(params["sessions"])
        elif "namespaces" in params:
            await self._extra_nodes.clear()
            await self._namespaces.put_before(params["namespaces"])
        else:
            await self._state.plant.put(
                str(params["node"]),
                params["value"],
                _status_code(params.get("status", "Good")),
                **{name: _moment(name, params[name]) for name in _TIMESTAMPS if name in params},
            )

    async def _close_sessions(self, condition: Any) -> None:
        if condition != "closed":
            raise ValueError(f"sessions: expected closed, found {condition!r}")
        for session in list(self._state.sessions):
            await session.close_session()

    def fault(self, rules: list[dict[str, Any]]) -> list[int]:
        plan = FaultPlan(rules)
        hits, self._state.faults = self._state.faults.hits, plan
        return hits

    async def reset(self) -> None:
        self._state.faults = FaultPlan([])
        self._state.limits = Limits()
        self._state.subscribe("normal")
        self._state.network.restored()
        self._state.accounts.restored()
        if self._certificates is not None and self._state.certificate != USUAL:
            await self._present(USUAL)
        await self._state.close_abandoned_sessions()
        await self._advertise()
        await self._extra_nodes.clear()
        await self._namespaces.put_before([])
        await self._state.plant.restore()

    async def _advertise(self) -> None:
        for number, value in self._state.limits.advertised().items():
            await self._server.iserver.write_attribute_value(ua.NodeId(number), ua.DataValue(value))

    async def tick(self) -> None:
        await self._state.plant.tick()


def _status_code(given: Any) -> int:
    """Return a status code by its symbol, or any number of 32 bits as it is."""
    code = given if type(given) is int else getattr(ua.StatusCodes, str(given), None)
    if not isinstance(code, int) or not 0 <= code <= _LARGEST_CODE:
        raise ValueError(f"unknown status code {given!r}")
    return code


def _moment(name: str, text: Any) -> datetime | None:
    try:
        return None if text is None else datetime.fromisoformat(text).astimezone(UTC)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: expected a time in ISO 8601 or null, found {text!r}") from None
