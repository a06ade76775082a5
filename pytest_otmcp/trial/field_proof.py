"""Proves that an adapter's session reads a real device, where no value can be set: three values that differ, each seen by two witnesses."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from ..core.errors import NoBindingError
from ..protocols.field import agrees
from ..protocols.journal import Image, JournalEntry
from ..protocols.registry import protocols
from .reply import Reply
from .subject_in_rig import SubjectInRig

__all__ = ["prove_by_reading"]

_READS = 3


class _Device(Protocol):
    async def image(self) -> dict[str, object]:
        """Return what the second client reads."""
        ...


class _Reader(Protocol):
    """An adapter at its real device, as far as this proof needs them."""

    protocol: str
    subject: SubjectInRig

    @property
    def device(self) -> _Device:
        """The real device."""

    def can_ask_first(self, operation: str, inputs: Mapping[str, object]) -> bool:
        """The subject says how to ask for this, before any other operation."""

    async def ask(self, operation: str, inputs: Mapping[str, object]) -> Reply:
        """Perform an operation that writes nothing."""

    async def journal(self) -> list[JournalEntry]:
        """Return what the tap has seen; every answer goes on where the one before ended."""


async def prove_by_reading(at: _Reader) -> tuple[str | None, str]:
    """Read three values that differ: the tap must see each request, and the second client must read the same value.

    Returns:
        The operation that read last, or None and the sentence that says why nothing may be written.

    Raises:
        NoBindingError: the subject has no operation that reads three such values.
    """
    field = protocols()[at.protocol].real
    assert field is not None, "a protocol without real devices has no items about them"
    before: Any = await at.device.image()
    reads = [
        one
        for one in field.reads(before, at.subject.claims)
        if len(one.points) == 1 and at.can_ask_first(one.operation, one.inputs)
    ]
    # Each value once, from whichever table.
    differing = list({str(list(one.points.values())): one for one in reversed(reads)}.values())[::-1][:_READS]
    if len(differing) < _READS:
        raise NoBindingError(
            f"{at.protocol}: nothing is written before reads of {_READS} values that differ have come through the adapter, and it "
            f"has operations for {len(differing)} of those that the device has"
        )
    for one in differing:
        seen = len(await at.journal())
        reply = await at.ask(one.operation, one.inputs)
        if field.was_read((await at.journal())[seen:], one):
            return None, f"the tap before the device saw no read of what {reply.label} asks for; nothing was written"
        after: Image = await at.device.image()
        ((point, value),) = one.points.items()
        now = _as_told(one.outputs, after["points"][point])
        # A value may move while it is read; then it is one of the two.
        if not any(_told(reply, outputs) for outputs in (one.outputs, now)):
            held = f"{point} = {value!r}"
            return None, f"{reply.label} does not say what the second client reads, {held}; nothing was written"
    return differing[-1].operation, ""


def _told(reply: Reply, outputs: Mapping[str, object]) -> bool:
    return bool(reply.success) and all(agrees(value, reply.outputs.get(name)) for name, value in outputs.items())


def _as_told(outputs: Mapping[str, object], new: object) -> Mapping[str, object]:
    """Return outputs as they are with another value in the place of the only one."""
    return {name: [new] if isinstance(told, list) else new for name, told in outputs.items()}
