"""The verdict over every combination of statuses that matters."""

from __future__ import annotations

from itertools import combinations_with_replacement

import pytest

from pytest_otmcp.verdict import Status, Verdict, decide


@pytest.mark.parametrize("statuses", list(combinations_with_replacement(Status, 3)))
def test_the_worst_status_decides(statuses: tuple[Status, ...]) -> None:
    named = {str(index): status for index, status in enumerate(statuses)}
    verdict = decide(named, list(named))
    if Status.KIT_ERROR in statuses:
        assert verdict == Verdict.INDETERMINATE
    elif Status.FAIL in statuses or Status.NOT_TESTABLE in statuses:
        assert verdict == Verdict.NOT_CONFORMANT
    elif Status.INTERRUPTED in statuses:
        assert verdict == Verdict.INCOMPLETE
    elif set(statuses) == {Status.NOT_APPLICABLE}:
        assert verdict == Verdict.INDETERMINATE
    else:
        assert verdict == Verdict.CONFORMANT


def test_an_item_that_did_not_run_is_missed() -> None:
    assert decide({"a": Status.PASS}, ["a", "b"]) == Verdict.INCOMPLETE


def test_a_failure_is_a_failure_even_in_an_incomplete_run() -> None:
    assert decide({"a": Status.FAIL}, ["a", "b"]) == Verdict.NOT_CONFORMANT


def test_nothing_at_all_is_not_conformant() -> None:
    assert decide({}, []) == Verdict.INDETERMINATE
