"""Defects that the device betrays in any call fail exactly the items in which they show, for the requirement that they break."""

from __future__ import annotations

import pytest

from .conftest import Judge, failing, requirements, words
from .defects_seen import DEFECTS

EVERY_MODBUS_ITEM = "M1 M2 M3 M4 X1 X2 X1p X2p FM1 FM2 FX1 S1 S4 S7 S10 R-modbus"

EXPECTED: dict[str, tuple[str, str]] = {}


@pytest.mark.parametrize("name", DEFECTS)
def test_a_defect_that_the_device_betrays_fails_exactly_its_items(judge: Judge, name: str) -> None:
    items, cited = EXPECTED[name]
    protocol, _ = DEFECTS[name]
    results = judge(protocol, "defects_seen.py", name)
    assert failing(results) == set(items.split()), words(results)
    assert requirements(results) == set(cited.split()), words(results)
