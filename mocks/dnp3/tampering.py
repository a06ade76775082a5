"""What a fault rule makes of a right answer."""

from __future__ import annotations

from dataclasses import replace

from pytest_otmcp.wire.dnp3.objects import INDEX8, INDEX16, START_STOP8, START_STOP16

from .faults import Rule
from .outstation import Answer

__all__ = ["altered", "falsified"]


def altered(rule: Rule, raw: bytes) -> bytes:
    """Return the bytes of a frame with the length that a rule makes of the right one."""
    return raw[:2] + bytes([(raw[2] + rule.length) & 0xFF]) + raw[3:]


def falsified(rule: Rule, answer: Answer) -> Answer:
    """Return the answer that a rule makes of a right one."""
    objects = answer.objects if rule.answer_objects is None else rule.answer_objects
    if rule.answer_index and len(objects) > 5:
        changed = bytearray(objects)
        # Where the first header has its indexes: both ends of a range, or before its first object.
        places = {START_STOP8: (3, 4), START_STOP16: (3, 5), INDEX8: (4,), INDEX16: (5,)}.get(objects[2], ())
        for place in places:
            changed[place] = (changed[place] + rule.answer_index) & 0xFF
        objects = bytes(changed)
    return replace(answer, sequence=(answer.sequence + rule.sequence) & 0x0F, objects=objects)
