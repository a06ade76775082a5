"""What carries out the steps of a repetition at one adapter: a running adapter and device, or the history that a run has of them.

The steps are the same for both, and so is everything that is made of what was seen (``rig``). ``live_player`` asks and notes what it was
answered; ``replay.player`` hands out what was noted.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from ..record.schema import HandshakeEra
from ..subject.model import Binding
from .alteration import Alteration
from .cursor import JournalCursor
from .ledger import Entry, Ledger
from .reply import Reply
from .subject_in_rig import SubjectInRig

if TYPE_CHECKING:
    from .adapter_under_test import AdapterUnderTest

__all__ = ["OBSERVING", "FreshSession", "Player"]

T = TypeVar("T")

OBSERVING = "observing the device"
"""What the time of a look is spent on, unless it is a call of a tool."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FreshSession:
    """A session that replaced another one.

    Attributes:
        spawned_ns: monotonic; when its process was started.
        opened: sequence number of the device's journal at which it began.
        ended: how the process before it ended: ``exited``, ``terminated``, ``killed``; None when there was no process.
        seconds: how long the end took.
    """

    spawned_ns: int
    opened: int
    ended: str | None
    seconds: float


class Player(ABC):
    """One adapter at its device, for one repetition.

    Args:
        protocol, variant: the adapter whose session it is, such as ``modbus`` and ``rw``.
        stated: what the subject states of the adapter.
        cursor: position of the adapter in the journal of its device.

    Attributes:
        took_s: seconds between question and answer of the last look.
    """

    def __init__(self, protocol: str, variant: str, stated: SubjectInRig, cursor: JournalCursor) -> None:
        self.protocol = protocol
        self.variant = variant
        self.stated = stated
        self.cursor = cursor
        self.took_s = 0.0
        self._ledger: Ledger

    def join(self, ledger: Ledger) -> None:
        """Note what is seen in the ledger of a repetition from now on."""
        self._ledger = ledger

    # -- looks --------------------------------------------------------------------------------------------

    @abstractmethod
    async def ask(
        self, kind: str, question: Callable[[AdapterUnderTest], Awaitable[T]], *, spent: str = OBSERVING
    ) -> T:
        """Return what the answer to a question is, or was: a look at the adapter that needs no state.

        Args:
            kind: the member of an observation that has the answer.
            spent: what its time counts as.
        """

    @abstractmethod
    async def act(self, deed: Callable[[AdapterUnderTest], Awaitable[None]]) -> None:
        """Do something that is not seen by itself; in a stored history it was done."""

    @abstractmethod
    async def pause(self, seconds: float) -> None:
        """Let time pass."""

    @abstractmethod
    async def image(self) -> dict[str, object]:
        """Return the values that the device really holds."""

    @abstractmethod
    async def entries(self, kind: str, since: int) -> tuple[list[Entry], int]:
        """Return the entries of the device's journal from this number on, and the number of the one that follows.

        Args:
            kind: the member of an observation that has the latter.
        """

    @abstractmethod
    async def take_slice(self) -> list[Entry]:
        """Take the journal since the repetition began; the next repetition's slice begins where this one ends."""

    @abstractmethod
    async def wait(self, match: Mapping[str, object], *, timeout_s: float, count: int) -> list[Entry]:
        """Return the entries of this repetition that match, as soon as there are ``count``, or after the timeout."""

    # -- calls --------------------------------------------------------------------------------------------

    @abstractmethod
    async def perform(self, operation: str, inputs: Mapping[str, object], altered: Alteration | None = None) -> Reply:
        """Perform an operation through the adapter's own tools."""

    @abstractmethod
    async def perform_and_cancel(
        self,
        operation: str,
        inputs: Mapping[str, object],
        seen: Mapping[str, object],
        timeout_s: float,
        meanwhile: Callable[[], Awaitable[object]] | None,
    ) -> Reply:
        """Perform an operation; cancel the call as soon as the device has seen an entry that matches, or after the timeout."""

    @abstractmethod
    async def reconnecting(self) -> None:
        """Wait, after a failed call, until it makes sense to call again."""

    @abstractmethod
    def bindings(self, operation: str) -> Sequence[Binding] | None:
        """Return the subject's bindings of an operation; None for one that a Python function performs."""

    @abstractmethod
    def is_bound(self, operation: str, inputs: Mapping[str, object], *, first: bool = False) -> bool:
        """Tell whether the subject says how the operation is performed with these inputs; ``first``: before any other."""

    @abstractmethod
    def listing(self, operation: str, tool: str) -> Mapping[str, object] | None:
        """Return what ``tools/list`` says of the tool that a binding of this operation calls; None where it says nothing."""

    # -- the device ---------------------------------------------------------------------------------------

    @property
    @abstractmethod
    def addresses(self) -> list[tuple[str, int]]:
        """Host and port of each endpoint of the device, the main one first."""

    @property
    @abstractmethod
    def placeholders(self) -> Mapping[str, str]:
        """The placeholders of the subject file that stand for the device's endpoints, with their values."""

    @property
    @abstractmethod
    def running(self) -> bool:
        """The device runs."""

    @property
    @abstractmethod
    def accepting_ns(self) -> int:
        """Monotonic time since which the device accepts connections."""

    @abstractmethod
    async def check_away(self) -> None:
        """Make sure that nobody else listens where the stopped device was: a write would reach who does."""

    @abstractmethod
    async def start(self) -> float:
        """Start a new device process on the same port; return the milliseconds until it accepted connections."""

    @abstractmethod
    async def stop(self) -> float:
        """Kill the device process; return the milliseconds that this took."""

    # -- the session --------------------------------------------------------------------------------------

    @abstractmethod
    async def replace_session(self) -> FreshSession:
        """End the session and the adapter's process, and start anew."""

    @abstractmethod
    async def start_garbled(self) -> bool:
        """Start the adapter with a write switch whose value means nothing; return whether there is a session then."""

    @abstractmethod
    async def start_without_certificate(self) -> bool:
        """Start the adapter without the files of its own certificate; return whether there is a session then."""

    @abstractmethod
    async def open_by_handshake(self) -> HandshakeEra:
        """Start the adapter anew in MCP's era of the handshake, if it speaks it."""

    @abstractmethod
    async def close_handshake_era(self) -> None:
        """End the session and its process; the next session is opened as the subject file and the run's options say."""

    @abstractmethod
    async def close_session(self) -> None:
        """End the adapter's session and its process."""
