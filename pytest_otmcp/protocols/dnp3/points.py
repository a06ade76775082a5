"""The points of the mock outstation: by their indexes, and by the names that a launch of an adapter with names of its own has."""

from __future__ import annotations

from collections.abc import Mapping

from ..journal import Image
from ..point import BOOL, FLOAT32, FLOAT64, INT32, TEXT, Kind, Point
from ..proof import Call

__all__ = ["NAMES", "OUTSTATION", "analog", "at", "latch", "named", "several"]

OUTSTATION = 10

NAMES: dict[str, tuple[str, int, Kind]] = {
    "otmcp_level": ("analog_input", 1, INT32),
    "otmcp_exact": ("analog_input", 7, FLOAT64),
    "otmcp_pump": ("binary_output", 2, BOOL),
    "otmcp_setpoint": ("analog_output", 0, FLOAT32),
    "otmcp_limited": ("analog_output", 2, FLOAT32),
    "otmcp_batch": ("analog_output", 3, INT32),
    "otmcp_text": ("octet_string", 0, TEXT),
}
"""Names to kind, index and type of their points."""


def at(start: int, count: int = 1) -> dict[str, object]:
    """Return the inputs of a read."""
    return {"outstation": OUTSTATION, "start": start, "count": count}


def _point(
    name: str,
    kind: Kind,
    *,
    reading: Call | None = None,
    writing: Call | None = None,
    listed: bool = False,
    condition: Mapping[str, object] | None = None,
) -> Point:
    return Point(
        kind=kind,
        reading=reading,
        writing=writing,
        pokes=lambda value: ({"point": name, "value": value},),
        held=lambda value: {name: value},
        found=lambda image: image["points"].get(name),
        output="values" if listed else "value",
        listed=listed,
        condition=condition or {},
    )


def analog(index: int) -> Point:
    """Return an analog input."""
    condition = {"function": 1, "group": 30, "index": index}
    reading = Call("read_analog", at(index))
    return _point(f"analog_input/{index}", INT32, reading=reading, listed=True, condition=condition)


def latch(index: int) -> Point:
    """Return a binary output that is latched."""
    writing = Call("write_binary", {"outstation": OUTSTATION, "index": index})
    return _point(f"binary_output/{index}", BOOL, writing=writing)


def named(name: str) -> Point:
    """Return the point with a name."""
    kind, index, values = NAMES[name]
    call = {"name": name}
    return _point(f"{kind}/{index}", values, reading=Call("read_alias", call), writing=Call("write_alias", call))


def several(kind: str, start: int, count: int) -> Point:
    """Return inputs beside one another, as a list.

    Args:
        kind: ``analog`` or ``binary``.
    """
    names = [f"{kind}_input/{index}" for index in range(start, start + count)]

    def found(image: Image) -> list[object]:
        return [image["points"][name] for name in names]

    return Point(
        kind=INT32 if kind == "analog" else BOOL,
        reading=Call(f"read_{kind}", at(start, count)),
        pokes=lambda values: tuple({"point": name, "value": value} for name, value in zip(names, values, strict=True)),
        found=found,
        output="values",
    )
