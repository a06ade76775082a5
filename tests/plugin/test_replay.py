"""Real runs judged again: the judgements follow from the stored history, and a change of that history is found."""

from __future__ import annotations

import copy
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.plant.devices import Plant
from pytest_otmcp.record import load
from pytest_otmcp.replay import rejudge as replay
from pytest_otmcp.session.loop import LoopThread
from pytest_otmcp.soundness.defect import DEFECTS
from pytest_otmcp.soundness.judging import measured
from pytest_otmcp.soundness.warm_start import WarmStart
from pytest_otmcp.subject import Subject, load_subject, reference_subject
from pytest_otmcp.suite.catalogue import tasks_by_id
from pytest_otmcp.trial.adapter_under_test import BenchOptions
from pytest_otmcp.trial.bench import Bench
from tests.trials import as_read, recorded

from .reference_run import reference_run

Record = dict[str, Any]

SOUNDNESS = Path(__file__).parents[1] / "soundness"
DEFECTIVE, ROGUE = ((str(SOUNDNESS / name),) for name in ("defective.py", "rogue.py"))
MUTANT = ("-P", "-m", DEFECTS)

FOREIGN_SUBJECT = """
[subject]
name = "an adapter of another shape"
version = "1"

[adapter.modbus]
command = ["{python}", "-m", "pytest_otmcp.reference_adapters", "modbus"]
env = { MODBUS_HOST = "{host}", MODBUS_PORT = "{port}", MODBUS_TIMEOUT_S = "20", MODBUS_DEADLINE_S = "25" }
rw = { env = { MODBUS_WRITES_ENABLED = "true" } }
deadline_s = 30
answer = "json"
bindings = "functions.py"
errors = [
    { text = "illegal_address", code = "illegal_address" },
    { text = "range_overflow", code = "range_overflow" },
]

[adapter.modbus.bind]
ping = { tool = "ping", result = { reachable = "data.reachable" } }
read_input = { tool = "read_input_registers", arguments = { address = "$address", count = "$count" }, result = { values = "data.values" } }
write_holding = { tool = "write_register", arguments = { address = "$address", value = "$value" }, result = { value = "data.value" } }
"""

FUNCTIONS = """
from pytest_otmcp.subject import Refused


async def read_holding(tools, *, address, count):
    await tools.call("ping")
    answer = await tools.call("read_multiple_holding_registers", address=address, count=count)
    if answer.is_error:
        raise Refused(answer.structured["error"]["code"], answer.text)
    return {"values": answer.structured["data"]["values"]}
"""


BUGGY = """
import sys

sys.path.insert(0, {directory!r})
import rogue

error = {{"code": "internal_error", "class": "internal", "message": "see the log", "retryable": False}}
rogue.ENVELOPE |= {{"success": False, "data": None, "error": error | {{"outcome": "not_applicable"}}}}
print("ZeroDivisionError: no spindle", file=sys.stderr, flush=True)
rogue.main()
"""


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory, warm_start: WarmStart) -> Record:
    """The record of the whole suite, two repetitions each, with the reference adapters, in a pytest of its own."""
    return load(reference_run(tmp_path_factory, warm_start))


@pytest.fixture(scope="module")
def bench_of(warm_start: WarmStart) -> Iterator[Callable[..., Record]]:
    """``bench_of(subject, tasks, …)`` gives the record of these Modbus tasks, over one plant for all of them."""
    loop, plant = LoopThread(), Plant()

    def run(subject: Subject, tasks: str, *, time_scale: float = 1.0) -> Record:
        async def items() -> Record:
            bench = Bench(warm_start.subject(subject), BenchOptions(time_scale=time_scale), plant)
            try:
                known = tasks_by_id()
                items = [await measured(bench, known[name], 2) for name in tasks.split()]
                return recorded(bench, items)
            finally:
                await bench.close()

        return loop.run(items())

    yield run
    loop.run(plant.close())
    loop.close()


