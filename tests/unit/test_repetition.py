"""A check ends once it finds nothing new, and its long loops once its budget of time is used up."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.core.matrix import REQUIREMENTS
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.rig import EndedError

from .test_every_call import call

EQUAL = 5
BUDGET_S = 90


def repetition(*, is_check: bool = True, soak: bool = False, time_scale: float = 1.0) -> Repetition:
    return Repetition(
        "RES-003.modbus",
        0,
        "task",
        seed=0,
        time_scale=time_scale,
        rigs=(),
        soak=soak,
        suite=REQUIREMENTS if is_check else "normal",
    )


def wrong(value: int, **more: object) -> list[Finding]:
    return [Finding(code="wrong_value", message=f"values should be 7, they are {value}", **more)]  # type: ignore[arg-type]


def test_a_check_ends_with_the_fifth_finding_of_one_kind_and_notes_no_more() -> None:
    run = repetition()
    for value in range(1, EQUAL):
        run.witnessed(wrong(value))
    with pytest.raises(EndedError):
        run.witnessed(wrong(EQUAL), wrong(EQUAL + 1))
    assert len(run.ledger.findings) == EQUAL


def test_findings_of_different_kinds_and_warnings_end_no_check() -> None:
    run = repetition()
    for value in range(1, EQUAL):
        run.witnessed(wrong(value, requirement="RD-001"), wrong(value, requirement="WR-001"))
    for value in range(2 * EQUAL):
        run.witnessed(wrong(value, strength="SHOULD"))
    assert len(run.ledger.findings) == 2 * (EQUAL - 1) + 2 * EQUAL


def test_an_item_of_the_benchmark_makes_all_of_its_calls() -> None:
    run = repetition(is_check=False)
    for value in range(2 * EQUAL):
        run.witnessed(wrong(value))
    assert len(run.ledger.findings) == 2 * EQUAL


@pytest.mark.parametrize(
    ("seconds", "settings", "left"),
    [
        (BUDGET_S - 1, {}, True),
        (BUDGET_S, {}, False),
        (BUDGET_S, {"time_scale": 2.0}, True),
        (BUDGET_S - 1, {"time_scale": 0.4}, True),
        (100 * BUDGET_S, {"soak": True}, True),
    ],
)
def test_a_long_loop_goes_on_until_the_calls_have_used_up_the_budget(
    seconds: float, settings: dict[str, float], left: bool
) -> None:
    run = repetition(**settings)  # type: ignore[arg-type]
    assert run.has_time
    first = call()
    later = replace(first.reply.exchange, sent_ns=first.reply.exchange.sent_ns + int(seconds * 1e9))
    run.ledger.calls += [first, replace(first, reply=replace(first.reply, exchange=later))]
    assert run.has_time is left


def test_a_check_that_was_cut_short_says_what_it_did_and_fails_nothing() -> None:
    run = repetition()
    run.cut_short("RES-003", "14 of 100 reads")
    [found] = run.ledger.findings
    assert found.message.startswith("14 of 100 reads were made in the 90 s")
    assert not run.ledger.failed
