"""The kill matrix: what counts as noticed, what the exit code says, and which defects a name means."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
from pytest_otmcp.reference_adapters.defects.listing import listing

from pytest_otmcp.core.errors import UsageError
from pytest_otmcp.core.verdict import ExitCode
from pytest_otmcp.soundness.defect import Declared, Defect, chosen, read
from pytest_otmcp.soundness.kill_matrix import KillMatrix, Outcome
from pytest_otmcp.soundness.seen import Seen
from pytest_otmcp.suite.requirements import requirements

KNOWN = read(listing())
LAX, UNKNOWN_ARGUMENT = (next(one for one in KNOWN.defects if one.id == name) for name in ("MU-12", "MU-13"))
CHECKS = {item: item.partition(".")[0] for item in (*LAX.items, *UNKNOWN_ARGUMENT.items)}


def as_declared(defect: Defect) -> Outcome:
    seen = Seen(
        items=frozenset(defect.items), requirements=frozenset(defect.requirements), faults=(), words=("M1: a finding",)
    )
    return Outcome(defect=defect, seen=seen, seconds=1.0)


def changed(outcome: Outcome, **seen: object) -> Outcome:
    return replace(outcome, seen=replace(outcome.seen, **seen))  # type: ignore[arg-type]


def matrix(*outcomes: Outcome, declared: Declared = KNOWN) -> KillMatrix:
    return KillMatrix(declared=declared, outcomes=outcomes, checks=CHECKS, rows=requirements())


def test_defects_that_exactly_their_items_notice_are_as_expected() -> None:
    found = matrix(as_declared(LAX), as_declared(UNKNOWN_ARGUMENT))
    assert found.exit_code == ExitCode.CONFORMANT
    assert found.shown == {"MU-12", "MU-13"}
    assert found.killed == found.musts == {"MCP-004", "MCP-005"}
    assert [one.word for one in found.outcomes] == ["noticed", "noticed"]


@pytest.mark.parametrize(
    ("seen", "word", "code"),
    [
        ({"items": frozenset(), "requirements": frozenset()}, "NOT NOTICED", ExitCode.NOT_CONFORMANT),
        ({"items": frozenset({*UNKNOWN_ARGUMENT.items, "M1"})}, "OTHERWISE", ExitCode.NOT_CONFORMANT),
        ({"requirements": frozenset({"WR-003"})}, "OTHERWISE", ExitCode.NOT_CONFORMANT),
        ({"faults": ("M1: the mock device has ended",)}, "NOT JUDGED", ExitCode.INDETERMINATE),
    ],
)
def test_whatever_is_seen_otherwise_is_named_and_decides_the_exit_code(
    seen: dict[str, object], word: str, code: ExitCode
) -> None:
    found = matrix(as_declared(LAX), changed(as_declared(UNKNOWN_ARGUMENT), **seen))
    assert found.exit_code == code
    assert [one.defect.id for one in found.unexpected] == ["MU-13"]
    assert found.unexpected[0].word == word
    assert found.killed == {"MCP-005"}
    assert found.shown == {"MU-12"}


def test_a_defect_with_a_variant_that_is_not_noticed_is_not_shown() -> None:
    variant = replace(LAX, id="MU-12x")
    found = matrix(as_declared(LAX), changed(as_declared(variant), items=frozenset()))
    assert found.shown == set()


def test_a_whole_run_in_which_no_defect_fails_the_check_of_a_must_is_not_as_expected() -> None:
    declared = replace(KNOWN, defects=(LAX,))
    found = matrix(as_declared(LAX), declared=declared)
    assert found.is_whole
    assert found.musts - found.killed == {"MCP-004"}
    assert found.exit_code == ExitCode.NOT_CONFORMANT


def test_the_document_says_what_the_matrix_says() -> None:
    document = matrix(as_declared(LAX), changed(as_declared(UNKNOWN_ARGUMENT), items=frozenset())).as_document()
    assert document["unexpected"] == ["MU-13"]
    assert document["musts_not_killed"] == ["MCP-004"]
    assert document["totals"]["run"] == 2
    assert document["totals"]["noticed_as_expected"] == 1
    assert document["totals"]["catalogue"] == KNOWN.total
    assert document["defects"][0]["findings"] == ["M1: a finding"]
    assert document["exit_code"] == ExitCode.NOT_CONFORMANT
    assert {one["id"] for one in document["not_noticed_yet"]} == {one.id for one in KNOWN.unnoticed}


def test_the_sample_has_defects_of_the_benchmark_and_of_every_area() -> None:
    sample = [one for one in KNOWN.defects if one.sample]
    assert {one.areas for one in sample} == {one.areas for one in KNOWN.defects}
    assert len(sample) < len(KNOWN.defects) / 10


@pytest.mark.parametrize(
    ("names", "ids"),
    [
        (["mu-13"], {"MU-13"}),
        (["MU-12"], {one.id for one in KNOWN.defects if re.fullmatch("MU-12[a-z]*", one.id)}),
        (["MU-12q", "MU-13"], {"MU-12q", "MU-13"}),
        (["RES"], {one.id for one in KNOWN.defects if one.areas == ("res",)}),
        (["benchmark"], {one.id for one in KNOWN.defects if not one.areas}),
    ],
)
def test_a_name_is_an_id_an_id_without_its_letter_or_an_area(names: list[str], ids: set[str]) -> None:
    assert {one.id for one in chosen(KNOWN.defects, names)} == ids


def test_a_name_that_means_no_defect_ends_in_a_sentence_that_says_which_there_are() -> None:
    with pytest.raises(
        UsageError, match=r"no defect and no area 'MU-139': expected an id such as MU-01 .* benchmark adr"
    ):
        chosen(KNOWN.defects, ["MU-13", "MU-139"])
