"""What the device must have seen of a call that reads or writes one of the points."""

from __future__ import annotations

from ...core.finding import Finding
from ..exercise import Asked
from ..journal import Entries, Image
from . import oracle
from .points import NAMES

__all__ = ["one_write", "reached", "selected_write", "was_read"]


def was_read(entries: Entries, image: Image, asked: Asked) -> list[Finding]:
    """Expect that the outstation was asked for the points that a call reads."""
    inputs = asked.inputs
    if "name" in inputs:
        kind, index, _ = NAMES[inputs["name"]]
        return oracle.read_from_device(entries, kind, index)
    kind = f"{asked.operation.removeprefix('read_')}_input"
    return oracle.read_from_device(entries, kind, inputs["start"], inputs["count"])


def one_write(entries: Entries, image: Image, asked: Asked) -> list[Finding]:
    """Expect that the outstation saw the one command of a call."""
    inputs = asked.inputs
    if "name" in inputs:
        return oracle.exactly_one_operation(entries, "analog", NAMES[inputs["name"]][1], inputs["value"])
    return oracle.exactly_one_operation(entries, "binary", inputs["index"], inputs["value"])


def selected_write(entries: Entries, image: Image, asked: Asked) -> list[Finding]:
    """Expect that the outstation saw the one command of a call, which was selected before."""
    return [*one_write(entries, image, asked), *oracle.selected_first(entries)]


def reached(entries: Entries, image: Image, asked: Asked) -> bool:
    """Tell whether a request for the points that a call reads by their indexes reached the outstation."""
    kind = f"{asked.operation.removeprefix('read_')}_input"
    return oracle.reached(entries, kind, asked.inputs["start"], asked.inputs["count"])
