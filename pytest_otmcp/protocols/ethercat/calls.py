"""What the device must have seen of a call that reads or writes one of the points."""

from __future__ import annotations

from ...core.finding import Finding
from ..exercise import Asked
from ..journal import Entries, Image
from . import oracle
from .points import content_of

__all__ = ["one_write", "reached", "was_read"]


def was_read(entries: Entries, image: Image, asked: Asked) -> list[Finding]:
    """Expect that a slave was asked for an object, or for its inputs."""
    if asked.operation == "read_inputs":
        return oracle.inputs_were_read(entries, slave=asked.inputs["slave"])
    place = {name: asked.inputs[name] for name in ("slave", "index", "subindex")}
    return oracle.object_was_read(entries, **place)


def one_write(entries: Entries, image: Image, asked: Asked) -> list[Finding]:
    """Expect that a slave got the value of an object, or outputs, once."""
    sent = asked.inputs
    if asked.operation == "write_outputs":
        return oracle.one_write_of_outputs(entries, slave=sent["slave"], outputs=bytes(sent["data"]))
    place = {name: sent[name] for name in ("slave", "index", "subindex")}
    return oracle.one_write_of_object(
        entries, **place, data=content_of(sent["type"], sent["value"]), is_text=sent["type"] == "STRING"
    )


def reached(entries: Entries, image: Image, asked: Asked) -> bool:
    """Tell whether requests for what a call reads reached the device."""
    return not was_read(entries, image, asked)
