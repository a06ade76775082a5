"""A real OPC UA server at ``opc.tcp://host[:port][/NODEID]``, and the second client that reads it, without user and without security.

From the node NODEID on, by default the folder Objects, variables are looked for; up to 16 of those that hold a number or a truth value
are read. Below the folder Objects what the specification itself defines, such as the state of the server, is left out.
"""

from __future__ import annotations

import asyncio
import math
import struct
import sys
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import asynccontextmanager
from typing import Any
from urllib.parse import unquote, urlsplit

from asyncua import Client, ua

from ..protocols.exercise import LARGEST_FLOAT32
from ..protocols.external import in_url
from ..protocols.field import Consent
from ..protocols.opcua.external import EXTERNAL
from .endpoint import Endpoint
from .field_device import FieldDevice, UnreachableError
from .mirror import OwnConnections

__all__ = ["OpcUaClient", "OpcUaFieldDevice"]

_ANSWER_TIMEOUT_S = 5.0
_BROWSED, _LOOKED_AT, _READ, _AT_ONCE = 64, 128, 16, 32
_BOUNDS: Mapping[Any, tuple[float, float]] = {
    ua.VariantType.Boolean: (0, 1),
    ua.VariantType.Float: (-LARGEST_FLOAT32, LARGEST_FLOAT32),
    ua.VariantType.Double: (-sys.float_info.max, sys.float_info.max),
    ua.VariantType.SByte: (-0x80, 0x7F),
    ua.VariantType.Int16: (-0x8000, 0x7FFF),
    ua.VariantType.Int32: (-0x8000_0000, 0x7FFF_FFFF),
    ua.VariantType.Byte: (0, 0xFF),
    ua.VariantType.UInt16: (0, 0xFFFF),
    ua.VariantType.UInt32: (0, 0xFFFF_FFFF),
}
"""Built-in types whose values every adapter can tell as numbers of JSON, with the lowest and the highest one."""
_OBJECTS, _SERVER = "i=85", "i=2253"
_BUILD = ("i=2263", "i=2261", "i=2264")
"""Manufacturer, name and version of the server (OPC 10000-6, NodeIds: Server_ServerStatus_BuildInfo)."""
_FAR = (4_294_967_000, 999_983)
"""Numeric identifiers that most servers do not have."""


class OpcUaFieldDevice(FieldDevice):
    """A real OPC UA server."""

    def __init__(self, url: str, consent: Consent | None = None) -> None:
        parts = urlsplit(url)
        host, port = parts.hostname or "127.0.0.1", parts.port or EXTERNAL.default_port
        client = OpcUaClient(host, port, unquote(parts.path.removeprefix("/")) or _OBJECTS)
        super().__init__("opcua", url, Endpoint(name="opcua", kind="tcp", host=host, port=port), client, consent)


