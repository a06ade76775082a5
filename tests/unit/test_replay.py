"""Judging again: histories of golden records that a forger has changed in more than one place, and what is believed of frames.

Changes of one member are made by ``tests/golden/test_forgeries``.
"""

from __future__ import annotations

import copy
import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pytest_otmcp.record.images import Images, keep_image, restore_image
from pytest_otmcp.record.reader import StoredRun
from pytest_otmcp.record.schema import Call, Run
from pytest_otmcp.replay.player import Clock, RecordedRepetition, ReplayItemState
from pytest_otmcp.replay.rejudge import differences, rejudge
from pytest_otmcp.replay.reply import recorded_reply, restored_bindings
from pytest_otmcp.subject.model import Answering, Binding, OutputRule
from pytest_otmcp.trial.stored import KEPT_OF_A_FRAME

from ..golden.files import recorded
from ..plugin.places import Record, call, journal, moved, sample
from .samples import finding

SECOND_NS = 10**9
READ = "read_multiple_holding_registers"


@pytest.fixture
def good() -> Record:
    """Return a run of M3, which writes 40 to register 1 and reads it back, and of M4, which must not write."""
    return golden("honest-modbus-reads-back-after-writing", 2)


@pytest.fixture
def failed() -> Record:
    """Return a run of M3 whose adapter reads another value back; the frames of its calls are there."""
    return golden("defect-MU-07", 1)


def golden(name: str, count: int) -> Record:
    """Return the first items of a golden record."""
    run: Record = recorded(name)
    return run | {"items": run["items"][:count]}


def judged(run: Record) -> list[str]:
    return list(map(str, differences(StoredRun.of(cast(Run, run)))))


def test_a_history_that_nobody_has_changed_is_confirmed(good: Record, failed: Record) -> None:
    assert judged(good) == []
    assert judged(failed) == []


def test_what_excuses_a_late_answer_is_read_from_the_record(good: Record) -> None:
    answer_late(good)
    call(good, "M3", 1)["starved_ns"] = 2 * SECOND_NS
    assert "deadline_missed" not in "\n".join(judged(good))


# -- changes in more than one place ------------------------------------------------------------------------------------------


def remove_a_write_and_number_again(run: Record) -> None:
    entries = journal(run, "M3")
    del entries[:2]
    for one in entries:
        one["seq"] -= 2
        one["answers"] = one["answers"] and one["answers"] - 2
    for seen in sample(run, "M3")["observations"]:
        for name in {"journal", "end"} & seen.keys():
            seen[name] -= 2


def answer_late(run: Record) -> None:
    late = call(run, "M3", 1)
    late["received_ns"] += 6 * SECOND_NS
    for seen in sample(run, "M3")["observations"][2:]:
        seen["asked_ns"] += 6 * SECOND_NS
        seen["seen_ns"] += 6 * SECOND_NS


def change_the_value_of_a_write(run: Record) -> None:
    journal(run, "M3")[0] |= {"values": [41], "pdu": "0600010029"}


def take_an_item_of_yesterday(run: Record) -> None:
    moved(run["items"][1], ns=-24 * 3600 * SECOND_NS)


def begin_before_the_item_before_has_ended(run: Record) -> None:
    first, second = run["items"]
    second["began_ns"] = first["ended_ns"] - 1


FORGED: dict[Callable[[Record], None], str] = {
    remove_a_write_and_number_again: "the device should have seen one write of [40] to holding_registers 1, it saw 0",
    answer_late: "ms, deadline 5 s' (deadline_missed), the record says nothing of it",
    change_the_value_of_a_write: "the device should have seen one write of [40] to holding_registers 1, it saw a write of [41]",
    take_an_item_of_yesterday: "M4: modbus was not left alone since the last item that had it",
    begin_before_the_item_before_has_ended: "M4: it began before the item before it had ended",
}


@pytest.mark.parametrize("change", FORGED, ids=lambda change: change.__name__)
def test_a_history_that_was_changed_is_refused(good: Record, change: Callable[[Record], None]) -> None:
    change(good)
    assert FORGED[change] in "\n".join(judged(good))


