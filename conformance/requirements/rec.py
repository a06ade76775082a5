"""REC: outages and return."""

from __future__ import annotations

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.journal import Image
from pytest_otmcp.protocols.mqtt import oracle as mqtt_oracle
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig

from ..tasks.common import NOTICING_S, each_fails, each_write
from ..tasks.messages import publish_from_kit, subscribe
from .steps import CONNECTION_FAULTS, a_read_works, answers_again, exercise, faulty, read, vanishing

__all__ = ["TASKS"]

TASKS = Checks()

_OUTAGES = {False: 2, True: 20}
"""Outages in the short and in the long form."""

_CALLS = {False: 5, True: 50}

_SECOND_BYTE, _LAST_BYTES = 1, 3
_MANGLED = (
    # The first bytes are those by which a receiver finds the end of a message: type, length, protocol identifier.
    {"flip": [[0, 0xFF], [_SECOND_BYTE, 0xFF]], "end": True},
    {"flip": [[2, 0x5A], [3, 0xA5], [4, 0x7F], [5, 0xFF]], "end": True},
    {"cut": _LAST_BYTES, "end": True},
    {"append": "ff" * 300, "end": True},
    {"flip": [[place, 0xFF] for place in range(8)], "append": "00" * 70},
)
"""What becomes of an answer: noise, a length that cannot be, half a message, a message with more behind it; then noise on a
connection that stays."""

_DELIVERED_S = 2.0


@TASKS.every_protocol("REC-001", "After the device is back the same session works again.", facets="recovery")
async def the_same_session_recovers(run: Repetition, at: Rig) -> None:
    """Read; stop the device, read until that fails, start it with other contents, read until that succeeds, and once more; all of
    it several times.

    Said: the device's own value before and after each outage, within the time that the subject declares, in the same session.
    Seen: the reads.
    Why: an outage must not need a person who restarts the adapter, and after it nobody may be shown what was before.
    """
    await a_read_works(run, at)
    for _ in range(_OUTAGES[run.soak]):
        await at.stop_device()
        asked = exercise(at).read(run.rng)
        await at.call(asked.operation, role="control", **asked.inputs)
        await at.start_device()
        await answers_again(run, at)
        await a_read_works(run, at, requirement="REC-001")


@TASKS.every_protocol("REC-002", "While the device is away every call fails.", facets="recovery")
async def calls_fail_during_an_outage(run: Repetition, at: Rig) -> None:
    """Read, and ask for the status; stop the device and do the same several times, and write by every operation that writes; start the
    device and read.

    Said: success; failures with `connect_failed`, `connection_lost` or `timeout`, of a status at the latest when it may no longer be a
        remembered one; then success.
    Seen: nothing, it is away.
    Why: a value of before the outage that looks like one of now hides the outage from whoever has to act.
    """
    await a_read_works(run, at)
    operations = protocols()[at.protocol].operations
    statuses = [name for name, operation in operations.items() if operation.status and at.subject.claims(name)]
    for status in statuses:
        run.succeeds(await at.call(status))
    writes = each_write(run, at)
    if writes:
        await at.prove()
    await at.stop_device()
    for _ in range(_CALLS[run.soak]):
        asked = exercise(at).read(run.rng)
        reply = await at.call(asked.operation, **asked.inputs)
        run.fails(reply, *CONNECTION_FAULTS, requirement="REC-002", code_requirement="ERR-005")
    for status in statuses:
        window_s = max(NOTICING_S, at.subject.max_age_s(status) or 0.0)
        noticed = await at.call_until_failure(status, window_s=window_s)
        run.fails(noticed, *CONNECTION_FAULTS, requirement="REC-002", code_requirement="ERR-005")
    await each_fails(run, at, writes, code_requirement="ERR-005")
    await at.start_device()
    await answers_again(run, at)


@TASKS.every_protocol("REC-003", "A connection whose other end has vanished is found to be dead.", facets="recovery")
async def a_vanished_peer_is_noticed(run: Repetition, at: Rig) -> None:
    """Read; from this request on the connection is dead in both directions, without an end. Read again.

    Said: a failure within the deadline, or success where the adapter has asked again; then success within the recovery time.
    Seen: the read on a new connection; the old one stays dead.
    Why: after a pulled cable nobody says goodbye; who waits for that shows a plant that stands still.
    """
    await a_read_works(run, at)
    await at.device.fault(*({**rule, "times": 1} for rule in faulty(exercise(at).reads, **vanishing(at))))
    asked, lost = await read(run, at)
    if lost.success:
        run.succeeds(lost, requirement="REC-003", **asked.outputs)
    else:
        run.fails(lost, *CONNECTION_FAULTS, requirement="REC-003", code_requirement="ERR-005")
    await at.device.fault()
    await answers_again(run, at, requirement="REC-003")


@TASKS.check("REC-004", "A subscription that is reported as active is active.", needs="mqtt.subscribe mqtt.recovery")
async def subscriptions_return(run: Repetition, mqtt: Rig) -> None:
    """Subscribe; stop and start the broker, which has forgotten everything, and publish on the topic when the adapter works
    again. Do the same after the broker has ended the connection.

    Said: success; an adapter that lists its subscriptions may list this one as inactive, or not at all.
    Seen: the subscription and the message that the broker sends to the adapter, with no lower QoS than before the outage.
    Why: an alarm that is subscribed to and never comes is worse than none.
    """
    topic = f"otmcp/alarm/{run.rng.getrandbits(32):08x}"
    takes_qos = mqtt.subject.accepts_input("subscribe", "qos")
    qos = int(takes_qos and mqtt.excess("subscribe", filter=topic, qos=1) is None)
    run.must_succeed(await subscribe(mqtt, topic, qos=qos))
    before = await _still_heard(run, mqtt, topic)
    await mqtt.stop_device()
    await mqtt.start_device()
    await answers_again(run, mqtt)
    await _still_heard(run, mqtt, topic, before)
    await mqtt.device.poke(disconnect={"client_id": None, "reason_code": 139})
    await answers_again(run, mqtt)
    await _still_heard(run, mqtt, topic, before)


