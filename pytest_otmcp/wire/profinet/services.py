"""What a message asks for or answers, in the words of the journal: what mock and kit both have to know of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from . import dcp, rpc
from .blocks import (
    APPLICATION_READY,
    CONTROLLER,
    INPUTS,
    IOCR,
    MODULE_DIFFERENCE,
    RELATION,
    SUBMODULES,
    CyclicData,
    Module,
    Place,
    Record,
    Relation,
    Submodule,
    blocks_of,
)
from .dcp import Dcp
from .rpc import Kind, Rpc
from .rt import GOOD, RtFrame

__all__ = ["SERVICES", "agreed_of", "dcp_fields", "rpc_fields", "status_of", "subslots_of"]

_DCP = {dcp.GET: "get", dcp.SET: "set", dcp.IDENTIFY: "identify"}
_RPC = {
    rpc.CONNECT: "connect",
    rpc.RELEASE: "release",
    rpc.READ: "read",
    rpc.WRITE: "write",
    rpc.CONTROL: "control",
    rpc.READ_IMPLICIT: "read",
}
SERVICES = (
    "identify",
    "get",
    "set",
    "signal",
    "connect",
    "read",
    "write",
    "control",
    "release",
    "outputs",
    "inputs",
    "other",
)
"""Names of all services, as the journal and fault rules have them."""
_IO_READ = 0x80
_CMRPC = 0x40


def status_of(status: int) -> str | None:
    """Return the key of a PNIO status in ``codes.toml``: that of a record's access, or of the connection; None for success."""
    if not status:
        return None
    _, decode, first, second = status.to_bytes(4)
    if decode == _IO_READ:
        return f"{first:02x}"
    return f"cmrpc-{second:02x}" if first == _CMRPC else f"cm-{first:02x}"


def dcp_fields(message: Dcp) -> dict[str, Any]:
    """Return what a DCP message says: members of its journal entry, see :class:`~pytest_otmcp.protocols.profinet.entries.ProfinetEntry`."""
    service = _DCP.get(message.service, "other")
    found: dict[str, Any] = {}
    # A qualifier, or block information, of two bytes precedes a value; a filter of an Identify has none.
    skip = 0 if message.kind == dcp.REQUEST and service == "identify" else 2
    for block in message.blocks:
        if block.option == dcp.NAME and block.content:
            found["name"] = block.content[skip:].decode("latin-1")
        elif block.option == dcp.IP and len(block.content) == 14:
            found["ip"] = ".".join(map(str, block.content[2:6]))
        elif block.option == dcp.RESULT and block.content[2:] not in (b"", b"\0"):
            found["status"] = f"dcp-{block.content[2]}"
    options = {block.option for block in message.blocks}
    if service == "set" and message.kind == dcp.REQUEST and dcp.SIGNAL in options <= {dcp.SIGNAL, dcp.START, dcp.STOP}:
        service = "signal"
    if message.kind == dcp.UNSUPPORTED:
        found["status"] = "dcp-1"
    return {"service": service, **found, "options": [".".join(map(str, one.option)) for one in message.blocks]}


def rpc_fields(call: Rpc) -> dict[str, Any]:
    """Return what a request, or the answer to one, says: members of its journal entry.

    Raises:
        MalformedError: its blocks cannot be read.
    """
    found: dict[str, Any] = {"service": _RPC.get(call.operation, "other"), "sequence": call.sequence}
    if call.kind in (Kind.FAULT, Kind.REJECT):
        return {**found, "status": "reject"}
    if call.kind == Kind.RESPONSE and (status := status_of(call.status)) is not None:
        found["status"] = status
    blocks, content = blocks_of(call.blocks)
    if found["service"] in ("read", "write") and blocks:
        record = Record.parse(blocks[0])
        found |= {"slot": record.slot, "subslot": record.subslot, "index": record.index}
        if content:
            found["data"] = content[: record.length].hex()
    for block in blocks:
        if block.type == RELATION:
            found["cyclic"] = Relation.parse(block.body).type == CONTROLLER
        elif block.type == APPLICATION_READY:
            found["service"] = "other"
        elif block.type == MODULE_DIFFERENCE:
            found["status"] = "module-difference"
    return found


def agreed_of(call: Rpc) -> tuple[dict[int, CyclicData], dict[Place, Submodule]]:
    """Return the cyclic data that a request to connect asks for, by direction, and what it expects in each subslot.

    Raises:
        MalformedError: its blocks cannot be read.
    """
    blocks, _ = blocks_of(call.blocks)
    cyclic = [CyclicData.parse(one.body) for one in blocks if one.type == IOCR]
    modules = [module for one in blocks if one.type == SUBMODULES for module in Module.parse_all(one.body)]
    expected = {(one.slot, subslot): held for one in modules for subslot, held in one.submodules.items()}
    return {one.type: one for one in cyclic}, expected


def subslots_of(frame: RtFrame, agreed: CyclicData, expected: Mapping[Place, Submodule]) -> dict[Place, bytes]:
    """Return the data in a cyclic frame of each subslot for which the provider vouches; those without data are left out."""
    found = {}
    for place, begin in agreed.data.items():
        held = expected.get(place, Submodule(identifier=0))
        end = begin + (held.inputs if agreed.type == INPUTS else held.outputs)
        if frame.is_valid and begin < end < len(frame.data) and frame.data[end] & GOOD:
            found[place] = frame.data[begin:end]
    return found
