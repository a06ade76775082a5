"""Judging again, on a history that was written by hand: one repetition of M3, a write and a read back."""

from __future__ import annotations

import copy
import hashlib
import json
from collections.abc import Callable
from typing import Any

import pytest

from pytest_otmcp.plant.mock_device import MockDevice
from pytest_otmcp.protocols.modbus.entries import points
from pytest_otmcp.record.images import Images, restored_images
from pytest_otmcp.replay.rejudge import rejudge
from pytest_otmcp.subject import reference_subject
from pytest_otmcp.suite.catalogue import suite_digest, tasks_by_id
from pytest_otmcp.trial.adapter_under_test import AdapterUnderTest, BenchOptions
from pytest_otmcp.trial.live_rig import LiveItemState

Item = dict[str, Any]

BEGIN_NS = 10**12
READ, WRITE = "read_multiple_holding_registers", "write_register"


def envelope(operation: str, data: dict[str, Any]) -> dict[str, Any]:
    return {
        "success": True,
        "data": data,
        "error": None,
        "meta": {
            "schema": "otmcp/1.0",
            "protocol": "modbus-tcp",
            "operation": f"modbus.{operation}",
            "endpoint": "modbus+tcp://127.0.0.1:502",
            "started_at": "2026-01-01T00:00:00.000Z",
            "latency_ms": 0.5,
            "attempts": 1,
            "request_id": "r",
            "source": "device",
            "connection": {"state": "connected", "generation": 1},
            "trace": {},
        },
    }


def call(operation: str, tool: str, inputs: dict[str, Any], data: dict[str, Any], *, group: int) -> dict[str, Any]:
    outputs = {name: value for name, value in data.items() if name in ("value", "values")}
    return {
        "role": "task",
        "adapter": "modbus",
        "variant": "rw",
        "operation": operation,
        "tool": tool,
        "arguments": dict(inputs),
        "latency_ms": 1.0,
        "ok": True,
        "envelope": envelope(operation, data),
        "native": True,
        "listed": True,
        "outputs": outputs,
        "error_code": None,
        "frames_sha256": "0" * 64,
        "inputs": inputs,
        "group": group,
        "sent_ns": BEGIN_NS + group * 10**7,
        "received_ns": BEGIN_NS + group * 10**7 + 10**6,
    }


def entry(seq: int, kind: str, function: int, **fields: Any) -> dict[str, Any]:
    direction = "in" if kind == "request" else "out"
    common = {"seq": seq, "t_ns": BEGIN_NS + seq, "connection": 1, "direction": direction, "kind": kind}
    asks = {"origin": "client", "request": kind == "request", "state_changing": False}
    asks["answers"] = None if kind == "request" else seq - 1
    return {"protocol": "modbus", **common, **asks, "unit": 1, "transaction_id": seq, "function": function, **fields}


def station() -> dict[str, Any]:
    """What an item keeps of the reference adapter's station: nothing is started for it."""
    adapter = reference_subject().adapters["modbus"]
    place = LiveItemState(AdapterUnderTest(adapter, "rw", MockDevice("modbus"), BenchOptions()))
    place.begin = 1
    place.used = {"write_holding": None, "read_holding": None}
    return place.as_record()


