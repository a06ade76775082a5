"""Policy, approval and audit log of the reference adapters: what they answer, what is on disk, and what the device saw."""

# In the checkout mypy does not find the installed name of the adapters' folder.
# mypy: disable-error-code="import-not-found"

from __future__ import annotations

import contextlib
import errno
import hashlib
import io
import json
import os
import resource
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pytest_otmcp.reference_adapters import modbus
from pytest_otmcp.reference_adapters.approvals import main as approver
from pytest_otmcp.reference_adapters.audit import main as verifier
from pytest_otmcp.reference_adapters.core import AdapterError, Call, ConfigError, Environment
from pytest_otmcp.reference_adapters.core import audit as core_audit
from pytest_otmcp.reference_adapters.core.gates import Gates

from .cases import CASES, MODBUS, Case
from .conftest import LEGACY, MODERN, Client, Mock, Reply, Rig

pytestmark = pytest.mark.usefixtures("clean")
CASE = MODBUS
FORMS = {"elicitation": {"form": {}}}
ANYTHING = json.dumps(["/".join("*" * depth) for depth in range(1, 8)])
"""Patterns that cover every target; MQTT's have most levels."""

POLICY = """
[rule.setpoints]
targets = ["1/holding_registers/20..29"]
tools = ["write_register", "write_registers"]
lowest = 0
highest = 800
label = "Setpoints, 0.1 degC"

[rule.steps]
targets = ["1/holding_registers/30"]
step = 10

[rule.positions]
targets = ["1/coils/1..3", "1/holding_registers/31"]
values = [true, 4]

[rule.few]
targets = ["1/holding_registers/40..41"]
per_minute = 2

[rule.asked]
targets = ["1/holding_registers/50..59"]
approve = "client"
highest = 800
label = "Limit of the boiler"

[rule.signed]
targets = ["1/holding_registers/60..69"]
approve = "inbox"

[rule.maintenance]
targets = ["1/holding_registers/*"]
roles = ["engineer"]
"""

Start = Callable[..., Client]


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return tmp_path / "audit.jsonl"


@pytest.fixture
def start(rig: Rig, log: Path, tmp_path: Path) -> Start:
    """Start an adapter with a policy and an audit log."""

    def starting(policy: str = POLICY, role: str = "operator", **more: Any) -> Client:
        file = tmp_path / "policy.toml"
        file.write_text(policy)
        (tmp_path / "inbox").mkdir(exist_ok=True)
        settings = {
            "OT_POLICY": str(file),
            "OT_AUDIT_LOG": str(log),
            "OT_APPROVAL_INBOX": str(tmp_path / "inbox"),
            "OT_PRINCIPAL": "alice",
            "OT_ROLE": role,
        }
        return rig.start("gated", writes="true", **settings | more)

    return starting


def records(log: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in log.read_bytes().splitlines()]


def events(log: Path) -> list[str]:
    return [record["event"] for record in records(log)]


def writes(device: Mock, mark: int) -> list[dict[str, Any]]:
    return device.since(mark, kind="request", state_changing=True)


def audit(*arguments: object) -> tuple[int, str]:
    """Return the exit code of the verifier, and what it printed."""
    return printed(verifier, "verify", *arguments)


def printed(program: Callable[[list[str]], int], *arguments: object) -> tuple[int, str]:
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        return program([str(argument) for argument in arguments]), said.getvalue()


def write(client: Client, address: int, value: int) -> Reply:
    return client.call("write_register", address=address, value=value)


# -- policy ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("tool", "arguments", "code", "rule"),
    [
        ("write_register", {"address": 70, "value": 1}, "access_denied", None),
        ("write_register", {"address": 20, "value": 1, "unit_id": 2}, "access_denied", None),
        ("write_registers", {"address": 19, "values": [1, 1]}, "access_denied", None),
        ("mask_write_register", {"address": 20, "and_mask": 0, "or_mask": 1}, "access_denied", None),
        ("write_coil", {"address": 20, "value": True}, "access_denied", None),
        ("write_register", {"address": 20, "value": 801}, "range_overflow", "setpoints"),
        ("write_registers", {"address": 20, "values": [0, 801]}, "range_overflow", "setpoints"),
        ("write_register", {"address": 30, "value": 111}, "range_overflow", "steps"),
        ("mask_write_register", {"address": 30, "and_mask": 0, "or_mask": 1}, "range_overflow", "steps"),
        ("write_coil", {"address": 1, "value": False}, "range_overflow", "positions"),
        ("write_register", {"address": 31, "value": 1}, "range_overflow", "positions"),
    ],
)
def test_what_the_policy_refuses_does_not_reach_the_device(
    start: Start, device: Mock, log: Path, tool: str, arguments: dict[str, Any], code: str, rule: str | None
) -> None:
    client, mark = start(), device.mark()
    device("poke", params={"table": "holding_registers", "address": 30, "values": [100]})
    reply = client.call(tool, arguments)
    assert (reply.error["code"], reply.error["outcome"]) == (code, "not_sent")
    assert reply.error["details"].get("rule") == rule
    assert reply.meta["policy"]["decision"] == "deny"
    assert writes(device, mark) == []
    _, refused = records(log)
    assert (refused["event"], refused["code"], refused["decision"]) == ("refused", code, "deny")
    assert reply.meta["audit_id"] == f"{refused['seq']}:{refused['hash'][:16]}"


