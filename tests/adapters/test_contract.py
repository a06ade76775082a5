"""The behaviour that every reference adapter must have: the acceptance test of a new one, see ``cases``."""

# In the checkout mypy does not find the installed name of the adapters' folder.
# mypy: disable-error-code="import-not-found"

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Callable, Iterable
from importlib import import_module
from typing import Any

import pytest
from pytest_otmcp.reference_adapters.core import ConfigError

from .cases import CASES, Case, Unfit
from .conftest import PATIENCE_S, TIMEOUT_S, Client, Reply, Rig

REAL_DEADLINE_S = 2.5
"""Deadline of the one test that waits for it; the calls that succeed must meet it even if a process pauses for 2 s."""


def each(values: Callable[[Case], Iterable[Any]]) -> list[Any]:
    """Return the parameters ``case, value`` for the values of every case."""
    return [
        pytest.param(case, value, id=f"{case}-{value if isinstance(value, str) else index}")
        for case in CASES
        for index, value in enumerate(values(case))
    ]


every_case = pytest.mark.parametrize("case", CASES, ids=str)
waiting_case = pytest.mark.parametrize(
    "case", [pytest.param(case, marks=() if case is CASES[0] else pytest.mark.long) for case in CASES], ids=str
)
"""For what waits; the fast lane has the first adapter alone."""
every_write = pytest.mark.parametrize(("case", "tool"), each(lambda case: case.writes))
every_answered_write = pytest.mark.parametrize(("case", "tool"), each(lambda case: case.answered))
break_off = pytest.mark.parametrize("action", [{"reset": True}, {"close": True}], ids=["reset", "close"])


@pytest.fixture
def rig(case: Case, rigs: Callable[[Case], Rig]) -> Rig:
    rig = rigs(case)
    rig.device("reset")
    return rig


def image(rig: Rig) -> dict[str, Any]:
    whole = rig.device("image")
    return {name: whole[name] for name in rig.case.image}


def reading(rig: Rig, client: Client | None = None) -> int:
    """Start the probe and return the id of its request."""
    return (client or rig.adapter).start(rig.case.probe, rig.case.reads[rig.case.probe])


def probed(rig: Rig, identifier: int, client: Client | None = None) -> Reply:
    return (client or rig.adapter).reply(rig.case.probe, identifier)


def write(rig: Rig, tool: str, client: Client | None = None) -> Reply:
    return (client or rig.adapter).call(tool, rig.case.writes[tool])


def learnt(rig: Rig, tool: str, client: Client | None = None) -> None:
    """Make a write, so that the adapter has read what it must know about the target; the next write is one request."""
    assert write(rig, tool, client).envelope["success"]


def refused(reply: Reply) -> tuple[str, str, bool]:
    return reply.error["code"], reply.error["outcome"], reply.error["retryable"]


def written(rig: Rig, mark: int, tool: str) -> list[dict[str, Any]]:
    """Return the requests of a writing tool, without those of reading tools, that reached the device since the mark."""
    return [entry for entry in rig.requests(mark, tool) if entry.get("state_changing", True)]


def nothing_sent(rig: Rig, mark: int, *clients: Client) -> bool:
    """Ask the device once for each client; return whether nothing else, not even a connection, reached it."""
    for client in clients:
        rig.ask(client)
    entries = [entry for entry in rig.device.since(mark, direction="in") if not rig.case.background(entry)]
    asked = rig.requests(mark, rig.case.probe)
    return len(asked) == len(clients) and entries == asked


# -- the surface -------------------------------------------------------------------------------------------------


@every_case
def test_the_tools_are_those_of_the_case_and_their_hints_are_true(rig: Rig) -> None:
    for client in (rig.adapter, rig.guarded):
        hints = {name: tool["annotations"]["readOnlyHint"] for name, tool in client.tools.items()}
        assert hints == {name: name in rig.case.reads for name in rig.case.tools}


@every_case
def test_reads_change_nothing(rig: Rig) -> None:
    before, mark = image(rig), rig.device.mark()
    for tool, arguments in rig.case.reads.items():
        reply = rig.adapter.call(tool, arguments)
        assert reply.envelope["success"]
        assert (reply.meta["attempts"] == 0) is (tool in rig.case.silent), tool
    rig.ask()
    assert image(rig) == before
    assert written(rig, mark, rig.case.write) == []
    assert rig.device.since(mark, state_changing=True) == []


@every_answered_write
def test_a_write_is_one_request(rig: Rig, tool: str) -> None:
    learnt(rig, tool)
    mark = rig.device.mark()
    reply = write(rig, tool)
    assert reply.envelope["success"]
    assert (reply.meta["attempts"], reply.meta["source"]) == (1, "device")
    assert len(rig.requests(mark, tool)) == 1


