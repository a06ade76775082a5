"""RES: resources, load and hostile devices."""

from __future__ import annotations

import base64
import random
from collections.abc import Awaitable, Callable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from statistics import median
from typing import cast

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.journal import ADAPTER
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.trial.alteration import Alteration
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Footprint, Rig

from ..tasks.messages import subscribe
from .provoked import UNKNOWN_ARGUMENT
from .steps import a_read_works, answers_again, exercise, faulty, read, reset

__all__ = ["TASKS"]

TASKS = Checks()

# -- RES-001: numbers in the short and in the long form ------------------------------------------------------

_CALLS = {False: 100, True: 2000}
_FAULTS = {False: 12, True: 200}
_CANCELS = {False: 8, True: 200}
_RECONNECTS = {False: 4, True: 50}
_WARM = (20, 3, 2, 1)
"""Calls, faults, cancellations and reconnections before the first look: caches and pools are filled by then."""

_MORE_HANDLES = 2
_MORE_RSS_KIB = 20 * 1024
_LATE_S = 0.05
_SLOWER, _SLOWER_MS = 10, 50.0
"""How much slower the last calls may be than the first, as a factor and beyond it; a busy machine alone does less."""

_WINDOW = 25
"""Calls between two looks at the processes."""
_MOST_WINDOWS = 40
_QUIET_WINDOWS = 2
"""Windows without growth after which a figure is believed to have found its bound."""
_PER_CALL = {"descriptors": 0.1, "threads": 0.1, "rss_kib": 10.0}
"""Growth with each call that counts. An honest adapter in Python on the official SDK takes 5.5 KiB with each of its first 500 calls, until
its collector looks through everything (CPython 3.11, measured 2026-11)."""
_KINDS = {"descriptors": "descriptors", "threads": "threads", "rss_kib": "KiB of memory"}

# -- RES-003 -------------------------------------------------------------------------------------------------

_SURVIVES = "A hostile device does not end the adapter."
_BATCHES = {False: 4, True: 100}
_BATCH = 25
_STAYING = 6
"""Mangled answers on connections that stay, asked for at the same time: each may be waited for."""

_PAYLOADS = {False: 60, True: 2000}
_SPARKPLUG = bytes.fromhex("08e5a2d2f0b631121c0a0b74656d70657261747572651800200a69000000000000354018ff01")
"""A Sparkplug B payload with one metric: a Double named temperature, and a sequence number."""

_HOSTILE = (
    # A length without an end, a length beyond the payload, groups in groups, metrics without any member.
    b"\xff" * 64,
    b"\x12\xff\xff\xff\xff\x0f",
    b"\x0b" * 4000,
    b"\x12\x00" * 4000,
    b"\x12\x0a\x20\x0a\x50\xff\xff\xff\xff\xff\xff\xff\xff\xff\x01"[:8],
)

# -- RES-004 -------------------------------------------------------------------------------------------------

_AT_ONCE = 256
_ROUNDS = {False: 1, True: 20}
"""The long form has more rounds, not more calls at once: an adapter reads and refuses one after the other, and a busy machine would take
longer for thousands of them than a deadline."""
_SLOW_S = 0.05
_REFUSALS = ("rate_limited", "device_busy", "limit_exceeded")


@TASKS.every_protocol("RES-001", "Nothing leaks.", facets="recovery", prompt=True)
async def nothing_leaks(run: Repetition, at: Rig) -> None:
    """Read many times; read while connections are reset, cancel reads, stop and start the device, each several times. Do it once
    with few of each and then with many, and where something has grown once more. Then read, 25 times between two looks at the
    processes, until nothing has grown between two of them; and again while the calls fail.

    Said: success for the reads without a fault; the last of them as fast as the first.
    Seen: memory, descriptors, threads and processes of the adapter, before and after; nothing of them grows every time, or with
        every call.
    Why: an adapter runs for months; what it loses with each fault is gone in the night in which the line is disturbed.
    """
    await _burst(run, at, *_WARM)
    before = await at.session.footprint()
    if not before["processes"] or not await _is_seen(at):
        message = f"{at.protocol}: the process that talks to the device cannot be seen from here, so nothing is known of what it loses"
        run.witnessed([Finding(code="unseen_process", message=message, requirement="RES-001", strength="SHOULD")])
        return
    numbers = (_CALLS[run.soak], _FAULTS[run.soak], _CANCELS[run.soak], _RECONNECTS[run.soak])
    replies = await _burst(run, at, *numbers)
    after = await at.session.footprint()
    grown = _grown(before, after)
    if grown:
        # What is collected late, or grows up to a bound, does not grow a second time.
        await _burst(run, at, *numbers)
        again = await at.session.footprint()
        grown = {name: told for name, told in _grown(after, again).items() if name in grown}
    did = "{} calls, {} faults, {} cancellations and {} reconnections".format(*numbers)
    run.witnessed(
        [
            Finding(
                code="leak",
                message=f"{at.protocol}: with every {did} the adapter's {name} should stay, they grow: {told}",
                requirement="RES-001",
            )
            for name, told in grown.items()
        ]
    )
    spans = [reply.latency_ms for reply in replies if reply.success and reply.latency_ms is not None]
    tenth = len(spans) // 10
    first, last = median(spans[:tenth] or [0.0]), median(spans[-tenth:] or [0.0])
    if last > first * _SLOWER + _SLOWER_MS:
        message = f"{at.protocol}: after {did} a read took {last:.1f} ms, before {first:.1f} ms"
        run.finding("slower", message, "RES-001")
    if not grown:
        await _loses_nothing(run, at, "succeeds", partial(_succeeding, run, at))
        await at.device.fault(*exercise(at).refused)
        await _loses_nothing(run, at, "fails", partial(_failing, run, at))
        await at.device.fault()
        await answers_again(run, at)


