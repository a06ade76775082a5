"""SPB: Sparkplug B.

That every session of an edge node keeps the rules of births, deaths and sequence is judged in all checks, packet by packet
(:class:`~pytest_otmcp.protocols.mqtt.oracle.SparkplugSequence`). The checks here make happen what the rules are about.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.journal import Entries
from pytest_otmcp.protocols.mqtt import oracle
from pytest_otmcp.protocols.mqtt.commands import REBIRTH, SCAN_RATE, commands
from pytest_otmcp.protocols.mqtt.entries import adapter_packets, as_mqtt, describe, payload_of
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig
from pytest_otmcp.wire.mqtt.sparkplug import DATA_TYPES, decode_payload

from ..tasks.messages import subscribe, sync_point
from .mqtt_steps import Messages, edge_node_of, nonce, sparkplug, until, until_it_works
from .steps import CONNECTION_FAULTS, QUIET_S, since

__all__ = ["TASKS"]

TASKS = Checks()

_DEVICES = "mqtt.device_birth mqtt.device_data"
_REFUSALS = ("invalid_input", "illegal_address", "illegal_value", "type_mismatch", "range_overflow", "not_born")
_UNSUPPORTED = (*_REFUSALS, "unsupported_operation")
_REBIRTH = {"name": REBIRTH, "datatype": "Boolean", "value": True}
_LOST_CONNECTION = 0x8B
_NOTICED_S, _LET_IN_S = 1.0, 2.0
"""Seconds in which an adapter that connects again by itself does so, when it has lost its connection and when the broker lets it in again."""

_LOOKS, _LOOK_S = 20, 0.05
"""How often an adapter without an exchange to wait for is asked until it has heard what was published, and the pause between."""

_TYPES: tuple[tuple[str, Any, Any], ...] = (
    ("Int8", 1, -5),
    ("Int16", 1, -300),
    ("Int32", 1, -5),
    ("Int64", 1, -(2**62)),
    ("UInt8", 1, 200),
    ("UInt16", 1, 40_000),
    ("UInt32", 1, 4_000_000_000),
    ("UInt64", 1, 2**63),
    ("Float", 1.5, -22.25),
    ("Double", 1.5, 1 / 3),
    ("Boolean", False, True),
    ("String", "born", "22,5 °C \N{GREEK CAPITAL LETTER OMEGA}"),
    ("DateTime", 1_700_000_000_000, 1_700_000_000_123),
)
"""Data types with a value for the birth and one for the data; a reader of JSON that has only doubles reads each exactly."""

# The node as the mock has it.
_GROUP, _NODE = "factory", "edge-node-1"


def _temperature(value: float = 20.0) -> list[dict[str, Any]]:
    return [{"name": "temperature", "datatype": "Double", "value": value}]


def _data(value: float) -> list[dict[str, Any]]:
    return [{"name": "temperature", "value": value}]


def _new_device(run: Repetition) -> str:
    return f"device-{nonce(run)}"


def _a_value(run: Repetition) -> float:
    return round(run.rng.uniform(1.0, 99.0), 3)


async def _born(run: Repetition, mqtt: Rig, device: str, metrics: Sequence[Mapping[str, Any]] = ()) -> Reply:
    """Announce a device, by default with a temperature."""
    reply = await mqtt.call("device_birth", device=device, metrics=list(metrics) or _temperature())
    run.succeeds(reply)
    return reply


async def _reports(run: Repetition, mqtt: Rig, device: str) -> Reply:
    """Report a random temperature of a device that was born, as the positive control: said, and on the wire once."""
    value = _a_value(run)
    reply = await mqtt.call("device_data", device=device, metrics=_data(value))
    if run.succeeds(reply, metric_count=1):
        await _arrives(run, mqtt, reply, "DDATA", device, _temperature(value))
    return reply


async def _arrives(
    run: Repetition, mqtt: Rig, reply: Reply, kind: str, device: str, metrics: Sequence[Mapping[str, Any]]
) -> None:
    """Expect that a device's message with these metrics reached the broker."""
    await _there(mqtt, reply, device, kind)
    births, entries = await mqtt.follow(oracle.Births), since(reply, await mqtt.journal())
    run.witnessed(oracle.reported(entries, kind=kind, device=device, metrics=metrics, births=births))


async def _there(mqtt: Rig, reply: Reply, device: str, kind: str) -> None:
    """Wait for a device's message that was sent after the request of a call."""
    await until(mqtt, lambda entries: _of(device, sparkplug(since(reply, entries), kind)) != [])


def _of(device: str | None, messages: Messages) -> Messages:
    return [one for one in messages if one[1]["device"] == device]


async def _buried(run: Repetition, mqtt: Rig, *devices: str) -> None:
    """Declare devices dead, so that the births of later checks do not have them."""
    if mqtt.subject.claims("device_death"):
        for device in devices:
            run.succeeds(await mqtt.call("device_death", device=device))


async def _cut(mqtt: Rig) -> None:
    await mqtt.device.poke(disconnect={"reason_code": _LOST_CONNECTION})


# -- SPB-001, SPB-002 ---------------------------------------------------------------------------------------


@TASKS.check("SPB-001", "Metrics arrive with the type and the value that were asked for.", needs=_DEVICES)
async def metrics_arrive_as_they_were_asked_for(run: Repetition, mqtt: Rig) -> None:
    """Announce a device with metrics of thirteen data types, and report new values: negative ones, 2^63, text, and null. An adapter that
    refuses them together is given one at a time; it may refuse a type that it does not have. Where a tool decodes payloads, have it
    decode a message of the plant's.

    Said: success; the decoded metrics are those of the message.
    Seen: DBIRTH and DDATA which a decoder of the kit's own reads as what was asked for: negative numbers as two's complement, null
        as `is_null` (tck-id-payloads-metric-datatype-value-type, tck-id-payloads-name-birth-data-requirement).
    Why: a number in the wrong field of the payload is another number, or none, and "published" was said.
    """
    device = _new_device(run)
    together = await _reports_types(run, mqtt, device, _TYPES)
    alone = [] if together else [(f"{device}-{one[0]}", one) for one in _TYPES]
    accepted = [device] if together else []
    for name, one in alone:
        if await _reports_types(run, mqtt, name, [one]):
            accepted.append(name)
    if not accepted:
        run.finding(
            "not_successful", f"{mqtt.protocol}: a device with a metric of any of the data types is refused", "SPB-001"
        )
    await _buried(run, mqtt, *accepted)
    if mqtt.subject.claims("decode_sparkplug") and mqtt.subject.claims("subscribe"):
        await _decodes(run, mqtt)