def program(*command: str) -> Subject:
    """Return the reference subject with its Modbus adapter alone, started by another command."""
    genuine = reference_subject()
    adapter = genuine.adapters["modbus"]
    variants = {
        name: replace(variant, command=(sys.executable, *command)) for name, variant in adapter.variants.items()
    }
    return replace(genuine, adapters={"modbus": replace(adapter, variants=variants)})


def rejudge(record: Record) -> list[str]:
    return replay.rejudge(as_read(record))


def the(record: Record, identifier: str) -> Record:
    return next(item for item in record["items"] if item["id"] == identifier)


@pytest.mark.long
def test_a_whole_run_is_judged_as_it_was(record: Record) -> None:
    assert len(record["items"]) == 38
    assert rejudge(record) == []


def test_nonces_come_from_the_seed_of_the_run(record: Record) -> None:
    changed = {**record, "settings": {**record["settings"], "seed": 8}}
    assert any(sentence.startswith("M2 repetition 1: the stored history shows") for sentence in rejudge(changed))


def shift_a_slice(item: Record) -> None:
    second = item["samples"][1]["device"]
    item["samples"][0]["device"].append(second.pop(0))


def seen(item: Record, what: str) -> Record:
    found: Record = next(seen for seen in item["samples"][0]["observations"] if what in seen)
    return found


def stop_in_less_than_no_time(item: Record) -> None:
    seen(item, "stop")["stop"] = -1.0


def lose_an_attempt(item: Record) -> None:
    calls = item["samples"][0]["calls"]
    calls.pop()
    calls.pop()


def swap_concurrent_replies(item: Record) -> None:
    first, second = item["samples"][0]["calls"][:2]
    first["envelope"]["data"], second["envelope"]["data"] = second["envelope"]["data"], first["envelope"]["data"]


CHANGES: dict[Callable[[Record], None], tuple[str, str]] = {
    shift_a_slice: ("O1", "O1 repetition 1: the journal of opcua has 1 entries beyond its end"),
    stop_in_less_than_no_time: ("S10", "S10 repetition 1: the stop of modbus took -1.0 ms, there were"),
    lose_an_attempt: ("S11", "the history has no further call"),
    swap_concurrent_replies: ("S1", "S1 repetition 1: the stored history shows 'read_input_registers"),
}


@pytest.mark.parametrize("change", CHANGES, ids=lambda change: change.__name__)
def test_a_change_in_the_history_is_found_out(record: Record, change: Callable[[Record], None]) -> None:
    identifier, sentence = CHANGES[change]
    item = copy.deepcopy(the(record, identifier))
    assert item["status"] == "PASS"
    change(item)
    items = [item if other["id"] == identifier else other for other in record["items"]]
    disagreements = rejudge({**record, "items": items})
    assert sentence in "\n".join(disagreements)
    assert all(identifier in disagreement for disagreement in disagreements)


WAITED_FOR = ("hang", "wrong-id")


@pytest.mark.parametrize(
    ("command", "tasks", "code"),
    [
        ((*DEFECTIVE, "wrong-value"), "M2 S1", "wrong_value"),
        pytest.param((*DEFECTIVE, "hang"), "S10", "no_reply", marks=pytest.mark.long),
        ((*MUTANT, "MU-49"), "M1", "stdout_noise"),
        pytest.param((*MUTANT, "MU-126"), "S10", "not_successful", marks=pytest.mark.long),
        pytest.param((*MUTANT, "MU-20"), "M4", "wrote", marks=pytest.mark.long),
        ((*ROGUE, "not-json"), "M1", "not_strict_json"),
        ((*ROGUE, "huge-reply"), "M1", "frame_too_long"),
        ((*ROGUE, "dies-in-call"), "M2 M3", "session_lost"),
        pytest.param((*ROGUE, "wrong-id"), "M1", "unknown_id", marks=pytest.mark.long),
        ((*ROGUE, "dead"), "M1", "cannot_start"),
    ],
)
def test_findings_come_out_again(
    bench_of: Callable[..., Record], command: tuple[str, ...], tasks: str, code: str
) -> None:
    run = bench_of(program(*command), tasks, time_scale=0.3 if command[-1] in WAITED_FOR else 1.0)
    found = [finding for item in run["items"] for part in (item, *item["samples"]) for finding in part["findings"]]
    assert code in {finding["code"] for finding in found}
    assert rejudge(run) == []
    for item in run["items"]:
        item["findings"] = []
        for sample in item["samples"]:
            sample["findings"] = []
    sentences = "\n".join(rejudge(run))
    assert {finding["code"] for finding in found if f"({finding['code']})" not in sentences} == set()