async def _is_seen(at: Rig) -> bool:
    """Tell whether the process that talks to the device is one that can be looked at; only of connections a witness knows whose they
    are."""
    if not protocols()[at.protocol].has_connections:
        return True
    made = [entry for entry in await at.journal() if entry["kind"] == "CONNECTED" and entry["origin"] == ADAPTER]
    return not made or any("process" in entry for entry in made)


async def _succeeding(run: Repetition, at: Rig, _: int) -> None:
    asked, reply = await read(run, at)
    run.succeeds(reply, requirement=None, **asked.outputs)


async def _failing(run: Repetition, at: Rig, index: int) -> None:
    """Have the device refuse a read, and the adapter every second one."""
    asked = exercise(at).read(run.rng)
    if index % 2 and at.arguments_of(asked.operation, **asked.inputs) is not None:
        wrong = Alteration(given={UNKNOWN_ARGUMENT: index})
        await at.call_altered(asked.operation, wrong, role="control", **asked.inputs)
    else:
        await at.call(asked.operation, role="control", **asked.inputs)


async def _loses_nothing(run: Repetition, at: Rig, how: str, call: Callable[[int], Awaitable[None]]) -> None:
    """Call until nothing of the processes has grown for a while, or what grows has grown nearly every time."""
    looks: list[Footprint] = []
    for _ in range(_MOST_WINDOWS):
        if not run.has_time:
            run.cut_short("RES-001", f"{len(looks) * _WINDOW} of the calls that show what each of them loses")
            return
        for index in range(_WINDOW):
            await call(index)
        looks.append(await at.session.footprint())
        if not any(_may_grow(_growths(looks, name), name) for name in _PER_CALL):
            return
    lost = {name: growths for name in _PER_CALL if _keeps_growing(growths := _growths(looks, name), name)}
    if any(look.get("lazy_heap") for look in looks):
        # Such a runtime takes memory up to a limit of its own before it looks for what it can free.
        lost.pop("rss_kib", None)
    run.witnessed(
        [
            Finding(
                code="leak",
                message=f"{at.protocol}: the adapter's {_KINDS[name]} should stay, with every call that {how} "
                f"there are {sum(growths) / len(growths) / _WINDOW:.1f} more, through {len(growths) * _WINDOW} calls",
                requirement="RES-001",
            )
            for name, growths in lost.items()
        ]
    )


def _growths(looks: Sequence[Footprint], name: str) -> list[int]:
    """Return by how much a figure grew from each look to the next; the first windows are those in which caches and pools are filled."""
    figures = [cast(int, dict(look)[name]) for look in looks]
    return [now - then for then, now in pairwise(figures)]


def _may_grow(growths: Sequence[int], name: str) -> bool:
    return sum(growth < _PER_CALL[name] * _WINDOW for growth in growths) < _QUIET_WINDOWS


def _keeps_growing(growths: Sequence[int], name: str) -> bool:
    """Tell whether a figure has grown to the end, and hardly less than at the beginning: what fills up grows less and less."""
    half = len(growths) // 2
    return _may_grow(growths, name) and 2 * sum(growths[half:]) >= sum(growths[:half])