# -- the write guard ---------------------------------------------------------------------------------------------


@every_write
def test_a_denied_write_puts_nothing_on_the_wire(rig: Rig, tool: str) -> None:
    rig.ask(rig.guarded)
    before, mark = image(rig), rig.device.mark()
    reply = write(rig, tool, rig.guarded)
    assert refused(reply) == ("writes_disabled", "not_sent", False)
    assert reply.meta["attempts"] == 0
    assert nothing_sent(rig, mark, rig.guarded)
    assert image(rig) == before


@every_case
def test_a_switch_that_is_not_understood_stays_off_and_denied_writes_do_not_even_connect(rig: Rig) -> None:
    mark = rig.device.mark()
    subject = rig.start("misspelt", writes="flase")
    for tool in rig.case.writes:
        assert refused(write(rig, tool, subject)) == ("writes_disabled", "not_sent", False)
    rig.ask()
    assert rig.device.since(mark, kind="CONNECTED") == []
    assert subject.close()[0] == 0
    assert f"{rig.case.prefix}_WRITES_ENABLED: 'flase'".encode() in subject.stderr
    assert b"writes disabled" in subject.stderr
    assert b"writes disabled" in rig.guarded.stderr
    assert b"writes ENABLED" in rig.adapter.stderr


# -- strict arguments --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("case", "unfit"), each(lambda case: case.unfit))
def test_unfit_arguments_are_refused_before_anything_is_sent(rig: Rig, unfit: Unfit) -> None:
    for client in (rig.adapter, rig.guarded):
        rig.ask(client)
    mark = rig.device.mark()
    guard_first = unfit.in_tool and unfit.tool in rig.case.writes
    for client, code in ((rig.adapter, unfit.code), (rig.guarded, "writes_disabled" if guard_first else unfit.code)):
        reply = client.call(unfit.tool, unfit.arguments)
        assert refused(reply) == (code, "not_sent", False)
        assert reply.meta["attempts"] == 0
    assert nothing_sent(rig, mark, rig.adapter, rig.guarded)


# -- connections that fail ---------------------------------------------------------------------------------------


@every_answered_write
@break_off
def test_a_write_over_a_connection_that_breaks_is_sent_once(rig: Rig, tool: str, action: dict[str, Any]) -> None:
    learnt(rig, tool)
    mark = rig.device.mark()
    rig.fault(tool, action)
    reply = write(rig, tool)
    assert refused(reply) == ("connection_lost", "unknown", False)
    assert reply.meta["attempts"] == 1
    rig.device.fault()
    rig.reconnected(mark)
    rig.ask()
    assert len(written(rig, mark, tool)) == 1


@every_answered_write
def test_a_write_that_is_not_answered_is_sent_once(rig: Rig, tool: str) -> None:
    learnt(rig, tool)
    mark = rig.device.mark()
    rig.fault(tool, rig.case.silence)
    identifier = rig.adapter.start(tool, rig.case.writes[tool])
    rig.await_requests(mark, tool)
    rig.adapter.pass_time()
    reply = rig.adapter.reply(tool, identifier)
    assert refused(reply) == ("timeout", "unknown", False)
    assert reply.meta["attempts"] == 1
    rig.device.fault()
    rig.reconnected(mark)
    rig.ask()
    assert len(written(rig, mark, tool)) == 1


@every_case
@break_off
def test_a_read_is_repeated_once_over_a_new_connection(rig: Rig, action: dict[str, Any]) -> None:
    probe = rig.case.probe
    generation = rig.ask().meta["connection"]["generation"]
    mark = rig.device.mark()
    rig.fault(probe, action, times=1)
    reply = rig.ask()
    assert (reply.meta["attempts"], len(rig.requests(mark, probe))) == (2, 2)
    assert reply.meta["connection"] == {"state": "reconnected", "generation": generation + 1}
    mark = rig.device.mark()
    rig.fault(probe, action)
    reply = probed(rig, reading(rig))
    assert (reply.error["code"], reply.meta["attempts"]) == ("connection_lost", 2)
    assert len(rig.requests(mark, probe)) == 2
    rig.device.fault()
    rig.ask()


