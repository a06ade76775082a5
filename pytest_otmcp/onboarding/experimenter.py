"""The trial of guesses at a mock device; the proof is what the device saw, and its values in the answer."""

from __future__ import annotations

import json
import random
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import replace

from ..core.errors import NoBindingError
from ..core.strict_json import parse_strict
from ..plant.mock_device import MockDevice
from ..protocols.exercise import Asked
from ..protocols.journal import judged
from ..protocols.oracle import state_changing
from ..protocols.registry import protocols
from ..subject.addressing import mentions_address
from ..subject.answers import read_answer
from ..subject.model import Answering, Binding, placeholders
from ..trial.adapter_under_test import AdapterUnderTest
from ..trial.proving import ARRIVAL
from .evidence import Found, Sample, find, no_result, same_value, tells_failure
from .guess import Guess
from .proposal import Proposal, Shown

__all__ = ["Experiment", "Experimenter", "NotProvenError", "words_of"]

_TRIES = 4
"""Number of tools that are tried for an operation, the likeliest first."""

_LATE_S = 0.2
"""Seconds to wait for a late journal entry."""

_ADDRESSES = 3
"""Further addresses at which a binding is proven, where the protocol's exercise knows some."""

_SHOWN, _SAID = 60, 600
"""Characters that are shown of a value, and of an answer, which may have its reason at its end."""


Another = tuple[Shown, object]
"""What another call of the same tool showed, and a value that is known to be in its answer."""


class NotProvenError(Exception):
    """Nothing may be written: the session may talk to any device; the message says why."""