async def _reports_types(run: Repetition, mqtt: Rig, device: str, types: Sequence[tuple[str, Any, Any]]) -> bool:
    """Announce a device with metrics of these types and report new values; return False where the device is refused."""
    first, second = ([{"name": one[0], "datatype": one[0], "value": one[which]} for one in types] for which in (1, 2))
    birth = await mqtt.call("device_birth", device=device, metrics=first)
    if not birth.success:
        codes = _UNSUPPORTED if birth.excess is None else (*_UNSUPPORTED, "limit_exceeded")
        run.fails(birth, *codes, outcome="not_sent", requirement="SPB-001")
        return False
    await _arrives(run, mqtt, birth, "DBIRTH", device, first)
    for metrics in (second, [{**metric, "value": None} for metric in second]):
        values = [{"name": metric["name"], "value": metric["value"]} for metric in metrics]
        reply = await mqtt.call("device_data", device=device, metrics=values)
        if reply.success:
            await _arrives(run, mqtt, reply, "DDATA", device, metrics)
        else:
            run.fails(reply, *_UNSUPPORTED, outcome="not_sent", requirement="SPB-001")
    return True


async def _decodes(run: Repetition, mqtt: Rig) -> None:
    topic = f"spBv1.0/{_GROUP}/DBIRTH/{_NODE}/device-1"
    run.succeeds(await subscribe(mqtt, topic))
    metrics = [
        _plant_metric(*one) for one in (("low", "Int32", -5), ("large", "UInt64", 2**63), ("broken", "Double", "NaN"))
    ]
    await mqtt.device.poke(edge_node={"metrics": metrics})
    sent = [
        packet
        for packet in await mqtt.wait_for(kind="PUBLISH", direction="out", topic=topic, timeout_s=1.0)
        if any(metric["name"] == "low" for metric in decode_payload(payload_of(packet))["metrics"])
    ]
    if not sent:
        run.witnessed((await mqtt.follow(oracle.Subscriptions)).granted(topic, qos=None))
        return
    reply = await mqtt.call("decode_sparkplug", payload=as_mqtt(sent[-1])["payload"])
    if run.succeeds(reply, requirement="SPB-001"):
        run.judge(reply, _told(reply, reply.outputs.get("metrics"), decode_payload(payload_of(sent[-1]))["metrics"]))


def _plant_metric(name: str, datatype: str, value: object, device: str = "device-1") -> dict[str, object]:
    return {"device": device, "name": name, "datatype": datatype, "value": value, "writable": False}


def _told(
    reply: Reply, told: object, metrics: Sequence[Mapping[str, Any]], requirement: str = "SPB-001"
) -> list[Finding]:
    """Expect that an answer lists these metrics with their values."""
    if (problem := _not_told(told, metrics)) is None:
        return []
    message = f"{reply.label}: {problem}"
    return [Finding(code="wrong_value", message=message, requirement=requirement, evidence=repr(told)[:400])]


def _not_told(told: object, metrics: Sequence[Mapping[str, Any]]) -> str | None:
    listed = {one.get("name"): one for one in told if isinstance(one, dict)} if isinstance(told, list) else {}
    for metric in metrics:
        said = listed.get(metric["name"])
        problem = "it is not there" if said is None else _value_problem(said.get("value"), metric["value"])
        if problem is not None:
            return f"{metric['name']} should be {metric['value']!r}, {problem}"
    return None


def _value_problem(said: object, value: object) -> str | None:
    if value in ("NaN", "Infinity", "-Infinity"):
        # JSON has no word for them; which one is used is the matter of other rows.
        wrong = isinstance(said, int | float) and not isinstance(said, bool)
    elif isinstance(value, int) and not isinstance(value, bool):
        # Numbers that readers of JSON would round may be told as decimal digits.
        wrong = isinstance(said, bool) or said not in (value, str(value))
    else:
        wrong = said != value or isinstance(said, bool) != isinstance(value, bool)
    return f"it is {said!r}" if wrong else None


@TASKS.check("SPB-002", "Topics of an edge node keep to their levels.", needs=_DEVICES)
async def topics_keep_to_their_levels(run: Repetition, mqtt: Rig) -> None:
    """Announce devices and report them dead under names that are several levels, wildcards or nothing; then perform every operation
    that publishes as an edge node under a proper name.

    Said: a failure with `invalid_input` and the outcome `not_sent`; then success.
    Seen: no message for the first; for each of the others one on its topic, with QoS 0 and not retained
        (tck-id-topic-structure-namespace-valid-device-id, tck-id-topics-nbirth-mqtt and its like).
    Why: a device named `a/b` publishes as a part of another one.
    """
    device = _new_device(run)
    for name in (f"{device}/a", f"{device}+", "#", ""):
        asked: list[tuple[str, dict[str, Any]]] = [
            ("device_birth", {"device": name, "metrics": _temperature()}),
            ("device_data", {"device": name, "metrics": _data(1.0)}),
            ("device_death", {"device": name}),
        ]
        for operation, inputs in asked:
            if mqtt.subject.claims(operation):
                await _refused(run, mqtt, await mqtt.call(operation, **inputs), "SPB-002", "invalid_input", "not_born")
    await _born(run, mqtt, device)
    await _reports(run, mqtt, device)
    for operation, inputs in (
        ("node_birth", {"metrics": _temperature()}),
        ("node_data", {"metrics": _data(_a_value(run))}),
        ("device_death", {"device": device}),
    ):
        if mqtt.subject.claims(operation):
            run.succeeds(await mqtt.call(operation, **inputs), requirement="SPB-002")


async def _refused(run: Repetition, mqtt: Rig, reply: Reply, requirement: str, *codes: str) -> None:
    """Expect that a call is refused, and that the edge node and its commands say nothing because of it."""
    run.fails(reply, *codes, outcome="not_sent", requirement=requirement)
    # An edge node may repeat the births of what lives whenever it likes.
    births = ("DBIRTH",) if reply.operation == "device_birth" else ()
    during = reply.during(await mqtt.journal())
    found = [*sparkplug(during, *births, "DDATA", "DDEATH"), *_commanding(during)]
    mine = [packet for packet, _ in found if _names(reply, packet["topic"])]
    if mine and reply.success is False:
        message = f"{reply.label}: it was refused, the broker saw {describe(mine[0])}"
        run.witnessed([oracle.broken_rule(requirement, message)])


