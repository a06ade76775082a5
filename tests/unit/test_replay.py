"""Judging again, on a history that was written by hand: one repetition of M3, a write and a read back."""

from __future__ import annotations

import copy
import hashlib
import json
import random
import struct
from collections.abc import Callable
from dataclasses import asdict
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pytest_otmcp.plant.mock_device import MockDevice
from pytest_otmcp.protocols.modbus.entries import points
from pytest_otmcp.protocols.modbus.proof import PROOF
from pytest_otmcp.record.images import Images, keep_image, restore_image
from pytest_otmcp.record.reader import StoredRun
from pytest_otmcp.record.schema import Call, Run, check
from pytest_otmcp.replay.player import Clock, RecordedRepetition, ReplayItemState
from pytest_otmcp.replay.rejudge import rejudge
from pytest_otmcp.replay.reply import recorded_reply, restored_bindings
from pytest_otmcp.subject import reference_subject
from pytest_otmcp.subject.model import Answering, Binding, OutputRule
from pytest_otmcp.suite.catalogue import suite_digest, tasks_by_id
from pytest_otmcp.trial.adapter_under_test import AdapterUnderTest, BenchOptions
from pytest_otmcp.trial.stored import KEPT_OF_A_FRAME

from ..stored_runs import run_of
from .samples import finding

Item = dict[str, Any]

BEGIN_NS = 10**16
READ_SEQ = 7
"""Sequence number of the second call's request."""

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
            "started_at": "2026-11-21T07:03:43.011Z",
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
        "inputs": inputs,
        "group": group,
        "sent_ns": BEGIN_NS + group * 10**7,
        "received_ns": BEGIN_NS + group * 10**7 + 10**6,
    }


def pdu(kind: str, function: int, *, address: int = 1, values: list[int] | None = None, **_: Any) -> str:
    """Return the PDU of a request or response of function 3 or 6 in hexadecimal digits."""
    if function == 3 and kind == "response":
        words = values or []
        return struct.pack(f">BB{len(words)}H", 3, 2 * len(words), *words).hex()
    [word] = [1] if function == 3 else values or [40]
    return struct.pack(">BHH", function, address, word).hex()


def entry(seq: int, kind: str, function: int, **fields: Any) -> dict[str, Any]:
    direction = "in" if kind == "request" else "out"
    group = 1 if seq < READ_SEQ else 2
    at_ns = BEGIN_NS + group * 10**7 + seq * 10**4
    common = {"seq": seq, "t_ns": at_ns, "connection": 1, "direction": direction, "kind": kind}
    asks = {"origin": "client", "request": kind == "request", "state_changing": False}
    asks["answers"] = None if kind == "request" else seq - 1
    about = {"unit": 1, "transaction_id": seq, "function": function, "pdu": pdu(kind, function, **fields), **fields}
    return {"protocol": "modbus", **common, **asks, **about}


CONNECTED = {**entry(0, "connected", 6), "t_ns": BEGIN_NS - 10**6, "answers": None}


def adapter() -> dict[str, Any]:
    """Return what a record says of the reference adapter; nothing is started for it."""
    under_test = AdapterUnderTest(reference_subject().adapters["modbus"], "rw", MockDevice("modbus"), BenchOptions())
    under_test.used = {"write_holding": None, "read_holding": None}
    return {**under_test.facts(), "tools": 17}


DEVICE = {
    "protocol": "modbus",
    "variant": "rw",
    "worker": "main",
    "endpoints": [{"name": "modbus", "kind": "tcp", "host": "127.0.0.1", "port": 502, "path": ""}],
    "placeholders": {"host": "127.0.0.1", "port": "502", "url": "modbus+tcp://127.0.0.1:502"},
    "first": 0,
}


def look(at_ns: int, **seen: Any) -> dict[str, Any]:
    return {"at": "modbus", "asked_ns": at_ns, "seen_ns": at_ns + 1000, **seen}


