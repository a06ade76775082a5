"""``docs/field-report.md`` and the pages of its adapters say what the run records say, and every example has a record of its own subject file."""

from __future__ import annotations

import lzma
import tomllib
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.core.matrix import BENCHMARK, SUITES
from pytest_otmcp.fleet.outcome import Outcome, Result, judged, pack, write_result
from pytest_otmcp.fleet.plan import RUNS, planned, write_plan
from pytest_otmcp.record.reader import open_record
from pytest_otmcp.record.schema import Run
from pytest_otmcp.replay.rejudge import differences
from pytest_otmcp.report.causes import causes
from pytest_otmcp.report.verdict_file import verdict
from pytest_otmcp.subject import load_subject
from tests.stored_runs import store

from . import records
from .examples import EXAMPLES, NAMES, sources
from .field_report import DOCS, pages
from .page import side_by_side
from .records import RECORDS, REPS, judge_again, recorded, stored, take
from .wire import wire


def test_every_example_has_a_record() -> None:
    assert set(recorded()) == set(NAMES)


def test_the_fleet_has_every_example_in_the_version_of_its_subject_file() -> None:
    name, rows = planned(EXAMPLES / "fleet.toml")
    found = {(row.id, row.version): row for row in rows}
    for example in NAMES:
        told = tomllib.loads((EXAMPLES / example / "otmcp.toml").read_text(encoding="utf-8"))
        row = found[example, told["subject"]["version"]]
        # So its record is one of the subject file as it is.
        assert row.files[row.subject] == (EXAMPLES / example / "otmcp.toml").read_text(encoding="utf-8")
        assert row.reps == REPS
    assert len(found) > len(NAMES)
    assert name == "Public adapters"


def test_the_records_of_a_fleet_are_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name, version = "npm-modbus-mcp", "0.1.1"
    plan = write_plan(EXAMPLES / "fleet.toml", tmp_path)
    (key,) = (row.key for row in plan.rows if (row.id, row.version) == (name, version))
    folder = tmp_path / RUNS / key
    folder.mkdir(parents=True)
    (folder / "run.json").write_bytes(lzma.decompress((RECORDS / f"{name}.json.xz").read_bytes()))
    told = verdict(stored(name))
    digest, packed = pack(folder / "run.json")
    found = Result(
        key=key, id=name, version=version, outcome=judged(told), verdict=told, record=digest, packed=packed, seconds=1
    )
    write_result(folder, found)
    taken = tmp_path / "taken"
    taken.mkdir()
    monkeypatch.setattr("tests.adapters_in_the_wild.records.RECORDS", taken)
    said = list(take(tmp_path))
    assert f"{name}: {Outcome.NOT_CONFORMANT}" in said
    assert len(said) == len(NAMES)
    assert [path.name for path in taken.iterdir()] == [f"{name}.json.xz"]
    assert stored(name)["subject"]["version"] == version


@pytest.mark.long
def test_a_record_is_judged_again_by_its_evidence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = "industriagents-profinet-mcp"
    with open_record(_plain(name, tmp_path)) as run:
        items: list[Any] = [{**item.head, "samples": list(item.samples())} for item in run.items()]
        record = {**run.header, "items": items, "footer": run.footer}
    finding = next(found for item in items for sample in item["samples"] for found in sample["findings"])
    finding["message"] = "a judge of long ago said this"
    changed = store(tmp_path / "changed.json", record)
    monkeypatch.setattr("tests.adapters_in_the_wild.records.RECORDS", tmp_path)
    (tmp_path / f"{name}.json.xz").write_bytes(lzma.compress(changed.read_bytes()))
    list(judge_again([name]))
    with open_record(_plain(name, tmp_path)) as again:
        assert list(differences(again)) == []
        found = [one["message"] for item in again.items() for sample in item.samples() for one in sample["findings"]]
    assert found
    assert "a judge of long ago said this" not in found


def _plain(name: str, folder: Path) -> Path:
    path = folder / "plain.json"
    path.write_bytes(lzma.decompress((records.RECORDS / f"{name}.json.xz").read_bytes()))
    return path


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.long if number % 4 else ()) for number, name in enumerate(recorded())]
)
def test_a_record_is_of_the_whole_suite_and_of_the_subject_file_as_it_is(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for variable in sources(name):
        monkeypatch.setenv(variable, "anywhere")
    run = stored(name)
    assert run["subject"]["digest"] == load_subject(EXAMPLES / name / "otmcp.toml").digest
    assert run["settings"]["reps"] == REPS
    assert run["settings"]["suites"] in (list(BENCHMARK), list(SUITES))
    assert run["settings"]["narrowed"] == []


@pytest.mark.long
def test_the_pages_say_what_the_records_say() -> None:
    current = {f"field-report/{page.name}": page for page in (DOCS / "field-report").glob("*.md")}
    current["field-report.md"] = DOCS / "field-report.md"
    assert pages() == {name: page.read_text(encoding="utf-8") for name, page in current.items()}, (
        "out of date: python -m tests.adapters_in_the_wild.field_report"
    )


@pytest.mark.parametrize(
    ("name", "item", "code", "shown"),
    [
        ("mcmqtt", "Q1", "no_exchange", ["host → adapter  mqtt_status", "the device saw nothing of it"]),
        (
            "mcmqtt",
            "Q3",
            "published_otherwise",
            ['"qos": 0', "adapter → device  PUBLISH", "qos=1", "adapter ← device  PUBACK"],
        ),
        ("mcmqtt", "Q2", "wrong_value", ["adapter ← device  PUBLISH", "mqtt_get_messages", '"messages": []']),
        (
            "mqtt5-mcp-server",
            "S11",
            "wrote",
            ["the device is started", "adapter → device  PUBLISH", "control/pump", "PUBACK"],
        ),
        ("x746b-modbus-mcp", "WR-003.modbus", "written_twice", ["write_register", "request: write single register"]),
        ("kukapay-modbus-mcp", "R-modbus", "not_from_the_device", ["read_input_registers", "Demo Mode", "saw nothing"]),
    ],
)
def test_beside_a_cause_stands_what_was_said_and_what_the_device_saw(
    name: str, item: str, code: str, shown: list[str]
) -> None:
    (cause,) = (cause for cause in causes(stored(name)) if (cause.where["id"], cause.first["code"]) == (item, code))
    text = "\n".join(wire(cause))
    places = [text.index(words) for words in shown]
    assert places == sorted(places), text


@pytest.mark.long
def test_the_papers_measure_sees_less_than_the_device() -> None:
    runs: dict[str, Run] = {name: stored(name) for name in recorded()}
    row = next(line for line in side_by_side(runs).splitlines() if line.startswith("| normal suite |"))
    _, _, paper, *measured, _ = (cell.strip() for cell in row.split("|"))
    assert paper == "480/480"
    for claimed, seen in zip(measured[::2], measured[1::2], strict=True):
        assert passed(claimed) > passed(seen)


def passed(cell: str) -> int:
    return int(cell.partition("/")[0])
