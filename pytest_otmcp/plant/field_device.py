"""A real device of the user's: read-only but for what a person consents to.

Two witnesses see what an adapter does there. The *wire* is the kit's tap, whose address is all that the adapter gets; it withholds
every frame that is not known to be harmless. Where the adapter's address cannot be changed, a *mirror* takes its place. The *state* is a
client of the kit's own, straight at the device. The kit never loads or disturbs
such a device, and stops and starts it by the commands of a consent alone.
"""

from __future__ import annotations

import asyncio
import os
import signal
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any, NoReturn, Protocol

from ..core.errors import KitError, MeddledError, NoBindingError, UsageError
from ..protocols.field import Consent, Field, agrees
from ..protocols.registry import protocols
from ..record.schema import Witnesses
from ..wire.framing import FrameLength, Framer, MalformedError
from .endpoint import Endpoint
from .mirror import Mirror, OwnConnections
from .tapped_device import TappedDevice

__all__ = ["FieldDevice", "Gate", "ReadingClient", "SecondClient", "UnreachableError", "UnrestoredError", "connected"]

_ANSWER_TIMEOUT_S, _CLOSING_S = 5.0, 1.0
_COMMAND_S, _GONE_S, _BACK_S, _LOOK_S = 60.0, 30.0, 300.0, 0.2
"""A controller may take minutes to come back."""
_AWAY, _BACK = 5, 3
"""Looks in a row: a busy device leaves one unanswered, and one whose power is about to fail answers one."""
_DIFFERENT = 3
"""Values that must differ, so that none of them is taken for another one's."""


class UnreachableError(Exception):
    """The device does not answer the second client as its protocol has it; one clause."""


@asynccontextmanager
async def connected(
    address: tuple[str, int],
    frame_length: FrameLength,
    spoken: str,
    *,
    alone: bool = False,
    own: OwnConnections | None = None,
) -> AsyncIterator[Callable[[bytes], Awaitable[bytes]]]:
    """Connect to a device; give a function that sends a frame and returns the next one of the device.

    Args:
        alone: the device may take one connection at a time, so this one has ended only when the device has closed it too.
        own: is told of the connection.

    Raises:
        UnreachableError: there is no connection, or no frame of the protocol ``spoken``.
    """
    framer, waiting = Framer(frame_length), deque[bytes]()
    try:
        async with asyncio.timeout(_ANSWER_TIMEOUT_S):
            reader, writer = await asyncio.open_connection(*address)
        if own is not None:
            own.note(writer.transport)

        async def exchange(frame: bytes) -> bytes:
            writer.write(frame)
            async with asyncio.timeout(_ANSWER_TIMEOUT_S):
                while not waiting:
                    if not (data := await reader.read(4096)):
                        raise UnreachableError("it closes the connection")
                    waiting.extend(framer.feed(data))
                    if framer.malformed:
                        raise UnreachableError(f"it does not speak {spoken}: {framer.malformed}")
            return waiting.popleft()

        try:
            yield exchange
            if alone:
                writer.write_eof()
                with suppress(TimeoutError):
                    async with asyncio.timeout(_CLOSING_S):
                        while await reader.read(4096):
                            pass
        finally:
            writer.close()
    except TimeoutError:
        raise UnreachableError("it does not answer") from None
    except OSError as error:
        raise UnreachableError(str(error)) from None


class UnrestoredError(MeddledError):
    """A real device does not hold again what it held before a write; the message says what that was."""


