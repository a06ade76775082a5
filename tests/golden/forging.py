"""Every change of one member of a run record, as a forger would make it who changes nothing else.

A change is the smallest that means something: a number is one more (a monotonic time a minute later), a flag is its opposite, a text
is another one that the record has under that name, a time of day is of another year, a frame has another bit, an item of a list is removed or
repeated, a member is removed.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

__all__ = ["Forgery", "forgeries"]

Path = tuple[str | int, ...]

_MINUTE_NS = 60 * 10**9
_LINES = {("items",), ("footer",)}
"""Members without which a file has no lines of a record."""


@dataclass(frozen=True, slots=True)
class Forgery:
    """One change of a record.

    Attributes:
        place: the path without numbers and names of one run: ``items[].parts[].calls[task].ok``.
        path: of the member or item.
        what: ``changed``, ``garbled``, ``removed`` or ``repeated``.
        value: that it is changed to.
    """

    place: str
    path: Path
    what: str
    value: object = None

    def applied(self, record: Any) -> Any:
        """Return the record with this change; the record itself stays as it is."""
        return self._at(record, self.path)

    def _at(self, value: Any, path: Path) -> Any:
        head, *rest = path
        copy = value.copy()
        if rest:
            copy[head] = self._at(value[head], tuple(rest))
        elif self.what == "removed":
            del copy[head]
        elif self.what == "repeated":
            copy.insert(head, copy[head])
        else:
            copy[head] = self.value
        return copy


def forgeries(record: dict[str, Any]) -> Iterator[Forgery]:
    """Return every change of every leaf of a record."""
    known: dict[str, list[object]] = defaultdict(list)
    _collect(record, "", known)
    yield from _of(record, (), "", known)


def _collect(value: object, name: str, known: dict[str, list[object]]) -> None:
    if isinstance(value, dict):
        for member, inner in value.items():
            _collect(inner, member, known)
    elif isinstance(value, list):
        for inner in value:
            _collect(inner, name, known)
    elif value is not None and value not in known[name]:
        known[name].append(value)


def _of(value: object, path: Path, place: str, known: dict[str, list[object]]) -> Iterator[Forgery]:
    if isinstance(value, dict):
        for name, inner in value.items():
            at = f"{place}.{name}" if place else name
            # A member that is null or empty says what a missing one says. Tests write the digest and the members that make lines.
            if inner not in (None, []) and (*path, name) not in _LINES and name not in ("samples", "order", "digest"):
                yield Forgery(at, (*path, name), "removed")
            if at != "footer.digest":
                yield from _of(inner, (*path, name), at, known)
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            at = f"{place}[{_sort(inner)}]"
            at = re.sub(r"\.(around|samples)\[\]$", ".parts[]", at)
            # Of numbers and texts the last one stands for all.
            if isinstance(inner, dict | list) or index == len(value) - 1:
                yield Forgery(at, (*path, index), "removed")
                yield Forgery(at, (*path, index), "repeated")
            yield from _of(inner, (*path, index), at, known)
    else:
        name = next(part for part in reversed(path) if isinstance(part, str))
        yield Forgery(place, path, "changed", _other(value, name, known[name]))
        if name == "frame":
            yield Forgery(place, path, "garbled", _garbled(str(value)))


def _sort(inner: object) -> str:
    """Return what tells the items of a list apart that are judged differently: a call's role, or an event's kind."""
    if not isinstance(inner, dict):
        return ""
    if "t_ns" in inner:
        return str(inner.get("kind", ""))
    return str(inner["judgement"]["role"]) if "tool" in inner and "judgement" in inner else ""


def _garbled(frame: str) -> str:
    """Return a frame with one bit turned: that in its middle."""
    first = frame.partition(" ")[0]
    middle = len(first) // 2
    return f"{frame[:middle]}{int(frame[middle], 16) ^ 1:x}{frame[middle + 1 :]}"


def _other(value: object, name: str, known: list[object]) -> object:
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        return value + (_MINUTE_NS if name.endswith("_ns") else 1)
    if value is None:
        return known[0] if known else "x"
    text = str(value)
    if name.endswith("_at"):
        return f"2001{text[4:]}"
    others = (other for other in known if isinstance(other, str) and other != text)
    return next(others, text[:-1] + ("0" if text[-1:] != "0" else "1"))