def _names(reply: Reply, topic: str) -> bool:
    """Tell whether the topic ends with what the call has named."""
    return any(isinstance(value, str) and value and topic.endswith(value) for value in reply.arguments.values())


# -- SPB-003, SPB-004, SPB-005 ------------------------------------------------------------------------------


@TASKS.check("SPB-003", "Births come before data.", needs=_DEVICES)
async def births_come_before_data(run: Repetition, mqtt: Rig) -> None:
    """In a new session report data of a device that was never announced, as the first thing and again when another device is born.
    Then cut the connection, and report data of that one. Where the tool is there, declare the device dead, have the node born again by
    a command, and cut the connection once more.

    Said: a refusal with `not_born`, or success after the births; success. After the cut `not_born` as well: then it is announced again.
    Seen: in each connection NBIRTH first, and DBIRTH before the data of its device (tck-id-principles-birth-certificates-order,
        tck-id-payloads-ddata-order). The device that was declared dead is not born again with the node.
    Why: a host throws away the data of a device that it does not know, and takes one that is dead for alive.
    """
    await mqtt.fresh_session()
    await mqtt.prove()
    unborn, device = _new_device(run), _new_device(run)
    await _unborn(run, mqtt, unborn)
    await _born(run, mqtt, device)
    await _unborn(run, mqtt, unborn)
    await _reports(run, mqtt, device)
    await _cut(mqtt)
    await until_it_works(run, mqtt, "subscribe", filter=f"otmcp/{nonce(run)}", qos=0)
    reply = await mqtt.call("device_data", device=device, metrics=_data(_a_value(run)))
    if not reply.success:
        run.fails(reply, "not_born", *CONNECTION_FAULTS, requirement="SPB-003")
        await until_it_works(run, mqtt, "device_birth", device=device, metrics=_temperature())
    await _reports(run, mqtt, device)
    await _buried(run, mqtt, device)
    if mqtt.subject.claims("device_death"):
        await _stays_dead(run, mqtt, device)


async def _stays_dead(run: Repetition, mqtt: Rig, dead: str) -> None:
    """Ask the node of a device that was reported dead for a rebirth, and cut its connection: the device is not born again with the node."""
    living = _new_device(run)
    birth = await _born(run, mqtt, living)
    node = edge_node_of(since(birth, await mqtt.journal()), living)
    if node is None:
        # No birth on the wire: that has been found.
        return
    await mqtt.device.poke(command={"group": node[0], "edge_node": node[1], "device": None, "metrics": [_REBIRTH]})
    await until(mqtt, lambda entries: len(_of(living, sparkplug(since(birth, entries), "DBIRTH"))) > 1)
    await _cut(mqtt)
    # A birth may be handed to the connection that has just been cut; a subscription is answered on the next one.
    await until_it_works(run, mqtt, "subscribe", filter=f"otmcp/{nonce(run)}", qos=0)
    await until_it_works(run, mqtt, "device_birth", device=living, metrics=_temperature())
    await _reports(run, mqtt, living)
    entries = since(birth, await mqtt.journal())
    if again := _of(dead, sparkplug(entries, "DBIRTH", "DDATA")):
        message = f"{dead} was reported dead, and is there again although no call announced it: {describe(again[0][0])}"
        run.witnessed([oracle.broken_rule("SPB-003", message, entries)])
    await _buried(run, mqtt, living)


async def _unborn(run: Repetition, mqtt: Rig, device: str) -> None:
    """Report data of a device that was not announced."""
    reply = await mqtt.call("device_data", device=device, metrics=_data(_a_value(run)))
    if reply.success:
        await _there(mqtt, reply, device, "DDATA")
        births = _of(device, sparkplug(await mqtt.journal(), "DBIRTH"))
        if not births:
            message = f"{reply.label}: {device} was not announced, it claims success without a DBIRTH"
            run.judge(reply, [oracle.broken_rule("SPB-003", message, since(reply, await mqtt.journal()))])
        return
    await _refused(run, mqtt, reply, "SPB-003", "not_born", "illegal_address", "invalid_input")


_MESSAGES = {False: 260, True: 2600}
"""Data messages in the short and in the long form: once around the 256 numbers, and ten times."""
_AT_ONCE = 4


@TASKS.check("SPB-004", "One sequence counts all messages of an edge node.", needs=_DEVICES)
async def one_sequence_counts_all(run: Repetition, mqtt: Rig) -> None:
    """Announce two devices, and report 260 times data of one or the other, in a soak 2600 times, four calls at a time.

    Said: success each time; where the tool tells it, the number that the message has.
    Seen: 0 to 255 and 0 again, one more with each message, whichever device it is about
        (tck-id-payloads-sequence-num-incrementing, tck-id-payloads-ddata-seq-inc).
    Why: a number that is missing or there twice tells a host that it has lost something, and it asks for everything anew.
    """
    devices = (_new_device(run), _new_device(run))
    births = [await _born(run, mqtt, device) for device in devices]
    await until(mqtt, lambda entries: _of(devices[1], sparkplug(entries, "DBIRTH")) != [])
    _numbers_are_told(run, births, await mqtt.journal())
    received = 0
    for first in range(0, _MESSAGES[run.soak], _AT_ONCE):
        # A slice of its own for each group: otherwise every call would look at everything that came before it.
        await mqtt.keep_journal()
        # Calls that are made together must not each begin with a proof.
        await mqtt.prove()
        values = range(first, first + _AT_ONCE)
        replies = await run.together(
            *(mqtt.call("device_data", device=devices[value % 2], metrics=_data(float(value))) for value in values)
        )
        await until(mqtt, lambda entries: len(_data_of(devices, entries)) >= _AT_ONCE)
        journal = await mqtt.journal()
        received += len(_data_of(devices, journal))
        _numbers_are_told(run, replies, journal)
        if not all(map(run.succeeds, replies)):
            return
    if received != _MESSAGES[run.soak]:
        text = f"of {_MESSAGES[run.soak]} data messages the broker received {received}"
        run.witnessed([oracle.broken_rule("SPB-004", text)])
    await _buried(run, mqtt, *devices)