def proof() -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the calls and looks that prove the session before its first write: random values of register 1, 13 bits each."""
    rng = random.Random(f"0/M3/warmup/0/proof/1/{DEVICE['placeholders']['url']}")
    unbound, way = PROOF.ways[:2]
    unbound.ask(rng)
    calls, looks = [], []
    now_ns = BEGIN_NS - 9000
    for number in range(3):
        [*_, poked] = way.ask(rng).pokes
        read = call("read_holding", READ, {"address": 1, "count": 1}, {"values": [poked["values"][1]]}, group=number)
        read["envelope"]["meta"]["latency_ms"] = 0.0
        calls.append(
            {**read, "role": "setup", "latency_ms": 0.0001, "sent_ns": now_ns + 1100, "received_ns": now_ns + 1200}
        )
        looks += [look(now_ns, journal=1), look(now_ns + 1300, journal=1)]
        now_ns += 2400
    return calls, [*looks, look(now_ns, end=1)]


def item() -> Item:
    """Return M3 as a run without fault would have it; its first repetition writes 40 to register 1."""
    task = tasks_by_id()["M3"]
    cells = [0, 7, 0]
    before = {"points": points("holding_registers", 0, cells)}
    calls = [
        call("write_holding", WRITE, {"address": 1, "value": 40}, {"address": 1, "value": 40}, group=1),
        call("read_holding", READ, {"address": 1, "count": 1}, {"values": [40]}, group=2),
    ]
    write = {"address": 1, "quantity": 1, "values": [40], "state_changing": True}
    entries = [
        entry(5, "request", 6, **write),
        entry(6, "response", 6),
        entry(READ_SEQ, "request", 3, address=1, quantity=1, state_changing=False),
        entry(8, "response", 3, values=[40]),
    ]
    changes = [[["points", "1/holding_registers/1"], 40]]
    begin = BEGIN_NS + 10**8

    def part(number: int) -> dict[str, Any]:
        """Return the calls, entries and looks of the warm-up (0) or of the repetition (1)."""
        shift = number * 10**8
        moved = [
            {**one, "sent_ns": one["sent_ns"] + shift, "received_ns": one["received_ns"] + shift}
            for one in copy.deepcopy(calls)
        ]
        seen = copy.deepcopy(entries)
        for one in seen:
            one["seq"] -= 4 * (1 - number)
            one["t_ns"] += shift
            one["answers"] = None if one["answers"] is None else one["answers"] - 4 * (1 - number)
        looks = [
            look(BEGIN_NS + shift, **({"changes": []} if number else {"image": before})),
            look(BEGIN_NS + 15 * 10**6 + shift, changes=changes),
            look(BEGIN_NS + 10**8 - 10**6 + shift, journal=5 + 4 * number),
            look(BEGIN_NS + 10**8 - 10**5 + shift, end=5 + 4 * number),
        ]
        return {"calls": moved, "device": seen, "observations": looks}

    warm_up, repetition = part(0), part(1)
    for one in warm_up["calls"]:
        one["role"] = "warmup"
    proof_calls, proof_looks = proof()
    warm_up["calls"] += proof_calls
    warm_up["calls"].sort(key=lambda one: one["sent_ns"])
    warm_up["observations"] = proof_looks + warm_up["observations"]
    return {
        "id": "M3",
        "suite": task.suite,
        "family": task.family,
        "title": task.title,
        "capabilities": list(task.capabilities),
        "requirements": list(task.requirements),
        "status": "PASS",
        "reason": None,
        "planned": 1,
        "worker": "main",
        "started_at": "2026-11-21T07:03:43.000Z",
        "finished_at": "2026-11-21T07:03:44.000Z",
        "began_ns": BEGIN_NS - 10**6,
        "ended_ns": begin + 10**9,
        "findings": [],
        "requirement_rows": [],
        "timing_ms": {},
        "devices": {
            "modbus": {
                "device": "modbus",
                "begin": 1,
                "asked_ns": BEGIN_NS - 10**5,
                "seen_ns": BEGIN_NS - 10**4,
                "accepting_ns": BEGIN_NS - 10**9,
                "starts": 0,
                "before": [{name: value for name, value in CONNECTED.items() if name != "protocol"}],
                "quiet": False,
                "session": [1, 0],
            }
        },
        "around": [{"role": "warmup", **warm_up}],
        "sessions": [],
        "ended": None,
        "samples": [{"repetition": 0, "ok": True, "duration_ms": 2.0, "findings": [], "phases": None, **repetition}],
    }


def run(*items: Item, digest: str | None = None, **settings: Any) -> StoredRun:
    record = run_of(
        items,
        adapters={"modbus": adapter()},
        devices={"modbus": DEVICE},
        suite_digest=digest or suite_digest(),
        repetitions={"normal": items[0]["planned"]},
    )
    record["settings"].update(settings)  # type: ignore[typeddict-item]
    # The record is checked as if it was read from a file.
    return StoredRun.of(check(json.loads(json.dumps(record)), Run, "the record"))


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
    changed["samples"][0]["device"][0] |= {"values": [41], "pdu": "0600010029"}


def contradict_the_bytes(changed: Item) -> None:
    changed["samples"][0]["device"][0]["pdu"] = "00"


def lose_the_bytes(changed: Item) -> None:
    del changed["samples"][0]["device"][0]["pdu"]


def answer_a_later_request(changed: Item) -> None:
    changed["samples"][0]["device"][1]["answers"] = READ_SEQ


def invent_a_digest_of_frames(changed: Item) -> None:
    changed["samples"][0]["calls"][0]["frames_sha256"] = "0" * 64


def remove_a_pair_and_number_again(changed: Item) -> None:
    sample = changed["samples"][0]
    sample["device"] = [
        {**one, "seq": one["seq"] - 2, "answers": one["answers"] and one["answers"] - 2} for one in sample["device"][2:]
    ]
    sample["observations"][2]["journal"] = sample["observations"][3]["end"] = 7


def change_an_image(changed: Item) -> None:
    changed["samples"][0]["observations"][1]["changes"][0][1] = 39


def touch_another_cell(changed: Item) -> None:
    changed["samples"][0]["observations"][1]["changes"].append([["points", "1/holding_registers/2"], 1])


def break_an_image(changed: Item) -> None:
    changed["samples"][0]["observations"][1]["changes"][0][0] = ["points", "9/holding_registers/1", "x"]


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
    sample = changed["samples"][0]
    late = sample["calls"][1]
    late["received_ns"], late["latency_ms"] = late["sent_ns"] + 6 * 10**9, 6000.0
    for seen in sample["observations"][2:]:
        seen["asked_ns"] += 6 * 10**9
        seen["seen_ns"] += 6 * 10**9
    changed["ended_ns"] += 6 * 10**9


def shorten_a_latency(changed: Item) -> None:
    changed["samples"][0]["calls"][0]["latency_ms"] = 0.9


def shorten_a_duration(changed: Item) -> None:
    changed["samples"][0]["duration_ms"] = 1.9


def flip_ok(changed: Item) -> None:
    changed["samples"][0]["ok"] = False


def invent_a_finding(changed: Item) -> None:
    changed["samples"][0]["findings"].append(finding("wrote", "it wrote"))


def fail_the_item(changed: Item) -> None:
    changed["status"] = "FAIL"


def claim_nothing(changed: Item) -> None:
    changed["status"] = "NOT_APPLICABLE"


def lose_the_repetition(changed: Item) -> None:
    changed["samples"] = []


def lose_the_warm_up(changed: Item) -> None:
    changed["around"] = []


def change_the_warm_up(changed: Item) -> None:
    changed["around"][0]["calls"][-1]["envelope"]["data"]["values"] = [39]


def change_a_value_that_proved_the_session(changed: Item) -> None:
    changed["around"][0]["calls"][0]["envelope"]["data"]["values"] = [39]


def claim_a_proof(changed: Item) -> None:
    proof = {"proven": "read_holding", "preferred": "read_holding", "refused": None}
    changed["devices"]["modbus"]["proof"] = proof


def add_noise(changed: Item) -> None:
    facts = {"protocol": "modbus", "overflow": False, "died": None, "overstayed": None, "unknown_ids": []}
    changed["sessions"].append({"inspection": 1, **facts, "stray_lines": 1, "first_stray": "hello"})


def forget_what_came_before(changed: Item) -> None:
    changed["devices"]["modbus"]["before"] = []


def move_the_sequence_numbers(changed: Item) -> None:
    shift(changed, seq=1000)


def say_that_nobody_called_it(changed: Item) -> None:
    changed["devices"]["modbus"]["quiet"] = True


def forget_a_restart(changed: Item) -> None:
    changed["devices"]["modbus"]["starts"] = 1


def stop_the_devices_clock(changed: Item) -> None:
    for one in changed["samples"][0]["device"]:
        one["t_ns"] = 0


def deliver_an_hour_late(changed: Item) -> None:
    for one in changed["samples"][0]["device"]:
        one["t_ns"] += 3600 * 10**9


def reorder_the_entries(changed: Item) -> None:
    first, second = changed["samples"][0]["device"][:2]
    first["t_ns"], second["t_ns"] = second["t_ns"], first["t_ns"]


def take_the_repetition_of_another_day(changed: Item) -> None:
    sample = changed["samples"][0]
    move(sample, ns=-86400 * 10**9)


def look_before_the_call(changed: Item) -> None:
    early = changed["samples"][0]["observations"][1]
    early["asked_ns"] -= 10**8
    early["seen_ns"] -= 10**8


def go_on_after_the_end(changed: Item) -> None:
    changed["ended_ns"] = changed["began_ns"] + 1


def name_another_device(changed: Item) -> None:
    changed["devices"]["modbus"]["device"] = "modbus@ro"


def change_the_title(changed: Item) -> None:
    changed["title"] = "Read a register."


SENTENCES = {
    remove_an_entry: "M3 repetition 1: the journal of modbus should have the entries 5 to 8, it has [5, 7, 8]",
    remove_the_last_entry: "M3 repetition 1: the journal of modbus should have the entries 5 to 8, it has [5, 6, 7]",
    double_an_entry: "M3 repetition 1: the journal of modbus should have the entries 5 to 8, it has [5, 5, 6, 7]",
    add_an_entry: "M3 repetition 1: the journal of modbus has 1 entries beyond its end",
    change_an_entry: "M3 repetition 1: the stored history shows 'the device should have seen one write of [40]",
    remove_a_pair_and_number_again: "one write of [40] to holding_registers 1, it saw 0' (not_written_once), the record",
    contradict_the_bytes: "M3 repetition 1: entry 5 of the journal of modbus says function 6, its PDU says 0",
    lose_the_bytes: "M3 repetition 1: entry 5 of the journal of modbus has no PDU but None",
    answer_a_later_request: "M3 repetition 1: entry 6 of the journal of modbus answers the entry 7",
    invent_a_digest_of_frames: f"M3 repetition 1: {WRITE} has a digest of frames, and no frames",
    change_an_image: "M3 repetition 1: the stored history shows '1/holding_registers/1 should hold 40, the device",
    touch_another_cell: "'1/holding_registers/2 should hold 0, the device holds 1' (device_differs), the record says",
    break_an_image: "M3 repetition 1: it cannot be judged (KeyError('9/holding_registers/1') at images.py:",
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
    forget_what_came_before: "M3: the journal of modbus should have the entries 0 to 0, it has []",
    move_the_sequence_numbers: "M3: the journal of modbus should have the entries 0 to 1000, it has [1000]",
    say_that_nobody_called_it: "M3: modbus was not left alone since the last item that had it",
    forget_a_restart: "M3: modbus was started again 1 time(s) before, the items before show 0",
    stop_the_devices_clock: "M3 repetition 1: entry 5 of the journal of modbus is not of its time: 0 ns is not between",
    deliver_an_hour_late: "M3 repetition 1: entry 5 of the journal of modbus is not of its time",
    reorder_the_entries: "M3 repetition 1: entry 6 of the journal of modbus is not of its time",
    take_the_repetition_of_another_day: "M3 repetition 1: image of modbus is not of its time",
    look_before_the_call: "M3 repetition 1: image of modbus is not of its time",
    go_on_after_the_end: "M3: it went on until 10000000199901000 ns, but ended at 9999999999000001 ns",
    name_another_device: "M3: the run has no device 'modbus@ro' for modbus",
    lose_the_warm_up: "M3: the history ends after 0 repetitions and does not say why",
    change_the_warm_up: "M3: the stored history shows 'warmup: read_multiple_holding_registers(address=1, count=1): values",
    change_a_value_that_proved_the_session: "M3 warmup: journal of modbus is not of its time",
    claim_a_proof: "the items before do not show of the session at modbus that its proof is",
    add_noise: "M3: the stored history shows \"modbus: 1 line(s) on stdout that are no MCP message, the first: 'hello'\"",
    change_the_title: "M3: the stored history shows title",
}


@pytest.mark.parametrize("change", SENTENCES, ids=lambda change: change.__name__)
def test_a_history_that_was_changed_is_found_out(change: Callable[[Item], None]) -> None:
    changed = item()
    change(changed)
    disagreements = rejudge(run(changed))
    assert SENTENCES[change] in "\n".join(disagreements)


def failing() -> Item:
    """Return the same item, but the value read back is another one; the frames of both calls are there."""
    failed = item()
    sample = failed["samples"][0]
    sample["ok"] = False
    sample["calls"][1] |= {"ok": False, "outputs": {"values": [41]}}
    sample["calls"][1]["envelope"]["data"]["values"] = [41]
    message = f"{READ}(address=1, count=1): values should be [40], the reply says [41]"
    sample["findings"] = [finding("wrong_value", message, "RD-001")]
    for one in sample["calls"]:
        text = {"type": "text", "text": json.dumps(one["envelope"])}
        result = {"content": [text], "structuredContent": one["envelope"], "isError": False}
        request, response = "{}", json.dumps({"jsonrpc": "2.0", "id": 1, "result": result})
        one["frames"] = {"request": request, "response": response, "failure": None, "complaint": None, "faults": []}
        one["frames_sha256"] = hashlib.sha256(f"{request}\n{response}".encode()).hexdigest()
    return failed | {"status": "FAIL"}


def test_a_finding_is_confirmed_from_the_frames() -> None:
    assert rejudge(run(failing())) == []


@pytest.mark.parametrize(("member", "value"), [("requirement", "WR-003"), ("cause", "M2"), ("strength", "SHOULD")])
def test_a_finding_that_is_about_something_else_is_found_out(member: str, value: str) -> None:
    # The level of an adapter follows from the requirements that findings cite.
    failed = failing()
    failed["samples"][0]["findings"][0][member] = value
    assert "(wrong_value), the record says nothing of it" in "\n".join(rejudge(run(failed)))


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
    cut["frames"]["response"] = cut["frames"]["response"].ljust(KEPT_OF_A_FRAME) + "… (90000 bytes)"
    assert rejudge(run(failed)) == []
    fault = finding("no_text", f"{WRITE}(address=1, value=40): no text")
    cut["frames"]["faults"].append(fault)
    assert "no text' (no_text), the record says nothing of it" in "\n".join(rejudge(run(failed)))


def test_what_is_kept_of_a_frame_are_bytes() -> None:
    failed = failing()
    cut = failed["samples"][0]["calls"][0]
    cut["frames"]["response"] = "\u00e9" * (KEPT_OF_A_FRAME // 2) + "\u2026 (90000 bytes)"
    assert rejudge(run(failed)) == []


def test_frames_that_were_not_cut_off_must_be_those_of_their_digest() -> None:
    failed = failing()
    failed["samples"][0]["calls"][0]["frames"]["response"] += " "
    assert rejudge(run(failed)) == [f"M3 repetition 1: the frames of {WRITE} are not those of their digest"]


def test_frames_without_their_secret_are_believed() -> None:
    failed = failing()
    redacted = failed["samples"][0]["calls"][0]["frames"]
    redacted["request"] = '{"password": "[redacted]"}'
    assert rejudge(run(failed)) == []


def elsewhere(record: dict[str, Any]) -> None:
    record["devices"]["modbus"]["endpoints"][0]["host"] = "10.0.0.1"


def under_another_address(record: dict[str, Any]) -> None:
    record["devices"]["modbus"]["placeholders"]["port"] = "1502"


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (elsewhere, "modbus: a device of the kit listens on this machine only, the record says '10.0.0.1'"),
        (under_another_address, "modbus: from its endpoints follows"),
    ],
)
def test_a_device_that_was_elsewhere_is_found_out(change: Callable[[dict[str, Any]], None], sentence: str) -> None:
    device = copy.deepcopy(DEVICE)
    record = {"devices": {"modbus": device}}
    change(record)
    stored = run(item())
    stored.header["devices"].update(record["devices"])  # type: ignore[arg-type]
    assert sentence in "\n".join(rejudge(stored))


def test_a_run_of_another_suite_is_not_judged() -> None:
    assert (
        "judge it again with the version of the kit that made it"
        in rejudge(run(item(), digest="sha256:" + "0" * 64))[0]
    )


def test_less_repetitions_than_demanded_are_found_out() -> None:
    record = run(item(), repetitions={"normal": 30})
    assert rejudge(record) == ["M3: 1 repetitions were planned, the settings demand 30"]


def test_an_item_that_nobody_knows_is_named() -> None:
    assert rejudge(run(item() | {"id": "M99"})) == ["M99: the suite has no such task"]


def test_an_item_is_stopped_for_the_reason_that_is_stored() -> None:
    stopped = item() | {"samples": [], "status": "FAIL", "planned": 3}
    stopped["ended"] = {"fault_of": "subject", "code": "cannot_start", "message": "no such command"}
    stopped["findings"] = [finding("cannot_start", "no such command", "MCP-002")]
    assert rejudge(run(stopped)) == []
    stopped["findings"] = []
    assert "'no such command' (cannot_start), the record says nothing of it" in "\n".join(rejudge(run(stopped)))


def test_what_an_interrupted_item_has_is_judged() -> None:
    interrupted = item() | {"status": "INTERRUPTED", "planned": 9}
    assert rejudge(run(interrupted)) == []
    flip_ok(interrupted)
    assert rejudge(run(interrupted)) == ["M3 repetition 1: the stored history shows ok true, the record says false"]


# -- from item to item ---------------------------------------------------------------------------------------------------


def move(part: dict[str, Any], *, seq: int = 0, ns: int = 0) -> None:
    """Move the calls, entries and looks of a repetition in the journal and in time."""
    for spoken in part["calls"]:
        spoken["sent_ns"] += ns
        spoken["received_ns"] += ns
    for one in part["device"]:
        one["seq"] += seq
        one["t_ns"] += ns
        if one["answers"] is not None:
            one["answers"] += seq
    for seen in part["observations"]:
        seen["asked_ns"] += ns
        seen["seen_ns"] += ns
        for what in {"journal", "end"} & seen.keys():
            seen[what] += seq


def shift(changed: Item, *, seq: int = 0, ns: int = 0) -> None:
    """Move an item in the device's journal and in time, as a forger would who is careful within an item."""
    found = changed["devices"]["modbus"]
    found["begin"] += seq
    for name in ("asked_ns", "seen_ns"):
        found[name] += ns
    for one in found["before"]:
        one["seq"] += seq
        one["t_ns"] += ns
    changed["began_ns"] += ns
    changed["ended_ns"] += ns
    for part in (*changed["around"], *changed["samples"]):
        move(part, seq=seq, ns=ns)