class OpcUaClient:
    """The second client, see :class:`~pytest_otmcp.plant.field_device.SecondClient`."""

    name = "the kit's own client, built on asyncua"
    elsewhere = "/ns=2;s=Plant"
    library: str | None = "asyncua"

    def __init__(self, host: str, port: int, first: str) -> None:
        self.own: OwnConnections | None = OwnConnections()
        self._url = f"opc.tcp://{in_url(host)}:{port}"
        self._first = first
        self._nodes: list[str] = []
        self._kinds: dict[str, Any] = {}

    async def identity(self) -> str | None:
        """Return manufacturer, name and version."""
        async with self._connection() as client:
            told = await _read(client, _BUILD)
        return " ".join(str(value.Value.Value) for value in told if value.Value and value.Value.Value) or None

    async def survey(self) -> Mapping[str, object]:
        """Find variables with plain values, those first that stay as they are, and a node that is not there."""
        async with self._connection() as client:
            found = [node async for node in _variables(client, self._first)]
            before, after = [
                {
                    node: plain
                    for node, value in zip(found, await _read(client, found), strict=True)
                    for plain in _plain(value)
                }
                for _ in range(2)
            ]
            steady = [node for node, value in before.items() if after.get(node) == value]
            different = {str(before[node]): node for node in reversed(steady)}
            order = [*reversed(different.values()), *steady, *before]
            self._nodes = list(dict.fromkeys(node for node in order if node in after))[:_READ]
            # In the same namespace: a server may refuse another one for another reason.
            namespace = self._first.partition(";")[0] + ";" if ";" in self._first else ""
            missing = [f"{namespace}i={number}" for number in _FAR]
            refused = [
                node
                for node, value in zip(missing, await _read(client, missing), strict=True)
                if value.StatusCode is not None and value.StatusCode.value == ua.StatusCodes.BadNodeIdUnknown
            ]
        return {"node": refused[0]} if refused else {}

    async def values(self, points: tuple[str, ...] = ()) -> dict[str, object]:
        """Read the variables that the survey has found, and these."""
        return await self.held(tuple(dict.fromkeys((*self._nodes, *points))))

    async def held(self, points: tuple[str, ...]) -> dict[str, object]:
        """Read these variables."""
        async with self._connection() as client:
            values = dict(zip(points, await _read(client, points), strict=True))
        held = {node: plain for node, value in values.items() for plain in _plain(value)}
        if lost := [node for node in points if node not in held]:
            raise UnreachableError(f"it tells no number and no truth value of {lost[0]}")
        # A server may let a write change the type: the first one counts.
        self._kinds = {node: value.Value.VariantType for node, value in values.items()} | self._kinds
        return held

    def bounds(self, point: str) -> tuple[float, float]:
        """Return those of the built-in type that the variable had when it was read first."""
        return _BOUNDS[self._kinds[point]]

    async def write(self, point: str, value: Any) -> None:
        """Write a value with the built-in type that the variable had when it was read first."""
        told = ua.DataValue(ua.Variant(value, self._kinds[point]), StatusCode=None)
        async with self._connection() as client:
            await client.get_node(point).write_attribute(ua.AttributeIds.Value, told)

    @asynccontextmanager
    async def _connection(self) -> AsyncIterator[Any]:
        try:
            async with asyncio.timeout(4 * _ANSWER_TIMEOUT_S), Client(self._url, timeout=_ANSWER_TIMEOUT_S) as client:
                if self.own is not None:
                    self.own.note(client.uaclient.protocol.transport)
                yield client
        except TimeoutError:
            raise UnreachableError("it does not answer") from None
        except (OSError, ua.UaError, struct.error) as error:  # the last for a node id with a number that none can have
            raise UnreachableError(str(error) or type(error).__name__) from None


async def _variables(client: Any, first: str) -> AsyncIterator[str]:
    """Yield the variables at and below a node, level by level, as far as the kit looks."""
    yield first
    waiting, known, told = [first], {first, _SERVER}, 1
    for _ in range(_BROWSED):
        if not waiting:
            return
        node = waiting.pop(0)
        for reference in await client.get_node(node).get_references(
            refs=ua.ObjectIds.HierarchicalReferences,
            direction=ua.BrowseDirection.Forward,
            nodeclassmask=ua.NodeClass.Object | ua.NodeClass.Variable,
        ):
            name = _name(reference.NodeId)
            if name is None or name in known:
                continue
            known.add(name)
            waiting.append(name)
            if reference.NodeClass == ua.NodeClass.Variable and (first != _OBJECTS or reference.NodeId.NamespaceIndex):
                yield name
                told += 1
                if told == _LOOKED_AT:
                    return


def _name(node: Any) -> str | None:
    """Return a node id as a URL of the kit may have it; None of another one."""
    if getattr(node, "ServerIndex", 0) or not isinstance(node.Identifier, int | str):
        return None
    kind = "i" if isinstance(node.Identifier, int) else "s"
    namespace = f"ns={node.NamespaceIndex};" if node.NamespaceIndex else ""
    return f"{namespace}{kind}={node.Identifier}"


async def _read(client: Any, nodes: Any) -> list[Any]:
    named = [client.get_node(node) for node in nodes]
    some = [named[first : first + _AT_ONCE] for first in range(0, len(named), _AT_ONCE)]
    return [value for part in some for value in await client.read_attributes(part)]


def _is_bad(value: Any) -> bool:
    return value.StatusCode is not None and not value.StatusCode.is_good()


def _plain(value: Any) -> Iterator[object]:
    """Yield the number or truth value that a DataValue holds; nothing of another one."""
    variant = value.Value
    if (
        _is_bad(value)
        or variant is None
        or variant.VariantType not in _BOUNDS
        or not isinstance(variant.Value, bool | int | float)
    ):
        return
    if math.isfinite(variant.Value):
        yield variant.Value
