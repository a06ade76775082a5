"""The verdict over every combination of statuses of small sets of items: its value, and the laws that it obeys."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import date, timedelta
from itertools import chain, combinations, permutations, product

import pytest

from pytest_otmcp.core.verdict import ExitCode, Status, Verdict, decide, exit_code, judge_deviations
from pytest_otmcp.errors import UsageError

TODAY = date(2027, 3, 31)
YESTERDAY = TODAY - timedelta(days=1)
TOMORROW = TODAY + timedelta(days=1)

FAILURES = {Status.FAIL, Status.NOT_TESTABLE}
HARMLESS = {Status.PASS, Status.NOT_APPLICABLE}
BEST_FIRST = [Verdict.CONFORMANT, Verdict.INCOMPLETE, Verdict.NOT_CONFORMANT, Verdict.INDETERMINATE]
SET = ("a", "b", "c")

Statuses = dict[str, Status]


def runs(items: tuple[str, ...]) -> Iterator[Statuses]:
    """Yield every run over these items: each item has one of the statuses, or did not run."""
    for statuses in product([None, *Status], repeat=len(items)):
        yield {item: status for item, status in zip(items, statuses, strict=True) if status is not None}


def subsets(items: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    return chain.from_iterable(combinations(items, size) for size in range(len(items) + 1))


RUNS = list(runs(SET))
REQUIRED = list(subsets(SET))


def rank(verdict: Verdict) -> int:
    return BEST_FIRST.index(verdict)


def test_there_are_as_many_runs_as_there_should_be() -> None:
    assert len(RUNS) == (len(Status) + 1) ** len(SET) == 343
    assert set(BEST_FIRST) == set(Verdict)


@pytest.mark.parametrize("required", REQUIRED, ids=lambda required: "".join(required) or "none")
def test_the_verdict_is_what_the_rules_say(required: tuple[str, ...]) -> None:
    for statuses in RUNS:
        found = set(statuses.values())
        if Status.KIT_ERROR in found:
            expected = Verdict.INDETERMINATE
        elif found & FAILURES:
            expected = Verdict.NOT_CONFORMANT
        elif Status.INTERRUPTED in found or any(item not in statuses for item in required):
            expected = Verdict.INCOMPLETE
        elif Status.PASS in found:
            expected = Verdict.CONFORMANT
        else:
            expected = Verdict.INDETERMINATE
        assert decide(statuses, required) == expected, statuses


def test_conformant_is_exactly_a_complete_set_of_passes_of_which_there_is_one() -> None:
    for statuses, required in product(RUNS, REQUIRED):
        found = set(statuses.values())
        complete = set(required) <= statuses.keys()
        conformant = complete and found <= HARMLESS and Status.PASS in found
        assert (decide(statuses, required) == Verdict.CONFORMANT) == conformant, (statuses, required)


def test_the_order_of_items_does_not_matter() -> None:
    for statuses in RUNS:
        verdicts = {
            decide(dict(entries), order) for entries in permutations(statuses.items()) for order in (SET, SET[::-1])
        }
        assert len(verdicts) == 1, statuses


@pytest.mark.parametrize("worse", [status for status in Status if status != Status.PASS])
def test_a_pass_that_becomes_anything_else_never_improves_the_verdict(worse: Status) -> None:
    for statuses, required in product(RUNS, REQUIRED):
        before = rank(decide(statuses, required))
        for item in (name for name, status in statuses.items() if status == Status.PASS):
            assert rank(decide({**statuses, item: worse}, required)) >= before, (statuses, item)


@pytest.mark.parametrize(
    ("better", "worse"),
    [
        (Status.INTERRUPTED, Status.FAIL),
        (Status.INTERRUPTED, Status.NOT_TESTABLE),
        (Status.FAIL, Status.KIT_ERROR),
        (Status.NOT_TESTABLE, Status.KIT_ERROR),
    ],
)
def test_worse_statuses_never_improve_the_verdict(better: Status, worse: Status) -> None:
    for statuses, required in product(RUNS, REQUIRED):
        for item in (name for name, status in statuses.items() if status == better):
            assert rank(decide({**statuses, item: worse}, required)) >= rank(decide(statuses, required))


def test_an_item_that_is_claimed_but_not_testable_weighs_as_much_as_a_failure() -> None:
    for statuses, required in product(RUNS, REQUIRED):
        as_failure = {
            item: Status.FAIL if status == Status.NOT_TESTABLE else status for item, status in statuses.items()
        }
        assert decide(statuses, required) == decide(as_failure, required)


def test_what_does_not_run_never_helps() -> None:
    for statuses in RUNS:
        for missing in statuses:
            rest = {item: status for item, status in statuses.items() if item != missing}
            assert decide(rest, SET) != Verdict.CONFORMANT, f"although {missing} did not run"


def test_a_larger_set_never_improves_the_verdict() -> None:
    for statuses, required in product(RUNS, REQUIRED):
        for more in SET:
            verdict = decide(statuses, (*required, more))
            # That nothing applied is worse than that something is missing, and only a complete run can show it.
            if decide(statuses, required) != Verdict.INDETERMINATE:
                assert rank(verdict) >= rank(decide(statuses, required))
            if verdict == Verdict.CONFORMANT:
                assert decide(statuses, required) == Verdict.CONFORMANT


def test_an_item_that_does_not_apply_changes_nothing() -> None:
    for statuses, required in product(RUNS, REQUIRED):
        more = {**statuses, "d": Status.NOT_APPLICABLE}
        assert decide(more, (*required, "d")) == decide(statuses, required)


def test_nothing_at_all_is_not_conformant() -> None:
    assert decide({}, []) == Verdict.INDETERMINATE
    assert decide({}, ["a"]) == Verdict.INCOMPLETE


# -- deviations and exit codes --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Known:
    item: str
    expires: date


PAIR = ("a", "b")
DEVIATIONS = [
    [Known(item, expires) for item, expires in zip(PAIR, days, strict=True) if expires is not None]
    for days in product([None, YESTERDAY, TODAY, TOMORROW], repeat=2)
]
CASES = list(product(runs(SET[:3]), DEVIATIONS))


def excused(statuses: Mapping[str, Status], known: list[Known], today: date = TODAY) -> ExitCode:
    return exit_code(decide(statuses, SET), judge_deviations(known, statuses, SET, today))


def test_without_deviations_the_exit_code_is_the_verdicts() -> None:
    codes = {verdict: exit_code(verdict) for verdict in Verdict}
    assert codes == {
        Verdict.CONFORMANT: 0,
        Verdict.NOT_CONFORMANT: 1,
        Verdict.INCOMPLETE: 1,
        Verdict.INDETERMINATE: 3,
    }
    for statuses in RUNS:
        assert excused(statuses, []) == codes[decide(statuses, SET)]


def test_the_exit_code_is_green_exactly_when_every_failure_is_excused_and_the_rest_passed() -> None:
    for statuses, known in CASES:
        open_until = {deviation.item: deviation.expires for deviation in known}
        failing = {item for item, status in statuses.items() if status in FAILURES}
        green = (
            statuses.keys() == set(SET)
            and set(statuses.values()) <= HARMLESS | FAILURES
            and Status.PASS in statuses.values()
            and failing == open_until.keys()
            and all(expires >= TODAY for expires in open_until.values())
        )
        assert (excused(statuses, known) == 0) == green, (statuses, known)


def test_a_deviation_never_changes_the_verdict_only_the_exit_code() -> None:
    statuses = {"a": Status.FAIL, "b": Status.PASS, "c": Status.PASS}
    report = judge_deviations([Known("a", TODAY)], statuses, SET, TODAY)
    assert decide(statuses, SET) == Verdict.NOT_CONFORMANT
    assert report.as_record() == {"used": ["a"], "stale": [], "expired": []}
    assert exit_code(Verdict.NOT_CONFORMANT, report) == 0


def test_a_deviation_is_used_stale_expired_or_none_of_them() -> None:
    for statuses, known in CASES:
        report = judge_deviations(known, statuses, SET, TODAY)
        named = {deviation.item: deviation for deviation in known}
        assert set(report.stale) == {item for item in named if statuses.get(item) in HARMLESS}
        assert set(report.expired) == {
            item for item in named if named[item].expires < TODAY and item not in report.stale
        }
        assert set(report.used) == {
            item for item in named if statuses.get(item) in FAILURES and item not in report.expired
        }


def test_a_stale_or_expired_deviation_is_never_green() -> None:
    for statuses, known in CASES:
        report = judge_deviations(known, statuses, SET, TODAY)
        if report.stale or report.expired:
            assert excused(statuses, known) != 0
            assert not report.sound


def test_a_fault_of_the_kit_is_its_exit_code_whatever_is_excused() -> None:
    for statuses, known in CASES:
        if Status.KIT_ERROR in statuses.values():
            assert excused(statuses, known) == 3


def test_time_only_takes_excuses_away() -> None:
    for statuses, known in CASES:
        if excused(statuses, known, TOMORROW) == 0:
            assert excused(statuses, known, TODAY) == 0


def test_the_order_of_deviations_does_not_matter() -> None:
    for statuses, known in CASES:
        assert judge_deviations(known, statuses, SET, TODAY) == judge_deviations(known[::-1], statuses, SET, TODAY)


def test_of_two_deviations_for_one_item_the_one_that_expired_counts() -> None:
    statuses = {"a": Status.FAIL, "b": Status.PASS, "c": Status.PASS}
    report = judge_deviations([Known("a", TOMORROW), Known("a", YESTERDAY)], statuses, SET, TODAY)
    assert (report.used, report.expired) == ((), ("a",))


def test_what_excuses_everything_leaves_no_evidence() -> None:
    statuses = {"a": Status.FAIL, "b": Status.NOT_APPLICABLE, "c": Status.FAIL}
    known = [Known("a", TODAY), Known("c", TODAY)]
    assert excused(statuses, known) == 1


def test_an_excused_failure_in_a_set_that_is_not_complete_is_not_green() -> None:
    assert excused({"a": Status.FAIL, "b": Status.PASS}, [Known("a", TODAY)]) == 1


def test_a_deviation_whose_item_did_not_run_is_neither_used_nor_stale() -> None:
    report = judge_deviations([Known("c", TODAY)], {"a": Status.PASS}, SET, TODAY)
    assert report.as_record() == {"used": [], "stale": [], "expired": []}


@pytest.mark.parametrize(
    ("item", "hint"),
    [("FQ9", "did you mean 'FQ2'"), ("everything", "remove the deviation")],
)
def test_a_deviation_of_an_unknown_item_is_the_users_mistake(item: str, hint: str) -> None:
    with pytest.raises(UsageError, match=f"there is no item '{item}' in the suite; {hint}"):
        judge_deviations([Known(item, TODAY)], {}, ["FQ2", "M1"], TODAY)


def test_a_run_in_which_nothing_applied_is_a_matter_of_the_subject_file() -> None:
    statuses = {"A": Status.NOT_APPLICABLE, "B": Status.NOT_APPLICABLE}
    verdict = decide(statuses, statuses)
    assert verdict == Verdict.INDETERMINATE
    assert exit_code(verdict, statuses=statuses.values()) == ExitCode.USAGE
    assert exit_code(verdict, statuses=[*statuses.values(), Status.KIT_ERROR]) == ExitCode.INDETERMINATE
