"""Plays the steps of a stored repetition: it returns what the history has, and objects where the history cannot be true.

Each call or observation that the steps ask for must be the next one in the history, and in the order of time.
"""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from itertools import takewhile
from typing import TYPE_CHECKING, Any, TypeVar, cast

from ..core.strict_json import same_json
from ..record.images import Images, restore_image
from ..record.schema import AdapterFacts, Call, DeviceEntry, HandshakeEra, ItemDevice, Observation
from ..subject.claims import Claims
from ..subject.model import READ_WRITE, Binding
from ..trial.alteration import Alteration
from ..trial.ledger import Ledger
from ..trial.player import OBSERVING, FreshSession, Player
from ..trial.reply import Reply
from ..trial.rig import EndedError, Entry, adapter_name
from ..trial.subject_in_rig import SubjectInRig
from .device import DeviceHistory
from .reply import HistoryError, recorded_reply

if TYPE_CHECKING:
    from ..trial.adapter_under_test import AdapterUnderTest

__all__ = ["Clock", "RecordedAdapter", "RecordedRepetition", "ReplayItemState", "StoredPlayer"]

T = TypeVar("T")


class RecordedAdapter:
    """An adapter as the run record has it, for all items.

    Args:
        protocol: of the adapter.
        facts: what the record says about it.
        claims: of the subject.
        bindings: of the operations that were used; None for an operation that a Python function performs.
        time_scale: of the run.
    """

    def __init__(
        self,
        protocol: str,
        facts: AdapterFacts,
        claims: Claims,
        bindings: Mapping[str, list[Binding] | None],
        time_scale: float,
    ) -> None:
        self.protocol = protocol
        self.facts = facts
        self.stated = SubjectInRig(protocol, facts, claims)
        self.bindings = bindings
        self.deadline_s = facts["deadline_s"] * time_scale


class Clock:
    """Time within one stored item: it only goes forward.

    Calls that were made at the same time have no order among them, nor have the looks at a device meanwhile.

    Args:
        now_ns: monotonic time at which the item began.
    """

    def __init__(self, now_ns: int) -> None:
        self._floor_ns = self.now_ns = now_ns
        self._together = False

    def passed(self, begun_ns: int, over_ns: int, what: str, *, together: bool) -> None:
        """Let the time of one call or observation pass.

        Args:
            begun_ns, over_ns: its begin and its end.
            what: its name in the error.
            together: it was made at the same time as others.

        Raises:
            HistoryError: its time lies before that of a call or an observation that precedes it in the history.
        """
        if not (together and self._together):
            self._floor_ns = self.now_ns
        self._together = together
        if begun_ns < self._floor_ns or over_ns < begun_ns:
            raise HistoryError(f"{what} is not of its time: {begun_ns} to {over_ns} ns, after {self._floor_ns} ns")
        self.now_ns = max(self.now_ns, over_ns)


class ReplayItemState:
    """An adapter and its device during one item, as the item's history has them."""

    def __init__(self, adapter: RecordedAdapter, history: DeviceHistory, found: ItemDevice) -> None:
        self.adapter = adapter
        self.history = history
        self.found = found
        self.protocol = adapter.protocol
        self.variant = history.facts["variant"]
        self.name = adapter_name(self.protocol, self.variant)
        self.images: Images = {}
        self.running = True


