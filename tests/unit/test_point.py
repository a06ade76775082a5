"""The types of values and the points: bounds that a type has just so, values that tell types apart, calls with their good answers."""

from __future__ import annotations

import random
import struct

import pytest

from pytest_otmcp.protocols.point import (
    FLOAT32,
    FLOAT64,
    INT8,
    INT16,
    INT32,
    INT64,
    UINT8,
    UINT16,
    UINT32,
    UINT64,
    Kind,
    Point,
    different_bytes,
)
from pytest_otmcp.protocols.proof import Call

WHOLE = (INT8, INT16, INT32, INT64, UINT8, UINT16, UINT32, UINT64)


def point(kind: Kind) -> Point:
    return Point(kind=kind, reading=Call("read"), writing=Call("write"), held=lambda value: {"a": value})


@pytest.mark.parametrize("kind", [*WHOLE, FLOAT32], ids=lambda kind: kind.form)
def test_the_bounds_of_a_type_fit_and_the_values_beyond_do_not(kind: Kind) -> None:
    for asked, beyond in point(kind).bounds():
        assert struct.pack(f">{kind.form}", asked.inputs["value"])
        with pytest.raises((struct.error, OverflowError)):
            struct.pack(f">{kind.form}", beyond)


@pytest.mark.parametrize("kind", [*WHOLE, FLOAT32, FLOAT64], ids=lambda kind: kind.form)
def test_a_telling_value_is_another_one_with_another_sign(kind: Kind) -> None:
    rng = random.Random(1)
    for _ in range(100):
        value = kind.telling(rng)
        content = struct.pack(f">{kind.form}", value)
        assert struct.unpack(f">{kind.form}", content) == (value,)
        if kind.is_whole:
            assert struct.unpack(f">{kind.form.swapcase()}", content) != (value,)


def test_no_mixture_of_values_with_different_bytes_is_one_of_them() -> None:
    values = [value.to_bytes(4, "big", signed=True) for value in different_bytes(random.Random(1), ">i")]
    assert all(len({content[place] for content in values}) == 3 for place in range(4))


def test_a_proof_takes_the_value_and_no_other_for_one_that_came_through() -> None:
    way = point(INT32).way(INT32.any, bits=32)
    question = way.ask(random.Random(1))
    value = INT32.any(random.Random(1))
    assert [question.bits({"value": found}, []) for found in (value, [value], value + 1, True, None)] == [
        32,
        32,
        0,
        0,
        0,
    ]
