"""Messages of CIP and their paths: what a request names, and the answer to it. It handles bytes only.

Sources: ODVA's volume 1, chapters 2 and 3 and appendix C, as far as the public developer guide has it, and Rockwell's 1756-PM020 for
symbolic segments, multiple services and status codes.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

__all__ = [
    "BAD_PATH",
    "SUCCESS",
    "TOO_LITTLE_DATA",
    "Path",
    "Refusal",
    "Reply",
    "Request",
    "embedded",
    "multiple_reply",
]

SUCCESS = 0x00
BAD_PATH, TOO_LITTLE_DATA, PATH_SIZE = 0x04, 0x13, 0x26
EMBEDDED_ERROR = 0x1E

_SYMBOL = 0x91
_CLASS, _INSTANCE, _ELEMENT, _POINT, _ATTRIBUTE = 0x20, 0x24, 0x28, 0x2C, 0x30
_LOGICAL = {_CLASS, _INSTANCE, _ELEMENT, _POINT, _ATTRIBUTE}
_EXTENDED_LINK = 0x10
_REPLY = 0x80


class Refusal(Exception):
    """A service that the controller does not carry out."""

    def __init__(self, status: int, *extended: int) -> None:
        super().__init__(f"status {status:02X}")
        self.status = status
        self.extended = extended


@dataclass(frozen=True, slots=True, kw_only=True)
class Path:
    """What a request is for (EPATH, padded).

    Attributes:
        ports: hops before the target, each a port and a link address.
        class_id, instance, attribute: numbers of logical segments; None for none.
        names: what the symbolic segments before the class segment say: the program.
        steps: what the rest says: names of a tag and of members, and indexes of elements.
    """

    ports: tuple[tuple[int, bytes], ...] = ()
    class_id: int | None = None
    instance: int | None = None
    attribute: int | None = None
    names: tuple[str, ...] = ()
    steps: tuple[str | int, ...] = ()

    @classmethod
    def parse(cls, raw: bytes) -> Path:
        """Read a path.

        Raises:
            Refusal: it holds a segment that is none, or that is cut off.
        """
        found = _Parts()
        rest = raw
        while rest:
            rest = _segment(found, rest)
        names, steps = ((), found.steps) if found.class_id is None else (found.names, found.steps)
        return cls(
            ports=tuple(found.ports),
            class_id=found.class_id,
            instance=found.instance,
            attribute=found.attribute,
            names=tuple(names),
            steps=tuple(steps),
        )

    def label(self) -> str | None:
        """Return what the path names as Logix writes it, such as ``Levels[2]``; None where the tag is an instance or there is none."""
        if self.class_id is not None:
            return None
        text = ""
        for step in self.steps:
            if isinstance(step, int):
                text = f"{text[:-1]},{step}]" if text.endswith("]") else f"{text}[{step}]"
            else:
                text = f"{text}.{step}" if text else step
        return text or None


@dataclass(slots=True)
class _Parts:
    ports: list[tuple[int, bytes]] = field(default_factory=list)
    class_id: int | None = None
    instance: int | None = None
    attribute: int | None = None
    names: list[str] = field(default_factory=list)
    steps: list[str | int] = field(default_factory=list)


def _segment(found: _Parts, raw: bytes) -> bytes:
    """Take the first segment of a path; return the rest."""
    kind = raw[0]
    if kind < 0x20:
        return _port(found, raw)
    if kind == _SYMBOL:
        size = raw[1] if len(raw) > 1 else 0
        padded = 2 + size + size % 2
        if not size or len(raw) < padded:
            raise Refusal(BAD_PATH, 0)
        found.steps.append(raw[2 : 2 + size].decode("latin-1"))
        return raw[padded:]
    width = kind & 0x03
    if kind - width not in _LOGICAL or width == 3 or len(raw) < (2, 4, 6)[width]:
        raise Refusal(BAD_PATH, 0)
    # Wider numbers follow a byte of padding.
    value = raw[1] if width == 0 else int.from_bytes(raw[2 : 2 + 2 * width], "little")
    _number(found, kind - width, value)
    return raw[(2, 4, 6)[width] :]


def _number(found: _Parts, kind: int, value: int) -> None:
    if kind == _ELEMENT:
        found.steps.append(value)
    elif kind == _CLASS and found.class_id is None:
        found.class_id = value
        found.names = [step for step in found.steps if isinstance(step, str)]
        found.steps = []
    elif kind in (_INSTANCE, _POINT) and found.class_id is not None:
        found.instance = value
    elif kind == _ATTRIBUTE and found.class_id is not None:
        found.attribute = value
    else:
        raise Refusal(BAD_PATH, 0)


def _port(found: _Parts, raw: bytes) -> bytes:
    port = raw[0] & 0x0F
    if port == 0x0F or len(raw) < 2 or found.class_id is not None or found.steps:
        raise Refusal(BAD_PATH, 0)
    size = raw[1] if raw[0] & _EXTENDED_LINK else 1
    first = 2 if raw[0] & _EXTENDED_LINK else 1
    end = first + size
    if not size or len(raw) < end:
        raise Refusal(BAD_PATH, 0)
    found.ports.append((port, raw[first:end]))
    return raw[end + end % 2 :]


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """A request to the message router.

    Attributes:
        service: its code.
        route: bytes of the path.
        data: what follows it.
    """

    service: int
    route: bytes
    data: bytes

    @classmethod
    def parse(cls, raw: bytes) -> Request:
        """Read a request.

        Raises:
            Refusal: the path is longer than the message.
        """
        if len(raw) < 2 or len(raw) < 2 + 2 * raw[1]:
            raise Refusal(PATH_SIZE)
        end = 2 + 2 * raw[1]
        return cls(service=raw[0], route=raw[2:end], data=raw[end:])

    @property
    def path(self) -> Path:
        """The path, read.

        Raises:
            Refusal: it is none.
        """
        return Path.parse(self.route)


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """The answer to a request.

    Attributes:
        service: code of the request's service.
        status, extended: general status, and words that tell more.
    """

    service: int
    status: int = SUCCESS
    extended: tuple[int, ...] = ()
    data: bytes = b""

    def encoded(self) -> bytes:
        """Return the answer as it is on the wire."""
        head = struct.pack("<BBBB", (self.service | _REPLY) & 0xFF, 0, self.status, len(self.extended))
        return head + struct.pack(f"<{len(self.extended)}H", *self.extended) + self.data


def embedded(data: bytes) -> list[bytes] | None:
    """Return the messages that a multiple service packet, or the answer to one, holds; None where it holds none."""
    if len(data) < 2:
        return None
    (count,) = struct.unpack_from("<H", data)
    if not count or len(data) < 2 + 2 * count:
        return None
    starts = [*struct.unpack_from(f"<{count}H", data, 2), len(data)]
    if starts[0] < 2 + 2 * count or any(end < start for start, end in pairwise(starts)):
        return None
    return [data[start:end] for start, end in pairwise(starts)]


def multiple_reply(service: int, replies: Sequence[Reply]) -> Reply:
    """Return the answer to a multiple service packet whose services have these answers."""
    parts = [reply.encoded() for reply in replies]
    start = 2 + 2 * len(parts)
    offsets = [start + sum(map(len, parts[:number])) for number in range(len(parts))]
    failed = any(reply.status for reply in replies)
    data = struct.pack(f"<{1 + len(parts)}H", len(parts), *offsets) + b"".join(parts)
    return Reply(service=service, status=EMBEDDED_ERROR if failed else SUCCESS, data=data)