class RecordedRepetition:
    """Calls and observations of one stored repetition; each is handed out once."""

    def __init__(self, calls: Iterable[Call], observations: Iterable[Observation], clock: Clock) -> None:
        self.calls = list(calls)
        self.observations = list(observations)
        self._clock = clock

    def next_is(self, at: str, what: str) -> bool:
        """Tell whether the next observation is of the adapter ``at`` and shows ``what``."""
        return bool(self.observations) and self.observations[0]["at"] == at and what in self.observations[0]

    def observation(self, at: str, what: str, *others: str, together: bool) -> Observation:
        """Take the next observation, which must be of the adapter ``at`` and show ``what`` or one of ``others``.

        Raises:
            HistoryError: the next observation is another one, or there is none.
        """
        if not self.observations:
            raise HistoryError(f"the steps ask for {what} of {at}, the history has nothing further")
        seen = self.observations.pop(0)
        if seen["at"] != at or not any(name in seen for name in (what, *others)):
            found = " ".join(name for name in seen if name not in ("at", "asked_ns", "seen_ns"))
            raise HistoryError(f"the steps ask for {what} of {at}, the history has {found} of {seen['at']}")
        self._clock.passed(seen["asked_ns"], seen["seen_ns"], f"{what} of {at}", together=together)
        return seen

    def call(self, at: ReplayItemState, operation: str, inputs: Mapping[str, object], *, together: bool) -> Call:
        """Take the call that the steps ask for: the next call, or one of the next group of concurrent calls.

        Raises:
            HistoryError: the next call is another one, or there is none.
        """
        asked = f"{at.name} {operation}({_listed(inputs)})"
        if not self.calls:
            raise HistoryError(f"the steps ask for {asked}, the history has no further call")
        first = self.calls[0]
        made = takewhile(lambda one: one[1]["group"] == first["group"], enumerate(self.calls))
        equal = [
            (call["sent_ns"] or math.inf, index)
            for index, call in made
            if (call["adapter"], call["variant"], call["operation"]) == (at.protocol, at.variant, operation)
            and same_json(call["inputs"], inputs)
        ]
        if equal:
            # The history has calls in the order of their replies. The steps made equal ones in the order in which they were sent, and
            # may judge the first of them alone.
            call = self.calls.pop(min(equal)[1])
            self._pass(call, together=together)
            return call
        found = f"{first['adapter']} {first['operation']}({_listed(first['inputs'])})"
        raise HistoryError(f"the steps ask for {asked}, the history has {found}")

    def _pass(self, call: Call, *, together: bool) -> None:
        # A call that could not be sent has no time.
        if call["sent_ns"]:
            received_ns = call["sent_ns"] if call["received_ns"] is None else call["received_ns"]
            self._clock.passed(call["sent_ns"], received_ns, f"the call of {call['tool']}", together=together)


def _check_within(seen: Observation, what: str, *, ms: float, moment_ns: int | None = None) -> None:
    """Check that what lasted so long, and was at that moment, took place between question and answer.

    Raises:
        HistoryError: it cannot have.
    """
    begun_ns, over_ns = seen["asked_ns"], seen["seen_ns"]
    if moment_ns is not None and not begun_ns <= moment_ns <= over_ns:
        raise HistoryError(f"{what} was at {moment_ns} ns, which is not between {begun_ns} and {over_ns}")
    if not 0 <= round(ms * 1e6) <= over_ns - begun_ns:
        raise HistoryError(f"{what} took {ms} ms, there were {(over_ns - begun_ns) / 1e6} ms")


def _listed(inputs: Mapping[str, object]) -> str:
    return ", ".join(f"{name}={value!r}" for name, value in inputs.items())


