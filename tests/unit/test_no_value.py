"""An end of a type of whole numbers may be no value to a device; what is told then is no number."""

from __future__ import annotations

import pytest

from conformance.requirements.enc import _says_no_value


@pytest.mark.parametrize(
    ("told", "value", "kind", "is_one"),
    [
        ("Not available", 2**31 - 1, "int32", True),
        ("Not available", -(2**31), "int32", True),
        (None, 2**32 - 1, "uint32", True),
        ("n/a", 32767, "int16", True),
        ("Not available", -1, "int32", False),
        ("Not available", 0, "uint16", False),
        ("Not available", 1234567, "int32", False),
        ("n/a (65535)", 65535, "uint16", False),
        (0, 65535, "uint16", False),
        ("Not available", -2.0, "float32", False),
    ],
)
def test_no_number_at_an_end_of_a_type_says_that_there_is_no_value(
    told: object, value: float, kind: str, is_one: bool
) -> None:
    assert _says_no_value(told, value, kind) is is_one
