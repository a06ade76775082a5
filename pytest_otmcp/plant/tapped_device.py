"""A device of the user's own behind a tap: the tap is its witness.

The kit never starts or stops such a device. It takes the tap's endpoint away and brings it back, which looks the same to an
adapter.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

from ..core.errors import KitError
from ..protocols.journal import JournalEntry
from ..protocols.protocol import Framing
from ..session.isolation import Walls
from .device import Journal, check_kept
from .endpoint import Endpoint, check_free
from .owners import Sessions
from .tap.faults import Action, FaultRule
from .tap.medium import Gate, Rewrite
from .tap.tap import Tap, new_tap

__all__ = ["TappedDevice"]


class TappedDevice:
    """A device that is reached through a tap. See :class:`~pytest_otmcp.plant.device.Device`.

    A protocol adds in a sub-class what it takes to find out that the device is there, and to change it past the tap.

    Args:
        noun: name of the device in sentences, with its address, such as ``broker mqtt://10.0.0.1``.
        target: its endpoint.
        framing: how to cut and decode what passes.
        gate: decides which frames reach the device; None lets everything through.
        rewrite: makes of the frames of the device what the adapter gets; None leaves them as they are.

    Attributes:
        tap: the tap, for fault rules.
        endpoints: the tap, under the name of the target.
        running: True while the tap hands on what comes.
        faulty: True while the tap delays what passes.
        accepting_ns: monotonic time since which it does.
        credentials, account, walls: see :class:`~pytest_otmcp.plant.device.Device`.
    """

    def __init__(
        self,
        noun: str,
        target: Endpoint,
        framing: Framing,
        gate: Gate | None = None,
        rewrite: Rewrite | None = None,
    ) -> None:
        self.noun = noun
        self.tap: Tap = new_tap(target, framing, gate, rewrite)
        self._target = target
        self.endpoints: Mapping[str, Endpoint] = {}
        self.running = False
        self.faulty = False
        self.accepting_ns = 0
        self.sessions = Sessions()
        self.credentials: Mapping[str, bytes] = {}
        self.account: Mapping[str, str] = {}
        self.walls: Walls | None = None

    @property
    def host(self) -> str:
        """Address of the tap."""
        return self.tap.host

    @property
    def port(self) -> int:
        """Port of the tap."""
        return self.tap.port

    # -- life ---------------------------------------------------------------------------------------------

    async def check(self) -> None:
        """Make sure that the device is there, as far as its protocol allows to find out.

        Raises:
            KitError: it is not.
        """

    async def launch(self) -> None:
        """Make sure that the device is there, and start the tap.

        Raises:
            KitError: the device is not there.
        """
        await self.check()
        if self.walls is not None and self.walls.network:
            # The tap is where its adapters are, and the device is not.
            self.tap.new_socket = self.walls.socket
        await self.tap.start()
        target = self._target
        self.endpoints = {
            target.name: Endpoint(name=target.name, kind=target.kind, host=self.tap.host, port=self.tap.port)
        }
        self._serves()

    def _serves(self) -> None:
        self.accepting_ns = time.monotonic_ns()
        self.running = True

    async def stop(self) -> None:
        """Take the tap's endpoint away."""
        await self.tap.down()
        self.running = False

    async def start(self) -> None:
        """Bring the tap's endpoint back on the same port, with an empty journal that counts from 0 again.

        Raises:
            ExhaustedError: another program has taken the port.
        """
        await check_free(self.endpoints.values(), self.walls)
        self.tap.begin_journal()
        await self.tap.up()
        self._serves()

    async def close(self) -> None:
        """End the tap; the device is left as it is."""
        self.running = False
        await self.tap.aclose()

    # -- witness ------------------------------------------------------------------------------------------

    async def image(self) -> dict[str, object]:
        """Refuse: only a mock can be asked what it holds.

        Raises:
            KitError: always.
        """
        raise KitError(f"the {self.noun} cannot be asked what it holds")

    async def mark(self) -> int:
        """Return the sequence number that the next journal entry will get."""
        await self.tap.settle()
        return self.tap.journal.next

    async def first(self) -> int:
        """Return the sequence number of the oldest journal entry that has not been released, or of the next entry."""
        return self.tap.journal.first

    async def journal(self, since: int) -> Journal:
        """Return the entries from ``since`` on.

        Raises:
            KitError: the oldest of them were released, or have given way to newer ones.
        """
        await self.tap.settle()
        journal = self.tap.journal
        check_kept(since, journal.first)
        return Journal(entries=self.sessions.attribute(journal.since(since), journal.peers), next=journal.next)

    async def forget(self, before: int) -> None:
        """Release the entries before ``before`` for good: they have been read."""
        self.tap.journal.forget(before)

    async def wait(
        self, since: int, match: Mapping[str, object], *, timeout_s: float, count: int = 1
    ) -> list[JournalEntry]:
        """Wait for entries from ``since`` on that have all fields of ``match``; return them as soon as there are
        ``count``, or those found when the time is over.

        Raises:
            KitError: the oldest entries from ``since`` on were released, or have given way to newer ones.
        """
        await self.tap.settle()
        journal = self.tap.journal
        # Whose an entry is, is decided afterwards.
        fields = {name: value for name, value in match.items() if name != "origin"}

        async def look(count: int, timeout_s: float) -> list[JournalEntry]:
            entries = await journal.wait(since, fields, count, timeout_s, self.tap.more)
            check_kept(since, journal.first)
            return self.sessions.attribute(entries, journal.peers)

        return await self.sessions.wait(look, match, count=count, timeout_s=timeout_s)

    async def poke(self, **params: object) -> None:
        """Refuse: how to change a device past the tap is a matter of its protocol.

        Raises:
            KitError: always.
        """
        raise KitError(f"the {self.noun} cannot be changed past the tap")

    async def fault(self, *rules: Mapping[str, object]) -> None:
        raise KitError(f"the {self.noun} has no faults of its own")

    async def delay(self, seconds: float) -> None:
        """Let every frame of the device pass so many seconds late from now on; 0 ends that."""
        rule = FaultRule(action=Action.DELAY, direction="out", times=None, seconds=seconds)
        self.tap.inject(*([rule] if seconds else ()))
        self.faulty = bool(seconds)

    async def preset(self, presets: Sequence[Mapping[str, object]]) -> None:
        """Leave it as it is: a device of the user's own has what it has."""

    async def reset(self) -> bool:
        """End the faults; what the device holds is left as it is."""
        self.tap.inject()
        self.faulty = False
        return self.tap.dead_connections > 0

    async def tick(self, steps: int = 1) -> None:
        """Do nothing: the kit does not simulate what is behind a device of the user's own."""
