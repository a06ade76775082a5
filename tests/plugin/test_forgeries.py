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
from pytest_otmcp.core.challenge import seed_of
from pytest_otmcp.record import load
from pytest_otmcp.soundness.warm_start import WarmStart
from tests.stored_runs import store

from .places import Change, Record, call, calls, entry, facts, item, journal, look, moved, parts, sample
from .reference_run import reference_run
from .vendor import Repository

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
    return examine(store(path / "run.json", run)).said


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
        examine(store(tmp_path / "run.json", genuine), subject=changed)


@pytest.mark.long
def test_a_run_for_a_challenge_is_none_for_another_one(empty_repository: Repository, tmp_path: Path) -> None:
    asked, other = "buyer-2026-11-26-7f3a9c", "buyer-2025-01-01-000000"
    empty_repository.subject()
    outcome = empty_repository.pytest(
        "--pyargs", "pytest_otmcp.conformance", f"--otmcp-challenge={asked}", "-k", "[M3]"
    )
    record = outcome.report / "run.json"
    assert (
        f"its values follow from the challenge {asked}, so the run is newer than that question"
        in examine(record, challenge=asked).said
    )
    with pytest.raises(Refusal, match="was not made for the challenge 'buyer-2025-01-01-000000', but for 'buyer-2026"):
        examine(record, challenge=other)
    run = load(record, allow_incomplete=True)
    run["settings"].update(challenge=other, seed=seed_of(other))
    with pytest.raises(Refusal, match="was not judged as its history deserves: M3 warmup: the steps ask for "):
        examine(store(tmp_path / "run.json", run), challenge=other)
    outcome = empty_repository.pytest(
        "--pyargs", "pytest_otmcp.conformance", f"--otmcp-challenge={asked}", "-k", "[M1]"
    )
    with pytest.raises(Refusal, match="names a challenge, but no value of the run follows from it"):
        examine(outcome.report / "run.json", challenge=asked)
    del run["settings"]["challenge"]
    with pytest.raises(Refusal, match="was not made for the challenge 'buyer-2026-11-26-7f3a9c', but for none"):
        examine(store(tmp_path / "run.json", run), challenge=asked)


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
    """Change what the device was told to write."""
    write = entry(run, "M3", function=6, direction="in")
    write["frame"] = f"{write['frame'][:-4]}{write['values'][0] ^ 1:04x}"


def lose_an_entry(run: Record) -> None:
    """Drop a request and renumber what follows in that repetition."""
    entries = journal(run, "M1")
    del entries[0]
    for one in entries:
        one["seq"] -= 1


def other_message(run: Record) -> None:
    """Put the payload of a birth certificate into a data message."""
    birth = next(one for part in parts(run) for one in part["device"] if "/DBIRTH/" in one.get("topic", ""))
    data = message(run)
    topic, before = (one["topic"].encode().hex() for one in (data, birth))
    data["frame"] = birth["frame"].replace(before, topic)


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


def ended(run: Record) -> Record:
    """Return the UNSUBSCRIBE of the adapter's first subscription."""
    return entry(run, "Q2", kind="UNSUBSCRIBE", origin="client")


def service(run: Record, identifier: str, kind: str, direction: str = "in") -> Record:
    """Return a service request of an item, or an answer."""
    return entry(run, identifier, kind=kind, direction=direction)


def a_write_without_its_frame(run: Record) -> None:
    """Keep of a Write what is said of a Read, and no frame that could say otherwise."""
    write = service(run, "O3", "Write")
    write |= {"kind": "Read", "state_changing": False}
    del write["frame"]


def a_request_of_the_kit(run: Record) -> None:
    """Call a write of the adapter, with its answer, what the kit did at the device."""
    asked = entry(run, "M3", function=6, direction="in")
    both = [one for part in parts(run) for one in part["device"] if one is asked or one["answers"] == asked["seq"]]
    for one in both:
        one.update(connection=0, origin="kit")


def a_real_device(run: Record) -> None:
    run["settings"]["devices"] = {"modbus": {"url": "tcp://10.0.0.1:502", "consent": None}}


def a_connection_that_begins_twice(run: Record) -> None:
    """Call a packet the begin of its connection."""
    unsubscribe = ended(run)
    unsubscribe |= {"kind": "CONNECTED", "request": False}
    for name in ("filters", "frame", "packet_id"):
        unsubscribe.pop(name)