async def _burst(run: Repetition, at: Rig, calls: int, faults: int, cancels: int, reconnects: int) -> list[Reply]:
    """Do so many of each, and return the replies to the reads without a fault."""
    asks = exercise(at)
    replies = []
    for _ in range(calls // 2):
        asked, reply = await read(run, at)
        run.succeeds(reply, requirement=None, **asked.outputs)
        replies.append(reply)
    for _ in range(faults):
        await at.device.fault(*faulty(asks.reads, **reset(at)))
        asked = asks.read(run.rng)
        await at.call(asked.operation, role="control", **asked.inputs)
    await at.device.fault()
    await answers_again(run, at)
    await at.device.fault(*faulty(asks.reads, delay_s=_LATE_S))
    for _ in range(cancels):
        asked = asks.read(run.rng)
        await at.call_and_cancel(asked.operation, seen={"request": True}, timeout_s=1.0, **asked.inputs)
    await at.device.fault()
    for _ in range(reconnects):
        await at.stop_device()
        await at.start_device()
        await answers_again(run, at)
    for _ in range(calls - calls // 2):
        asked, reply = await read(run, at)
        run.succeeds(reply, requirement=None, **asked.outputs)
        replies.append(reply)
    return replies


def _grown(before: Footprint, after: Footprint) -> dict[str, str]:
    """Return what there is more of than before, with both figures."""
    more = {
        "descriptors": (before["descriptors"], after["descriptors"], _MORE_HANDLES),
        "threads": (before["threads"], after["threads"], _MORE_HANDLES),
        "processes": (before["processes"], after["processes"], _MORE_HANDLES),
        "KiB of memory": (before["rss_kib"], after["rss_kib"], _MORE_RSS_KIB),
    }
    return {name: f"{then}, then {now}" for name, (then, now, most) in more.items() if now > then + most}


@TASKS.every_protocol("RES-003", _SURVIVES, facets="recovery", apart="mqtt opcua", prompt=True)
async def a_hostile_device(run: Repetition, at: Rig) -> None:
    """Read while every answer is mangled at random: bits, missing bytes, further bytes. After every batch read without a fault.
    Then have some answers mangled on connections that stay.

    Said: whatever can be said of such an answer, in time; between the batches the value that the device holds.
    Seen: the reads; the adapter's processes take no more than 20 MB more.
    Why: a device with a fault must not take the adapter with it, which has to tell of the fault.
    """
    await _mangled_answers(run, at)


@TASKS.check("RES-003", _SURVIVES, needs="opcua.read opcua.recovery")
async def a_hostile_opcua_server(run: Repetition, opcua: Rig) -> None:
    """Read while every answer is mangled at random: bits, missing bytes, further bytes. After every batch read without a fault.
    Then have some answers mangled on connections that stay.

    Said: whatever can be said of such an answer, in time; between the batches the value that the server holds.
    Seen: the reads; the adapter's processes take no more than 20 MB more.
    Why: a server with a fault must not take the adapter with it, which has to tell of the fault.
    """
    # A session whose connection has ended stays with the server for a while, so there are many of them.
    await opcua.device.poke(limits={"sessions": 0})
    await _mangled_answers(run, opcua)


async def _mangled_answers(run: Repetition, at: Rig) -> None:
    asks = exercise(at)
    await a_read_works(run, at)
    before, done = None, 0
    for _ in range(_BATCHES[run.soak]):
        if not run.has_time:
            break
        rules = [{**rule, "times": 1} for _ in range(_BATCH) for rule in _mangling(asks.reads, run.rng, end=True)]
        await at.device.fault(*rules)
        mangled = [asks.read(run.rng) for _ in range(_BATCH)]
        calls = (at.call(asked.operation, role="control", **asked.inputs) for asked in mangled)
        if protocols()[at.protocol].has_connections:
            for call in calls:
                if run.has_time:
                    await call
                    done += 1
                else:
                    call.close()
        else:
            # Nothing ends where there is no connection, so nearly every one of them is waited for.
            await run.together(*calls)
            done += _BATCH
        await at.device.fault()
        await answers_again(run, at, requirement="RES-003")
        before = before or await at.session.footprint()
    if done < (planned := _BATCH * _BATCHES[run.soak]):
        run.cut_short("RES-003", f"{done} of {planned} reads with a mangled answer")
    staying = [{**rule, "times": 1} for _ in range(_STAYING) for rule in _mangling(asks.reads, run.rng, end=False)]
    await at.device.fault(*staying)
    waiting = [asks.read(run.rng) for _ in range(_STAYING)]
    await run.together(*(at.call(asked.operation, role="control", **asked.inputs) for asked in waiting))
    await at.device.fault()
    await answers_again(run, at, requirement="RES-003")
    if before is not None:
        _stays_small(run, at, before, await at.session.footprint())


def _stays_small(run: Repetition, at: Rig, before: Footprint, after: Footprint) -> None:
    if before["processes"] and after["rss_kib"] > before["rss_kib"] + _MORE_RSS_KIB:
        message = (
            f"{at.protocol}: mangled answers made the adapter grow from {before['rss_kib']} to {after['rss_kib']} KiB"
        )
        run.finding("leak", message, "RES-003")


def _mangling(conditions: Sequence[Mapping[str, object]], rng: random.Random, *, end: bool) -> list[dict[str, object]]:
    """Return rules with one and the same random change of an answer."""
    mangle: dict[str, object] = {"end": end}
    # The first bytes say type and length: they are hit as often as all the others together.
    places = [rng.choice((rng.randrange(9), rng.randrange(200))) for _ in range(rng.randrange(1, 5))]
    kind = rng.randrange(4)
    if kind != 1:
        mangle["flip"] = [[place, rng.randrange(1, 256)] for place in places]
    if kind in (1, 3):
        mangle["cut"] = rng.randrange(1, 30)
    if kind >= 2:
        mangle["append"] = rng.randbytes(rng.choice((1, 8, 300))).hex()
    return [{**condition, "action": {"mangle": mangle}} for condition in conditions]


@TASKS.check("RES-003", _SURVIVES, needs="mqtt.subscribe mqtt.recovery")
async def a_hostile_broker(run: Repetition, mqtt: Rig) -> None:
    """Publish Sparkplug messages that were mangled at random, and some that were made to stop a decoder, to the adapter; have it
    decode some, where it decodes; after each dozen subscribe to another topic. Then subscribe while every answer is mangled at
    random: bits, missing bytes, further bytes; after every batch subscribe without a fault.

    Said: success for the subscriptions without a fault; whatever can be said of the others and of such a payload, in time.
    Seen: the subscriptions; the adapter's processes take no more than 20 MB more.
    Why: everybody who may publish at the broker could otherwise stop the adapter.
    """
    run.must_succeed(await subscribe(mqtt, "spBv1.0/#"))
    payloads = [*_HOSTILE, *(_mangled(run.rng) for _ in range(_PAYLOADS[run.soak]))]
    for place, payload in enumerate(payloads, start=1):
        topic = f"spBv1.0/plant/{run.rng.choice(('NBIRTH', 'NDATA', 'NDEATH'))}/hostile-{place % 3}"
        await mqtt.device.poke(
            publish={"topic": topic, "payload": base64.b64encode(payload).decode(), "qos": 0, "retain": False}
        )
        if place <= len(_HOSTILE) and mqtt.subject.claims("decode_sparkplug"):
            await mqtt.call("decode_sparkplug", role="control", payload=base64.b64encode(payload).decode())
        if place % 12 == 0:
            await a_read_works(run, mqtt, requirement="RES-003")
    await _mangled_answers(run, mqtt)


def _mangled(rng: random.Random) -> bytes:
    changed = bytearray(_SPARKPLUG[: rng.choice((len(_SPARKPLUG), rng.randrange(len(_SPARKPLUG))))])
    for _ in range(rng.randrange(1, 6) if changed else 0):
        changed[rng.randrange(len(changed))] ^= rng.randrange(1, 256)
    return bytes(changed) + rng.randbytes(rng.choice((0, 0, 3, 200)))


@TASKS.every_protocol("RES-004", "Too many calls are refused, and do not wait without end.", prompt=True)
async def overload_is_refused(run: Repetition, at: Rig) -> None:
    """Read by hundreds of calls at the same time while the device is slow; read once it is not.

    Said: success, or a refusal with `rate_limited`, `device_busy` or `limit_exceeded`, beside which some may have waited in vain;
        then success.
    Seen: the reads of those that succeeded.
    Why: a call that waits in a queue until its time is over has done harm twice: nobody is told to slow down, and the device is
        asked for what nobody waits for any more.
    """
    await a_read_works(run, at)
    for _ in range(_ROUNDS[run.soak]):
        await at.device.fault(*faulty(exercise(at).reads, delay_s=_SLOW_S))
        asked = [exercise(at).read(run.rng) for _ in range(_AT_ONCE)]
        replies = await run.together(*(at.call(one.operation, **one.inputs) for one in asked))
        await at.device.fault()
        waited = [reply for reply in replies if not reply.success and not _is_refusal(reply)]
        # The calls are equal: which of them has which answer must not decide what is found, nor which of many faults are told.
        for reply in sorted(replies, key=lambda one: one.exchange.sent_ns):
            if reply.success:
                run.succeeds(reply)
            elif _is_refusal(reply):
                run.fails(reply, *_REFUSALS, requirement="RES-004")
        if waited and not any(map(_is_refusal, replies)):
            message = f"{waited[0].label}: of {len(replies)} calls at the same time those beyond a limit should be refused as rate_limited"
            codes = " and ".join(sorted({str(reply.error_code) for reply in waited}))
            run.finding("overloaded", f"{message}, {len(waited)} failed with {codes}", "RES-004")
        await answers_again(run, at, requirement="RES-004")


def _is_refusal(reply: Reply) -> bool:
    """Tell whether a call was refused for there being too many; an adapter without classes of errors only says that it failed."""
    return reply.unclassified or reply.error_code in _REFUSALS
