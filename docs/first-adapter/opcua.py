"""An OPC UA adapter that earns Silver: the official SDK, and asyncua."""

from __future__ import annotations

import asyncio
import base64
import math
import os
import struct
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import fields, is_dataclass
from datetime import UTC, datetime
from enum import Enum
from typing import Any
from uuid import UUID

from asyncua import Client, Node, ua
from asyncua.ua.ua_binary import nodeid_to_binary
from mcp.server.mcpserver.exceptions import ToolError
from strict_mcp import READS, WRITES, StrictServer, strict

mcp = StrictServer("plant-opcua", "1.0.0")
TIMEOUT_S = float(os.environ.get("OPCUA_TIMEOUT_S", "2"))
CLOSING: set[asyncio.Task[None]] = set()
LONGEST = 10000
SESSIONS = asyncio.Semaphore(4)  # servers have few of them

# asyncua skips what it does not know: "nsu=urn:other;i=2256" would be node 2256 of namespace 0.
NodeId = strict(str, "node id, such as ns=2;s=Temperature", pattern=r"^(ns=\d+;)?[isgb]=", max_length=4096)

# The format of each integer type, for struct.
INTEGERS = dict(zip("SByte Byte Int16 UInt16 Int32 UInt32 Int64 UInt64".split(), "bBhHiIqQ", strict=True))
TEXTS = {
    "String": str,
    "LocalizedText": ua.LocalizedText,
    "Guid": UUID,
    "ByteString": lambda text: base64.b64decode(text, validate=True),
    "DateTime": lambda text: utc(datetime.fromisoformat(text)),
}
SPECIAL = {"nan": "NaN", "inf": "Infinity", "-inf": "-Infinity"}  # JSON has none of these numbers


@asynccontextmanager
async def waited() -> AsyncIterator[None]:
    """Wait a moment for one of the sessions; refuse the call when there are too many."""
    try:
        async with asyncio.timeout(1):
            await SESSIONS.acquire()
    except TimeoutError:
        raise ToolError("device_busy: too many calls at the same time; nothing was sent") from None
    try:
        yield
    finally:
        SESSIONS.release()


@asynccontextmanager
async def plc() -> AsyncIterator[Client]:
    """Give a call a session of its own."""
    # The watchdog ends a connection whose server was slow to answer it once.
    client = Client(os.environ["OPCUA_URL"], timeout=TIMEOUT_S, watchdog_intervall=60)
    try:
        async with waited(), asyncio.timeout(2 * TIMEOUT_S):
            try:
                try:
                    await client.connect()
                except (OSError, ua.UaError) as error:
                    raise ToolError(f"connect_failed: the server cannot be reached ({error})") from error
                yield client
            finally:
                # In a task of its own: a call that is cancelled is cancelled at each await, and its session would stay.
                closing = asyncio.create_task(client.disconnect())
                CLOSING.add(closing)
                closing.add_done_callback(CLOSING.discard)
                await asyncio.wait({closing}, timeout=1)
    except ua.UaStatusCodeError as error:
        raise ToolError(f"{ua.StatusCode(error.code).name}: the server refused") from error
    except (OSError, ua.UaError) as error:
        # The SDK hides the text of every exception but ToolError.
        raise ToolError(f"no_reply: the server gave no valid answer ({error})") from error


def node(client: Client, text: str) -> Node:
    """Return a node; raise for a text that is no node id."""
    try:
        found = client.get_node(text)
        nodeid_to_binary(found.nodeid)  # an index of more than 16 bits, or an id of more than 32, fails here
        return found
    except Exception as error:
        raise ToolError(f"invalid_argument: {text!r} is no node id; nothing was sent") from error


def plain(value: Any) -> Any:
    """Return a value as JSON has it."""
    if isinstance(value, list):
        return [plain(member) for member in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, int) and not isinstance(value, bool):
        # A client in JavaScript has no integers beyond this.
        return value if abs(value) < 2**53 else str(value)
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    if isinstance(value, datetime):
        return value.replace(tzinfo=UTC).isoformat()
    if isinstance(value, ua.NodeId):
        return value.to_string()
    if isinstance(value, ua.LocalizedText):
        return value.Text
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    return value if value is None or isinstance(value, (bool, str)) else str(value)


