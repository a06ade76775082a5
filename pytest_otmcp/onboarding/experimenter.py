"""The trial of guesses at a mock device; the proof is what the device saw, and its values in the answer."""

from __future__ import annotations

import random
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence

from ..core.strict_json import parse_strict
from ..plant.mock_device import MockDevice
from ..protocols.journal import judged
from ..protocols.oracle import state_changing
from ..protocols.registry import protocols
from ..subject.addressing import mentions_address
from ..subject.answers import read_answer
from ..subject.model import Answering, Binding
from ..trial.adapter_under_test import AdapterUnderTest, NoBindingError
from .evidence import FORMS, Found, find
from .guess import Guess
from .proposal import Proposal, Shown

__all__ = ["Experiment", "Experimenter", "words_of"]

_TRIES = 4
"""Number of tools that are tried for an operation, the likeliest first."""

_LATE_S = 0.2
"""Seconds to wait for a late journal entry."""


Another = tuple[Shown, object]
"""What another call of the same tool showed, and a value that is known to be in its answer."""


class _NotProvenError(Exception):
    """Nothing may be written: the session may talk to any device; the message says why."""


class Experimenter:
    """An experimenter that calls tools of one adapter at one mock device, and makes proposals from the results.

    Attributes:
        adapter: the adapter; what writes is tried in a process of its own, to which only what was proven has been said.
        device: the mock device.
        random: source of values that no adapter can know.
        longest_s: how long the longest call took that was answered.
    """

    def __init__(self, adapter: AdapterUnderTest, device: MockDevice, late: Mapping[str, object] | None = None) -> None:
        """Take an adapter that is configured for the device.

        Args:
            late: a journal entry that may follow the answer to a call; see :class:`~pytest_otmcp.onboarding.pack.Pack`.
        """
        self.device = device
        self.random: random.Random = random.SystemRandom()
        self.longest_s = 0.0
        self.adapter = adapter
        self._late = late
        self._read: list[tuple[Proposal, Experiment]] = []
        self._writing = False

    async def best(self, guesses: list[Guess], experiment: Experiment, *, writes: bool) -> Proposal | None:
        """Return the proposal for the first guess that the device confirms and that lacks nothing, else the one that lacks least.

        Args:
            writes: the operation writes: nothing is tried before a read has proven that the adapter talks to the mock device.
        """
        self._writing = writes
        tried: list[Proposal] = []
        for variation in (variation for guess in guesses[:_TRIES] for variation in guess.variations()):
            proposal = await self._try(variation, experiment)
            if not writes and not variation.missing:
                self._read.append((proposal, experiment))
            tried.append(proposal)
            if self._merits(proposal) == (True, True, True):
                return proposal
        return max(tried, key=self._merits, default=None)

    def _merits(self, proposal: Proposal) -> tuple[bool, bool, bool]:
        """Return what speaks for a proposal, most important first."""
        needed = protocols()[self.adapter.adapter.protocol].operations[proposal.guess.operation].needed
        return proposal.proven, proposal.proven and proposal.whole, proposal.proven and {*needed} <= {*proposal.outputs}

    async def _try(self, guess: Guess, experiment: Experiment) -> Proposal:
        if guess.missing:
            lacking = ", ".join(guess.missing)
            return Proposal(guess=guess, proven=False, evidence=[f"not tried: no idea what to give for {lacking}"])
        try:
            if self._writing:
                await self._prove_session(guess)
            return await experiment(self, guess)
        except (_NotProvenError, NoBindingError) as problem:
            return Proposal(guess=guess, proven=False, evidence=[f"not tried, nothing was written: {problem}"])

    async def _prove_session(self, guess: Guess) -> None:
        """Make sure, before a tool may write, that the session talks to the mock device: with new random values.

        Raises:
            _NotProvenError: it may talk to any device.
        """
        addressed = [proposal for proposal, _ in self._proofs() if mentions_address(proposal.guess.arguments)]
        if addressed and not mentions_address(guess.arguments) and self.adapter.adapter.connect is None:
            raise _NotProvenError(
                f"{addressed[0].guess.tool} is told with each call where the device is, this tool is not"
            )
        await self.adapter.open()
        if self.adapter.cursor.proven is not None:
            return
        self._writing = False
        try:
            for proposal, experiment in self._proofs():
                again = await experiment(self, proposal.guess)
                if again.returned or (again.proven and not proposal.returned):
                    self.adapter.cursor.proven = proposal.guess.operation
                    return
        finally:
            self._writing = True
        raise _NotProvenError("no random value that was set at the mock device came back through the adapter")

    def _proofs(self) -> list[tuple[Proposal, Experiment]]:
        """Return the experiments that prove a session: those through which a random value came.

        Where no tool gives values at all, it has to do that the device saw a call.
        """
        returned = [tried for tried in self._read if tried[0].returned]
        operations = protocols()[self.adapter.adapter.protocol].operations
        giving = [tried for tried in self._read if not operations[tried[0].guess.operation].status]
        return returned or ([] if giving else [tried for tried in self._read if tried[0].proven])

    async def call(self, guess: Guess, offset: Mapping[str, int], **inputs: object) -> Shown:
        """Call the guessed tool and read what reached the device."""
        adapter = self.adapter
        await adapter.open()
        if self._writing and adapter.cursor.proven is None:
            await self._prove_session(guess)
        since = await self.device.mark()
        message, failure = await self.answer(guess, offset, inputs, writes=self._writing)
        if self._late is not None:
            await self.device.wait(since, dict(self._late), timeout_s=_LATE_S)
        entries = judged((await self.device.journal(since)).entries)
        if self._writing and not state_changing(entries):
            # Where did it go?
            adapter.cursor.withdraw_proof()
        return Shown(message=message, entries=entries, words=failure if message is None else words_of(message))

    async def answer(
        self, guess: Guess, offset: Mapping[str, int], inputs: Mapping[str, object], *, writes: bool
    ) -> tuple[Mapping[str, object] | None, str]:
        """Call the guessed tool; return its answer, or None and why there is none."""
        binding = Binding(
            tool=guess.tool,
            arguments=guess.arguments,
            outputs={},
            answering=Answering(form="text"),
            when={},
            offset=offset,
            names={},
            convert=guess.convert,
        )
        arguments = binding.fill(inputs, self.adapter.endpoint)
        timeout_s = 1.2 * self.adapter.deadline_s
        began = time.monotonic()
        exchange = await self.adapter.call_tool(guess.tool, arguments, writes=writes, timeout_s=timeout_s)
        if exchange.response is None:
            return None, f"no answer ({exchange.failure})"
        self.longest_s = max(self.longest_s, time.monotonic() - began)
        try:
            return parse_strict(exchange.response), ""
        except ValueError as error:
            return None, f"an answer that is no strict JSON ({error})"

    def propose(
        self,
        guess: Guess,
        shown: Shown,
        *,
        proven: bool,
        seen: str | None = None,
        offset: Mapping[str, int] | None = None,
    ) -> Proposal:
        """Make a proposal from a guess and the observations of its call.

        Args:
            seen: what the device saw, in words; empty for nothing. None: every request that came.
        """
        if seen is None:
            describe = protocols()[self.adapter.adapter.protocol].describe
            seen = "; ".join(dict.fromkeys(describe(entry) for entry in shown.entries if entry["request"]))
        evidence = [f"the device saw {seen}" if proven else f"the device saw {seen or 'nothing of it'}; {shown.words}"]
        return Proposal(guess=guess, proven=proven, evidence=evidence, offset=dict(offset or {}), good=shown.message)

    async def provoke(self, proposal: Proposal, code: str, **inputs: object) -> None:
        """Call the tool so that it has to fail, and keep the answer for the rules that recognise failures.

        Args:
            code: the error code that this failure should have.
        """
        failing = await self.call(proposal.guess, proposal.offset, **inputs)
        if failing.message is not None:
            proposal.failures.append((code, failing.message))

    def locate(self, proposal: Proposal, output: str, expected: object, *, also: Another | None = None) -> None:
        """Look in the answer for a value that the device is known to have given.

        Args:
            also: what another call showed, and the value that has to be at the same place in its answer.
        """
        found = _find(proposal, expected, also)
        if found is None:
            proposal.evidence.append(f"the value {str(expected)[:60]} was not found in the answer: fill in 'result'")
            return
        proposal.form = found.form
        proposal.outputs[output] = found.rule
        proposal.returned = True
        proposal.evidence.append(f"the value {str(expected)[:60]} of the device was found there")

    def locate_echo(self, proposal: Proposal, output: str, expected: object, *, also: Another | None = None) -> None:
        """Look for a value that an answer may repeat; a structure shows that it is this value, a sentence does not.

        Args:
            also: see :meth:`locate`.
        """
        found = _find(proposal, expected, also, ("structured", "json"))
        if found is not None and set(found.rule) == {"path"} and found.form == (proposal.form or found.form):
            proposal.form = found.form
            proposal.outputs[output] = found.rule


def _find(proposal: Proposal, expected: object, also: Another | None, forms: Sequence[str] = FORMS) -> Found | None:
    """Return the place of a value in the answer to a call; None where there is none, or no answer."""
    if proposal.good is None or (also is not None and also[0].message is None):
        return None
    another = None if also is None or also[0].message is None else (also[0].message, also[1])
    return find(proposal.good, expected, forms, also=another)


Experiment = Callable[[Experimenter, Guess], Awaitable[Proposal]]
"""A function that tries a guess for one operation."""


def words_of(message: Mapping[str, object]) -> str:
    """Return how an answer began, and whether it is an error, in a few words."""
    _, text, is_error = read_answer(message, "text")
    return f"it {'failed' if is_error else 'answered'}: {' '.join(text.split())[:160]!r}"
