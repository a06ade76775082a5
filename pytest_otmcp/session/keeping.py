"""The kit's end of the keeper (see ``keeper``): one for this process, and a watcher for each adapter."""

from __future__ import annotations

import asyncio
import atexit
import errno
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

from ..core.errors import ExhaustedError, KitError
from ..core.exhaustion import exhausted
from . import keeper

__all__ = ["Enclosure", "Keeper", "Watcher"]

_PROGRAM = f"import sys; sys.path.append({str(Path(__file__).parents[2])!r}); from {keeper.__name__} import main; sys.exit(main())"
"""Python runs it isolated and without the site module: it needs nothing but the standard library and itself."""

_WATCHED_S = 20.0
"""Seconds within which a killed process must be gone; one that waits for a disk cannot be killed."""

_OF_A_MOMENT = (errno.EAGAIN, errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.ENOSPC)
"""What the system says when something is used up."""

_OF_THE_COMMAND = (errno.ENOENT, errno.EACCES, errno.ENOEXEC, errno.ENOTDIR)
"""What the system says when the command is wrong; whatever else it says is about the kit's machine."""


class Keeper:
    """A keeper of this process, which is started with its first adapter and ends with this process.

    Args:
        words: returns what follows on its command line, and the descriptors that are named there (see ``keeper``).
    """

    def __init__(self, words: Callable[[], tuple[Sequence[str], Sequence[int]]] = lambda: ((), ())) -> None:
        self._words = words
        self._lock = threading.Lock()
        self._running: _Running | None = None

    def start(self) -> socket.socket:
        """Start it, if it does not run; return the socket on which it listens."""
        running = self._running
        if running is None or running.process.poll() is not None or running.owner != os.getpid():
            running = self._running = _Running(*self._words())
        return running.socket

    def send(self, word: bytes, descriptors: Sequence[int] = ()) -> None:
        """Hand it a word, as ``keeper`` describes them."""
        with self._lock:
            listening = self.start()
            assert self._running is not None
            # An adapter may have stopped it.
            self._running.process.send_signal(signal.SIGCONT)
            socket.send_fds(listening, [word], descriptors)

    def close(self) -> None:
        """End it, and with it all that it has started."""
        with self._lock:
            if self._running is not None:
                self._running.close()
                self._running = None

    def replace(self) -> None:
        """Start another one for the next adapter: this one did not fork a watcher, as when an adapter has taken its descriptors."""
        with self._lock:
            self._running = None


class _Running:
    """The process of a keeper."""

    def __init__(self, words: Sequence[str], descriptors: Sequence[int]) -> None:
        self.socket, theirs = socket.socketpair()
        own = os.pidfd_open(os.getpid())
        try:
            self.process = subprocess.Popen(
                [sys.executable, "-I", "-S", "-c", _PROGRAM, str(theirs.fileno()), str(own), *words],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(), own, *descriptors),
                cwd="/",
                start_new_session=True,
            )
        except BaseException:
            self.socket.close()
            raise
        finally:
            theirs.close()
            os.close(own)
        self.owner = os.getpid()
        atexit.register(self.close)

    def close(self) -> None:
        """End it; nothing that it has started outlives it."""
        atexit.unregister(self.close)
        self.socket.close()
        if self.owner == os.getpid():
            self.process.send_signal(signal.SIGCONT)
            try:
                self.process.wait(_WATCHED_S)
            except subprocess.TimeoutExpired:
                # Something stops it again and again. The watchers notice themselves that the kit has ended.
                self.process.kill()
                self.process.wait()


_PLAIN = Keeper()
"""The keeper of adapters without walls."""


