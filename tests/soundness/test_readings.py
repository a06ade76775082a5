"""Adapters that read under names of their own: honest ones are accused of nothing, each lie is found by what the device holds."""

from __future__ import annotations

import pytest

from .conftest import Judge, failing, passing, requirements, words
from .test_commands import accused_of_nothing, on

HONEST = {
    "opcua-brewery": ("RD-004 RD-008 REC-001 TMO-001", "O1 S3 S9 S12 R-opcua"),
    "modbus-tank": ("RD-004 RD-008 REC-001 TMO-001", "M2 S1 S7 S10 R-modbus"),
}
"""Each with rows of the requirement suite that it must pass, and all items of the benchmark that it passes."""

LIES = {
    ("opcua-brewery", "one-for-another"),
    ("opcua-brewery", "clamped"),
    ("opcua-brewery", "other-word"),
    ("opcua-brewery", "guesses-words"),
    ("opcua-brewery", "the-last-one"),
    ("opcua-brewery", "from-memory"),
    ("opcua-brewery", "any-quality"),
    ("modbus-tank", "another-scale"),
    ("modbus-tank", "neighbour"),
}
QUICK = {"clamped", "another-scale"}


@pytest.mark.parametrize("name", HONEST)
def test_an_honest_adapter_with_readings_of_its_own_passes_what_it_can_express(judge_foreign: Judge, name: str) -> None:
    results = judge_foreign(name, tasks=" ".join(on(name.partition("-")[0], "RD-004 RD-008")))
    assert passing(results) == results.keys(), words(results)


@pytest.mark.long
@pytest.mark.parametrize("name", HONEST)
def test_an_honest_adapter_with_readings_of_its_own_is_accused_of_nothing(judge_foreign: Judge, name: str) -> None:
    accused_of_nothing(judge_foreign, name, *HONEST[name])


@pytest.mark.parametrize(
    ("name", "lie"), [pytest.param(*lie, marks=() if lie[1] in QUICK else pytest.mark.long) for lie in sorted(LIES)]
)
def test_a_lie_about_a_reading_is_found(judge_foreign: Judge, name: str, lie: str) -> None:
    identifier = f"RD-008.{name.partition('-')[0]}"
    results = judge_foreign(name, lie=lie, tasks=identifier)
    assert failing(results) == {identifier}, words(results)
    assert requirements(results) == {"RD-008"}, words(results)


@pytest.mark.parametrize(
    "described",
    [
        ('means = "$value * 276.48"', 'means = "$value * 270"'),
        ("address = 30", "address = 31"),
        pytest.param(
            ('runs = true, "stands still" = false', 'runs = false, "stands still" = true'), marks=pytest.mark.long
        ),
    ],
)
def test_what_differs_from_the_subject_file_is_a_finding(judge_foreign: Judge, described: tuple[str, str]) -> None:
    assert failing(judge_foreign("modbus-tank", tasks="RD-008.modbus", described=described)) == {"RD-008.modbus"}


def test_what_a_reading_cannot_express_does_not_apply(judge_foreign: Judge) -> None:
    results = judge_foreign("modbus-tank", tasks="FM1 RD-001.modbus")
    assert {result["status"] for result in results.values()} == {"NOT_APPLICABLE"}, words(results)
    assert results["FM1"]["reason"] == (
        "the subject reads by named readings alone, and the item asks for read_holding with address=9999, count=1"
    )