def typed(value: Any, kind: ua.VariantType) -> Any:
    """Return a value as the node's own type; raise for one that the type cannot hold."""
    if isinstance(value, list):
        return [typed(member, kind) for member in value]
    refused = ToolError(f"type_mismatch: the node holds {kind.name}; nothing was sent")
    if kind.name in INTEGERS and type(value) is int:
        try:
            struct.pack(f"<{INTEGERS[kind.name]}", value)
        except struct.error:
            raise ToolError(f"range_overflow: {kind.name} cannot hold {value}; nothing was sent") from None
        return value
    if kind.name in ("Float", "Double") and type(value) in (int, float):
        try:
            struct.pack("<f" if kind.name == "Float" else "<d", value)
        except OverflowError:
            raise ToolError(f"range_overflow: {kind.name} cannot hold {value}; nothing was sent") from None
        if not math.isfinite(value):
            raise refused
        return float(value)
    if kind.name == "Boolean" and type(value) is bool:
        return value
    if kind.name in TEXTS and type(value) is str:
        try:
            return TEXTS[kind.name](value)
        except ValueError:
            raise refused from None
    raise refused


def utc(moment: datetime) -> datetime:
    """Return the instant as the server has it; raise for a time that does not say its zone."""
    if moment.tzinfo is None:
        raise ValueError("no zone")
    return moment.astimezone(UTC).replace(tzinfo=None)


def shape(value: Any) -> list[int]:
    """Return the lengths of an array's dimensions; raise for one whose rows differ."""
    if not isinstance(value, list):
        return []
    inner = [shape(member) for member in value]
    if any(other != inner[0] for other in inner):
        raise ToolError("type_mismatch: the rows of the array differ in length; nothing was sent")
    return [len(value), *(inner[0] if inner else [])]


@mcp.tool(annotations=READS)
async def read_node(node_id: NodeId) -> dict[str, Any]:
    """Read the value of a variable."""
    async with plc() as client:
        # read_data_value() does not ask for the time of the server, and fails for a value that is uncertain.
        asked = ua.ReadValueId(NodeId=node(client, node_id).nodeid, AttributeId=ua.AttributeIds.Value)
        both = ua.ReadParameters(TimestampsToReturn=ua.TimestampsToReturn.Both, NodesToRead=[asked])
        [found] = await client.uaclient.read(both)
        if found.StatusCode.is_bad():
            found.StatusCode.check()
    held = found.Value or ua.Variant()
    value, kind = held.Value, held.VariantType
    return {
        "value": plain(value),
        "data_type": kind.name,
        "status": found.StatusCode.name,
        "special": SPECIAL.get(str(value)) if isinstance(value, float) else None,
        "source_timestamp": plain(found.SourceTimestamp),
        "server_timestamp": plain(found.ServerTimestamp),
    }


@mcp.tool(annotations=READS)
async def browse_node(node_id: NodeId) -> dict[str, list[dict[str, str]]]:
    """List the children of a node."""
    async with plc() as client:
        parent = node(client, node_id)
        await parent.read_node_class()  # asyncua lists no children for a node that does not exist
        children = await parent.get_children_descriptions()
    return {"children": [{"node_id": plain(each.NodeId), "name": each.BrowseName.Name} for each in children]}


@mcp.tool(annotations=WRITES)
async def write_node(node_id: NodeId, value: Any) -> dict[str, Any]:
    """Write the value of a variable, as the type that the node has."""
    if os.environ.get("OPCUA_WRITES") != "true":
        raise ToolError("writes_disabled: OPCUA_WRITES is not true; nothing was sent")
    if isinstance(value, list) and len(value) > LONGEST:
        raise ToolError(f"limit_exceeded: an array has {LONGEST} elements at most; nothing was sent")
    async with plc() as client:
        target = node(client, node_id)
        kind = await target.read_data_type_as_variant_type()
        rank = await target.read_value_rank()
        lengths = await target.read_array_dimensions() or [] if rank > 0 else []
        found = shape(value)
        if len(found) != max(rank, 0) or any(one not in (0, two) for one, two in zip(lengths, found, strict=False)):
            raise ToolError(f"type_mismatch: the node holds {rank} dimensions of {lengths}; nothing was sent")
        data = ua.DataValue(ua.Variant(typed(value, kind), kind, is_array=rank > 0))
        request = ua.WriteValue(NodeId=target.nodeid, AttributeId=ua.AttributeIds.Value, Value=data)
        [status] = await client.uaclient.write(ua.WriteParameters(NodesToWrite=[request]))
        status.check()
        if status.name == "GoodClamped":
            value = plain(await target.read_value())
    return {"node_id": node_id, "value": value, "status": status.name}


if __name__ == "__main__":
    mcp.run()
