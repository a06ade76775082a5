"""One subprocess of the subject: pipes with timestamps, stderr tail, process group, steps of stopping it.

This module knows operating systems (groups, signals, pipes); it does not know MCP. Every other module may
assume that no process of a stopped subject is left running, including children that it forked.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from ..core.errors import ExhaustedError, KitError
from ..core.exhaustion import exhausted

__all__ = ["MAX_FRAME_BYTES", "StopReport", "SubjectProcess", "subject_environment"]

MAX_FRAME_BYTES = 16 * 1024 * 1024
"""Length of the longest line on stdout that is read to its end; no OT reply has a reason to be longer."""

_OF_THE_COMMAND = (errno.ENOENT, errno.EACCES, errno.ENOEXEC, errno.ENOTDIR)
"""What the system says when the command is wrong; whatever else it says is about the kit's machine."""

_SETTLE_S = 3.0
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
    return inherited | _ALWAYS | dict(declared)


@dataclass(frozen=True, slots=True, kw_only=True)
class StopReport:
    """The end of a subject's process.

    Attributes:
        how: ``exited`` (before it was asked to), ``eof`` (after its stdin was closed, as the MCP specification asks),
            ``terminated`` (by SIGTERM, after its stdin was closed in vain), ``signalled`` (by SIGTERM as the first
            request) or ``killed`` (SIGKILL).
        seconds: time from the first request to the exit.
        returncode: exit code, negative for a signal, as in :mod:`subprocess`.
    """

    how: str
    seconds: float
    returncode: int | None


class _Pipes(asyncio.SubprocessProtocol):
    """The pipes of a process: stdout is cut into lines, each stamped with the time at which its last byte was read."""

    def __init__(self, on_line: Callable[[int, bytes], None], on_overflow: Callable[[int], None]) -> None:
        self._on_line = on_line
        self._on_overflow = on_overflow
        self._partial = bytearray()
        self._overflown = False
        self.stderr: deque[str] = deque(maxlen=_STDERR_LINES)
        self._stderr_partial = b""
        self.exited = asyncio.Event()
        self.stdout_closed = asyncio.Event()
        self.stderr_closed = asyncio.Event()

    def pipe_data_received(self, fd: int, data: bytes | str) -> None:
        assert isinstance(data, bytes)
        if fd == 1:
            self._stdout(time.monotonic_ns(), data)
        else:
            self._stderr(data)

    def _stdout(self, now: int, data: bytes) -> None:
        if self._overflown:
            return
        start = 0
        while (end := data.find(b"\n", start)) >= 0:
            self._partial += data[start:end]
            line, self._partial = bytes(self._partial), bytearray()
            start = end + 1
            self._on_line(now, line)
        self._partial += data[start:]
        if len(self._partial) > MAX_FRAME_BYTES:
            self._overflown = True
            self._partial.clear()
            self._on_overflow(now)

    def _stderr(self, data: bytes) -> None:
        *lines, rest = (self._stderr_partial + data).split(b"\n")
        self._stderr_partial = rest[-_STDERR_LINE_BYTES:]
        # Only the newest lines are kept, so the others of a large chunk need not be decoded.
        for line in lines[-_STDERR_LINES:]:
            self.stderr.append(line[:_STDERR_LINE_BYTES].decode("utf-8", "replace").rstrip("\r"))

    def pipe_connection_lost(self, fd: int, exc: Exception | None) -> None:
        if fd == 1:
            self.stdout_closed.set()
        elif fd == 2:
            if self._stderr_partial:
                self.stderr.append(self._stderr_partial.decode("utf-8", "replace"))
                self._stderr_partial = b""
            self.stderr_closed.set()

    def process_exited(self) -> None:
        self.exited.set()


