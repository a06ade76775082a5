"""The decoding of CIP messages: requests to a message router with their paths, and the answers to them.

CIP volume 1, chapters 2 and 3 and appendix C, as ODVA's public developer guide has them; symbolic segments, tag services and multiple
services: Rockwell 1756-PM020. Requests are described as far as their bytes go: the bytes that arrived are evidence.
"""

from __future__ import annotations

import struct
from typing import Any

__all__ = ["MULTIPLE", "asked_of", "results_of", "unwrapped"]

READ, READ_PART, WRITE, WRITE_PART, MODIFY, MULTIPLE = 0x4C, 0x52, 0x4D, 0x53, 0x4E, 0x0A
UNCONNECTED_SEND, FORWARD_OPEN, LARGE_OPEN, FORWARD_CLOSE = 0x52, 0x54, 0x5B, 0x4E
ROUTER, MANAGER, SYMBOL, TEMPLATE, CLOCK, PROGRAM_NAME = 0x02, 0x06, 0x6B, 0x6C, 0x8B, 0x64

STATE_CHANGING = frozenset({2, 4, 5, 6, 7, 8, 9, 0x10, 0x4B, WRITE, MODIFY, WRITE_PART})
"""Services that can change the controller: setting attributes, reset, start, stop, create, delete, PCCC, and writing tags."""

_TAG = {READ: "read", READ_PART: "read", WRITE: "write", WRITE_PART: "write", MODIFY: "modify"}
_OBJECTS = {
    (ROUTER, MULTIPLE): "multiple",
    (MANAGER, FORWARD_OPEN): "forward_open",
    (MANAGER, LARGE_OPEN): "forward_open",
    (MANAGER, FORWARD_CLOSE): "forward_close",
    (SYMBOL, 0x55): "tag_list",
    (TEMPLATE, 3): "template",
    (TEMPLATE, READ): "template",
    (CLOCK, 3): "clock",
    (CLOCK, 4): "set_clock",
    (1, 1): "identity",
    (1, 0x0E): "identity",
    (PROGRAM_NAME, 1): "identity",
}
_SIZES = {0xC1: 1, 0xC2: 1, 0xC3: 2, 0xC4: 4, 0xC5: 8, 0xC6: 1, 0xC7: 2, 0xC8: 4, 0xC9: 8, 0xCA: 4, 0xCB: 8}
"""Codes of elementary types, from BOOL to LREAL, to bytes of a value."""
_STRUCTURE, _STRING, _STRING_SIZE = 0x02A0, 0x0FCE, 88


class _BadPathError(ValueError):
    """The bytes are no path."""


def asked_of(message: bytes) -> dict[str, Any]:
    """Return what a message asks for: ``service``, ``items`` and ``state_changing``."""
    outer = _item(message)
    items = [outer]
    if outer["asks"] == "multiple":
        items = [_item(part) for part in _parts(_behind_path(message) or b"")]
    changing = any(item.get("code") in STATE_CHANGING and item.get("class") != MANAGER for item in items)
    return {"service": outer["asks"], "items": items, "state_changing": changing or _connects_data(outer, message)}


def unwrapped(message: bytes) -> tuple[bytes, bytes] | None:
    """Return the message that an Unconnected Send carries, and its route; None for another message."""
    outer = _item(message)
    data = _behind_path(message)
    if (outer.get("code"), outer.get("class")) != (UNCONNECTED_SEND, MANAGER) or data is None or len(data) < 4:
        return None
    length = int.from_bytes(data[2:4], "little")
    behind = data[4 + length + length % 2 :]
    whole = length >= 2 and len(behind) >= 2 and len(behind) == 2 + 2 * behind[0]
    return (data[4 : 4 + length], behind[2:]) if whole else None


def results_of(message: bytes) -> dict[str, Any]:
    """Return what an answer says: ``status``, ``extended`` and ``items``.

    Raises:
        IndexError: it is cut off.
    """
    outer = _result(message)
    parts = [message]
    if outer["code"] == MULTIPLE:
        parts = _parts(bytes.fromhex(outer.get("data", "")))
    return {"status": outer["status"], "extended": outer.get("extended"), "items": [_result(part) for part in parts]}


def _result(message: bytes) -> dict[str, Any]:
    start = 4 + 2 * message[3]
    found: dict[str, Any] = {"code": message[0] & 0x7F, "status": message[2]}
    if start > 4:
        found["extended"] = int.from_bytes(message[4:6], "little")
    if len(message) > start:
        found["data"] = message[start:].hex()
    return found


def _behind_path(message: bytes) -> bytes | None:
    """Return the data of a request; None where the path is longer than the message."""
    if len(message) < 2 or len(message) < 2 + 2 * message[1]:
        return None
    return message[2 + 2 * message[1] :]


def _parts(data: bytes) -> list[bytes]:
    """Return the messages within a multiple service packet, or its answer; none where the offsets are wrong."""
    count = int.from_bytes(data[:2], "little")
    first = 2 + 2 * count
    if not count or len(data) < first:
        return []
    bounds = [*struct.unpack_from(f"<{count}H", data, 2), len(data)]
    if bounds[0] < first or sorted(bounds) != bounds:
        return []
    return [data[bounds[number] : bounds[number + 1]] for number in range(count)]


