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
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from ..core.errors import ExhaustedError, KitError
from ..core.exhaustion import exhausted
from . import keeper

__all__ = ["Watcher"]

_WATCHED_S = 20.0
"""Seconds within which a killed process must be gone; one that waits for a disk cannot be killed."""

_OF_THE_COMMAND = (errno.ENOENT, errno.EACCES, errno.ENOEXEC, errno.ENOTDIR)
"""What the system says when the command is wrong; whatever else it says is about the kit's machine."""


class _Keeper:
    """The keeper of this process, which is started with the first adapter and ends with this process."""

    _lock = threading.Lock()
    _running: _Keeper | None = None

    def __init__(self) -> None:
        self._socket, theirs = socket.socketpair()
        own = os.pidfd_open(os.getpid())
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-I", "-S", keeper.__file__, str(theirs.fileno()), str(own)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(), own),
                cwd="/",
                start_new_session=True,
            )
        except BaseException:
            self._socket.close()
            raise
        finally:
            theirs.close()
            os.close(own)
        self._owner = os.getpid()
        atexit.register(self._close)

    @classmethod
    def send(cls, word: bytes, descriptors: Sequence[int] = ()) -> None:
        with cls._lock:
            if cls._running is None or cls._running._process.poll() is not None or cls._running._owner != os.getpid():
                cls._running = cls()
            # An adapter may have stopped it.
            cls._running._process.send_signal(signal.SIGCONT)
            socket.send_fds(cls._running._socket, [word], descriptors)

    @classmethod
    def replace(cls) -> None:
        """Start another keeper for the next adapter: this one did not fork a watcher, as when an adapter has taken its descriptors."""
        with cls._lock:
            cls._running = None

    def _close(self) -> None:
        self._socket.close()
        if self._owner == os.getpid():
            self._process.send_signal(signal.SIGCONT)
            try:
                self._process.wait(_WATCHED_S)
            except subprocess.TimeoutExpired:
                # Something stops it again and again. The watchers notice themselves that the kit has ended.
                self._process.kill()
                self._process.wait()


class Watcher:
    """The process above an adapter, as the kit sees it.

    Attributes:
        pid: number of the adapter's process.
        root: number of the watcher's, from which everything descends that the adapter starts, and nothing else.
        exited: set when the adapter's process has ended.
        empty: set when nothing of it is left.
        returncode: of the adapter, as in :mod:`subprocess`; None as long as it runs.
    """

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, pid: int, root: int) -> None:
        self.pid = pid
        self.root = root
        self.exited = asyncio.Event()
        self.empty = asyncio.Event()
        self.returncode: int | None = None
        self._left: list[str] = []
        self._reader = reader
        self._writer = writer
        self._task = asyncio.create_task(self._read(), name="otmcp-watcher")

    @classmethod
    async def start(
        cls, command: Sequence[str], *, env: Mapping[str, str], cwd: Path | None, streams: Sequence[int]
    ) -> Watcher:
        """Start an adapter with these file descriptors as its standard input, output and error.

        Raises:
            OSError: the command cannot be executed.
            KitError: no process could be started, for a reason that is not the command's.
        """
        try:
            ours, theirs = socket.socketpair()
            try:
                _Keeper.send(b"W", [theirs.fileno(), *streams])
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
            directory = os.getcwd() if cwd is None else str(cwd)
            request = {"command": list(command), "env": dict(env), "cwd": directory}
            writer.write(json.dumps(request).encode() + b"\n")
            try:
                answer = await reader.readline()
            except ConnectionError:
                answer = b""
            if not answer:
                _Keeper.replace()
        except BaseException:
            writer.close()
            raise
        event = json.loads(answer or '{"failed": 0}')
        if "failed" in event:
            writer.close()
            number = event["failed"]
            if number in _OF_THE_COMMAND and "of" not in event:
                raise OSError(number, os.strerror(number), command[0])
            raise _not_started(OSError(number, os.strerror(number) if number else "the keeper has ended"))
        return cls(reader, writer, event["pid"], event["watcher"])

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
                _Keeper.send(b"S")
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
                os.kill(self.root, number)

    def _say(self, word: bytes) -> None:
        with suppress(ConnectionError):
            self._writer.write(word)


def _not_started(error: OSError | RuntimeError) -> KitError:
    if (cure := exhausted(error)) is not None:
        return ExhaustedError(f"the adapter could not be started: {cure}")
    return KitError(f"the adapter could not be started: {error}")