def test_a_finding_that_was_deleted_is_found_out(failed: Record) -> None:
    found = sample(failed, "M3")["findings"]
    sample(failed, "M3").update(findings=[], ok=True)
    failed["items"][0].update(status="PASS", findings=[])
    said = "\n".join(judged(failed))
    assert "M3 repetition 1: the stored history shows ok false, the record says true" in said
    assert all(f"{one['message']!r} ({one['code']}), the record says nothing of it" in said for one in found)


# -- frames ------------------------------------------------------------------------------------------------------------------


def the_read(run: Record) -> Record:
    """Return the call of M3 that reads."""
    return next(one for one in sample(run, "M3")["calls"] if one["tool"] == READ)


def test_an_envelope_that_its_frames_do_not_hold_is_found_out(failed: Record) -> None:
    the_read(failed)["envelope"]["data"]["values"] = [40]
    [said] = judged(failed)
    assert f"({READ}): the stored history shows envelope" in said


def test_frames_that_were_cut_off_are_believed_with_their_faults(failed: Record) -> None:
    cut = the_read(failed)["frames"]
    cut["response"] = cut["response"].ljust(KEPT_OF_A_FRAME) + "\u2026 (90000 bytes)"
    assert judged(failed) == []
    cut["faults"].append(finding("no_text", f"{READ}(address=1, count=1): no text"))
    assert "no text' (no_text), the record says nothing of it" in "\n".join(judged(failed))


def test_what_is_kept_of_a_frame_are_bytes(failed: Record) -> None:
    the_read(failed)["frames"]["response"] = "\u00e9" * (KEPT_OF_A_FRAME // 2) + "\u2026 (90000 bytes)"
    assert judged(failed) == []


def test_frames_that_were_not_cut_off_must_be_those_of_their_digest(failed: Record) -> None:
    the_read(failed)["frames"]["response"] += " "
    assert judged(failed) == [f"M3 repetition 1: the frames of {READ} are not those of their digest"]


def test_an_answer_has_no_failure(failed: Record) -> None:
    the_read(failed)["frames"]["failure"] = "timeout"
    assert judged(failed) == [f"M3 repetition 1: {READ} was answered, and its failure is called 'timeout'"]


def test_frames_without_their_secret_are_believed(failed: Record) -> None:
    the_read(failed)["frames"]["request"] = '{"password": "[redacted]"}'
    assert judged(failed) == []


# -- runs --------------------------------------------------------------------------------------------------------------------


def test_a_run_of_another_suite_is_not_judged(good: Record) -> None:
    good["kit"]["suite_digest"] = "sha256:" + "0" * 64
    [said] = rejudge(StoredRun.of(cast(Run, good)))
    assert said.endswith("judge it again with the version of the kit that made it")


def test_less_repetitions_than_demanded_are_found_out(good: Record) -> None:
    good["settings"]["repetitions"] = {"normal": 30}
    assert judged(good) == [f"{item}: 1 repetitions were planned, the settings demand 30" for item in ("M3", "M4")]


def test_an_item_that_nobody_knows_is_named(good: Record) -> None:
    good["items"][1]["id"] = "M99"
    assert judged(good) == ["M99: the suite has no such task"]


def test_the_order_of_the_items_in_the_file_does_not_matter(good: Record) -> None:
    good["items"].reverse()
    assert judged(good) == []


def test_what_an_interrupted_item_has_is_judged(good: Record) -> None:
    del good["items"][1]
    good["items"][0] |= {"status": "INTERRUPTED", "planned": 9}
    good["settings"]["repetitions"] = {}
    assert judged(good) == []
    sample(good, "M3")["ok"] = False
    assert judged(good) == ["M3 repetition 1: the stored history shows ok true, the record says false"]


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
    made = {
        "adapter": "modbus",
        "variant": "rw",
        "operation": "read_holding",
        "tool": "read",
        "inputs": inputs,
        "group": 1,
    }
    # In the order of their replies.
    calls = [{**made, "outputs": {"values": [at]}, "sent_ns": at, "received_ns": None} for at in (3, 1, 2)]
    history = RecordedRepetition(cast("list[Call]", calls), [], Clock(0))
    at = SimpleNamespace(name="modbus", protocol="modbus", variant="rw")
    asked = [history.call(cast("ReplayItemState", at), "read_holding", inputs, together=True) for _ in calls]
    assert [one["outputs"]["values"] for one in asked] == [[1], [2], [3]]
