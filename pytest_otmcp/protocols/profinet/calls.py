"""What the device must have seen of a call that reads or writes one of the points."""

from __future__ import annotations

from ...core.finding import Finding
from ..exercise import Asked
from ..journal import Entries, Image
from . import oracle

__all__ = ["one_write", "reached", "was_read"]


def was_read(entries: Entries, image: Image, asked: Asked) -> list[Finding]:
    """Expect that the device was asked for the inputs of a subslot, or for a record."""
    place = asked.inputs["slot"], asked.inputs["subslot"]
    if asked.operation == "read_inputs":
        return oracle.inputs_were_read(entries, place)
    return oracle.record_was_read(entries, place, asked.inputs["index"])


def one_write(entries: Entries, image: Image, asked: Asked) -> list[Finding]:
    """Expect that the device got the outputs, or the record, of a call."""
    place = asked.inputs["slot"], asked.inputs["subslot"]
    content = bytes(asked.inputs["data"])
    if asked.operation == "write_outputs":
        return oracle.outputs_written_once(entries, place, content)
    return oracle.record_written_once(entries, place, asked.inputs["index"], content)


def reached(entries: Entries, image: Image, asked: Asked) -> bool:
    """Tell whether requests for what a call reads reached the device."""
    return not was_read(entries, image, asked)