def test_what_the_policy_allows_is_done_and_recorded(start: Start, device: Mock, log: Path) -> None:
    client, mark = start(), device.mark()
    device("poke", params={"table": "holding_registers", "address": 30, "values": [100]})
    replies = [write(client, 20, 0), write(client, 29, 800), write(client, 30, 110), write(client, 31, 4)]
    replies.append(client.call("write_coil", address=1, value=True))
    for reply in replies:
        assert reply.envelope["success"], reply.envelope
    # The value that a step is from was asked for.
    assert [reply.meta["attempts"] for reply in replies] == [1, 1, 2, 1, 1]
    assert replies[2].meta["policy"] == {"decision": "allow", "rule": "steps", "principal": "local:alice"}
    assert len(writes(device, mark)) == 5
    assert events(log) == ["start", *["intent", "outcome"] * 5]
    intent, outcome = records(log)[1:3]
    assert intent["changes"] == [["1/holding_registers/20", 0]]
    assert (intent["principal"], intent["role"], intent["rules"]) == ("local:alice", "operator", ["setpoints"])
    assert intent["endpoint"] == replies[0].meta["endpoint"]
    assert intent["request_id"] == outcome["request_id"] == replies[0].meta["request_id"]
    assert (outcome["code"], outcome["outcome"]) == (None, "applied")
    # What was refused changes nothing of what is allowed.
    assert write(client, 30, 121).error["code"] == "range_overflow"
    assert write(client, 30, 120).envelope["success"]


def test_a_role_is_that_of_the_launch_alone(start: Start, device: Mock) -> None:
    mark = device.mark()
    for role in ("viewer", "operator"):
        client = start(role=role)
        reply = client.call("write_register", address=70, value=1)
        assert reply.error["code"] == "access_denied"
        with_argument = client.call("write_register", {"address": 70, "value": 1, "role": "engineer"})
        assert with_argument.error["code"] == "invalid_input"
        assert client.call("read_register", address=70).envelope["success"]
        client.abandon()
    assert writes(device, mark) == []
    assert write(start(role="engineer"), 70, 1).envelope["success"]


def test_a_viewer_writes_nothing_and_asks_the_device_nothing(start: Start, device: Mock) -> None:
    client, mark = start(role="viewer"), device.mark()
    for tool, arguments in MODBUS.writes.items():
        assert client.call(tool, arguments).error["code"] == "access_denied"
    client.call("ping")
    assert len(device.since(mark, kind="request")) == 1


def test_more_than_a_rule_allows_in_a_minute_is_refused(start: Start, device: Mock) -> None:
    client, mark = start(), device.mark()
    assert write(client, 40, 1).envelope["success"]
    assert write(client, 41, 1).envelope["success"]
    error = write(client, 40, 1).error
    assert (error["code"], error["details"]["rule"]) == ("rate_limited", "few")
    assert 0 < error["retry_after_ms"] <= 60_000
    assert len(writes(device, mark)) == 2
    assert write(client, 20, 1).envelope["success"]


@pytest.mark.parametrize(
    ("policy", "sentence"),
    [
        ("", "rule"),
        ("[rule.a]\ntargets = ['x']\nhighst = 5", "rule.a.highst"),
        ("[rule.a]\ntargets = ['x']\ntools = ['write_regster']", "write_regster"),
        ("[rule.a]\ntargets = ['x']\ntools = ['read_register']", "read_register"),
        ("[rule.a]\ntargets = ['x']\nroles = ['admin']", "rule.a.roles"),
        ("[rule.a]\ntargets = ['x']\nroles = ['viewer']", "rule.a.roles"),
        ("[rule.a]\ntargets = []", "rule.a.targets"),
        ("[rule.a]\nlowest = 1", "rule.a.targets"),
        ("[rule.a]\ntargets = ['x']\nlowest = nan", "rule.a.lowest"),
        ("[rule.a]\ntargets = ['x']\napprove = 'inbox'", "OT_APPROVAL_INBOX"),
        ("[rule.a", "policy.toml"),
        ("[[rule]]\ntargets = ['x']", "rule"),
    ],
)
def test_a_policy_that_is_not_understood_stops_the_start(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, policy: str, sentence: str
) -> None:
    (tmp_path / "policy.toml").write_text(policy)
    monkeypatch.setenv("OT_POLICY", str(tmp_path / "policy.toml"))
    with pytest.raises(ConfigError) as caught:
        modbus.build().ready(over_http=False, has_tokens=False)
    assert str(caught.value).startswith("OT_POLICY: ")
    assert sentence in str(caught.value)


