"""What is new since an earlier run is said by rule, and nothing is called mended that was not shown again."""

from __future__ import annotations

from typing import Any

import pytest

from pytest_otmcp.report.baseline import Baseline, since
from pytest_otmcp.report.verdict_file import verdict

from .samples import run, written_twice
from .test_latex import ALL

BROKEN = ("WR-003", "Modbus")
EVERY = frozenset({"M1", "M3", "WR-003.modbus"})


@pytest.mark.parametrize(
    ("before", "now", "said"),
    [
        ({}, [], "nothing has changed"),
        ({}, [written_twice()], "1 new (WR-003 Modbus)"),
        ({BROKEN: ("M3",)}, [written_twice()], "nothing has changed"),
        ({("RD-001", "Modbus"): ("M1",)}, ALL, "1 mended (RD-001 Modbus)"),
        ({("RD-001", "Modbus"): ("M1", "WR-003.modbus")}, ALL, "1 not shown again (RD-001 Modbus)"),
        ({(f"ADR-00{n}", "MQTT"): ("none",) for n in range(7)}, [], "7 not shown again (ADR-000 MQTT, ADR-001 MQTT, ADR-002 MQTT, "
         "ADR-003 MQTT, ADR-004 MQTT, 2 more)"),
    ],
)  # fmt: skip
def test_a_rule_is_new_mended_or_not_shown_again(
    before: dict[tuple[str, str], tuple[str, ...]], now: list[Any], said: str
) -> None:
    ran = run(now)
    earlier = Baseline(before, EVERY, ran["subject"]["name"], ran["kit"]["suite_digest"])
    assert since(earlier, ran) == f"since the baseline {said}"


def test_a_rule_is_not_new_that_the_baseline_did_not_ask_for() -> None:
    ran = run([written_twice()])
    earlier = Baseline({}, frozenset({"M1"}), ran["subject"]["name"], ran["kit"]["suite_digest"])
    assert since(earlier, ran) == "since the baseline 1 not asked before (WR-003 Modbus)"


def test_a_baseline_of_another_adapter_or_suite_is_named() -> None:
    ran = run([written_twice()])
    assert since(Baseline({}, EVERY, "Acme", "sha256:0"), ran).startswith(
        "since the baseline (of Acme, by another version of the suite) 1 new"
    )


def test_a_program_reads_what_has_changed() -> None:
    ran = run([written_twice()])
    assert verdict(ran)["since"] is None
    earlier = Baseline({("RD-001", "Modbus"): ("M1",)}, EVERY, ran["subject"]["name"], "sha256:0")
    assert verdict(ran, earlier)["since"] == {
        "subject": ran["subject"]["name"],
        "suite_digest": "sha256:0",
        "new": [{"rule": "WR-003", "protocol": "Modbus"}],
        "not_asked_before": [],
        "mended": [],
        "not_shown_again": [{"rule": "RD-001", "protocol": "Modbus"}],
    }