def item() -> Item:
    """M3 as a run without fault would have it; its first repetition writes 40 to register 1."""
    task = tasks_by_id()["M3"]
    cells = [0, 7, 0]
    before = {"points": points("holding_registers", 0, cells)}
    after = {"points": points("holding_registers", 0, [0, 40, 0])}
    images = Images()
    calls = [
        call("write_holding", WRITE, {"address": 1, "value": 40}, {"address": 1, "value": 40}, group=1),
        call("read_holding", READ, {"address": 1, "count": 1}, {"values": [40]}, group=2),
    ]
    write = {"address": 1, "quantity": 1, "values": [40], "state_changing": True}
    entries = [
        entry(5, "request", 6, **write),
        entry(6, "response", 6),
        entry(7, "request", 3, address=1, quantity=1, state_changing=False),
        entry(8, "response", 3, values=[40]),
    ]
    first, second = images.keep("modbus", before), images.keep("modbus", after)
    observations = [
        {"at": "modbus", "image": first},
        {"at": "modbus", "image": second},
        {"at": "modbus", "journal": 9},
        {"at": "modbus", "end": 9},
    ]
    warm_up = [{**one, "seq": one["seq"] - 4} for one in entries]
    return {
        "id": "M3",
        "suite": task.suite,
        "family": task.family,
        "title": task.title,
        "requirements": list(task.requirements),
        "status": "PASS",
        "reason": None,
        "planned": 1,
        "samples": [
            {
                "repetition": 0,
                "ok": True,
                "duration_ms": 2.0,
                "calls": calls,
                "device": entries,
                "observations": observations,
                "findings": [],
                "phases": None,
            }
        ],
        "other_calls": [{**one, "role": "warmup"} for one in copy.deepcopy(calls)],
        "other_device": warm_up,
        "findings": [],
        "timing_ms": {},
        "history": {
            "stations": [station()],
            "images": images.kept,
            "sessions": [],
            "around": [
                {
                    "role": "warmup",
                    "calls": 2,
                    "entries": 4,
                    "observations": [
                        {"at": "modbus", "image": first},
                        {"at": "modbus", "image": second},
                        {"at": "modbus", "journal": 5},
                        {"at": "modbus", "end": 5},
                    ],
                }
            ],
            "ended": None,
        },
    }


def run(*items: Item, digest: str | None = None) -> dict[str, Any]:
    # As if read from a file.
    record: dict[str, Any] = json.loads(
        json.dumps(
            {
                "kit": {"suite_digest": digest or suite_digest()},
                "subject": {"adapters": {"modbus": {"unclaimed": {}, "recovery": "same_session"}}},
                "settings": {"seed": 0, "time_scale": 1.0, "repetitions": {"normal": items[0]["planned"]}},
                "items": items,
            }
        )
    )
    return record


def test_a_judgement_that_follows_from_its_history_is_confirmed() -> None:
    assert rejudge(run(item())) == []


def remove_an_entry(changed: Item) -> None:
    del changed["samples"][0]["device"][1]


def remove_the_last_entry(changed: Item) -> None:
    del changed["samples"][0]["device"][-1]


def double_an_entry(changed: Item) -> None:
    changed["samples"][0]["device"].insert(1, changed["samples"][0]["device"][0])


def add_an_entry(changed: Item) -> None:
    changed["samples"][0]["device"].append(entry(9, "request", 6, state_changing=True))


def change_an_entry(changed: Item) -> None:
    changed["samples"][0]["device"][0]["values"] = [41]


def remove_a_pair_and_number_again(changed: Item) -> None:
    sample = changed["samples"][0]
    sample["device"] = [{**one, "seq": one["seq"] - 2} for one in sample["device"][2:]]
    sample["observations"][2:] = [{"at": "modbus", "journal": 7}, {"at": "modbus", "end": 7}]


def change_an_image(changed: Item) -> None:
    changed["history"]["images"][1]["changes"][0][1] = 39


def touch_another_cell(changed: Item) -> None:
    changed["history"]["images"][1]["changes"].append([["points", "1/holding_registers/2"], 1])


def break_an_image(changed: Item) -> None:
    changed["history"]["images"][1]["changes"][0][0] = ["points", "9/holding_registers/1", "x"]


def change_a_value_that_was_read(changed: Item) -> None:
    changed["samples"][0]["calls"][1]["envelope"]["data"]["values"] = [39]


def change_an_output(changed: Item) -> None:
    changed["samples"][0]["calls"][1]["outputs"]["values"] = [41]


def lose_a_member_of_the_envelope(changed: Item) -> None:
    del changed["samples"][0]["calls"][0]["envelope"]["meta"]["endpoint"]