class Experimenter:
    """An experimenter that calls tools of one adapter at one mock device, and makes proposals from the results.

    Attributes:
        adapter: the adapter; what writes is tried in a process of its own, to which only what was proven has been said.
        device: the mock device.
        random: source of values that no adapter can know.
        longest_s: how long the longest call took that was answered.
        offsets: those with which tools were proven, after none.
        results: number of answers that are valid results of tool calls.
        invalid: what other answers were, and how often.
        proofs: further proofs that a session talks to the device; each returns the operation that proves it, or None.
    """

    def __init__(
        self,
        adapter: AdapterUnderTest,
        device: MockDevice,
        late: Mapping[str, object] | None = None,
        samples: Callable[[random.Random], Sequence[Asked]] | None = None,
    ) -> None:
        """Take an adapter that is configured for the device.

        Args:
            late, samples: see :class:`~pytest_otmcp.onboarding.pack.Pack`.
        """
        self.device = device
        self.random: random.Random = random.SystemRandom()
        self.longest_s = 0.0
        self.offsets: list[dict[str, int]] = [{}]
        self.results = 0
        self.invalid: Counter[str] = Counter()
        self.proofs: list[Callable[[], Awaitable[str | None]]] = []
        self.adapter = adapter
        self._late = late
        self._samples = samples
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
            if proposal.proven and proposal.offset not in self.offsets:
                self.offsets.append(proposal.offset)
            if self._merits(proposal) == (True, True, True):
                break
        chosen = max(tried, key=self._merits, default=None)
        for other in tried:
            if chosen is None or other is chosen:
                break
            if other.guess.tool != chosen.guess.tool:
                chosen.likelier.append(f"{other.guess.tool}: {other.evidence[0]}")
        return chosen

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
            proposal = await self._proof(guess, experiment)
        except (NotProvenError, NoBindingError) as problem:
            return Proposal(guess=guess, proven=False, evidence=[f"not tried, nothing was written: {problem}"])
        if proposal.proven:
            try:
                await (self._write_further if self._writing else self._vary)(proposal)
                await self._give_by_input(proposal, experiment)
                await self._provoke(proposal)
            except (NotProvenError, NoBindingError) as problem:
                proposal.caveats.append(f"nothing further was tried: {problem}")
        return proposal

    async def _proof(self, guess: Guess, experiment: Experiment) -> Proposal:
        is_first = not self._read and not self._writing
        proposal = await experiment(self, guess)
        self._refute(proposal)
        if is_first and not proposal.proven:
            # Many adapters load the library of their protocol, and connect, with the first call that needs it; on a busy machine that
            # may take longer than a call may.
            proposal = await experiment(self, guess)
            self._refute(proposal)
        return proposal

    async def _give_by_input(self, proposal: Proposal, experiment: Experiment) -> None:
        """Find the arguments that may be left to an input: those without which the tool does the same."""
        for argument, name in proposal.guess.stand_ins.items():
            without = {key: value for key, value in proposal.guess.arguments.items() if key != argument}
            if argument in proposal.guess.arguments:
                again = await experiment(self, replace(proposal.guess, arguments=without))
                self._refute(again)
                if not again.proven:
                    continue
            proposal.by_input[argument] = f"${name}"

    def _refute(self, proposal: Proposal) -> None:
        """Take back the proof of a call that the device has seen, and whose answer is no answer to it."""
        if not proposal.proven or (proposal.good is None and self._writing):
            return
        fault = None if proposal.good is None else no_result(proposal.good)
        if fault is not None:
            fault = f"the answer is no valid MCP: {fault}"
        elif proposal.good is None:
            fault = "there was no answer"
        elif not self._writing and not self._is_status(proposal.guess.operation) and tells_failure(proposal.good):
            fault = words_of(proposal.good)
        if fault is not None:
            proposal.proven = proposal.returned = False
            proposal.outputs.clear()
            proposal.evidence = [f"{proposal.evidence[0]}, but {fault}"]

    def _is_status(self, operation: str) -> bool:
        """Tell whether an operation tells a status, which need not be a good one."""
        return protocols()[self.adapter.adapter.protocol].operations[operation].status

    async def _vary(self, proposal: Proposal) -> None:
        """Read at further addresses, values of further types: what holds for one of them need not hold for all."""
        failed: dict[str, list[str]] = {}
        for asked in self._further(proposal.guess.operation):
            for poke in asked.pokes:
                await self.device.poke(**poke)
            shown = await self.call(proposal.guess, proposal.offset, **asked.inputs)
            if shown.message is None or no_result(shown.message) or tells_failure(shown.message):
                failed.setdefault(shown.words, []).append(_about(shown.told))
                if shown.message is None:
                    # Each further call might take as long as this one.
                    break
                continue
            for output, samples in proposal.samples.items():
                if output in asked.outputs:
                    expected = asked.outputs[output]
                    samples.append(Sample(message=shown.message, expected=expected, told=shown.told))
        for output in proposal.samples:
            self._place(proposal, output, alone=bool(failed))
        proposal.caveats += [f"with {'; '.join(places)}: {words}" for words, places in failed.items()]

    async def _write_further(self, proposal: Proposal) -> None:
        """Write to further targets, and values of further types; take the proof back where a tool says each time that it wrote, and never
        did."""
        exercise = protocols()[self.adapter.adapter.protocol].exercise
        if exercise is None:
            return
        calls = [exercise.write(self.random), *(exercise.every_write(self.random) if exercise.every_write else ())]
        done, claimed = 0, list[str]()
        for asked in (asked for asked in calls if asked.operation == proposal.guess.operation):
            shown = await self.perform(proposal, asked)
            if await self.was_done(asked, shown):
                done += 1
            elif shown.message is None or tells_failure(shown.message):
                proposal.caveats.append(f"with {_about(shown.told)} the device was not told it; {shown.words}")
                if shown.message is None:
                    break
            else:
                claimed.append(f"with {_about(shown.told)} the device was not told it, although {shown.words}")
        proposal.caveats += claimed
        if claimed and not done:
            proposal.proven = False
            proposal.evidence.insert(0, f"{proposal.evidence[0]}, but {claimed[0]}")

    async def was_done(self, asked: Asked, shown: Shown) -> bool:
        """Tell whether the device was told what a write asked for, or holds it where that shows."""
        if not asked.points:
            exercise = protocols()[self.adapter.adapter.protocol].exercise
            return exercise is not None and bool(exercise.done(shown.entries, asked))
        points = (await self.device.image())["points"]
        return all(same_value(points.get(name), value) for name, value in asked.points.items())

    def _further(self, operation: str) -> list[Asked]:
        """Return further calls of an operation whose good answers are known."""
        exercise = protocols()[self.adapter.adapter.protocol].exercise
        calls: list[Asked] = list(self._samples(self.random)) if self._samples is not None else []
        if exercise is not None:
            calls.append(exercise.read(self.random))
            calls += exercise.distinct(self.random, _ADDRESSES) if exercise.distinct is not None else ()
            calls += exercise.every_read(self.random) if exercise.every_read is not None else ()
        return [asked for asked in calls if asked.operation == operation]

    async def _prove_session(self, guess: Guess) -> None:
        """Make sure, before a tool may write, that the session talks to the mock device: with new random values.

        Raises:
            NotProvenError: it may talk to any device.
        """
        addressed = [proposal for proposal, _ in self._proofs() if mentions_address(proposal.guess.arguments)]
        if addressed and not mentions_address(guess.arguments) and self.adapter.adapter.connect is None:
            raise NotProvenError(
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
            for proves in self.proofs:
                if (operation := await proves()) is not None:
                    self.adapter.cursor.proven = operation
                    return
            if not any(map(self._says_more_than_arrival, self._read)) and await self._has_arrived():
                self.adapter.cursor.proven = ARRIVAL
                return
        finally:
            self._writing = True
        raise NotProvenError("no random value that was set at the mock device came back through the adapter")

    def _says_more_than_arrival(self, read: tuple[Proposal, Experiment]) -> bool:
        """Tell whether a tool brought a value back, or takes what its operation is about, such as a filter, and brought none: it may read
        somewhere else."""
        guess = read[0].guess
        known = protocols()[self.adapter.adapter.protocol].operations[guess.operation]
        return read[0].returned or bool(placeholders(guess.arguments) & {*known.inputs})

    async def _has_arrived(self) -> bool:
        """Tell whether a client arrived at the mock device since the session began, where that says who it is.

        A client that connects only for a call is given one that reads.
        """
        session, arrival = self.adapter.cursor.session, protocols()[self.adapter.adapter.protocol].proof.arrival
        if session is None or arrival is None:
            return False
        for proposal, experiment in self._read[:1]:
            await experiment(self, proposal.guess)
        return any(map(arrival, judged((await self.device.journal(session[1])).entries)))

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
        return Shown(
            message=message,
            entries=entries,
            words=failure if message is None else words_of(message),
            told=self._binding(guess, offset).told(inputs),
        )

    async def perform(self, proposal: Proposal, asked: Asked) -> Shown:
        """Write what is asked for, by a proposal.

        Raises:
            NotProvenError: nothing was written: the session may talk to any device.
        """
        self._writing = True
        for poke in asked.pokes:
            await self.device.poke(**poke)
        return await self.call(proposal.guess, proposal.offset, **asked.inputs)

    async def read(self, guess: Guess, arguments: Mapping[str, object]) -> Shown:
        """Call a tool that reads, for which no operation stands, with these arguments."""
        self._writing = False
        return await self.call(guess, {}, **arguments)

    async def write(self, guess: Guess, arguments: Mapping[str, object]) -> Shown:
        """Call a tool that writes, for which no operation stands, with these arguments.

        Raises:
            NotProvenError: nothing was written: the session may talk to any device.
        """
        self._writing = True
        return await self.call(guess, {}, **arguments)

    async def renew(self) -> None:
        """Start the adapter anew: a call before, such as one with bad arguments, may have left it unable to answer."""
        await self.adapter.close()
        await self.adapter.open()

    async def answer(
        self, guess: Guess, offset: Mapping[str, int], inputs: Mapping[str, object], *, writes: bool
    ) -> tuple[Mapping[str, object] | None, str]:
        """Call the guessed tool; return its answer, or None and why there is none."""
        arguments = self._binding(guess, offset).fill(inputs, self.adapter.endpoint)
        timeout_s = 1.2 * self.adapter.deadline_s
        began = time.monotonic()
        exchange = await self.adapter.call_tool(guess.tool, arguments, writes=writes, timeout_s=timeout_s)
        if exchange.response is None:
            return None, f"no answer ({exchange.failure})"
        self.longest_s = max(self.longest_s, time.monotonic() - began)
        try:
            message = parse_strict(exchange.response)
        except ValueError as error:
            self.invalid[f"an answer that is no strict JSON ({error})"] += 1
            return None, f"an answer that is no strict JSON ({error})"
        fault = no_result(message)
        if fault is None:
            self.results += 1
        else:
            self.invalid[fault] += 1
        return message, ""

    @staticmethod
    def _binding(guess: Guess, offset: Mapping[str, int]) -> Binding:
        return Binding(
            tool=guess.tool,
            arguments=guess.arguments,
            outputs={},
            answering=Answering(form="text"),
            when={},
            offset=offset,
            names={},
            convert=guess.convert,
        )

    @property
    def never_valid(self) -> str | None:
        """Why no answer at all was a valid result of a tool call; None where one was, or where there was no answer."""
        return None if self.results or not self.invalid else self.invalid.most_common(1)[0][0]

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
            seen: what the device saw, in words; where it is empty or None, every request that came.
        """
        if not seen:
            describe = protocols()[self.adapter.adapter.protocol].describe
            asked = (entry for entry in shown.entries if entry["request"] and entry["origin"] == "client")
            seen = "; ".join(dict.fromkeys(map(describe, asked)))
        evidence = [f"the device saw {seen}" if proven else f"the device saw {seen or 'nothing of it'}; {shown.words}"]
        return Proposal(
            guess=guess,
            proven=proven,
            evidence=evidence,
            offset=dict(offset or {}),
            good=shown.message,
            told=shown.told,
        )

    @staticmethod
    def provoke(proposal: Proposal, code: str, **inputs: object) -> None:
        """Have the tool called so that it has to fail, once everything else was tried: an adapter may break by it.

        Args:
            code: the error code that this failure should have.
        """
        proposal.provocations.append((code, inputs))

    async def _provoke(self, proposal: Proposal) -> None:
        """Make the calls that have to fail, and keep the answers for the rules that recognise failures."""
        for code, inputs in proposal.provocations:
            failing = await self.call(proposal.guess, proposal.offset, **inputs)
            if failing.message is not None:
                proposal.failures.append((code, failing.message))

    def locate(self, proposal: Proposal, output: str, expected: object, *, also: Another | None = None) -> None:
        """Look in the answer for a value that the device is known to have given.

        Args:
            also: what another call showed, and the value that has to be at the same place in its answer.
        """
        proposal.samples[output] = _samples(proposal, expected, also)
        self._place(proposal, output)

    def _place(self, proposal: Proposal, output: str, *, alone: bool = False) -> None:
        """Say where an output is in the answers of which its value is known, or that it is not to be found there.

        Args:
            alone: there may be one sample because all further calls failed: then a rule for its type alone proves nothing.
        """
        samples = proposal.samples[output]
        proposal.evidence[:] = [line for line in proposal.evidence if line not in proposal.placed]
        proposal.outputs.pop(output, None)
        proposal.caveats.clear()
        found = find(samples) if samples else None
        several = any(sample.told != samples[0].told for sample in samples)
        if found is None or ((found.missed or (alone and not several)) and not found.takes_everything):
            proposal.placed = [_not_placed(samples, found)]
        else:
            proposal.form = found.form
            proposal.outputs[output] = found.rule
            proposal.returned = True
            proposal.placed = [f"the value {_shown(samples[0].expected)} of the device was found there"]
            if several:
                proposal.placed = [f"{len(samples) - len(found.missed)} values of the device were found there"]
            proposal.caveats += [
                f"with {_about(sample.told)} the device holds {_shown(sample.expected)}, and the answer says "
                f"{_shown(sample.read(found.form, found.rule))}"
                for sample in found.missed
            ]
        proposal.evidence += proposal.placed

    def locate_echo(self, proposal: Proposal, output: str, expected: object, *, also: Another | None = None) -> None:
        """Look for a value that an answer may repeat; a structure shows that it is this value, a sentence does not.

        Args:
            also: see :meth:`locate`.
        """
        samples = _samples(proposal, expected, also)
        found = find(samples, ("structured", "json")) if samples else None
        if (
            found is not None
            and not found.missed
            and {*found.rule} == {"path"}
            and found.form == (proposal.form or found.form)
        ):
            proposal.form = found.form
            proposal.outputs[output] = found.rule


def _samples(proposal: Proposal, expected: object, also: Another | None) -> list[Sample]:
    """Return the answers of which a value is known; none where one of them is missing."""
    shown = [
        (proposal.good, proposal.told, expected),
        *(() if also is None else [(also[0].message, also[0].told, also[1])]),
    ]
    found = [
        Sample(message=message, expected=value, told=told) for message, told, value in shown if message is not None
    ]
    return found if len(found) == len(shown) else []


def _about(told: Mapping[str, object]) -> str:
    return ", ".join(f"{name} {value}" for name, value in told.items())


def _shown(value: object) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]} ..."


def _not_placed(samples: Sequence[Sample], found: Found | None) -> str:
    """Say which values were not found where the others are, or that none was found."""
    if found is None and len(samples) == 1:
        return f"the value {_shown(samples[0].expected)} was not found in the answer: fill in 'result'"
    if found is not None and not found.missed:
        return (
            f"the value {_shown(samples[0].expected)} was found with {_about(samples[0].told)} alone: fill in 'result'"
        )
    if found is None:
        values = ", ".join(dict.fromkeys(_shown(sample.expected) for sample in samples)) or "of the device"
        return f"no one place in the answers has the values {values}: fill in 'result'"
    missed = "; ".join(
        f"{_shown(sample.expected)}, with {_about(sample.told)}, {words_of(sample.message)}" for sample in found.missed
    )
    return f"what reads the value {_shown(samples[0].expected)} does not read {missed}: fill in 'result'"


Experiment = Callable[[Experimenter, Guess], Awaitable[Proposal]]
"""A function that tries a guess for one operation."""


def words_of(message: Mapping[str, object]) -> str:
    """Return how an answer began, and whether it is an error, in a few words."""
    _, text, is_error = read_answer(message, "text")
    said = " ".join(text.split())
    cut = "" if len(said) <= _SAID else f" ... ({len(said)} characters)"
    return f"it {'failed' if is_error else 'answered'}: {said[:_SAID]!r}{cut}"