def _numbers_are_told(run: Repetition, replies: Sequence[Reply], entries: Entries) -> None:
    """Expect that a sequence number that a reply tells is that of a message."""
    sent = {message["seq"] for _, message in sparkplug(entries)}
    for reply in replies:
        number = reply.outputs.get("sequence")
        if reply.success and number is not None and number not in sent:
            message = (
                f"{reply.label}: it tells the sequence number {number}, the messages have {sorted(map(str, sent))}"
            )
            run.judge(reply, [Finding(code="wrong_value", message=message, requirement="SPB-004")])
            return


def _data_of(devices: Sequence[str], entries: Entries) -> Messages:
    return [one for one in sparkplug(entries, "DDATA") if one[1]["device"] in devices]


@TASKS.check("SPB-005", "What fails takes no sequence number.", needs=_DEVICES)
async def what_fails_takes_no_number(run: Repetition, mqtt: Rig) -> None:
    """Report data; a metric that was not announced, a text for a number, and a number that is none; data again. Then stop the broker,
    report data, start it, and report data again.

    Said: success; failures; success. While the broker is away failures of the connection.
    Seen: the message after the failures has the number that follows the one before them, or a new birth comes first
        (tck-id-payloads-sequence-num-incrementing).
    Why: a gap makes a host ask for everything anew, each time that a call has failed.
    """
    device = _new_device(run)
    await _born(run, mqtt, device)
    before = await _reports(run, mqtt, device)
    for metric in (
        {"name": "unknown", "value": 1.0},
        {"name": "temperature", "value": "warm"},
        {"name": "", "value": 1.0},
    ):
        reply = await mqtt.call("device_data", device=device, metrics=[metric])
        if not reply.success:
            run.fails(reply, *_REFUSALS, outcome="not_sent", requirement="SPB-005", code_requirement="ERR-001")
    await _reports(run, mqtt, device)
    run.witnessed(_no_gap(since(before, await mqtt.journal())))
    if not mqtt.subject.claims("recovery"):
        await _buried(run, mqtt, device)
        return
    await mqtt.stop_device()
    value = _a_value(run)
    failed = await mqtt.call_until_failure("device_data", window_s=1.0, device=device, metrics=_data(value))
    run.fails(failed, *CONNECTION_FAULTS, requirement="SPB-005", code_requirement="ERR-005")
    await mqtt.start_device()
    births = await mqtt.call_until_success(
        "device_birth", window_s=mqtt.subject.recovery_s, device=device, metrics=_temperature()
    )
    run.succeeds(births[-1], requirement="REC-001")
    await _reports(run, mqtt, device)
    await _buried(run, mqtt, device)


def _no_gap(entries: Entries) -> list[Finding]:
    """Expect that the edge node's numbers go on by one, or begin anew with an NBIRTH."""
    last: dict[tuple[str, str], int] = {}
    for packet, message in sparkplug(entries):
        node, seq = (message["group"], message["edge_node"]), message["seq"]
        if seq is None:
            continue
        if node in last and message["type"] != "NBIRTH" and seq != (last[node] + 1) % 256:
            text = f"{packet['topic']}: after calls that failed the next number is {(last[node] + 1) % 256}, the message has {seq}"
            return [oracle.broken_rule("SPB-005", text, entries)]
        last[node] = seq
    return []


# -- SPB-006, SPB-008 ---------------------------------------------------------------------------------------

_RECONNECTIONS = 3


@TASKS.check("SPB-006", "Each connection carries the node's death as its will, and bdSeq counts them.", needs=_DEVICES)
async def each_connection_has_a_will(run: Repetition, mqtt: Rig) -> None:
    """In a new session announce a device; then cut the connection and announce it again, three times.

    Said: success.
    Seen: each CONNECT has a will on the topic of NDEATH, with QoS 1, not retained, with bdSeq alone, which is one more each time; the
        NBIRTH of the connection repeats it and has `Node Control/Rebirth` (tck-id-message-flow-edge-node-birth-publish-will-message,
        tck-id-topics-nbirth-bdseq-increment, tck-id-topics-nbirth-bdseq-matching, tck-id-topics-nbirth-rebirth-metric).
    Why: without its will nobody learns that the node is gone, and its last values stay good for ever.
    """
    await mqtt.fresh_session()
    device = _new_device(run)
    await mqtt.prove()
    await _born(run, mqtt, device)
    await until(mqtt, lambda entries: _of(device, sparkplug(entries, "DBIRTH")) != [])
    for _ in range(_RECONNECTIONS):
        await _cut(mqtt)
        reply = await until_it_works(run, mqtt, "device_birth", device=device, metrics=_temperature())
        if not reply.success:
            return
        await _there(mqtt, reply, device, "DBIRTH")
    journal = await mqtt.session_journal()
    born = {packet["connection"] for packet, _ in sparkplug(journal, "NBIRTH")}
    if len(born) <= _RECONNECTIONS:
        message = f"each of {_RECONNECTIONS + 1} connections should have had its NBIRTH, {len(born)} had one"
        run.witnessed([oracle.broken_rule("SPB-006", message, journal)])
    wills = [packet.get("will") for packet in adapter_packets(journal, "CONNECT", "in") if packet["connection"] in born]
    if not all(wills):
        message = (
            f"each CONNECT of the edge node should have carried its NDEATH as will, {wills.count(None)} carried none"
        )
        run.witnessed([oracle.broken_rule("SPB-006", message, journal)])
    await _buried(run, mqtt, device)


@TASKS.check("SPB-008", "A rebirth that a host asks for is carried out.", needs=_DEVICES)
async def a_rebirth_is_carried_out(run: Repetition, mqtt: Rig) -> None:
    """Announce two devices; the kit sends NCMD with `Node Control/Rebirth` while data are reported; then report data again.

    Said: success.
    Seen: over the same connection NBIRTH, with the bdSeq of the connection's will, then DBIRTH of each device that is born, then
        data; no NDEATH (tck-id-operational-behavior-data-commands-rebirth-action-1, -2 and -3).
    Why: a host that has missed something has no other means to learn what there is.
    """
    devices = (_new_device(run), _new_device(run))
    for device in devices:
        await _born(run, mqtt, device)
    first = await _reports(run, mqtt, devices[0])
    node = edge_node_of(since(first, await mqtt.journal()), devices[0])
    if node is None:
        # No data on the wire: that has been found.
        return
    group, name = node
    await mqtt.device.poke(command={"group": group, "edge_node": name, "device": None, "metrics": [_REBIRTH]})
    data = await run.together(
        *(mqtt.call("device_data", device=device, metrics=_data(_a_value(run))) for device in devices)
    )
    for reply in data:
        run.succeeds(reply)
    complete = partial(_reborn, (group, name), devices)
    await until(mqtt, lambda entries: complete(since(first, entries)) is None)
    entries = since(first, await mqtt.journal())
    if (problem := complete(entries)) is not None:
        text = f"spBv1.0/{group}/NCMD/{name}: after the request the node should have been born again, {problem}"
        run.witnessed([oracle.broken_rule("SPB-008", text, entries)])
    for device in devices:
        await _reports(run, mqtt, device)
    await _buried(run, mqtt, *devices)


