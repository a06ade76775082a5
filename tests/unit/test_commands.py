"""Named commands: from arguments to what the device gets and back, and a sentence for each wrong table."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest

from pytest_otmcp.errors import UsageError
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.replay.reply import restored_bindings
from pytest_otmcp.report.plainly import due
from pytest_otmcp.session.exchange import Exchange
from pytest_otmcp.subject import Subject, load_subject, named_subject
from pytest_otmcp.subject.comparison import stored_bindings
from pytest_otmcp.subject.model import Binding
from pytest_otmcp.trial.expectations import succeeded
from pytest_otmcp.trial.reply import Expectation, observe

HEAD = """
[subject]
name = "x"
version = "1"
[adapter.modbus]
command = ["x"]
answer = "text"
{bind}
[adapter.modbus.commands.run]
{run}
"""

GOOD = """
draws = { percent = { lowest = -1, highest = 100, step = 0.1 } }
arguments = { speed = "$percent" }
effect.write_holding = { address = 40, value = "$percent * 10 + 20" }
"""

Load = Callable[..., Subject]


@pytest.fixture
def load(tmp_path: Path) -> Load:
    def loaded(run: str = GOOD, bind: str = "") -> Subject:
        file = tmp_path / "otmcp.toml"
        file.write_text(HEAD.replace("{bind}", bind).replace("{run}", run), encoding="utf-8")
        return load_subject(file)

    return loaded


def only(subject: Subject, operation: str, protocol: str = "modbus") -> Binding:
    bound = subject.adapters[protocol].operations[operation]
    assert isinstance(bound, tuple)
    return bound[0]


def test_a_command_performs_its_operation_with_the_arguments_that_have_this_effect(load: Load) -> None:
    binding = only(load(), "write_holding")
    assert binding.tool == "run"
    assert binding.fits({"address": 40, "value": 523})
    assert binding.fill({"address": 40, "value": 523}, {}) == {"speed": 50.3}
    assert binding.fill({"address": 40, "value": 1020}, {}) == {"speed": 100}


@pytest.mark.parametrize(
    "inputs",
    [
        {"address": 41, "value": 523},
        {"address": 40, "value": 1021},
        {"address": 40, "value": 9},
        {"address": 40, "value": 523.5},
        {"address": 40, "value": "523"},
        {"address": 40, "value": True},
        {"address": 40, "value": 10**400},
        {"address": 40, "value": float("nan")},
        {"address": 40},
        {"address": 40, "value": 523, "unit": 1},
    ],
)
def test_a_command_does_not_express_what_none_of_its_values_has_as_effect(load: Load, inputs: dict[str, Any]) -> None:
    assert not only(load(), "write_holding").fits(inputs)


SEVERAL = """
draws = { litres = { lowest = 1, highest = 9 } }
arguments = { litres = "$litres" }
effect = [
    { write_holding = { address = 40, value = "$litres * 10" } },
    { write_coil = { address = 1, value = true } },
]
"""


def test_a_command_of_several_effects_performs_the_first_with_the_others_after_it(load: Load) -> None:
    binding = only(load(SEVERAL), "write_holding")
    command = binding.command
    assert command is not None
    inputs = command.effect_of({"litres": 5})
    then = [{"operation": "write_coil", "inputs": {"address": 1, "value": True}}]
    assert inputs == {"address": 40, "value": 50, "then": then}
    assert binding.fits(inputs)
    assert binding.fill(inputs, {}) == {"litres": 5}


@pytest.mark.parametrize(
    "change",
    [
        {"then": []},
        {"then": [{"operation": "write_coils", "inputs": {"address": 1, "value": True}}]},
        {"then": [{"operation": "write_coil", "inputs": {"address": 2, "value": True}}]},
        {"then": [{"operation": "write_coil", "inputs": {"address": 1}}]},
        {"value": 51},
    ],
)
def test_a_command_of_several_effects_expresses_nothing_else(load: Load, change: dict[str, Any]) -> None:
    binding = only(load(SEVERAL), "write_holding")
    assert binding.command is not None
    assert not binding.fits({**binding.command.effect_of({"litres": 5}), **change})
    assert not binding.fits({"address": 40, "value": 50})


def test_one_effect_in_a_list_is_as_one_without(load: Load) -> None:
    one = load("effect = [{ write_coil = { address = 1, value = true } }]")
    assert only(one, "write_coil") == only(load("effect.write_coil = { address = 1, value = true }"), "write_coil")


def test_a_value_that_is_no_text_has_its_meaning_by_its_place_in_the_list(load: Load) -> None:
    run = """
