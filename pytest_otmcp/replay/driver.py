"""The driver of a trial on the stored history of an item: it looks up what was done and does nothing itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext

from ..core.errors import ExhaustedError, KitError, MeddledError, NoBindingError, SubjectError
from ..core.verdict import Status
from ..protocols.journal import Entries
from ..protocols.protocol import Declared
from ..record.reader import StoredItem
from ..record.schema import Around, Role, Sample
from ..session.canary import Leak
from ..subject.model import READ_WRITE
from ..trial.asked_for import AskedFor
from ..trial.driver import ItemHistory, SessionFacts
from ..trial.repetition import Repetition
from ..trial.rig import EndedError, Rig, adapter_name
from ..trial.task import Steps, Task, execute
from .device import DeviceHistory
from .player import Clock, RecordedAdapter, RecordedRepetition, ReplayItemState, StoredPlayer
from .reply import UNREADABLE, HistoryError, at_its_place

__all__ = ["ReplayDriver", "UnfinishedError"]


class UnfinishedError(Exception):
    """The history ends here, because the user ended the run."""


class ReplayDriver:
    """Driver that plays an item of a run record back.

    Args:
        item: of the record.
        task: the item's task.
        adapters: of the subject, by protocol.
        devices: of the run, in the state in which the item before this one left them.
        seed, time_scale, soak: of the run.

    Attributes:
        sample: the stored repetition that is being played back.
        objections: role and number of each repetition that does not fit the steps, to the reason.
    """

    def __init__(
        self,
        item: StoredItem,
        task: Task,
        *,
        adapters: Mapping[str, RecordedAdapter],
        devices: Mapping[str, DeviceHistory],
        seed: int,
        time_scale: float,
        soak: bool,
    ) -> None:
        self.objections: dict[tuple[str, int], str] = {}
        self.sample: Sample | None = None
        self._head = item.head
        self._task = task
        self._adapters = adapters
        self._devices = devices
        self._seed = seed
        self._time_scale = time_scale
        self._soak = soak
        self._clock = Clock(item.head["began_ns"])
        self._samples = item.samples()
        self._repetitions = 0
        self._around = list(item.head["around"])
        self._states: list[ReplayItemState] = []
        self._players: list[StoredPlayer] = []
        self._inspections = 0
        self._ended = item.head["ended"]

    def obstacle(self) -> tuple[Status, str] | None:
        """Return the recorded status and reason of an item for which nothing was done; None for any other item."""
        head = self._head
        status = Status(head["status"])
        if status in (Status.NOT_APPLICABLE, Status.NOT_TESTABLE) and not head["devices"] and not self._ended:
            return status, head["reason"] or ""
        return None

    def spent(self, what: str) -> AbstractContextManager[None]:
        """Measure nothing."""
        return nullcontext()

    async def prepare(self) -> None:
        """Take every device from the state in which the item before left it to the state in which this one found it."""
        problems = []
        for name, found in self._head["devices"].items():
            protocol = name.partition("@")[0]
            device = self._devices.get(found["device"])
            if device is None or protocol not in self._adapters or name != _rig_name(device):
                raise HistoryError(f"the run has no device {found['device']!r} for {name}")
            state = ReplayItemState(self._adapters[protocol], device, found)
            self._states.append(state)
            try:
                self._clock.passed(found["asked_ns"], found["seen_ns"], f"the first look at {name}", together=False)
                device.enter(found)
            except HistoryError as problem:
                problems.append(str(problem))
        if problems:
            raise HistoryError("; ".join(problems))
        missing = sorted(set(self._task.adapters) - {state.name for state in self._states})
        if missing and not self._ended:
            raise HistoryError(f"{' and '.join(missing)} did not take part")
        await self.open_sessions()

    def before(self) -> Sequence[tuple[str, Entries, Declared, AskedFor]]:
        """Return what had reached the devices while nobody called their adapters."""
        return [
            (state.protocol, state.found["before"], state.adapter.facts["lists"], state.history.cursor.asked_for)
            for state in self._states
            if state.found["quiet"]
        ]

    def repetition(self, rep: int, role: Role) -> Repetition:
        """Return the next stored repetition, ready to be played back."""
        part: Sample | Around
        if role == "task":
            self.sample = next(self._samples, None)
            if self.sample is None:
                raise self._end()
            self._repetitions += 1
            part = self.sample
        else:
            if not self._around:
                raise self._end()
            part = self._around.pop(0)
            if part["role"] != role:
                raise HistoryError(f"after {role} the task asks for, there is {part['role']}")
        taken = {(state.protocol, state.variant) for state in self._states}
        if any((entry["protocol"], entry.get("variant", READ_WRITE)) not in taken for entry in part["device"]):
            raise HistoryError(f"{role} has journal entries of a device that the item did not have")
        past = RecordedRepetition(part["calls"], part["observations"], self._clock)
        self._players = [StoredPlayer(state, past, part["device"]) for state in self._states]
        return Repetition(
            self._task.id,
            rep,
            role,
            seed=self._seed,
            time_scale=self._time_scale,
            soak=self._soak,
            suite=self._task.suite,
            rigs=map(Rig, self._players),
        )

    def _end(self) -> Exception:
        """Return the exception that says why no further repetition is stored."""
        ended, self._ended = self._ended, None
        if ended is None:
            if self._head["status"] == Status.INTERRUPTED:
                return UnfinishedError()
            return HistoryError(f"the history ends after {self._repetitions} repetitions and does not say why")
        message = ended["message"]
        if ended["fault_of"] == "subject":
            return SubjectError(ended["code"], message)
        if ended["fault_of"] == "binding":
            return NoBindingError(message)
        return {"exhausted": ExhaustedError, "meddled": MeddledError}.get(ended["code"], KitError)(message)

    async def perform(self, repetition: Repetition, steps: Steps) -> None:
        """Take the steps through the history."""
        for state in self._states:
            state.history.cursor.looked_through = False
        try:
            try:
                await execute(self._task, steps, repetition)
            except EndedError:
                repetition.ended_early = True
                for at in repetition.all:
                    if not at.device.running:
                        await at.start_device()
            await repetition.close_journals()
            for player in self._players:
                player.finish()
        except HistoryError as objection:
            self.objections[repetition.role, repetition.rep] = str(objection)
        except UNREADABLE as error:
            # An oracle has met data that no adapter and no device of the kit can have sent.
            self.objections[repetition.role, repetition.rep] = f"it cannot be judged ({at_its_place(error)})"
        for player in self._players:
            player.leave()
        for state in self._states:
            state.history.cursor.looked_through = True

    async def inspect(self) -> list[SessionFacts]:
        """Return what was remarkable about the sessions at this inspection.

        An item that ended early after its last steps raises the exception of that end instead.
        """
        if self._ended:
            raise self._end()
        self._close(renewed=False)
        return self._inspected()

    def told_at_start(self) -> list[SessionFacts]:
        """Return what was remarkable at this inspection."""
        return self._inspected()

    async def end_sessions(self) -> list[SessionFacts]:
        """End all sessions; return what was remarkable about them at this inspection."""
        for state in self._states:
            state.history.cursor.close_session()
        return self._inspected()

    def _inspected(self) -> list[SessionFacts]:
        self._inspections += 1
        return [
            SessionFacts(
                protocol=entry["protocol"],
                overflow=entry["overflow"],
                died=entry["died"],
                overstayed=entry["overstayed"],
                unknown_ids=tuple(entry["unknown_ids"]),
                repeated_ids=tuple(entry.get("repeated_ids", ())),
                too_deep=entry.get("too_deep", 0),
                stray_lines=entry["stray_lines"],
                first_stray=entry["first_stray"],
                leaks=tuple(Leak(**told) for told in entry.get("leaks", ())),
                tools_changed=entry.get("tools_changed"),
            )
            for entry in self._head["sessions"]
            if entry["inspection"] == self._inspections
        ]

    async def open_sessions(self) -> None:
        """Mark all sessions as open; where one was replaced, the record of the next repetition says so."""
        for state in self._states:
            state.history.cursor.connected = True

    async def close(self, *, renew: bool) -> None:
        """End the sessions that the bench has ended: those of an item that failed then, whatever is found now."""
        self._close(renewed=self._head["status"] == Status.FAIL)

    def _close(self, *, renewed: bool) -> None:
        for state in self._states:
            if (renewed and not state.history.cursor.hopeless) or state.variant != READ_WRITE:
                state.history.cursor.close_session()

    def leave(self, *, judged: bool) -> None:
        """End the item; the state of its devices is unknown from here on if it ended early or could not be judged.

        Args:
            judged: the item was played back to its end without an objection.
        """
        early = self._head["ended"] is not None or self._head["status"] in (Status.INTERRUPTED, Status.KIT_ERROR)
        met = {found["device"] for found in self._head["devices"].values()}
        for name, device in self._devices.items():
            if name in met:
                device.unknown = early or not judged
            elif early and device.facts["protocol"] in self._task.protocols:
                # It may have begun at the device, and ended before that could be noted.
                device.unknown = True

    def left_over(self) -> str | None:
        """Say what the history has beyond the task's end; None when it has nothing."""
        if self._ended or self._around or next(self._samples, None) is not None:
            return "the history has more than the task does"
        taken = {state.protocol for state in self._states}
        early = self._head["ended"] or self._head["status"] in (Status.INTERRUPTED, Status.KIT_ERROR)
        for remark in self._head["sessions"]:
            number = remark["inspection"]
            # An item that ended early may have ended in the midst of an inspection.
            if remark["protocol"] not in taken or not (early or 1 <= number <= self._inspections):
                return f"it has a remark about a session of {remark['protocol']} from inspection {number}, which there was not"
        if self._clock.now_ns > self._head["ended_ns"]:
            return f"it went on until {self._clock.now_ns} ns, but ended at {self._head['ended_ns']} ns"
        return None

    def timing_ms(self) -> Mapping[str, float]:
        """Return nothing: nothing is measured."""
        return {}

    def history(self) -> ItemHistory:
        """Return the driver's members of the item as the record has them already."""
        head = self._head
        return ItemHistory(
            worker=head["worker"],
            started_at=head["started_at"],
            finished_at=head["finished_at"],
            began_ns=head["began_ns"],
            ended_ns=head["ended_ns"],
            devices=head["devices"],
            sessions=head["sessions"],
        )


def _rig_name(device: DeviceHistory) -> str:
    return adapter_name(device.facts["protocol"], device.facts["variant"])
