"""Named readings: from an answer to what the device holds by the subject file, and a sentence for each wrong table."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest

from pytest_otmcp.errors import UsageError
from pytest_otmcp.protocols.exercise import READING
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.replay.reply import restored_bindings
from pytest_otmcp.report.plainly import due
from pytest_otmcp.session.exchange import Exchange
from pytest_otmcp.subject import Subject, load_subject, named_subject
from pytest_otmcp.subject.answers import extract
from pytest_otmcp.subject.comparison import stored_bindings
from pytest_otmcp.subject.model import Binding
from pytest_otmcp.trial.expectations import succeeded
from pytest_otmcp.trial.named_readings import apart, asked_of, with_readings
from pytest_otmcp.trial.reply import Expectation, observe

HEAD = """
[subject]
name = "x"
version = "1"
[adapter.{protocol}]
command = ["x"]
answer = "json"
{bind}
[adapter.{protocol}.readings.level]
{reading}
"""

GOOD = """
means = { tank = { left = 10, right = 12 } }
arguments = { tank = "$tank" }
source.read_holding = { address = "$tank", count = 1 }
value = { path = "percent", means = "$value * 10" }
"""

Load = Callable[..., Subject]


@pytest.fixture
def load(tmp_path: Path) -> Load:
    def loaded(reading: str = GOOD, bind: str = "", protocol: str = "modbus") -> Subject:
        file = tmp_path / "otmcp.toml"
        text = HEAD.replace("{bind}", bind).replace("{reading}", reading).replace("{protocol}", protocol)
        file.write_text(text, encoding="utf-8")
        return load_subject(file)

    return loaded


def only(subject: Subject, operation: str, protocol: str = "modbus") -> Binding:
    bound = subject.adapters[protocol].operations[operation]
    assert isinstance(bound, tuple)
    return bound[0]


def at(address: int) -> dict[str, object]:
    return {"address": address, "count": 1, READING: "level"}


def test_a_reading_is_called_with_the_arguments_that_read_this_place(load: Load) -> None:
    binding = only(load(), "read_holding")
    assert binding.tool == "level"
    assert binding.fits(at(12))
    assert binding.fill(at(12), {}) == {"tank": "right"}
    assert not binding.fits(at(11))


def test_what_is_read_without_a_name_is_read_by_no_reading(load: Load) -> None:
    binding = only(load(), "read_holding")
    assert not binding.fits({"address": 10, "count": 1})
    assert not binding.fits({**at(10), READING: "another"})


@pytest.mark.parametrize(
    ("value", "said", "held"),
    [
        ('{ path = "v", means = "$value * 10" }', 21.5, [215]),
        ('{ path = "v", means = "$value * 10" }', 21.5400001, [215]),
        ('{ path = "v", means = "$value * 10 + 5" }', 1, [15]),
        ('{ path = "v", means = "$value * -1" }', -7, [7]),
        ('{ path = "v", means = "$value * 10" }', "21.5", [None]),
        ('{ path = "v", means = "$value * 10" }', True, [None]),
        ('{ path = "v", means = "$value * 10" }', 1e300, [None]),
        ('{ path = "v", means = { off = 0, on = 1 } }', "on", [1]),
        ('{ path = "v", means = { off = 0, on = 1 } }', "ON", [None]),
        ('{ path = "v", means = { true = 1, false = 0 } }', True, [1]),
        ('{ path = "v", means = { 3 = 30, 4 = 40 } }', 3, [30]),
        ('"v"', 7, [7]),
        ('"v"', 7.5, [7.5]),
        ('{ path = "v", regex = \'is ([0-9.]+) %\', as = "float", means = "$value * 10" }', "It is 4.5 %", [45]),
    ],
)
def test_an_answer_says_what_the_device_holds(load: Load, value: str, said: object, held: object) -> None:
    binding = only(load(f"source.read_holding = {{ address = 1, count = 1 }}\nvalue = {value}"), "read_holding")
    assert extract(binding.outputs, {"v": said}) == {"values": held}


def test_an_answer_that_is_rounded_means_the_nearest_value_that_the_device_may_hold(load: Load) -> None:
    table = 'source.read_holding = { address = 1, count = 1 }\nvalue = { path = "v", means = "$value * 276.48" }\n'
    rounded = only(load(f"{table}holds = {{ lowest = 0, highest = 27640, step = 40 }}"), "read_holding")
    exact = only(load(table), "read_holding")
    for held in range(0, 27641, 40):
        said = {"v": round(held / 276.48, 1)}
        assert extract(rounded.outputs, said) == {"values": [held]}
    assert extract(exact.outputs, {"v": 0.1}) == {"values": [28]}


@pytest.mark.parametrize(
    ("source", "count", "values"),
    [
        ("read_holding = { address = 0, count = 1 }", 65536, {0, 65535}),
        ("read_coils = { address = 99, count = 1 }", 2, {False, True}),
        ('read_typed = { address = 98, type = "int16" }', 65536, {-32768, 32767}),
        ('read_typed_input = { address = 96, type = "float32", byte_order = "CDAB" }', 201, {0, 100}),
        ('read_typed = { address = 0, type = "uint32" }', 2**32, {0, 2**32 - 1}),
    ],
)
def test_without_a_statement_the_device_may_hold_whatever_fits_the_place(
    load: Load, source: str, count: int, values: set[object]
) -> None:
    binding = only(load(f'source.{source}\nvalue = "v"'), source.split(" ")[0])
    assert binding.command is not None
    assert binding.command.holds is not None
    assert binding.command.holds.count == count
    assert {*binding.command.held_at_most()} == values


@pytest.mark.parametrize("order", ["ABCD", "CDAB", "BADC", "DCBA"])
@pytest.mark.parametrize("kind", ["int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64"])
def test_what_is_set_at_a_number_of_several_registers_is_found_there(kind: str, order: str) -> None:
    place = protocols()["modbus"].places["read_typed"]({"address": 7, "type": kind, "byte_order": order})
    assert place is not None
    assert place.found is not None
    for value in (1, 2, 100):
        assert place.found({"points": dict(place.held(value))}) == value
        (poke,) = place.pokes(value)
        assert [*place.held(value).values()] == poke["values"]


def test_a_proof_is_a_value_that_nobody_can_guess_through_a_reading(load: Load) -> None:
    adapter = load().adapters["modbus"]
    proof = with_readings(protocols()["modbus"].proof, "modbus", adapter.vocabulary(readings=True))
    way = next(
        way for way in proof.ways if way.operation == "read_holding" and READING in way.ask(random.Random(1)).inputs
    )
    question = way.ask(random.Random(1))
    (poke,) = question.pokes
    held = next(iter(cast("list[int]", poke["values"])))
    assert question.bits({"values": [held]}, []) == 16
    assert question.bits({"values": [held + 1]}, []) == 0
    names = [call.operation for call in proof.unreachable]
    assert names.index("ping") == len(names) - 1


def test_a_call_of_a_reading_says_what_its_place_holds() -> None:
    subject = named_subject()
    ((operation, reading), *_) = subject.adapters["modbus"].vocabulary(readings=True)
    asked = asked_of("modbus", operation, reading.examples()[1], 215)
    assert asked.outputs == {"values": [215]}
    assert asked.pokes == ({"unit": 1, "table": "input_registers", "address": 12, "values": [215]},)
    assert asked.points == {"1/input_registers/12": 215}


def test_an_adapter_with_readings_claims_the_reads_that_it_names_and_no_others(load: Load) -> None:
    adapter = load().adapters["modbus"]
    assert adapter.unclaimed == {"read_input": "the adapter reads by named readings"}
    assert set(adapter.offered) == {"readings"}
    assert adapter.readings == {"level": "read_holding"}
    assert adapter.commands == {}


def test_a_record_has_a_reading_as_it_is(load: Load) -> None:
    adapter = load().adapters["modbus"]
    stored = json.loads(json.dumps({"read_holding": stored_bindings(adapter, "read_holding")}))
    restored = (restored_bindings(stored)["read_holding"] or [])[0]
    assert restored.outputs == only(load(), "read_holding").outputs
    assert restored.fill(at(12), {}) == {"tank": "right"}
    assert restored.command is not None
    assert restored.command.held_at_most() == (0, 65535)


@pytest.mark.parametrize(
    "changed",
    [{"holds": {"values": [], "means": [], "lowest": 0, "highest": 5, "step": 0}}],
)
def test_a_record_with_values_that_there_are_not_is_refused(load: Load, changed: dict[str, Any]) -> None:
    stored = json.loads(json.dumps(stored_bindings(load().adapters["modbus"], "read_holding")))
    stored[0]["command"] |= changed
    with pytest.raises(ValueError, match="there are not"):
        restored_bindings({"read_holding": stored})


@pytest.mark.parametrize("grid", [[0], [0, 0], [0, -1]])
def test_a_record_that_rounds_to_what_there_is_not_is_refused(load: Load, grid: list[float]) -> None:
    stored = json.loads(json.dumps(stored_bindings(load().adapters["modbus"], "read_holding")))
    stored[0]["outputs"]["values"]["grid"] = grid
    with pytest.raises(ValueError, match="grid"):
        restored_bindings({"read_holding": stored})


SOURCE = "source.read_holding = { address = 1, count = 1 }\n"
WRONG = {
    "": "adapter.modbus.readings.level.source: expected a table, found nothing",
    SOURCE: "adapter.modbus.readings.level.value: expected a table, found nothing",
    'source = {}\nvalue = "v"': "readings.level.source: expected one operation, such as",
    'source.write_holding = { address = 1, value = 1 }\nvalue = "v"': "readings.level.source.write_holding: unknown key",
    'source.read_holding = { address = 1, count = 2 }\nvalue = "v"': (
        "readings.level.source.read_holding: the mock device has no such place, or it holds more than one value"
    ),
    'source.read_holding = { address = 100, count = 1 }\nvalue = "v"': "the mock device has no such place",
    'source.read_holding = { address = 1, count = 1, unit = 7 }\nvalue = "v"': "the mock device has no such place",
    'source.read_typed = { address = 99, type = "float32" }\nvalue = "v"': "the mock device has no such place",
    'source.read_typed = { address = 1, type = "float16" }\nvalue = "v"': "the mock device has no such place",
    'source.read_holding = { address = "$tank", count = 1 }\nvalue = "v"': (
        "readings.level.source.read_holding: $tank is no value that is drawn; it draws none"
    ),
    f'draws.tank = [1, 2]\n{SOURCE}value = "v"': "readings.level.arguments: $tank is given to no argument of the tool",
    f'draws.tank = [1, 2]\narguments = {{ t = "$tank" }}\n{SOURCE}value = "v"': (
        "readings.level.source.read_holding: $tank has no part in it, so that nothing says what is read"
    ),
    'means.tank = { a = 1, b = 1 }\narguments = { t = "$tank" }\nsource.read_holding = { address = "$tank", count = 1 }\nvalue = "v"': (
        "readings.level.source.read_holding: two values of an argument read the same place"
    ),
    SOURCE + 'value = { path = "v", means = "$v * 10" }': "value.means: expected a number made from $value",
    SOURCE + 'value = { path = "v", means = "$value * 10 * 2" }': "value.means: expected a number made from $value",
    SOURCE + 'value = "v"\nholds = [3]': "readings.level.holds: expected two values or more",
    SOURCE
    + 'value = "v"\nholds = [3, 65536]': "readings.level.holds: 65536 is no value that the place in 'source' can hold",
    SOURCE + 'value = "v"\nholds = [true, false]': "readings.level.holds: True is no value",
    SOURCE + 'value = "v"\nholds = { lowest = 0, highest = 5, step = 0.5 }': "readings.level.holds: 0.5 is no value",
    SOURCE + 'value = { path = "v", means = { on = 1 } }\nholds = [0, 1]': (
        "readings.level.holds: 0 is what none of the words in 'value.means' means, so that no answer could say it"
    ),
}


@pytest.mark.parametrize("reading", WRONG, ids=range(len(WRONG)))
def test_a_wrong_table_is_refused_in_one_sentence(load: Load, reading: str) -> None:
    with pytest.raises(UsageError) as refusal:
        load(reading)
    assert WRONG[reading] in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_node_that_the_mock_does_not_have_is_refused(load: Load) -> None:
    with pytest.raises(UsageError, match=r"readings\.level\.source\.read: the mock device has no such place"):
        load('source.read = { node = "ns=2;s=Nowhere" }\nvalue = "v"', protocol="opcua")


def test_a_protocol_without_places_has_no_readings(load: Load) -> None:
    with pytest.raises(UsageError, match=r"adapter\.mqtt\.readings: unknown key"):
        load(SOURCE, protocol="mqtt")


@pytest.mark.parametrize(
    ("value", "said", "meant"),
    [
        ('{ path = "v", means = "$value * 10" }', {"v": 21.6}, "that it holds 216"),
        ('{ path = "v", means = { open = 1 } }', {"v": "ajar"}, "nothing that the subject file knows"),
    ],
)
def test_a_wrong_reading_is_told_in_the_terms_of_the_device(load: Load, value: str, said: object, meant: str) -> None:
    binding = only(load(f"source.read_holding = {{ address = 1, count = 1 }}\nvalue = {value}"), "read_holding")
    message = {"jsonrpc": "2.0", "id": 1, "result": {"content": [{"type": "text", "text": json.dumps(said)}]}}
    response = (json.dumps(message) + "\n").encode()
    exchange = Exchange(tool="level", arguments={}, request=b"", response=response, sent_ns=1, received_ns=2)
    expectation = Expectation.of(
        binding, at(1), adapter="modbus", variant="rw", operation="read_holding", deadline_s=5, listed=True
    )
    (finding,) = succeeded(observe(exchange, expectation), values=[215])
    assert finding.message == f"level(): the device holds 215, by the subject file the reply means {meant}"
    assert due(cast(Any, {"code": finding.code, "message": finding.message})) == "what means 215 at the device"


def test_places_that_share_a_register_are_not_set_together() -> None:
    inputs = [{"address": address, "type": "float32", READING: "level"} for address in (0, 1, 2)]
    asked = [asked_of("modbus", "read_typed", one, 1.5) for one in inputs]
    assert apart(asked) == [asked[0], asked[2]]