def test_a_bad_policy_is_one_sentence_and_exit_code_2(rig: Rig, tmp_path: Path) -> None:
    (tmp_path / "policy.toml").write_text("[rule.a]\ntargets = ['x']\ntools = ['write_regster']")
    command = [sys.executable, "-m", "pytest_otmcp.reference_adapters", "modbus"]
    settings = {**os.environ, **rig.settings("bad", OT_POLICY=str(tmp_path / "policy.toml"))}
    done = subprocess.run(command, env=settings, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False)
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (2, "", 1)
    assert "write_regster" in done.stderr


def test_a_tool_that_goes_on_after_a_refusal_sends_nothing(tmp_path: Path) -> None:
    (tmp_path / "policy.toml").write_text(POLICY)
    environment = Environment({"OT_POLICY": str(tmp_path / "policy.toml"), "OT_ROLE": "operator"})
    gates = Gates.of(environment, "toy", "toy://")
    assert gates is not None
    for said in (["1/holding_registers/70"], ["1/holding_registers/50"], ["1/holding_registers/20", "1/coils/9"], []):
        gate = gates.gate("write_register", "toy.write", {}, None)
        call = Call(protocol="toy", operation="toy.write", endpoint="toy://", writes=True, gate=gate)
        call.begin()
        for target in said:
            with contextlib.suppress(AdapterError):
                call.changes((target, 1))
        call.sending(changes_state=False)
        with pytest.raises(AdapterError) as refused:
            call.sending()
        assert refused.value.code == "access_denied"
        assert call.writes_sent == 0


# -- all adapters ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", CASES, ids=str)
def test_every_writing_tool_of_every_adapter_passes_the_gates(
    case: Case, rigs: Callable[[Case], Rig], tmp_path: Path
) -> None:
    rig = rigs(case)
    rig.device("reset")
    policy, log = tmp_path / "policy.toml", tmp_path / "audit.jsonl"
    settings = {"OT_POLICY": str(policy), "OT_AUDIT_LOG": str(log), "OT_ROLE": "operator"}
    policy.write_text("[rule.nothing]\ntargets = ['nowhere']")
    client, mark = rig.start("denied", writes="true", **settings), rig.device.mark()
    for tool, arguments in case.writes.items():
        if tool not in case.stateful:
            assert client.call(tool, arguments).error["code"] == "access_denied", tool
    assert rig.device.since(mark, state_changing=True) == []
    assert set(events(log)) == {"start", "refused"}
    client.abandon()
    log.unlink()

    policy.write_text(f"[rule.all]\ntargets = {ANYTHING}")
    client = rig.start("allowed", writes="true", **settings)
    for tool, arguments in case.writes.items():
        reply = client.call(tool, arguments)
        if tool not in case.stateful:
            assert reply.envelope["success"], (tool, reply.envelope)
            intent, outcome = records(log)[-2:]
            assert (intent["event"], outcome["event"], outcome["outcome"]) == ("intent", "outcome", "applied")
            assert intent["tool"] == tool
            assert intent["changes"], tool
            assert json.loads(intent["arguments"]) == arguments
        assert reply.meta["audit_id"] == f"{records(log)[-1]['seq']}:{records(log)[-1]['hash'][:16]}"
    assert audit(log)[0] == 0


STEPS = {
    "modbus": ("1/holding_registers/20", "write_register", {"address": 20}),
    "opcua": ("ns=2;s=FanSpeed", "write_opcua_node", {"node_id": "ns=2;s=FanSpeed"}),
    "ethernetip": ("FanSpeed", "write_tag", {"tag_name": "FanSpeed"}),
    "bacnet": (
        "12345/analog-output,1/present-value",
        "write_property",
        {"device_id": 12345, "object_type": "analog-output", "object_instance": 1},
    ),
    "dnp3": ("10/analog_output/0", "write_point_by_alias", {"alias": "setpoint"}),
}
"""By adapter that can ask what a target holds: a target, and the tool and the arguments that write it."""


