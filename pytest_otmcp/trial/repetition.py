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
from ..core.strict_json import same_json
from ..record.schema import Phases, Role
from ..subject.model import READ_WRITE
from . import expectations as oracle
from .ledger import Judged, Ledger
from .reply import Reply
from .rig import EndedError, Rig

__all__ = ["Repetition"]


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

    Attributes:
        soak: steps that have a long form take it: thousands of calls, messages or faults instead of some.
        rng: random numbers that only depend on the seed, the task, the role and the repetition.
        ledger: what the steps have shown so far.
        notes: a place where the steps can keep values.
        phases: of a recovery trial.
        ended_early: its last steps were not reached.
        inapplicable: why the steps found nothing to judge; None where they did.
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
    ) -> None:
        self.rep = rep
        self.role = role
        self.time_scale = time_scale
        self.soak = soak
        origin = f"{seed}/{task_id}/{role}/{rep}"
        self.ledger = Ledger(role, time_scale, item=task_id, origin=origin)
        # The same seed gives the same nonces, whatever ran before.
        self.rng = random.Random(origin)
        self.phases: Phases | None = None
        self.notes: dict[str, object] = {}
        self.ended_early = False
        self.inapplicable: str | None = None
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
            if at.running:
                await at.keep_journal()

    def witnessed(self, *findings: list[Finding]) -> None:
        """Take over findings of what was observed at the device."""
        self.ledger.witnessed(*findings)

    def finding(self, code: str, message: str, requirement: str | None = None, evidence: str | None = None) -> None:
        """Note a finding of the task itself."""
        self.ledger.finding(code, message, requirement, evidence)

    def not_applicable(self, reason: str) -> NoReturn:
        """End the repetition: the subject has nothing that the steps could judge.

        Args:
            reason: why, from what the subject file and the adapter's list of tools say alone, so that a stored history says the same.
        """
        self.inapplicable = reason
        raise EndedError

    # -- judging ------------------------------------------------------------------------------------------

    def succeeds(self, reply: Reply, *, requirement: str | None = None, **outputs: object) -> bool:
        """Expect success with these outputs, and return whether it was so; ``requirement`` as for ``expectations``."""
        return self.judge(reply, oracle.succeeded(reply, requirement=requirement, **outputs))

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

    def judge(self, reply: Reply, findings: list[Finding]) -> bool:
        """Take over what an expectation found about a reply; return whether it was met."""
        return self.ledger.judge(reply, findings)

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
