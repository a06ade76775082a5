"""A repetition: one execution of a task's steps, and everything it showed.

``expectations`` and the oracles of ``protocols`` judge; a repetition only collects their findings.
It does not know whether it runs on a bench or on stored history: see :class:`~pytest_otmcp.trial.rig.Rig`.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Coroutine, Iterable
from typing import Any, NoReturn

from ..core.finding import Finding
from ..core.matrix import FIELD, REQUIREMENTS
from ..core.strict_json import same_json
from ..record.schema import Phases, Role
from ..subject.model import READ_WRITE
from . import expectations as oracle
from .ledger import Judged, Ledger
from .reply import Reply
from .rig import EndedError, Rig

__all__ = ["Repetition"]

_MOST_EQUAL = 5
"""Equal findings after which a check ends: a read that is wrong 163 times is no worse than one that is wrong five times."""

_BUDGET_S = 90.0
"""Seconds from the first call of a check to the last one that its long loops still make. An adapter may use up its deadline in each call."""


class Repetition:
    """One execution of a task's steps.

    Args:
        task_id: id of the task.
        rep: number of the repetition, from 0.
        role: role of the calls for which the steps name none.
        seed: of the run.
        time_scale: factor on windows and deadlines.
        rigs: every adapter at its device that the task has.
        soak: of the run.
        suite: of the task. A check of the requirement suite ends once it finds nothing new; its steps, and those at a real device, may have less in mind than a
            tool's own schema allows, so that a refusal of the rest is no fault.

    Attributes:
        soak: steps that have a long form take it: thousands of calls, messages or faults instead of some.
        rng: random numbers that only depend on the seed, the task, the role and the repetition.
        ledger: what the steps have shown so far.
        notes: a place where the steps can keep values.
        phases: of a recovery trial.
        ended_early: its last steps were not reached.
    """

    def __init__(
        self,
        task_id: str,
        rep: int,
        role: Role,
        *,
        seed: int,
        time_scale: float,
        rigs: Iterable[Rig],
        soak: bool = False,
        suite: str = "",
    ) -> None:
        self.rep = rep
        self.role = role
        self.time_scale = time_scale
        self.soak = soak
        self._is_check = suite in (REQUIREMENTS, FIELD)
        origin = f"{seed}/{task_id}/{role}/{rep}"
        most_equal = _MOST_EQUAL if self._is_check else None
        self.ledger = Ledger(
            role, time_scale, item=task_id, origin=origin, most_equal=most_equal, at_real=suite == FIELD
        )
        # The same seed gives the same nonces, whatever ran before.
        self.rng = random.Random(origin)
        self.phases: Phases | None = None
        self.notes: dict[str, object] = {}
        self.ended_early = False
        self._at = {(at.protocol, at.variant): at for at in rigs}
        for at in self.all:
            at.join(self.ledger)

    # -- who there is -------------------------------------------------------------------------------------

    def rig(self, protocol: str, variant: str = READ_WRITE) -> Rig | None:
        """Return the adapter of ``protocol`` at its device; None where the subject claims no such variant.

        Args:
            variant: each but the one with writes enabled has a device of its own.
        """
        return self._at.get((protocol, variant))

    @property
    def all(self) -> Iterable[Rig]:
        """Every adapter at its device that this task has."""
        return self._at.values()

    @property
    def inapplicable(self) -> str | None:
        """Why the steps found nothing to judge; None where they did."""
        return self.ledger.inapplicable

    # -- collecting ---------------------------------------------------------------------------------------

    async def in_order(self, *calls: Coroutine[object, object, Reply]) -> list[Reply]:
        """Perform calls one after the other."""
        replies = []
        for index, call in enumerate(calls):
            try:
                replies.append(await call)
            except BaseException:
                for unused in calls[index + 1 :]:
                    unused.close()
                raise
        return replies

    async def together(self, *calls: Coroutine[object, object, Reply]) -> list[Reply]:
        """Perform calls concurrently; their time counts once, from the first request to the last reply."""
        with self.ledger.one_group():
            replies = await asyncio.gather(*calls, return_exceptions=True)
        for reply in replies:
            if isinstance(reply, BaseException):
                raise reply
        return [reply for reply in replies if isinstance(reply, Reply)]

    async def close_journals(self) -> None:
        """Keep the journal entries of this repetition, at its end."""
        for at in self.all:
            if at.device.running:
                await at.keep_journal()

    def witnessed(self, *findings: list[Finding]) -> None:
        """Take over findings of what was observed at the device."""
        self.ledger.witnessed(*findings)
        self._end_if_repeating()

    def finding(self, code: str, message: str, requirement: str | None = None, evidence: str | None = None) -> None:
        """Note a finding of the task itself."""
        self.ledger.finding(code, message, requirement, evidence)
        self._end_if_repeating()

    def _end_if_repeating(self) -> None:
        if self.ledger.repeats_itself:
            raise EndedError

    @property
    def has_time(self) -> bool:
        """Whether a long loop of a check may go on: the calls so far have not used up its budget of time.

        Only the times of calls count, so that a stored history says the same. The long form has no budget.
        """
        calls = [call.reply.exchange.sent_ns for call in self.ledger.calls]
        return self.soak or not calls or max(calls) - min(calls) < _BUDGET_S * max(self.time_scale, 1.0) * 1e9

    def cut_short(self, requirement: str, did: str) -> None:
        """Note that the budget of time was used up before a check had done all that it does.

        Args:
            did: what it did instead, such as ``14 of 100 reads``.
        """
        message = f"{did} were made in the {_BUDGET_S:g} s that this check has: the adapter takes long for each"
        self.witnessed([Finding(code="cut_short", message=message, requirement=requirement, strength="SHOULD")])

    def not_applicable(self, reason: str) -> NoReturn:
        """End the repetition: the subject has nothing that the steps could judge.

        Args:
            reason: why, from what the subject file and the adapter's list of tools say alone, so that a stored history says the same.
        """
        self.ledger.inapplicable = reason
        raise EndedError

    # -- judging ------------------------------------------------------------------------------------------

    def succeeds(self, reply: Reply, *, requirement: str | None = None, **outputs: object) -> bool:
        """Expect success with these outputs, and return whether it was so; ``requirement`` as for ``expectations``.

        Where the schema of the tool does not allow what was asked for, a refusal before the wire is as good, and nothing is left to judge.
        """
        if self._is_check and reply.excess is not None and reply.success is False:
            self._refuses_what_its_schema_forbids(reply, reply.excess)
        return self.judge(reply, oracle.succeeded(reply, requirement=requirement, **outputs))

    def _refuses_what_its_schema_forbids(self, reply: Reply, excess: str) -> None:
        codes = ("limit_exceeded", "invalid_input", "range_overflow", "illegal_value", "illegal_address")
        if not self.fails(reply, *codes, outcome=("not_sent", "not_applicable"), code_requirement="ERR-002"):
            return
        if any(finding.is_must for finding in self.ledger.findings):
            raise EndedError
        self.not_applicable(f"the schema of {reply.tool} does not allow what this check asks for: {excess}")

    def must_succeed(self, reply: Reply, **outputs: object) -> None:
        """Expect success with these outputs; without it the repetition ends here."""
        if not self.succeeds(reply, requirement=None, **outputs):
            raise EndedError

    def fails(self, reply: Reply, *codes: str, **expected: Any) -> bool:
        """Expect a refusal with one of these codes, and return whether it was so; see
        :func:`pytest_otmcp.trial.expectations.failed`."""
        return self.judge(reply, oracle.failed(reply, *codes, **expected))

    def one_of(self, reply: Reply, output: str, *values: object, requirement: str = "CON-004") -> None:
        """Expect that an output is one of several values, each of which is right, as concurrency makes them."""
        found = reply.outputs.get(output)
        if reply.success and not any(same_json(value, found) for value in values):
            shown = " or ".join(map(repr, values))
            message = f"{reply.label}: {output} should be {shown}, the reply says {found!r}"
            self.ledger.reject(reply, Finding(code="wrong_value", message=message, requirement=requirement))
            self._end_if_repeating()

    def judge(self, reply: Reply, findings: list[Finding]) -> bool:
        """Take over what an expectation found about a reply; return whether it was met."""
        met = self.ledger.judge(reply, findings)
        self._end_if_repeating()
        return met

    @property
    def unanswered(self) -> bool:
        """At least one call of the steps got no response at all."""
        return not all(call.reply.answered or call.reply.cancelled for call in self.ledger.calls if not call.proof)

    @property
    def duration_ms(self) -> float:
        """Time of the task's calls: the sum over sequential calls, concurrent ones counted once."""
        answered = [call for call in self.ledger.calls if call.role == "task" and call.reply.answered]
        return sum(map(_span, _groups(answered))) / 1e6

    def calls_s(self) -> tuple[float, float]:
        """Return the seconds spent in calls of any role: from the first request to the last reply of calls made together,
        and in the MCP client before and after."""
        between = around = 0
        for calls in _groups(self.ledger.calls):
            answered = [call for call in calls if call.reply.answered]
            # Without any reply the client has waited all the time.
            span = _span(answered) if answered else _whole(calls)
            between += span
            around += _whole(calls) - span
        return between / 1e9, around / 1e9


def _groups(calls: Iterable[Judged]) -> Iterable[list[Judged]]:
    groups: dict[int, list[Judged]] = {}
    for call in calls:
        groups.setdefault(call.group, []).append(call)
    return groups.values()


def _span(calls: list[Judged]) -> int:
    exchanges = [call.reply.exchange for call in calls]
    return max(exchange.received_ns or 0 for exchange in exchanges) - min(exchange.sent_ns for exchange in exchanges)


def _whole(calls: list[Judged]) -> int:
    exchanges = [call.reply.exchange for call in calls]
    return max(exchange.returned_ns for exchange in exchanges) - min(exchange.asked_ns for exchange in exchanges)