def change_what_was_asked(changed: Item) -> None:
    changed["samples"][0]["calls"][0]["inputs"]["value"] = 41


def change_the_arguments(changed: Item) -> None:
    changed["samples"][0]["calls"][0]["arguments"]["value"] = 41


def remove_a_call(changed: Item) -> None:
    del changed["samples"][0]["calls"][1]


def add_a_call(changed: Item) -> None:
    changed["samples"][0]["calls"].append({**changed["samples"][0]["calls"][1], "group": 3})


def answer_late(changed: Item) -> None:
    late = changed["samples"][0]["calls"][0]
    late["received_ns"], late["latency_ms"] = late["sent_ns"] + 6 * 10**9, 6000.0


def shorten_a_latency(changed: Item) -> None:
    changed["samples"][0]["calls"][0]["latency_ms"] = 0.9


def shorten_a_duration(changed: Item) -> None:
    changed["samples"][0]["duration_ms"] = 1.9


def flip_ok(changed: Item) -> None:
    changed["samples"][0]["ok"] = False


def invent_a_finding(changed: Item) -> None:
    changed["samples"][0]["findings"].append({"code": "wrote", "message": "it wrote"})


def fail_the_item(changed: Item) -> None:
    changed["status"] = "FAIL"


def claim_nothing(changed: Item) -> None:
    changed["status"] = "NOT_APPLICABLE"


def lose_the_repetition(changed: Item) -> None:
    changed["samples"] = []


def lose_the_warm_up(changed: Item) -> None:
    changed["history"]["around"] = []


def change_the_warm_up(changed: Item) -> None:
    changed["other_calls"][1]["envelope"]["data"]["values"] = [39]


def add_noise(changed: Item) -> None:
    facts = {"protocol": "modbus", "overflow": False, "died": None, "unknown_ids": []}
    changed["history"]["sessions"].append({"inspection": 1, **facts, "stray_lines": 1, "first_stray": "hello"})


def give_it_more_time(changed: Item) -> None:
    changed["history"]["stations"].append({**changed["history"]["stations"][0], "deadline_s": 60.0})


def take_a_claim_back(changed: Item) -> None:
    changed["history"]["stations"][0]["unclaimed"] = ["write_holding"]


def read_the_output_elsewhere(changed: Item) -> None:
    again = copy.deepcopy(changed["history"]["stations"][0])
    again["bindings"]["read_holding"][0]["outputs"]["values"]["path"] = "[`40`]"
    changed["history"]["stations"].append(again)


def change_the_title(changed: Item) -> None:
    changed["title"] = "Read a register."


