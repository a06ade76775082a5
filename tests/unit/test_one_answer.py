"""Every place that tells of a run says the same verdict, level and counts; thirty records are rendered everywhere and compared."""

from __future__ import annotations

import json
import lzma
import re
from collections.abc import Callable, Iterator
from html import unescape
from pathlib import Path
from typing import Any, cast

import pytest

from pytest_otmcp.certificate.badge import badge
from pytest_otmcp.certificate.statement import certificate
from pytest_otmcp.cli.examination import _said
from pytest_otmcp.core.matrix import REQUIREMENTS, SUITES
from pytest_otmcp.core.verdict import Status, decide
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.record.condensed import condensed
from pytest_otmcp.record.reader import open_record
from pytest_otmcp.record.schema import Run
from pytest_otmcp.report import console, markdown
from pytest_otmcp.report.certificate_page import certificate_page
from pytest_otmcp.report.comparison import compared
from pytest_otmcp.report.html import page
from pytest_otmcp.report.overview import requirements as requirement_rows
from pytest_otmcp.report.verdict_file import properties, verdict
from pytest_otmcp.suite.catalogue import tasks_by_id
from pytest_otmcp.suite.requirements import requirements
from tests.golden.files import path_of

from .certified import adapter, conformant_run

FIELD = Path(__file__).parents[2] / "docs" / "field-report"
GOLDEN = {
    "honest": (
        "reference-modbus",
        "reference-mqtt",
        "reference-together",
        "reference-named",
        "honest-modbus-split-reads",
        "honest-mcp-no-text-block",
        "honest-opcua-writes-a-timestamp",
        "honest-s7-bytes-in-parts",
        "foreign-mqtt-connect",
    ),
    "lying": (
        "defect-MU-14p",
        "defect-MU-14dnp",
        "defect-MU-02n",
        "defect-MU-08ei",
        "defect-MU-33o",
        "defect-MU-51",
        "defect-MU-52r",
        "defect-MU-72",
        "defect-MU-117",
        "foreign-modbus-prose-demo-mode",
    ),
}
SMALL_FIELD_RECORDS = 4
FAST = 3
"""Records of a kind that are rendered in the fast lane."""


def golden(name: str) -> Run:
    """Return a stored record as a run of its items alone would have ended."""
    with open_record(path_of(name), compressed=True) as stored:
        run = condensed(stored)
    statuses = {item["id"]: Status(item["status"]) for item in run["items"]}
    run["footer"] |= {"verdict": str(decide(statuses, statuses)), "complete": True, "reason": None}  # type: ignore[typeddict-item]
    return run


def altered(change: Callable[[Any], object]) -> Run:
    run = conformant_run()
    change(run)
    statuses = {item["id"]: Status(item["status"]) for item in run["items"]}
    run["footer"]["verdict"] = str(decide(statuses, tasks_by_id(run["subject"]["adapters"], SUITES)))
    return cast(Run, run)


def _failing(run: Any, identifier: str) -> None:
    (item,) = (item for item in run["items"] if item["id"] == identifier)
    item["status"] = "FAIL"
    finding = {"code": "wrong_value", "message": "values differ", "requirement": "RD-001", "evidence": None}
    item["samples"][0] |= {"ok": False, "findings": [finding | {"strength": "MUST", "cause": None}]}


ALTERED: dict[str, Callable[[Any], object]] = {
    "complete": lambda run: None,
    "N = 1": lambda run: run["settings"].update(reps=1),
    "a wall is missing": lambda run: run["environment"].update(walls={"files": "refused"}),
    "narrowed": lambda run: run["settings"].update(narrowed=["a conftest replaced something"]),
    "interrupted": lambda run: run.update(items=run["items"][:20]),
    "one suite": lambda run: run.update(items=[one for one in run["items"] if one["suite"] == "normal"]),
    "parallel": lambda run: run["footer"].update(timing_valid=False),
    "one item fails": lambda run: _failing(run, "M2"),
    "one row fails": lambda run: _failing(run, "RD-001.modbus"),
    "a fault of the kit": lambda run: run["items"][3].update(status="KIT_ERROR"),
    "cannot be tested": lambda run: run["items"][3].update(status="NOT_TESTABLE", reason="nothing is bound"),
    "no requirement suite": lambda run: (
        run["settings"].update(suites=["normal", "fault", "stress", "recovery"]),
        run.update(items=[one for one in run["items"] if one["suite"] != REQUIREMENTS]),
    ),
}