class StoredPlayer(Player):
    """Hands out what the history of one repetition has. Nothing is done, and nothing is waited for."""

    def __init__(self, state: ReplayItemState, past: RecordedRepetition, device: Iterable[DeviceEntry]) -> None:
        super().__init__(state.protocol, state.variant, state.adapter.stated, state.history.cursor)
        self.name = state.name
        self._state = state
        self._past = past
        self._unread = [
            cast(Entry, {name: value for name, value in entry.items() if name not in ("protocol", "variant")})
            for entry in device
            if (entry["protocol"], entry.get("variant", READ_WRITE)) == (state.protocol, state.variant)
        ]

    def join(self, ledger: Ledger) -> None:
        super().join(ledger)
        if self._past.next_is(self.name, "session"):
            seen = self._seen("session")
            self._state.history.has_session(seen["session"], seen["seen_ns"])

    def finish(self) -> None:
        """Check, at the end of the steps, that the history of this repetition is used up.

        Raises:
            HistoryError: calls, observations or journal entries are left.
        """
        if self._past.calls:
            raise HistoryError(f"the history has {len(self._past.calls)} call(s) more than the steps make")
        if self._past.observations:
            raise HistoryError(
                f"the history has {len(self._past.observations)} observation(s) more than the steps make"
            )
        if self._unread:
            raise HistoryError(f"the journal of {self.name} has {len(self._unread)} entries beyond its end")

    def leave(self) -> None:
        """Bring the state to the begin of the next repetition, also when this one could not be played back to its end."""
        cursor = self.cursor
        for seen in self._past.observations:
            if seen["at"] == self.name:
                if "start" in seen:
                    self._state.history.restart()
                    self._state.history.accepting_ns = seen["start"]["accepting_ns"]
                elif "fresh_session" in seen:
                    self._open_session(seen["fresh_session"]["opened"], seen)
                elif (opened := seen.get("garbled")) is not None:
                    self._open_session(opened, seen)
                elif "handshake_era" in seen:
                    self._follow(seen)
                elif "end" in seen:
                    cursor.next = cursor.fed = seen["end"]
        self._state.running = True

    # -- looks --------------------------------------------------------------------------------------------

    def _seen(self, what: str, *others: str) -> Observation:
        seen = self._past.observation(self.name, what, *others, together=self._ledger.together)
        self.took_s = (seen["seen_ns"] - seen["asked_ns"]) / 1e9
        return seen

    async def ask(
        self, kind: str, question: Callable[[AdapterUnderTest], Awaitable[T]], *, spent: str = OBSERVING
    ) -> T:
        return cast(T, cast(Mapping[str, Any], self._seen(kind))[kind])

    async def act(self, deed: Callable[[AdapterUnderTest], Awaitable[None]]) -> None:
        pass

    async def pause(self, seconds: float) -> None:
        pass

    async def image(self) -> dict[str, object]:
        seen = self._seen("image", "changes")
        return restore_image(self._state.images, self.name, cast(Mapping[str, Any], seen))

    async def entries(self, kind: str, since: int) -> tuple[list[Entry], int]:
        seen = self._seen(kind)
        end = cast(Mapping[str, Any], seen)[kind]
        if kind == "session_journal":
            begin, end = end
            if begin != since:
                raise HistoryError(f"the session at {self.name} began at entry {since}, not at {begin}")
        return [entry for entry in self._until(end, seen["seen_ns"]) if entry["seq"] >= since], end

    def _until(self, end: int, seen_ns: int) -> list[Entry]:
        """Return the slice of this repetition up to the entry before ``end``."""
        entries = self._unread[: max(0, end - self.cursor.next)]
        self._state.history.looked(entries, end, seen_ns)
        return entries

    async def take_slice(self) -> list[Entry]:
        seen = self._seen("end")
        end = seen["end"]
        entries = self._until(end, seen["seen_ns"])
        self._unread = self._unread[len(entries) :]
        self._state.history.take(entries, end, seen["asked_ns"])
        return entries

    async def wait(self, match: Mapping[str, object], *, timeout_s: float, count: int) -> list[Entry]:
        seen = self._seen("wait")
        found = [
            entry
            for entry in self._unread
            if all(name in entry and dict(entry)[name] == value for name, value in match.items())
            and entry["t_ns"] <= seen["seen_ns"]
        ]
        if len(found) < seen["wait"]:
            raise HistoryError(
                f"{seen['wait']} entries with {_listed(match)} were seen at {self.name}, there are {len(found)}"
            )
        return found[: seen["wait"]]

    # -- calls --------------------------------------------------------------------------------------------

    async def perform(self, operation: str, inputs: Mapping[str, object], altered: Alteration | None = None) -> Reply:
        if self.cursor.session is None:
            raise HistoryError(f"{self.name} was called before the history has a session of it")
        try:
            call = self._past.call(self._state, operation, inputs, together=self._ledger.together)
        except HistoryError:
            # The call that should have yielded a handle has failed, and this one was not made.
            if self._ledger.failed and any(case.follows for case in self.bindings(operation) or ()):
                raise EndedError from None
            raise
        stated = None if altered is None else altered.as_record()
        if not same_json(call.get("altered"), stated):
            raise HistoryError(
                f"the steps change a call of {call['tool']} by {stated}, the history by {call.get('altered')}"
            )
        return recorded_reply(
            call,
            altered=altered,
            cases=self._state.adapter.bindings.get(operation),
            endpoint=self._state.history.facts["placeholders"],
            deadline_s=self._state.adapter.deadline_s,
        )

    async def perform_and_cancel(
        self,
        operation: str,
        inputs: Mapping[str, object],
        seen: Mapping[str, object],
        timeout_s: float,
        meanwhile: Callable[[], Awaitable[object]] | None,
    ) -> Reply:
        reply = await self.perform(operation, inputs)
        if meanwhile is not None:
            await meanwhile()
        return reply

    async def reconnecting(self) -> None:
        pass

    def bindings(self, operation: str) -> Sequence[Binding] | None:
        return self._state.adapter.bindings.get(operation, [])

    def is_bound(self, operation: str, inputs: Mapping[str, object], *, first: bool = False) -> bool:
        # An operation that was never used has no bindings in the record: then it was no way to prove anything.
        cases = self._state.adapter.bindings.get(operation, [])
        return cases is None or any(case.fits(inputs) and not (first and case.follows) for case in cases)

    def listing(self, operation: str, tool: str) -> Mapping[str, object] | None:
        adapter = self._state.adapter
        return None if adapter.bindings.get(operation) is None else adapter.facts["listing"].get(tool)

    # -- the device ---------------------------------------------------------------------------------------

    @property
    def addresses(self) -> list[tuple[str, int]]:
        endpoints = self._state.history.facts["endpoints"]
        return [(endpoint["host"], endpoint["port"]) for endpoint in endpoints if endpoint["port"]]

    @property
    def placeholders(self) -> Mapping[str, str]:
        return self._state.history.facts["placeholders"]

    @property
    def running(self) -> bool:
        return self._state.running

    @property
    def accepting_ns(self) -> int:
        return self._state.history.accepting_ns

    async def check_away(self) -> None:
        """It was so, or the item ended there."""

    async def stop(self) -> float:
        self._state.running = False
        seen = self._seen("stop")
        _check_within(seen, f"the stop of {self.name}", ms=seen["stop"])
        return seen["stop"]

    async def start(self) -> float:
        seen = self._seen("start")
        started = seen["start"]
        _check_within(seen, f"the start of {self.name}", ms=started["ms"], moment_ns=started["accepting_ns"])
        self._state.running, self._state.history.accepting_ns = True, started["accepting_ns"]
        self._state.history.restart()
        return started["ms"]

    # -- the session --------------------------------------------------------------------------------------

    async def replace_session(self) -> FreshSession:
        seen = self._seen("fresh_session")
        fresh = seen["fresh_session"]
        ended_ms = fresh["seconds"] * 1000
        _check_within(seen, f"the new session of {self.name}", ms=ended_ms, moment_ns=fresh["spawned_ns"])
        self._open_session(fresh["opened"], seen)
        return FreshSession(**fresh)

    async def start_garbled(self) -> bool:
        seen = self._seen("garbled")
        opened = seen["garbled"]
        if opened is None:
            return False
        self._open_session(opened, seen)
        return True

    async def start_without_certificate(self) -> bool:
        return await self.start_garbled()

    async def open_by_handshake(self) -> HandshakeEra:
        seen = self._seen("handshake_era")
        self._follow(seen)
        return seen["handshake_era"]

    def _follow(self, seen: Observation) -> None:
        found = seen["handshake_era"]
        if found["opened"] is not None:
            self._open_session(found["opened"], seen)
            if found["revision"] is None:
                self.cursor.close_session()

    async def close_handshake_era(self) -> None:
        self.cursor.close_session()

    async def close_session(self) -> None:
        self.cursor.close_session()

    def _open_session(self, seq: int, seen: Observation) -> None:
        self._state.history.open_session(seq, seen["seen_ns"])
