"""A fault that the warm-up and a repetition both show is found once, in the repetition."""

from __future__ import annotations

import pytest

from pytest_otmcp.core.finding import kind_of
from pytest_otmcp.report.findings import faults

from .conftest import Judge


@pytest.mark.parametrize(
    ("defect", "task"), [("wrong-value", "M2"), ("truncates-overflow", "FM2"), ("lying-guard", "M4")]
)
def test_a_fault_that_a_repetition_repeats_is_not_said_of_the_warm_up_too(judge: Judge, defect: str, task: str) -> None:
    item = judge("modbus", "defective.py", defect, tasks=task)[task]
    assert item["status"] == "FAIL"
    assert item["around"][0]["role"] == "warmup"
    repeated = {
        kind_of(found["code"], found["requirement"], found["message"]) for found in item["samples"][0]["findings"]
    }
    own = [
        kind_of(found["code"], found["requirement"], found["message"].removeprefix("warmup: "))
        for found in item["findings"]
    ]
    assert repeated
    assert not repeated & set(own)
    assert len(faults(item)) == len(repeated) + len(set(own))


def test_a_fault_that_only_the_warm_up_can_show_is_kept(judge: Judge) -> None:
    # The value that was cut down is there already when the repetition begins.
    item = judge("modbus", "defective.py", "truncates-overflow", tasks="FM2")["FM2"]
    assert "warmup: 1/holding_registers/1 should hold 30, the device holds 4464" in [
        found["message"] for found in item["findings"]
    ]
