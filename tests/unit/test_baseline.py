"""What is new since an earlier run is said by rule, and nothing is called mended that was not asked again."""

from __future__ import annotations

from typing import Any

import pytest

from pytest_otmcp.report.baseline import Baseline, since

from .samples import run, written_twice
from .test_latex import ALL

BROKEN = ("WR-003", "Modbus")


@pytest.mark.parametrize(
    ("before", "now", "said"),
    [
        ({}, [], "nothing has changed"),
        ({}, [written_twice()], "1 new (WR-003 Modbus)"),
        ({BROKEN: ("M3",)}, [written_twice()], "nothing has changed"),
        ({("RD-001", "Modbus"): ("M1",)}, ALL, "1 mended (RD-001 Modbus)"),
        ({("RD-001", "Modbus"): ("M1", "WR-003.modbus")}, ALL, "1 not asked again (RD-001 Modbus)"),
        ({(f"ADR-00{n}", "MQTT"): ("none",) for n in range(7)}, [], "7 not asked again (ADR-000 MQTT, ADR-001 MQTT, ADR-002 MQTT, "
         "ADR-003 MQTT, ADR-004 MQTT, 2 more)"),
    ],
)  # fmt: skip
def test_a_rule_is_new_mended_or_not_asked_again(
    before: dict[tuple[str, str], tuple[str, ...]], now: list[Any], said: str
) -> None:
    assert since(Baseline(before), run(now)) == f"since the baseline {said}"
