"""The run record survives an end at any moment and refuses what contradicts itself."""

from __future__ import annotations

import copy
import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import jsonschema
import pytest

from pytest_otmcp.record import RecordError, load
from pytest_otmcp.record.condensed import condensed
from pytest_otmcp.record.consistency import count_calls
from pytest_otmcp.record.json_schema import json_schema
from pytest_otmcp.record.reader import open_record
from pytest_otmcp.record.schema import Footer, ItemHead
from pytest_otmcp.record.writer import RunWriter, SampleSpool, laid_out

from ..stored_runs import counted, header_of, store
from .samples import around, call, finding, item, run

ITEMS = [
    item("M1", "normal", "Modbus", "Ping", [1.0, 2.0]),
    item("FM1", "fault", "Modbus", "Read", [1.0], error_code="illegal_address"),
]


def head(entry: dict[str, Any]) -> ItemHead:
    return cast(ItemHead, {name: value for name, value in entry.items() if name != "samples"})


def append(writer: RunWriter, entry: dict[str, Any]) -> None:
    writer.append(head(entry), laid_out(entry["samples"]))


def footer(samples: int, items: int) -> Footer:
    counts = {"items": items, "samples": samples, "tool_calls": count_calls(ITEMS)}
    return cast(Footer, {"complete": True, "reason": None, **counts, "verdict": "CONFORMANT"})


def begun(tmp_path: Path) -> tuple[Path, RunWriter]:
    path = tmp_path / "run.json"
    header = header_of(run([]))
    return path, RunWriter(path, {**header, "environment": {**header["environment"], "finished_at": None}})


def test_what_was_written_is_read_back_in_the_suites_order(tmp_path: Path) -> None:
    path, writer = begun(tmp_path)
    for entry in reversed(ITEMS):
        append(writer, entry)
    writer.finish(header_of(run([])), footer(3, 2))
    record = load(path)
    assert record["items"] == ITEMS
    assert record["environment"]["finished_at"] == "2026-11-21T07:13:43Z"
    assert list(record)[:2] == ["schema", "run_id"]
    assert list(record)[-2:] == ["items", "footer"]
    # Other readers need not know that the record is written in lines.
    assert [entry["id"] for entry in json.loads(path.read_text())["items"]] == [entry["id"] for entry in ITEMS]


def test_an_item_without_samples_is_read_back(tmp_path: Path) -> None:
    nothing = item("M1", "normal", "Modbus", "Ping", []) | {"status": "NOT_APPLICABLE", "planned": 3}
    assert load(store(tmp_path / "run.json", run([nothing])))["items"] == [nothing]


def test_samples_wait_in_a_file_of_their_own(tmp_path: Path) -> None:
    path, writer = begun(tmp_path)
    spool = SampleSpool(tmp_path / "M1.jsonl")
    assert list(SampleSpool.read(spool.path, spool.digest)) == []
    for sample in ITEMS[0]["samples"]:
        spool.add(sample)
    writer.append(head(ITEMS[0]), SampleSpool.read(spool.path, spool.digest))
    assert load(path, allow_incomplete=True)["items"] == ITEMS[:1]


def test_the_digest_is_that_of_the_bytes_before_its_line(tmp_path: Path) -> None:
    content = store(tmp_path / "run.json", run(ITEMS)).read_bytes()
    before, line = content[: content.rindex(b' "digest"')], content[content.rindex(b' "digest"') :]
    assert hashlib.sha256(before).hexdigest() in line.decode()


def test_an_unfinished_record_is_valid_after_every_item_and_says_so(tmp_path: Path) -> None:
    path, writer = begun(tmp_path)
    for count, entry in enumerate([None, *ITEMS]):
        if entry is not None:
            append(writer, entry)
        assert len(json.loads(path.read_text())["items"]) == count
        with pytest.raises(RecordError, match="incomplete: the run did not end"):
            load(path)
        assert len(load(path, allow_incomplete=True)["items"]) == count


def torn(tmp_path: Path, lost: int) -> Path:
    """Write a record of both items, and cut the last ``lost`` bytes off."""
    path, writer = begun(tmp_path)
    for entry in ITEMS:
        append(writer, entry)
    path.write_bytes(path.read_bytes()[:-lost])
    return path


