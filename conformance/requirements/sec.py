"""SEC: what a caller may do, where a call may lead, and by which account."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from pytest_otmcp.core.credentials import USER
from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.exercise import Asked
from pytest_otmcp.protocols.journal import Entries
from pytest_otmcp.protocols.protocol import ACCOUNT, SECURE
from pytest_otmcp.trial.alteration import Alteration
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.expectations import failed
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig

from .fenced import BEYOND, FORBIDDEN, another, beyond, fenced, is_written, refused, taken, written
from .steps import (
    CONNECTION_FAULTS,
    NOTHING_SENT,
    a_read_works,
    answers_again,
    citing,
    exercise,
    faulty,
    nothing_arrived,
    read,
    refusal,
    since,
    witness,
)

__all__ = ["TASKS"]

TASKS = Checks()

_CLAIMS = {"role": "engineer", "user": "admin", "is_admin": True, "approved": True, "confirm": True}
"""Arguments by which a caller makes itself more than it is."""
_DENIED = (*FORBIDDEN, "writes_disabled", "auth_failed")
"""Codes for a caller who may write nothing."""
_MOST_READS = 3
"""Until the device has denied one: after an outage some adapters need a call that fails to connect again."""
_LEADING = (("host", "port"), ("ip", "port"), ("url",), ("endpoint",), ("broker",), ("server",), ("device_path",))
"""Arguments that might name another endpoint, as they might be given together."""


@TASKS.every_protocol(
    "SEC-001", "Nobody writes what the policy does not let him.", writes=True, launch="governance", having="fenced"
)
async def nobody_writes_what_the_policy_forbids(run: Repetition, at: Rig, governed: Rig) -> None:
    """Through an adapter with a policy, whose every question is answered by yes: write what the policy does not name, also with arguments that
    claim a role; where a person approves numbers, one beyond the limits; and what the policy allows. Then, as a caller who may write
    nothing, the same, claims and all.

    Said: success for what is allowed; else failures with `access_denied`, or that it is beyond a limit, and the outcome `not_sent`.
    Seen: what is allowed, and nothing else.
    Why: a role that a model can claim, or a yes that opens everything, is no limit to what it can do.
    """
    asks, known = fenced(run, governed), exercise(governed)
    told = governed.subject.governance
    await governed.session.answers("accept")
    await a_read_works(run, governed)
    for asked in asks.outside:
        await refused(run, governed, governed.call, asked, *FORBIDDEN, requirement="SEC-001")
    await _claimed(run, governed, asks.outside[0], *FORBIDDEN)
    if asks.way is not None and told.approval is not None:
        highest = told.bounds.limits[told.approval["target"]].highest or 0
        for asked in beyond(asks.way, highest + known.limited[told.approval["target"]].unit):
            await refused(run, governed, governed.call, asked, *BEYOND, requirement="SEC-001")
    for asked in asks.inside:
        await written(run, governed, asked, requirement="SEC-001")
    if told.viewer:
        async with another(governed, viewer=True):
            await a_read_works(run, governed)
            for asked in asks.inside:
                await refused(run, governed, governed.call, asked, *_DENIED, requirement="SEC-001")
            await _claimed(run, governed, asks.inside[0], *_DENIED)


async def _claimed(run: Repetition, at: Rig, asked: Asked, *codes: str) -> None:
    for claims in taken(at, asked, _CLAIMS):
        call = partial(at.call_altered, altered=Alteration(given=claims))
        await refused(run, at, call, asked, *codes, requirement="SEC-001")


@TASKS.every_protocol(
    "SEC-002", "No argument leads to another endpoint.", writes=True, launch="governance", having="fenced"
)
async def no_argument_leads_elsewhere(run: Repetition, at: Rig, governed: Rig) -> None:
    """Through an adapter with a policy, read and write with further arguments that name the host and port, the URL or the path of another device,
    which is there and would answer.

    Said: failures with `invalid_input` or `access_denied`, or the value that the adapter's own device holds.
    Seen: at the other device nothing; at the adapter's own what it told as written.
    Why: an adapter that goes where an argument says is a way around every wall between its assistant and the plant.
    """
    asks, codes = fenced(run, governed), ("invalid_input", "access_denied")
    await governed.session.answers("accept")
    await a_read_works(run, governed)
    for names in _LEADING:
        given = _elsewhere(at, names)
        if not given:
            continue
        asked = exercise(governed).read(run.rng)
        for poke in asked.pokes:
            await governed.device.poke(**poke)
        if governed.arguments_of(asked.operation, **asked.inputs) is not None:
            reply = await governed.call_altered(asked.operation, Alteration(given=given), **asked.inputs)
            if reply.success:
                run.succeeds(reply, requirement="SEC-002", **asked.outputs)
            else:
                run.fails(reply, *codes, outcome=NOTHING_SENT, requirement="SEC-002")
        # What the other device refuses does no harm to it.
        await at.device.fault(*faulty(exercise(at).changing or exercise(at).writes, **refusal(at)))
        await _leads_nowhere(run, at, governed, asks.inside[0], given)
        await at.device.fault()


async def _leads_nowhere(run: Repetition, at: Rig, governed: Rig, asked: Asked, given: Mapping[str, object]) -> None:
    if governed.arguments_of(asked.operation, **asked.inputs) is None:
        return
    before: Any = await at.device.image()
    reply = await governed.call_altered(asked.operation, Alteration(given=given), **asked.inputs)
    if reply.success:
        run.witnessed(await is_written(governed, reply, asked, "SEC-002"))
    else:
        run.fails(reply, "invalid_input", "access_denied", outcome=NOTHING_SENT, requirement="SEC-002")
        run.witnessed(nothing_arrived(governed, since(reply, await governed.journal()), requirement="SEC-002"))
    held = {point: before["points"][point] for point in asked.points if point in before["points"]}
    run.witnessed(citing("SEC-002", witness(at).holds(await at.device.image(), held)))


def _elsewhere(at: Rig, names: tuple[str, ...]) -> dict[str, object]:
    """Return arguments of these names that lead to the device of another adapter; none where it has nothing that they could name."""
    places = at.device.placeholders
    url, serial = places.get("url"), places.get("serial")
    values: dict[str, object | None] = dict.fromkeys(names, url)
    values |= {"host": places.get("host"), "ip": places.get("host"), "device_path": serial}
    values["port"] = int(places["port"]) if places.get("port", "").isdigit() else None
    given = {name: values[name] for name in names}
    return {} if None in given.values() or "" in given.values() else given


@TASKS.every_protocol(
    "SEC-003", "The adapter has one account, and goes on with no other.", launch=SECURE, facets=ACCOUNT
)
async def one_account(run: Repetition, at: Rig, secure: Rig) -> None:
    """Read at a device that lets in the adapter's account alone; read while it lets in everybody else, with any account or none; start the adapter
    anew, and read while it lets in the account; read while the account may not read any more; read as at first.

    Said: success; a failure, best with `auth_failed` or `access_denied`; success; a failure, best with `access_denied`, where the device denied
        it in this call; success.
    Seen: logins of the account, and no other.
    Why: an adapter that goes on as another user, or as nobody, does what nobody has allowed it, and the device's log names the wrong one.
    """
    await _let_in(run, secure)
    begun = len(await secure.journal())
    await secure.device.poke(account="refused")
    await _control(run, secure)
    _, reply = await read(run, secure)
    tried = any(entry["kind"] == "login" for entry in since(reply, await secure.journal()))
    # Who waits before he logs in again was not refused in this call.
    _is_told(run, reply, "auth_failed", "access_denied", *([] if tried else CONNECTION_FAULTS))
    _no_other(run, reply, (await secure.journal())[begun:])
    # Who tries a refused account no more until he is started again keeps it from being locked.
    await secure.fresh_session()
    await _let_in(run, secure)
    await secure.device.poke(account="denied")
    if not (secure.subject.claims("recovery") and secure.subject.reconnects):
        await secure.fresh_session()
    for _ in range(_MOST_READS):
        _, reply = await read(run, secure)
        if any(entry["kind"] == "denied" for entry in since(reply, await secure.journal())):
            _is_told(run, reply, "access_denied")
            break
    await _let_in(run, secure)


async def _let_in(run: Repetition, at: Rig) -> None:
    """Let in the account alone, and read: a success."""
    begun = len(await at.journal())
    await at.device.poke(account="required")
    await _control(run, at)
    reply = await answers_again(run, at, requirement="SEC-003")
    _no_other(run, reply, (await at.journal())[begun:])


async def _control(run: Repetition, at: Rig) -> None:
    """Read, whatever comes of it: the device has cut the connection."""
    asked = exercise(at).read(run.rng)
    await at.call(asked.operation, role="control", **asked.inputs)


def _is_told(run: Repetition, reply: Reply, *codes: str) -> None:
    """Expect a failure, and advise one of these codes."""
    if run.fails(reply, "auth_failed", "access_denied", *CONNECTION_FAULTS, requirement="SEC-003"):
        found = [one for one in failed(reply, *codes, requirement="SEC-003") if one.code == "wrong_error_code"]
        run.judge(reply, [replace(one, strength="SHOULD") for one in found])


def _no_other(run: Repetition, reply: Reply, entries: Entries) -> None:
    others = {entry.get("user") for entry in entries if entry["kind"] == "login"} - {USER}
    if others:
        shown = " and ".join("a client without an account" if user is None else repr(user) for user in others)
        message = f"{reply.label}: the device should have seen logins of {USER!r} alone, it saw {shown}"
        run.witnessed([Finding(code="other_account", message=message, requirement="SEC-003")])
