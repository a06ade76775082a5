"""Whether an answer says a number, or a status code, in another of the forms that a text has for it."""

from __future__ import annotations

import random
import struct

import pytest

from conformance.requirements.opcua_values import further_types
from pytest_otmcp.protocols.modbus.registers import same_bits, unpacked


@pytest.mark.parametrize(
    ("value", "kind", "same"),
    [
        ("-739138300299672800000", "float32", True),
        ("-739138300299672900000", "float64", False),
        ("12", "float64", False),
        ("12345678901234567", "int64", False),
    ],
)
def test_a_float_that_a_text_says_by_all_its_digits_is_that_float(value: str, kind: str, same: bool) -> None:
    assert same_bits(value, unpacked(struct.pack(">f", -7.391383e20), "float32"), kind) is same


@pytest.mark.parametrize(
    "said", ["BadSensorFailure", "BadSensorFailure (0x808C0000)", 0x808C0000, {"code": 0x808C0000}]
)
def test_a_status_code_is_said_by_its_name_or_its_number(said: object) -> None:
    typed = next(one for one in further_types(random.Random(1)) if one.kind == "StatusCode")
    assert typed.same(said, typed.values[0])
    assert not typed.same("BadSensor", typed.values[0])
