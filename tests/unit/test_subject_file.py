"""The subject file: its keys and values are understood, and what it must not say is refused in one sentence."""

from __future__ import annotations

import datetime
import json
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any, cast

import jsonschema
import pytest

from pytest_otmcp.errors import UsageError
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.subject import Adapter, Binding, Function, Subject, load_subject, reference_subject
from pytest_otmcp.subject.claims import Claims
from pytest_otmcp.subject.schema import shipped_text

MINIMAL = """
[subject]
name = "x"
version = "1"
"""
LAUNCH = f"""{MINIMAL}
[adapter.modbus]
command = ["adapter"]
"""
FOREIGN = f"""{LAUNCH}
answer = "text"
"""


def why_not(adapter: Adapter, facet: str) -> str | None:
    """Say why the adapter does not claim a facet; None when it does."""
    return Claims.of_subject({adapter.protocol: adapter}).why_not(f"{adapter.protocol}.{facet}")


def load(tmp_path: Path, text: str) -> Subject:
    file = tmp_path / "otmcp.toml"
    file.write_text(text, encoding="utf-8")
    return load_subject(file)


def schema() -> Any:
    return json.loads(shipped_text())


def test_the_reference_adapters_are_described_completely() -> None:
    subject = reference_subject()
    for protocol, adapter in subject.adapters.items():
        assert set(adapter.operations) == set(protocols()[protocol].operations)
        assert adapter.facts()["unjudged"] == []
        assert adapter.facts()["unclaimed"] == {}
        assert adapter.facts()["envelope"] == "native"
    assert set(subject.adapters) == set(protocols())


def test_two_seconds_in_which_any_process_is_stopped_are_held_against_no_reference_adapter() -> None:
    for protocol, adapter in reference_subject().adapters.items():
        for name, variant in adapter.variants.items():
            exchange, call = (float(variant.env[f"{protocol.upper()}_{what}_S"]) for what in ("TIMEOUT", "DEADLINE"))
            if name == "retimed":
                # What has to work with a short time-out is asked for until it does.
                assert adapter.times is not None
                assert exchange + 2.0 <= adapter.times.deadline_s < call
                continue
            assert 2.0 < exchange < call, "the device may be stopped"
            assert call + 2.0 < adapter.deadline_s, "the adapter or the kit may be stopped when its time-out is due"


def test_an_adapter_that_says_nothing_of_its_tools_has_those_of_the_reference_adapter(tmp_path: Path) -> None:
    adapter = load(tmp_path, LAUNCH).adapters["modbus"]
    reference = reference_subject().adapters["modbus"].operations
    assert adapter.operations.keys() == {"ping", "read_input", "read_holding", "write_holding"}
    for name, bound in adapter.operations.items():
        (binding,), (whole,) = cast("Any", bound), cast("Any", reference[name])
        assert (binding.tool, binding.outputs) == (whole.tool, whole.outputs)
        assert binding.arguments.items() <= whole.arguments.items()
    assert adapter.variants["rw"].command == ("adapter",)


def test_variants_add_arguments_and_environment(tmp_path: Path) -> None:
    text = LAUNCH + 'env = { A = "{port}" }\nro = { args = ["--read-only"], env = { B = "{host}" } }\n'
    ro = load(tmp_path, text).adapters["modbus"].variants["ro"].for_endpoint({"host": "127.0.0.1", "port": "5020"})
    assert ro.command == ("adapter", "--read-only")
    assert ro.env == {"A": "5020", "B": "127.0.0.1"}


def test_a_variant_may_have_a_command_of_its_own(tmp_path: Path) -> None:
    adapter = load(tmp_path, LAUNCH + 'ro = { command = ["other"] }\n').adapters["modbus"]
    assert adapter.variants["ro"].command == ("other",)
    assert adapter.variants["rw"].command == ("adapter",)


BOTH_COMMANDS = f"""{MINIMAL}
[adapter.modbus]
rw = {{ command = ["one"] }}
ro = {{ command = ["other"] }}
"""


def test_a_command_for_each_variant_is_enough(tmp_path: Path) -> None:
    variants = load(tmp_path, BOTH_COMMANDS).adapters["modbus"].variants
    assert {name: variant.command for name, variant in variants.items()} == {"rw": ("one",), "ro": ("other",)}


