"""The claims of a subject file decide what is tested, and no item passes because it was not tested."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from pytest_otmcp.core.verdict import ExitCode, Status, Verdict, decide, exit_code
from pytest_otmcp.plant.devices import Plant
from pytest_otmcp.session.loop import LoopThread
from pytest_otmcp.subject import load_subject
from pytest_otmcp.trial.adapter_under_test import BenchOptions
from pytest_otmcp.trial.bench import Bench

from .conftest import HERE, SUBJECTS, Judge, Results, failing, foreign_subject, passing, words


def verdict(results: Results) -> Verdict:
    return decide({identifier: Status(result["status"]) for identifier, result in results.items()}, list(results))


def untestable(results: Results) -> dict[str, str]:
    return {name: result["reason"] for name, result in results.items() if result["status"] == "NOT_TESTABLE"}


def test_what_is_claimed_without_saying_how_is_not_testable_and_fails_the_run(judge_foreign: Judge) -> None:
    text = (SUBJECTS / "modbus-json.toml").read_text(encoding="utf-8")
    begin, end = text.index("[adapter.modbus.bind.ping]"), text.index("[adapter.modbus.bind.read_input]")
    results = judge_foreign("modbus-json", described=(text[begin:end], ""), tasks="M1 M3")
    assert untestable(results) == {
        "M1": "modbus: no tool is bound to the operation 'ping', and ping is not declared as unclaimed"
    }
    assert results["M1"]["samples"] == []
    assert passing(results) == {"M3"}
    assert verdict(results) is Verdict.NOT_CONFORMANT


@pytest.mark.long
def test_a_tool_for_some_inputs_is_no_tool_for_the_others(judge_foreign: Judge) -> None:
    many = 'tool = "read_many"\n'
    results = judge_foreign("modbus-prose", described=(many, "when = { count = 125 }\n" + many))
    assert untestable(results) == dict.fromkeys(
        ("M2",),
        "modbus: the subject binds no tool to the operation 'read_input' for address=0, count=4",
    )
    assert failing(results) == {"M2"}, words(results)


def test_where_nothing_is_claimed_there_is_no_verdict(judge_foreign: Judge) -> None:
    unclaimed = 'unclaimed = { ping = "has no tool for it" }'
    nothing = "\n".join(
        (
            "[adapter.modbus.unclaimed]",
            *(f'{name} = "no"' for name in ("ping", "read_input", "read_holding", "write_holding")),
        )
    )
    results = judge_foreign("modbus-prose", described=(unclaimed, nothing))
    assert {result["status"] for result in results.values()} == {"NOT_APPLICABLE"}
    assert verdict(results) is Verdict.INDETERMINATE
    assert exit_code(verdict(results)) is ExitCode.INDETERMINATE


def test_a_rule_for_other_answers_does_not_spoil_a_guard_by_absence(judge_foreign: Judge) -> None:
    rule = ('text = "exception 0x02"', 'text = "exception 0x02|[Uu]nknown"')
    results = judge_foreign("modbus-prose", described=rule, tasks="M4 FM1")
    assert passing(results) == {"M4", "FM1"}, words(results)
    (guarded,) = (call for call in results["M4"]["samples"][0]["calls"] if call["operation"] == "write_holding")
    assert guarded["listed"] is False
    assert guarded["error_code"] == "writes_disabled"
    assert "Unknown tool: write_register" in guarded["envelope"]["error"]["message"]


@pytest.fixture
def drift(loop: LoopThread, plant: Plant) -> Callable[..., list[str]]:
    """``drift(name, old, new)`` gives a bench's objections to a subject with a replaced text, before anything runs."""

    def found(name: str, *described: str) -> list[str]:
        async def prepared() -> list[str]:
            bench = Bench(subject, BenchOptions(), plant)
            try:
                await bench.prepare(subject.adapters)
                return bench.drift()
            finally:
                await bench.close()

        subject = foreign_subject(name, (described[0], described[1]))
        return loop.run(prepared())

    return found


def test_a_misspelt_connect_step_is_the_subject_files_fault(drift: Callable[..., list[str]]) -> None:
    assert drift("mqtt-connect", '"open_connection"', '"open_conection"') == [
        "adapter.mqtt.connect.tool: the adapter lists no tool 'open_conection'; did you mean 'open_connection'?"
    ]


def test_a_misspelt_argument_is_the_subject_files_fault(drift: Callable[..., list[str]]) -> None:
    assert drift("mqtt-connect", 'text = "$payload"', 'txt = "$payload"') == [
        "adapter.mqtt.bind.publish.arguments.txt: the tool 'send' has no such argument; did you mean 'text'?"
    ]


ROGUE = """
[subject]
name = "rogue"
version = "1"
[adapter.modbus]
command = ["{python}", "{rogue}", "not-json"]
answer = "text"
"""


@pytest.mark.parametrize("asked", ["connect step", "function"])
def test_an_answer_that_is_no_json_is_the_adapters_fault_wherever_it_is_read(
    judge_described: Judge, tmp_path: Path, asked: str
) -> None:
    text = ROGUE.replace("{rogue}", str(HERE / "rogue.py")).replace("{python}", sys.executable)
    if asked == "function":
        text += 'bindings = "ping.py"\n'
        calls = "async def ping(tools):\n    return {'reachable': (await tools.call('ping')).structured['success']}\n"
        (tmp_path / "ping.py").write_text(calls, encoding="utf-8")
    else:
        text += 'connect = { tool = "ping" }\n[adapter.modbus.bind.ping]\ntool = "ping"\n'
    (tmp_path / "otmcp.toml").write_text(text, encoding="utf-8")
    results = judge_described(load_subject(tmp_path / "otmcp.toml"), tasks="M1")
    assert results["M1"]["status"] == "FAIL"
    assert "not strict JSON: NaN is no JSON number" in words(results)
