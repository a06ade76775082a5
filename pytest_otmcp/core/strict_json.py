"""Strict reading of JSON (RFC 8259, RFC 7493), which refuses every text that two readers could read differently, and
comparison of JSON values. Pure."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Mapping
from typing import Any

__all__ = ["Wide", "parse_strict", "same_json"]


def parse_strict(text: bytes | str) -> Any:
    """Read one JSON text by the rules of RFC 8259 and RFC 7493.

    Raises:
        ValueError: with one reason: not UTF-8, not JSON, NaN or Infinity, a number beyond doubles, a duplicate
            member name, a lone surrogate.
    """

    def refuse_constant(name: str) -> object:
        raise ValueError(f"{name} is no JSON number")

    def finite(digits: str) -> float:
        number = float(digits)
        if math.isinf(number):
            raise ValueError(f"{digits} is beyond the range of a double")
        return number

    def unique(pairs: list[tuple[str, object]]) -> dict[str, object]:
        members = dict(pairs)
        if len(members) != len(pairs):
            # An adapter may send a hundred thousand names: counting each of them among all others would take minutes.
            counts = Counter(name for name, _ in pairs)
            twice = next(name for name, number in counts.items() if number > 1)
            raise ValueError(f"the member {twice!r} occurs twice")
        return members

    if isinstance(text, bytes):
        try:
            text = text.decode("utf-8")
        except UnicodeDecodeError as error:
            raise ValueError(f"not UTF-8 at byte {error.start}") from None
    try:
        value = json.loads(text, parse_constant=refuse_constant, parse_float=finite, object_pairs_hook=unique)
    except json.JSONDecodeError as error:
        raise ValueError(f"{error.msg} at character {error.pos}") from None
    except RecursionError:
        raise ValueError("nested too deeply") from None
    if "\\ud" in text.lower():
        _refuse_surrogates(value)
    return value


def _refuse_surrogates(value: object) -> None:
    if isinstance(value, str) and any("\ud800" <= character <= "\udfff" for character in value):
        raise ValueError("a string holds a lone surrogate")
    if isinstance(value, Mapping):
        for name, member in value.items():
            _refuse_surrogates(name)
            _refuse_surrogates(member)
    elif isinstance(value, list):
        for member in value:
            _refuse_surrogates(member)


_ALL_WHOLE = 2.0**53
_DIGITS = re.compile(r"-?[0-9]{1,400}")


class Wide(int):
    """A whole number of a type of 64 bits: in JSON its decimal digits are as good (RFC 7493, section 2.2; OPC 10000-6, section 5.4.2.3)."""

    __slots__ = ()


def same_json(one: object, other: object) -> bool:
    """Tell whether two values are equal as JSON: ``1`` equals ``1.0``, but ``true`` is not ``1``. The first may be :class:`Wide`; of a float so
    large that it is whole all digits are as good, which is how JavaScript writes it into a text."""
    if isinstance(one, bool) or isinstance(other, bool):
        return one is other
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(same_json(one[name], other[name]) for name in one)
    if isinstance(one, list | tuple) and isinstance(other, list | tuple):
        return len(one) == len(other) and all(map(same_json, one, other))
    if isinstance(one, float) and isinstance(other, str):
        return abs(one) >= _ALL_WHOLE and _DIGITS.fullmatch(other) is not None and float(other) == one
    return bool(one == other) or (isinstance(one, Wide) and other == str(one))