def test_a_working_directory_is_that_of_the_file_however_the_file_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "otmcp.toml").write_text(f'{LAUNCH}cwd = "."\n', encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    # otmcp doctor names the file in this way.
    adapter = load_subject(Path("otmcp.toml")).adapters["modbus"]
    assert adapter.variants["rw"].cwd == tmp_path.resolve()


def test_an_argument_template_is_filled_with_inputs_and_endpoint(tmp_path: Path) -> None:
    text = FOREIGN + (
        '[adapter.modbus.bind.read_holding]\ntool = "read"\n'
        'arguments = { device = { at = "{host}:{port}", port = "{port:int}" }, address = "$address", n = ["$count"] }\n'
        'offset = { address = 40001 }\nas = { count = "string" }\nresult = { values = {} }\n'
    )
    (binding,) = bindings(load(tmp_path, text), "modbus", "read_holding")
    filled = binding.fill({"address": 9, "count": 4}, {"host": "127.0.0.1", "port": "502"})
    assert filled == {"device": {"at": "127.0.0.1:502", "port": 502}, "address": 40010, "n": ["4"]}


def bindings(subject: Subject, protocol: str, operation: str) -> tuple[Binding, ...]:
    bound = subject.adapters[protocol].operations[operation]
    assert isinstance(bound, tuple)
    return bound


def test_nodes_may_have_names_of_the_vendors_own(tmp_path: Path) -> None:
    text = f"""{MINIMAL}
[adapter.opcua]
command = ["adapter"]
answer = "json"
[adapter.opcua.bind.read_many]
tool = "read"
arguments = {{ points = "$nodes" }}
names = {{ nodes = {{ "ns=2;s=Temperature" = "temp" }} }}
result = {{ values = "values" }}
"""
    (binding,) = bindings(load(tmp_path, text), "opcua", "read_many")
    filled = binding.fill({"nodes": ["ns=2;s=Temperature", "ns=2;s=Pressure"]}, {})
    assert filled == {"points": ["temp", "ns=2;s=Pressure"]}


def test_one_operation_may_be_several_tools(tmp_path: Path) -> None:
    text = FOREIGN + (
        "[[adapter.modbus.bind.read_holding]]\n"
        'tool = "read_one"\nwhen = { count = 1 }\nresult = { values = { wrap = true } }\n'
        "[[adapter.modbus.bind.read_holding]]\n"
        'tool = "read_many"\nresult = { values = {} }\n'
    )
    one, many = bindings(load(tmp_path, text), "modbus", "read_holding")
    assert (one.tool, dict(one.when)) == ("read_one", {"count": 1})
    assert (many.tool, dict(many.when)) == ("read_many", {})


def test_a_tool_may_be_for_any_of_several_values(tmp_path: Path) -> None:
    text = (
        FOREIGN
        + '[adapter.modbus.bind.read_typed]\ntool = "read"\nwhen = { type = ["int16", "uint16"] }\nresult = { value = "v" }\n'
    )
    (binding,) = bindings(load(tmp_path, text), "modbus", "read_typed")
    fitting = {kind: binding.fits({"address": 1, "type": kind}) for kind in ("int16", "uint16", "float32")}
    assert fitting == {"int16": True, "uint16": True, "float32": False}


def test_a_facet_that_is_not_claimed_has_a_reason(tmp_path: Path) -> None:
    text = FOREIGN + 'unclaimed = { guard = "has no read-only mode", ping = "no such tool" }\nbind = {}\n'
    adapter = load(tmp_path, text).adapters["modbus"]
    assert why_not(adapter, "guard") == "has no read-only mode"
    assert why_not(adapter, "read_input") is None
    assert adapter.why_not_testable("read_input") == "no tool is bound to the operation 'read_input'"


def test_an_input_without_a_place_is_not_testable(tmp_path: Path) -> None:
    text = f"""{MINIMAL}
[adapter.mqtt]
command = ["adapter"]
answer = "text"
[adapter.mqtt.bind.subscribe]
tool = "subscribe"
arguments = {{ topic = "$filter" }}
"""
    adapter = load(tmp_path, text).adapters["mqtt"]
    assert adapter.why_not_testable("subscribe") is None
    assert adapter.why_not_testable("subscribe.qos") == "no binding of 'subscribe' has a place for $qos"


def test_who_needs_a_new_session_does_not_claim_recovery(tmp_path: Path) -> None:
    adapter = load(tmp_path, LAUNCH + 'recovery = "new_session"\n').adapters["modbus"]
    assert why_not(adapter, "recovery") == "needs a new session after an outage"


@pytest.mark.parametrize(("role", "claimed"), [("edge", True), ("host", False), ("none", False)])
def test_only_an_edge_node_claims_births_and_data(tmp_path: Path, role: str, claimed: bool) -> None:
    text = f'{MINIMAL}[adapter.mqtt]\ncommand = ["adapter"]\nsparkplug = "{role}"\n'
    adapter = load(tmp_path, text).adapters["mqtt"]
    assert (why_not(adapter, "device_data") is None) == claimed
    assert (why_not(adapter, "device_birth") is None) == claimed
    assert why_not(adapter, "publish") is None


STATUS = f"""{LAUNCH}
[adapter.modbus.bind.ping]
tool = "status"
source = "cache"
max_age_s = 1.5
"""


def test_a_status_may_be_declared_to_come_from_a_cache(tmp_path: Path) -> None:
    adapter = load(tmp_path, STATUS).adapters["modbus"]
    assert adapter.cached == {"ping": 1.5}
    assert adapter.facts()["cached"] == {"ping": 1.5}
    assert reference_subject().adapters["modbus"].cached == {}


def test_the_time_to_come_back_is_five_seconds_unless_it_is_declared_to_be_less(tmp_path: Path) -> None:
    assert load(tmp_path, LAUNCH).adapters["modbus"].recovery_s == 5.0
    assert load(tmp_path, LAUNCH + "recovery_s = 2\n").adapters["modbus"].facts()["recovery_s"] == 2.0


def test_a_limit_of_calls_may_be_declared(tmp_path: Path) -> None:
    limited = load(tmp_path, LAUNCH + "call_limit = { calls = 25, per_s = 120 }\n").adapters["modbus"]
    assert limited.facts()["call_limit"] == {"calls": 25, "per_s": 120.0}
    assert load(tmp_path, LAUNCH).adapters["modbus"].facts()["call_limit"] is None


def test_further_topics_of_commands_may_be_declared(tmp_path: Path) -> None:
    text = LAUNCH.replace("modbus", "mqtt") + 'command_topics = ["line/+/set"]\n'
    assert load(tmp_path, text).adapters["mqtt"].lists["command_topics"] == ("line/+/set",)
    assert load(tmp_path, LAUNCH).adapters["modbus"].lists == {}


def test_deviations_have_a_last_day(tmp_path: Path) -> None:
    text = LAUNCH + '[[deviation]]\nitem = "FM1"\nreason = "known"\nexpires = 2027-03-31\n'
    (deviation,) = load(tmp_path, text).deviations
    assert (deviation.item, deviation.reason) == ("FM1", "known")
    assert deviation.expires == datetime.date(2027, 3, 31)


def test_the_digest_covers_the_bindings_file(tmp_path: Path) -> None:
    text = FOREIGN + 'bindings = "b.py"\n'
    (tmp_path / "b.py").write_text("async def ping(tools):\n    return {}\n", encoding="utf-8")
    first = load(tmp_path, text)
    (tmp_path / "b.py").write_text("async def ping(tools):\n    return {'reachable': True}\n", encoding="utf-8")
    assert first.digest != load(tmp_path, text).digest
    assert isinstance(first.adapters["modbus"].operations["ping"], Function)


REFUSED = {
    "no table of its own": ("", "adapter: expected a table, found nothing"),
    "unknown protocol": (MINIMAL + "[adapter.modbuss]\n", "adapter.modbuss: unknown key; did you mean 'modbus'?"),
    "no command": (MINIMAL + "[adapter.modbus]\n", "adapter.modbus.command: expected a non-empty list of strings"),
    "command as text": (
        MINIMAL + '[adapter.modbus]\ncommand = "adapter --x"\n',
        "adapter.modbus.command: expected a non-empty list of strings",
    ),
    "misspelt key": (LAUNCH + "deadlines = 3\n", "adapter.modbus.deadlines: unknown key; did you mean 'deadline_s'?"),
    "deadline": (LAUNCH + "deadline_s = -1\n", "adapter.modbus.deadline_s: expected seconds above 0 and up to 300"),
    "recovery too slow": (
        LAUNCH + "recovery_s = 6\n",
        "adapter.modbus.recovery_s: expected seconds above 0 and up to 5",
    ),
    "limit of no calls": (
        LAUNCH + "call_limit = { calls = 0, per_s = 1 }\n",
        "adapter.modbus.call_limit.calls: expected a whole number above 0, found 0",
    ),
    "limit without a time": (
        LAUNCH + "call_limit = { calls = 1 }\n",
        "adapter.modbus.call_limit.per_s: expected seconds above 0 and up to 300, found None",
    ),
    "cache too old": (
        STATUS.replace("1.5", "30"),
        "adapter.modbus.bind.ping.max_age_s: expected seconds above 0 and up to 5, found 30",
    ),
    "cache without age": (
        STATUS.replace("max_age_s = 1.5", ""),
        'adapter.modbus.bind.ping.max_age_s: source = "cache" says how old an answer may be, and nothing else does',
    ),
    "age without cache": (
        STATUS.replace("cache", "device"),
        'adapter.modbus.bind.ping.max_age_s: source = "cache" says how old an answer may be, and nothing else does',
    ),
    "cache of a value": (
        STATUS.replace("bind.ping]", "bind.read_holding]") + 'result = { values = "v" }\n',
        "adapter.modbus.bind.read_holding.source: only a status may come from a cache",
    ),
    "command topics": (
        LAUNCH + 'command_topics = ["x"]\n',
        "adapter.modbus.command_topics: unknown key",
    ),
    "no retained message": (
        LAUNCH.replace("modbus", "mqtt") + 'retained = ["estate/devices"]\n',
        "adapter.mqtt: retained: expected TOPIC=PAYLOAD, found 'estate/devices'",
    ),
    "environment": (LAUNCH + "env = { A = 1 }\n", "adapter.modbus.env.A: expected a string, found a number"),
    "directory": (LAUNCH + 'cwd = "nowhere"\n', "adapter.modbus.cwd:"),
    "file elsewhere": (LAUNCH + 'files = { "../x" = "" }\n', "'../x' must be a name below {work}"),
    "unknown facet": (
        LAUNCH + 'unclaimed = { guards = "x" }\n',
        "adapter.modbus.unclaimed.guards: unknown key; did you mean 'guard'?",
    ),
    "no reason": (LAUNCH + 'unclaimed = { guard = " " }\n', "adapter.modbus.unclaimed.guard: expected the reason"),
    "network of the machine without a reason": (
        LAUNCH + 'isolation = { network = "host" }\n',
        "adapter.modbus.isolation: network = 'host' needs a 'reason', which reports and certificates show",
    ),
    "url without http": (LAUNCH + 'url = "http://127.0.0.1:1/"\n', 'only an adapter with transport = "http"'),
    "http without url": (
        LAUNCH + 'transport = "http"\n',
        "adapter.modbus.url: expected a non-empty string, found nothing",
    ),
    "command of one variant": (
        MINIMAL + '[adapter.modbus]\nro = { command = ["adapter"] }\n',
        "adapter.modbus.command: expected a non-empty list of strings",
    ),
    "another host": (
        LAUNCH + 'transport = "http"\nurl = "http://10.0.0.1/mcp"\n',
        "expected http:// with a loopback address, found 'http://10.0.0.1/mcp'",
    ),
    "no connect step": (LAUNCH + 'recovery = "connect_step"\n', "'connect_step' needs a 'connect' table"),
    "recovery": (LAUNCH + 'recovery = "never"\n', "adapter.modbus.recovery: unknown 'never'; known are"),
    "sparkplug": (LAUNCH + 'sparkplug = "edge"\n', "adapter.modbus.sparkplug: unknown key"),
    "answer": (LAUNCH + 'answer = "jsn"\n', "adapter.modbus.answer: unknown 'jsn'; did you mean 'json'?"),
    "rules for an envelope": (
        LAUNCH + 'errors = [{ text = "x", code = "timeout" }]\n',
        "an adapter that answers in envelopes needs no such rules",
    ),
    "foreign without bindings": (FOREIGN, "adapter.modbus: expected 'bind' tables"),
    "unknown operation": (
        FOREIGN + 'bind = { read_holdings = { tool = "x" } }\n',
        "adapter.modbus.bind.read_holdings: unknown key; did you mean 'read_holding'?",
    ),
    "unknown input": (
        FOREIGN + 'bind = { ping = { tool = "x", arguments = { a = "$adress" } } }\n',
        "adapter.modbus.bind.ping.arguments.a: $adress is no input of this operation; its inputs are: none",
    ),
    "input within a text": (
        FOREIGN + 'bind = { read_holding = { tool = "x", arguments = { at = ["H$address"] } } }\n',
        "adapter.modbus.bind.read_holding.arguments.at: 'H$address' would be sent as it is: an input stands alone",
    ),
    "no tool": (FOREIGN + "bind = { ping = {} }\n", "adapter.modbus.bind.ping.tool: expected a non-empty string"),
    "nothing to judge": (
        FOREIGN + 'bind = { read_holding = { tool = "x" } }\n',
        "adapter.modbus.bind.read_holding.result: lacks 'values', without which the operation cannot be judged",
    ),
    "hidden case": (
        FOREIGN + 'bind = { ping = [{ tool = "x" }, { tool = "y" }] }\n',
        "adapter.modbus.bind.ping[0]: without 'when' it hides the tables after it",
    ),
    "jmespath": (
        FOREIGN + 'bind = { ping = { tool = "x", result = { reachable = "a[" } } }\n',
        "adapter.modbus.bind.ping.result.reachable: not a JMESPath expression",
    ),
    "regular expression": (
        FOREIGN + 'outcome = [{ text = "(", then = "failure" }]\n',
        "adapter.modbus.outcome[0].text: not a regular expression",
    ),
    "outcome without condition": (FOREIGN + 'outcome = [{ then = "failure" }]\n', "expected a condition"),
    "unknown code": (
        FOREIGN + 'errors = [{ text = "x", code = "illegal_adress" }]\n',
        "adapter.modbus.errors[0].code: unknown 'illegal_adress'; did you mean 'illegal_address'?",
    ),
    "conversion": (
        FOREIGN + 'bind = { read_holding = { tool = "x", as = { count = "integer" }, result = { values = {} } } }\n',
        "adapter.modbus.bind.read_holding.as.count: unknown 'integer'",
    ),
    "resource and tool": (
        FOREIGN + 'bind = { ping = { tool = "x", resource = "y://z" } }\n',
        "adapter.modbus.bind.ping.resource: a resource is read without tool and arguments",
    ),
    "resource and arguments": (
        FOREIGN + 'bind = { ping = { resource = "y://z", arguments = { a = 1 } } }\n',
        "adapter.modbus.bind.ping.resource: a resource is read without tool and arguments",
    ),
    "messages of no topic": (
        FOREIGN + 'bind = { ping = { tool = "x", topic = "subscribed" } }\n',
        "adapter.modbus.bind.ping.topic: only messages are of a topic",
    ),
    "blocking": (
        FOREIGN + 'bind = { ping = { tool = "x", blocking = true } }\n',
        "adapter.modbus.bind.ping.blocking: only a call for messages may wait for them",
    ),
    "no bindings file": (FOREIGN + 'bindings = "none.py"\n', "there is no such file"),
    "deviation without day": (LAUNCH + '[[deviation]]\nitem = "M1"\nreason = "x"\n', "expected a date such as"),
    "deviation twice": (
        LAUNCH + 2 * '[[deviation]]\nitem = "M1"\nreason = "x"\nexpires = 2030-01-01\n',
        "more than one for the item M1",
    ),
    "not TOML": ("[subject\n", "not valid TOML"),
}


@pytest.mark.parametrize("name", list(REFUSED))
def test_what_cannot_be_understood_is_refused_with_file_key_and_expectation(tmp_path: Path, name: str) -> None:
    text, expected = REFUSED[name]
    with pytest.raises(UsageError) as refused:
        load(tmp_path, text)
    message = str(refused.value)
    assert "\n" not in message
    assert str(tmp_path) in message
    assert expected in message if text else "subject: expected a table" in message


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("import nonesuch\n", "cannot be imported: ModuleNotFoundError"),
        ("def ping(tools):\n    return {}\n", "ping must be an 'async def'"),
        ("async def pong(tools):\n    return {}\n", "pong is no operation; they are ping, read_input"),
        (
            "async def read_input(tools, address):\n    return {}\n",
            "must be callable as read_input(tools, *, address, count)",
        ),
    ],
    ids=["import", "synchronous", "unknown", "signature"],
)
def test_a_bindings_file_is_checked_before_anything_runs(tmp_path: Path, content: str, expected: str) -> None:
    (tmp_path / "b.py").write_text(content, encoding="utf-8")
    with pytest.raises(UsageError, match=r"b\.py") as refused:
        load(tmp_path, FOREIGN + 'bindings = "b.py"\n')
    assert expected in str(refused.value)