HOUR_NS = 3600 * 10**9


def following() -> Item:
    """Return the same item an hour later; nothing reached the device in between."""
    later = item()
    proven = {"proven": "read_holding", "preferred": "read_holding", "refused": None}
    later["devices"]["modbus"] |= {"before": [], "quiet": True, "proof": proven}
    warm_up = later["around"][0]
    proof_calls, proof_looks = proof()
    warm_up["calls"] = warm_up["calls"][len(proof_calls) :]
    warm_up["observations"] = warm_up["observations"][len(proof_looks) :]
    shift(later, seq=8, ns=HOUR_NS)
    return later


def test_items_of_one_run_follow_one_another() -> None:
    assert rejudge(run(item(), following())) == []


def test_the_order_of_the_items_in_the_file_does_not_matter() -> None:
    assert rejudge(run(following(), item())) == []


def a_write_between() -> Item:
    """Return an item before which a command came although nobody had asked for one; the item says so."""
    later = following()
    late = entry(9, "request", 6, address=1, quantity=1, values=[7], state_changing=True)
    found = later["devices"]["modbus"]
    found["before"] = [{**{name: value for name, value in late.items() if name != "protocol"}}]
    found["before"][0]["t_ns"] = found["asked_ns"] - 10
    found["begin"] += 1
    for part in (*later["around"], *later["samples"]):
        move(part, seq=1)
    message = (
        "modbus: before this item, when nobody called the adapter: "
        "the device should have seen no state-changing request, it saw 1"
    )
    later["findings"] = [finding("wrote", message, "WR-004")]
    return later | {"status": "FAIL"}


