"""Defects that the device betrays in any call fail exactly the items in which they show, for the requirement that they break."""

from __future__ import annotations

import pytest

from .conftest import Judge, failing, requirements, words
from .defects_seen import DEFECTS

EVERY_MODBUS_ITEM = "M1 M2 M3 M4 X1 X2 X1p X2p FM1 FM2 FX1 S1 S4 S7 S10 R-modbus"

EXPECTED = {
    "MU-26": ("M4 FM2", "ENV-005"),
    "MU-29d": ("R-mqtt", "WR-010"),
    "MU-51": ("R-modbus", "MCP-002"),
    "demo": ("R-modbus", "ERR-001"),
    "MU-52r": ("M4", "MCP-009"),
    "MU-53a": ("M1", "MCP-008"),
    "MU-53h": ("M3 M4 X2 X2p FM2 S4 S10", "MCP-008"),
    "MU-53o": ("O2", "MCP-008"),
    "MU-59a": ("M1", "ENV-004"),
    "MU-59b": ("O1", "ENV-004"),
    "MU-60": (EVERY_MODBUS_ITEM, "ENV-006"),
    "MU-65": ("S11", "REC-004"),
    "MU-67a": ("Q2", "MQT-004"),
    "MU-76b": ("S11 R-mqtt", "SPB-006"),
    "MU-90": ("S7", "CON-006"),
    "MU-112": (EVERY_MODBUS_ITEM.removeprefix("M1 "), "MCP-003"),
    "MU-116w": (EVERY_MODBUS_ITEM, "ENV-007"),
    "MU-120": ("S10", "ERR-005"),
    "MU-124": (EVERY_MODBUS_ITEM, "ENC-007"),
}


@pytest.mark.parametrize("name", DEFECTS)
def test_a_defect_that_the_device_betrays_fails_exactly_its_items(judge: Judge, name: str) -> None:
    items, cited = EXPECTED[name]
    protocol, _ = DEFECTS[name]
    results = judge(protocol, "defects_seen.py", name)
    assert failing(results) == set(items.split()), words(results)
    assert requirements(results) == set(cited.split()), words(results)