@every_case
def test_a_read_that_is_not_answered_is_not_repeated(rig: Rig) -> None:
    probe = rig.case.probe
    generation = rig.ask().meta["connection"]["generation"]
    mark = rig.device.mark()
    rig.fault(probe, rig.case.silence)
    identifier = reading(rig)
    rig.await_requests(mark, probe)
    rig.adapter.pass_time()
    reply = probed(rig, identifier)
    assert (reply.error["code"], reply.error["retryable"], reply.meta["attempts"]) == ("timeout", True, 1)
    assert f"within {TIMEOUT_S:g} s" in reply.error["message"]
    assert (reply.meta["source"], reply.meta["connection"]["state"]) == ("none", "disconnected")
    assert len(rig.requests(mark, probe)) == 1
    rig.device.fault()
    rig.reconnected(mark)
    # A late answer must not be taken for the answer to a later request, so the adapter uses a new connection.
    assert rig.ask().meta["connection"]["generation"] == generation + 1


@every_case
def test_every_call_ends_by_its_deadline_though_the_device_swallows_them_all(rig: Rig) -> None:
    tool = rig.case.write
    learnt(rig, tool)
    mark = rig.device.mark()
    rig.fault(tool, rig.case.silence)
    identifiers = rig.adapter.start_together(*[(tool, rig.case.writes[tool])] * 8)
    rig.await_requests(mark, tool, 8 if rig.case.concurrent else 1)
    rig.adapter.pass_time()
    if not rig.case.concurrent:
        # The second request is sent over a new connection before the calls' common deadline.
        rig.await_requests(mark, tool, 2)
        rig.adapter.pass_time()
    replies = [rig.adapter.reply(tool, identifier) for identifier in identifiers]
    assert {reply.error["code"] for reply in replies} <= {"timeout", "connection_lost"}
    sent = [reply for reply in replies if reply.error["outcome"] == "unknown"]
    unsent = [reply for reply in replies if reply.error["outcome"] == "not_sent"]
    assert len(sent) + len(unsent) == 8
    # An adapter that is not concurrent would send them all one after the other, but the deadline comes first.
    assert len(sent) == (8 if rig.case.concurrent else 2)
    assert len(written(rig, mark, tool)) == len(sent) == sum(reply.meta["attempts"] for reply in replies)
    rig.device.fault()
    rig.reconnected(mark)
    rig.ask()


@waiting_case
def test_the_deadline_comes_in_real_time(rig: Rig) -> None:
    tool, prefix = rig.case.write, rig.case.prefix
    limits = {f"{prefix}_TIMEOUT_S": "600", f"{prefix}_DEADLINE_S": str(REAL_DEADLINE_S)}
    subject = rig.start("limited", writes="true", **limits)
    learnt(rig, tool, subject)
    mark = rig.device.mark()
    rig.fault(tool, rig.case.silence)
    reply = write(rig, tool, subject)
    assert refused(reply) == ("timeout", "unknown", False)
    assert f"within {REAL_DEADLINE_S:g} s" in reply.error["message"]
    assert reply.meta["latency_ms"] >= 1000 * REAL_DEADLINE_S
    rig.device.fault()
    rig.reconnected(mark, "limited")
    rig.ask(subject)
    assert len(written(rig, mark, tool)) == 1
    subject.close()


@every_case
def test_tools_are_listed_and_other_calls_answered_while_one_stalls(rig: Rig) -> None:
    adapter = rig.adapter
    rig.ask()
    mark = rig.device.mark()
    rig.fault(rig.case.probe, rig.case.silence, times=1)
    stalled = reading(rig)
    rig.await_requests(mark, rig.case.probe)
    assert adapter.request("tools/list", {})["result"]["tools"]
    for tool in rig.case.silent:
        assert adapter.call(tool, rig.case.reads[tool]).envelope["success"]
    if rig.case.concurrent:
        rig.ask()
    adapter.pass_time()
    assert probed(rig, stalled).error["code"] == "timeout"
    rig.reconnected(mark)
    rig.ask()


@every_case
def test_a_cancelled_call_sends_nothing_more_and_the_next_one_works(rig: Rig) -> None:
    adapter, tool = rig.adapter, rig.case.write
    learnt(rig, tool)
    mark = rig.device.mark()
    rig.fault(tool, rig.case.silence, times=1)
    started = [adapter.start(tool, rig.case.writes[tool])]
    rig.await_requests(mark, tool)
    if not rig.case.concurrent:
        # The second call waits for the first, so it has sent nothing.
        started.append(adapter.start(tool, rig.case.writes[tool]))
    for identifier in reversed(started):
        adapter.write({"jsonrpc": "2.0", "method": "notifications/cancelled", "params": {"requestId": identifier}})
    rig.ask()
    assert len(written(rig, mark, tool)) == 1
    for identifier in started:
        with pytest.raises(TimeoutError):
            adapter.answer(identifier, timeout_s=0.0)