class SecondClient(Protocol):
    """The client of the kit's own, straight at the device; each method has a connection of its own.

    Attributes:
        name: of the client, for the record.
        elsewhere: an example of what may stand behind the port of a URL.
        library: on which it is built, as the list of libraries has it; None for the kit's own codec.
        own: is told of each connection; None where a capture is no witness, because there are none, or the device takes one at a time.
    """

    name: str
    elsewhere: str
    library: str | None
    own: OwnConnections | None

    async def identity(self) -> str | None:
        """Return what the device says of itself; None where it says nothing."""

    async def survey(self) -> Mapping[str, object]:
        """Look for values to read; return what the device says is not there, as a field's image has it."""
        ...

    async def values(self, points: tuple[str, ...] = ()) -> dict[str, object]:
        """Read what the survey has found, and these points."""
        ...

    async def held(self, points: tuple[str, ...]) -> dict[str, object]:
        """Read these points and nothing else."""
        ...

    def bounds(self, point: str) -> tuple[float, float]:
        """Return the lowest and the highest number that a point which was read can hold."""
        ...

    async def write(self, point: str, value: Any) -> None:
        """Write one value: what was there before."""


class ReadingClient(ABC):
    """The half of a :class:`SecondClient` for devices to which nothing may be written; ``taken`` names them in sentences."""

    taken: str
    library: str | None = None
    own: OwnConnections | None = None

    @abstractmethod
    async def read(self) -> dict[str, object]:
        """Read what the survey has found."""

    async def values(self, points: tuple[str, ...] = ()) -> dict[str, object]:
        """Read what the survey has found; refuse points of a consent."""
        if points:
            raise UnreachableError(f"the kit writes nothing to {self.taken}, so no consent is taken for one")
        return await self.read()

    async def held(self, points: tuple[str, ...]) -> dict[str, object]:
        """Refuse: nothing is written, so nothing has an old value."""
        return await self.values(points)

    def bounds(self, point: str) -> tuple[float, float]:
        """Return those of a point to which nothing may be written."""
        return 0, 0

    async def write(self, point: str, value: Any) -> None:
        """Refuse: nothing was written, so nothing is given back."""
        raise UnreachableError(f"the kit does not write {point}")


class Gate:
    """The decision which frames reach a real device. Whatever goes wrong with it, the frame does not.

    Attributes:
        field: of the device's protocol.
        is_open: what the consent allows may pass now.
        passed: the points that frames have written which passed, with their values.
        unseen: why nobody can see what a frame asks for that did not pass, a clause; None while there was no such frame.
        unanswered: for each frame that did not pass why an honest adapter may fail without an answer to it, or None.
    """

    def __init__(self, field: Field, consent: Consent | None) -> None:
        self.field = field
        self._consent = consent
        self.is_open = False
        self.passed: dict[str, list[object]] = {}
        self.unseen: str | None = None
        self.unanswered: set[str | None] = set()

    def __call__(self, frame: bytes) -> bool:
        """Tell whether a whole frame may reach the device."""
        try:
            if self.field.harmless(frame):
                return True
            written = self.field.written(frame) if self.is_open and self._consent is not None else None
            if self._consent is None or written is None or not self._consent.allows(written):
                self.unseen = self.field.unseen(frame) or self.unseen
                self.unanswered.add(self.field.unanswered(frame))
                return False
        except Exception:  # what cannot be read may do anything
            self.unanswered.add(None)
            return False
        for point, value in written.items():
            self.passed.setdefault(point, []).append(value)
        return True