def _reborn(node: tuple[str, str], devices: Sequence[str], entries: Entries) -> str | None:
    """Return what is missing of a rebirth; None where it is complete."""
    # A host application of the same adapter may command the node as well.
    told = sparkplug(entries, "NBIRTH", "DBIRTH", "NDATA", "DDATA", "NDEATH", "DDEATH")
    mine = [one for one in told if (one[1]["group"], one[1]["edge_node"]) == node]
    births = [index for index, (_, message) in enumerate(mine) if message["type"] == "NBIRTH"]
    if any(message["type"] == "NDEATH" for _, message in mine):
        return "it sent an NDEATH"
    if len({packet["connection"] for packet, _ in mine}) > 1:
        return "it made another connection"
    if not births:
        asked = f"spBv1.0/{node[0]}/NCMD/{node[1]}"
        heard = any(packet["topic"] == asked for packet in adapter_packets(entries, "PUBLISH", "out"))
        return "it sent no NBIRTH" if heard else "it is not subscribed to its commands"
    following = mine[births[0] + 1 :]
    missing = [
        device for device in devices if not _of(device, [one for one in following if one[1]["type"] == "DBIRTH"])
    ]
    return f"it sent no DBIRTH of {missing[0]}" if missing else None


# -- SPB-009, SPB-010 ---------------------------------------------------------------------------------------


@TASKS.check("SPB-009", "Data have only metrics that the birth declared.", needs=_DEVICES)
async def data_have_declared_metrics(run: Repetition, mqtt: Rig) -> None:
    """Report a metric that the device's birth does not have, one whose name differs in case, and a text for a number; then a
    proper value.

    Said: failures with the outcome `not_sent`, or success after a birth that declares the metric; then success.
    Seen: no data with a metric that no birth has declared, or with another type (tck-id-operational-behavior-data-publish-dbirth,
        tck-id-case-sensitivity-metric-names).
    Why: a host drops what it was not told of, and the adapter has said "published".
    """
    device = _new_device(run)
    await _born(run, mqtt, device)
    for name, value in (("pressure", 1.5), ("Temperature", 1.5), ("temperature", "warm")):
        reply = await mqtt.call("device_data", device=device, metrics=[{"name": name, "value": value}])
        if reply.success:
            # The session's oracle compares it with the births.
            await _there(mqtt, reply, device, "DDATA")
            declared = {
                metric["name"]: metric["datatype"]
                for _, message in _of(device, sparkplug(await mqtt.journal(), "DBIRTH"))
                for metric in message["metrics"]
            }
            text = isinstance(value, str)
            if name not in declared or text != (declared[name] == DATA_TYPES.index("String")):
                message = f"{reply.label}: the device was born without {name} of this type, it claims success"
                run.judge(reply, [oracle.broken_rule("SPB-009", message, since(reply, await mqtt.journal()))])
        else:
            await _refused(run, mqtt, reply, "SPB-009", *_REFUSALS)
    await _reports(run, mqtt, device)
    await _buried(run, mqtt, device)


@TASKS.check(
    "SPB-010",
    "A command reaches the node or device that it names, and none passes the guard.",
    needs="mqtt.command",
    guards="mqtt",
)
async def a_command_reaches_its_target(run: Repetition, mqtt: Rig, mqtt_ro: Rig | None) -> None:
    """Command a device of the plant's edge node, and the node itself to be born again; where the adapter tells what it has heard
    of nodes, command a metric that the device does not have, and one with another type. Command groups, nodes and devices whose names are
    several levels, wildcards or nothing. Command once while the broker lets the adapter in no more, and once when it does again. Command
    through the adapter that was started with writes disabled.

    Said: success; failures with the outcome `not_sent`; a failure of the connection; a refusal with `writes_disabled`.
    Seen: one DCMD and one NCMD on the topic of its target, with QoS 0, not retained and without a sequence number; the device has
        done it; nothing of the others, and none that has failed when the adapter is let in again (tck-id-payloads-dcmd-seq,
        tck-id-payloads-ncmd-seq, tck-id-operational-behavior-data-commands-dcmd-metric-name,
        tck-id-topic-structure-namespace-valid-group-id).
    Why: a command is a write: it moves the machine.
    """
    listens = mqtt.subject.claims("sparkplug_nodes") or mqtt.subject.claims("sparkplug_metrics")
    if listens:
        # An adapter may begin to listen when it is first asked, and knows the births since.
        await _heard(run, mqtt)
    if mqtt.subject.claims("send_device_command"):
        await _device_obeys(run, mqtt)
    if mqtt.subject.claims("send_node_command"):
        await _commands(run, mqtt, None, [_REBIRTH])
    if listens and mqtt.subject.claims("send_device_command"):
        setpoint = _setpoint(run)
        for metric in ({**setpoint, "name": "no-such-metric"}, {**setpoint, "datatype": "String", "value": "high"}):
            target = _target(mqtt, "device-1")
            reply = await mqtt.call("send_device_command", **target, metrics=[metric])
            await _refused(run, mqtt, reply, "SPB-010", *_REFUSALS)
    await _names_are_levels(run, mqtt)
    await _is_not_made_up_for(run, mqtt)
    if mqtt_ro is not None:
        await _is_guarded(run, mqtt_ro)


def _setpoint(run: Repetition) -> dict[str, Any]:
    return {"name": "setpoint", "datatype": "Double", "value": _a_value(run)}


async def _device_obeys(run: Repetition, mqtt: Rig) -> None:
    setpoint = _setpoint(run)
    await _commands(run, mqtt, "device-1", [setpoint])
    await mqtt.wait_for(
        kind="PUBLISH", direction="out", topic=f"spBv1.0/{_GROUP}/DDATA/{_NODE}/device-1", timeout_s=0.2
    )
    points = (await mqtt.device.image())["points"]
    held = points.get("edge_node/device-1/setpoint") if isinstance(points, dict) else None
    if held != setpoint["value"]:
        text = f"edge_node/device-1/setpoint should be {setpoint['value']} after the command, it is {held}"
        run.witnessed([Finding(code="device_differs", message=text, requirement="SPB-010")])


