"""ENV: the envelope that every result is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.journal import JournalEntry
from pytest_otmcp.trial.alteration import Alteration
from pytest_otmcp.trial.call_windows import from_adapter
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig

from .provoked import (
    broken,
    every_kind,
    expect_failure,
    met,
    needs_envelopes,
    refused_by_the_adapter,
    refused_by_the_device,
)
from .steps import (
    CONNECTION_FAULTS,
    a_read_works,
    a_write_works,
    answers_again,
    exercise,
    polls,
    read,
    reads_soon,
    write,
)

__all__ = ["TASKS"]

TASKS = Checks()

_DELAYS_S = (0.1, 0.4)
_AWKWARD = 'a"b\\c\u2028d\x00e\nf\u202eg'
"""Characters that end a string, a line or a text where JSON is made by hand."""

_SPECIAL = ("NaN", "Infinity", "-Infinity", "-0.0")
_FLOATS = {"NaN": [0x7FC0, 0], "Infinity": [0x7F80, 0], "-Infinity": [0xFF80, 0], "-0.0": [0x8000, 0]}
_FLOAT_AT = 22


# -- the shape --------------------------------------------------------------------------------------------------------


@TASKS.every_protocol("ENV-001", "Every result is an envelope.", writes=True, prompt=True)
async def every_result_is_an_envelope(run: Repetition, at: Rig) -> None:
    """Read, write, have a call refused by the adapter, by the device and by a connection that breaks.

    Said: `{success, data, error, meta}` each time, with the declared types and nothing else.
    Seen: what each call asks for.
    Why: what an assistant has to look for in another place each time it will not find.
    """
    needs_envelopes(run, at)
    await every_kind(run, at)


@TASKS.every_protocol("ENV-002", "Success and error exclude each other.", writes=True, guard=True, prompt=True)
async def success_or_error(run: Repetition, at: Rig, guarded: Rig) -> None:
    """Read, write, have a call refused by the adapter, by the device, by a connection that breaks, and by the write guard.

    Said: success without an error, or an error without data, and never both or neither.
    Seen: what each call asks for; nothing of the write through the guard.
    Why: an answer that is both is read as what the reader hoped for.
    """
    needs_envelopes(run, at)
    await every_kind(run, at)
    await a_read_works(run, guarded)
    _, denied = await write(run, guarded)
    run.fails(denied, "writes_disabled", outcome="not_sent", requirement="WR-004")


@TASKS.every_protocol("ENV-003", "Every answer is strict JSON, whatever the device or the assistant says.", prompt=True)
async def answers_are_strict_json(run: Repetition, at: Rig) -> None:
    """Read with quotation marks, line separators and control characters in an argument; then, where it is claimed, read values that
    JSON does not have: NaN, both infinities, minus zero.

    Said: whatever fits, as JSON that a strict parser takes: no NaN, no line break within the frame.
    Seen: the special values, which the device really holds.
    Why: a parser that stops at one answer loses the session with it.
    """
    asked = exercise(at).read(run.rng)
    arguments = at.arguments_of(asked.operation, **asked.inputs)
    if arguments:
        for name in sorted(arguments.values()):
            altered = Alteration(given={name: f"{run.rng.getrandbits(16):04x}{_AWKWARD}"})
            expect_failure(run, await at.call_altered(asked.operation, altered, **asked.inputs), requirement="MCP-007")
    await reads_soon(run, at, exercise(at).read(run.rng), requirement="MCP-007")
    await _read_specials(run, at)


async def _read_specials(run: Repetition, at: Rig) -> None:
    # How such a value is told is a matter of ENC-004; here it only has to be JSON.
    if at.protocol == "opcua":
        for value in _SPECIAL:
            await at.device.poke(node="Temperature", value=value)
            await at.call("read", node="ns=2;s=Temperature")
        await at.device.poke(node="Temperature", value=20.0)
    elif at.protocol == "modbus":
        asked: dict[str, Any] = {"address": _FLOAT_AT, "type": "float32"}
        if not at.can_ask("read_typed", asked):
            return
        for registers in _FLOATS.values():
            await at.device.poke(unit=1, table="holding_registers", address=_FLOAT_AT, values=registers)
            await at.call("read_typed", **asked)
    elif at.can_ask("messages", {"filter": "otmcp/#"}) and not at.subject.blocks("messages"):
        filter_ = f"otmcp/strict/{run.rng.getrandbits(32):08x}"
        run.succeeds(await at.call("subscribe", filter=filter_, qos=0))
        # A quotation mark, a backslash, a line break, and bytes that are no text.
        for payload in ("YSJiXGMKZA==", "/wD+", "TmFO"):
            await at.device.poke(publish={"topic": filter_, "payload": payload, "qos": 0, "retain": False})
        await at.call("messages", filter=filter_)


# -- meta -------------------------------------------------------------------------------------------------------------


@TASKS.every_protocol("ENV-004", "The stated latency is the time of the call in milliseconds.", prompt=True)
async def latency_is_measured(run: Repetition, at: Rig) -> None:
    """Read while the device answers at once, a tenth of a second late, and four tenths late.

    Said: success, and a `latency_ms` of at least that time and at most the time of the whole call.
    Seen: the time between request and answer at the device.
    Why: a latency in seconds, or a constant, hides a line that is about to fail.
    """
    needs_envelopes(run, at)
    await a_read_works(run, at)
    for seconds in _DELAYS_S:
        await at.device.delay(seconds)
        await a_read_works(run, at)
        await at.device.delay(0)


@TASKS.every_protocol("ENV-005", "The stated attempts are the requests that were sent.", writes=True, prompt=True)
async def attempts_are_counted(run: Repetition, at: Rig) -> None:
    """Read and write; write without any argument; read and write while the device resets the connection once
    instead of answering.

    Said: `attempts` as many as requests left for the call, and 0 where none did.
    Seen: so many requests.
    Why: an operator who reads 1 where four were sent looks for the fault in the wrong place.
    """
    needs_envelopes(run, at)
    for step in (read, write):
        asked, reply = await step(run, at)
        run.succeeds(reply, **asked.outputs)
        # Everything that was sent for the call has been seen by now: the last of it perhaps after the reply, if the adapter waits for no answer.
        seen = [entry for entry in from_adapter(await at.journal()) if entry["t_ns"] >= reply.exchange.sent_ns]
        stated = _meta(reply).get("attempts")
        if isinstance(stated, int) and stated > len(seen):
            message = f"meta.attempts says {stated}, the device saw {len(seen)} request(s) during the call"
            _wrong(run, reply, "attempts", message, "ENV-005")
    refused = await refused_by_the_adapter(run, at)
    if refused is not None and _meta(refused).get("attempts"):
        _wrong(
            run,
            refused,
            "attempts",
            f"nothing was sent, meta.attempts says {_meta(refused).get('attempts')!r}",
            "ENV-005",
        )
    await _interrupted_read(run, at)
    await broken(run, at, requirement="ERR-005")


async def _interrupted_read(run: Repetition, at: Rig) -> None:
    await at.device.fault(*({**rule, "times": 1} for rule in exercise(at).reset))
    asked, reply = await read(run, at)
    await at.device.fault()
    # A read may be repeated over a new connection; the device has seen both requests.
    reset: list[JournalEntry] = []
    if reply.success:
        run.succeeds(reply, **asked.outputs)
        if _meta(reply).get("attempts") == 1:
            reset = [entry for entry in reply.during(await at.journal()) if _is_reset(entry.get("fault"))]
    else:
        run.fails(reply, *CONNECTION_FAULTS, requirement="ERR-005")
    await answers_again(run, at)
    # The request that met the reset may be one that the adapter makes when nobody asks.
    if reset and not await polls(at, reset):
        message = "the device reset the connection at the first request, meta.attempts says 1 and there was an answer"
        _wrong(run, reply, "attempts", message, "ENV-005")


def _is_reset(fault: object) -> bool:
    return isinstance(fault, Mapping) and "reset" in fault


@TASKS.every_protocol(
    "ENV-006", "meta is complete in every answer, and messages are for people.", writes=True, prompt=True
)
async def meta_is_complete(run: Repetition, at: Rig) -> None:
    """Read, write, have a call refused by the adapter, by the device and by a connection that breaks.

    Said: the same members of `meta` as in a success, the endpoint that was contacted, without credentials; messages of at most 500
        characters without traceback, path or representation of an object.
    Seen: the connection to the endpoint that is stated.
    Why: the answers to failures are read when there is a failure, and are tested least.
    """
    needs_envelopes(run, at)
    _, good = await read(run, at)
    run.succeeds(good)
    failures = await every_kind(run, at)
    wanted = {name for name in _meta(good) if name in _REQUIRED}
    for reply in failures:
        if missing := sorted(wanted - set(_meta(reply))):
            _wrong(run, reply, "envelope_schema", f"meta lacks {', '.join(missing)}, which a success has", "ENV-006")


_REQUIRED = frozenset(
    "schema protocol operation endpoint started_at latency_ms attempts request_id source connection trace".split()
)


@TASKS.every_protocol("ENV-007", "The stated trace is what was on the wire.", writes=True, prompt=True)
async def the_trace_is_the_wire(run: Repetition, at: Rig) -> None:
    """Read and write random values, and read while the device refuses it.

    Said: in `meta.trace` facts of the exchange, each as it was on the wire.
    Seen: the same facts.
    Why: a trace that is made of the arguments agrees with them, whatever was really sent.
    """
    needs_envelopes(run, at)
    for step in (read, write):
        _, reply = await step(run, at)
        run.succeeds(reply)
        _has_facts(run, at, reply)
    _has_facts(run, at, await refused_by_the_device(run, at))
    await a_read_works(run, at)


def _has_facts(run: Repetition, at: Rig, reply: Reply) -> None:
    trace = _meta(reply).get("trace")
    if _meta(reply).get("attempts") and not (isinstance(trace, Mapping) and trace):
        _wrong(run, reply, "wrong_trace", f"meta.trace should have facts of the exchange, it is {trace!r}", "ENV-007")


@TASKS.every_protocol("ENV-008", "An answer says where its data are from.", writes=True, prompt=True)
async def the_source_is_told(run: Repetition, at: Rig) -> None:
    """Read the same twice, write and read back where that is the same thing, have a call refused by the adapter, and read while the
    device resets every connection.

    Said: `source` is `device` where there was an exchange with the device in this call, and not where there was none; a failure while
        the device is away.
    Seen: an exchange for each of these.
    Why: yesterday's value that says that it is from the device is believed.
    """
    needs_envelopes(run, at)
    asked = exercise(at).read(run.rng)
    for poke in asked.pokes:
        await at.device.poke(**poke)
    for _ in range(2):
        run.succeeds(await at.call(asked.operation, **asked.inputs), **asked.outputs)
    await a_write_works(run, at)
    await refused_by_the_adapter(run, at)
    await _one_shape(run, at)
    await at.device.fault(*exercise(at).reset)
    gone = await at.call(asked.operation, **asked.inputs)
    await at.device.fault()
    # An adapter may get at its data in another way, by which the device can still be reached.
    if await met(at, gone):
        run.fails(gone, *CONNECTION_FAULTS, requirement="ENV-008", code_requirement="ERR-005")
    await answers_again(run, at)


async def _one_shape(run: Repetition, at: Rig) -> None:
    """Read one register and three: a list each time."""
    if at.protocol != "modbus":
        return
    for count in (1, 3):
        values = [run.rng.randrange(0x10000) for _ in range(count)]
        await at.device.poke(unit=1, table="holding_registers", address=_FLOAT_AT, values=values)
        run.succeeds(
            await at.call("read_holding", address=_FLOAT_AT, count=count), requirement="ENV-008", values=values
        )


def _meta(reply: Reply) -> Mapping[str, object]:
    meta = reply.member("meta")
    return meta if isinstance(meta, Mapping) else {}


def _wrong(run: Repetition, reply: Reply, code: str, what: str, requirement: str) -> None:
    run.judge(reply, [Finding(code=code, message=f"{reply.label}: {what}", requirement=requirement)])
