"""Position of an adapter in the journal of its device: what has been taken, and what its session's oracles have seen. Pure.

A bench and the judging of a stored run again use the same object: both look at the journals in the same order.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TypeVar

from ..core.finding import Finding
from ..protocols.journal import judged
from ..protocols.registry import protocols
from ..protocols.session_oracle import SessionOracle
from ..record.schema import SessionProof, SessionStart
from .asked_for import AskedFor
from .ledger import Entry

__all__ = ["JournalCursor", "Oracle"]

Oracle = TypeVar("Oracle", bound=SessionOracle)


class JournalCursor:
    """Position of one adapter in the journal of its device.

    Args:
        protocol: of the adapter; its description names the session oracles.
        first: sequence number at which the journal begins for the adapter.

    Attributes:
        next: sequence number at which the next slice begins.
        missed: entries that were taken in an item that ended before it could keep them.
        fed: sequence number before which the session's oracles have seen everything.
        released: sequence number before which the device has forgotten everything.
        starts: how often the device was started again.
        connected: the adapter's session is open.
        looked_through: everything before ``next`` has been looked at, and since then nobody has called the adapter.
        proven: the operation that proved that the session talks to this device; None as long as nothing did.
        refused: the item in which the session could not be proven, and the reason; or None.
        preferred: the operation that proved any session of the adapter last.
        arrived: the device saw a client arrive since the session began.
        asked_for: what the adapter's calls have asked for, in every session.
    """

    def __init__(self, protocol: str, first: int = 0) -> None:
        self._kinds = protocols()[protocol].session_oracles
        self._arrival = protocols()[protocol].proof.arrival
        self._oracles: dict[type[SessionOracle], SessionOracle] = {}
        self._faults: list[Finding] = []
        self.next = first
        self.missed: list[Entry] = []
        self.fed = first
        self.released = first
        self.starts = 0
        self._sessions = 0
        self._began: int | None = None
        self.connected = False
        self.looked_through = False
        self.proven: str | None = None
        self.refused: tuple[str, str] | None = None
        self.preferred: str | None = None
        self.arrived = False
        self.asked_for = AskedFor()

    @property
    def hopeless(self) -> bool:
        """Neither this session nor one before it could be proven: another one would only say the same again."""
        return self.refused is not None and self.preferred is None

    @property
    def quiet(self) -> bool:
        """Nobody has called the connected adapter since ``next``: what it does from there on, it does by itself."""
        return self.connected and self.looked_through

    @property
    def proof(self) -> SessionProof | None:
        """How far the session is proven; None as long as none of the adapter was to be."""
        if (self.proven, self.preferred, self.refused) == (None, None, None):
            return None
        return {"proven": self.proven, "preferred": self.preferred, "refused": self.refused}

    def assume(self, proof: SessionProof | None) -> None:
        """Take over how far the session is proven."""
        known = proof or {"proven": None, "preferred": None, "refused": None}
        self.proven, self.preferred, self.refused = known["proven"], known["preferred"], known["refused"]

    @property
    def session(self) -> SessionStart | None:
        """Number of the adapter's last session, and the sequence number at which it began; None without a session."""
        return None if self._began is None else (self._sessions, self._began)

    def open_session(self, seq: int, number: int | None = None) -> None:
        """Begin a session at this sequence number; by default it is the next one."""
        self._sessions = self._sessions + 1 if number is None else number
        self._began = seq
        self.connected = True
        self._keep_faults()
        self._oracles = {
            kind: self._oracles[kind].renewed() if kind in self._oracles else kind() for kind in self._kinds
        }
        self.withdraw_proof()

    def close_session(self) -> None:
        """End the session; its oracles can still be asked about it."""
        self.connected = False

    def withdraw_proof(self) -> None:
        """Forget where the session leads: before anything else is written it has to be proven."""
        self.proven = self.refused = None
        self.arrived = False

    def restart(self) -> None:
        """Begin a journal that counts from 0 again, as that of a restarted device does."""
        self.starts += 1
        self.next = self.fed = self.released = 0
        self.withdraw_proof()
        if self._began is not None:
            self._began = 0
            self._keep_faults()
            self._oracles = {kind: oracle.restarted() for kind, oracle in self._oracles.items()}

    @property
    def began(self) -> int:
        """Sequence number at which the session's entries begin among those that are still to be taken."""
        return max(self.next, self._began or 0)

    def feed(self, entries: Iterable[Entry], until: int) -> None:
        """Show the session's oracles the entries that they have not seen, which are all before ``until``."""
        for entry in judged(entries):
            if self._began is not None and entry["seq"] >= max(self.fed, self._began):
                self.arrived = self.arrived or (self._arrival is not None and self._arrival(entry))
                for oracle in self._oracles.values():
                    oracle.feed(entry)
        self.fed = max(self.fed, until)

    def take(self, entries: Iterable[Entry], until: int) -> None:
        """Take a slice: the next one begins where this one ends."""
        self.feed(entries, until)
        self.next = until

    def note_failed(self, inputs: Mapping[str, object]) -> None:
        """Tell the session's oracles of a write that was reported as failed while the device was away."""
        for oracle in self._oracles.values():
            oracle.failed(inputs)

    def take_faults(self) -> list[Finding]:
        """Return what the session's oracles have found by themselves since they were last asked."""
        self._keep_faults()
        faults, self._faults = self._faults, []
        return faults

    def forget_faults(self) -> None:
        """Drop what has been found and not been asked for: it is of an item that ended before its time, and not the next one's."""
        self.take_faults()

    def _keep_faults(self) -> None:
        for oracle in self._oracles.values():
            self._faults += oracle.take_faults()

    def oracle(self, kind: type[Oracle]) -> Oracle:
        """Return the session's oracle of this kind, which has seen everything before ``fed``.

        Raises:
            LookupError: the protocol does not name it, or there never was a session.
        """
        found = self._oracles[kind]
        assert isinstance(found, kind)
        return found
