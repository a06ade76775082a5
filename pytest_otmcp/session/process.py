"""One subprocess of the subject: pipes with timestamps, stderr tail, steps of stopping it.

This module knows pipes and what ends a process; it does not know MCP. Every other module may
assume that no process of a stopped subject is left running, including whatever it started (see ``keeper``).
"""

from __future__ import annotations

import asyncio
import os
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import AsyncExitStack, suppress
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import cast

from ..core.errors import ExhaustedError
from ..core.exhaustion import exhausted
from .isolation import Walls
from .keeping import Watcher
from .limits import MAX_FRAME_BYTES
from .starvation import Patience, finish_within

__all__ = ["StopReport", "SubjectProcess", "subject_environment"]

_UNREAD_BYTES = 4 * 1024 * 1024
"""Bytes that wait for an adapter to read its stdin, beyond which its stdout is not read either: it may send requests, and
every answer to one that it does not read would be kept."""

_SETTLE_S = 3.0
_STARVED_S = 10.0
"""Seconds without a processor that are granted to a process that is to end."""

_STDERR_LINES = 60
_STDERR_LINE_BYTES = 2000

# Variables that a subject inherits from the kit's environment. This is an allow-list: a ``MODBUS_WRITES_ENABLED`` in the user's
# shell must not reach the read-only variant.
_INHERITED = (
    "HOME LOGNAME PATH SHELL TERM USER LANG LC_ALL TZ TMPDIR VIRTUAL_ENV PYTHONPATH LD_LIBRARY_PATH SSL_CERT_FILE "
    "APPDATA HOMEDRIVE HOMEPATH LOCALAPPDATA PATHEXT PROCESSOR_ARCHITECTURE SYSTEMDRIVE SYSTEMROOT TEMP USERNAME "
    "USERPROFILE"
).split()


# What a subject prints on stdout is to be seen when it is printed, not when a buffer is full.
_ALWAYS = {"PYTHONUNBUFFERED": "1"}


def subject_environment(declared: Mapping[str, str]) -> dict[str, str]:
    """Return the environment of a subject: a short allow-list from the kit's own, and the variables that it declares."""
    inherited = {name: os.environ[name] for name in _INHERITED if name in os.environ}
    # What is declared comes first: a program that shows its environment may show no more than its beginning.
    return dict(declared) | inherited | _ALWAYS | dict(declared)


@dataclass(frozen=True, slots=True, kw_only=True)
class StopReport:
    """The end of a subject's process.

    Attributes:
        how: ``exited`` (before it was asked to), ``eof`` (after its stdin was closed, as the MCP specification asks),
            ``terminated`` (by SIGTERM, after its stdin was closed in vain), ``signalled`` (by SIGTERM as the first
            request) or ``killed`` (SIGKILL).
        seconds: time from the first request to the exit.
        returncode: exit code, negative for a signal, as in :mod:`subprocess`.
        left: names of the processes that it had started and that still ran as long after the end of its stdin as it
            may run itself; they have been killed.
    """

    how: str
    seconds: float
    returncode: int | None
    left: Sequence[str] = ()


