"""What the device must have seen of a call that reads or writes one of the points."""

from __future__ import annotations

from ...core.finding import Finding
from ..exercise import Asked
from ..journal import Entries, Image
from . import oracle
from .points import KINDS, content_of

__all__ = ["one_write", "reached", "was_read"]


def _bytes_of(asked: Asked) -> dict[str, int]:
    """Return which bytes a call reads."""
    inputs = asked.inputs
    size = inputs["size"] if "size" in inputs else KINDS[inputs["type"]].size
    return {"db": inputs["db"], "start": inputs["start"], "size": size}


def was_read(entries: Entries, image: Image, asked: Asked) -> list[Finding]:
    """Expect that the controller was asked for the bytes that a call reads."""
    return oracle.read_from_device(entries, **_bytes_of(asked))


def one_write(entries: Entries, image: Image, asked: Asked) -> list[Finding]:
    """Expect that the controller saw the one write of a call."""
    inputs = asked.inputs
    written = content_of(inputs["type"], inputs["value"])
    return oracle.exactly_one_write(entries, db=inputs["db"], start=inputs["start"], written=written)


def reached(entries: Entries, image: Image, asked: Asked) -> bool:
    """Tell whether requests for what a call reads reached the device."""
    return oracle.reached(entries, **_bytes_of(asked))