SENTENCES = {
    remove_an_entry: "M3 repetition 1: the journal of modbus should have the entries 5 to 8, it has [5, 7, 8]",
    remove_the_last_entry: "M3 repetition 1: the journal of modbus should have the entries 5 to 8, it has [5, 6, 7]",
    double_an_entry: "M3 repetition 1: the journal of modbus should have the entries 5 to 8, it has [5, 5, 6, 7]",
    add_an_entry: "M3 repetition 1: the journal of modbus has 1 entries beyond its end",
    change_an_entry: "M3 repetition 1: the stored history shows 'the device should have seen one write of [40]",
    remove_a_pair_and_number_again: "one write of [40] to holding_registers 1, it saw 0' (not_written_once), the record",
    change_an_image: "M3 repetition 1: the stored history shows '1/holding_registers/1 should hold 40, the device",
    touch_another_cell: "'1/holding_registers/2 should hold 0, the device holds 1' (device_differs), the record says",
    break_an_image: "M3: the images of the devices cannot be restored (KeyError('9/holding_registers/1'))",
    change_a_value_that_was_read: "values should be [40], the reply says [39]' (wrong_value), the record says nothing",
    change_an_output: f"M3 repetition 1, call 2 ({READ}): the stored history shows outputs",
    lose_a_member_of_the_envelope: "meta: 'endpoint' is a required property\" (envelope_schema), the record says nothing",
    change_what_was_asked: "M3 repetition 1: the steps ask for modbus write_holding(address=1, value=40), the history has",
    change_the_arguments: "M3 repetition 1: write_holding is performed by write_register with {'address': 1, 'value': 40}",
    remove_a_call: "M3 repetition 1: the steps ask for modbus read_holding(address=1, count=1), the history has no further",
    add_a_call: "M3 repetition 1: the history has 1 call(s) more than the steps make",
    answer_late: "answered after 6000 ms, deadline 5 s' (deadline_missed), the record says nothing of it",
    shorten_a_latency: f"M3 repetition 1, call 1 ({WRITE}): the stored history shows latency_ms 1.0, the record says 0.9",
    shorten_a_duration: "M3 repetition 1: the stored history shows duration_ms 2.0, the record says 1.9",
    flip_ok: "M3 repetition 1: the stored history shows ok true, the record says false",
    invent_a_finding: "M3 repetition 1: the record says 'it wrote' (wrote), the stored history does not show it",
    fail_the_item: 'M3: the stored history shows status "PASS", the record says "FAIL"',
    claim_nothing: "M3: the record says NOT_APPLICABLE, the subject claims modbus.write_holding and modbus.read_holding",
    lose_the_repetition: "M3: the history ends after 0 repetitions and does not say why",
    lose_the_warm_up: "M3: the history ends after 1 repetitions and does not say why",
    change_the_warm_up: "M3: the stored history shows 'warmup: read_multiple_holding_registers(address=1, count=1): values",
    add_noise: "M3: the stored history shows \"modbus: 1 line(s) on stdout that are no MCP message, the first: 'hello'\"",
    give_it_more_time: "M3: deadline_s is 60.0, with M3 it is 5.0",
    take_a_claim_back: 'M3: unclaimed is ["write_holding"], with the subject it is []',
    read_the_output_elsewhere: "M3: the binding of read_holding is [",
    change_the_title: "M3: the stored history shows title",
}


@pytest.mark.parametrize("change", SENTENCES, ids=lambda change: change.__name__)
def test_a_history_that_was_changed_is_found_out(change: Callable[[Item], None]) -> None:
    changed = item()
    change(changed)
    disagreements = rejudge(run(changed))
    assert SENTENCES[change] in "\n".join(disagreements)


def failing() -> Item:
    """The same, but the register read back is another one; the frames of both calls are there."""
    failed = item()
    sample = failed["samples"][0]
    sample["ok"] = False
    sample["calls"][1] |= {"ok": False, "outputs": {"values": [41]}}
    sample["calls"][1]["envelope"]["data"]["values"] = [41]
    sample["findings"] = [
        {"code": "wrong_value", "message": f"{READ}(address=1, count=1): values should be [40], the reply says [41]"}
    ]
    for one in sample["calls"]:
        text = {"type": "text", "text": json.dumps(one["envelope"])}
        result = {"content": [text], "structuredContent": one["envelope"], "isError": False}
        request, response = "{}", json.dumps({"jsonrpc": "2.0", "id": 1, "result": result})
        one["frames"] = {"request": request, "response": response, "failure": None, "complaint": None, "faults": []}
        one["frames_sha256"] = hashlib.sha256(f"{request}\n{response}".encode()).hexdigest()
    return failed | {"status": "FAIL"}


def test_a_finding_is_confirmed_from_the_frames() -> None:
    assert rejudge(run(failing())) == []


def test_a_finding_that_was_deleted_is_found_out() -> None:
    failed = failing()
    failed["samples"][0] |= {"findings": [], "ok": True}
    disagreements = rejudge(run(failed | {"status": "PASS"}))
    assert disagreements[0] == "M3 repetition 1: the stored history shows ok false, the record says true"
    assert (
        "values should be [40], the reply says [41]' (wrong_value), the record says nothing of it" in disagreements[1]
    )


