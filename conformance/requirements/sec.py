"""SEC: what a caller may do, and where a call may lead."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from pytest_otmcp.protocols.exercise import Asked
from pytest_otmcp.trial.alteration import Alteration
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.rig import Rig

from .fenced import BEYOND, FORBIDDEN, another, beyond, fenced, is_written, refused, taken, written
from .steps import NOTHING_SENT, a_read_works, citing, exercise, faulty, nothing_arrived, refusal, since, witness

__all__ = ["TASKS"]

TASKS = Checks()

_CLAIMS = {"role": "engineer", "user": "admin", "is_admin": True, "approved": True, "confirm": True}
"""Arguments by which a caller makes itself more than it is."""
_DENIED = (*FORBIDDEN, "writes_disabled", "auth_failed")
"""Codes for a caller who may write nothing."""
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
