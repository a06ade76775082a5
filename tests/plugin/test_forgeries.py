"""Forgeries of a genuine record: each is sealed again, with counts and digest that fit, and each is refused for its reason.

``otmcp certify`` asks for everything that is asked here, and for more; its own forgeries are in ``test_certification``. What a
self-certification without a signature cannot refuse is pinned here as well, and listed in ``docs/certificate.md``.
"""

from __future__ import annotations

import copy
import json
from datetime import datetime, timedelta
from pathlib import Path

import pytest

from pytest_otmcp.cli import Refusal
from pytest_otmcp.cli.examination import examine
from pytest_otmcp.record import load
from pytest_otmcp.soundness.warm_start import WarmStart
from tests.stored_runs import store

from .places import Change, Record, call, calls, entry, facts, item, journal, look, moved, parts, sample
from .reference_run import reference_run

FAMILIES = ("Modbus", "MQTT", "OPC UA")
HOUR_NS = 3600 * 10**9
DAY_NS = 24 * HOUR_NS


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory, warm_start: WarmStart) -> Path:
    return reference_run(tmp_path_factory, warm_start)


@pytest.fixture(scope="module")
def genuine(path: Path) -> Record:
    """The record of that run with its first twelve items, as if it had been ended then: the forgeries need no more."""
    run: Record = load(path)
    return {
        **run,
        "items": [item for item in run["items"] if item["suite"] == "normal" and item["family"] in FAMILIES],
        "footer": {**run["footer"], "complete": False, "reason": "interrupted by the user", "verdict": "INCOMPLETE"},
    }


def examined(path: Path, run: Record) -> list[str]:
    return examine(store(path / "run.json", run, recount=True)).said


def test_the_genuine_record_is_verified(genuine: Record, tmp_path: Path) -> None:
    said = examined(tmp_path, genuine)
    assert said[0].startswith("verified: ")
    assert said[0].endswith("24 of 24 repetitions passed, and judging them again found the same")


def test_the_subject_file_of_the_run_is_that_of_the_record(path: Path) -> None:
    said = examine(path, subject=path.parents[2] / "otmcp.toml").said
    assert said[-1].startswith("the subject, its claims, deadlines and bindings are those of ")


def test_what_a_device_saw_of_an_item_that_the_kit_broke_off_is_unknown(genuine: Record, tmp_path: Path) -> None:
    run = copy.deepcopy(genuine)
    ended = {"fault_of": "kit", "code": "kit_error", "message": "the mock said nothing for 60 s"}
    told = {"requirement": None, "evidence": None, "strength": "MUST", "cause": None}
    finding = {
        **told,
        "code": "kit_error",
        "message": f"{ended['message']}. This is the kit's fault; please file a bug.",
    }
    nothing: Record = {"devices": {}, "around": [], "samples": [], "sessions": []}
    item(run, "M2").update({**nothing, "status": "KIT_ERROR", "ended": ended, "findings": [finding]})
    run["footer"]["verdict"] = "INDETERMINATE"
    assert examined(tmp_path, run)[0].startswith("verified: ")


def test_another_subject_file_is_refused(genuine: Record, path: Path, tmp_path: Path) -> None:
    changed = tmp_path / "otmcp.toml"
    changed.write_bytes((path.parents[2] / "otmcp.toml").read_bytes() + b"\n")
    with pytest.raises(Refusal, match=r"is not about \S+otmcp\.toml: the digest of the subject is sha256:"):
        examine(store(tmp_path / "run.json", genuine, recount=True), subject=changed)


# -- changes ---------------------------------------------------------------------------------------------------------------


def message(run: Record) -> Record:
    """Return a Sparkplug data message that the adapter has published."""
    entries = (one for part in item(run, "Q4")["samples"] for one in part["device"])
    return next(one for one in entries if "/DDATA/" in one.get("topic", "") and one["direction"] == "in")


def swap(one: Record, other: Record, name: str) -> None:
    one[name], other[name] = other[name], one[name]


def read_another_value(run: Record) -> None:
    """Change the value of a read everywhere but at the device."""
    read = call(run, "M3", 1)
    value = read["envelope"]["data"]["values"][0] ^ 1
    read["envelope"]["data"]["values"] = read["outputs"]["values"] = [value]


def write_another_value(run: Record) -> None:
    """Change what the device was told to write, with the bytes that belong to it."""
    write = entry(run, "M3", function=6, direction="in")
    write["values"] = [write["values"][0] ^ 1]
    write["pdu"] = f"06{write['address']:04x}{write['values'][0]:04x}"


def lose_an_entry(run: Record) -> None:
    """Drop a request and renumber what follows in that repetition."""
    entries = journal(run, "M1")
    del entries[0]
    for one in entries:
        one["seq"] -= 1


def other_message(run: Record) -> None:
    """Put the payload of a birth certificate into a data message."""
    birth = next(one for part in parts(run) for one in part["device"] if "/DBIRTH/" in one.get("topic", ""))
    message(run)["payload"] = birth["payload"]


def elsewhere(run: Record) -> None:
    for one in calls(run):
        if one["adapter"] == "modbus":
            one["envelope"]["meta"]["endpoint"] = "modbus+tcp://10.0.0.1:502"


def at_another_port(run: Record) -> None:
    """Move a device to another port, wherever the record says where it was."""
    device = run["devices"]["modbus"]
    old, device["endpoints"][0]["port"] = device["endpoints"][0]["port"], 502
    device["placeholders"] |= {"port": "502", "url": "modbus+tcp://127.0.0.1:502"}
    for one in calls(run):
        meta = one["envelope"]["meta"]
        meta["endpoint"] = meta["endpoint"].replace(f":{old}", ":502")


