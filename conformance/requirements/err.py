"""ERR: what an error says, for every way in which a call can fail."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from pytest_otmcp.core.error_registry import WireCode, registry, wire_codes
from pytest_otmcp.core.finding import Finding
from pytest_otmcp.core.strict_json import same_json
from pytest_otmcp.protocols.exercise import Asked
from pytest_otmcp.protocols.journal import Entries
from pytest_otmcp.protocols.mqtt.oracle import refusals
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig

from ..tasks.common import untold
from .mqtt_steps import speaks_mqtt_5
from .provoked import (
    VALIDATION,
    expect_failure,
    met,
    refused_by_the_adapter,
    refused_by_the_device,
    wrongly_asked,
)
from .steps import (
    CONNECTION_FAULTS,
    NOTHING_SENT,
    QUIET_S,
    a_read_works,
    a_write_works,
    answers_again,
    exact_or_refused,
    exercise,
    faulty,
    knows_node,
    nothing_arrived,
    read,
    since,
    write,
)

__all__ = ["TASKS"]

TASKS = Checks()

_TIMES = 3
"""How often the same failure is provoked to compare its codes."""


# -- the codes --------------------------------------------------------------------------------------------------------


@TASKS.every_protocol("ERR-001", "The same failure has the same code, and the code is known.", writes=True)
async def codes_are_stable(run: Repetition, at: Rig) -> None:
    """Three times each: write without any argument, and read while the device refuses it.

    Said: a failure each time, with a code of the registry or one that begins with `x_`, and the same code for the same failure.
    Seen: the refusals of the device.
    Why: whoever reacts to a code cannot react to one that changes with the version of a library.
    """
    await a_read_works(run, at)
    _same_code(run, [reply for _ in range(_TIMES) if (reply := await refused_by_the_adapter(run, at)) is not None])
    _same_code(run, [await refused_by_the_device(run, at) for _ in range(_TIMES)])
    await a_read_works(run, at)


def _same_code(run: Repetition, replies: Iterable[Reply]) -> None:
    failed = [reply for reply in replies if reply.success is False]
    for reply in failed[1:]:
        if reply.error_code != failed[0].error_code:
            message = (
                f"{reply.label}: the error code is {reply.error_code!r}, it was {failed[0].error_code!r} the first time"
            )
            run.judge(reply, [Finding(code="code_differs", message=message, requirement="ERR-001")])
            return


# -- what the protocols say -------------------------------------------------------------------------------------------

_WRITING_FUNCTIONS = (5, 6, 15, 16, 22)
_READING_FUNCTIONS = (3,)
_UNKNOWN_EXCEPTION = 0x7F


@TASKS.check(
    "ERR-002", "Each exception of a Modbus device has its code.", needs="modbus.read_holding modbus.write_holding"
)
async def exceptions_have_their_code(run: Repetition, modbus: Rig) -> None:
    """Read and write a register while the device answers with each exception code, and with one that does not exist; by every further
    operation that reads or writes while it refuses with one of them.

    Said: a failure with the code of the table, whether a repetition makes sense, and the exception in the trace.
    Seen: the exception.
    Why: a busy device, a missing register and a broken one ask for three different things to be done next.
    """
    known = wire_codes("pytest_otmcp.protocols.modbus")
    unknown = WireCode(
        key="127", name="", value=_UNKNOWN_EXCEPTION, codes=("protocol_error",), outcome="unknown", retry="verify"
    )
    for code in (*known.values(), unknown):
        trace = {"exception_code": code.value}
        for functions, step in ((_READING_FUNCTIONS, read), (_WRITING_FUNCTIONS, write)):
            rules = [{"function": function, "action": {"exception": code.value}} for function in functions]
            await _has_code(run, modbus, rules, step, code, trace, "ERR-002")
    code = known["2"]
    refused = [{"action": {"exception": code.value}}]
    for asked in _further(run, modbus):
        await modbus.prove()

        async def step(run: Repetition, at: Rig, asked: Asked = asked) -> tuple[Asked, Reply]:
            return asked, await at.call(asked.operation, **asked.inputs)

        is_read = not protocols()["modbus"].operations[asked.operation].writes
        trace = {"exception_code": code.value}
        await _has_code(run, modbus, refused, step, code, trace, "ERR-002", is_read=is_read)
    await a_read_works(run, modbus)
    await a_write_works(run, modbus)


def _further(run: Repetition, modbus: Rig) -> list[Asked]:
    """Return a read or a write by each operation but those of the exercise, as far as the subject has them."""
    asks = exercise(modbus)
    assert asks.every_write is not None
    reads = [Asked(operation=name, inputs={"address": 4, "count": 3}) for name in _FURTHER_READS]
    every = [*reads, *(asked for asked in asks.every_write(run.rng) if asked.operation != asks.writing)]
    return [
        asked
        for asked in every
        if modbus.subject.claims(asked.operation) and modbus.can_ask(asked.operation, asked.inputs)
    ]


_FURTHER_READS = ("read_input", "read_coils", "read_discrete_inputs")

_OF_ITEMS = """
    BadNodeIdInvalid BadNodeIdUnknown BadAttributeIdInvalid BadIndexRangeInvalid BadIndexRangeNoData BadNotSupported BadUserAccessDenied
    BadOutOfRange BadResourceUnavailable BadNoCommunication BadNotConnected BadOutOfService BadDeviceFailure BadInternalError
    BadUnexpectedError BadCommunicationError BadTimeout BadInvalidState
