"""An adapter at its device in a repetition of the past: gives what the history has, and objects where it cannot be so.

Whatever the steps ask for must be what the history has next. A journal is checked to be without a gap: each slice has
consecutive sequence numbers and begins where the one before it ended.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, cast

from ..core.strict_json import same_json
from ..protocols.oracle import has
from ..subject.model import READ_WRITE, Binding
from ..trial.reply import Reply
from ..trial.rig import Entry, FreshSession, Rig, place_name
from .reply import HistoryError, recorded_reply, restored_bindings

__all__ = ["RecordedRepetition", "ReplayItemState", "ReplayRig"]


class ReplayItemState:
    """A station during one item, as its history has it.

    Attributes:
        before: the journal from the end of the last item that had the device to the beginning of this one.
        since: sequence number at which the next slice of the journal begins.
        past: the journal before that, as far as the history has it.
    """

    def __init__(self, station: Mapping[str, Any]) -> None:
        self.protocol: str = station["protocol"]
        self.variant: str = station["variant"]
        self.deadline_s: float = station["deadline_s"]
        self.endpoint: Mapping[str, str] = station["endpoint"]
        self.bindings: Mapping[str, list[Binding] | None] = restored_bindings(station["bindings"])
        self.unclaimed: list[str] = station["unclaimed"]
        self.probes: Mapping[str, Any] = station["probes"]
        self.lacks: list[str] = station["lacks"]
        self.blocking: list[str] = station["blocking"]
        self.accepting_ns: int = station["accepting_ns"]
        self.since: int = station["begin"]
        self.before: list[Entry] = list(station["before"])
        found = [entry.get("seq") for entry in self.before]
        if found != list(range(self.since - len(found), self.since)):
            raise HistoryError(f"what reached {self.protocol} before should end with entry {self.since - 1}: {found}")
        self.past: list[Entry] = list(station["earlier"])
        self.name = place_name(self.protocol, self.variant)
        self.running = True


class RecordedRepetition:
    """Calls and observations of one repetition, each to be had once."""

    def __init__(self, calls: Iterable[Mapping[str, Any]], observations: Iterable[Mapping[str, Any]]) -> None:
        self.calls = list(calls)
        self.observations = list(observations)

    def observation(self, at: str, what: str) -> Any:
        """The next one, which must be this one."""
        if not self.observations:
            raise HistoryError(f"the steps ask for {what} of {at}, the history has nothing further")
        entry = self.observations.pop(0)
        if entry.get("at") != at or what not in entry:
            found = " ".join(name for name in entry if name != "at")
            raise HistoryError(f"the steps ask for {what} of {at}, the history has {found} of {entry.get('at')}")
        return entry[what]

    def call(self, at: ReplayItemState, operation: str, inputs: Mapping[str, Any]) -> Mapping[str, Any]:
        """The call that the steps ask for: the next one, or, of concurrent ones, one of the next."""
        asked = f"{at.name} {operation}({_listed(inputs)})"
        if not self.calls:
            raise HistoryError(f"the steps ask for {asked}, the history has no further call")
        group = self.calls[0]["group"]
        for index, call in enumerate(self.calls):
            if call["group"] != group:
                break
            who = (call["adapter"], call["variant"], call["operation"])
            if who == (at.protocol, at.variant, operation) and same_json(call["inputs"], inputs):
                return self.calls.pop(index)
        first = self.calls[0]
        found = f"{first['adapter']} {first['operation']}({_listed(first['inputs'])})"
        raise HistoryError(f"the steps ask for {asked}, the history has {found}")


def _listed(inputs: Mapping[str, Any]) -> str:
    return ", ".join(f"{name}={value!r}" for name, value in inputs.items())


class ReplayRig(Rig):
    """An adapter at its device in one repetition of the past. Nothing is done, nothing is waited for."""

    def __init__(
        self,
        place: ReplayItemState,
        past: RecordedRepetition,
        device: Iterable[Mapping[str, Any]],
        images: list[dict[str, Any]],
    ) -> None:
        super().__init__(place.protocol, place.variant)
        self._place = place
        self._past = past
        self._images = images
        self._unread = [
            cast(Entry, {name: value for name, value in entry.items() if name not in ("protocol", "variant")})
            for entry in device
            if (entry["protocol"], entry.get("variant", READ_WRITE)) == (place.protocol, place.variant)
        ]

    def claims(self, facet: str) -> bool:
        return not {facet, facet.partition(".")[0]} & set(self._place.unclaimed)

    def blocks(self, operation: str) -> bool:
        return operation in self._place.blocking

    def probe(self, name: str) -> Any:
        return self._place.probes[name]

    def accepts_input(self, operation: str, name: str) -> bool:
        return f"{operation}.{name}" not in self._place.lacks

    @property
    def running(self) -> bool:
        return self._place.running

    @property
    def accepting_ns(self) -> int:
        return self._place.accepting_ns

    def finish(self) -> None:
        """The steps are over: so must this repetition's history be.

        Raises:
            HistoryError: something is left.
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
        """Bring the place to where the next repetition begins, also when this one could not be taken to its end."""
        for entry in self._past.observations:
            if entry.get("at") == self.name and isinstance(end := entry.get("end"), int):
                self._place.since = end
        self._place.past += self._unread
        self._unread = []
        self._place.running = True

    def _seen(self, what: str) -> Any:
        return self._past.observation(self.name, what)

    def _until(self, end: int) -> list[Entry]:
        """The slice of this repetition up to the entry before ``end``."""
        entries = self._unread[: max(0, end - self._place.since)]
        self._without_gap(entries, self._place.since, end)
        return entries

    def _without_gap(self, entries: list[Entry], begin: int, end: int) -> None:
        found = [entry.get("seq") for entry in entries]
        if found != list(range(begin, end)):
            wanted = f"{begin} to {end - 1}" if end > begin else "none"
            raise HistoryError(f"the journal of {self.name} should have the entries {wanted}, it has {found}")

    async def _perform(self, operation: str, inputs: Mapping[str, Any]) -> Reply:
        call = self._past.call(self._place, operation, inputs)
        return recorded_reply(
            call,
            cases=self._place.bindings.get(operation),
            endpoint=self._place.endpoint,
            deadline_s=self._place.deadline_s,
        )

    async def journal(self) -> list[Entry]:
        return self._until(self._seen("journal"))

    async def wait_for(self, *, timeout_s: float, count: int = 1, **match: Any) -> list[Entry]:
        seen = self._seen("wait")
        found = [entry for entry in self._unread if has(entry, **match)]
        if len(found) < seen:
            raise HistoryError(f"{seen} entries with {_listed(match)} were seen at {self.name}, there are {len(found)}")
        return found[:seen]

    async def session_journal(self) -> list[Entry]:
        begin, end = self._seen("session_journal")
        known = self._place.past + self._unread
        entries = [entry for entry in known if begin <= entry["seq"] < end]
        self._without_gap(entries, begin, end)
        return entries

    async def image(self) -> dict[str, Any]:
        index: int = self._seen("image")
        if not 0 <= index < len(self._images):
            raise HistoryError(f"there is no image {index}")
        image: dict[str, Any] = self._images[index]
        return image

    async def poke(self, **params: Any) -> None:
        pass

    async def tick(self, steps: int) -> None:
        pass

    async def _watch(self, seconds: float) -> None:
        pass

    async def _reconnecting(self) -> None:
        pass

    async def close_session(self) -> None:
        pass

    async def _stop(self) -> float:
        self._place.running = False
        took_ms: float = self._seen("stop")
        return took_ms

    async def start_device(self) -> float:
        seen = self._seen("start")
        place = self._place
        place.running, place.accepting_ns, place.since, place.past = True, seen["accepting_ns"], 0, []
        took_ms: float = seen["ms"]
        return took_ms

    async def _replace_session(self) -> FreshSession:
        return FreshSession(**self._seen("fresh_session"))

    async def take_slice(self) -> list[Entry]:
        end = self._seen("end")
        entries = self._until(end)
        place = self._place
        self._unread = self._unread[len(entries) :]
        place.past += entries
        place.since = end
        return entries
