"""What journal entries have of requests and answers, as far as their bytes say it; also of requests that a controller refuses."""

from __future__ import annotations

import struct
from typing import Any

from . import cip
from .messages import Refusal, Request, embedded

__all__ = ["describe", "described_reply"]

_TAG_SERVICES = {
    cip.READ: "read",
    cip.READ_FRAGMENT: "read",
    cip.WRITE: "write",
    cip.WRITE_FRAGMENT: "write",
    cip.MODIFY: "modify",
}
_SERVICES: dict[tuple[int, int | None], str] = {
    **{(code, None): name for code, name in _TAG_SERVICES.items()},
    **{(code, cip.SYMBOL): name for code, name in _TAG_SERVICES.items()},
    (cip.LIST_INSTANCES, cip.SYMBOL): "tag_list",
    (cip.GET_LIST, cip.TEMPLATE): "template",
    (cip.READ, cip.TEMPLATE): "template",
    (cip.GET_ALL, cip.IDENTITY): "identity",
    (cip.GET_SINGLE, cip.IDENTITY): "identity",
    (cip.GET_ALL, cip.PROGRAM_NAME): "identity",
    (cip.GET_LIST, cip.WALL_CLOCK): "clock",
    (cip.SET_LIST, cip.WALL_CLOCK): "set_clock",
    (cip.MULTIPLE, cip.MESSAGE_ROUTER): "multiple",
    (cip.FORWARD_OPEN, cip.CONNECTION_MANAGER): "forward_open",
    (cip.LARGE_FORWARD_OPEN, cip.CONNECTION_MANAGER): "forward_open",
    (cip.FORWARD_CLOSE, cip.CONNECTION_MANAGER): "forward_close",
}
# Set_Attributes_All and _List, Reset, Start, Stop, Create, Delete, Set_Attribute_Single, Execute PCCC, and the writes of tags.
_CHANGING = {0x02, cip.SET_LIST, 0x05, 0x06, 0x07, 0x08, 0x09, 0x10, 0x4B, cip.WRITE, cip.MODIFY, cip.WRITE_FRAGMENT}
_HANDLE_FOLLOWS = 0x02A0
_SIZES = {0xC1: 1, 0xC2: 1, 0xC3: 2, 0xC4: 4, 0xC5: 8, 0xC6: 1, 0xC7: 2, 0xC8: 4, 0xC9: 8, 0xCA: 4, 0xCB: 8}
"""Codes of elementary types, from BOOL to LREAL, to bytes of a value."""
_STRING, _STRING_SIZE = 0x0FCE, 88
"""Handle of the structure that holds a text, and its bytes."""


def describe(raw: bytes) -> dict[str, Any]:
    """Return the members that a journal entry has of a request: ``service``, ``items`` and ``state_changing``."""
    item = _item(raw)
    items = [item]
    if item["asks"] == "multiple":
        items = [_item(one) for one in embedded(Request.parse(raw).data) or ()]
    changing = any(one.get("code") in _CHANGING and one.get("class") != cip.CONNECTION_MANAGER for one in items)
    return {"service": item["asks"], "items": items, "state_changing": changing}


def _item(raw: bytes) -> dict[str, Any]:
    try:
        request = Request.parse(raw)
        path = request.path
    except Refusal:
        return {"asks": "other", "code": raw[0]} if raw else {"asks": "other"}
    found: dict[str, Any] = {
        "asks": _SERVICES.get((request.service, path.class_id), "other"),
        "code": request.service,
        "tag": path.label(),
        "program": ".".join(path.names) or None,
        "class": path.class_id,
        "instance": path.instance,
        "attribute": path.attribute,
        "steps": list(path.steps) if path.class_id is not None else None,
        **_content(request),
    }
    return {name: value for name, value in found.items() if value not in (None, [])}


def _content(request: Request) -> dict[str, Any]:
    """Return what a read or a write of a tag asks for, besides the tag."""
    data = request.data
    if request.service in (cip.READ, cip.READ_FRAGMENT):
        count = struct.unpack_from("<H", data)[0] if len(data) >= 2 else None
        return {"count": count, "offset": _offset(data, 2) if request.service == cip.READ_FRAGMENT else None}
    if request.service == cip.MODIFY and len(data) >= 2:
        (size,) = struct.unpack_from("<H", data)
        return {"or_mask": data[2 : 2 + size].hex(), "and_mask": data[2 + size : 2 + 2 * size].hex()}
    if request.service in (cip.WRITE, cip.WRITE_FRAGMENT) and len(data) >= 4:
        return _written(request.service, data)
    return {}


def _written(service: int, data: bytes) -> dict[str, Any]:
    found: dict[str, Any] = {}
    found["type"], rest = _type(data)
    if found["type"] == _HANDLE_FOLLOWS:
        found["handle"], rest = _type(rest)
    if len(rest) < 2:
        return found
    (found["count"],) = struct.unpack_from("<H", rest)
    rest = rest[2:]
    if service == cip.WRITE_FRAGMENT:
        return {**found, "offset": _offset(rest, 0), "data": rest[4:].hex()}
    size = _STRING_SIZE if found.get("handle") == _STRING else _SIZES.get(found["type"], len(rest))
    whole = found["count"] * size
    # A client may send more than it announces (pycomm3 does); the controller takes what is announced.
    return {**found, "data": rest[:whole].hex(), "excess": max(0, len(rest) - whole) or None}


def _type(data: bytes) -> tuple[int | None, bytes]:
    return (int.from_bytes(data[:2], "little"), data[2:]) if len(data) >= 2 else (None, b"")


def _offset(data: bytes, at: int) -> int | None:
    return int(struct.unpack_from("<I", data, at)[0]) if len(data) >= at + 4 else None


def described_reply(raw: bytes) -> dict[str, Any]:
    """Return the members that a journal entry has of an answer: ``status``, ``extended`` and ``items``.

    Raises:
        IndexError: it is cut off.
    """
    first = _result(raw)
    parts = [raw]
    if first["code"] == cip.MULTIPLE:
        parts = embedded(bytes.fromhex(first.get("data", ""))) or []
    return {"status": first["status"], "extended": first.get("extended"), "items": [_result(part) for part in parts]}


def _result(raw: bytes) -> dict[str, Any]:
    words = raw[3]
    found: dict[str, Any] = {"code": raw[0] & 0x7F, "status": raw[2]}
    if words:
        found["extended"] = int.from_bytes(raw[4:6], "little")
    if len(raw) > 4 + 2 * words:
        found["data"] = raw[4 + 2 * words :].hex()
    return found