@pytest.mark.parametrize("case", [case for case in CASES if case.protocol in STEPS], ids=str)
def test_a_step_is_from_what_the_device_holds_and_a_person_is_shown_it(
    case: Case, rigs: Callable[[Case], Rig], tmp_path: Path
) -> None:
    rig, (target, tool, place) = rigs(case), STEPS[case.protocol]
    rig.device("reset")
    policy = tmp_path / "policy.toml"
    policy.write_text(f"[rule.a]\ntargets = ['{target}']\nstep = 5\napprove = 'client'")
    client = rig.start("steps", writes="true", capabilities=FORMS, OT_POLICY=str(policy), OT_ROLE="operator")

    def value(number: int) -> dict[str, Any]:
        # What the device writes in whole numbers is written in whole numbers.
        return {**place, "value": float(number) if case.protocol in ("bacnet", "dnp3", "opcua") else number}

    assert rig.adapter.call(tool, value(50)).envelope["success"]
    mark = rig.device.mark()
    assert client.call(tool, value(56)).error["code"] == "range_overflow"
    result = asked(client, tool, **value(54))
    question = result["inputRequests"]["approval"]["params"]["message"]
    assert "now 50" in question
    assert "to be 54" in question
    assert rig.device.since(mark, state_changing=True) == []
    reply = client.reply(tool, again(client, result, ACCEPT, tool, **value(54)))
    assert reply.envelope["success"], reply.envelope
    assert client.call(tool, value(60)).error["code"] == "range_overflow"
    asked(client, tool, **value(59))


# -- audit log ---------------------------------------------------------------------------------------------------


def test_the_intent_is_on_disk_before_the_request_is_answered_and_survives_a_kill(
    start: Start, device: Mock, log: Path
) -> None:
    client, mark = start(), device.mark()
    assert write(client, 20, 1).envelope["success"]
    device.fault({"action": {"drop": True}})
    client.start("write_register", {"address": 21, "value": 2})
    device.wait(mark, 2, kind="request", state_changing=True)
    last = records(log)[-1]
    assert (last["event"], last["changes"]) == ("intent", [["1/holding_registers/21", 2]])
    client.process.kill()
    client.process.wait(timeout=10)
    assert audit(log, "--anchor", f"{last['seq']}:{last['hash'][:16]}")[0] == 0
    assert events(log) == ["start", "intent", "outcome", "intent"]
    device.fault()
    # The next process goes on where the last one ended.
    assert write(start(), 20, 3).envelope["success"]
    assert events(log)[4:] == ["start", "intent", "outcome"]
    assert audit(log)[0] == 0


@pytest.mark.parametrize("torn", [b'{"seq":2,"ti', b'{"seq":2,"ti\n', b'{"seq"\n{"seq":2,"time":"x","event":"start"}'])
def test_a_record_that_was_not_finished_is_told_of(start: Start, log: Path, torn: bytes) -> None:
    start().close()
    whole = log.read_bytes()
    log.write_bytes(whole + torn)
    code, said = audit(log)
    assert (code, f"{len(torn.replace(bytes([10]), b''))} bytes at the end" in said) == (0, True)
    assert write(start(), 20, 1).envelope["success"]
    after = log.read_bytes().splitlines()[whole.count(b"\n") + torn.count(b"\n") + (not torn.endswith(b"\n")) :]
    recovered = json.loads(after[0])
    assert (recovered["event"], recovered["lost_bytes"]) == ("recovered", len(torn.replace(b"\n", b"")))
    assert audit(log)[0] == 0
    log.write_bytes(log.read_bytes().replace(b'"ti', b'"tim', 1))
    assert audit(log)[0] == 1