def a_session_that_begins_later(run: Record) -> None:
    """Let a new session begin a million entries later, so that nothing that it did would be of a session."""
    looks = (seen for part in parts(run) for seen in part["observations"])
    fresh = next(seen for seen in looks if seen["at"] == "modbus" and "fresh_session" in seen)
    fresh["fresh_session"]["opened"] += 10**6


def a_guard_that_leaks(run: Record) -> None:
    """Let the adapter with writes disabled have sent a write."""
    request = entry(run, "M4", variant="ro", kind="request")
    request["frame"] = f"{request['frame'][:14]}06{request['address']:04x}0001"


# -- forgeries ------------------------------------------------------------------------------------------------------------


def on_another_day(run: Record) -> None:
    """Move the whole run by two days: every time of day, those of the envelopes, and the monotonic clock by as much."""
    for place in (run["environment"], *run["items"]):
        for name in ("started_at", "finished_at"):
            place[name] = earlier(place[name])
    for one in calls(run):
        meta = one["envelope"]["meta"]
        meta["started_at"] = earlier(meta["started_at"])
    for one in run["items"]:
        moved(one, ns=2 * DAY_NS)


def to_come(run: Record) -> None:
    """Move the time of day of the whole run five years ahead."""
    for place in (run["environment"], *run["items"]):
        for name in ("started_at", "finished_at"):
            place[name] = (
                (datetime.fromisoformat(place[name]) + timedelta(days=5 * 365)).isoformat().replace("+00:00", "Z")
            )


def earlier(moment: str) -> str:
    return (datetime.fromisoformat(moment) + timedelta(days=-2)).isoformat().replace("+00:00", "Z")


