"""The tasks that apply to a subject are claimed, bound and expressible; the others have a reason."""

from __future__ import annotations

from pathlib import Path

import pytest

from pytest_otmcp.core.verdict import Status
from pytest_otmcp.subject import load_subject
from pytest_otmcp.suite.catalogue import tasks_by_id
from pytest_otmcp.trial.applicability import applicability

HEAD = """
[subject]
name = "x"
version = "1"
"""

MODBUS = """
[adapter.modbus]
command = ["adapter"]
answer = "text"
{more}
[adapter.modbus.bind.write_holding]
tool = "write"
arguments = {{ register = "$address", value = "$value" }}
[adapter.modbus.bind.read_holding]
tool = "read"
arguments = {{ register = "$address", count = "$count" }}
result.values = {{}}
"""

MQTT = """
[adapter.mqtt]
command = ["adapter"]
answer = "json"
{more}
[adapter.mqtt.bind.subscribe]
tool = "subscribe"
arguments = {{ topic = "$filter"{qos} }}
[adapter.mqtt.bind.messages]
tool = "messages"
result.messages = "messages"
"""


def judged(tmp_path: Path, task: str, *adapters: str) -> tuple[Status, str] | None:
    """Say why a task of the suite cannot be run for a subject file with these adapters; None when it can be."""
    (tmp_path / "otmcp.toml").write_text(HEAD + "".join(adapters), encoding="utf-8")
    return applicability(tasks_by_id()[task], load_subject(tmp_path / "otmcp.toml").adapters)


def modbus(more: str = "") -> str:
    return MODBUS.format(more=more)


def mqtt(more: str = "", qos: str = "") -> str:
    return MQTT.format(more=more, qos=qos)


@pytest.mark.parametrize("task", ["M3", "M4", "FM1", "FM2", "S4"])
def test_what_is_claimed_and_bound_is_run(tmp_path: Path, task: str) -> None:
    assert judged(tmp_path, task, modbus()) is None


def test_what_is_not_claimed_does_not_apply_and_the_vendors_reason_is_given(tmp_path: Path) -> None:
    unclaimed = modbus('unclaimed = { write_holding = "only reads" }')
    assert judged(tmp_path, "M3", unclaimed) == (
        Status.NOT_APPLICABLE,
        "modbus.write_holding is not claimed: only reads",
    )
    assert judged(tmp_path, "FM1", unclaimed) is None


def test_a_guard_that_is_not_claimed_takes_the_guarded_write_with_it_and_nothing_else(tmp_path: Path) -> None:
    unclaimed = modbus('unclaimed = { guard = "always writes" }')
    assert judged(tmp_path, "M4", unclaimed) == (Status.NOT_APPLICABLE, "modbus.guard is not claimed: always writes")
    assert judged(tmp_path, "M3", unclaimed) is None


def test_what_is_claimed_but_bound_to_no_tool_is_not_testable(tmp_path: Path) -> None:
    assert judged(tmp_path, "M1", modbus()) == (
        Status.NOT_TESTABLE,
        "modbus: no tool is bound to the operation 'ping', and ping is not declared as unclaimed",
    )


def test_a_task_of_an_adapter_that_the_subject_does_not_have_does_not_apply(tmp_path: Path) -> None:
    assert judged(tmp_path, "O1", modbus()) == (Status.NOT_APPLICABLE, "the subject has no adapter for OPC UA")
    # This holds even where, because of the other adapters, the task could not be tested.
    assert judged(tmp_path, "X2", modbus()) == (Status.NOT_APPLICABLE, "the subject has no adapter for OPC UA")


def test_what_does_not_apply_need_not_be_bound(tmp_path: Path) -> None:
    # No tool is bound to ping either.
    assert judged(tmp_path, "M1", modbus('unclaimed = { ping = "has none" }')) == (
        Status.NOT_APPLICABLE,
        "modbus.ping is not claimed: has none",
    )


@pytest.mark.parametrize("task", ["M2", "S1", "S7", "S10", "R-modbus"])
def test_a_task_takes_the_first_read_that_is_claimed(tmp_path: Path, task: str) -> None:
    assert judged(tmp_path, task, modbus()) == (
        Status.NOT_TESTABLE,
        "modbus: no tool is bound to the operation 'read_input', and read_input is not declared as unclaimed",
    )
    assert judged(tmp_path, task, modbus('unclaimed = { read_input = "no input registers" }')) is None
    neither = modbus('unclaimed = { read_input = "has none", read_holding = "has none", ping = "has none" }')
    assert judged(tmp_path, task, neither) == (Status.NOT_APPLICABLE, "modbus.read_input is not claimed: has none")


def test_an_optional_input_without_a_place_is_not_testable_until_it_is_unclaimed(tmp_path: Path) -> None:
    assert judged(tmp_path, "FQ2", mqtt()) == (
        Status.NOT_TESTABLE,
        "mqtt: no binding of 'subscribe' has a place for $qos, and subscribe.qos is not declared as unclaimed",
    )
    assert judged(tmp_path, "FQ2", mqtt('unclaimed = { "subscribe.qos" = "always 0" }')) == (
        Status.NOT_APPLICABLE,
        "mqtt.subscribe.qos is not claimed: always 0",
    )
    assert judged(tmp_path, "FQ2", mqtt(qos=', qos = "$qos"')) is None


def test_an_optional_input_is_unclaimed_with_its_operation(tmp_path: Path) -> None:
    assert judged(tmp_path, "FQ2", mqtt('unclaimed = { subscribe = "only publishes" }')) == (
        Status.NOT_APPLICABLE,
        "mqtt.subscribe is not claimed: only publishes",
    )


def test_who_does_not_claim_an_optional_input_is_asked_for_the_rest(tmp_path: Path) -> None:
    assert judged(tmp_path, "Q2", mqtt('unclaimed = { "subscribe.qos" = "always 0" }')) is None


def test_to_receive_takes_a_subscription_unless_the_call_waits(tmp_path: Path) -> None:
    unclaimed = 'unclaimed = { subscribe = "receives by a call that waits" }'
    assert judged(tmp_path, "Q2", mqtt(unclaimed)) == (
        Status.NOT_APPLICABLE,
        "mqtt.subscribe is not claimed: receives by a call that waits",
    )
    waiting = mqtt(unclaimed).replace('tool = "messages"', 'tool = "messages"\nblocking = true')
    assert judged(tmp_path, "Q2", waiting) is None


def test_who_needs_a_new_session_is_not_asked_to_recover_in_the_old_one(tmp_path: Path) -> None:
    reads = '[adapter.modbus.bind.read_input]\ntool = "read"\nresult.values = {}\n'
    assert judged(tmp_path, "S10", modbus('recovery = "new_session"'), reads) == (
        Status.NOT_APPLICABLE,
        "modbus.recovery is not claimed: needs a new session after an outage",
    )
    assert judged(tmp_path, "R-modbus", modbus('recovery = "new_session"'), reads) is None
    assert judged(tmp_path, "S10", modbus(), reads) is None
