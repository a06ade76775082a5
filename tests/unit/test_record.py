"""The run record survives an end at any moment and refuses what contradicts itself."""

from __future__ import annotations

import copy
import json
import os
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.record.run_file import RecordError, RunWriter, count_calls, digest, load

from .samples import call, item, run

ITEMS = [
    item("M1", "normal", "Modbus", "Ping", [1.0, 2.0]),
    item("FM1", "fault", "Modbus", "Read", [1.0], error_code="illegal_address"),
]


def header() -> dict[str, Any]:
    record = run([])
    return {name: record[name] for name in ("schema", "kit", "subject", "environment", "settings")}


def footer(samples: int, items: int) -> dict[str, Any]:
    return {"complete": True, "reason": None, "items": items, "samples": samples, "verdict": "CONFORMANT"}


def test_what_was_written_is_read_back_in_the_suites_order(tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    writer = RunWriter(path, header())
    for entry in reversed(ITEMS):
        writer.append(entry)
    writer.finish(footer(3, 2), {"modbus": {"tools": 17}})
    record = load(path)
    assert [entry["id"] for entry in record["items"]] == ["M1", "FM1"]
    assert record["items"][0] == ITEMS[0]
    assert record["subject"]["adapters"] == {"modbus": {"tools": 17}}
    assert list(record) == ["schema", "kit", "subject", "environment", "settings", "items", "footer"]


def test_an_unfinished_record_is_valid_after_every_item_and_says_so(tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    writer = RunWriter(path, header())
    for count, entry in enumerate([None, *ITEMS]):
        if entry is not None:
            writer.append(entry)
        with pytest.raises(RecordError, match="incomplete: the run did not end"):
            load(path)
        assert len(load(path, allow_incomplete=True)["items"]) == count


def torn(tmp_path: Path, lost: int) -> Path:
    """A record of both items from whose last write ``lost`` bytes are missing."""
    path = tmp_path / "run.json"
    writer = RunWriter(path, header())
    for entry in ITEMS:
        writer.append(entry)
    path.write_bytes(path.read_bytes()[:-lost])
    return path


def test_a_write_torn_in_its_footer_loses_no_item(tmp_path: Path) -> None:
    path = torn(tmp_path, 10)
    assert load(path, allow_incomplete=True)["items"] == ITEMS
    with pytest.raises(RecordError, match="not strict JSON"):
        load(path)


def test_a_write_torn_in_an_item_loses_that_item_only(tmp_path: Path) -> None:
    record = load(torn(tmp_path, 150), allow_incomplete=True)
    assert record["items"] == ITEMS[:1]
    assert record["footer"] == {"complete": False, "reason": "the run did not end", "items": 1}


def test_a_record_torn_before_its_items_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    RunWriter(path, header())
    path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(RecordError, match="not strict JSON"):
        load(path, allow_incomplete=True)


def test_an_append_that_fails_leaves_the_record_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.json"
    writer = RunWriter(path, header())
    writer.append(ITEMS[0])
    before = path.read_bytes()
    genuine, left = os.write, 40

    def disk_full(descriptor: int, content: memoryview) -> int:
        nonlocal left
        if left > 0:
            written = genuine(descriptor, content[:left])
            left -= written
            return written
        monkeypatch.setattr(os, "write", genuine)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "write", disk_full)
    with pytest.raises(OSError, match="No space"):
        writer.append(ITEMS[1])
    assert path.read_bytes() == before
    writer.append(ITEMS[1])
    assert load(path, allow_incomplete=True)["items"] == ITEMS


def test_a_lone_surrogate_from_a_device_does_not_make_the_record_unreadable(tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    writer = RunWriter(path, header())
    writer.append({**ITEMS[0], "title": "topic \ud800"})
    writer.finish(footer(2, 1), {})
    assert load(path)["items"][0]["title"] == "topic ?"


def test_the_recovery_suites_task_calls_are_counted_apart() -> None:
    normal, recovery = item("M1", "normal", "Modbus", "Ping", [1.0]), item("R-modbus", "recovery", "Modbus", "R", [1.0])
    normal["other_calls"] = [call(role="setup"), call(role="warmup")]
    recovery["samples"][0]["calls"].append(call(role="control"))
    assert count_calls([normal, recovery]) == {"task": 1, "control": 1, "setup": 1, "warmup": 1, "recovery": 1}


def stored(tmp_path: Path, record: dict[str, Any]) -> Path:
    path = tmp_path / "run.json"
    path.write_text(json.dumps(record))
    return path


def test_a_consistent_record_is_accepted(tmp_path: Path) -> None:
    assert load(stored(tmp_path, run(ITEMS)))["items"] == ITEMS


def test_an_edited_record_is_refused(tmp_path: Path) -> None:
    record = copy.deepcopy(run(ITEMS))
    record["items"][0]["samples"][0]["duration_ms"] = 0.5
    with pytest.raises(RecordError, match="digest does not match"):
        load(stored(tmp_path, record))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda record: record["items"].append(record["items"][0]), "occurs twice"),
        (lambda record: record["items"].pop(), "the footer counts 2 items"),
        (lambda record: record["items"][0]["samples"].pop(), "the footer counts 3 samples"),
        (lambda record: record.pop("footer"), "lacks footer"),
        (lambda record: record["footer"].pop("digest"), "without a digest"),
        (lambda record: record.update(schema="otmcp-run/9"), "not a run record"),
        (lambda record: record["footer"]["tool_calls"].update(task=4), "the footer counts .* tool_calls"),
        (lambda record: record["items"][0].pop("planned"), "item 1 has no valid 'planned'"),
        (lambda record: record["items"][0].update(planned=True), "item 1 has no valid 'planned'"),
        (lambda record: record["items"][0].update(status="GOOD"), "unknown suite or status"),
        (lambda record: record["items"][0]["samples"].__setitem__(0, 7), "a sample of M1 is no object"),
        (lambda record: record["items"][0]["samples"][0]["calls"][0].update(role="x"), "unknown role 'x'"),
    ],
)
def test_a_record_that_contradicts_itself_is_refused(tmp_path: Path, change: Any, reason: str) -> None:
    record = copy.deepcopy(run(ITEMS))
    change(record)
    with pytest.raises(RecordError, match=reason):
        load(stored(tmp_path, record))