def test_a_full_disk_refuses_writes_and_leaves_reads_alone(start: Start, device: Mock, log: Path) -> None:
    client = start()
    assert write(client, 20, 1).envelope["success"]
    size = log.stat().st_size
    resource.prlimit(client.process.pid, resource.RLIMIT_FSIZE, (size + 40, resource.RLIM_INFINITY))
    mark = device.mark()
    for _ in range(3):
        error = write(client, 20, 2).error
        assert (error["code"], error["outcome"]) == ("audit_unavailable", "not_sent")
        assert client.call("read_register", address=20).data["value"] == 1
    assert writes(device, mark) == []
    resource.prlimit(client.process.pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    assert write(client, 20, 3).envelope["success"]
    assert audit(log)[0] == 0
    lines = log.read_bytes().splitlines()
    recovered = json.loads(lines[-3])
    assert (recovered["event"], recovered["lost_bytes"], recovered["unrecorded"]) == ("recovered", 40, 3)


def test_a_disk_that_becomes_full_during_a_write_does_not_undo_it(start: Start, device: Mock, log: Path) -> None:
    client, mark = start(), device.mark()
    device.fault({"action": {"delay_s": 0.3}})
    identifier = client.start("write_register", {"address": 20, "value": 5})
    device.wait(mark, 1, kind="request", state_changing=True)
    size = log.stat().st_size
    resource.prlimit(client.process.pid, resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
    reply = client.reply("write_register", identifier)
    device.fault()
    assert reply.envelope["success"]
    intent = records(log)[-1]
    assert reply.meta["audit_id"] == f"{intent['seq']}:{intent['hash'][:16]}"


@pytest.mark.parametrize("reason", ["folder", "lock", "other file", "pipe", "link to a device"])
def test_a_log_that_cannot_be_used_refuses_writes_and_leaves_reads_alone(
    start: Start, device: Mock, log: Path, tmp_path: Path, reason: str
) -> None:
    if reason == "lock":
        start()
    elif reason == "other file":
        log.write_bytes(b"something else\nof somebody\n")
    elif reason == "pipe":
        os.mkfifo(log)
    elif reason == "link to a device":
        log.symlink_to("/dev/null")
    else:
        log = tmp_path / "missing" / "audit.jsonl"
    client, mark = start(OT_AUDIT_LOG=str(log)), device.mark()
    assert write(client, 20, 2).error["code"] == "audit_unavailable"
    assert client.call("read_register", address=20).envelope["success"]
    assert writes(device, mark) == []


def test_a_record_of_which_the_disk_does_not_say_that_it_has_it_is_not_believed(
    monkeypatch: pytest.MonkeyPatch, log: Path
) -> None:
    def broken(descriptor: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    audit_log = core_audit.Audit(log, None, {})
    audit_log.append("intent")
    with monkeypatch.context() as patch:
        patch.setattr(core_audit, "_SYNC", broken)
        for _ in range(2):
            with pytest.raises(AdapterError, match="Input/output error"):
                audit_log.append("intent")
    anchor = audit_log.append("intent")
    audit_log.close()
    # The file has what was refused; the record that follows says that it was.
    assert audit(log, "--anchor", anchor)[0] == 0
    told = [record["unrecorded"] for record in records(log) if record["event"] == "recovered"]
    assert told[-1] >= 1


def test_a_log_that_was_taken_away_goes_on_and_shows_it(start: Start, log: Path) -> None:
    client = start()
    write(client, 20, 1)
    log.unlink()
    assert write(client, 20, 2).envelope["success"]
    code, said = audit(log)
    assert code == 0
    assert "records 1 to 3 are in earlier files" in said
    # One from whose end something was removed is not gone on with.
    shorter = log.with_suffix(".shorter")
    shorter.write_bytes(log.read_bytes().splitlines(keepends=True)[0])
    shorter.rename(log)
    assert write(client, 20, 3).error["code"] == "audit_unavailable"


def test_a_log_is_rotated_without_a_gap(start: Start, log: Path) -> None:
    client = start("[rule.all]\ntargets = ['*/*/*']", OT_AUDIT_ROTATE_MB="1")
    # Each of these is two records of 4.5 kB.
    block = {"address": 0, "values": [65535] * 123}
    anchors = [client.call("write_registers", block).meta["audit_id"] for _ in range(130)]
    client.close()
    parts = sorted(log.parent.glob("audit.jsonl.0*"))
    assert parts
    assert audit(*parts, log, "--anchor", *anchors)[0] == 0
    assert audit(log)[0] == 0
    assert audit(log, "--anchor", anchors[0])[0] == 1
    numbers = [record["seq"] for part in (*parts, log) for record in records(part)]
    assert numbers == list(range(1, len(numbers) + 1))
    # Killed between the two steps of a rotation: the chain goes on.
    log.rename(f"{log}.{numbers[-1]:09}")
    assert write(start(), 20, 1).envelope["success"]
    assert events(log)[0] == "continued"
    assert audit(*sorted(log.parent.glob("audit.jsonl.0*")), log)[0] == 0


def test_every_kind_of_forgery_is_found(start: Start, log: Path) -> None:
    client = start()
    for value in range(10):
        anchor = write(client, 20, value).meta["audit_id"]
    client.abandon()
    whole = log.read_bytes()
    lines = whole.splitlines(keepends=True)
    rehashed = json.loads(lines[5])
    del rehashed["hash"]
    body = json.dumps(rehashed | {"role": "engineer"}, separators=(",", ":")).encode()[:-1]
    new = body + b',"hash":"' + hashlib.sha256(body).hexdigest().encode() + b'"}\n'
    edits = {
        "alter": whole.replace(b'"role":"operator"', b'"role":"engineer"', 1),
        "alter and hash again": b"".join([*lines[:5], new, *lines[6:]]),
        "delete": b"".join(lines[:5] + lines[6:]),
        "delete the beginning": b"".join(lines[1:]),
        "insert": b"".join([*lines[:5], lines[3], *lines[5:]]),
        "insert an empty line": b"".join([*lines[:5], b"\n", *lines[5:]]),
        "reorder": b"".join([*lines[:5], lines[6], lines[5], *lines[7:]]),
        "cut off": b"".join(lines[:-2]),
        "cut off in a record": whole[:-20],
        "empty": b"",
    }
    assert audit(log, "--anchor", anchor)[0] == 0
    for name, edited in edits.items():
        log.write_bytes(edited)
        assert audit(log, "--anchor", anchor)[0] == 1, name


def test_no_argument_can_look_like_a_record(rigs: Callable[[Case], Rig], tmp_path: Path) -> None:
    (mqtt,) = (case for case in CASES if case.protocol == "mqtt")
    log = tmp_path / "audit.jsonl"
    client = rigs(mqtt).start("forger", writes="true", OT_AUDIT_LOG=str(log))
    forged = 'x\n{"seq":9,"time":"","event":"start","prev":"' + "0" * 64 + '","hash":"' + "0" * 64 + '"}\n\x1b[2J\u202e'
    client.call("publish_message", topic="control/pump", payload=forged)
    assert json.loads(records(log)[1]["arguments"])["payload"] == forged
    assert len(records(log)) == 3
    assert audit(log)[0] == 0


def test_a_cancelled_write_is_recorded(start: Start, device: Mock, log: Path) -> None:
    client, mark = start(), device.mark()
    device.fault({"action": {"drop": True}})
    identifier = client.start("write_register", {"address": 20, "value": 2})
    device.wait(mark, 1, kind="request", state_changing=True)
    client.write({"jsonrpc": "2.0", "method": "notifications/cancelled", "params": {"requestId": identifier}})
    client.request("tools/list", {})
    device.fault()
    client.call("ping")
    outcome = records(log)[-1]
    assert (outcome["event"], outcome["code"], outcome["outcome"]) == ("outcome", "cancelled", "unknown")


def test_without_settings_there_are_no_gates(rig: Rig, device: Mock) -> None:
    reply = write(rig.adapter, 70, 1)
    assert reply.envelope["success"]
    assert "audit_id" not in reply.meta
    assert "policy" not in reply.meta


# -- approval ----------------------------------------------------------------------------------------------------

ACCEPT = {"action": "accept", "content": {"approve": True}}
NO = [
    {"action": "decline"},
    {"action": "cancel"},
    {"action": "accept"},
    {"action": "accept", "content": {}},
    {"action": "accept", "content": {"approve": False}},
    {"action": "accept", "content": {"approve": "yes"}},
    {"action": "accept", "content": {"approve": 1}},
]


def asked(client: Client, tool: str = "write_register", **arguments: Any) -> dict[str, Any]:
    result: dict[str, Any] = client.request("tools/call", {"name": tool, "arguments": arguments})["result"]
    assert result["resultType"] == "input_required", result
    return result


def again(client: Client, result: Any, answer: Any, tool: str = "write_register", **arguments: Any) -> int:
    more = {"requestState": result["requestState"], "inputResponses": {"approval": answer}}
    return client.send("tools/call", {"name": tool, "arguments": arguments, **more})


def approved(client: Client, result: Any, answer: Any, **arguments: Any) -> Reply:
    return client.reply("write_register", again(client, result, answer, **arguments))


def test_an_approved_write_is_done_once(start: Start, device: Mock, log: Path) -> None:
    client, mark = start(capabilities=FORMS), device.mark()
    device("poke", params={"table": "holding_registers", "address": 50, "values": [123]})
    result = asked(client, address=50, value=9)
    question = result["inputRequests"]["approval"]["params"]["message"]
    for shown in (
        client_endpoint(client),
        '"1/holding_registers/50"',
        "now 123",
        "to be 9",
        "Limit of the boiler",
        "800",
    ):
        assert shown in question
    assert writes(device, mark) == []
    reply = approved(client, result, ACCEPT, address=50, value=9)
    assert reply.envelope["success"]
    assert reply.meta["policy"] == {"decision": "approval", "rule": "asked", "principal": "local:alice"}
    assert len(writes(device, mark)) == 1
    assert approved(client, result, ACCEPT, address=50, value=9).error["code"] == "approval_denied"
    assert len(writes(device, mark)) == 1
    assert events(log) == ["start", "asked", "intent", "outcome", "refused"]
    assert records(log)[2]["approved_by"] == "client"
    assert len({record["approval"] for record in records(log)[1:]}) == 1


def client_endpoint(client: Client) -> str:
    endpoint: str = client.call("ping").meta["endpoint"]
    return endpoint


@pytest.mark.parametrize("answer", [*NO, {}, None, "accept", ["accept"]])
def test_anything_but_an_approval_is_a_refusal(start: Start, device: Mock, log: Path, answer: Any) -> None:
    client, mark = start(capabilities=FORMS), device.mark()
    result = asked(client, address=50, value=9)
    assert approved(client, result, answer, address=50, value=9).error["code"] == "approval_denied"
    assert events(log) == ["start", "asked", "refused"]
    # An answer counts once, whatever it was.
    assert approved(client, result, ACCEPT, address=50, value=9).error["code"] == "approval_denied"
    assert writes(device, mark) == []
    assert events(log)[-1] == "refused"


def test_an_approval_is_for_what_was_asked(start: Start, device: Mock) -> None:
    client, mark = start(capabilities=FORMS), device.mark()
    for changed in (
        {"address": 50, "value": 10},
        {"address": 51, "value": 9},
        {"address": 50, "value": 9, "unit_id": 1},
    ):
        result = asked(client, address=50, value=9)
        assert approved(client, result, ACCEPT, **changed).error["code"] == "approval_denied"
        assert approved(client, result, ACCEPT, address=50, value=9).error["code"] == "approval_denied"
    result = asked(client, address=50, value=9)
    flipped = {"requestState": result["requestState"][:-1] + ("A" if result["requestState"][-1] != "A" else "B")}
    assert approved(client, flipped, ACCEPT, address=50, value=9).error["code"] == "approval_denied"
    assert writes(device, mark) == []
    # Two at once: one of them has it.
    both = [again(client, result, ACCEPT, address=50, value=9) for _ in range(2)]
    outcomes = sorted(client.reply("write_register", one).envelope["success"] for one in both)
    assert outcomes == [False, True]
    assert len(writes(device, mark)) == 1


def test_an_approval_ends_after_its_time(start: Start, device: Mock) -> None:
    client, mark = start(capabilities=FORMS, OT_APPROVAL_S="0.05"), device.mark()
    result = asked(client, address=50, value=9)
    threading.Event().wait(0.06)
    code = approved(client, result, ACCEPT, address=50, value=9).error["code"]
    assert code in ("approval_expired", "approval_denied")
    assert writes(device, mark) == []


def test_the_policy_is_asked_again_after_an_approval(start: Start, device: Mock) -> None:
    policy = '[rule.both]\ntargets = ["1/holding_registers/50"]\nstep = 10\napprove = "client"'
    client, mark = start(policy, capabilities=FORMS), device.mark()
    device("poke", params={"table": "holding_registers", "address": 50, "values": [100]})
    result = asked(client, address=50, value=105)
    device("poke", params={"table": "holding_registers", "address": 50, "values": [200]})
    assert approved(client, result, ACCEPT, address=50, value=105).error["code"] == "range_overflow"
    assert writes(device, mark) == []


@pytest.mark.parametrize("era", [LEGACY, MODERN])
def test_a_client_that_cannot_ask_gets_no_further(rig: Rig, tmp_path: Path, device: Mock, era: str) -> None:
    file = tmp_path / "policy.toml"
    file.write_text('[rule.asked]\ntargets = ["1/holding_registers/50"]\napprove = "client"')
    for capabilities in ({}, {"elicitation": {"url": {}}}):
        settings = {"OT_POLICY": str(file), "OT_ROLE": "operator"}
        client = rig.start("dumb", writes="true", era=era, capabilities=capabilities, **settings)
        mark = device.mark()
        assert write(client, 50, 9).error["code"] == "approval_required"
        assert writes(device, mark) == []


@pytest.mark.parametrize("capabilities", [FORMS, {"elicitation": {}}])
def test_until_2025_11_25_the_client_is_asked_during_the_call(
    start: Start, device: Mock, capabilities: dict[str, Any]
) -> None:
    client, mark = start(era=LEGACY, capabilities=capabilities), device.mark()
    for answer, code in [(ACCEPT, None), *((answer, "approval_denied") for answer in NO)]:
        call = client.start("write_register", {"address": 50, "value": 9})
        question = client.question()
        assert question["method"] == "elicitation/create"
        assert client.call("read_register", address=50).envelope["success"]
        client.write({"jsonrpc": "2.0", "id": question["id"], "result": answer})
        reply = client.reply("write_register", call)
        assert (reply.envelope["error"] or {}).get("code") == code, answer
    call = client.start("write_register", {"address": 50, "value": 9})
    error = {"code": -1, "message": "User rejected"}
    client.write({"jsonrpc": "2.0", "id": client.question()["id"], "error": error})
    assert client.reply("write_register", call).error["code"] == "approval_denied"
    assert len(writes(device, mark)) == 1


def test_silence_is_no_approval(start: Start, device: Mock) -> None:
    client, mark = start(era=LEGACY, capabilities=FORMS, OT_APPROVAL_S="0.05"), device.mark()
    assert write(client, 50, 9).error["code"] == "approval_expired"
    client.write({"jsonrpc": "2.0", "id": client.question()["id"], "result": ACCEPT})
    client.call("ping")
    assert writes(device, mark) == []


def inbox(*arguments: object) -> tuple[int, str]:
    return printed(approver, *arguments)


@pytest.mark.parametrize(("address", "capabilities"), [(50, {}), (60, FORMS)])
def test_a_person_approves_outside_of_mcp(
    start: Start, device: Mock, log: Path, tmp_path: Path, address: int, capabilities: dict[str, Any]
) -> None:
    folder = tmp_path / "inbox"
    client, mark = start(capabilities=capabilities), device.mark()
    error = write(client, address, 9).error
    number = error["details"]["approval_id"]
    assert error["code"] == "approval_required"
    # The assistant may ask again and again: it is the same request.
    assert write(client, address, 9).error["details"]["approval_id"] == number
    code, said = inbox("list", folder)
    assert code == 0
    assert f"1/holding_registers/{address}" in said
    # Another value is another request, and what was approved for one is not for the other.
    other = write(client, address, 10).error["details"]["approval_id"]
    assert other != number
    assert inbox("approve", folder, number)[0] == 0
    assert inbox("deny", folder, number)[0] == 1
    assert write(client, address, 10).error["code"] == "approval_required"
    assert writes(device, mark) == []
    assert write(client, address, 9).envelope["success"]
    assert len(writes(device, mark)) == 1
    assert records(log)[-2]["approved_by"].startswith("inbox:")
    assert write(client, address, 9).error["code"] == "approval_required"
    assert inbox("deny", folder, other)[0] == 0
    assert write(client, address, 10).error["code"] == "approval_denied"
    assert len(writes(device, mark)) == 1


def test_what_is_approved_is_what_was_shown(start: Start, device: Mock, tmp_path: Path) -> None:
    client, mark = start(), device.mark()
    number = write(client, 60, 9).error["details"]["approval_id"]
    file = tmp_path / "inbox" / f"{number}.request"
    file.write_text(file.read_text().replace("to be 9", "to be 1"))
    assert inbox("approve", tmp_path / "inbox", number)[0] == 0
    assert write(client, 60, 9).error["code"] == "approval_denied"
    assert writes(device, mark) == []


def test_an_approval_of_another_process_is_none(start: Start, device: Mock, tmp_path: Path) -> None:
    first = start()
    number = write(first, 60, 9).error["details"]["approval_id"]
    assert inbox("approve", tmp_path / "inbox", number)[0] == 0
    first.abandon()
    mark = device.mark()
    assert write(start(), 60, 9).error["code"] == "approval_required"
    assert writes(device, mark) == []


def test_a_tool_that_writes_twice_is_decided_and_approved_as_a_whole(
    sessions: Callable[..., Client], rig: Rig, device: Mock, log: Path, tmp_path: Path
) -> None:
    command = [sys.executable, "-m", "pytest_otmcp.reference_adapters.named", "modbus"]
    file = tmp_path / "policy.toml"
    settings = rig.settings("batch", writes="true", OT_POLICY=str(file), OT_AUDIT_LOG=str(log), OT_ROLE="operator")
    mark = device.mark()
    file.write_text('[rule.size]\ntargets = ["1/holding_registers/41"]')
    client = sessions(command, settings)
    assert client.call("start_batch", litres=7).error["code"] == "access_denied"
    assert writes(device, mark) == []
    client.abandon()
    file.write_text('[rule.batch]\ntargets = ["1/holding_registers/41", "1/coils/12"]\napprove = "client"')
    client = sessions(command, settings, capabilities=FORMS)
    result = asked(client, "start_batch", litres=7)
    question = result["inputRequests"]["approval"]["params"]["message"]
    assert "holding_registers/41" in question
    assert "coils/12" in question
    reply = client.reply("start_batch", again(client, result, ACCEPT, "start_batch", litres=7))
    assert reply.envelope["success"]
    assert len(writes(device, mark)) == 2
    intent = records(log)[-2]
    assert intent["changes"] == [["1/holding_registers/41", 7], ["1/coils/12", True]]


def test_more_than_a_person_can_see_is_not_asked(start: Start) -> None:
    policy = '[rule.block]\ntargets = ["1/holding_registers/*"]\napprove = "client"'
    client = start(policy, capabilities=FORMS)
    assert client.call("write_registers", address=0, values=[1] * 21).error["code"] == "limit_exceeded"
    asked(client, "write_registers", address=0, values=[1] * 20)