async def _names_are_levels(run: Repetition, mqtt: Rig) -> None:
    name = nonce(run)
    for bad in (f"{name}/a", f"{name}+", "#", ""):
        for device in (None, "device-1"):
            operation, inputs = _command(run, mqtt, device)
            for part in ("group", "node", "device") if mqtt.subject.claims(operation) else ():
                if part in inputs:
                    reply = await mqtt.call(operation, **{**inputs, part: bad})
                    await _refused(run, mqtt, reply, "SPB-002", *_REFUSALS)


async def _is_not_made_up_for(run: Repetition, mqtt: Rig) -> None:
    """Command while the broker ends every connection, and expect that nothing of it comes afterwards."""
    if not (mqtt.subject.claims("recovery") and mqtt.subject.reconnects):
        return
    operation, inputs = _command(run, mqtt, "device-1" if mqtt.subject.claims("send_device_command") else None)
    await mqtt.prove()
    connects = len(adapter_packets(await mqtt.journal(), "CONNECT", "in"))
    await mqtt.device.fault({"packet": "CONNECT", "action": {"reset": True}})
    await _cut(mqtt)
    # An adapter that connects again has noticed; others connect when they are called.
    await mqtt.wait_for(kind="CONNECT", direction="in", count=connects + 1, timeout_s=_NOTICED_S)
    failed = await mqtt.call(operation, **inputs)
    run.fails(failed, *CONNECTION_FAULTS, *_REFUSALS, outcome=("not_sent", "unknown"), requirement="SPB-010")
    await mqtt.device.fault()
    again = partial(mqtt.wait_for, kind="SUBACK", direction="out", timeout_s=_LET_IN_S)
    await again(count=1 + len(adapter_packets(await mqtt.journal(), "SUBACK", "out")))
    await mqtt.watch(QUIET_S)
    if mqtt.subject.claims("sparkplug_nodes") or mqtt.subject.claims("sparkplug_metrics"):
        await _heard(run, mqtt)
    operation, further = _command(run, mqtt, inputs.get("device"))
    await until_it_works(run, mqtt, operation, **further)
    if failed.success is False:
        run.witnessed(oracle.never_commanded(since(failed, await mqtt.journal()), inputs))


def _command(run: Repetition, mqtt: Rig, device: str | None) -> tuple[str, dict[str, Any]]:
    """Return the operation that commands the plant's node, or this device of it, and its inputs with a random value."""
    scan_rate = {"name": SCAN_RATE, "datatype": "Int64", "value": run.rng.randrange(1_000, 2**40)}
    metric = scan_rate if device is None else _setpoint(run)
    operation = "send_node_command" if device is None else "send_device_command"
    return operation, {**_target(mqtt, device), "metrics": [metric]}


async def _is_guarded(run: Repetition, guarded: Rig) -> None:
    operation, inputs = _command(run, guarded, "device-1" if guarded.subject.claims("send_device_command") else None)
    reply = await guarded.call(operation, **inputs)
    run.fails(reply, "writes_disabled", outcome="not_sent", requirement="WR-004")
    await guarded.watch(QUIET_S)
    commanded = [packet for packet, _ in _commanding(await guarded.journal())]
    if commanded:
        text = f"with writes disabled nothing should be commanded, the broker saw {describe(commanded[0])}"
        run.witnessed([Finding(code="wrote", message=text, requirement="WR-004")])


def _commanding(entries: Entries) -> Messages:
    """Return the commands of the adapter, without the births that a host asks for by itself."""
    return [one for one in sparkplug(entries, "NCMD", "DCMD") if commands(one[0], {})]


def _target(mqtt: Rig, device: str | None, operation: str = "") -> dict[str, Any]:
    operation = operation or ("send_node_command" if device is None else "send_device_command")
    group = {"group": _GROUP} if mqtt.subject.accepts_input(operation, "group") else {}
    return {"node": _NODE, **group, **({} if device is None else {"device": device})}


async def _commands(run: Repetition, mqtt: Rig, device: str | None, metrics: list[dict[str, Any]]) -> None:
    operation = "send_node_command" if device is None else "send_device_command"
    reply = await mqtt.call(operation, **_target(mqtt, device), metrics=metrics)
    if not run.succeeds(reply):
        return
    await until(mqtt, lambda entries: sparkplug(since(reply, entries), "NCMD", "DCMD") != [])
    run.witnessed(
        oracle.commanded_once(
            since(reply, await mqtt.journal()), group=_GROUP, node=_NODE, device=device, metrics=metrics
        )
    )


# -- SPB-011 ------------------------------------------------------------------------------------------------


@TASKS.check("SPB-011", "What is known of other nodes is told with what has become of them.", needs="mqtt.heard")
async def other_nodes_are_told_as_they_are(run: Repetition, mqtt: Rig) -> None:
    """List the edge nodes, or the metrics of a device, while the plant's node is born, with aliases; when it has reported new values by alias
    alone; when one of its devices has died; when the node has died; when it is born again and the death of its earlier life comes once
    more; and when a sequence number is missing.

    Said: names and values of all metrics, a negative number and one of 64 bits among them; the device, then the node and its
        devices, as not alive; alive again, whatever an older death says; the gap.
    Seen: the plant's edge node, which the kit lets do all this (tck-id-operational-behavior-edge-node-termination-host-action-ndeath-node-tags-stale
        and its like).
    Why: the last value of a node that is dead looks like a measurement.
    """
    lists = mqtt.subject.claims("sparkplug_nodes")
    if lists:
        run.succeeds(await mqtt.call("sparkplug_nodes"))
    special = (
        ("low", "Int32", -5),
        ("large", "UInt64", 2**63),
        ("broken", "Double", "NaN"),
        ("word", "String", nonce(run)),
    )
    await mqtt.device.poke(edge_node={"aliases": True})
    await mqtt.device.poke(edge_node={"metrics": [_plant_metric(*one) for one in special]})
    await _lists(run, mqtt, special, alive=True)
    # Known metrics: the node reports them by their aliases.
    changed = (("low", "Int32", -(10**9)), ("large", "UInt64", 2**62), ("word", "String", nonce(run)))
    await mqtt.device.poke(edge_node={"metrics": [_plant_metric(*one) for one in changed]})
    await _lists(run, mqtt, changed, alive=True)
    await mqtt.device.poke(edge_node={"death": "device-2"})
    await _lists(run, mqtt, (), alive=False, device="device-2", node_alive=True)
    await mqtt.device.poke(edge_node={"offline": True})
    await _lists(run, mqtt, (), alive=False, node_alive=False)
    deaths = await mqtt.wait_for(
        kind="PUBLISH", direction="out", topic=f"spBv1.0/{_GROUP}/NDEATH/{_NODE}", timeout_s=1.0
    )
    await mqtt.device.poke(edge_node={"offline": False})
    await _lists(run, mqtt, changed, alive=True)
    if deaths:
        death = {"topic": f"spBv1.0/{_GROUP}/NDEATH/{_NODE}", "payload": as_mqtt(deaths[-1])["payload"]}
        await mqtt.device.poke(publish=death)
        await _lists(run, mqtt, changed, alive=True)
    if lists:
        await _tells_a_gap(run, mqtt)
    await mqtt.device.poke(edge_node={"aliases": False})