def test_a_write_torn_in_its_footer_loses_no_item(tmp_path: Path) -> None:
    path = torn(tmp_path, 10)
    assert load(path, allow_incomplete=True)["items"] == ITEMS
    with pytest.raises(RecordError, match="not strict JSON"):
        load(path)


@pytest.mark.parametrize("lost", [150, 900])
def test_a_write_torn_in_an_item_loses_that_item_only(tmp_path: Path, lost: int) -> None:
    record = load(torn(tmp_path, lost), allow_incomplete=True)
    assert record["items"] == ITEMS[:1]
    assert record["footer"] == {"complete": False, "reason": "the run did not end", **counted(ITEMS[:1])}


def test_a_record_torn_before_its_items_is_refused(tmp_path: Path) -> None:
    path, _ = begun(tmp_path)
    path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(RecordError, match="not strict JSON"):
        load(path, allow_incomplete=True)


@pytest.mark.parametrize("room", [40, 800])
def test_an_append_that_fails_leaves_the_record_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room: int
) -> None:
    path, writer = begun(tmp_path)
    append(writer, ITEMS[0])
    before = path.read_bytes()
    genuine, left = os.write, room

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
        append(writer, ITEMS[1])
    assert path.read_bytes() == before
    append(writer, ITEMS[1])
    assert load(path, allow_incomplete=True)["items"] == ITEMS


def test_a_lone_surrogate_from_a_device_does_not_make_the_record_unreadable(tmp_path: Path) -> None:
    path = store(tmp_path / "run.json", run([{**ITEMS[0], "title": "topic \ud800"}]))
    assert load(path)["items"][0]["title"] == "topic ?"


def test_two_items_can_be_read_in_turns(tmp_path: Path) -> None:
    with open_record(store(tmp_path / "run.json", run(ITEMS))) as stored:
        first, second = stored.items()
        pairs = list(zip(first.samples(), second.samples(), strict=False))
    assert pairs == [(ITEMS[0]["samples"][0], ITEMS[1]["samples"][0])]


def test_a_record_is_read_as_it_was_when_it_was_checked(tmp_path: Path) -> None:
    path = store(tmp_path / "run.json", run(ITEMS))
    with open_record(path) as stored:
        path.write_text("another one")
        assert [entry.head["id"] for entry in stored.items()] == ["M1", "FM1"]
        assert [len(list(entry.samples())) for entry in stored.items()] == [2, 1]


def test_reports_keep_whole_what_they_show_and_count_the_rest(tmp_path: Path) -> None:
    failed = item("M1", "normal", "Modbus", "Ping", [1.0] * 6, failing=2)
    failed["samples"][5]["findings"] = [finding("timeout", "nothing came", "TMO-001")]
    with open_record(store(tmp_path / "run.json", run([failed]))) as stored:
        kept = condensed(stored)
    (entry,) = kept["items"]
    whole = [sample["repetition"] for sample in entry["samples"] if "tool" in sample["calls"][0]]
    assert whole == [0, 4, 5]
    assert [sample["duration_ms"] for sample in entry["samples"]] == [1.0] * 6
    assert count_calls(kept["items"]) == count_calls([cast(Any, failed)])


# -- one definition ----------------------------------------------------------------------------------------------------


def test_a_record_satisfies_the_exported_json_schema(tmp_path: Path) -> None:
    failed = item("M3", "normal", "Modbus", "Write", [1.0], failing=1) | {"around": [around("warmup", call())]}
    document = json.loads(store(tmp_path / "run.json", run([*ITEMS, failed])).read_text())
    schema = json.loads(json_schema())
    validator = jsonschema.Draft202012Validator(schema)
    assert [error.message for error in validator.iter_errors(document)] == []
    document["items"][0]["samples"][0]["judgement"]["ok"] = "yes"
    assert [error.json_path for error in validator.iter_errors(document)] == ["$.items[0].samples[0].judgement.ok"]