@every_case
def test_parallel_calls_share_one_connection(rig: Rig) -> None:
    rig.ask()
    mark = rig.device.mark()
    calls = [(rig.case.probe, rig.case.reads[rig.case.probe])] * 64
    for identifier in rig.adapter.start_together(*calls):
        assert probed(rig, identifier).envelope["success"]
    for tool in (*rig.case.reads, *rig.case.answered):
        assert rig.adapter.call(tool, rig.case.tools[tool]).envelope["success"]
    assert rig.device.since(mark, kind="CONNECTED") == []
    assert len(rig.requests(mark, rig.case.probe)) >= 64


# -- the life of an adapter --------------------------------------------------------------------------------------


@waiting_case
def test_the_adapter_starts_without_its_device_heals_and_leaves_in_order(rig: Rig) -> None:
    device, case = rig.device, rig.case
    with rig.outage():
        # This adapter is not forked: it starts as it does for a user.
        fresh = rig.start("fresh", writes="true", forked=False)
        assert fresh.tools == rig.adapter.tools
        for tool in case.tools.keys() - case.silent - case.stateful:
            reply = fresh.call(tool, case.tools[tool])
            assert refused(reply)[0::2] == ("connect_failed", True), tool
            assert reply.error["outcome"] == ("not_sent" if tool in case.writes else reply.error["outcome"])
            assert (reply.meta["attempts"], reply.meta["connection"]["state"]) == (0, "disconnected")
        # Arguments are checked whether the device is there or not.
        for unfit in case.unfit:
            assert fresh.call(unfit.tool, unfit.arguments).error["code"] == unfit.code
    rig.reconnected(0, "fresh")
    assert rig.ask(fresh).meta["connection"] == {"state": "connected", "generation": 1}
    with rig.outage():
        assert probed(rig, reading(rig, fresh), fresh).error["code"] == "connect_failed"
        assert refused(write(rig, case.write, fresh)) == ("connect_failed", "not_sent", True)
    rig.reconnected(0, "fresh")
    state = "reconnected" if case.readmitted is None else "connected"
    mark = device.mark()
    assert rig.ask(fresh).meta["connection"] == {"state": state, "generation": 2}
    # A call that is refused before it uses the connection reports the connection, too.
    assert fresh.call(case.probe, {"x": 1}).meta["connection"] == {"state": "connected", "generation": 2}
    learnt(rig, case.write, fresh)
    (connection,) = {entry["connection"] for entry in rig.requests(mark, case.probe)}
    mark = device.mark()
    assert fresh.close()[0] == 0
    device.wait(mark, kind="DISCONNECTED", connection=connection)
    entries = device.since(mark, direction="in", connection=connection)
    assert [entry["kind"] for entry in entries] == list(case.farewell)
    assert b"Traceback" not in fresh.stderr


@every_case
def test_an_unknown_host_is_named_as_such(rig: Rig) -> None:
    lost = rig.start("lost", **rig.case.unknown_host, **{f"{rig.case.prefix}_DEADLINE_S": "5"})
    error = probed(rig, reading(rig, lost), lost).error
    assert error["code"] in ("dns_error", "timeout")
    lost.close()


# -- settings ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("case", "setting"), each(lambda case: case.bad_settings))
def test_a_setting_that_cannot_be_used_is_named(
    monkeypatch: pytest.MonkeyPatch, case: Case, setting: tuple[str, str]
) -> None:
    name, value = setting
    monkeypatch.setenv(name, value)
    build = import_module(f"pytest_otmcp.reference_adapters.{case.protocol}").build
    with pytest.raises(ConfigError) as caught:
        build()
    assert str(caught.value).startswith(name)
    assert "canary" not in str(caught.value)


@every_case
def test_a_bad_setting_is_one_sentence_and_exit_code_2(case: Case, adapter_command: Callable[[str], list[str]]) -> None:
    name, value = case.bad_settings[0]
    done = run(adapter_command(case.protocol), {name: value})
    assert (done.returncode, done.stdout) == (2, "")
    assert len(done.stderr.splitlines()) == 1
    assert name in done.stderr


@pytest.mark.parametrize("arguments", [[], ["core"]], ids=json.dumps)
def test_another_name_is_answered_by_the_list_of_adapters(
    adapter_command: Callable[[str], list[str]], arguments: list[str]
) -> None:
    *program, _ = adapter_command("")
    done = run([*program, *arguments], {})
    assert (done.returncode, done.stdout) == (2, "")
    assert (
        done.stderr
        == "usage: python -m pytest_otmcp.reference_adapters {bacnet|dnp3|ethercat|ethernetip|modbus|mqtt|opcua|profibus|profinet|s7}\n"
    )


def run(command: list[str], env: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command, env={**os.environ, **env}, capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