""".split()
"""Status codes that a server gives an item, read or written."""

_OF_READ_ITEMS = ["BadNotReadable", "BadWaitingForInitialData", "BadSensorFailure"]
_OF_WRITTEN_ITEMS = ["BadTypeMismatch", "BadNotWritable", "BadWriteNotSupported"]
_OF_SERVICES = """
    BadServiceUnsupported BadTooManyOperations BadNothingToDo BadRequestTooLarge BadResponseTooLarge BadUserAccessDenied BadInternalError
    BadUnexpectedError BadResourceUnavailable BadTimeout BadDecodingError BadSessionIdInvalid BadSessionClosed BadShutdown
""".split()
"""Status codes with which a server refuses a whole service call."""


@TASKS.check("ERR-003", "Each status code of an OPC UA server has its code.", needs="opcua.read opcua.write")
async def status_codes_have_their_code(run: Repetition, opcua: Rig) -> None:
    """Read and write a variable while the server answers with each status code, for the item and as a fault of the service.

    Said: a failure with the code of the table, and the status code in the trace.
    Seen: the status code.
    Why: a variable that may not be written, one of another type and one that is gone ask for three different things to be done next.
    """
    known = wire_codes("pytest_otmcp.protocols.opcua")
    for service, step, own in (("Read", read, _OF_READ_ITEMS), ("Write", write, _OF_WRITTEN_ITEMS)):
        for action, symbols in (("status", [*_OF_ITEMS, *own]), ("service_fault", _OF_SERVICES)):
            for symbol in symbols:
                code = known.get(symbol) or WireCode(
                    key=symbol, name=symbol, value=None, codes=("device_failure",), outcome="unknown", retry="verify"
                )
                rules = [{"service": service, "action": {action: symbol}}]
                trace = {} if code.value is None else {"status_code": {"value": code.value}}
                await _has_code(run, opcua, rules, step, code, trace, "ERR-003")
    await answers_again(run, opcua)
    await a_write_works(run, opcua)


async def _has_code(
    run: Repetition,
    at: Rig,
    rules: list[dict[str, Any]],
    step: Any,
    code: WireCode,
    trace: Mapping[str, object],
    requirement: str,
    *,
    told: Callable[[Entries], Sequence[object]] | None = None,
    is_read: bool | None = None,
) -> None:
    """Read or write while the device answers by these rules, and expect the code that belongs to the answer.

    Args:
        told: finds the answers that refuse in what the device saw, where not each request has an answer.
        is_read: the step reads; None where the step tells.
    """
    await at.device.fault(*rules)
    _, reply = await step(run, at)
    await at.device.fault()
    if not await met(at, reply) or (told is not None and not told(reply.during(await at.journal()))):
        # An adapter may get at its data in another way, which the device did not refuse.
        return
    reads = step is read if is_read is None else is_read
    outcome = ("not_applicable",) if reads else (code.outcome or "rejected", "unknown")
    run.fails(reply, *code.codes, outcome=outcome, trace=trace, requirement=requirement)


_SUBACK_REFUSAL = 0x80
_SHUTTING_DOWN = 0x8B
_CONNACK_5 = (132, 133, 134, 135, 136, 137, 138, 140, 151, 156, 157, 159)
_SUBACK_5 = (135, 143, 151, 158, 162)
_PUBACK_5 = (128, 131, 135, 144, 151, 153)


@TASKS.check("ERR-004", "Each refusal of a broker has its code.", needs="mqtt.subscribe mqtt.publish")
async def refusals_have_their_code(run: Repetition, mqtt: Rig) -> None:
    """Subscribe while the broker refuses the filter, with each reason that the version of MQTT has, and in MQTT 5 publish while it refuses the
    message, with each; then, for each reason to refuse a client, have the broker end the connection and refuse the next ones with it, and subscribe.

    Said: a failure with the code of the table, and the reason in the trace; success when the broker takes the client again.
    Seen: the refusal.
    Why: who has a wrong password has to do something else than who is asked to come back later.
    """
    await a_read_works(run, mqtt)
    # The version is in the CONNECT of the connection that is made now.
    await mqtt.device.poke(disconnect={"client_id": None, "reason_code": _SHUTTING_DOWN})
    await answers_again(run, mqtt)
    modern = speaks_mqtt_5(await mqtt.journal())
    known = wire_codes("pytest_otmcp.protocols.mqtt")
    refused = WireCode(
        key="128", name="Failure", value=_SUBACK_REFUSAL, codes=("access_denied",), outcome="rejected", retry="no"
    )
    for code in [known[str(number)] for number in _SUBACK_5] if modern else [refused]:
        rules = [{"packet": "SUBSCRIBE", "action": {"reason_code": code.value}}]
        await _has_code(run, mqtt, rules, read, code, {"reason_code": code.value}, "ERR-004")
    for code in [known[str(number)] for number in _PUBACK_5] if modern else []:
        rules = [{"packet": "PUBLISH", "action": {"reason_code": code.value}}]
        await _has_code(run, mqtt, rules, write, code, {"reason_code": code.value}, "ERR-004", told=refusals)
    await a_read_works(run, mqtt)
    if mqtt.subject.claims("recovery") and mqtt.subject.reconnects:
        table = [known[str(number)] for number in _CONNACK_5] if modern else _connack()
        for code in table:
            await _refused_client(run, mqtt, code)
    await a_write_works(run, mqtt)


def _connack() -> list[WireCode]:
    return list(wire_codes("pytest_otmcp.protocols.mqtt", table="connack").values())


async def _refused_client(run: Repetition, mqtt: Rig, code: WireCode) -> None:
    await mqtt.device.fault({"packet": "CONNECT", "action": {"reason_code": code.value}})
    await mqtt.device.poke(disconnect={"client_id": None, "reason_code": _SHUTTING_DOWN})
    _, reply = await read(run, mqtt)
    await mqtt.device.fault()
    told = [entry for entry in reply.during(await mqtt.journal()) if entry["kind"] == "CONNACK"]
    # An adapter that waits before it connects again was not refused during this call.
    codes = code.codes if told else tuple(dict.fromkeys((*code.codes, "connect_failed", "connection_lost")))
    run.fails(reply, *codes, requirement="ERR-004")
    await answers_again(run, mqtt)


# -- the connection ---------------------------------------------------------------------------------------------------


@TASKS.every_protocol("ERR-005", "A refused, a reset and a silent connection are told apart.", writes=True)
async def connections_fail_in_three_ways(run: Repetition, at: Rig) -> None:
    """Write while the device resets the connection; read while a connection that asks for a value dies without an end; read while nobody
    listens.

    Said: `connection_lost`; `timeout`; `connect_failed`: not one code for all three. Each time a read works afterwards.
    Seen: the reset; the read.
    Why: whether a request may have left decides whether it may be repeated.
    """
    if not protocols()[at.protocol].has_connections:
        run.not_applicable("datagrams have no connection that is refused or reset: silence is all that there is")
    await a_read_works(run, at)
    codes: list[str | None] = []
    await at.device.fault(*({**rule, "times": 1} for rule in exercise(at).reset))
    asked, reset = await write(run, at)
    await at.device.fault()
    if not reset.success:
        # Where something else of the adapter's was reset, the write need not have left.
        if reset.error_code == "connect_failed" and not exercise(at).done(since(reset, await at.journal()), asked):
            run.fails(reset, "connect_failed", outcome=("unknown", *NOTHING_SENT), requirement="ERR-005")
        else:
            # Some find out only when their time is over.
            run.fails(reset, "connection_lost", "timeout", outcome="unknown", requirement="ERR-005")
        codes.append(reset.error_code)
    await answers_again(run, at)
    # Each request is in the journal before its connection dies: nothing that the adapter has said is unknown to the device.
    await at.device.fault(*faulty(exercise(at).reads, half_open=True))
    _, silent = await read(run, at)
    await at.device.fault()
    # Whoever makes a connection for the call may not get as far as its request.
    made = any(entry["kind"] == "CONNECTED" for entry in silent.during(await at.journal()))
    run.fails(silent, "timeout", "connection_lost", *(["connect_failed"] if made else []), requirement="ERR-005")
    codes.append(silent.error_code)
    await answers_again(run, at)
    if at.subject.reconnects:
        codes.append(await _refused_connection(run, at))
    known = [code for code in codes if code in registry()]
    if len(known) == _TIMES and len(set(known)) == 1:
        message = f"{at.protocol}: a reset, a silent and a refused connection all have the error code {known[0]!r}"
        run.finding("codes_alike", message, requirement="ERR-005")


async def _refused_connection(run: Repetition, at: Rig) -> str | None:
    asked = exercise(at).read(run.rng)
    await at.stop_device()
    noticed = await at.call_until_failure(asked.operation, window_s=1.0, **asked.inputs)
    run.fails(noticed, *CONNECTION_FAULTS, requirement="ERR-005")
    # Whoever knows that the connection is gone makes a new one, which is refused; who needs a new session for that makes none.
    known = ["connect_failed"] if at.subject.claims("recovery") else ["connect_failed", "connection_lost"]
    refused = await at.call(asked.operation, **asked.inputs)
    run.fails(refused, *known, requirement="ERR-005")
    await at.start_device()
    await answers_again(run, at)
    return refused.error_code


# -- what may have happened -------------------------------------------------------------------------------------------


@TASKS.every_protocol("ERR-006", "What is said not to be sent never arrives.", writes=True, guard=True, status=True)
async def outcomes_are_true(run: Repetition, at: Rig, guarded: Rig) -> None:
    """Write without any argument, and through the write guard; write while the device does what it is asked and
    then resets the connection; write while the device is down, and start it. After each the device is watched.

    Said: a failure each time; the outcome `not_sent` for the first two, `unknown` or `applied` for the third if it has reached the device,
        `not_sent` or `unknown` for the fourth.
    Seen: no request that changes the plant but that of the third.
    Why: a write that was reported as failed and is delivered later moves a valve when nobody expects it.
    """
    await a_read_works(run, guarded)
    _, denied = await write(run, guarded)
    run.fails(denied, "writes_disabled", outcome="not_sent", requirement="WR-004")
    refused = await wrongly_asked(run, at)
    if refused is not None:
        run.fails(refused, *VALIDATION, outcome=NOTHING_SENT, requirement="MCP-007", code_requirement="ERR-001")
    await guarded.watch(QUIET_S)
    for rig, reply, otherwise in ((guarded, denied, "WR-004"), (at, refused, "WR-010")):
        if reply is not None:
            run.witnessed(_not_arrived(rig, reply, _since(await rig.journal(), reply), otherwise))
    await at.device.fault(*({**rule, "times": 1} for rule in exercise(at).reset))
    asked, lost = await write(run, at)
    await at.device.fault()
    if not lost.success:
        # What an adapter tells the device of itself may have met the fault first, and the write never left.
        arrived = exercise(at).done(_since(await at.journal(), lost), asked)
        outcome = ("unknown", "applied") if arrived else ("unknown", "not_sent")
        run.fails(lost, *CONNECTION_FAULTS, outcome=outcome, requirement="ERR-005")
    await answers_again(run, at)
    await _away(run, at)
    await a_write_works(run, at)


async def _away(run: Repetition, at: Rig) -> None:
    if not at.subject.reconnects:
        return
    await at.prove()
    await at.stop_device()
    _, away = await write(run, at)
    own = protocols()[at.protocol].operations[exercise(at).writing].requirement
    run.fails(away, *CONNECTION_FAULTS, outcome=("not_sent", "unknown"), requirement=own, code_requirement="ERR-005")
    await at.start_device()
    await answers_again(run, at)
    await at.watch(QUIET_S)
    run.witnessed(_not_arrived(at, away, _since(await at.journal(), away), "WR-010"))


def _not_arrived(at: Rig, reply: Reply, entries: Entries, otherwise: str) -> list[Finding]:
    """Expect that nothing of a write that failed commands the plant; of one that claims success that claim is the fault.

    Args:
        otherwise: id of the requirement that it breaks where the adapter did not say that nothing was sent.
    """
    if reply.success is not False:
        return []
    return nothing_arrived(at, entries, requirement=untold(reply, otherwise))


def _since(entries: Iterable[Any], reply: Reply) -> list[Any]:
    return [entry for entry in entries if entry["t_ns"] >= reply.exchange.sent_ns]


@TASKS.every_protocol(
    "ERR-007", "What is invalid is invalid, whether or not the device is there.", writes=True, status=True
)
async def validation_comes_first(run: Repetition, at: Rig) -> None:
    """Write without any argument; the same while the device is down.

    Said: the same code both times.
    Seen: no request on account of the invalid calls.
    Why: an assistant that is told of the connection repeats what can never work.
    """
    await a_read_works(run, at)
    there = await wrongly_asked(run, at)
    if there is None:
        run.not_applicable(f"a call that performs {exercise(at).writing} has no argument that it cannot do without")
    run.fails(there, *VALIDATION, outcome=NOTHING_SENT, requirement="ERR-007")
    if at.subject.reconnects:
        await at.prove()
        await at.stop_device()
        gone = await wrongly_asked(run, at)
        await at.start_device()
        if gone is not None and there.success is False:
            _is_as_invalid(run, gone, there)
        await answers_again(run, at)


def _is_as_invalid(run: Repetition, gone: Reply, there: Reply) -> None:
    if there.unclassified and gone.success is False and not gone.unclassified:
        # What the adapter calls it with the device there is in no code.
        problem = f"without the device the same call is {gone.error_code!r}, with it the failure has other words"
        finding = Finding(code="code_differs", message=f"{gone.label}: {problem}", requirement="ERR-007")
        run.judge(gone, [finding])
        return
    run.fails(gone, str(there.error_code), outcome=NOTHING_SENT, requirement="ERR-007")


# -- several items ----------------------------------------------------------------------------------------------------

_NODES = ("ns=2;s=Temperature", "ns=2;s=Pressure")


@TASKS.check(
    "ERR-008", "Of several items each has its own status.", needs="opcua.read_many", keys="opcua.probes.missing_node"
)
async def items_fail_alone(run: Repetition, opcua: Rig) -> None:
    """Read two variables; one of them twice; both with a node between them that does not exist; two nodes of which neither exists; sixty
    variables; then the two while one of them has a bad status.

    Said: the values in the order asked for; then a failure with `partial_failure` and the two values below `data.partial`, or with
        the code of the missing node where nothing was read; then a failure; all sixty values, or that these are too many; then a failure, or
        null in the place of the bad value. Nowhere is the text of an error, or an earlier value, in the place of a value.
    Seen: the reads.
    Why: "Error: …" in a list of temperatures is a temperature to whoever goes through the list.
    """
    values = [round(run.rng.uniform(0.0, 100.0), 6) for _ in _NODES]
    for node, value in zip(_NODES, values, strict=True):
        await opcua.device.poke(node=node.rpartition("=")[2], value=value)
    run.succeeds(await opcua.call("read_many", nodes=list(_NODES)), values=values)
    twice = await opcua.call("read_many", nodes=[_NODES[0], _NODES[0], _NODES[1]])
    run.succeeds(twice, requirement="ERR-008", values=[values[0], *values])
    missing = opcua.subject.probe("missing_node")
    mixed = await opcua.call("read_many", nodes=[_NODES[0], missing, _NODES[1]])
    # Who looks at the nodes before reading any may refuse the whole.
    run.fails(mixed, "partial_failure", "illegal_address", "invalid_input", requirement="ERR-008")
    if opcua.subject.native and mixed.error_code == "partial_failure":
        partial = mixed.member("data", "partial")
        lost = [value for value in values if not _holds(partial, value)]
        if lost:
            message = f"{mixed.label}: data.partial should hold the values that could be read, it lacks {lost}"
            run.judge(mixed, [Finding(code="wrong_value", message=message, requirement="ERR-008")])
    neither = await opcua.call("read_many", nodes=[missing, missing])
    expect_failure(run, neither, requirement="ERR-008")
    await _many_at_once(run, opcua)
    await _a_bad_one_among_them(run, opcua, values)


_BATCH = 60
"""Variables of a call, more than a client puts into one request that keeps to the usual limits of servers."""


async def _many_at_once(run: Repetition, opcua: Rig) -> None:
    numbers = run.rng.sample(range(10**6), _BATCH)
    names = [f"Batch.{number}" for number in numbers]
    made = [
        {"variable": name, "type": "Double", "value": number / 8} for name, number in zip(names, numbers, strict=True)
    ]
    await opcua.device.poke(create=made)
    nodes = [f"ns=2;s={name}" for name in names]
    if not await knows_node(run, opcua, nodes[0]):
        return
    reply = await opcua.call("read_many", nodes=nodes)
    too_many = ("limit_exceeded", "invalid_input", "rate_limited")
    exact_or_refused(run, reply, *too_many, requirement="ERR-008", values=[number / 8 for number in numbers])


async def _a_bad_one_among_them(run: Repetition, opcua: Rig, before: Sequence[float]) -> None:
    """Read two variables of which the first has a bad status, and was read before."""
    bad, good = before[0] + 1, before[1]
    await opcua.device.poke(node="Temperature", value=bad, status="BadSensorFailure")
    reply = await opcua.call("read_many", nodes=list(_NODES))
    told = reply.outputs.get("values")
    if not (reply.success and same_json(told, [None, good])):
        run.fails(reply, "partial_failure", "bad_quality", "device_failure", requirement="ERR-008")
    await opcua.device.poke(node="Temperature", value=bad, status="Good")
    run.succeeds(await opcua.call("read_many", nodes=list(_NODES)), requirement="ERR-008", values=[bad, good])


def _holds(found: object, value: float) -> bool:
    if isinstance(found, Mapping):
        return any(_holds(member, value) for member in found.values())
    if isinstance(found, list):
        return any(_holds(member, value) for member in found)
    return isinstance(found, float | int) and not isinstance(found, bool) and found == value
