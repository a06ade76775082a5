"""What the device must have seen of a call that reads or writes one of the points."""

from __future__ import annotations

from ...core.finding import Finding
from ..exercise import Asked
from ..journal import Entries, Image
from . import oracle
from .points import elements

__all__ = ["one_write", "reached", "was_read"]


def _tags_of(asked: Asked) -> list[str]:
    """Return the names of the values that a call reads."""
    name = str(asked.inputs["tag"])
    if "count" not in asked.inputs:
        return [name]
    return elements(0, asked.inputs["count"], name.removesuffix("[0]"))


def was_read(entries: Entries, image: Image, asked: Asked) -> list[Finding]:
    """Expect that the controller was asked for the values that a call reads."""
    return oracle.read_from_device(entries, image, _tags_of(asked))


def one_write(entries: Entries, image: Image, asked: Asked) -> list[Finding]:
    """Expect that the controller saw the one write of a call."""
    inputs = asked.inputs
    return oracle.exactly_one_write(entries, image, inputs["tag"], inputs["type"], inputs["value"])


def reached(entries: Entries, image: Image, asked: Asked) -> bool:
    """Tell whether requests for what a call reads reached the device."""
    return oracle.reached(entries, image, _tags_of(asked))