def field_records() -> list[Path]:
    return sorted(FIELD.glob("*.xz"), key=lambda path: path.stat().st_size)[:SMALL_FIELD_RECORDS]


def field(path: Path, directory: Path) -> Run:
    (directory / "run.json").write_bytes(lzma.decompress(path.read_bytes()))
    with open_record(directory / "run.json", allow_incomplete=True) as stored:
        return condensed(stored)


Said = tuple[str, str, int, int]
"""Verdict, levels in words, items that passed, and of how many."""

_COUNT = r"(\d+) of (\d+) (?:[\w /-]+ )?items?"


def counts_in(text: str) -> tuple[int, int]:
    found = re.search(_COUNT, text)
    assert found is not None, text
    return int(found[1]), int(found[2])


def words(html: str) -> str:
    return " ".join(unescape(re.sub(r"<[^>]+>", " ", html)).split())


def answers(run: Run) -> Iterator[tuple[str, Said]]:
    """Yield every place with what it says."""
    told = verdict(run)
    named = [(protocols()[key].name, level or "no level") for key, level in told["levels"].items()]
    named = [(name, level if level == "no level" else level.capitalize()) for name, level in named]
    levels = named[0][1] if len(named) == 1 else ", ".join(map(" ".join, sorted(named)))
    items = told["items"].values()
    yield (
        "verdict.json",
        (told["verdict"], levels, sum(one["passed"] for one in items), sum(one["of"] for one in items)),
    )

    line = console.summary(run)[-1][0]
    found = re.fullmatch(rf"VERDICT: ([A-Z ]+) \({_COUNT} passed(.*?); \d+/\d+ runs passed.*\)", line)
    assert found is not None, line
    yield "terminal", (found[1], _level(found[4]), int(found[2]), int(found[3]))

    html = page(run)
    box = re.search(
        r'<h2><span class="unseen">Verdict: </span>.*?</span>([^<]*)(?:<span class="level">(.*?)</span>)?'
        r'(?:<span class="(no-level)">level not tested</span>)?</h2>',
        html,
    )
    assert box is not None
    assert bool(box[3]) == (not told["levels"] and told["verdict"] == "CONFORMANT")
    counted = re.search(r"</h2>\s*<p><b>(.*?)</b>", html)
    assert counted is not None
    yield "report", (box[1].strip(), _sorted(box[2] or ""), *counts_in(counted[1]))
    title = re.search(r"<title>(.*?):", html)
    assert title is not None
    columns = re.findall(r'<th scope="\w+">[\w /-]+ <span class="note">(\d+) of (\d+)</span>', html)
    yield "report's matrix", (title[1], levels, sum(int(one) for one, _ in columns), sum(int(of) for _, of in columns))

    summary = markdown.summary(run)
    head = re.match(rf"## \S+ ([A-Z ]+): .*\n\n\*\*{_COUNT} passed(.*?)\*\*", summary)
    assert head is not None, summary[:300]
    yield "summary", (head[1], _level(head[4]), int(head[2]), int(head[3]))

    junit = properties(run)
    of_junit = {name.removeprefix("otmcp_level_"): level for name, level in junit.items() if "_level_" in name}
    assert {key: level or "none" for key, level in told["levels"].items()} == of_junit
    yield "JUnit", (junit["otmcp_verdict"], levels, *counts_in(junit["otmcp_items"]))

    verified = next(_said(run, None))
    found = re.search(rf" is ([A-Z ]+); {_COUNT} passed(.*?); \d+ of \d+ repetitions", verified)
    assert found is not None, verified
    yield "verify", (found[1], _level(found[4]), int(found[2]), int(found[3]))

    column = compared([run, run]).columns[0]
    yield "comparison", (column.verdict.text, levels, *counts_in(column.items))