def test_the_editors_schema_accepts_what_the_kit_accepts() -> None:
    validator = jsonschema.Draft202012Validator(schema())
    validator.check_schema(schema())
    reference = resources.files("pytest_otmcp.subject") / "reference.toml"
    examples = sorted((Path(__file__).parents[2] / "docs" / "examples").glob("*/otmcp.toml"))
    assert examples
    for text in [BOTH_COMMANDS, *(file.read_text(encoding="utf-8") for file in (reference, *examples))]:
        assert list(validator.iter_errors(tomllib.loads(text))) == []


@pytest.mark.parametrize("name", [name for name, (text, _) in REFUSED.items() if name not in ("not TOML",)])
def test_the_editors_schema_refuses_what_the_kit_refuses(name: str) -> None:
    """The kit knows more than the schema: files, JMESPath, regular expressions, rules about several tables."""
    text, _ = REFUSED[name]
    found = list(jsonschema.Draft202012Validator(schema()).iter_errors(tomllib.loads(text)))
    by_kit_alone = {
        "directory", "file elsewhere", "rules for an envelope", "foreign without bindings", "unknown input", "hidden case",
        "jmespath", "regular expression", "no bindings file", "deviation twice", "another host",
        "no retained message",
    }  # fmt: skip
    assert bool(found) == (name not in by_kit_alone)


