"""A fault that the warm-up and a repetition both show is found once, in the repetition."""

from __future__ import annotations

import pytest

from pytest_otmcp.core.finding import kind_of

from .conftest import DEFECT, Judge


@pytest.mark.parametrize(
    ("program", "defect", "task"),
    [
        (("defective.py",), "wrong-value", "M2"),
        (DEFECT, "MU-08", "FM2"),
        (DEFECT, "MU-20", "M4"),
    ],
)
def test_a_fault_that_a_repetition_repeats_is_not_said_of_the_warm_up_too(
    judge: Judge, program: tuple[str, ...], defect: str, task: str
) -> None:
    item = judge("modbus", *program, defect, tasks=task)[task]
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


def test_a_fault_that_only_the_warm_up_can_show_is_kept(judge: Judge) -> None:
    item = judge("modbus", "defective.py", "wrong-at-first", tasks="M2")["M2"]
    assert [sample["ok"] for sample in item["samples"]] == [True]
    (finding,) = item["findings"]
    assert finding["message"].startswith("warmup: read_input_registers(address=0, count=4): values should be")