def test_an_adapter_without_envelopes_is_judged_from_its_frames(
    bench_of: Callable[..., Record], tmp_path: Path
) -> None:
    (tmp_path / "functions.py").write_text(FUNCTIONS)
    subject = tmp_path / "foreign.toml"
    subject.write_text(FOREIGN_SUBJECT)
    run = bench_of(load_subject(subject), "M1 M2 M3 M4 FM2")
    assert {item["status"] for item in run["items"]} == {"PASS"}, run["items"]
    assert rejudge(run) == []
    call = the(run, "M2")["samples"][0]["calls"][0]
    call["envelope"]["data"] = {"values": [0, 0, 0, 0]}
    assert "call 1 (read_input_registers): the stored history shows envelope" in "\n".join(rejudge(run))


def test_what_a_function_of_the_subject_returned_is_held_against_the_device(
    bench_of: Callable[..., Record], tmp_path: Path
) -> None:
    (tmp_path / "functions.py").write_text(FUNCTIONS)
    subject = tmp_path / "foreign.toml"
    subject.write_text(FOREIGN_SUBJECT)
    run = bench_of(load_subject(subject), "M3")
    run["items"][0]["samples"][1]["calls"][1]["outputs"]["values"] = [40]
    assert "values should be [41], the reply says [40]' (wrong_value)" in "\n".join(rejudge(run))


def test_a_bug_that_an_adapter_reports_is_shown_with_its_last_words(
    bench_of: Callable[..., Record], tmp_path: Path
) -> None:
    (tmp_path / "buggy.py").write_text(BUGGY.format(directory=str(SOUNDNESS)))
    run = bench_of(program(str(tmp_path / "buggy.py"), "ping"), "M1")
    findings = run["items"][0]["samples"][0]["findings"]
    evidence = next(finding["evidence"] for finding in findings if finding["code"] == "internal_error")
    assert "ZeroDivisionError: no spindle" in evidence
    assert rejudge(run) == []


@pytest.mark.long
def test_a_device_need_not_keep_what_the_record_has(warm_start: WarmStart) -> None:
    loop, plant = LoopThread(), Plant()

    async def run() -> tuple[Record, int, int]:
        bench, task = Bench(warm_start.subject(reference_subject()), BenchOptions(), plant), tasks_by_id()["S7"]
        try:
            # A repetition makes fifty calls, and so a hundred entries.
            item = await measured(bench, task, 12)
            device = await plant.device("modbus")
            return recorded(bench, [item]), await device.first(), await device.mark()
        finally:
            await bench.close()

    try:
        record, first, following = loop.run(run())
    finally:
        loop.run(plant.close())
        loop.close()
    assert following > 1200
    assert following - first < 1200
    assert record["items"][0]["status"] == "PASS"
    assert rejudge(record) == []


@pytest.mark.long
def test_a_recovery_trial_without_a_first_success_ends_there(bench_of: Callable[..., Record]) -> None:
    run = bench_of(program(*ROGUE, "not-json"), "R-modbus")
    (item,) = run["items"]
    assert [len(sample["calls"]) for sample in item["samples"]] == [1, 1]
    assert [sample["ok"] for sample in item["samples"]] == [False, False]
    assert rejudge(run) == []