draws = { on = [true, false] }
means = { on = [0xFF, 0] }
arguments = { on = "$on" }
effect.write_holding = { address = 7, value = "$on" }
"""
    binding = only(load(run), "write_holding")
    assert binding.fill({"address": 7, "value": 255}, {}) == {"on": True}
    assert binding.fill({"address": 7, "value": 0}, {}) == {"on": False}


def every_command() -> list[Any]:
    files = [named_subject().source, *Path(__file__).parents[1].glob("soundness/subjects/*.toml")]
    found = []
    for file in files:
        for protocol, adapter in load_subject(file, run=False).adapters.items():
            for operation, bound in adapter.operations.items():
                cases = bound if isinstance(bound, tuple) else ()
                found += [
                    pytest.param(case, id=f"{protocol}-{operation}-{case.command.name}")
                    for case in cases
                    if case.command
                ]
    return found


@pytest.mark.parametrize("binding", every_command())
def test_every_value_that_is_drawn_is_found_again_in_its_effect(binding: Binding) -> None:
    command = binding.command
    assert command is not None
    for seed in range(200):
        inputs = command.drawn(random.Random(seed))
        found = command.arguments(inputs)
        assert found is not None, inputs
        assert found.keys() == command.draws.keys()
        assert command.arguments(json.loads(json.dumps(inputs))) == found


def test_there_are_commands_of_every_protocol() -> None:
    assert {str(param.id).partition("-")[0] for param in every_command()} == protocols().keys()


@pytest.mark.parametrize("protocol", ["modbus", "mqtt"])
def test_a_record_keeps_commands(protocol: str) -> None:
    adapter = named_subject().adapters[protocol]
    for operation in set(adapter.commands.values()):
        stored = json.loads(json.dumps({operation: stored_bindings(adapter, operation)}))
        restored, bound = restored_bindings(stored)[operation], adapter.operations[operation]
        assert restored is not None
        assert isinstance(bound, tuple)
        for one, other in zip(restored, bound, strict=True):
            assert one.command is not None
            assert other.command is not None
            assert one.command.drawn(random.Random(7)) == other.command.drawn(random.Random(7))


@pytest.mark.parametrize(
    "change", [{"step": 0}, {"step": 1e-300}, {"highest": -1}, {"highest": 1e300}, {"values": [1], "means": [1, 2]}]
)
def test_a_record_with_a_range_that_there_is_not_is_unreadable(change: dict[str, Any]) -> None:
    stored = json.loads(
        json.dumps({"write_holding": stored_bindings(named_subject().adapters["modbus"], "write_holding")})
    )
    stored["write_holding"][0]["command"]["draws"]["percent"] |= change
    with pytest.raises(ValueError, match="a range that there is not"):
        restored_bindings(stored)


def test_a_topic_of_a_command_is_a_command_topic() -> None:
    assert named_subject().adapters["mqtt"].lists["command_topics"] == (
        "home/+/set",
        "home/bell",
        "home/kitchen/set",
        "home/hall/set",
    )


def test_commands_are_tried_before_other_bindings_of_their_operation(load: Load) -> None:
    bind = 'bind.write_holding = { tool = "write", arguments = { at = "$address", value = "$value" } }'
    bound = load(bind=bind).adapters["modbus"].operations["write_holding"]
    assert isinstance(bound, tuple)
    assert [case.tool for case in bound] == ["run", "write"]


def test_an_adapter_with_commands_claims_the_writes_that_it_names_and_no_others(load: Load) -> None:
    adapter = load("effect.write_coil = { address = 1, value = true }").adapters["modbus"]
    assert adapter.unclaimed == {"write_holding": "the adapter writes by named commands"}
    assert set(adapter.offered) == {"commands", "write_coil"}


WRONG = {
    "effect = []": "adapter.modbus.commands.run.effect: expected a list of effects, in their order, found a list",
    "effect = [{ mask_write = { address = 1, and_mask = 1, or_mask = 1 } }]": (
        "adapter.modbus.commands.run.effect[0].mask_write: unknown key; known are write_coil, write_coils, write_holding, write_registers"
    ),
    'draws.speed = [1, 2]\narguments = { a = "$speed" }\n'
    "effect = [{ write_coil = { address = 1, value = true } }, { write_coil = { address = 2, value = true } }]": (
        "commands.run.effect: $speed has no part in it, so that nothing says what it does at the device"
    ),
    "": "adapter.modbus.commands.run.effect: expected a table, found nothing",
    "effect = {}": "adapter.modbus.commands.run.effect: expected one operation, such as write_holding",
    "effect.write_holding = { address = 1 }": "commands.run.effect.write_holding.value: expected a value, found nothing",
    "effect.read_holding = { address = 1 }": "commands.run.effect.read_holding: unknown key; did you mean 'write_holding'?",
    "effect.write_holding = { adress = 1, value = 1 }": "effect.write_holding.adress: unknown key; did you mean 'address'?",
    'effect.write_holding = { address = 1, value = "$speed" }': (
        "commands.run.effect.write_holding: $speed is no value that is drawn; it draws none"
    ),
    'draws.speed = [1, 2]\narguments = { a = "$sped" }\neffect.write_holding = { address = 1, value = "$speed" }': (
        "commands.run.arguments: $sped is no value that is drawn; did you mean 'speed'?"
    ),
    'draws.speed = [1, 2]\neffect.write_holding = { address = 1, value = "$speed" }': (
        "commands.run.arguments: $speed is given to no argument of the tool"
    ),
    'draws.speed = [1, 2]\narguments = { a = "$speed" }\neffect.write_holding = { address = 1, value = 2 }': (
        "commands.run.effect.write_holding: $speed has no part in it, so that nothing says what it does at the device"
    ),
    'draws.on = ["a", "b"]\narguments = { a = "$on" }\neffect.write_holding = { address = 1, value = "$on * 2" }': (
        "commands.run.effect.write_holding: makes a number from $on, which is no number for each of its values"
    ),
    'draws.on = []\narguments = { a = "$on" }\neffect.write_holding = { address = 1, value = "$on" }': (
        "commands.run.draws.on: expected a list of values, found a list"
    ),
    'means.on = { a = 1, b = 1 }\narguments = { a = "$on" }\neffect.write_holding = { address = 1, value = "$on" }': (
        "commands.run.effect.write_holding: two values of an argument are the same at the device"
    ),
    'draws.on = [1, 2]\narguments = { a = "$on" }\neffect.write_holding = { address = 1, value = "$on * 0" }': (
        "commands.run.effect.write_holding: two values of an argument are the same at the device"
    ),
    'means.on = {}\narguments = { a = "$on" }\neffect.write_holding = { address = 1, value = "$on" }': (
        "commands.run.means.on: expected a value and what it is at the device, found an empty table"
    ),
    'draws.on = [1]\nmeans.on = { a = 1 }\narguments = { a = "$on" }\neffect.write_holding = { address = 1, value = "$on" }': (
        "commands.run.means.on: 'draws' has values for this argument as well"
    ),
    'draws.on = [1, 2]\nmeans.on = [5]\narguments = { a = "$on" }\neffect.write_holding = { address = 1, value = "$on" }': (
        "commands.run.means.on: expected as many values as the list of this argument in 'draws' has"
    ),
    'means.on = [5]\narguments = { a = "$on" }\neffect.write_holding = { address = 1, value = "$on" }': (
        "commands.run.means.on: expected as many values as the list of this argument in 'draws' has"
    ),
    'draws.on = { lowest = 3, highest = 1 }\narguments = { a = "$on" }\neffect.write_holding = { address = 1, value = "$on" }': (
        "commands.run.draws.on: expected a 'highest' that is not below 'lowest', and a 'step' above 0"
    ),
    'draws.on = { lowest = 3 }\narguments = { a = "$on" }\neffect.write_holding = { address = 1, value = "$on" }': (
        "commands.run.draws.on.highest: expected a number, found nothing"
    ),
    'draws.on = [1]\narguments = { a = "$on", at = "{hots}" }\neffect.write_holding = { address = 1, value = "$on" }': (
        "commands.run.arguments.at: {hots} is not replaced; did you mean {host}?"
    ),
    GOOD + "[adapter.modbus.commands.walk]\n" + GOOD: (
        "commands.walk.effect: the command 'run' has this effect as well, so that the kit could not tell which of them to call"
    ),
}


@pytest.mark.parametrize("run", WRONG, ids=range(len(WRONG)))
def test_a_wrong_table_is_refused_in_one_sentence(load: Load, run: str) -> None:
    with pytest.raises(UsageError) as refusal:
        load(run)
    assert WRONG[run] in str(refusal.value)
    assert "\n" not in str(refusal.value)


SAYING = f"{GOOD}says.percent = {{ regex = 'at (\\S+) %', as = 'float' }}\nsays.value = {{ regex = '; (.+)', means = {{ fast = 1020 }} }}\n"


@pytest.mark.parametrize(
    ("value", "said", "wrong"),
    [
        (1020, "runs at 100.0 %; fast", []),
        (1020, "runs at 100.00001 %; fast", []),
        (1020, "runs at 0 %; fast", ["percent should be 100, the reply says 0 by the subject file"]),
        (1020, "runs at 100 %; slow", ["value should be 1020, the reply says nothing by the subject file"]),
        (523, "runs at 50.3 %; fast", ["value should be 523, the reply says 1020 by the subject file"]),
    ],
)
def test_an_answer_says_what_was_asked_for(load: Load, value: int, said: str, wrong: list[str]) -> None:
    stored = json.loads(json.dumps(stored_bindings(load(SAYING).adapters["modbus"], "write_holding")))
    restored = restored_bindings({"write_holding": stored})["write_holding"]
    assert isinstance(restored, list | tuple)
    for binding in (only(load(SAYING), "write_holding"), restored[0]):
        message = {"jsonrpc": "2.0", "id": 1, "result": {"content": [{"type": "text", "text": said}]}}
        response = (json.dumps(message) + "\n").encode()
        exchange = Exchange(tool="run", arguments={}, request=b"", response=response, sent_ns=1, received_ns=2)
        inputs = {"address": 40, "value": value}
        expectation = Expectation.of(
            binding, inputs, adapter="modbus", variant="rw", operation="write_holding", deadline_s=5, listed=True
        )
        found = succeeded(observe(exchange, expectation))
        assert [finding.message for finding in found] == [f"run(): {one}" for one in wrong]
        assert all(finding.requirement == "WR-014" for finding in found)
        assert all(due(cast(Any, {"code": one.code, "message": one.message})) is not None for one in found)


def test_what_an_answer_may_say_is_an_argument_or_an_input_of_the_effect(load: Load) -> None:
    with pytest.raises(UsageError, match=r"commands\.run\.says\.percnt: is no argument that is drawn, and no input"):
        load(f'{GOOD}says.percnt = "v"')
