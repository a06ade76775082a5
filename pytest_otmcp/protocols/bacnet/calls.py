"""What the device must have seen of a call that reads or writes one of the points."""

from __future__ import annotations

from ...core.finding import Finding
from ..exercise import Asked
from ..journal import Entries, Image
from . import oracle
from .entries import Target

__all__ = ["at_its_priority", "one_write", "reached", "was_read"]


def _target_of(asked: Asked) -> Target:
    """Return the object that a call is about."""
    return str(asked.inputs["type"]), int(asked.inputs["instance"])


def was_read(entries: Entries, image: Image, asked: Asked) -> list[Finding]:
    """Expect that the device was asked for the present value that a call reads."""
    return oracle.read_from_device(entries, _target_of(asked))


def one_write(entries: Entries, image: Image, asked: Asked) -> list[Finding]:
    """Expect that the device saw the one write of a call, at whichever priority."""
    return oracle.exactly_one_write(entries, _target_of(asked), "real", asked.inputs["value"])


def at_its_priority(entries: Entries, image: Image, asked: Asked) -> list[Finding]:
    """Expect that the device saw the one write of a call, at the priority that was asked for."""
    value, priority = asked.inputs["value"], asked.inputs["priority"]
    kind = "null" if value is None else "real"
    return oracle.exactly_one_write(entries, _target_of(asked), kind, value, priority=priority)


def reached(entries: Entries, image: Image, asked: Asked) -> bool:
    """Tell whether requests for what a call reads reached the device."""
    return oracle.reached(entries, _target_of(asked))