def _item(message: bytes) -> dict[str, Any]:
    data = _behind_path(message)
    try:
        if data is None:
            raise _BadPathError
        path = _path(message[2 : len(message) - len(data)])
    except _BadPathError:
        return {"asks": "other", "code": message[0]} if message else {"asks": "other"}
    code, of_class = message[0], path["class"]
    names = _TAG if of_class in (None, SYMBOL) else {}
    asks = _OBJECTS.get((of_class, code)) or names.get(code, "other")
    found = {"asks": asks, "code": code, **path, **_content(code, data)}
    return {name: value for name, value in found.items() if value not in (None, [])}


def _content(code: int, data: bytes) -> dict[str, Any]:
    if code in (READ, READ_PART):
        offset = data[2:6] if code == READ_PART else b""
        return {"count": _number(data[:2], 2), "offset": _number(offset, 4)}
    if code == MODIFY and len(data) >= 2:
        size = int.from_bytes(data[:2], "little")
        return {"or_mask": data[2 : 2 + size].hex(), "and_mask": data[2 + size : 2 + 2 * size].hex()}
    if code in (WRITE, WRITE_PART) and len(data) >= 4:
        return _written(code, data)
    return {}


def _written(code: int, data: bytes) -> dict[str, Any]:
    kind, rest = int.from_bytes(data[:2], "little"), data[2:]
    found: dict[str, Any] = {"type": kind}
    if kind == _STRUCTURE:
        found["handle"], rest = int.from_bytes(rest[:2], "little"), rest[2:]
    if len(rest) < 2:
        return found
    count, rest = int.from_bytes(rest[:2], "little"), rest[2:]
    if code == WRITE_PART:
        return {**found, "count": count, "offset": _number(rest[:4], 4), "data": rest[4:].hex()}
    size = _STRING_SIZE if found.get("handle") == _STRING else _SIZES.get(kind, len(rest))
    # What a client sends beyond the elements that it announces is no second write (pycomm3 sends it, 1.2.16).
    return {
        **found,
        "count": count,
        "data": rest[: count * size].hex(),
        "excess": max(0, len(rest) - count * size) or None,
    }


def _number(content: bytes, size: int) -> int | None:
    return int.from_bytes(content, "little") if len(content) == size else None


def _path(raw: bytes) -> dict[str, Any]:
    """Return what a path names: ``tag``, or ``class``, ``instance`` and ``attribute``, with the ``program`` before and the ``steps`` behind.

    Raises:
        _BadPathError: the bytes are none.
    """
    numbers: dict[str, int | None] = {"class": None, "instance": None, "attribute": None}
    before: list[str | int] = []
    steps: list[str | int] = []
    while raw:
        kind, number, raw = _segment(raw)
        if kind in ("name", "element"):
            steps.append(number)
        elif kind == "port":
            if steps or numbers["class"] is not None:
                raise _BadPathError
        elif kind == "class" and numbers["class"] is None:
            numbers["class"], before, steps = int(number), steps, []
        elif kind != "class" and numbers["class"] is not None:
            numbers[kind] = int(number)
        else:
            raise _BadPathError
    if numbers["class"] is None:
        return {"tag": tag_name(steps) or None, **numbers}
    program = ".".join(step for step in before if isinstance(step, str))
    return {"program": program or None, **numbers, "steps": steps}


def tag_name(steps: list[str | int]) -> str:
    """Return names and indexes as Logix writes them."""
    text = ""
    for step in steps:
        if isinstance(step, str):
            text += f".{step}" if text else step
        else:
            text = f"{text[:-1]},{step}]" if text.endswith("]") else f"{text}[{step}]"
    return text


_LOGICAL = {0x20: "class", 0x24: "instance", 0x28: "element", 0x2C: "instance", 0x30: "attribute"}


def _segment(raw: bytes) -> tuple[str, str | int, bytes]:
    """Return kind and content of the first segment of a path, and the rest.

    Raises:
        _BadPathError: there is none.
    """
    head, after = raw[0], raw[1:]
    if head == 0x91 and after and after[0]:
        size = after[0]
        padded = size + size % 2
        if len(after) < 1 + padded:
            raise _BadPathError
        return "name", after[1 : 1 + size].decode("latin-1"), after[1 + padded :]
    if head < 0x20 and head & 0x0F != 0x0F and after:
        size = 1 + after[0] if head & 0x10 else 1
        if len(after) < size or (head & 0x10 and not after[0]):
            raise _BadPathError
        # The segment ends at an even byte.
        return "port", head & 0x0F, after[size + (1 + size) % 2 :]
    width = head & 0x03
    kind = _LOGICAL.get(head - width)
    size = (2, 4, 6)[width] if width < 3 else 0
    if kind is None or not size or len(raw) < size:
        raise _BadPathError
    return kind, int.from_bytes(raw[1:2] if width == 0 else raw[2:size], "little"), raw[size:]


def _connects_data(outer: dict[str, Any], message: bytes) -> bool:
    """Tell whether a forward open asks for a connection that carries data of the plant (transport classes 0 and 1)."""
    data = _behind_path(message)
    if outer["asks"] != "forward_open" or data is None:
        return False
    transport = data[38 if outer["code"] == LARGE_OPEN else 34 :][:1]
    return bool(transport) and transport[0] & 0x0F not in (2, 3)
