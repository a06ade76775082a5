"""What the device must have seen of a call that reads or writes one of the points."""

from __future__ import annotations

from ...core.finding import Finding
from ..exercise import Asked
from ..journal import Entries, Image
from . import oracle

__all__ = ["one_write", "reached", "was_read"]


def was_read(entries: Entries, image: Image, asked: Asked) -> list[Finding]:
    """Expect that a slave was asked for its inputs."""
    return oracle.inputs_were_read(entries, station=asked.inputs["slave"])


def one_write(entries: Entries, image: Image, asked: Asked) -> list[Finding]:
    """Expect that a slave got the outputs of a call."""
    return oracle.exactly_one_write(entries, station=asked.inputs["slave"], outputs=bytes(asked.inputs["data"]))


def reached(entries: Entries, image: Image, asked: Asked) -> bool:
    """Tell whether requests for what a call reads reached the device."""
    return not was_read(entries, image, asked)
