"""Whose connection is whose: the adapter's under test, that of a session which is over, or a stranger's.

A witness tells which process was at the other end of a connection when it was accepted. Whose process that is, is decided here:
the kit has started the adapter, and gave it a random token in its environment, by which a descendant is recognised that has
lost its parents. What a device saw of others accuses nobody and proves nothing.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from ..core.journal_entry import OwnerProcess
from ..protocols.journal import JournalEntry
from ..protocols.oracle import has

__all__ = ["TOKEN_VARIABLE", "Peer", "PeerProcess", "Sessions", "new_token", "process_told"]

TOKEN_VARIABLE = "OTMCP_SESSION"  # noqa: S105  (it tells processes apart and protects nothing)
"""Environment variable of an adapter's process: which session it belongs to."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PeerProcess:
    """A process that has a connection, as a witness found it.

    Attributes:
        pid: its number.
        name: of its program.
        ancestors: numbers of its parent, of the parent's parent, and so on.
        token: value of :data:`TOKEN_VARIABLE` in its environment.
        contained: it is in another namespace of processes than the witness. As a descendant of the adapter's it is the adapter's;
            without a parent that is known it may be one that a service has started for the adapter.
    """

    pid: int
    name: str
    ancestors: tuple[int, ...]
    token: str | None
    contained: bool = False


@dataclass(slots=True, kw_only=True)
class Peer:
    """The other end of a connection.

    Attributes:
        accepted_ns: monotonic; when the connection was accepted.
        process: that had it then; None when that cannot be known.
        spoke: sequence number of its first message that is one of the protocol; None as long as there is none.
        ended: sequence number of its end; None as long as there is none.
    """

    accepted_ns: int
    process: PeerProcess | None
    spoke: int | None = None
    ended: int | None = None


def process_told(told: Mapping[str, Any] | None) -> PeerProcess | None:
    """Return a process of which a mock tells; None if it knows of none."""
    return None if told is None else PeerProcess(**{**told, "ancestors": tuple(told["ancestors"])})


@dataclass(slots=True, kw_only=True)
class _Session:
    began_ns: int
    pid: Callable[[], int | None]
    ended_ns: int | None = None


_given: set[str] = set()
"""Tokens of all sessions of this process, at whichever device."""


def new_token() -> str:
    """Return a token for the process of one session."""
    _given.add(token := secrets.token_hex(16))
    return token


class Sessions:
    """The sessions of the adapters that a device is there for."""

    def __init__(self) -> None:
        self._by_token: dict[str, _Session] = {}
        self._expected = False

    def expect(self) -> None:
        """Expect the adapter under test: whoever it is not, is a stranger from now on.

        Who uses a device without an adapter under test, such as a test of the user's, is its client.
        """
        self._expected = True

    def begin(self, token: str, pid: Callable[[], int | None]) -> None:
        """Begin a session, before its process is started.

        Args:
            token: that the process has in its environment, see :func:`new_token`.
            pid: returns the number of the process, None as long as there is none.
        """
        self._by_token[token] = _Session(began_ns=time.monotonic_ns(), pid=pid)

    def end(self, token: str) -> None:
        """End a session: its process is gone, and what comes of its connections from now on is of a session that is over."""
        session = self._by_token[token]
        session.ended_ns = time.monotonic_ns()
        number = session.pid()
        # What knows the number may be the whole adapter; a run with fresh sessions would keep every one of them.
        session.pid = lambda: number

    def attribute(self, entries: Iterable[JournalEntry], peers: Mapping[int, Peer]) -> list[JournalEntry]:
        """Say of each entry of a client's connection whose it is.

        Args:
            peers: number of a connection to what is known of its other end.
        """
        return [self._attributed(entry, peers.get(entry["connection"])) for entry in entries]

    async def wait(
        self,
        look: Callable[[int, float], Awaitable[list[JournalEntry]]],
        match: Mapping[str, object],
        *,
        count: int,
        timeout_s: float,
    ) -> list[JournalEntry]:
        """Wait for entries that a witness cannot tell apart: it does not know whose they are.

        Args:
            look: returns the attributed entries that have the fields of ``match`` but its ``origin``, as soon as there are so
                many, or those that there are after so many seconds.
        """
        end = time.monotonic() + timeout_s
        others = 0
        while True:
            found = await look(count + others, max(0.0, end - time.monotonic()))
            wanted = [entry for entry in found if has(entry, **match)]
            if len(wanted) >= count or len(found) < count + others:
                return wanted
            others = len(found) - len(wanted)

    def _attributed(self, entry: JournalEntry, peer: Peer | None) -> JournalEntry:
        if peer is None or entry["origin"] != "client":
            return entry
        entry, found = entry.copy(), peer.process
        session = None if found is None else self._session(found, peer.accepted_ns)
        if found is not None and found.contained and session is None and found.token not in _given:
            # Of an adapter in a container of its own nobody knows it. One that the kit has started for another device is known.
            found = None
        if found is None:
            # What cannot be known counts for the adapter as far as it speaks the protocol.
            entry["origin"] = "client" if peer.spoke is not None and peer.spoke <= entry["seq"] else "unknown"
        elif session is not None:
            over = session.ended_ns is not None and entry["t_ns"] > session.ended_ns
            entry["origin"] = "former" if over else "client"
        elif self._expected:
            entry["origin"] = "stranger"
        if found is not None and (entry["kind"] == "CONNECTED" or entry["origin"] != "client"):
            entry["process"] = OwnerProcess(pid=found.pid, name=found.name)
        return entry

    def owns(self, process: PeerProcess) -> bool:
        """Tell whether a process that runs now is, or descends from, an adapter's."""
        return self._session(process, time.monotonic_ns()) is not None

    def _session(self, process: PeerProcess, accepted_ns: int) -> _Session | None:
        for session in self._by_token.values():
            lived = session.began_ns <= accepted_ns <= (session.ended_ns or accepted_ns)
            # Numbers of processes come again: only one that lived then is meant.
            if lived and session.pid() in (process.pid, *process.ancestors):
                return session
        # Only what has lost its parents is known by its token, which whoever was told it can give another.
        return None if process.token is None else self._by_token.get(process.token)