def test_what_came_between_two_items_is_judged_again() -> None:
    assert rejudge(run(item(), a_write_between())) == []


def lose_what_came_between(first: Item, second: Item) -> None:
    second["devices"]["modbus"]["before"] = []
    second |= {"status": "PASS", "findings": []}


def close_the_gap(first: Item, second: Item) -> None:
    lose_what_came_between(first, second)
    second["devices"]["modbus"]["begin"] = 9


def say_that_somebody_called(first: Item, second: Item) -> None:
    second["devices"]["modbus"]["quiet"] = False
    second |= {"status": "PASS", "findings": []}


def take_an_item_of_yesterday(first: Item, second: Item) -> None:
    shift(second, ns=-24 * HOUR_NS)


def take_an_item_of_another_hour(first: Item, second: Item) -> None:
    shift(second, ns=HOUR_NS)
    second["devices"]["modbus"]["before"][0]["t_ns"] -= 24 * HOUR_NS


SPLICED = {
    lose_what_came_between: "M3: the journal of modbus should have the entries 9 to 9, it has []",
    close_the_gap: "M3 warmup: the journal of modbus should have the entries 9 to 13, it has [10, 11, 12, 13]",
    say_that_somebody_called: "M3: modbus was left alone since the last item that had it",
    take_an_item_of_yesterday: "M3: modbus was not left alone since the last item that had it",
    take_an_item_of_another_hour: "M3: entry 9 of the journal of modbus is not of its time",
}


