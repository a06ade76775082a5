"""The order of the server's namespaces, which may be another one after a restart (OPC 10000-3, 8.2.2): clients must look an URI
up, and not remember its index.

``put_before`` takes the URIs that stand before the plant's. The nodes of the plant then have another namespace index in every node
id and browse name. As after a restart, all connections are reset and extra nodes are gone.
"""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

from asyncua import Server, ua

from .plant import NAMESPACE
from .state import DeviceState

__all__ = ["Namespaces"]

_FIRST = 2
"""Index of the first namespace that is not the specification's or the server's own."""


class Namespaces:
    """The namespaces of one server."""

    def __init__(self, server: Server, device: DeviceState) -> None:
        self._server = server
        self._device = device

    async def put_before(self, uris: Any) -> None:
        """Put these namespaces, and no others, before the plant's.

        Raises:
            ValueError: this is no list of URIs.
        """
        if not isinstance(uris, list) or not all(isinstance(uri, str) and uri and uri != NAMESPACE for uri in uris):
            raise ValueError(f"namespaces: expected a list of other URIs than {NAMESPACE}, found {uris!r}")
        old, new = self._device.plant.namespace, _FIRST + len(uris)
        if old == new == _FIRST:
            return
        await self._end_sessions()
        array = self._server.nodes.namespace_array
        kept = (await array.read_value())[:_FIRST]
        await array.write_value([*kept, *uris, NAMESPACE])
        if old != new:
            self._renumber(old, new)

    async def _end_sessions(self) -> None:
        """Reset all connections; return when the server has forgotten their sessions and monitored items."""
        closing = self._server.bserver.closing_tasks
        links = list(self._device.network.links)
        for link in links:
            link.reset()
        for link in links:
            await link.gone.wait()
        await asyncio.gather(*closing, return_exceptions=True)

    def _renumber(self, old: int, new: int) -> None:
        """Give every node of the plant, and every reference to one, the new index."""

        def moved(value: Any) -> Any:
            if isinstance(value, ua.NodeId | ua.QualifiedName) and value.NamespaceIndex == old:
                return replace(value, NamespaceIndex=new)
            return value

        space, plant = self._server.iserver.aspace, self._device.plant
        for node in list(space.keys()):
            data = space[node]
            for reference in data.references:
                if reference.NodeId.NamespaceIndex == old:
                    reference.NodeId, reference.BrowseName = moved(reference.NodeId), moved(reference.BrowseName)
            if node.NamespaceIndex != old:
                continue
            for attribute in (ua.AttributeIds.NodeId, ua.AttributeIds.BrowseName):
                held = data.attributes[attribute]
                assert held.value is not None
                assert held.value.Value is not None
                variant = ua.Variant(moved(held.value.Value.Value), held.value.Value.VariantType)
                held.value = replace(held.value, Value=variant)
            del space[node]
            data.nodeid = moved(node)
            space[data.nodeid] = data
        plant.namespace = new
        plant.folders = {name: moved(node) for name, node in plant.folders.items()}
        plant.variables = {
            moved(node): replace(variable, parent=moved(variable.parent)) for node, variable in plant.variables.items()
        }
        plant.methods = {
            moved(node): replace(method, owner=moved(method.owner)) for node, method in plant.methods.items()
        }
        plant.calls = {moved(node): calls for node, calls in plant.calls.items()}
