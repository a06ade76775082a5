"""The run record survives an end at any moment and refuses what contradicts itself."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.record import RecordError, RunWriter, load

from .samples import item, run

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


def stored(tmp_path: Path, record: dict[str, Any]) -> Path:
    path = tmp_path / "run.json"
    path.write_text(json.dumps(record))
    return path


def test_a_consistent_record_is_accepted(tmp_path: Path) -> None:
    assert load(stored(tmp_path, run(ITEMS)))["items"] == ITEMS


def test_an_edited_record_is_refused(tmp_path: Path) -> None:
    record = run(ITEMS)
    record["items"][0]["samples"][0]["duration_ms"] = 0.5
    with pytest.raises(RecordError, match="digest does not match"):
        load(stored(tmp_path, record))
    record["items"][0]["samples"][0]["duration_ms"] = 1.0


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda record: record["items"].append(record["items"][0]), "occurs twice"),
        (lambda record: record["items"].pop(), "the footer counts 2 items"),
        (lambda record: record["items"][0]["samples"].pop(), "the footer counts 3 samples"),
        (lambda record: record.pop("footer"), "lacks footer"),
        (lambda record: record["footer"].pop("digest"), "without a digest"),
        (lambda record: record.update(schema="otmcp-run/9"), "not a run record"),
    ],
)
def test_a_record_that_contradicts_itself_is_refused(tmp_path: Path, change: Any, reason: str) -> None:
    record = json.loads(json.dumps(run(ITEMS)))
    change(record)
    with pytest.raises(RecordError, match=reason):
        load(stored(tmp_path, record))


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
