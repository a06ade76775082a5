"""A mock program as a real process, and an async client of its control channel.

The client follows the documented protocol, without the mocks' code: it does what a person with a shell could do. What frames say
it is told by the kit's decoder.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import os
import sys
from typing import Any

from pytest_otmcp.plant.journal import DeviceJournal
from pytest_otmcp.protocols.registry import protocols

__all__ = ["PATIENCE_S", "Control", "MockProgram", "RefusedError"]

PATIENCE_S = 40.0
"""Seconds that a test waits for something that must happen; each wait ends as soon as it has happened."""

_LINE_LIMIT = 64 * 1024 * 1024
_THIRD_PARTIES = os.path.dirname(__file__)
"""Folder of mock packages that are no part of the product; it takes the place of their installation."""


class RefusedError(Exception):
    """The device answered a control request with an error."""


class Control:
    """Client of one control connection. Requests are pipelined: several may be awaited at once."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader = reader
        self.writer = writer
        self._ids = itertools.count(1)
        self._waiting: dict[int, asyncio.Future[dict[str, Any]]] = {}
        self._pump = asyncio.create_task(self._read())
        self._decoded: DeviceJournal | None = None

    @classmethod
    async def connect(cls, path: str) -> Control:
        return cls(*await asyncio.open_unix_connection(path, limit=_LINE_LIMIT))

    async def _read(self) -> None:
        try:
            while line := await self.reader.readline():
                answer = json.loads(line)
                waiting = self._waiting.pop(answer["id"])
                if not waiting.done():
                    waiting.set_result(answer)
        except (ConnectionError, ValueError):
            pass  # gone, or a line longer than the limit: either way nothing more will be answered
        for waiting in self._waiting.values():
            if not waiting.done():
                waiting.set_exception(ConnectionError("the control channel was closed"))

    async def ask(self, op: str, **members: Any) -> dict[str, Any]:
        """Perform an operation and return its result.

        Raises:
            RefusedError: the answer was an error; the exception carries its sentence.
        """
        number = next(self._ids)
        answer: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()
        self._waiting[number] = answer
        self.writer.write(json.dumps({"id": number, "op": op, **members}).encode() + b"\n")
        reply = await asyncio.wait_for(answer, PATIENCE_S)
        if not reply["ok"]:
            raise RefusedError(reply["error"])
        result: dict[str, Any] = reply["result"]
        return result

    async def image(self) -> dict[str, Any]:
        return await self.ask("image")

    async def points(self) -> dict[str, Any]:
        """Return the flat part of the image: the value of each point."""
        found: dict[str, Any] = (await self.image())["points"]
        return found

    async def poke(self, **params: Any) -> None:
        """Change the device past its protocol."""
        await self.ask("poke", params=params)

    async def fault(self, action: dict[str, Any], **conditions: Any) -> None:
        """Give the device a fault plan of one rule."""
        await self.ask("fault", rules=[{**conditions, "action": action}])

    async def decoded(self) -> DeviceJournal:
        """Return the journal, with all that the device has recorded until now."""
        if self._decoded is None:
            protocol = (await self.ask("ready"))["protocol"]
            described = protocols().get("mqtt" if protocol == "sparkplug" else protocol)
            framing = None if described is None else described.framing
            self._decoded = DeviceJournal(None if framing is None else framing.conversation)
        self._decoded.take(await self.ask("journal", since=self._decoded.taken))
        return self._decoded

    async def journal(self, since: int = 0, **match: Any) -> list[dict[str, Any]]:
        """Return the entries from ``since`` on that have these fields."""
        entries: list[Any] = (await self.decoded()).since(since)
        return [entry for entry in entries if all(entry.get(name) == value for name, value in match.items())]

    async def wait(self, since: int = 0, count: int = 1, **match: Any) -> list[dict[str, Any]]:
        """Return the entries with these fields as soon as there are ``count``; fail if there never are."""
        journal = await self.decoded()

        async def more(timeout_s: float) -> None:
            journal.take(await self.ask("wait", since=journal.taken, timeout_s=timeout_s))

        entries: list[Any] = await journal.wait(since, match, count, PATIENCE_S / 2, more)
        assert len(entries) >= count, f"{match} did not happen {count} time(s): {entries}"
        return entries

    async def next(self) -> int:
        """Return the sequence number that the next journal entry will get."""
        return (await self.decoded()).next

    async def forget(self) -> None:
        """Release everything that there is until now."""
        journal = await self.decoded()
        journal.forget(journal.next)
        await self.ask("forget", before=journal.taken)

    async def close(self) -> None:
        self._pump.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await self._pump
        self.writer.close()
        with contextlib.suppress(ConnectionError):
            await self.writer.wait_closed()


class MockProgram:
    """``python -m pytest_otmcp.mocks …``: launcher process, its events, and the control channel of its device.

    Attributes:
        process: the launcher.
        ready_event: the newest ready line.
        control: connected to the running device by :meth:`ready`.
    """

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process = process
        self.ready_event: dict[str, Any] = {}
        self.control: Control
        self._controls: list[Control] = []

    @classmethod
    async def start(cls, *arguments: str) -> MockProgram:
        """Start the program; :meth:`ready` or :meth:`end` has to follow."""
        return cls(
            await asyncio.create_subprocess_exec(
                # The kit does it so, too: nothing may be imported from the working directory.
                *(sys.executable, "-P", "-m", "pytest_otmcp.mocks", *arguments),
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.PIPE,
                env={**os.environ, "PYTHONPATH": _THIRD_PARTIES},
            )
        )

    @property
    def host(self) -> str:
        return str(self.ready_event["host"])

    @property
    def port(self) -> int:
        return int(self.ready_event["port"])

    async def event(self) -> dict[str, Any]:
        """Return the next event on standard output."""
        assert self.process.stdout is not None
        line = await asyncio.wait_for(self.process.stdout.readline(), PATIENCE_S)
        assert line, f"the program ended: {(await self.end())[1]}"
        event: dict[str, Any] = json.loads(line)
        return event

    async def ready(self, *, paused: bool = True) -> None:
        """Wait for the device and connect to its control socket."""
        self.ready_event = await self.event()
        assert self.ready_event["event"] == "ready", self.ready_event
        self.control = await self.connect_control()
        if paused:
            await self.control.ask("pause")

    async def connect_control(self) -> Control:
        """Open another control connection."""
        control = await Control.connect(self.ready_event["control"])
        self._controls.append(control)
        return control

    def say(self, *words: str) -> None:
        """Write commands, one per line."""
        assert self.process.stdin is not None
        self.process.stdin.write("".join(f"{word}\n" for word in words).encode())

    async def restart(self) -> None:
        """Stop the device and start a new one."""
        self.say("stop")
        assert (await self.event())["event"] == "stopped"
        self.say("start")
        await self.ready()

    async def end(self) -> tuple[int, str]:
        """Close standard input; return the exit code and standard error."""
        try:
            for control in self._controls:
                await control.close()
            self._controls.clear()
            assert self.process.stdin is not None
            assert self.process.stderr is not None
            self.process.stdin.close()
            with contextlib.suppress(ConnectionError):
                await self.process.stdin.wait_closed()
            # Standard error ends with the last process that holds it: launcher or device.
            stderr = await asyncio.wait_for(self.process.stderr.read(), PATIENCE_S)
            return await asyncio.wait_for(self.process.wait(), PATIENCE_S), stderr.decode()
        finally:
            # A launcher that does not end must not outlive the test and cause a warning in another test.
            if self.process.returncode is None:
                self.process.kill()
                await self.process.wait()
