"""The stored history of an item as the stage of a trial: what happened is looked up, nothing is done."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from ..core.errors import KitError, SubjectError
from ..core.verdict import Status
from ..protocols.journal import Entries
from ..record.images import restored_images
from ..trial.adapter_under_test import NoBindingError
from ..trial.driver import SessionFacts
from ..trial.repetition import Repetition
from ..trial.rig import EndedError
from ..trial.task import Steps, Task, execute
from .reply import UNREADABLE, HistoryError
from .rig import RecordedRepetition, ReplayItemState, ReplayRig

__all__ = ["ReplayDriver", "UnfinishedError"]


class UnfinishedError(Exception):
    """The history is over, because the user ended the run."""


class ReplayDriver:
    """Plays an item of a run record back.

    Args:
        item: as ``run.json`` has it.
        task: the item's task.
        seed, time_scale: of the run.

    Attributes:
        objections: role and number of a repetition that the steps cannot be taken through, to the reason.
    """

    def __init__(self, item: Mapping[str, Any], task: Task, *, seed: int, time_scale: float) -> None:
        self.objections: dict[tuple[str, int], str] = {}
        self._item = item
        self._history: Mapping[str, Any] = item["history"]
        self._task = task
        self._seed = seed
        self._time_scale = time_scale
        self._images: list[dict[str, Any]] = []
        self._places: list[ReplayItemState] = []
        self._around = list(self._history["around"])
        self._other_calls = list(item["other_calls"])
        self._other_device = list(item["other_device"])
        self._inspections = 0
        self._ended = self._history["ended"]

    def obstacle(self) -> tuple[Status, str] | None:
        """What the record says, of an item that nothing was done for."""
        status = Status(self._item["status"])
        if status in (Status.NOT_APPLICABLE, Status.NOT_TESTABLE) and not self._history["stations"] and not self._ended:
            return status, self._item["reason"]
        return None

    def spent(self, what: str) -> AbstractContextManager[None]:
        """Nothing is measured."""
        return nullcontext()

    async def prepare(self) -> None:
        """Look at what there is."""
        try:
            self._images = restored_images(self._history["images"])
        except UNREADABLE as error:
            raise HistoryError(f"the images of the devices cannot be restored ({error!r})") from None
        self._places = [ReplayItemState(station) for station in self._history["stations"]]
        missing = sorted(set(self._task.adapters) - {place.name for place in self._places})
        if missing and not self._ended:
            raise HistoryError(f"{' and '.join(missing)} did not take part")

    def before(self) -> Sequence[tuple[str, Entries]]:
        """What had reached the devices since the last item that had them."""
        return [(place.protocol, place.before) for place in self._places]

    def repetition(self, rep: int, role: str) -> Repetition:
        """The next execution of steps that is stored."""
        if role == "task":
            samples = self._item["samples"]
            if rep >= len(samples):
                raise self._end()
            calls, device, seen = samples[rep]["calls"], samples[rep]["device"], samples[rep]["observations"]
        else:
            if not self._around:
                raise self._end()
            part = self._around.pop(0)
            if part["role"] != role:
                raise HistoryError(f"after {role} the task asks for, there is {part['role']}")
            calls, self._other_calls = _cut(self._other_calls, part["calls"])
            device, self._other_device = _cut(self._other_device, part["entries"])
            seen = part["observations"]
        past = RecordedRepetition(calls, seen)
        return Repetition(
            self._task.id,
            rep,
            role,
            seed=self._seed,
            time_scale=self._time_scale,
            places=[ReplayRig(place, past, device, self._images) for place in self._places],
        )

    def _end(self) -> Exception:
        """Why there is no more."""
        ended, self._ended = self._ended, None
        if ended is None:
            if self._item["status"] == Status.INTERRUPTED:
                return UnfinishedError()
            return HistoryError(f"the history ends after {len(self._item['samples'])} repetitions and does not say why")
        message = str(ended["message"])
        if ended["fault_of"] == "subject":
            return SubjectError(ended["code"], message)
        return NoBindingError(message) if ended["fault_of"] == "binding" else KitError(message)

    async def perform(self, repetition: Repetition, steps: Steps) -> None:
        """Take the steps through the history."""
        try:
            try:
                await execute(steps, repetition)
            except EndedError:
                for at in repetition.all:
                    if not at.running:
                        await at.start_device()
            await repetition.close_journals()
            for at in repetition.all:
                if isinstance(at, ReplayRig):
                    at.finish()
        except HistoryError as objection:
            self.objections[repetition.role, repetition.rep] = str(objection)
        except UNREADABLE as error:
            # An oracle has met what no adapter and no device of the kit ever said.
            self.objections[repetition.role, repetition.rep] = f"it cannot be judged ({error!r})"
        for at in repetition.all:
            if isinstance(at, ReplayRig):
                at.leave()

    async def inspect(self) -> list[SessionFacts]:
        """What was remarkable then; or how the item ended, when that was after its last steps."""
        if self._ended:
            raise self._end()
        return self._inspected()

    async def end_sessions(self) -> list[SessionFacts]:
        """What was remarkable then."""
        return self._inspected()

    def _inspected(self) -> list[SessionFacts]:
        self._inspections += 1
        return [
            SessionFacts(
                protocol=entry["protocol"],
                overflow=entry["overflow"],
                died=entry["died"],
                unknown_ids=tuple(entry["unknown_ids"]),
                stray_lines=entry["stray_lines"],
                first_stray=entry["first_stray"],
            )
            for entry in self._history["sessions"]
            if entry["inspection"] == self._inspections
        ]

    async def open_sessions(self) -> None:
        """Nothing."""

    async def close(self) -> None:
        """Nothing."""

    def left_over(self) -> str | None:
        """What the history has beyond the task's end."""
        if self._ended or self._around or self._other_calls or self._other_device:
            return "the history has more than the task does"
        return None

    def timing_ms(self) -> Mapping[str, float]:
        """Nothing."""
        return {}

    def history(self) -> dict[str, Any]:
        """Nothing: it is there already."""
        return {}


def _cut(values: list[Any], count: int) -> tuple[list[Any], list[Any]]:
    return values[:count], values[count:]