async def _still_heard(run: Repetition, mqtt: Rig, topic: str, before: int = 0) -> int:
    """Publish on a topic, and expect that the adapter is sent it with at least this QoS; return the QoS."""
    await mqtt.wait_for(kind="SUBACK", direction="out", timeout_s=mqtt.subject.recovery_s)
    nonce = f"alarm-{run.rng.getrandbits(64):016x}".encode()
    await publish_from_kit(mqtt, topic, nonce, qos=1)
    await mqtt.wait_for(kind="PUBLISH", direction="out", topic=topic, timeout_s=_DELIVERED_S)
    journal = await mqtt.journal()
    lost = mqtt_oracle.subscription_lost(journal, topic=topic, payload=nonce, qos=before)
    if lost and await _is_listed(mqtt, topic):
        run.witnessed(lost)
    return mqtt_oracle.delivered_qos(journal, topic=topic, payload=nonce) or 0


async def _is_listed(mqtt: Rig, topic: str) -> bool:
    """Tell whether the adapter says that a subscription is active; one that says nothing of it leaves it at its first word."""
    if not mqtt.subject.claims("subscriptions"):
        return True
    reply = await mqtt.call("subscriptions")
    listed, active = reply.outputs.get("filters"), reply.outputs.get("active")
    if not isinstance(listed, list) or topic not in listed:
        return False
    states = active if isinstance(active, list) else []
    return len(states) != len(listed) or states[listed.index(topic)] is not False


@TASKS.every_protocol("REC-005", "What is no message of the protocol does no harm to the next call.", facets="recovery")
async def noise_is_recovered_from(run: Repetition, at: Rig) -> None:
    """Read while the answer becomes noise, has an impossible length, is cut off or is followed by noise, each in its turn; read
    after each of them without a fault.

    Said: whatever can be said of such an answer; then the value that the device holds.
    Seen: the reads.
    Why: who has lost the beginning of a message reads every later one wrongly, and shows plausible values.
    """
    await a_read_works(run, at)
    for mangle in _MANGLED:
        await at.device.fault(*faulty(exercise(at).reads, mangle=mangle))
        await read(run, at)
        await at.device.fault()
        await answers_again(run, at, requirement="REC-005")
        await a_read_works(run, at, requirement="REC-005")


# -- REC-006 ------------------------------------------------------------------------------------------------

_TEMPERATURE = "ns=2;s=Temperature"
_LOSSES, _CLOSED = 20, 6
"""The number of losses, and how many of them, at first, are sessions that the server closes; that closes those left behind as well."""
_IN_PASSING = 2
"""Sessions that an adapter may still be closing while it has opened another one."""


@TASKS.check(
    "REC-006",
    "A session that the server has closed is made anew, and none is left behind.",
    needs="opcua.read opcua.recovery",
)
async def lost_sessions_are_made_anew(run: Repetition, opcua: Rig) -> None:
    """Read twenty times, each time after a loss: the server has closed the session, answers that it does not know the secure channel, or
    ends the connection. Read after it was restarted.

    Said: success within the time to come back, each time in the same session of the assistant.
    Seen: the server has no more sessions in the end than in the beginning.
    Why: a server has few sessions; an adapter that leaves one behind at every loss locks out the operators' own screens.
    """
    if not opcua.subject.reconnects:
        run.not_applicable("the adapter is not said to connect again by itself")
    last = await opcua.call("read", node=_TEMPERATURE)
    run.must_succeed(last)
    before = _sessions(await opcua.device.image())
    for loss in range(_LOSSES):
        if loss < _CLOSED:
            await opcua.device.poke(sessions="closed")
        else:
            action = {"service_fault": "BadSecureChannelIdInvalid"} if loss % 2 else {"close": True}
            await opcua.device.fault({"service": "Read", "times": 1, "action": action})
        last = await _answered_again(run, opcua, last)
        if not last.success:
            return
    run.witnessed(_none_left_behind(before, _sessions(await opcua.device.image()), f"{_LOSSES} losses"))
    await opcua.stop_device()
    await opcua.start_device()
    await _answered_again(run, opcua, last)
    run.witnessed(_none_left_behind(before, _sessions(await opcua.device.image()), "a restart"))


async def _answered_again(run: Repetition, opcua: Rig, last: Reply) -> Reply:
    """Read until it succeeds, at most for as long as the subject declares after the last answer; return the reply."""
    since_accepting_s = ((last.exchange.received_ns or 0) - opcua.device.accepting_ns) / 1e9 / run.time_scale
    window_s = max(0.0, since_accepting_s) + opcua.subject.recovery_s
    replies = await opcua.call_until_success("read", window_s=window_s, node=_TEMPERATURE)
    run.succeeds(replies[-1], requirement="REC-006")
    return replies[-1]


def _sessions(image: Image) -> int:
    return int(image["clients"]["sessions"])


def _none_left_behind(before: int, after: int, what: str) -> list[Finding]:
    if after <= before + _IN_PASSING:
        return []
    message = f"after {what} the adapter should have the sessions of the beginning, {before}; the server has {after}"
    return [Finding(code="connections_left", message=message, requirement="REC-006")]