async def _tells_a_gap(run: Repetition, mqtt: Rig) -> None:
    await mqtt.device.poke(edge_node={"skip_seq": 3})
    later = ("low", "Int32", -run.rng.randrange(1, 10**6))
    await mqtt.device.poke(edge_node={"metrics": [_plant_metric(*later)]})
    reply, node = await _told_of_node(run, mqtt, _gap_is_told)
    _is_known(run, reply, node)
    if node is not None and not _gap_is_told(node):
        message = f"{reply.label}: numbers of the sequence are missing, the node is told to be online without a gap"
        run.judge(reply, [Finding(code="wrong_value", message=message, requirement="SPB-011")])


def _gap_is_told(node: Mapping[str, Any]) -> bool:
    return node.get("gap") is True or node.get("status") != "online"


_Right = Callable[[Mapping[str, Any]], bool]


async def _told_of_node(
    run: Repetition, mqtt: Rig, right: _Right, device: str = "device-1"
) -> tuple[Reply, Mapping[str, Any] | None]:
    """Ask what is known of the plant's node; an adapter without an exchange to wait for is asked until it is right, or for a second."""
    exchanges = mqtt.subject.claims("subscribe")
    if exchanges:
        await sync_point(run, mqtt, f"otmcp/{nonce(run)}")
    for look in range(1 if exchanges else _LOOKS):
        if look:
            await mqtt.watch(_LOOK_S)
        if mqtt.subject.claims("sparkplug_nodes"):
            reply = await mqtt.call("sparkplug_nodes")
            nodes = reply.outputs.get("nodes")
            plants = (one for one in nodes if _is_plants(one)) if isinstance(nodes, list) else iter(())
            node = next(plants, None)
        else:
            reply = await mqtt.call("sparkplug_metrics", **_target(mqtt, device, "sparkplug_metrics"))
            node = _node_of(reply, device)
        if node is not None and right(node):
            break
    return reply, node


def _is_plants(node: object) -> bool:
    return isinstance(node, Mapping) and (node.get("group"), node.get("node")) == (_GROUP, _NODE)


def _node_of(reply: Reply, device: str) -> Mapping[str, Any] | None:
    """Return what the metrics of a device tell of its node, as a list of nodes does."""
    if not reply.success:
        return None
    online = reply.outputs.get("online", True)
    one = {"device": device, "online": online, "metrics": reply.outputs.get("metrics")}
    return {"status": "online" if online else "offline", "devices": [one]}


def _is_known(run: Repetition, reply: Reply, node: Mapping[str, Any] | None) -> None:
    """Expect that something was told of the plant's node, which was born."""
    if run.succeeds(reply) and node is None:
        message = f"{reply.label}: {_GROUP}/{_NODE} was born and is not listed"
        evidence = repr(dict(reply.outputs))[:400]
        run.judge(reply, [Finding(code="wrong_value", message=message, requirement="SPB-011", evidence=evidence)])


async def _lists(
    run: Repetition,
    mqtt: Rig,
    metrics: Sequence[tuple[str, str, object]],
    *,
    alive: bool,
    device: str = "device-1",
    node_alive: bool | None = None,
) -> None:
    """Expect that a device of the plant's node is listed so, with these metrics."""
    expected = {"node": alive if node_alive is None else node_alive, device: alive}
    wanted = [{"name": name, "value": value} for name, _, value in metrics]
    if not mqtt.subject.claims("sparkplug_nodes"):
        # Of a device that is dead nothing need be known any more, and of its node nothing is told.
        if not alive and not mqtt.subject.claims("sparkplug_metrics.online"):
            return
        expected = {device: alive}
    reply, node = await _told_of_node(
        run, mqtt, lambda node: not _wrong(node, expected) and _not_told(_listed(node, device), wanted) is None, device
    )
    if not (alive or mqtt.subject.claims("sparkplug_nodes")) and reply.success is False:
        run.fails(reply, *_REFUSALS, requirement="SPB-011", code_requirement="ERR-001")
        return
    _is_known(run, reply, node)
    if node is None:
        return
    evidence = repr(node)[:400]
    if wrong := _wrong(node, expected):
        message = (
            f"{reply.label}: {wrong[0]} should be {'alive' if expected[wrong[0]] else 'dead'}, it is told otherwise"
        )
        run.judge(reply, [Finding(code="wrong_value", message=message, requirement="SPB-011", evidence=evidence)])
    run.judge(reply, _told(reply, _listed(node, device), wanted, "SPB-011"))
    if mqtt.subject.claims("sparkplug_nodes") and mqtt.subject.claims("sparkplug_metrics") and alive:
        # What the list has shown is known.
        told = await mqtt.call("sparkplug_metrics", **_target(mqtt, device, "sparkplug_metrics"))
        if run.succeeds(told):
            run.judge(told, _told(told, _listed(_node_of(told, device) or {}, device), wanted, "SPB-011"))


def _wrong(node: Mapping[str, Any], expected: Mapping[str, bool]) -> list[str]:
    told = {"node": node.get("status") == "online", **dict(_devices(node))}
    return [name for name, wanted in expected.items() if told.get(name, False) is not wanted]