class Enclosure(Protocol):
    """What is around an adapter: see :class:`~pytest_otmcp.session.isolation.Walls`."""

    @property
    def keeper(self) -> Keeper:
        """Starts the adapter."""
        ...

    def request(self, command: Sequence[str], env: Mapping[str, str], cwd: str) -> dict[str, Any]:
        """Return what the keeper is asked for."""
        ...

    def bare(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return what the keeper is asked for to learn whether the machine allows such walls where nothing is open to the adapter."""
        ...

    def refused(self, why: Sequence[Any]) -> None:
        """Take note that the machine refuses a view of the machine.

        Raises:
            UsageError: it is required.
        """

    def saw(self, request: Mapping[str, Any], namespaces: Mapping[str, int]) -> None:
        """Make sure that the adapter that was started so is in the namespaces that it was to have.

        Raises:
            KitError: it is not.
        """


class Watcher:
    """The process above an adapter, as the kit sees it.

    Attributes:
        pid: number of the adapter's process.
        root: number of the process from which everything descends that the adapter starts, and nothing else.
        number: that of the watcher's process.
        exited: set when the adapter's process has ended.
        empty: set when nothing of it is left.
        returncode: of the adapter, as in :mod:`subprocess`; None as long as it runs.
    """

    def __init__(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, keeper: Keeper, numbers: Mapping[str, int]
    ) -> None:
        self.pid = numbers["pid"]
        self.root = numbers["root"]
        self.number = numbers["watcher"]
        self._keeper = keeper
        self.exited = asyncio.Event()
        self.empty = asyncio.Event()
        self.returncode: int | None = None
        self._left: list[str] = []
        self._reader = reader
        self._writer = writer
        self._task = asyncio.create_task(self._read(), name="otmcp-watcher")

    @classmethod
    async def start(
        cls,
        command: Sequence[str],
        *,
        env: Mapping[str, str],
        cwd: Path | None,
        streams: Sequence[int],
        walls: Enclosure | None = None,
    ) -> Watcher:
        """Start an adapter with these file descriptors as its standard input, output and error.

        Raises:
            OSError: the command cannot be executed.
            KitError: no process could be started, for a reason that is not the command's.
        """
        used = _PLAIN if walls is None else walls.keeper
        directory = os.getcwd() if cwd is None else str(cwd)
        request: dict[str, Any] = {"command": list(command), "env": dict(env), "cwd": directory}
        request |= (
            {"network": False, "raw": False, "view": None} if walls is None else walls.request(command, env, directory)
        )
        reader, writer, event = await cls._ask(used, request, streams)
        if walls is not None and "refused" in event:
            await cls._believe(used, walls, request, event["refused"], streams)
            walls.refused(event["refused"])
            request["view"] = None
            reader, writer, event = await cls._ask(used, request, streams)
        if "refused" in event:
            raise KitError(f"the adapter could not be started: the machine refuses {event['refused'][1]}")
        if "failed" in event:
            number = event["failed"]
            if number in _OF_THE_COMMAND and "of" not in event:
                raise OSError(number, os.strerror(number), command[0])
            raise _not_started(OSError(number, os.strerror(number) if number else "the keeper has ended"))
        watcher = cls(reader, writer, used, event)
        if walls is not None:
            try:
                walls.saw(request, event["namespaces"])
            except KitError:
                await watcher.close()
                raise
        return watcher

    @classmethod
    async def _believe(
        cls, used: Keeper, walls: Enclosure, request: Mapping[str, Any], refused: Sequence[Any], streams: Sequence[int]
    ) -> None:
        """Make sure that the machine refuses walls, and nothing that an adapter has done: no adapter decides that it is started without them.

        Raises:
            KitError: it does not.
        """
        number, step = refused
        if number in _OF_A_MOMENT:
            raise _not_started(OSError(number, os.strerror(number)))
        _, _, event = await cls._ask(used, walls.bare(request), streams)
        if event.get("refused") is None:
            raise KitError(
                f"the adapter could not be started behind its walls: {step} failed ({os.strerror(number)}), which it does not where nothing "
                "is open to adapters; look at what they may write to"
            )

    @staticmethod
    async def _ask(
        used: Keeper, request: Mapping[str, Any], streams: Sequence[int]
    ) -> tuple[asyncio.StreamReader, asyncio.StreamWriter, dict[str, Any]]:
        """Ask for an adapter; return the connection to its watcher and what that says first."""
        try:
            ours, theirs = socket.socketpair()
            try:
                used.send(b"W", [theirs.fileno(), *streams])
            except BaseException:
                ours.close()
                raise
            finally:
                theirs.close()
            ours.setblocking(False)
            reader, writer = await asyncio.open_connection(sock=ours)
        except (OSError, RuntimeError) as error:
            raise _not_started(error) from error
        try:
            writer.write(json.dumps(request).encode() + b"\n")
            try:
                answer = await reader.readline()
            except ConnectionError:
                answer = b""
            if not answer:
                used.replace()
        except BaseException:
            writer.close()
            raise
        event: dict[str, Any] = json.loads(answer or '{"failed": 0}')
        if "pid" not in event:
            writer.close()
        return reader, writer, event

    async def _read(self) -> None:
        told = False
        with suppress(ConnectionError):
            while line := await self._reader.readline():
                event: dict[str, Any] = json.loads(line)
                if "exit" in event:
                    self.returncode = event["exit"]
                    self.exited.set()
                elif "empty" in event:
                    self.empty.set()
                elif "left" in event:
                    told = True
                    self._left = event["left"]
        if not told:
            # Who kills the watcher has killed the adapter with it, but not what the adapter has started.
            with suppress(OSError):
                self._keeper.send(b"S")
        if self.returncode is None:
            self.returncode = -9
        self.exited.set()
        self.empty.set()

    def terminate(self) -> None:
        """Send SIGTERM to the process group of the adapter."""
        self._say(b"T")

    async def close(self) -> list[str]:
        """Kill everything that is left of the adapter; return the names of what there was besides its own process."""
        self._signal(signal.SIGCONT)
        self._say(b"K")
        await asyncio.wait({self._task}, timeout=_WATCHED_S)
        if not self._task.done():
            # Something stops it again and again; what it leaves is for the keeper to kill.
            self._signal(signal.SIGKILL)
            await asyncio.wait({self._task}, timeout=_WATCHED_S)
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)
        self._writer.close()
        return self._left

    def _signal(self, number: signal.Signals) -> None:
        """Send a signal to the watcher, which an adapter may have stopped."""
        # As long as its socket is open the number is no other process's.
        if not self._task.done():
            with suppress(ProcessLookupError):
                os.kill(self.number, number)

    def _say(self, word: bytes) -> None:
        with suppress(ConnectionError):
            self._writer.write(word)


def _not_started(error: OSError | RuntimeError) -> KitError:
    if (cure := exhausted(error)) is not None:
        return ExhaustedError(f"the adapter could not be started: {cure}")
    return KitError(f"the adapter could not be started: {error}")