def _level(text: str) -> str:
    """Return the levels in what follows a count."""
    names = "|".join(re.escape(one.name) for one in protocols().values())
    return _sorted(", ".join(re.findall(rf"(?:(?:{names}) )?(?:no level|Bronze|Silver|Gold)\b", text)))


def _sorted(text: str) -> str:
    return ", ".join(sorted(text.split(", ")))


def agree(run: Run) -> None:
    said = dict(answers(run))
    assert set(said.values()) == {said["verdict.json"]}, said
    # What a cause says is broken is violated in the table of the requirements.
    table = dict(requirement_rows(run))
    for cause in verdict(run)["causes"]:
        if cause["rule"] in requirements() and cause["protocol"] in table[cause["rule"]]:
            assert table[cause["rule"]][cause["protocol"]].state == "violated"


def of_certificate(run: Run) -> None:
    """Hold badge and certificate against ``verdict.json``."""
    told = verdict(run)
    statement = certificate(run, "ab" * 32, tasks_by_id(run["subject"]["adapters"], SUITES))
    passed, of = (sum(one[name] for one in told["items"].values()) for name in ("passed", "of"))
    message = badge(statement)["message"]
    shown = words(certificate_page(statement, "cd" * 32, signed=False))
    assert message.startswith(f"{told['verdict'].lower()}: ")
    unclaimed = sum(one["unclaimed"] for one in told["items"].values())
    assert passed + unclaimed == of
    apart = f", {unclaimed} {'does' if unclaimed == 1 else 'do'} not apply" if unclaimed else ""
    assert f"({passed} of {of} items{apart}, catalogue {told['catalogue']})" in message
    assert f"catalogue of requirements {told['catalogue']}" in shown
    for key, level in told["levels"].items():
        name = protocols()[key].name
        assert f"{name} {level.capitalize()}" in message
        assert re.search(rf"{re.escape(name)}(, [^:]*)?: {level.capitalize()}", shown)
        count = told["items"][name]
        assert f"It passed {count['passed']} of {count['of']} {name} items" in shown


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.long] if index >= FAST else [])
        for names in GOLDEN.values()
        for index, name in enumerate(names)
    ],
)
def test_a_stored_record_says_the_same_everywhere(name: str) -> None:
    agree(golden(name))


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.long, *[pytest.mark.weekly] * (number % 2)])
        for number, name in enumerate(ALTERED)
    ],
)
def test_an_altered_record_says_the_same_everywhere(name: str) -> None:
    run = altered(ALTERED[name])
    agree(run)
    if run["footer"]["verdict"] == "CONFORMANT" and any(item["suite"] == REQUIREMENTS for item in run["items"]):
        of_certificate(run)


@pytest.mark.long
@pytest.mark.parametrize(
    "path",
    [
        # Most of a minute each.
        pytest.param(path, id=path.name, marks=pytest.mark.weekly if number % 8 else ())
        for number, path in enumerate(field_records())
    ],
)
def test_a_record_of_the_field_says_the_same_everywhere(path: Path, tmp_path: Path) -> None:
    agree(field(path, tmp_path))


@pytest.mark.long
def test_a_pass_of_less_than_everything_has_an_amber_edge() -> None:
    everything = conformant_run({"modbus": adapter("acme", "2026-07-28")})
    assert 'class="verdict good"' in page(cast(Run, everything))
    for change in ("N = 1", "a wall is missing", "narrowed"):
        assert 'class="verdict good partial"' in page(altered(ALTERED[change]))


@pytest.mark.long
def test_the_records_are_of_every_kind() -> None:
    found = {name: golden(name)["footer"]["verdict"] for names in GOLDEN.values() for name in names}
    assert {found[name] for name in GOLDEN["honest"]} == {"CONFORMANT"}
    assert {found[name] for name in GOLDEN["lying"]} == {"NOT CONFORMANT"}
    assert len(found) + len(ALTERED) >= 30
    assert json.dumps(verdict(golden("defect-MU-14p")))
