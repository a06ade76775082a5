"""The gate in front of everything that writes: a rig performs no writing operation before its session is proven.

A session is proven when a random value came through it from the mock device, or to it (``proving``), or when values of a real device came
through it (``field_proof``). One proof is enough until
the session or the device is another one, or the mock did not see a write that was answered with success.
"""

from __future__ import annotations

import random
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping

from ..core.errors import KitError, NoBindingError
from ..core.finding import Finding
from ..protocols.journal import JournalEntry
from ..protocols.oracle import state_changing
from ..protocols.proof import Proof
from ..protocols.registry import protocols
from .device_in_rig import DeviceInRig
from .field_proof import prove_by_reading
from .ledger import Ledger
from .player import Player
from .proving import prove, why_reachable
from .reply import Reply

__all__ = ["EndedError", "WriteGate"]


_LATE_S = 0.25


class EndedError(Exception):
    """End of the repetition: something that its next steps need, such as an answer, did not come.

    Those steps would show nothing, or only wait for one deadline after the other.
    """


class WriteGate(ABC):
    """The part of a rig that decides whether a write may be sent.

    Attributes:
        protocol: of the adapter, such as ``modbus``.
        subject: what the subject states of the adapter.
        device: at which the steps look, and which they change.
    """

    def __init__(self, player: Player) -> None:
        self.protocol = player.protocol
        self.subject = player.stated
        self.device = DeviceInRig(player)
        self._player = player
        self._cursor = player.cursor
        self._ledger: Ledger
        self._proofs = 0
        self._claimed = 0

    # -- for tasks and drivers ----------------------------------------------------------------------------

    async def prove(self) -> None:
        """Prove the session, unless it is proven already; for steps that write after the device was stopped, or that compare what it
        holds before a write with what it holds then: a proof sets values of its own.

        Raises:
            EndedError: it cannot be proven. The ledger has the reason, and the item ends.
        """
        # Which of several writes at the same time have succeeded when another one begins is a matter of chance.
        if self._claimed and not self._ledger.together:
            entries = await self.journal()
            if len(state_changing(entries)) < self._claimed:
                # What no device confirms may still be on its way when the call is answered.
                await self.pause(_LATE_S)
                entries = await self.journal()
            self._compare(entries)
        cursor = self._cursor
        if cursor.proven is not None:
            return
        if cursor.refused is not None:
            item, problem = cursor.refused
            self._refuse(f"as {item}: {problem}", cause=item, known=cursor.preferred is not None)
        if self._ledger.at_real:
            try:
                operation, problem = await prove_by_reading(self)
            except NoBindingError as gap:
                # A real device has what it has: that an adapter reads too little of it to be known is no fault of either.
                self._ledger.inapplicable = str(gap)
                raise EndedError from None
        else:
            self._proofs += 1
            rng = random.Random(f"{self._ledger.origin}/proof/{self._proofs}/{self.device.url}")
            operation, problem = await prove(self, rng, preferred=cursor.preferred, time_scale=self._ledger.time_scale)
        if operation is None:
            cursor.refused = (self._ledger.item, problem)
            self._refuse(problem, known=cursor.preferred is not None)
        cursor.proven = cursor.preferred = operation

    def doubt(self) -> None:
        """Have the session proven again before the next write: with a connection an adapter may lose what it has heard of the device."""
        self._cursor.proven = None

    def _refuse(self, problem: str, cause: str | None = None, *, known: bool = False) -> None:
        """End the item, because nothing may be written.

        Args:
            cause: the item that found it out.
            known: an earlier session of the adapter was proven.
        """
        code = "not_proven_again" if known else "not_proven"
        self._ledger.refused = Finding(code=code, message=f"{self.protocol}: {problem}", cause=cause)
        raise EndedError

    @property
    @abstractmethod
    def proof(self) -> Proof:
        """What shows that a session talks to the mock device."""

    # -- around each call ---------------------------------------------------------------------------------

    async def _before(self, operation: str) -> bool:
        """Let an operation pass when it writes nothing, or when the session is proven; return whether it writes."""
        known = protocols()[self.protocol].operations.get(operation)
        if known is None or not known.writes:
            return False
        if self.device.running:
            await self.prove()
        elif self._cursor.proven is None:
            raise KitError(f"the steps write while {self.protocol} is stopped, and did not prove the session before")
        else:
            await self._player.check_away()
            problem = await why_reachable(self, time_scale=self._ledger.time_scale)
            if problem is not None:
                message = f"{self.protocol}: {problem}"
                self._ledger.refused = Finding(code="answers_when_gone", message=message, requirement="REC-002")
                raise EndedError
            await self._player.check_away()
        return True

    def _after(self, reply: Reply) -> None:
        """Count a write that claims success."""
        if reply.success:
            self._claimed += 1

    def _compare(self, entries: Iterable[JournalEntry]) -> None:
        """Withdraw the proof when the mock saw fewer writes than claim success since the slice of these entries began."""
        seen = len(state_changing(list(entries)))
        if seen < self._claimed:
            self._cursor.withdraw_proof()
            # What is missing is the reason for one new proof, not for one before each write to come.
            self._claimed = seen

    # -- what a proof needs -------------------------------------------------------------------------------

    async def ask(self, operation: str, inputs: Mapping[str, object]) -> Reply:
        """Perform an operation of the proof; nothing is expected of its reply."""
        reply = await self._player.perform(operation, inputs)
        self._ledger.add_proof(reply, inputs)
        return reply

    def can_ask(self, operation: str, inputs: Mapping[str, object]) -> bool:
        """Tell whether the subject claims the operation and says how it is performed with these inputs."""
        return self.subject.claims(operation) and self._player.is_bound(operation, inputs)

    def can_ask_first(self, operation: str, inputs: Mapping[str, object]) -> bool:
        """Tell whether it is so without a handle that another operation yields."""
        return self.subject.claims(operation) and self._player.is_bound(operation, inputs, first=True)

    async def arrived(self) -> bool:
        """Tell whether the device has seen a client arrive since the session began."""
        await self._feed()
        return self._cursor.arrived

    @abstractmethod
    async def journal(self) -> list[JournalEntry]:
        """Return what reached the device, and what it answered, since this repetition began."""

    @abstractmethod
    async def _feed(self) -> None:
        """Show the session's oracles the entries that they have not seen."""

    async def pause(self, seconds: float) -> None:
        """Let time pass."""
        await self._player.pause(seconds)