class _Pipe(asyncio.Protocol):
    """One pipe of a process; what is read from it, and its end, is handed on."""

    def __init__(self, received: Callable[[bytes], None], closed: Callable[[], None]) -> None:
        self._received = received
        self._closed = closed

    def data_received(self, data: bytes) -> None:
        self._received(data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._closed()


class _Stdin(asyncio.BaseProtocol):
    """The pipe to a process, which says when too much waits in it, and when that is over."""

    def __init__(self) -> None:
        self.full: Callable[[bool], None] = lambda full: None

    def pause_writing(self) -> None:
        self.full(True)

    def resume_writing(self) -> None:
        self.full(False)


class _Pipes:
    """The output of a process: stdout is cut into lines, each stamped with the time at which its last byte was read."""

    def __init__(
        self,
        on_line: Callable[[int, bytes], None],
        on_overflow: Callable[[int], None],
        on_stderr: Callable[[bytes], None],
    ) -> None:
        self._on_line = on_line
        self._on_overflow = on_overflow
        self._on_stderr = on_stderr
        self._partial = bytearray()
        self.overflown = False
        self.stderr: deque[str] = deque(maxlen=_STDERR_LINES)
        self._stderr_partial = b""
        self.stdout_closed = asyncio.Event()
        self.stderr_closed = asyncio.Event()

    def read_stdout(self, data: bytes) -> None:
        if self.overflown:
            return
        now = time.monotonic_ns()
        start = 0
        while (end := data.find(b"\n", start)) >= 0:
            self._partial += data[start:end]
            line, self._partial = bytes(self._partial), bytearray()
            start = end + 1
            self._on_line(now, line)
        self._partial += data[start:]
        if len(self._partial) > MAX_FRAME_BYTES:
            self.overflown = True
            self._partial.clear()
            self._on_overflow(now)

    def read_stderr(self, data: bytes) -> None:
        self._on_stderr(data)
        *lines, rest = (self._stderr_partial + data).split(b"\n")
        self._stderr_partial = rest[-_STDERR_LINE_BYTES:]
        # Only the newest lines are kept, so the others of a large chunk need not be decoded.
        for line in lines[-_STDERR_LINES:]:
            self.stderr.append(line[:_STDERR_LINE_BYTES].decode("utf-8", "replace").rstrip("\r"))

    def end_of_stderr(self) -> None:
        if self._stderr_partial:
            self.stderr.append(self._stderr_partial.decode("utf-8", "replace"))
            self._stderr_partial = b""
        self.stderr_closed.set()


class SubjectProcess:
    """Running process of a subject. Create it with :meth:`start`, end it with :meth:`stop`."""

    def __init__(
        self, watcher: Watcher, stdin: asyncio.WriteTransport, output: Sequence[asyncio.BaseTransport], pipes: _Pipes
    ):
        self._watcher = watcher
        self._stdin = stdin
        self._output = output
        self._pipes = pipes
        self._held: set[str] = set()
        self.root = watcher.root

    @classmethod
    async def start(
        cls,
        command: Sequence[str],
        *,
        env: Mapping[str, str],
        cwd: Path | None,
        on_line: Callable[[int, bytes], None],
        on_overflow: Callable[[int], None],
        on_stderr: Callable[[bytes], None] = lambda data: None,
        walls: Walls | None = None,
    ) -> SubjectProcess:
        """Start ``command`` in a session of its own, below a watcher.

        Args:
            command: argument vector; no shell is involved.
            env: the whole environment of the process.
            cwd: working directory, or None for the kit's.
            on_line: called with (monotonic ns, line without its newline) for every line on stdout.
            on_overflow: called once when a line on stdout exceeds :data:`~pytest_otmcp.session.limits.MAX_FRAME_BYTES`; reading ends then.
            on_stderr: called with whatever is read from stderr.
            walls: around the process, or None for none.

        Raises:
            OSError: the command cannot be executed.
            KitError: no process could be started, for a reason that is not the command's.
        """
        pipes = _Pipes(on_line, on_overflow, on_stderr)
        async with AsyncExitStack() as undo:
            try:
                theirs, ours = _streams(undo)
            except OSError as error:
                if (cure := exhausted(error)) is not None:
                    raise ExhaustedError(f"the adapter could not be started: {cure}") from error
                raise
            streams = [file.fileno() for file in theirs]
            watcher = await Watcher.start(command, env=env, cwd=cwd, streams=streams, walls=walls)
            undo.push_async_callback(watcher.close)
            for file in theirs:
                file.close()
            loop = asyncio.get_running_loop()
            stdin, unread = await loop.connect_write_pipe(_Stdin, ours[0])
            stdin.set_write_buffer_limits(_UNREAD_BYTES)
            stdout, _ = await loop.connect_read_pipe(lambda: _Pipe(pipes.read_stdout, pipes.stdout_closed.set), ours[1])
            stderr, _ = await loop.connect_read_pipe(lambda: _Pipe(pipes.read_stderr, pipes.end_of_stderr), ours[2])
            undo.pop_all()
        process = cls(watcher, stdin, (stdin, stdout, stderr), pipes)
        unread.full = lambda full: process.hold("stdin", full)
        return process

    @property
    def pids(self) -> tuple[int, int]:
        """The process that the command has started, and its watcher."""
        return self._watcher.pid, self._watcher.number

    @property
    def returncode(self) -> int | None:
        """Exit code, or None while the process runs."""
        return self._watcher.returncode

    @property
    def exited(self) -> asyncio.Event:
        """Event that is set when the process has ended."""
        return self._watcher.exited

    @property
    def stdout_closed(self) -> asyncio.Event:
        """Event that is set when stdout has ended."""
        return self._pipes.stdout_closed

    def stderr_tail(self, lines: int = 12) -> list[str]:
        """Return the newest lines of stderr that say something, oldest first.

        Lines that underline a place in the line above, as tracebacks have them, say nothing in another width.
        """
        return [line for line in self._pipes.stderr if line.strip(" \t^~")][-lines:]

    async def settle(self) -> None:
        """Wait for a short time, after stdout was closed, until the exit code is known and stderr has been read to its end."""
        # The pipes of a process that ends are closed before its exit code is available.
        if await _within(_SETTLE_S, self._watcher.exited):
            # A child that lives on may keep the pipe open.
            await _within(_SETTLE_S, self._pipes.stderr_closed)

    def stop_reading(self) -> None:
        """Read no more of stdout until the process is to end: what comes now is a flood."""
        self._pipes.overflown = True
        self.hold("flood", True)

    def hold(self, reason: str, held: bool) -> None:
        """Read nothing more of stdout as long as there is a reason; what the process writes waits in its pipe."""
        (self._held.add if held else self._held.discard)(reason)
        stdout = cast(asyncio.ReadTransport, self._output[1])
        if not stdout.is_closing():
            (stdout.pause_reading if self._held else stdout.resume_reading)()

    def _read_on(self) -> None:
        """Read stdout and throw it away."""
        self._pipes.overflown = True
        for reason in list(self._held):
            self.hold(reason, False)

    def write(self, data: bytes) -> None:
        """Write bytes to stdin, at once unless the pipe is full.

        Raises:
            BrokenPipeError: stdin is closed.
        """
        if self._stdin.is_closing():
            raise BrokenPipeError("the adapter's stdin is closed")
        self._stdin.write(data)

    async def stop(self, *, grace_s: float, reads_stdin: bool = True) -> StopReport:
        """End the process as the MCP specification describes (stdio, shutdown): close stdin, wait, SIGTERM, wait,
        SIGKILL; then kill the rest of what it has started.

        Args:
            grace_s: seconds to wait after closing stdin, and after SIGTERM, beside those for which the machine did not let
                the process run.
            reads_stdin: True when the process takes the end of its stdin as a request to end; else SIGTERM is the first.
        """
        begun = time.monotonic()
        exited = self._watcher.exited
        if self._held:
            # A process that waits until somebody reads its output cannot end.
            self._read_on()
        if self._pipes.stdout_closed.is_set():
            # stdout closes a moment before the process can be reaped, so this process was ending before it was asked to.
            await _within(grace_s, exited)
        how = "exited" if exited.is_set() else "killed"
        if how != "exited":
            self._stdin.close()
            starved_s = _STARVED_S
            if reads_stdin:
                gone, starved_s = await self._gone_within(grace_s, starved_s)
                how = "eof" if gone else how
            if how != "eof":
                self._watcher.terminate()
                if (await self._gone_within(grace_s, starved_s))[0]:
                    how = "terminated" if reads_stdin else "signalled"
        seconds = time.monotonic() - begun
        if how == "eof":
            # What the adapter has started has as much time to end as the adapter itself.
            await _within(grace_s - seconds, self._watcher.empty)
        left = await self._watcher.close()
        for transport in self._output:
            transport.close()
        return StopReport(how=how, seconds=seconds, returncode=self.returncode, left=left if how == "eof" else [])

    async def _gone_within(self, grace_s: float, starved_s: float) -> tuple[bool, float]:
        """Wait for the process to exit; tell whether it did, and what is left of ``starved_s``.

        On a busy machine seconds pass before a process gets a processor at all, or the watcher, which tells of its end. An adapter whose
        other processes take the processors from it must not live longer for that.
        """
        patience = Patience(grace_s, starved_s=starved_s)
        patience.watch(self.pids)
        with suppress(TimeoutError):
            await finish_within(patience, self._watcher.exited.wait())
        return self._watcher.exited.is_set(), starved_s - patience.starved_s()


def _streams(undo: AsyncExitStack) -> tuple[list[FileIO], list[FileIO]]:
    """Return the adapter's ends of its standard streams, and the kit's."""
    theirs: list[FileIO] = []
    ours: list[FileIO] = []
    for number in range(3):
        read, write = os.pipe()
        ends = os.fdopen(read, "rb", 0), os.fdopen(write, "wb", 0)
        for end in ends:
            undo.enter_context(end)
        theirs.append(ends[number > 0])
        ours.append(ends[number == 0])
    return theirs, ours


async def _within(seconds: float, event: asyncio.Event) -> bool:
    """Wait for an event so long; tell whether it came."""
    with suppress(TimeoutError):
        await asyncio.wait_for(event.wait(), max(0.0, seconds))
    return event.is_set()