class SubjectProcess:
    """Running process of a subject. Create it with :meth:`start`, end it with :meth:`stop`."""

    def __init__(self, transport: asyncio.SubprocessTransport, pipes: _Pipes) -> None:
        self._transport = transport
        self._pipes = pipes
        self.pid: int = transport.get_pid()

    @classmethod
    async def start(
        cls,
        command: Sequence[str],
        *,
        env: Mapping[str, str],
        cwd: Path | None,
        on_line: Callable[[int, bytes], None],
        on_overflow: Callable[[int], None],
    ) -> SubjectProcess:
        """Start ``command`` in a process group of its own.

        Args:
            command: argument vector; no shell is involved.
            env: the whole environment of the process.
            cwd: working directory, or None for the kit's.
            on_line: called with (monotonic ns, line without its newline) for every line on stdout.
            on_overflow: called once when a line on stdout exceeds :data:`MAX_FRAME_BYTES`; reading ends then.

        Raises:
            OSError: the command cannot be executed.
            KitError: no process could be started, for a reason that is not the command's.
        """
        loop = asyncio.get_running_loop()
        options: dict[str, Any] = {"start_new_session": True} if os.name == "posix" else {}
        try:
            transport, pipes = await loop.subprocess_exec(
                lambda: _Pipes(on_line, on_overflow), *command, env=dict(env), cwd=cwd, **options
            )
        except Exception as error:
            if (cure := exhausted(error)) is not None:
                raise ExhaustedError(f"the adapter could not be started: {cure}") from error
            if isinstance(error, OSError) and error.errno not in _OF_THE_COMMAND:
                raise KitError(f"the adapter could not be started: {error}") from error
            raise
        return cls(transport, pipes)

    @property
    def returncode(self) -> int | None:
        """Exit code, or None while the process runs."""
        return self._transport.get_returncode()

    @property
    def exited(self) -> asyncio.Event:
        """Event that is set when the process has ended."""
        return self._pipes.exited

    @property
    def stdout_closed(self) -> asyncio.Event:
        """Event that is set when stdout has ended."""
        return self._pipes.stdout_closed

    def stderr_tail(self, lines: int = 12) -> list[str]:
        """Return the newest non-empty lines of stderr, oldest first."""
        return [line for line in self._pipes.stderr if line.strip()][-lines:]

    async def settle(self) -> None:
        """Wait for a short time, after stdout was closed, until the exit code is known and stderr has been read to its end."""
        # The pipes of a process that ends are closed before its exit code is available.
        if not await self._wait_for_exit(_SETTLE_S):
            return
        # A child that lives on may keep the pipe open.
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._pipes.stderr_closed.wait(), _SETTLE_S)

    def write(self, data: bytes) -> None:
        """Write bytes to stdin, at once unless the pipe is full.

        Raises:
            BrokenPipeError: stdin is closed.
        """
        stdin = self._transport.get_pipe_transport(0)
        if stdin is None or stdin.is_closing():
            raise BrokenPipeError("the adapter's stdin is closed")
        cast(asyncio.WriteTransport, stdin).write(data)

    async def stop(self, *, grace_s: float, reads_stdin: bool = True) -> StopReport:
        """End the process as the MCP specification describes (stdio, shutdown): close stdin, wait, SIGTERM, wait,
        SIGKILL; then kill the rest of its process group.

        Args:
            grace_s: seconds to wait after closing stdin, and after SIGTERM.
            reads_stdin: True when the process takes the end of its stdin as a request to end; else SIGTERM is the first.
        """
        begun = time.monotonic()
        if self._pipes.stdout_closed.is_set():
            # stdout closes a moment before the process can be reaped, so this process was ending before it was asked to.
            await self._wait_for_exit(grace_s)
        how = "exited" if self._pipes.exited.is_set() else "killed"
        if how != "exited":
            stdin = self._transport.get_pipe_transport(0)
            if stdin is not None:
                stdin.close()
            if reads_stdin and await self._wait_for_exit(grace_s):
                how = "eof"
            else:
                self._signal(signal.SIGTERM)
                if await self._wait_for_exit(grace_s):
                    how = "terminated" if reads_stdin else "signalled"
        seconds = time.monotonic() - begun
        # Children of a gracefully ended subject may live on: the group gets SIGKILL in every case.
        self._signal(signal.SIGKILL if os.name == "posix" else signal.SIGTERM)
        await self._wait_for_exit(5.0)
        self._transport.close()
        return StopReport(how=how, seconds=seconds, returncode=self.returncode)

    async def _wait_for_exit(self, timeout_s: float) -> bool:
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._pipes.exited.wait(), timeout_s)
        return self._pipes.exited.is_set()

    def _signal(self, number: signal.Signals) -> None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            if sys.platform != "win32":
                os.killpg(self.pid, number)
            elif self.returncode is None:
                self._transport.terminate()