def test_every_member_is_explained_in_the_documentation() -> None:
    text = (Path(__file__).parents[2] / "docs" / "run-record.md").read_text(encoding="utf-8")
    definitions = json.loads(json_schema())["$defs"]
    missing = [
        f"{name}.{member}"
        for name, definition in definitions.items()
        for member in definition.get("properties", {})
        if f"`{member}`" not in text
    ]
    assert missing == []


def test_calls_of_checks_are_counted_apart() -> None:
    calls = {"normal": "task", "recovery": "recovery", "requirements": "check"}
    for suite, role in calls.items():
        checked = [{**item("M1", suite, "Modbus", "x", [1.0, 2.0]), "around": []}]
        found = {name: count for name, count in count_calls(checked).items() if count}
        assert found == {role: 2}, suite
        record = run(checked)
        assert record["footer"]["tool_calls"] == count_calls(checked)
    assert "check" not in count_calls([])


# -- contradictions ----------------------------------------------------------------------------------------------------


def test_the_recovery_suites_task_calls_are_counted_apart() -> None:
    normal, recovery = item("M1", "normal", "Modbus", "Ping", [1.0]), item("R-modbus", "recovery", "Modbus", "R", [1.0])
    normal["around"] = [around("setup", call(role="setup")), around("warmup", call(role="warmup"))]
    recovery["samples"][0]["calls"].append(call(role="control"))
    assert count_calls(cast(Any, [normal, recovery])) == {
        "task": 1,
        "control": 1,
        "setup": 1,
        "warmup": 1,
        "recovery": 1,
    }


def test_an_edited_record_is_refused(tmp_path: Path) -> None:
    path = store(tmp_path / "run.json", run(ITEMS))
    path.write_bytes(path.read_bytes().replace(b'"duration_ms":1.0', b'"duration_ms":0.5', 1))
    with pytest.raises(RecordError, match="digest does not match"):
        load(path)


@pytest.mark.parametrize(
    ("content", "what"),
    [
        ("<!DOCTYPE html>\n<html lang='en'>", "it is a page for people, and run.json beside it is the record"),
        ('{\n "_type": "https://in-toto.io/Statement/v1"', "it is a certificate, and run.json beside it is the record"),
    ],
)
def test_another_file_of_the_kit_is_named(tmp_path: Path, content: str, what: str) -> None:
    (tmp_path / "other").write_text(content)
    with pytest.raises(RecordError, match=f"not a run record of schema otmcp-run/3 .*: {what}"):
        load(tmp_path / "other")


def test_a_record_that_was_formatted_anew_is_refused(tmp_path: Path) -> None:
    path = store(tmp_path / "run.json", run(ITEMS))
    path.write_text(json.dumps(json.loads(path.read_text()), indent=2))
    with pytest.raises(
        RecordError, match="not a run record of schema otmcp-run/3 in the lines in which the kit writes it"
    ):
        load(path)


Change = Callable[[dict[str, Any]], object]