FORGERIES: dict[str, tuple[str, Change]] = {
    # shape
    "a day that no calendar has": (
        "M1 has the time '2026-02-30T07:03:43.000Z', which no clock shows",
        lambda run: item(run, "M1").update(started_at="2026-02-30T07:03:43.000Z"),
    ),
    "a name that moves the cursor": (
        "the record.subject.name: has a control character",
        lambda run: run["subject"].update(name="acme\x1b[2J verified: by TUV\n"),
    ),
    "a deadline of days": ("deadline_s: expected `float` <= 300.0", lambda run: facts(run).update(deadline_s=1e6)),
    "a time scale of nothing": (
        "the record.settings.time_scale: expected `float` > 0.0",
        lambda run: run["settings"].update(time_scale=0),
    ),
    "a million restarts and one more": (
        "starts: expected `int` <= 1000000",
        lambda run: item(run, "M2")["devices"]["modbus"].update(starts=10**18),
    ),
    # counts and identity
    "an item twice": ("an item occurs twice: M1", lambda run: run["items"].append(copy.deepcopy(item(run, "M1")))),
    "an item of another run": (
        "M1 is of another run: its run_id is 0000",
        lambda run: item(run, "M1").update(run_id="0" * 32),
    ),
    "a verdict that is better": (
        "from its items follows INCOMPLETE, the footer says CONFORMANT",
        lambda run: run["footer"].update(verdict="CONFORMANT"),
    ),
    "a repetition that is lost": (
        "M2: the history ends after 1 repetitions and does not say why",
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
    "another kit": (
        "was judged by another kit: pytest-otmcp 9.9.9, and this is",
        lambda run: run["kit"].update(version="9.9.9"),
    ),
    "another suite": (
        "with other files than this one (of another commit, or one of the two has been changed)",
        lambda run: run["kit"].update(suite_digest="sha256:" + "0" * 64),
    ),
    "a protocol that somebody else is said to have judged": (
        "does not say rightly who judged the protocol 'modbus'",
        lambda run: run["kit"]["protocols"][0].update(distribution="tuv", version="1"),
    ),
    # time of day
    "an item of another hour": (
        "does not go with its monotonic time: it is of another run, or the clock of the machine was set",
        other_hour,
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
    "a claim withdrawn afterwards": (
        "M1: the record says PASS, the subject does not claim modbus.ping",
        unclaim,
    ),
    "an item that is said not to apply": (
        "M1: the record says NOT_APPLICABLE, the subject claims modbus.ping",
        lambda run: item(run, "M1").update(status="NOT_APPLICABLE"),
    ),
    "an absurd path in a binding": (
        'call 1 (ping): the stored history shows outputs {"reachable": null}, the record says',
        lambda run: facts(run)["bindings"]["ping"][0]["outputs"]["reachable"].update(path="[[["),
    ),
    "a shorter deadline": ("deadline 1e-06 s' (deadline_missed)", lambda run: facts(run).update(deadline_s=1e-6)),
    # devices
    "a device on another machine": (
        "modbus: a device of the kit listens on this machine only, the record says '10.0.0.1'",
        lambda run: run["devices"]["modbus"]["endpoints"][0].update(host="10.0.0.1"),
    ),
    "envelopes of another machine": (
        "ping(): meta.endpoint should be that of the device, 127.0.0.1:",
        elsewhere,
    ),
    "a device at another port": ("M3 warmup: the steps ask for modbus read_", at_another_port),
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
    "slices of other repetitions": (
        "M2 repetition 1: the journal of modbus should have the entries",
        swap_slices,
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
    "a request of the kit": ("has no connection, and is called the kit's", a_request_of_the_kit),
    "a real device that was a mock": ("a device with witnesses is a real one that the settings name", a_real_device),
    "a connection that begins twice": (
        "of the journal of mqtt begins the connection",
        a_connection_that_begins_twice,
    ),
    # bytes
    "the payload of another message": ("DDATA must have seq", other_message),
    "another value written, bytes and all": (
        "warmup: the device should have seen one write of [40] to holding_registers 1, it saw a write of [41]",
        write_another_value,
    ),
    "a guard that leaks": (
        "M4 control: the steps ask for end of modbus, the history has garbled of modbus@ro",
        a_guard_that_leaks,
    ),
    # kinds
    "a message of the kit that is called the adapter's": (
        "of the journal of mqtt is called 'PUBLISH', and has no frame",
        lambda run: entry(run, "Q2", kind="PUBLISH", origin="kit").update(
            origin="client", request=True, state_changing=True
        ),
    ),
    "a write of a node that has become a read": (
        "of the journal of opcua is called 'Read', and has no frame",
        a_write_without_its_frame,
    ),
    "entries of a device that was not there": (
        "M1: task has journal entries of a device that the item did not have",
        lambda run: journal(run, "M1").append({**journal(run, "M1")[0], "protocol": "opcua"}),
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
    "a value that was read": (
        "M3 repetition 1, call 2 (read_multiple_holding_registers): the stored history shows ok false",
        read_another_value,
    ),
    "an answer that never came": (
        "M1 repetition 1: the stored history shows ok false, the record says true",
        lambda run: call(run, "M1").update(received_ns=None, latency_ms=None),
    ),
    "a refusal that is a success": (
        "M4 repetition 1: the stored history shows ok false, the record says true",
        lambda run: call(run, "M4")["envelope"].update(success=True, error=None),
    ),
    "an exchange that did not take place": (
        "write_register(address=1, value=999): meta.attempts says 3, the device saw 0 request(s)",
        lambda run: call(run, "M4")["envelope"]["meta"].update(attempts=3),
    ),
    # looks
    "an image": (
        "'1/holding_registers/2 should hold 7, the device holds",
        lambda run: look(run, "M3", "changes")["changes"].append([["points", "1/holding_registers/2"], 7]),
    ),
    # items
    "no closing checks": (
        "M4: the history ends after 2 repetitions and does not say why",
        lambda run: item(run, "M4")["around"].pop(),
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
    "a time that is still to come": (
        "contradicts itself: the run ended at 20",
        to_come,
    ),
    "workers of pytest-xdist that had no device": (
        "the settings say 64 workers of pytest-xdist, ",
        lambda run: run["settings"].update(xdist_workers=64),
    ),
    "the era of the handshake": (
        "the settings ask for sessions by handshake, that of modbus was one of MCP 20",
        lambda run: run["settings"].update(era="legacy"),
    ),
    "a facet that does not exist": (
        "subject.adapters.modbus offers 'teleport', which is no voluntary facet of Modbus",
        lambda run: run["subject"]["adapters"]["modbus"].update(offered=["teleport"]),
    ),
    "a deviation that was not declared": (
        "from its items follow the deviations {'used': [], 'stale': [], 'expired': []}, the footer says {'used': ['M1']",
        lambda run: run["footer"]["deviations"].update(used=["M1"]),
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
    families = FAMILIES[:2] if any(word in reason for word in ("mqtt", "Q", "DDATA")) else (first,)
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
    "the latency of a call": a_faster_adapter,
    "the identifiers of calls": lambda run: [one["envelope"]["meta"].update(request_id="x") for one in calls(run)],
    "the run's identifier": lambda run: [part.update(run_id="5" * 32) for part in (run, *run["items"])],
    "the order of the items in the file": lambda run: run["items"].reverse(),
    "which further protocols were asked for": lambda run: run["settings"].update(
        protocols=["all"], not_measured={"s7": "it was not there"}
    ),
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