class FieldDevice(TappedDevice):
    """A real device behind a tap that guards it.

    Args:
        key: of the protocol.
        url: of the device, as the user wrote it.
        target: its endpoint.
        client: the second client.
        consent: what may be written; None for nothing.

    Attributes:
        gate: what decides which frames pass.
        library: of the second client.
        witnesses: who saw what, for the record.
        capture: file that is the witness of the wire instead of the tap: the adapter gets the device's own address, and nothing is held back.
            It is set before the launch.
    """

    def __init__(self, key: str, url: str, target: Endpoint, client: SecondClient, consent: Consent | None) -> None:
        protocol = protocols()[key]
        if protocol.real is None or protocol.framing is None:
            raise KitError(f"the kit takes no real device for {protocol.name}")
        self._field, self._framing = protocol.real, protocol.framing
        self.gate = Gate(protocol.real, consent)
        rewrite = None if protocol.real.led is None else self._led
        super().__init__(f"{protocol.name} device {url}", target, protocol.framing, self.gate, rewrite)
        self.capture: Path | None = None
        self._client = client
        self.library = client.library
        self._consent = consent
        self._beyond: Mapping[str, object] = {}
        self._limits: dict[str, list[float]] = {}
        self._old: dict[str, object] = {}
        self._written: dict[str, list[object]] = {}
        self._is_cut_off = False
        self._switching: asyncio.Task[str] | None = None
        self.witnesses: Witnesses = {"wire": "the kit's tap", "state": client.name, "identity": None}

    async def launch(self) -> None:
        """Make sure that the device is there, and start the tap, or what takes its place.

        Raises:
            UsageError: the device is not there, or a capture can be no witness for it.
        """
        if self.capture is not None:
            self._mirror(self.capture)
        await super().launch()

    def _mirror(self, capture: Path) -> None:
        if self._client.own is None:
            raise UsageError(f"--otmcp-mirror: a capture is no witness for the {self.noun}; name it without one")
        if self._consent is not None and self._consent.writable:
            raise UsageError(
                "--otmcp-mirror: a capture holds nothing back, so nothing is written: leave out [[writable]]"
            )
        target = self._target
        self.tap = Mirror(capture, target.host, target.port, self._framing, self._watch, self._client.own)
        self.witnesses = {"mirror": f"the capture {capture.name}", "state": self._client.name, "identity": None}

    def _watch(self, frame: bytes) -> None:
        """Note what nobody can see into, of a frame that nobody holds back."""
        try:
            if not self._field.harmless(frame):
                self.gate.unseen = self._field.unseen(frame) or self.gate.unseen
        except Exception:  # what cannot be read is in the journal as it is
            return

    def _led(self, frame: bytes) -> bytes | None:
        """Return a frame of the device that leads its client to the tap; one that cannot be read leads nowhere."""
        assert self._field.led is not None, "only what can be led is rewritten"
        try:
            led = self._field.led(frame, f"{self.host}:{self.port}")
        except MalformedError:
            return frame
        if led is None:
            self.gate.unseen = "the device names addresses in an answer of several chunks, and the tap puts its own in the place of those in one chunk alone"
        return led

    async def check(self) -> None:
        """Make sure that the device is there, that it is the one of the consent, and that it tells enough to know it by.

        Raises:
            UsageError: it is not so.
        """
        try:
            self.witnesses["identity"] = identity = await self._client.identity()
            if (consent := self._consent) is not None:
                if identity != consent.identity:
                    self._refuse(f"it says that it is {identity!r}, the consent is for {consent.identity!r}")
                self._limits = {point: [one.lowest, one.highest] for one in consent.writable for point in one.points}
            self._beyond = await self._client.survey()
            await self._client.values(tuple(self._limits))
            for point, limits in self._limits.items():
                lowest, highest = self._client.bounds(point)
                self._limits[point] = [max(limits[0], lowest), min(limits[1], highest)]
        except UnreachableError as problem:
            self._refuse(str(problem))
        reads = self._field.reads(await self.image(), lambda operation: True)
        told = {str(list(one.points.values())) for one in reads if len(one.points) == 1}
        if len(told) < _DIFFERENT:
            self._refuse(
                f"where it was looked at, fewer than {_DIFFERENT} values differ, so nothing would show whose values an adapter tells: "
                f"name another place to read behind the port, such as {self._client.elsewhere}"
            )

    def _refuse(self, problem: str) -> NoReturn:
        raise UsageError(f"--otmcp-device: the {self.noun} cannot be used: {problem}")

    async def image(self) -> dict[str, object]:
        """Return what the second client reads, see :class:`~pytest_otmcp.protocols.field.Field`.

        Raises:
            MeddledError: the device does not answer any more.
            NoBindingError: nobody can see what the adapter asks it for.
        """
        self.see()
        try:
            points = await self._client.values(tuple(self._limits))
        except UnreachableError as problem:
            raise MeddledError(f"the {self.noun} does not answer the kit any more: {problem}") from None
        return {"points": points, "beyond": dict(self._beyond), "writable": dict(self._limits)}

    def see(self) -> None:
        """Make sure that the tap has seen what the adapter asks for.

        Raises:
            NoBindingError: it has not: it withholds what the adapter sends, which says nothing about the adapter.
        """
        if self.gate.unseen is not None:
            raise NoBindingError(f"nothing is judged at the {self.noun}: {self.gate.unseen}")

    def excuse(self) -> None:
        """Make sure that a failure which is not due is the adapter's own.

        Raises:
            NoBindingError: an honest adapter may fail as well, as the tap withholds what it needs, and has withheld nothing else.
        """
        if self.gate.unanswered and None not in self.gate.unanswered:
            raise NoBindingError(f"nothing is judged at the {self.noun}: {min(map(str, self.gate.unanswered))}")

    async def poke(self, **params: object) -> None:
        """Let pass what the consent allows (``writes=True``), or nothing that writes from now on, see :meth:`reset`.

        Raises:
            KitError: something else was asked for: the kit sets no values here.
            MeddledError: the device does not tell its old values.
            UnrestoredError: a point does not have its old value again.
        """
        if params.keys() != {"writes"}:
            await super().poke(**params)
        elif params["writes"] is True:
            try:
                held = await self._client.held(tuple(self._limits))
            except UnreachableError as problem:
                raise MeddledError(f"the {self.noun} does not answer the kit any more: {problem}") from None
            # Somebody may have changed a value since the last look; what a write through the tap has left there is no old value.
            self._old |= {point: value for point, value in held.items() if not self._was_written(point, value)}
            self.gate.is_open = True
        else:
            await self.reset()

    async def stop(self) -> None:
        """Cut the device off by the command of the consent; wait until it answers the second client no more. The tap stays.

        Raises:
            KitError: no consent says how.
            NoBindingError: the command fails, or the device still answers.
        """
        if self._consent is None or not self._consent.stop:
            raise KitError(f"nothing says how the {self.noun} is stopped")
        self.running, self._is_cut_off = False, True
        await self._command("stop", self._consent.stop)
        if not await self._waits_until(answers=False, looks=_AWAY, timeout_s=_GONE_S):
            raise NoBindingError(f"stop, of the consent: the {self.noun} still answers after {_GONE_S:g} s")

    async def start(self) -> None:
        """Bring the device back by the command of the consent; wait until it answers the second client.

        Raises:
            UnrestoredError: it does not come back.
        """
        assert self._consent is not None, "only a device that was stopped is started"
        try:
            await self._command("start", self._consent.start)
        except NoBindingError as problem:
            raise UnrestoredError(f"the {self.noun} was stopped and is not back: {problem}") from None
        if not await self._waits_until(answers=True, looks=_BACK, timeout_s=_BACK_S):
            raise UnrestoredError(f"the {self.noun} was stopped and does not answer {_BACK_S:g} s after start")
        # A device knows nothing of connections from before; where its power failed, nobody has told their other end yet.
        await self.tap.down()
        await super().start()
        self._is_cut_off = False

    async def _command(self, name: str, words: Sequence[str]) -> None:
        # Whoever waits may be cancelled; the command goes on then, and the next one must not overtake it.
        self._switching = asyncio.create_task(_run(words, self._switching))
        if problem := await asyncio.shield(self._switching):
            raise NoBindingError(f"{name}, of the consent: {words[0]!r} {problem}")

    async def _waits_until(self, *, answers: bool, looks: int, timeout_s: float) -> bool:
        """Wait until so many looks in a row show the same; one that shows the contrary when the time is over ends it."""
        end, left = time.monotonic() + timeout_s, looks
        while True:
            if await self._answers() is answers:
                left -= 1
            elif time.monotonic() > end:
                return False
            else:
                left = looks
            if not left:
                return True
            await asyncio.sleep(_LOOK_S)

    async def _answers(self) -> bool:
        try:
            await self._client.values()
        except UnreachableError:
            return False
        return True

    async def reset(self) -> bool:
        """Let nothing pass that writes, and give back the old values where a write has passed.

        Raises:
            UnrestoredError: a point does not have its old value again.
        """
        self.gate.is_open = False
        dead = await super().reset()
        passed, self.gate.passed = self.gate.passed, {}
        for point, values in passed.items():
            self._written.setdefault(point, []).extend(values)
        if passed:
            await self._restore(passed)
        return dead

    async def _restore(self, points: Iterable[str], *, is_last: bool = False) -> None:
        """Give back the old values of points where they differ.

        A device may carry out a write late, which the last look finds. What it finds there that no write has asked for is somebody else's, and
        stays.
        """
        try:
            held = await self._client.held(tuple(points))
        except UnreachableError:
            held = {}
        for point in points:
            is_others = is_last and point in held and not self._was_written(point, held[point])
            if not is_others and held.get(point) != self._old[point]:
                with suppress(UnreachableError):
                    await self._client.write(point, self._old[point])
        for _ in range(_BACK):
            try:
                held = await self._client.held(tuple(points))
            except UnreachableError as error:
                lost, problem = list(points), str(error)
            else:
                lost = [point for point in points if held[point] != self._old[point]]
                problem = f"it holds {', '.join(str(held[point]) for point in lost)}"
            if not lost:
                return
            await asyncio.sleep(_LOOK_S)
        old = ", ".join(f"{point} = {self._old[point]}" for point in lost)
        raise UnrestoredError(f"the {self.noun} did not get its old values back, {old}: {problem}")

    def _was_written(self, point: str, held: object) -> bool:
        """Tell whether a point holds what a write that passed has asked for."""
        return any(held == value or agrees(held, value) for value in self._written.get(point, ()))

    async def close(self) -> None:
        """Bring the device back where it was left cut off; end the tap, then give back the old values, and look at all of them once more.

        Raises:
            UnrestoredError: the device is not back, or a point does not have its old value again.
        """
        problems: list[str] = []
        try:
            if self._is_cut_off:
                await self.start()
        except UnrestoredError as problem:
            problems.append(str(problem))
        finally:
            await super().close()
            try:
                await self.reset()
                if self._written:
                    await self._restore(self._written, is_last=True)
            except UnrestoredError as problem:
                problems.append(str(problem))
            # It matters more than whatever else ends this.
            if problems:
                raise UnrestoredError("; ".join(problems))


async def _run(words: Sequence[str], before: asyncio.Task[str] | None) -> str:
    """Run a command when the one before it has ended; return a clause that says why it failed, or nothing.

    It has a session of its own: a Ctrl-C at the terminal is for pytest, and what it starts itself ends with it when its time is over.
    """
    if before is not None:
        await asyncio.wait({before})
    nothing = asyncio.subprocess.DEVNULL
    try:
        process = await asyncio.create_subprocess_exec(
            *words, stdin=nothing, stdout=nothing, stderr=nothing, start_new_session=True
        )
    except (OSError, ValueError) as error:
        return f"cannot be run: {getattr(error, 'strerror', None) or error}"
    ended = asyncio.ensure_future(process.wait())
    try:
        code = await asyncio.wait_for(asyncio.shield(ended), _COMMAND_S)
    except TimeoutError:
        # Nobody may kill what runs as another user, such as sudo: it gets the same time again to end by itself.
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        await asyncio.wait({ended}, timeout=_COMMAND_S)
        return f"did not end within {_COMMAND_S:g} s"
    return f"ended with code {code}" if code else ""