def test_an_envelope_that_its_frames_do_not_hold_is_found_out() -> None:
    failed = failing()
    failed["samples"][0]["calls"][1]["envelope"]["data"]["values"] = [40]
    disagreements = rejudge(run(failed))
    assert len(disagreements) == 1
    assert disagreements[0].startswith(f"M3 repetition 1, call 2 ({READ}): the stored history shows envelope")


def test_frames_that_were_cut_off_are_believed_with_their_faults() -> None:
    failed = failing()
    sample = failed["samples"][0]
    cut = sample["calls"][0]
    cut["frames"]["response"] = cut["frames"]["response"][:100] + "… (90000 bytes)"
    assert rejudge(run(failed)) == []
    fault = {
        "code": "no_text",
        "message": f"{WRITE}(address=1, value=40): no text",
        "requirement": None,
        "evidence": None,
    }
    cut["frames"]["faults"].append(fault)
    assert "no text' (no_text), the record says nothing of it" in "\n".join(rejudge(run(failed)))


def test_a_run_of_another_suite_is_not_judged() -> None:
    assert "judge it again with the version of the kit that made it" in rejudge(run(item(), digest="sha256:0"))[0]


def test_less_repetitions_than_demanded_are_found_out() -> None:
    record = run(item())
    record["settings"]["repetitions"]["normal"] = 30
    assert rejudge(record) == ["M3: 1 repetitions were planned, the settings demand 30"]


def test_an_item_that_nobody_knows_is_named() -> None:
    assert rejudge(run(item() | {"id": "M99"})) == ["M99: the suite has no such task"]


def test_an_item_is_stopped_for_the_reason_that_is_stored() -> None:
    stopped = item() | {"samples": [], "status": "FAIL", "planned": 3}
    stopped["history"]["ended"] = {"fault_of": "subject", "code": "cannot_start", "message": "no such command"}
    stopped["findings"] = [{"code": "cannot_start", "message": "no such command"}]
    assert rejudge(run(stopped)) == []
    stopped["findings"] = []
    assert "'no such command' (cannot_start), the record says nothing of it" in "\n".join(rejudge(run(stopped)))


def test_what_an_interrupted_item_has_is_judged() -> None:
    interrupted = item() | {"status": "INTERRUPTED", "planned": 9}
    assert rejudge(run(interrupted)) == []
    flip_ok(interrupted)
    assert rejudge(run(interrupted)) == ["M3 repetition 1: the stored history shows ok true, the record says false"]


def test_a_history_of_another_shape_is_refused_in_a_sentence() -> None:
    broken = item()
    del broken["history"]["around"]
    assert rejudge(run(broken)) == ["M3: the stored history cannot be read (KeyError('around'))"]


@pytest.mark.parametrize(
    "change",
    [
        lambda image: image["cells"].__setitem__(1, 9),
        lambda image: image["cells"].append(3),
        lambda image: image["flags"].__setitem__("on", 1),
        lambda image: image.pop("flags"),
        lambda image: image["nodes"].__setitem__("new", {"value": 1.0}),
        lambda image: image["nodes"]["a"].__setitem__("value", 1.0),
    ],
)
def test_images_come_back_as_they_were(change: Callable[[dict[str, Any]], Any]) -> None:
    first = {"cells": [1, 2], "flags": {"on": True}, "nodes": {"a": {"value": 1}}}
    second = copy.deepcopy(first)
    change(second)
    images = Images()
    kept = [images.keep("modbus", image) for image in (first, second, first, copy.deepcopy(second))]
    assert kept == [0, 1, 0, 1]
    assert list(map(repr, restored_images(images.kept))) == list(map(repr, [first, second]))


def test_images_of_two_devices_are_kept_apart() -> None:
    images = Images()
    assert [images.keep("modbus", {"a": 1}), images.keep("modbus@ro", {"a": 1})] == [0, 1]
