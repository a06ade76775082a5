"""What the journal has of requests and answers, as far as their bytes say it."""

from __future__ import annotations

import struct
from typing import Any

from .messages import Refusal, Request, embedded
from .types import ELEMENTARY, STRING

__all__ = ["MULTIPLE", "describe", "described_reply"]

READ, READ_FRAGMENT, WRITE, WRITE_FRAGMENT, MODIFY = 0x4C, 0x52, 0x4D, 0x53, 0x4E
MULTIPLE = 0x0A

_TAG_SERVICES = {
    READ: "read",
    READ_FRAGMENT: "read",
    WRITE: "write",
    WRITE_FRAGMENT: "write",
    MODIFY: "modify",
}
_SERVICES: dict[tuple[int, int | None], str] = {
    **{(code, None): name for code, name in _TAG_SERVICES.items()},
    **{(code, 0x6B): name for code, name in _TAG_SERVICES.items()},
    (0x55, 0x6B): "tag_list",
    (0x03, 0x6C): "template",
    (READ, 0x6C): "template",
    (0x01, 0x01): "identity",
    (0x0E, 0x01): "identity",
    (0x01, 0x64): "identity",
    (0x03, 0x8B): "clock",
    (0x04, 0x8B): "set_clock",
    (MULTIPLE, 0x02): "multiple",
    (0x54, 0x06): "forward_open",
    (0x5B, 0x06): "forward_open",
    (0x4E, 0x06): "forward_close",
}
_CHANGING = {0x02, 0x04, 0x05, 0x06, 0x07, 0x08, 0x09, 0x10, 0x4B, WRITE, MODIFY, WRITE_FRAGMENT}
_HANDLE_FOLLOWS = 0x02A0
_SIZES = {kind.code: kind.size for kind in ELEMENTARY.values()}


def describe(raw: bytes) -> dict[str, Any]:
    """Return the members that the journal has of a request: ``service``, ``items`` and ``state_changing``."""
    item = _item(raw)
    items = [item]
    if item["asks"] == "multiple":
        items = [_item(one) for one in embedded(Request.parse(raw).data) or ()]
    changing = any(one.get("code") in _CHANGING and one.get("class") != 0x06 for one in items)
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
    if request.service in (READ, READ_FRAGMENT):
        count = struct.unpack_from("<H", data)[0] if len(data) >= 2 else None
        return {"count": count, "offset": _offset(data, 2) if request.service == READ_FRAGMENT else None}
    if request.service == MODIFY and len(data) >= 2:
        (size,) = struct.unpack_from("<H", data)
        return {"or_mask": data[2 : 2 + size].hex(), "and_mask": data[2 + size : 2 + 2 * size].hex()}
    if request.service in (WRITE, WRITE_FRAGMENT) and len(data) >= 4:
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
    if service == WRITE_FRAGMENT:
        return {**found, "offset": _offset(rest, 0), "data": rest[4:].hex()}
    size = STRING.size if found.get("handle") == STRING.handle else _SIZES.get(found["type"], len(rest))
    whole = found["count"] * size
    # A client may send more than it announces (pycomm3 does); the controller takes what is announced.
    return {**found, "data": rest[:whole].hex(), "excess": max(0, len(rest) - whole) or None}


def _type(data: bytes) -> tuple[int | None, bytes]:
    return (int.from_bytes(data[:2], "little"), data[2:]) if len(data) >= 2 else (None, b"")


def _offset(data: bytes, at: int) -> int | None:
    return int(struct.unpack_from("<I", data, at)[0]) if len(data) >= at + 4 else None


def described_reply(raw: bytes) -> dict[str, Any]:
    """Return the members that the journal has of an answer: ``status``, ``extended`` and ``items``."""
    first = _result(raw)
    parts = [raw]
    if first["code"] == MULTIPLE:
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