@pytest.mark.parametrize("change", SPLICED, ids=lambda change: change.__name__)
def test_items_that_were_not_of_one_run_are_found_out(change: Callable[[Item, Item], None]) -> None:
    first, second = item(), a_write_between()
    change(first, second)
    assert SPLICED[change] in "\n".join(rejudge(run(first, second)))


def test_an_item_that_begins_before_the_one_before_it_has_ended_is_found_out() -> None:
    second = following()
    shift(second, ns=-HOUR_NS + 10**8)
    assert "M3: it began before the item before it had ended" in rejudge(run(item(), second))


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
    kept: Images = {}
    members = [keep_image(kept, "modbus", image) for image in (first, second, first, copy.deepcopy(second))]
    seen: Images = {}
    restored = [restore_image(seen, "modbus", json.loads(json.dumps(dict([member])))) for member in members]
    assert list(map(repr, restored)) == list(map(repr, [first, second, first, second]))


def test_images_of_two_devices_are_kept_apart() -> None:
    kept: Images = {}
    assert [keep_image(kept, name, {"a": 1})[0] for name in ("modbus", "modbus@ro", "modbus")] == [
        "image",
        "image",
        "changes",
    ]


def test_an_output_that_is_called_like_an_input_is_read_again_by_that_input() -> None:
    binding = Binding(
        tool="read_nodes",
        arguments={"nodes": ["$node"]},
        outputs={"value": OutputRule(path='values."$node"')},
        answering=Answering(form="json"),
        when={},
        offset={},
        names={"node": {"ns=2;s=Level": "level"}},
        convert={},
    )
    (case,) = restored_bindings({"read": [asdict(binding)]})["read"] or []
    text = json.dumps({"values": {"level": 7.5, "ns=2;s=Level": 8.5}})
    response = json.dumps({"jsonrpc": "2.0", "id": 1, "result": {"content": [{"type": "text", "text": text}]}})
    request = '{"jsonrpc": "2.0", "id": 1}'
    recorded = {
        "adapter": "opcua",
        "variant": "rw",
        "operation": "read",
        "inputs": {"node": "ns=2;s=Level"},
        "tool": "read_nodes",
        "arguments": {"nodes": ["level"]},
        "sent_ns": 1,
        "received_ns": 2,
        "frames": {"request": request, "response": response, "failure": None, "complaint": None},
        "frames_sha256": hashlib.sha256(f"{request}\n{response}".encode()).hexdigest(),
        "listed": True,
        "native": False,
        "envelope": None,
    }
    reply = recorded_reply(recorded, cases=[case], endpoint={}, deadline_s=5.0)
    assert reply.outputs == {"value": 7.5}


def test_of_equal_calls_at_the_same_time_the_one_that_was_sent_first_is_the_first_of_the_steps() -> None:
    inputs = {"address": 1, "count": 1}
    # In the order of their replies.
    calls = [
        {**call("read_holding", READ, inputs, {"values": [value]}, group=1), "sent_ns": BEGIN_NS + value}
        for value in (3, 1, 2)
    ]
    history = RecordedRepetition(cast("list[Call]", calls), [], Clock(BEGIN_NS))
    at = SimpleNamespace(name="modbus", protocol="modbus", variant="rw")
    asked = [history.call(cast("ReplayItemState", at), "read_holding", inputs, together=True) for _ in calls]
    assert [one["outputs"]["values"] for one in asked] == [[1], [2], [3]]