def unclaim(run: Record) -> None:
    facts(run)["unclaimed"]["ping"] = "it has none"


def lose_a_repetition(run: Record) -> None:
    del item(run, "M2")["samples"][1]


def repeat_a_repetition(run: Record) -> None:
    samples = item(run, "M2")["samples"]
    samples[1] = {**copy.deepcopy(samples[0]), "repetition": 1}


def swap_repetitions(run: Record) -> None:
    samples = item(run, "M2")["samples"]
    samples.reverse()
    swap(samples[0], samples[1], "repetition")


def swap_slices(run: Record) -> None:
    first, second = item(run, "M2")["samples"]
    swap(first, second, "device")


def lose_what_came_between(run: Record) -> None:
    for one in run["items"]:
        for found in one["devices"].values():
            found["before"] = []


def add_a_stranger(run: Record) -> None:
    stranger = {"at": "modbus", "origin": "stranger", "program": "nmap", "connections": 1, "messages": 1, "sent": ["x"]}
    item(run, "M2")["strangers"] = [stranger]


def add_noise(run: Record) -> None:
    remark = {"inspection": 1, "protocol": "modbus", "overflow": False, "died": None, "overstayed": None}
    item(run, "M2")["sessions"].append({**remark, "unknown_ids": [], "stray_lines": 1, "first_stray": "hello"})


def invent_a_finding(run: Record) -> None:
    told = {"code": "no_text", "message": "no text", "requirement": "MCP-006", "evidence": None, "cause": None}
    sample(run, "M2")["findings"].append({**told, "strength": "SHOULD"})


def end_early(run: Record) -> None:
    item(run, "M2")["ended"] = {"fault_of": "subject", "code": "cannot_start", "message": "no such command"}


def other_hour(run: Record) -> None:
    """Give an item a time of day of an hour before, which the run is said to include."""
    late = item(run, "M2")
    for name in ("started_at", "finished_at"):
        late[name] = (datetime.fromisoformat(late[name]) - timedelta(hours=1)).isoformat()
    run["environment"]["started_at"] = "2001-01-01T00:00:00Z"


