"""Numbers that JSON does not have, or that some of its readers would round."""

from __future__ import annotations

import math
from typing import TypeVar

__all__ = ["EXACT_IN_JSON", "exact_in_json", "special_name"]

EXACT_IN_JSON = 2**53 - 1
"""Integers beyond this may be rounded by JSON readers that only have doubles (RFC 7493, section 2.2)."""

_Value = TypeVar("_Value")


def exact_in_json(value: _Value) -> _Value | str:
    """Return a value as an answer says it: a whole number that some readers would round as its digits, anything else as it is."""
    return str(value) if isinstance(value, int) and abs(value) > EXACT_IN_JSON else value


def special_name(number: float) -> str | None:
    """Return NaN, Infinity or -Infinity; None for a finite number, which JSON has."""
    if math.isfinite(number):
        return None
    return "NaN" if math.isnan(number) else "Infinity" if number > 0 else "-Infinity"