def _listed(node: Mapping[str, Any], device: str) -> object:
    """Return the metrics of a device as a list with names and values."""
    metrics = next((one.get("metrics") for one in node.get("devices") or () if one.get("device") == device), None)
    if not isinstance(metrics, Mapping):
        return metrics
    return [
        {"name": name, "value": one.get("value") if isinstance(one, Mapping) else one} for name, one in metrics.items()
    ]


async def _heard(run: Repetition, mqtt: Rig) -> None:
    """Have the plant's node born again, and wait until the adapter has heard of that."""
    if mqtt.subject.claims("sparkplug_nodes"):
        run.succeeds(await mqtt.call("sparkplug_nodes"))
    await mqtt.device.poke(edge_node={"rebirth": True})
    await _told_of_node(run, mqtt, lambda node: "device-1" in dict(_devices(node)))


def _devices(node: Mapping[str, Any]) -> Iterator[tuple[str, bool]]:
    for one in node.get("devices") or ():
        if isinstance(one, dict):
            yield str(one.get("device")), one.get("online") is True


# -- SPB-012 ------------------------------------------------------------------------------------------------


@TASKS.check("SPB-012", "Who leaves says so.", needs=_DEVICES)
async def who_leaves_says_so(run: Repetition, mqtt: Rig) -> None:
    """Announce two devices and, where the tools are there, declare one dead, then the node; announce one again, and end the session.

    Said: success.
    Seen: DDEATH, NDEATH; when the session ends NDEATH before DISCONNECT, or a connection that ends without DISCONNECT, so that the
        broker publishes the will (tck-id-operational-behavior-edge-node-intentional-disconnect-ndeath,
        tck-id-operational-behavior-device-ddeath).
    Why: a DISCONNECT takes the will back: the node seems to live, and its last values to be good.
    """
    devices = (_new_device(run), _new_device(run))
    for device in devices:
        await _born(run, mqtt, device)
    if mqtt.subject.claims("device_death"):
        reply = await mqtt.call("device_death", device=devices[1])
        run.succeeds(reply)
        if reply.success and not await until(mqtt, lambda entries: _of(devices[1], sparkplug(entries, "DDEATH")) != []):
            run.witnessed(
                [
                    oracle.broken_rule(
                        "SPB-012", f"{reply.label}: the broker saw no DDEATH", await mqtt.journal(), strength="SHOULD"
                    )
                ]
            )
    if mqtt.subject.claims("node_death"):
        reply = await mqtt.call("node_death")
        run.succeeds(reply)
        if reply.success and not await until(mqtt, lambda entries: sparkplug(entries, "NDEATH") != []):
            run.witnessed(
                [
                    oracle.broken_rule(
                        "SPB-012", f"{reply.label}: the broker saw no NDEATH", await mqtt.journal(), strength="SHOULD"
                    )
                ]
            )
        await _born(run, mqtt, devices[0])
    last = await _reports(run, mqtt, devices[0])
    await mqtt.fresh_session()
    run.witnessed(_left_orderly(since(last, await mqtt.journal()), devices[0]))


def _left_orderly(entries: Entries, device: str) -> list[Finding]:
    """Expect that no connection of the edge node ended with DISCONNECT without an NDEATH before."""
    used = {packet["connection"] for packet, _ in _of(device, sparkplug(entries))}
    for packet in adapter_packets(entries, "DISCONNECT", "in"):
        said = [one for one, _ in sparkplug(entries, "NDEATH") if one["connection"] == packet["connection"]]
        if packet["connection"] in used and not any(one["seq"] < packet["seq"] for one in said):
            message = "the edge node should have published NDEATH before its DISCONNECT, it published none"
            return [oracle.broken_rule("SPB-012", message, entries, strength="SHOULD")]
    return []


# -- SPB-013 ------------------------------------------------------------------------------------------------


@TASKS.check("SPB-013", "A host that says that it is there says so on every connection.", needs="mqtt.host")
async def a_host_is_born_on_every_connection(run: Repetition, mqtt: Rig) -> None:
    """Of an adapter that publishes a STATE: end its connection, so that the broker publishes its will; then publish in its name that it is
    not online, as a will of before that comes late.

    Said: anything.
    Seen: on the new connection, and again after the second, STATE with `online` true, QoS 1 and retained; the CONNECT has the opposite as its will,
        with the same timestamp (tck-id-message-flow-phid-sparkplug-state-publish, tck-id-host-topic-phid-birth-payload-timestamp,
        tck-id-message-flow-hid-sparkplug-state-message-delivered).
    Why: edge nodes that wait for their primary host stay silent, or go to another broker, while it says that it is away.
    """
    if not (mqtt.subject.claims("recovery") and mqtt.subject.reconnects):
        run.not_applicable("the adapter is not said to connect again by itself")
    await _is_asked(mqtt)
    await mqtt.watch(QUIET_S)
    topic = (await mqtt.follow(oracle.HostState)).topic
    if topic is None:
        run.not_applicable("the adapter publishes no STATE")
    known = {packet["connection"] for packet in adapter_packets(await mqtt.journal())}
    await _cut(mqtt)
    await mqtt.wait_for(kind="SUBACK", direction="out", timeout_s=_LET_IN_S)
    await _is_asked(mqtt)

    def born_again(entries: Entries) -> bool:
        return any(one["connection"] not in known for one in oracle.state_births(entries, topic))

    if not await until(mqtt, born_again):
        message = f"{topic} should say again that the host is online, as it has a new connection; it does not"
        run.witnessed([oracle.broken_rule("SPB-013", message, await mqtt.journal())])
        return
    births = len(oracle.state_births(await mqtt.journal(), topic))
    death = base64.b64encode(b'{"online": false, "timestamp": 1700000000000}').decode()
    await mqtt.device.poke(publish={"topic": topic, "payload": death, "qos": 1, "retain": True})
    if not await until(mqtt, lambda entries: len(oracle.state_births(entries, topic)) > births):
        message = f"{topic} told that the host is not online, which the host should have put right; it did not"
        run.witnessed([oracle.broken_rule("SPB-013", message, await mqtt.journal())])


async def _is_asked(mqtt: Rig) -> None:
    """Have an adapter connect that does so when it is called; what it answers is the matter of other checks."""
    if mqtt.subject.claims("sparkplug_nodes"):
        await mqtt.call("sparkplug_nodes")
    elif mqtt.subject.claims("sparkplug_metrics"):
        await mqtt.call("sparkplug_metrics", **_target(mqtt, "device-1", "sparkplug_metrics"))
    else:
        await mqtt.prove()