def test_an_answer_that_is_no_envelope_cannot_say_how_old_it_is(tmp_path: Path) -> None:
    text = STATUS.replace("[adapter.modbus.bind", 'answer = "json"\n[adapter.modbus.bind')
    with pytest.raises(
        UsageError, match=r"bind\.ping\.source: only an answer in the kit's envelope says how old it is"
    ):
        load(tmp_path, text)


SECRETS = """
[subject]
name = "x"
version = "1"
[adapter.mqtt]
command = ["adapter"]
env = { BROKER_PIN = "plant-4711-west", SHORT = "geheim1", WORD = "administrator" }
secrets = ["BROKER_PIN", "SHORT", "WORD"]
secret_env = ["MQTT_PASSWORD"]
"""


def test_a_secret_variable_gets_its_value_from_the_kit(tmp_path: Path) -> None:
    file = tmp_path / "otmcp.toml"
    file.write_text(SECRETS, encoding="utf-8")
    adapter = load_subject(file).adapters["mqtt"]
    assert adapter.secret_env == ("MQTT_PASSWORD",)
    # A short secret, or a word, may be in an answer for another reason.
    assert adapter.telling_secrets(adapter.variants["rw"].env) == {"BROKER_PIN": "plant-4711-west"}
    file.write_text(SECRETS.replace("SHORT =", "MQTT_PASSWORD ="), encoding="utf-8")
    with pytest.raises(UsageError, match=r"adapter\.mqtt\.secret_env: MQTT_PASSWORD has a value in 'env'"):
        load_subject(file)


def test_an_input_that_no_tool_is_given_is_known(tmp_path: Path) -> None:
    (tmp_path / "bindings.py").write_text(
        "async def write_db(tools, *, db, start, type, value):\n"
        "    def place():\n"
        "        return start\n"
        "    return await tools.call('write', place=place(), value=value)\n",
        encoding="utf-8",
    )
    file = tmp_path / "otmcp.toml"
    file.write_text(
        """
        [subject]
        name = "acme"
        version = "1"

        [adapter.s7]
        command = ["acme"]
        bindings = "bindings.py"

        [adapter.s7.bind.read_typed]
        tool = "read"
        when = { type = "INT" }
        arguments = { at = "$start" }
        result.value = "value"
        """,
        encoding="utf-8",
    )
    # Whoever compares a record with the file executes nothing of it, and has to find the same.
    for run in (True, False):
        adapter = load_subject(file, run=run).adapters["s7"]
        assert adapter.missing_inputs() == {"read_typed.db", "write_db.db", "write_db.type"}
