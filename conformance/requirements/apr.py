"""APR: writes that a person has to approve, who answers the adapter's question over MCP, or approves outside of it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from functools import partial
from typing import Any

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.exercise import Asked
from pytest_otmcp.trial.alteration import Alteration
from pytest_otmcp.trial.audit import told_in
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.rig import Rig
from pytest_otmcp.trial.session_in_rig import Answer

from .fenced import another, approved_numbers, fenced, refused, taken, written
from .steps import a_read_works, nothing_arrived, since

__all__ = ["TASKS"]

TASKS = Checks()

_NO = ("approval_denied", "approval_required", "approval_expired", "access_denied")
_REFUSING: tuple[Answer, ...] = ("decline", "cancel", "none")
_CONFIRMING = {"confirm": True, "approve": True, "approved": True, "confirmation": "yes"}
"""Arguments by which a model says itself that somebody has approved."""
_MARGIN_S = 0.3
_PATIENCE = 0.8
"""Part of the deadline that an adapter may wait for an answer that never comes, so that the call ends in time."""
_SECRETS = ("password", "passwd", "secret", "token", "api_key", "apikey", "pin", "credential")


class _Approved:
    """Writes of the target that a person approves.

    Args:
        told: what the subject file says of approvals.
    """

    def __init__(self, run: Repetition, at: Rig) -> None:
        told = at.subject.governance.approval
        if told is None:
            run.not_applicable("the subject file names no target that a person has to approve")
        way = fenced(run, at).way
        if way is None:
            run.not_applicable("the target that a person has to approve is none that the kit can write")
        self.told: Mapping[str, Any] = told
        self.by_client = told["by"] == "client"
        self._run, self._at, self._way = run, at, way
        self._numbers = approved_numbers(run, at, 8)

    def next(self) -> Asked:
        """Make the write of a number that was not asked for before."""
        return self._way(self._numbers.pop())

    async def no(self, asked: Asked, answer: Answer, requirement: str) -> None:
        """Expect that a write is refused for this answer."""
        await self._at.session.answers(answer)
        await refused(self._run, self._at, self._at.call, asked, *_NO, requirement=requirement)

    async def yes(self, asked: Asked, requirement: str) -> None:
        """Expect that an approved write is written."""
        if self.by_client:
            await self._at.session.answers("accept")
        else:
            await self.given(asked, requirement)
        await written(self._run, self._at, asked, requirement=requirement)

    async def given(self, asked: Asked, requirement: str) -> bool:
        """Have a write approved without making it; return whether a later call can make it."""
        await self._at.session.answers("none")
        reply = await self._at.call(asked.operation, **asked.inputs)
        self._run.fails(reply, *_NO, outcome="not_sent", requirement=requirement)
        self._run.witnessed(nothing_arrived(self._at, since(reply, await self._at.journal()), requirement=requirement))
        if self.by_client:
            return reply.asks
        name = told_in(reply, self.told["id"])
        if isinstance(name, str) and await self._at.session.approve(name):
            return True
        what = f"{reply.label}: the request at {self.told['id']}, {name!r}, could not be approved"
        self._run.witnessed([Finding(code="cannot_approve", message=what, requirement=requirement)])
        return False

    async def bring(self) -> None:
        """Let the next call bring what was approved, where a call does that."""
        if self.by_client:
            await self._at.session.redeem()


@TASKS.every_protocol(
    "APR-001", "Nothing is written before a person's yes.", writes=True, launch="governance", having="limited"
)
async def nothing_is_written_before_a_yes(run: Repetition, at: Rig, governed: Rig) -> None:
    """Write what needs an approval, again and again: declined, cancelled, accepted with a no or with a text, without an answer, for which the
    adapter may have to wait until its time is over, with arguments that say that it was approved, and approved. Where the client is asked,
    in both eras of MCP, and at last as a client that cannot be asked.

    Said: success for what was approved; else failures with `approval_denied`, `approval_required` or `approval_expired`.
    Seen: one write, after the approval; nothing of the others.
    Why: an approval that comes without a person is a delay, and no protection.
    """
    approved = _Approved(run, governed)
    await governed.session.answers("accept")
    await a_read_works(run, governed)
    await governed.session.questions()
    await _answered(run, governed, approved)
    if not approved.by_client:
        return
    if await governed.open_by_handshake():
        try:
            await _answered(run, governed, approved, handshake=True)
        finally:
            await governed.close_handshake_era()
    async with another(governed, can_ask=False):
        await approved.no(approved.next(), "accept", "APR-001")


async def _answered(run: Repetition, at: Rig, approved: _Approved, *, handshake: bool = False) -> None:
    asked = approved.next()
    if approved.by_client:
        for answer in _REFUSING:
            await approved.no(asked, answer, "APR-001")
        if any(_truths(question["form"]) for question in await at.session.questions()):
            # Without a truth value in the form the acceptance alone is the yes.
            await approved.no(asked, "no", "APR-001")
            await approved.no(asked, "text", "APR-001")
        if handshake and approved.told.get("expires_s", math.inf) < _PATIENCE * at.subject.deadline_s * at.time_scale:
            await approved.no(asked, "silence", "APR-001")
    else:
        await approved.no(asked, "accept", "APR-001")
    await at.session.answers("none")
    for given in taken(at, asked, _CONFIRMING):
        call = partial(at.call_altered, altered=Alteration(given=given))
        await refused(run, at, call, asked, *_NO, "invalid_input", requirement="APR-001")
    await approved.yes(approved.next(), "APR-001")


def _truths(form: Mapping[str, Any]) -> list[str]:
    return [name for name, about in form.get("properties", {}).items() if about.get("type") == "boolean"]


@TASKS.every_protocol(
    "APR-002",
    "An approval is for one write, once, and in its time.",
    writes=True,
    launch="governance",
    having="limited",
)
async def an_approval_is_for_one_write(run: Repetition, at: Rig, governed: Rig) -> None:
    """Have a write approved, and write another number with that; write what was approved, and the same once more. Have another approved, and
    write it when the approval has ended, where the subject file says when that is. Where the client is asked, in both eras of MCP; in that
    of the handshake an approval is for the call in which it is asked for.

    Said: success for what was approved, the first time; else failures with `approval_denied`, `approval_required` or `approval_expired`.
    Seen: one write of the number that was approved.
    Why: a yes to one number that opens the next is a yes to everything.
    """
    approved = _Approved(run, governed)
    await governed.session.answers("accept")
    await a_read_works(run, governed)
    await _used_once(run, governed, approved)
    if approved.by_client and await governed.open_by_handshake():
        try:
            await _used_once(run, governed, approved)
        finally:
            await governed.close_handshake_era()


async def _used_once(run: Repetition, at: Rig, approved: _Approved) -> None:
    one, other, late = approved.next(), approved.next(), approved.next()
    if held := await approved.given(one, "APR-002"):
        await approved.bring()
        await approved.no(other, "none", "APR-002")
        if approved.by_client:
            # Who was brought an approval of something else may have forgotten it.
            await approved.given(one, "APR-002")
        await approved.bring()
        await written(run, at, one, requirement="APR-002")
        await approved.bring()
    else:
        await approved.yes(one, "APR-002")
    await approved.no(one, "none", "APR-002")
    await approved.yes(other, "APR-002")
    await approved.no(late, "none", "APR-002")
    if held and "expires_s" in approved.told and await approved.given(late, "APR-002"):
        await at.pause(approved.told["expires_s"] + _MARGIN_S)
        await approved.bring()
        await approved.no(late, "none", "APR-002")


@TASKS.every_protocol(
    "APR-003",
    "The question says what is written where, and asks for no secret.",
    writes=True,
    launch="governance",
    having="limited",
)
async def the_question_says_what_is_written(run: Repetition, at: Rig, governed: Rig) -> None:
    """Write a number with an approval, then another one, and look at the second question.

    Said: in the question the number that is held and the one that is asked for; its form has no place for a secret.
    Seen: the number that is held.
    Why: who is asked "continue?" says yes.
    """
    approved = _Approved(run, governed)
    if not approved.by_client:
        run.not_applicable("the client is not asked, so there is no question to be read")
    await governed.session.answers("accept")
    await a_read_works(run, governed)
    before, asked = approved.next(), approved.next()
    await approved.yes(before, "APR-003")
    image: Any = await governed.device.image()
    await governed.session.questions()
    reply = await governed.call(asked.operation, **asked.inputs)
    run.succeeds(reply, requirement="APR-001")
    questions = await governed.session.questions()
    text = "\n".join(question["text"] for question in questions)
    new = [*_numbers(asked), *[*asked.points.values()][:1]]
    # A broker holds nothing that could be asked for.
    held = [value for point, value in before.points.items() if point in image["points"]]
    old = [*_numbers(before), *held[:1]] if held else []
    lacking = [
        what
        for what, values in (("the number that is asked for", new), ("the number that is held", old))
        if values and not any(_is_in(value, text) for value in values)
    ]
    problems = [f"does not show {what}" for what in lacking]
    asked_for = [name for one in questions for name in one["form"].get("properties", {}) if _is_secret(name)]
    problems += [f"asks for a secret ({name})" for name in asked_for]
    if problems:
        message = f"{governed.protocol}: the question {' and '.join(problems)}"
        finding = Finding(
            code="asked_poorly", message=message, requirement="APR-003", strength="SHOULD", evidence=text[:2000]
        )
        run.witnessed([finding])


def _numbers(asked: Asked) -> list[object]:
    """Return the numbers that a write tells: where the device holds bytes, none of its points is one of them."""
    return [value for value in asked.outputs.values() if isinstance(value, int | float)]


def _is_in(value: object, text: str) -> bool:
    return any(
        form in text
        for form in {json.dumps(value), str(value), f"{value:g}" if isinstance(value, float) else str(value)}
    )


def _is_secret(name: str) -> bool:
    return any(word == part for word in _SECRETS for part in (name.lower(), *name.lower().split("_")))