def overlapped(run: Record) -> None:
    """Let an item begin a millisecond before the one before it has ended, by both clocks."""
    late = item(run, "M2")
    by_ns = late["began_ns"] - item(run, "M1")["ended_ns"] + 10**6
    late["began_ns"] -= by_ns
    earlier = datetime.fromisoformat(late["started_at"]) - timedelta(microseconds=by_ns // 1000)
    late["started_at"] = earlier.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def subscribed(run: Record) -> Record:
    """Return the SUBACK of the adapter's first subscription."""
    return entry(run, "Q2", kind="SUBACK", origin="client")


def ended(run: Record) -> Record:
    """Return the UNSUBSCRIBE of the adapter's first subscription."""
    return entry(run, "Q2", kind="UNSUBSCRIBE", origin="client")


def published(run: Record) -> Record:
    """Return a PUBLISH of the adapter's."""
    return entry(run, "Q3", kind="PUBLISH", direction="in", origin="client")


def service(run: Record, identifier: str, kind: str, direction: str = "in") -> Record:
    """Return a service request of an item, or an answer."""
    return entry(run, identifier, kind=kind, direction=direction)


def a_write_that_is_a_read(run: Record) -> None:
    """Call a Write a Read, and leave out what only a Write has."""
    write = service(run, "O3", "Write")
    write |= {"kind": "Read", "state_changing": False}
    write["nodes"] = [{"node_id": node["node_id"], "attribute": "Value"} for node in write["nodes"]]


def a_connection_that_begins_twice(run: Record) -> None:
    """Call a packet the begin of its connection."""
    unsubscribe = ended(run)
    unsubscribe |= {"kind": "CONNECTED", "request": False}
    for name in ("filters", "packet_id"):
        unsubscribe.pop(name)


def a_session_that_begins_later(run: Record) -> None:
    """Let a new session begin a million entries later, so that nothing that it did would be of a session."""
    looks = (seen for part in parts(run) for seen in part["observations"])
    fresh = next(seen for seen in looks if seen["at"] == "modbus" and "fresh_session" in seen)
    fresh["fresh_session"]["opened"] += 10**6


def a_guard_that_leaks(run: Record) -> None:
    """Let the adapter with writes disabled have sent a write."""
    request = entry(run, "M4", variant="ro", kind="request")
    request |= {"function": 6, "values": [1], "quantity": 1, "state_changing": True}
    request["pdu"] = f"06{request['address']:04x}0001"


# -- forgeries ------------------------------------------------------------------------------------------------------------


def on_another_day(run: Record) -> None:
    """Move the whole run by two days: every time of day, those of the envelopes, and the monotonic clock."""
    for place in (run["environment"], *run["items"]):
        for name in ("started_at", "finished_at"):
            place[name] = later(place[name])
    for one in calls(run):
        meta = one["envelope"]["meta"]
        meta["started_at"] = later(meta["started_at"])
    for one in run["items"]:
        moved(one, ns=2 * DAY_NS)


def later(moment: str) -> str:
    return (datetime.fromisoformat(moment) + timedelta(days=2)).isoformat().replace("+00:00", "Z")


FORGERIES: dict[str, tuple[str, Change]] = {
    # shape
    "a number that is true": (
        "settings.time_scale: expected `float`, got `bool`",
        lambda run: run["settings"].update(time_scale=True),
    ),
    "a count below zero": ("item 1.planned: expected `int` >= 0", lambda run: item(run, "M1").update(planned=-1)),
    "a time that no clock shows": (
        "the record.environment.started_at: is no time as RFC 3339 has it",
        lambda run: run["environment"].update(started_at="yesterday \x1b[31m"),
    ),
    "a day that no calendar has": (
        "M1 has the time '2026-02-30T07:03:43.000Z', which no clock shows",
        lambda run: item(run, "M1").update(started_at="2026-02-30T07:03:43.000Z"),
    ),
    "a name that moves the cursor": (
        "the record.subject.name: has a control character",
        lambda run: run["subject"].update(name="acme\x1b[2J verified: by TUV\n"),
    ),
    "a server's name of two lines": (
        "server_name: has a control character",
        lambda run: facts(run).update(server_name="acme\nverified"),
    ),
    "a deadline of days": ("deadline_s: expected `float` <= 300.0", lambda run: facts(run).update(deadline_s=1e6)),
    "a recovery of days": ("recovery_s: expected `float` <= 300.0", lambda run: facts(run).update(recovery_s=1e6)),
    "a time scale of nothing": (
        "the record.settings.time_scale: expected `float` > 0.0",
        lambda run: run["settings"].update(time_scale=0),
    ),
    "a million restarts and one more": (
        "starts: expected `int` <= 1000000",
        lambda run: item(run, "M2")["devices"]["modbus"].update(starts=10**18),
    ),
    "a role that nobody has": (
        "a sample of M1.calls[0].role: invalid enum value 'demo'",
        lambda run: call(run, "M1").update(role="demo"),
    ),
    "a status that nobody has": (
        "item 1.status: invalid enum value 'PASSED'",
        lambda run: item(run, "M1").update(status="PASSED"),
    ),
    "a member that is missing": (
        "item 1: object missing required field `worker`",
        lambda run: item(run, "M1").pop("worker"),
    ),
    # counts and identity
    "an item twice": ("an item occurs twice: M1", lambda run: run["items"].append(copy.deepcopy(item(run, "M1")))),
    "an item of another run": (
        "M1 is of another run: its run_id is 0000",
        lambda run: item(run, "M1").update(run_id="0" * 32),
    ),
    "an item of another suite": (
        "M1 has the unknown suite 'demonstration'",
        lambda run: item(run, "M1").update(suite="demonstration"),
    ),
    "an item of a suite that was not asked for": (
        "M1 is of the suite normal, which the settings do not ask for",
        lambda run: run["settings"].update(suites=["fault", "stress", "recovery"]),
    ),
    "a suite that the settings alone know": (
        "the settings ask for the unknown suite 'gold'",
        lambda run: run["settings"]["suites"].append("gold"),
    ),
    "a variant that no device has": (
        "devices[...].variant: invalid enum value 'admin'",
        lambda run: run["devices"]["modbus"].update(variant="admin"),
    ),
    "an item that ended before it began": ("M1 ended before it began", lambda run: item(run, "M1").update(ended_ns=0)),
    "a device that the run has not": (
        "M1 has the device 'modbus@lab' as modbus, the run has no such device",
        lambda run: item(run, "M1")["devices"]["modbus"].update(device="modbus@lab"),
    ),
    "a verdict that is better": (
        "from its items follows INCOMPLETE, the footer says CONFORMANT",
        lambda run: run["footer"].update(verdict="CONFORMANT"),
    ),
    "a verdict that is worse": (
        "from its items follows INCOMPLETE, the footer says NOT CONFORMANT",
        lambda run: run["footer"].update(verdict="NOT CONFORMANT"),
    ),
    "a repetition that is lost": (
        "M2 is called PASS, but not everything of it passed",
        lose_a_repetition,
    ),
    "a repetition instead of another": (
        "M2 repetition 2: the call of read_input_registers is not of its time",
        repeat_a_repetition,
    ),
    "repetitions in another order": (
        "M2 repetition 1: the journal of modbus should have the entries",
        swap_repetitions,
    ),
    "less repetitions everywhere": (
        "M1: 1 repetitions were planned, the settings demand 2",
        lambda run: [one.update(planned=1, samples=one["samples"][:1]) for one in run["items"]],
    ),
    "an item that is lost": (
        "M3: the journal of modbus should have the entries",
        lambda run: run["items"].remove(item(run, "M2")),
    ),
    "an item that nobody knows": ("M99: the suite has no such task", lambda run: item(run, "M1").update(id="M99")),
    "another kit": (
        "was judged by another kit: pytest-otmcp 9.9.9, and this is",
        lambda run: run["kit"].update(version="9.9.9"),
    ),
    "another suite": (
        "with other files than this one (of another commit, or one of the two has been changed)",
        lambda run: run["kit"].update(suite_digest="sha256:" + "0" * 64),
    ),
    "a changed kit": (
        "with other files than this one (of another commit, or one of the two has been changed)",
        lambda run: run["kit"].update(digest="sha256:" + "0" * 64),
    ),
    "a kit of another name": (
        "with other files than this one (of another commit, or one of the two has been changed)",
        lambda run: run["kit"].update(name="kit approved by TUV"),
    ),
    "a protocol that somebody else is said to have judged": (
        "does not say rightly who judged the protocol 'modbus'",
        lambda run: run["kit"]["protocols"][0].update(distribution="tuv", version="1"),
    ),
    "protocols that nobody is said to have judged": (
        "does not say rightly who judged the protocol 'modbus'",
        lambda run: run["kit"].update(protocols=[]),
    ),
    "an item of another worker": (
        "M2 was performed by gw1, its device modbus is main's",
        lambda run: item(run, "M2").update(worker="gw1"),
    ),
    # time of day
    "an item of yesterday": (
        "M1: started_at 2020-11-21T07:03:43.000Z is not within the run, which lasted from",
        lambda run: item(run, "M1").update(started_at="2020-11-21T07:03:43.000Z"),
    ),
    "an item of another hour": (
        "does not go with its monotonic time: it is of another run, or the clock of the machine was set",
        other_hour,
    ),
    "a run without an end": (
        "the record does not say when the run ended",
        lambda run: run["environment"].update(finished_at=None),
    ),
    # subject and settings
    "another seed": (
        "M2 repetition 1: the stored history shows ok false, the record says true",
        lambda run: run["settings"].update(seed=8),
    ),
    "more repetitions demanded": (
        "contradicts itself: of N = 2 follow the repetitions {'normal': 2, ",
        lambda run: run["settings"]["repetitions"].update(normal=30),
    ),
    "more repetitions said": (
        "contradicts itself: of N = 30 follow the repetitions {'normal': 30, ",
        lambda run: run["settings"].update(reps=30),
    ),
    "no repetitions demanded": (
        "contradicts itself: of N = 2 follow the repetitions {'normal': 2, ",
        lambda run: run["settings"].update(repetitions={}),
    ),
    "repetitions of a suite that there is not": (
        "contradicts itself: of N = 2 follow the repetitions {'normal': 2, ",
        lambda run: run["settings"]["repetitions"].update(gold=1),
    ),
    "a claim withdrawn afterwards": (
        "M1: the record says PASS, the subject does not claim modbus.ping",
        unclaim,
    ),
    "an item that is said not to apply": (
        "M1: the record says NOT_APPLICABLE, the subject claims modbus.ping",
        lambda run: item(run, "M1").update(status="NOT_APPLICABLE"),
    ),
    "a binding of another tool": (
        "M1 repetition 1: ping is performed by pong with {}, the history has ping with {}",
        lambda run: facts(run)["bindings"]["ping"][0].update(tool="pong"),
    ),
    "a binding without outputs": (
        "M1 repetition 1, call 1 (ping): the stored history shows outputs {}, the record says",
        lambda run: facts(run)["bindings"]["ping"][0]["outputs"].clear(),
    ),
    "an absurd path in a binding": (
        'call 1 (ping): the stored history shows outputs {"reachable": null}, the record says',
        lambda run: facts(run)["bindings"]["ping"][0]["outputs"]["reachable"].update(path="[[["),
    ),
    "an operation without binding": (
        "M1 repetition 1, call 1 (ping): the stored history shows envelope",
        lambda run: facts(run)["bindings"].pop("ping"),
    ),
    "a shorter deadline": ("deadline 1e-06 s' (deadline_missed)", lambda run: facts(run).update(deadline_s=1e-6)),
    # devices
    "a device on another machine": (
        "modbus: a device of the kit listens on this machine only, the record says '10.0.0.1'",
        lambda run: run["devices"]["modbus"]["endpoints"][0].update(host="10.0.0.1"),
    ),
    "an address that is not the device's": (
        'modbus: from its endpoints follows {"host": "127.0.0.1",',
        lambda run: run["devices"]["modbus"]["placeholders"].update(port="502"),
    ),
    "envelopes of another machine": (
        "ping(): meta.endpoint should be that of the device, 127.0.0.1:",
        elsewhere,
    ),
    "a device at another port": ("M3 warmup: the steps ask for modbus read_", at_another_port),
    "a journal that begins later": (
        "M1: the journal of modbus was taken up to entry 5, the record goes back to 0",
        lambda run: run["devices"]["modbus"].update(first=5),
    ),
    # chain
    "what came between items is lost": (
        "Q1: the journal of mqtt should have the entries 0 to",
        lose_what_came_between,
    ),
    "sequence numbers of an item": (
        "M2: the journal of modbus should have the entries 9 to",
        lambda run: moved(item(run, "M2"), seq=1000),
    ),
    "times of an item": ("M2: started_at", lambda run: moved(item(run, "M2"), ns=DAY_NS)),
    "times of a repetition": ("of modbus is not of its time", lambda run: moved(sample(run, "M2", 1), ns=HOUR_NS)),
    "times of a repetition, earlier": (
        "M2 repetition 2: the call of read_input_registers is not of its time",
        lambda run: moved(sample(run, "M2", 1), ns=-(10**8)),
    ),
    "an item that overlaps another": (
        "M2: it began before the item before it had ended",
        overlapped,
    ),
    "an item that goes on after its end": (
        "M2: it went on until",
        lambda run: item(run, "M2").update(ended_ns=call(run, "M2")["received_ns"] - 1),
    ),
    "entries without a time": (
        "M1 repetition 1: entry 3 of the journal of modbus is not of its time: 0 ns is not between",
        lambda run: [one.update(t_ns=0) for one in journal(run, "M1")],
    ),
    "entries of an hour later": (
        "M1 repetition 1: entry 3 of the journal of modbus is not of its time",
        lambda run: [one.update(t_ns=one["t_ns"] + HOUR_NS) for one in journal(run, "M1")],
    ),
    "another order on the wire": (
        "M1 repetition 1: entry 4 of the journal of modbus is not of its time",
        lambda run: swap(*journal(run, "M1")[:2], "t_ns"),
    ),
    "an entry that is lost": (
        "M1 repetition 1: the journal of modbus should have the entries 3 to 4, it has [3]",
        lose_an_entry,
    ),
    "the last entry that is lost": (
        "M1 repetition 1: the journal of modbus should have the entries 3 to 4, it has [3]",
        lambda run: journal(run, "M1").pop(),
    ),
    "an entry twice": (
        "M1 repetition 1: the journal of modbus has 1 entries beyond its end",
        lambda run: journal(run, "M1").append(copy.deepcopy(journal(run, "M1")[-1])),
    ),
    "slices of other repetitions": (
        "M2 repetition 1: the journal of modbus should have the entries",
        swap_slices,
    ),
    "an adapter that was left alone": (
        "M2: modbus was left alone since the last item that had it",
        lambda run: item(run, "M2")["devices"]["modbus"].update(quiet=False),
    ),
    "a restart between items": (
        "M2: modbus was started again 1 time(s) before, the items before show 0",
        lambda run: item(run, "M2")["devices"]["modbus"].update(starts=1),
    ),
    "a proof that nothing shows": (
        "M1: the items before do not show of the session at modbus that its proof is {'proven': 'ping'",
        lambda run: item(run, "M1")["devices"]["modbus"].update(
            proof={"proven": "ping", "preferred": "ping", "refused": None}
        ),
    ),
    "a proof of another operation": (
        "M4: the items before do not show of the session at modbus that its proof is {'proven': 'ping'",
        lambda run: item(run, "M4")["devices"]["modbus"].update(
            proof={"proven": "ping", "preferred": "ping", "refused": None}
        ),
    ),
    "a session that is said to begin after what it did": (
        "the session at modbus began before",
        a_session_that_begins_later,
    ),
    "a session that is said to begin later, in the item's head": (
        "the session at modbus began before",
        lambda run: item(run, "M3")["devices"]["modbus"].update(session=[99, 10**6]),
    ),
    "a connection that asks for something": (
        "is a 'CONNECTED', which asks nothing, and is called a request",
        lambda run: entry(run, "M1", kind="CONNECTED").update(request=True),
    ),
    "a connection that never begins": (
        "of the journal of modbus is of the connection 1, which did not begin",
        lambda run: entry(run, "M1", kind="CONNECTED").update(connection=99),
    ),
    "the begin of a connection that is called something else": (
        "of the journal of modbus is of the kind 'begin', which nothing is that a client sends",
        lambda run: entry(run, "M1", kind="CONNECTED").update(kind="begin"),
    ),
    "a connection that begins twice": (
        "of the journal of mqtt begins the connection",
        a_connection_that_begins_twice,
    ),
    "an answer to what came later": (
        "M1 repetition 1: entry 4 of the journal of modbus answers the entry 5",
        lambda run: journal(run, "M1")[1].update(answers=journal(run, "M1")[1]["seq"] + 1),
    ),
    # bytes
    "a PDU of something else": (
        "M1 repetition 1: entry 3 of the journal of modbus says function 3, its PDU says 0",
        lambda run: journal(run, "M1")[0].update(pdu="00"),
    ),
    "no PDU": (
        "M1 repetition 1: entry 3 of the journal of modbus has no PDU but None",
        lambda run: journal(run, "M1")[0].pop("pdu"),
    ),
    "a PDU that is no text": (
        "M1 repetition 1: entry 3 of the journal of modbus has no PDU but [4, 0]",
        lambda run: journal(run, "M1")[0].update(pdu=[4, 0]),
    ),
    "another address than in the PDU": (
        "of the journal of modbus says address 7, its PDU says 0",
        lambda run: entry(run, "M2", kind="request").update(address=7),
    ),
    "another function than in the PDU": (
        "of the journal of modbus says function 3, its PDU says 4",
        lambda run: entry(run, "M2", kind="request").update(function=3),
    ),
    "other values than in the PDU": (
        "of the journal of modbus says values [1, 2, 3, 4], its PDU says [",
        lambda run: entry(run, "M2", kind="response").update(values=[1, 2, 3, 4]),
    ),
    "an exception that the PDU has not": (
        "of the journal of modbus says exception 2, its PDU says None",
        lambda run: entry(run, "M2", kind="response").update(exception=2),
    ),
    "a read that is called a write": (
        "of the journal of modbus says state_changing True, its PDU says False",
        lambda run: entry(run, "M2", kind="request").update(state_changing=True),
    ),
    "a payload that is no base64": (
        "of the journal of mqtt has the payload '%%%', which is no base64",
        lambda run: message(run).update(payload="%%%"),
    ),
    "the payload of another message": ("of the journal of mqtt says seq", other_message),
    "a metric that the payload has not": (
        "of the journal of mqtt says name 'pressure', its payload says 'temperature' of the metric",
        lambda run: message(run)["sparkplug"]["metrics"][0].update(name="pressure"),
    ),
    "a sequence number that the payload has not": (
        "of the journal of mqtt says seq 300, its payload says",
        lambda run: message(run)["sparkplug"].update(seq=300),
    ),
    "another value written, bytes and all": (
        "warmup: the device should have seen one write of [40] to holding_registers 1, it saw a write of [41]",
        write_another_value,
    ),
    "a guard that leaks": (
        "M4 control: the steps ask for end of modbus, the history has garbled of modbus@ro",
        a_guard_that_leaks,
    ),
    "a write that is called something else": (
        "says kind 'note', its PDU says 'request'",
        lambda run: entry(run, "M3", function=6, direction="in").update(kind="note"),
    ),
    "a write that is called no request": (
        "may change the plant, and is called no request",
        lambda run: entry(run, "M3", function=6, direction="in").update(request=False),
    ),
    "a request that is called none": (
        "says request False, its PDU says True",
        lambda run: entry(run, "M2", kind="request").update(request=False),
    ),
    "an answer that is called a request": (
        "was sent by the device, and is called a request",
        lambda run: entry(run, "M2", kind="response").update(request=True),
    ),
    # kinds
    "a publication that is called no request": (
        "of the journal of mqtt says request False, its kind 'PUBLISH' says True",
        lambda run: published(run).update(request=False, state_changing=False),
    ),
    "a publication that changes nothing": (
        "of the journal of mqtt says state_changing False, its kind 'PUBLISH' says True",
        lambda run: published(run).update(state_changing=False),
    ),
    "a subscription that changes the plant": (
        "of the journal of mqtt says state_changing True, its kind 'SUBSCRIBE' says False",
        lambda run: entry(run, "Q2", kind="SUBSCRIBE", origin="client").update(state_changing=True),
    ),
    "a packet of the adapter that is called the plant's": (
        "of the journal of mqtt is called the plant's, its connection was the client's",
        lambda run: ended(run).update(origin="plant", request=False),
    ),
    "a packet of the adapter that is called a stranger's": (
        "of the journal of mqtt is called the stranger's, its connection was the client's",
        lambda run: ended(run).update(origin="stranger"),
    ),
    "a packet of the adapter that is called the kit's": (
        "of the journal of mqtt is called the kit's, its connection was the client's",
        lambda run: ended(run).update(origin="kit", request=False),
    ),
    "a session that goes on after its end": (
        "of the journal of mqtt is called the client's, its connection was the former's",
        lambda run: ended(run).update(origin="former"),
    ),
    "a message of the kit that is called the adapter's": (
        "of the journal of mqtt has no connection, and is called the client's",
        lambda run: entry(run, "Q2", kind="PUBLISH", origin="kit").update(
            origin="client", request=True, state_changing=True
        ),
    ),
    "a grant of another connection": (
        "of the journal of mqtt answers the entry",
        lambda run: subscribed(run).update(connection=99),
    ),
    "a grant of what was published": (
        "of the journal of mqtt answers the entry",
        lambda run: subscribed(run).update(answers=entry(run, "Q2", kind="PUBLISH", direction="out")["seq"]),
    ),
    "a grant of what was ended": (
        "of the journal of mqtt is called 'UNSUBACK' and answers the entry",
        lambda run: subscribed(run).update(kind="UNSUBACK"),
    ),
    "a service that is called no request": (
        "of the journal of opcua says request False, its kind 'Read' says True",
        lambda run: service(run, "O1", "Read").update(request=False),
    ),
    "a write of a node that changes nothing": (
        "of the journal of opcua says state_changing False, its kind 'Write' says True",
        lambda run: service(run, "O3", "Write").update(state_changing=False),
    ),
    "a read of a node that changes the plant": (
        "of the journal of opcua says state_changing True, its kind 'Read' says False",
        lambda run: service(run, "O1", "Read").update(state_changing=True),
    ),
    "a write of a node that is called a read": (
        "of the journal of opcua is called 'Read', and has a value of 'ns=2;",
        lambda run: service(run, "O3", "Write").update(kind="Read", state_changing=False),
    ),
    "a write of a node that has become a read": (
        "of the journal of opcua says kind 'Read', its message says 'Write'",
        a_write_that_is_a_read,
    ),
    "a read of a node that is called a write": (
        "of the journal of opcua is called 'Write', and has no value of 'ns=2;",
        lambda run: service(run, "O1", "Read").update(kind="Write", state_changing=True),
    ),
    "a service that keeps the session": (
        "of the journal of opcua has 'nodes', which a 'CloseSession' that was received does not have",
        lambda run: service(run, "O2", "Browse").update(kind="CloseSession", request=False),
    ),
    "a service that nobody knows": (
        "of the journal of opcua is of the kind 'Re\u0430d', which is no service",
        lambda run: service(run, "O1", "Read").update(kind="Re\u0430d"),
    ),
    "results of a request": (
        "of the journal of opcua has 'results', which a 'Read' that was received does not have",
        lambda run: service(run, "O1", "Read").update(results=[{"status": "Good"}]),
    ),
    "an answer of another service": (
        "of the journal of opcua says kind 'Browse', its message says 'Read'",
        lambda run: service(run, "O1", "Read", "out").update(kind="Browse"),
    ),
    "another value of a node": (
        "of the journal of opcua says nodes [{",
        lambda run: service(run, "O3", "Write")["nodes"][0].update(value=0.25),
    ),
    "another node of a read": (
        "of the journal of opcua says nodes [{",
        lambda run: service(run, "O1", "Read")["nodes"][0].update(node_id="ns=2;s=Flow"),
    ),
    "another status of a write": (
        "of the journal of opcua says results [{'status': 'Good",
        lambda run: service(run, "O3", "Write", "out")["results"][0].update(status="GoodClamped"),
    ),
    "entries of a device that was not there": (
        "M1: task has journal entries of a device that the item did not have",
        lambda run: journal(run, "M1").append({**journal(run, "M1")[0], "protocol": "opcua"}),
    ),
    "a device that accepts connections later": (
        "M2: modbus accepted connections since",
        lambda run: item(run, "M2")["devices"]["modbus"].update(accepting_ns=item(run, "M2")["began_ns"]),
    ),
    "a device that accepts connections when all is over": (
        "M1: modbus accepted connections only after the item had looked at it",
        lambda run: [one["devices"]["modbus"].update(accepting_ns=10**18) for one in run["items"]],
    ),
    # calls
    "a call that is lost": (
        "M3 repetition 1: the steps ask for modbus read_holding(address=1, count=1), the history has no further call",
        lambda run: sample(run, "M3")["calls"].pop(),
    ),
    "a call twice": (
        "M3 repetition 1: the history has 1 call(s) more than the steps make",
        lambda run: sample(run, "M3")["calls"].append(copy.deepcopy(call(run, "M3", 1))),
    ),
    "another argument": (
        "M3 repetition 1: write_holding is performed by write_register with {'address': 1, 'value':",
        lambda run: call(run, "M3")["arguments"].update(value=41),
    ),
    "another question": (
        "M3 repetition 1: the steps ask for modbus write_holding(address=1, value=",
        lambda run: call(run, "M3")["inputs"].update(value=41),
    ),
    "another tool": (
        "the history has write_coil with {'address': 1, 'value':",
        lambda run: call(run, "M3").update(tool="write_coil"),
    ),
    "another operation": (
        "M1 repetition 1: the steps ask for modbus ping(), the history has modbus read_holding()",
        lambda run: call(run, "M1").update(operation="read_holding"),
    ),
    "a value that was read": (
        "M3 repetition 1, call 2 (read_multiple_holding_registers): the stored history shows ok false",
        read_another_value,
    ),
    "an output that was read": (
        "M3 repetition 1, call 2 (read_multiple_holding_registers): the stored history shows outputs",
        lambda run: call(run, "M3", 1)["outputs"].update(values=[41]),
    ),
    "a faster answer": (
        "M1 repetition 1, call 1 (ping): the stored history shows latency_ms",
        lambda run: call(run, "M1").update(latency_ms=0.01),
    ),
    "an answer before its question": (
        "M1 repetition 1: the call of ping is not of its time",
        lambda run: call(run, "M1").update(received_ns=call(run, "M1")["sent_ns"] - 1),
    ),
    "an answer that never came": (
        "M1 repetition 1: the stored history shows ok false, the record says true",
        lambda run: call(run, "M1").update(received_ns=None, latency_ms=None),
    ),
    "a call before the item": (
        "M1 repetition 1: the call of ping is not of its time: 1 to",
        lambda run: call(run, "M1").update(sent_ns=1),
    ),
    "another role": (
        'M1 repetition 1, call 1 (ping): the stored history shows role "task", the record says "setup"',
        lambda run: call(run, "M1").update(role="setup"),
    ),
    "a call that was right": (
        "M1 repetition 1, call 1 (ping): the stored history shows ok true, the record says false",
        lambda run: call(run, "M1").update(ok=False),
    ),
    "a refusal that is a success": (
        "M4 repetition 1: the stored history shows ok false, the record says true",
        lambda run: call(run, "M4")["envelope"].update(success=True, error=None),
    ),
    "another code of an error": (
        '(write_register): the stored history shows error_code "writes_disabled", the record says "timeout"',
        lambda run: call(run, "M4").update(error_code="timeout"),
    ),
    "another code in the envelope": (
        '(write_register): the stored history shows error_code "timeout", the record says "writes_disabled"',
        lambda run: call(run, "M4")["envelope"]["error"].update(code="timeout"),
    ),
    "no envelope": (
        "M1 repetition 1: ping was answered without an envelope, and there are no frames",
        lambda run: call(run, "M1").update(envelope=None),
    ),
    "an envelope that is not the adapter's": (
        "M1 repetition 1: ping was answered without an envelope, and there are no frames",
        lambda run: call(run, "M1").update(native=False),
    ),
    "a tool that is not listed": (
        "M1 repetition 1, call 1 (ping): the stored history shows listed true, the record says false",
        lambda run: call(run, "M1").update(listed=False),
    ),
    "an exchange that did not take place": (
        "write_register(address=1, value=999): meta.attempts says 3, the device saw 0 request(s)",
        lambda run: call(run, "M4")["envelope"]["meta"].update(attempts=3),
    ),
    "an envelope from another day": (
        "ping(): meta.started_at says 2020-11-21T07:03:43.000Z, the call was made at",
        lambda run: call(run, "M1")["envelope"]["meta"].update(started_at="2020-11-21T07:03:43.000Z"),
    ),
    "a digest of frames without frames": (
        "M1 repetition 1: ping has a digest of frames, and no frames",
        lambda run: call(run, "M1").update(frames_sha256="0" * 64),
    ),
    "a shorter repetition": (
        "M1 repetition 1: the stored history shows duration_ms",
        lambda run: sample(run, "M1").update(duration_ms=0.001),
    ),
    # looks
    "an image": (
        "'1/holding_registers/2 should hold 7, the device holds",
        lambda run: look(run, "M3", "changes")["changes"].append([["points", "1/holding_registers/2"], 7]),
    ),
    "a look that is lost": (
        "M3 repetition 1: the call of write_register is not of its time",
        lambda run: sample(run, "M3")["observations"].remove(look(run, "M3", "changes")),
    ),
    "a look that was answered before it was asked": (
        "M3 repetition 1: image of modbus is not of its time",
        lambda run: look(run, "M3", "changes").update(seen_ns=1),
    ),
    "a slice without end": (
        "M3 repetition 1: the journal of modbus should have the entries",
        lambda run: look(run, "M3", "end").update(end=10**10),
    ),
    "a slice that ends before": (
        "M3 repetition 1: the journal of modbus was taken up to entry",
        lambda run: look(run, "M3", "end").update(end=0),
    ),
    "more messages than there were": (
        "Q2 repetition 1: 1000000000 entries with",
        lambda run: look(run, "Q2", "wait").update(wait=10**9),
    ),
    # items
    "another title": (
        'M1: the stored history shows title "Ping the adapter and confirm the TCP mock is reachable.", the record says',
        lambda run: item(run, "M1").update(title="Read whatever there is."),
    ),
    "other capabilities": (
        'M1: the stored history shows capabilities ["',
        lambda run: item(run, "M1").update(capabilities=[]),
    ),
    "a requirement that is said to be met": (
        "M1: the stored history shows requirement_rows []",
        lambda run: item(run, "M1").update(requirement_rows=[{"id": "WR-003", "status": "PASS"}]),
    ),
    "other requirements": (
        'M1: the stored history shows requirements ["REC-002", "MCP-008"], the record says []',
        lambda run: item(run, "M1").update(requirements=[]),
    ),
    "another status": (
        "from its items follows NOT CONFORMANT, the footer says INCOMPLETE",
        lambda run: item(run, "M1").update(status="FAIL"),
    ),
    "another reason": (
        'M1: the stored history shows reason null, the record says "we were busy"',
        lambda run: item(run, "M1").update(reason="we were busy"),
    ),
    "no closing checks": (
        "M4: the history ends after 2 repetitions and does not say why",
        lambda run: item(run, "M4")["around"].pop(),
    ),
    "no warm-up": (
        "M1: the history ends after 0 repetitions and does not say why",
        lambda run: item(run, "M1").update(around=[]),
    ),
    "a finding that nothing shows": (
        "M2 repetition 1: the record says 'no text' (no_text, a warning), the stored history does not show it",
        invent_a_finding,
    ),
    "noise that the item does not know of": (
        'M2: the stored history shows status "FAIL", the record says "PASS"',
        add_noise,
    ),
    "a stranger that nobody saw": (
        "M2: the stored history shows strangers [], the record says",
        add_a_stranger,
    ),
    "another day than that of the times on the wire": (
        'Q4: the stored history shows status "FAIL", the record says "PASS"',
        on_another_day,
    ),
    "an end that did not come": (
        'M2: the stored history shows status "FAIL", the record says "PASS"',
        end_early,
    ),
}


@pytest.mark.parametrize("name", FORGERIES)
def test_a_forged_record_is_refused(genuine: Record, tmp_path: Path, name: str) -> None:
    reason, change = FORGERIES[name]
    # Most forgeries are found in the first four items; the others need not be judged again a hundred times.
    first = "Modbus" if "opcua" not in reason else "OPC UA"
    families = FAMILIES[:2] if "mqtt" in reason or "Q" in reason else (first,)
    run = copy.deepcopy({**genuine, "items": [one for one in genuine["items"] if one["family"] in families]})
    change(run)
    with pytest.raises(Refusal, match=r"^refused: ") as refusal:
        examined(tmp_path, run)
    sentence = str(refusal.value)
    assert reason in sentence
    assert "\n" not in sentence


# -- what nobody can refuse without a signature ---------------------------------------------------------------------------


def a_faster_adapter(run: Record) -> None:
    """Let an answer come earlier by a microsecond, in all that follows from it."""
    faster, repetition = call(run, "M1"), sample(run, "M1")
    faster["received_ns"] -= 1000
    faster["latency_ms"] = repetition["duration_ms"] = round((faster["received_ns"] - faster["sent_ns"]) / 1e6, 4)


INHERENT: dict[str, Change] = {
    "name, version and digest of the subject": lambda run: run["subject"].update(
        name="Another Adapter", version="9.0", digest="sha256:" + "1" * 64
    ),
    "the command": lambda run: facts(run).update(command=["another-adapter"]),
    "how the server introduced itself": lambda run: facts(run).update(server_name="other", server_version="9"),
    "the revision of MCP": lambda run: facts(run).update(protocol_version="2025-11-25"),
    "the machine": lambda run: run["environment"].update(python="3.13.0", platform="Plan 9", cpu_count=64, packages={}),
    "the latency of a call": a_faster_adapter,
    "where the time went": lambda run: item(run, "M1").update(timing_ms={"tool calls": 1.0}),
    "how long the run took": lambda run: run["footer"].update(elapsed_s=1.0, breakdown_s={}),
    "the identifiers of calls": lambda run: [one["envelope"]["meta"].update(request_id="x") for one in calls(run)],
    "the run's identifier": lambda run: [part.update(run_id="5" * 32) for part in (run, *run["items"])],
    "the order of the items in the file": lambda run: run["items"].reverse(),
    "the number of a session": lambda run: item(run, "M2")["devices"]["modbus"].update(session=[7, 0]),
    "who had a connection": lambda run: [one["process"].update(name="plc") for one in processes(run)],
    "what protocols do not keep the bytes of": lambda run: entry(run, "Q1", kind="CONNECT").update(keepalive=7),
    "the unit identifier of an answer": lambda run: entry(run, "M2", kind="response").update(unit=9),
    "which further protocols were asked for": lambda run: run["settings"].update(
        protocols=["all"], not_measured={"s7": "it was not there"}
    ),
    "what the server's own envelopes lack": lambda run: facts(run).update(unmet=["ENV-001"], unjudged=["reachable"]),
    "members that nobody knows": lambda run: run.update(awarded="Gold", approved_by="TUV"),
}


def processes(run: Record) -> list[Record]:
    return [one for part in parts(run) for one in part["device"] if "process" in one]


@pytest.mark.parametrize("name", INHERENT)
def test_what_an_unsigned_record_says_of_itself_is_believed(genuine: Record, tmp_path: Path, name: str) -> None:
    run = copy.deepcopy(genuine)
    INHERENT[name](run)
    assert json.dumps(run) != json.dumps(genuine)
    assert examined(tmp_path, run)[0].startswith("verified: ")