def resealed(record: dict[str, Any]) -> dict[str, Any]:
    """The record with the counts and the digest that a careful forger would give it."""
    record["footer"]["samples"] = sum(len(entry["samples"]) for entry in record["items"])
    record["footer"]["tool_calls"] = count_calls(record["items"])
    record["footer"]["digest"] = digest(record)
    return record


def failing(record: dict[str, Any], status: str) -> None:
    record["items"][0] = {**item("M1", "normal", "Modbus", "Ping", [1.0, 2.0], failing=1), "status": status}


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda record: failing(record, "PASS"), "M1 is called PASS, but not everything"),
        (lambda record: record["items"][0].update(planned=3), "M1 is called PASS, but not everything"),
        (lambda record: record["items"][0]["samples"].pop(0), "the repetitions of M1 are not the first of 2"),
        (lambda record: record["items"][0].update(planned=1), "the repetitions of M1 are not the first of 1"),
        (lambda record: failing(record, "FAIL"), "the footer says CONFORMANT, the items do not"),
        (
            lambda record: record["items"][0]["findings"].append({"code": "x", "message": "y"}),
            "M1 is called PASS, but not everything",
        ),
        (
            lambda record: record["items"][0]["samples"][0]["findings"].append({"code": "x", "message": "y"}),
            "a repetition of M1 is called ok, but has findings",
        ),
    ],
)
def test_a_better_judgement_than_the_samples_is_refused_even_with_a_matching_digest(
    tmp_path: Path, change: Any, reason: str
) -> None:
    record = copy.deepcopy(run(ITEMS))
    change(record)
    with pytest.raises(RecordError, match=reason):
        load(stored(tmp_path, resealed(record)))


@pytest.mark.parametrize("text", ["", "{", '{"schema": NaN}', '{"schema": 1, "schema": 2}', "[]"])
def test_what_is_no_strict_json_is_refused_in_one_sentence(tmp_path: Path, text: str) -> None:
    path = tmp_path / "run.json"
    path.write_text(text)
    with pytest.raises(RecordError, match=r"run\.json: ") as refusal:
        load(path)
    assert "\n" not in str(refusal.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="cannot be read"):
        load(tmp_path / "nowhere.json")