def first(record: dict[str, Any]) -> dict[str, Any]:
    entry: dict[str, Any] = record["items"][0]
    return entry


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda record: record["items"].append(first(record)), "an item occurs twice: M1"),
        (lambda record: first(record).pop("planned"), "item 1: object missing required field `planned`"),
        (lambda record: first(record).update(planned=True), r"item 1\.planned: expected `int`, got `bool`"),
        (lambda record: first(record).update(status="GOOD"), r"item 1\.status: invalid enum value"),
        (lambda record: first(record).update(suite="endless"), "M1 has the unknown suite 'endless'"),
        (lambda record: first(record)["samples"][0].pop("repetition"), "a sample of M1"),
        (
            lambda record: first(record)["samples"][0]["calls"][0].update(role="x"),
            r"a sample of M1\.calls\[0\]\.role: invalid",
        ),
        (lambda record: first(record).update(run_id="8" * 32), "M1 is of another run: its run_id is 8888"),
        (lambda record: record.update(run_id="yesterday"), r"the record\.run_id: expected `str` matching"),
        (
            lambda record: record["settings"].update(time_scale=True),
            r"settings\.time_scale: expected `float`, got `bool`",
        ),
        (lambda record: record["settings"].update(time_scale=0), r"settings\.time_scale: expected `float` > 0"),
        (lambda record: record["environment"].update(started_at="yesterday \x1b[31m"), r"environment\.started_at"),
        (
            lambda record: record["environment"].update(started_at="2026-13-32T25:61:61Z"),
            "environment.started_at|no clock",
        ),
        (lambda record: record["environment"].update(started_at="2026-02-31T07:03:43Z"), "which no clock shows"),
        (lambda record: first(record).update(finished_at="2026-11-21 07:03"), r"item 1\.finished_at"),
        (
            lambda record: record["subject"].update(name="x\x1b[2J verified: by TUV"),
            r"subject\.name: has a control character",
        ),
        (lambda record: record["subject"].update(name="acme\n"), r"subject\.name: has a control character"),
        (
            lambda record: record["subject"]["adapters"]["modbus"].update(server_name="a\rb"),
            r"subject\.adapters\[\.\.\.\]\.server_name",
        ),
        (
            lambda record: record["subject"]["adapters"]["modbus"].update(deadline_s=1e6),
            r"deadline_s: expected `float` <= 300",
        ),
        (lambda record: first(record).update(began_ns=9, ended_ns=8), "M1 ended before it began"),
        (
            lambda record: record["footer"].update(reason="later"),
            "has a reason in its footer if, and only if, it is not",
        ),
        (lambda record: record["settings"]["suites"].append("fault"), "the settings ask for the suite 'fault' twice"),
    ],
)
def test_a_record_that_contradicts_itself_is_refused(tmp_path: Path, change: Change, reason: str) -> None:
    record = copy.deepcopy(run(ITEMS))
    change(record)
    with pytest.raises(RecordError, match=reason):
        load(store(tmp_path / "run.json", record))


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        (b"otmcp-run/3", b"otmcp-run/9", "not a run record of schema"),
        (b' "footer"', b' "header"', "not strict JSON"),
        (b',\n "digest"', b',\n "digits"', "digest does not match"),
        (b'},\n   {"repetition":1', b'}\n   {"repetition":1', "a comma is missing between two samples of M1"),
        (b"}\n  ]},", b"},\n  ]},", "a comma after the last sample of M1"),
        (b'"}}\n', b'"}}\n{}\n', "something follows the footer"),
        (b'"items": [\n', b'"items": [\n\n', "not strict JSON"),
        (b' "items": [\n', b' "items": [],\n "items": [\n', "the member 'items' occurs twice"),
        (b' "items": [\n', b' "footer": {},\n "items": [\n', "the member 'footer' occurs twice"),
        (b' "footer": {', b"{", "where the footer should begin"),
        (b' "digest"', b' "awarded":"gold","digest"', "digest does not match"),
        (b'{"id":"M1"', b'{"id":"M1","id":"M2"', "the member 'id' occurs twice"),
    ],
)
def test_a_file_of_other_lines_is_refused(tmp_path: Path, old: bytes, new: bytes, reason: str) -> None:
    path = store(tmp_path / "run.json", run(ITEMS))
    content = path.read_bytes()
    assert old in content
    path.write_bytes(content.replace(old, new, 1))
    with pytest.raises(RecordError, match=reason):
        load(path)


def test_a_complete_record_without_a_digest_is_refused(tmp_path: Path) -> None:
    path = store(tmp_path / "run.json", run(ITEMS))
    content = path.read_bytes()
    path.write_bytes(content[: content.rindex(b',\n "digest"')] + b"}}\n")
    with pytest.raises(RecordError, match="a complete record without a digest"):
        load(path)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda record: record["items"][0]["samples"].pop(0), "the repetitions of M1 are not the first of 2"),
        (lambda record: record["items"][0].update(planned=1), "the repetitions of M1 are not the first of 1"),
    ],
)
def test_repetitions_that_are_not_the_first_are_refused_even_with_a_matching_digest(
    tmp_path: Path, change: Any, reason: str
) -> None:
    record = copy.deepcopy(run(ITEMS))
    change(record)
    with pytest.raises(RecordError, match=reason):
        load(store(tmp_path / "run.json", record))


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
