"""Mock devices as processes of their own, and the control channel on which they report what they saw.

The kit never imports a mock. It starts ``python -m pytest_otmcp.mocks NAME``, speaks one-word commands to its launcher
(``stop``, ``start``) and JSON lines to its control socket (image, journal, poke, fault, …). A mock that dies or does
not answer is a :class:`~pytest_otmcp.core.errors.KitError`: never the adapter's fault.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import os
import signal
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..core.credentials import USER
from ..core.errors import ExhaustedError, KitError, MeddledError, SubjectError
from ..core.exhaustion import exhausted
from ..protocols.journal import JournalEntry
from ..protocols.registry import protocols
from ..session.canary import new_canary
from ..session.isolation import Walls
from ..session.process import subject_environment
from ..session.starvation import Patience, finish_within
from . import pki
from .device import Journal, check_kept
from .endpoint import Endpoint, first_port, occupied
from .journal import DeviceJournal
from .owners import Sessions, process_told

__all__ = ["MockDevice"]

_LAUNCH_TIMEOUT_S = 60.0
_STARVED_S = 540.0
"""Seconds for which a mock may wait for a processor beside that: all mocks and adapters of a run start at once."""
_ANSWER_TIMEOUT_S = 20.0
_BEFORE_OTHERS = -20
"""Priority of a mock whose clients have no patience (setpriority(2))."""
_LINE_LIMIT = 64 * 1024 * 1024
_STDERR_KEPT = 8192
_EXHAUSTED = 75
"""Exit code of a launcher or device that has run out of something: EX_TEMPFAIL of ``sysexits.h``."""
_OCCUPIED = 69
"""Exit code of a device whose port another program has taken: EX_UNAVAILABLE of ``sysexits.h``."""


class _ClosedError(KitError):
    """The device has closed its control channel, so it has ended."""


_FROM_OUTSIDE = (-signal.SIGKILL, -signal.SIGTERM, -signal.SIGHUP, -signal.SIGINT)
"""Exit codes of a process that somebody has ended."""


class _Control:
    """The client of a device's control socket: pipelined requests, answers matched by id."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, name: str) -> None:
        self._reader = reader
        self._writer = writer
        self._name = name
        self._ids = itertools.count(1)
        self._waiting: dict[int, asyncio.Future[dict[str, object]]] = {}
        self._pump = asyncio.create_task(self._read(), name=f"otmcp-control-{name}")

    async def _read(self) -> None:
        with contextlib.suppress(ConnectionError, asyncio.IncompleteReadError, ValueError):
            while line := await self._reader.readline():
                answer = json.loads(line)
                waiting = self._waiting.pop(answer["id"], None)
                if waiting is not None and not waiting.done():
                    waiting.set_result(answer)
        for waiting in self._waiting.values():
            if not waiting.done():
                waiting.set_exception(_ClosedError(f"the {self._name} mock closed its control channel"))
        self._waiting.clear()

    async def ask(self, op: str, *, answer_within_s: float = _ANSWER_TIMEOUT_S, **fields: object) -> dict[str, Any]:
        if self._pump.done():
            raise _ClosedError(f"the {self._name} mock closed its control channel (asked for {op!r})")
        number = next(self._ids)
        answer: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()
        self._waiting[number] = answer
        self._writer.write(json.dumps({"id": number, "op": op, **fields}).encode() + b"\n")
        try:
            reply = await asyncio.wait_for(answer, answer_within_s)
        except TimeoutError:
            raise MeddledError(
                f"the {self._name} mock did not answer {op!r} within {answer_within_s:g} s: it was stopped or flooded, which an adapter can "
                "do, or this machine is far too busy"
            ) from None
        finally:
            self._waiting.pop(number, None)
        if not reply.get("ok"):
            raise KitError(f"the {self._name} mock refused {op!r}: {reply.get('error')}")
        result: dict[str, Any] = reply["result"]
        return result

    async def close(self) -> None:
        self._pump.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await self._pump
        self._writer.close()
        with contextlib.suppress(ConnectionError):
            await self._writer.wait_closed()


class MockDevice:
    """One mock device: its life, its journal, its image. See :class:`~pytest_otmcp.plant.device.Device`.

    Args:
        mock: name of the mock as ``python -m pytest_otmcp.mocks`` takes it: a built-in one, or the dotted name of a package.
        protocol: key of its protocol, for sentences; the name of a built-in mock is the key of its protocol.
        secure: it speaks the secure form of its protocol, with certificates made for it alone.

    Attributes:
        credentials, account: see :class:`~pytest_otmcp.plant.device.Device`.
        endpoints: see :class:`~pytest_otmcp.plant.device.Device`.
        running: True while it serves.
        faulty: see :class:`~pytest_otmcp.plant.device.Device`.
        accepting_ns: monotonic time at which its launcher said that it serves.
        sessions, walls: see :class:`~pytest_otmcp.plant.device.Device`.
    """

    def __init__(self, mock: str, protocol: str | None = None, *, secure: bool = False) -> None:
        self._mock = mock
        self._name = protocol or mock
        self._certificates: tempfile.TemporaryDirectory[str] | None = None
        self.credentials: Mapping[str, bytes] = {}
        self.account: Mapping[str, str] = {}
        if secure:
            self._certificates = tempfile.TemporaryDirectory(prefix="otmcp-")
            folder, known = Path(self._certificates.name), protocols()[self._name]
            self.credentials = pki.make(folder, known.application)
            if known.accounts:
                self.account = {"user": USER, "password": new_canary()}
                (folder / "account.json").write_text(json.dumps([*self.account.values()]), encoding="utf-8")
        self._launcher: asyncio.subprocess.Process | None = None
        self._control: _Control | None = None
        self._stderr: asyncio.Task[bytes] | None = None
        self._died: KitError | None = None
        self._journal = self._new_journal()
        self._presets: Sequence[Mapping[str, object]] = ()
        self.endpoints: Mapping[str, Endpoint] = {}
        self.running = False
        self.faulty = False
        self.accepting_ns = 0
        self.sessions = Sessions()
        self.walls: Walls | None = None

    def _new_journal(self) -> DeviceJournal:
        described = protocols().get(self._name)
        framing = None if described is None else described.framing
        return DeviceJournal(None if framing is None else framing.conversation)

    @property
    def host(self) -> str:
        """Address of its first port; empty if it has none."""
        port = first_port(self.endpoints)
        return "" if port is None else port.host

    @property
    def port(self) -> int:
        """Number of its first port; 0 if it has none."""
        port = first_port(self.endpoints)
        return 0 if port is None else port.port

    # -- life ---------------------------------------------------------------------------------------------

    async def launch(self) -> None:
        """Start the mock program and wait until its device serves, with its simulation paused."""
        # A module of the working directory must not replace one that the mock imports.
        command = [sys.executable, "-P", "-m", "pytest_otmcp.mocks"]
        namespaces: tuple[int, ...] = ()
        described = protocols().get(self._name)
        if described is not None and described.cable and (self.walls is None or not self.walls.network):
            raise KitError(
                f"the {self._name} mock needs a cable, and this machine refuses a network for it: see docs/isolation.md"
            )
        if self.walls is not None and self.walls.network:
            namespaces = self.walls.isolation.namespaces()
            command.append(f"--within={','.join(map(str, namespaces))}")
        command.append(self._mock)
        if self._certificates is not None:
            command.append(f"--tls={self._certificates.name}")
        try:
            self._launcher = await asyncio.create_subprocess_exec(
                *command,
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.PIPE,
                env=subject_environment({}),
                start_new_session=True,
                pass_fds=namespaces,
            )
            assert self._launcher.stderr is not None
            self._stderr = asyncio.create_task(_end_of(self._launcher.stderr), name=f"otmcp-stderr-{self._name}")
            if described is not None and described.cable:
                # Masters wait a few milliseconds for a frame (SOEM: 2), and a real device is not slowed down by what runs on this machine.
                with contextlib.suppress(PermissionError, ProcessLookupError):
                    os.setpriority(os.PRIO_PROCESS, self._launcher.pid, _BEFORE_OTHERS)
            await self._ready()
        except (OSError, RuntimeError) as error:
            if (cure := exhausted(error)) is not None:
                raise ExhaustedError(f"the {self._name} mock could not be started: {cure}") from error
            raise

    async def _event(self, expected: str) -> dict[str, Any]:
        assert self._launcher is not None
        assert self._launcher.stdout is not None
        patience = Patience(_LAUNCH_TIMEOUT_S, starved_s=_STARVED_S)
        patience.watch((self._launcher.pid,))
        try:
            line = await finish_within(patience, self._launcher.stdout.readline())
        except TimeoutError:
            raise KitError(f"the {self._name} mock said nothing for {_LAUNCH_TIMEOUT_S:g} s") from None
        if not line and await self._launcher.wait() == _EXHAUSTED:
            raise self._exhausted()
        if not line and self._launcher.returncode in _FROM_OUTSIDE:
            raise self._killed()
        if not line:
            stderr = (await self._stderr).decode("utf-8", "replace").strip() if self._stderr else ""
            raise KitError(f"the {self._name} mock ended unexpectedly: {stderr[-800:] or 'nothing on stderr'}")
        event: dict[str, object] = json.loads(line)
        if event.get("event") == "died" and event.get("exit") == _EXHAUSTED:
            raise self._exhausted()
        taken = first_port(self.endpoints)
        if event.get("event") == "died" and event.get("exit") == _OCCUPIED and taken is not None:
            raise occupied(taken)
        if event.get("event") != expected:
            raise KitError(f"the {self._name} mock said {event} where {expected!r} was expected")
        return event

    async def _death(self, closed: _ClosedError) -> KitError:
        """Return why a device that was not asked to stop does not answer any more; its launcher says so once."""
        if self._died is None and self.running:
            try:
                told = await self._event("died")
            except (ExhaustedError, MeddledError) as error:
                self._died = error
            else:
                self._died = self._killed() if told.get("exit") in _FROM_OUTSIDE else closed
        return self._died or closed

    def _exhausted(self) -> ExhaustedError:
        return ExhaustedError(
            f"the {self._name} mock ended because it has no file descriptors or memory left; raise the limits of its processes, "
            "for instance with `ulimit -n 1024`"
        )

    def _killed(self) -> MeddledError:
        return MeddledError(
            f"the {self._name} mock was killed by another program, as an adapter can do, or by the system, which does so when its memory "
            "runs out"
        )

    async def _ready(self) -> None:
        ready = await self._event("ready")
        self.accepting_ns = time.monotonic_ns()
        self.endpoints = {name: Endpoint(name=name, **address) for name, address in ready["endpoints"].items()}
        reader, writer = await asyncio.open_unix_connection(ready["control"], limit=_LINE_LIMIT)
        self._control = _Control(reader, writer, self._name)
        self._journal = self._new_journal()
        self.running = True
        others = [process_told(told) for told in (await self.ask("alone"))["others"]]
        await self.ask("pause")
        for other in others:
            if other is not None and self.sessions.owns(other):
                raise SubjectError(
                    "control_channel",
                    f"the adapter (its process {other.name!r}) connected to the control channel of the {self._name} mock",
                )
        if others:
            names = ", ".join(sorted({"one that has ended" if it is None else repr(it.name) for it in others}))
            raise KitError(
                f"other programs connected to the control channel of the {self._name} mock: {names}; nothing that it says "
                "can be relied on"
            )

    async def stop(self) -> None:
        """Kill the device process: its connections break, its TCP ports refuse, its other endpoints do not answer."""
        self.running = False
        await self._command("stop")
        await self._event("stopped")
        if self._control is not None:
            await self._control.close()
            self._control = None

    async def start(self) -> None:
        """Start a new device process at the same addresses and wait until it serves; ``accepting_ns`` says when.

        Raises:
            SubjectError: an adapter under test got hold of its control channel.
            ExhaustedError: another program has taken its port; it can be started once that program has ended.
        """
        await self._command("start")
        self.faulty = False
        await self._ready()
        await self.preset(self._presets)

    async def preset(self, presets: Sequence[Mapping[str, object]]) -> None:
        """Give it by pokes what has to be there for an adapter: now, and again whenever it was started or reset."""
        self._presets = presets
        for poke in presets:
            await self.poke(**poke)

    async def _command(self, word: str) -> None:
        assert self._launcher is not None
        assert self._launcher.stdin is not None
        self._launcher.stdin.write(word.encode() + b"\n")
        try:
            await self._launcher.stdin.drain()
        except ConnectionError:
            if await self._launcher.wait() in _FROM_OUTSIDE:
                raise self._killed() from None
            raise KitError(f"the {self._name} mock is gone; it cannot be told to {word}") from None

    async def close(self) -> None:
        """End launcher and device."""
        if self._certificates is not None:
            self._certificates.cleanup()
        if self._control is not None:
            await self._control.close()
            self._control = None
        self.running = False
        launcher = self._launcher
        if launcher is None:
            return
        if launcher.returncode is None and launcher.stdin is not None:
            launcher.stdin.close()
            try:
                await asyncio.wait_for(launcher.wait(), 5.0)
            except TimeoutError:
                launcher.kill()
                await launcher.wait()
        if self._stderr is not None:
            await self._stderr

    # -- witness ------------------------------------------------------------------------------------------

    async def ask(self, op: str, *, answer_within_s: float = _ANSWER_TIMEOUT_S, **fields: object) -> dict[str, Any]:
        """Send one request on the control channel and return its answer.

        Raises:
            KitError: the device is not running, refused or did not answer.
        """
        if self._control is None:
            raise KitError(f"the {self._name} mock is not running (asked for {op!r})")
        try:
            return await self._control.ask(op, answer_within_s=answer_within_s, **fields)
        except _ClosedError as error:
            raise await self._death(error) from None

    async def image(self) -> dict[str, Any]:
        """Return what the device really holds."""
        return await self.ask("image")

    async def _fetch(self, op: str = "journal", timeout_s: float = 0.0) -> None:
        """Decode what has been recorded since the last time, or what will be within so many seconds (``wait``)."""
        journal = self._journal
        fields = {"timeout_s": timeout_s} if op == "wait" else {}
        told = await self.ask(op, answer_within_s=timeout_s + _ANSWER_TIMEOUT_S, since=journal.taken, **fields)
        journal.take(told)

    async def mark(self) -> int:
        """Return the sequence number that the next journal entry will get."""
        await self._fetch()
        return self._journal.next

    async def first(self) -> int:
        """Return the sequence number of the oldest journal entry that has not been released, or of the next entry."""
        await self._fetch()
        return self._journal.first

    async def journal(self, since: int) -> Journal:
        """Return the entries from ``since`` on.

        Raises:
            KitError: the oldest of them were released, or have given way to newer ones.
        """
        await self._fetch()
        journal = self._journal
        check_kept(since, journal.first)
        return Journal(entries=self.sessions.attribute(journal.since(since), journal.peers), next=journal.next)

    async def forget(self, before: int) -> None:
        """Release the entries before ``before`` for good: they have been read."""
        self._journal.forget(before)
        await self.ask("forget", before=self._journal.taken)

    async def wait(
        self, since: int, match: Mapping[str, object], *, timeout_s: float, count: int = 1
    ) -> list[JournalEntry]:
        """Wait for entries from ``since`` on that have all fields of ``match``; return them as soon as there are
        ``count``, or those found when the time is over.

        Raises:
            KitError: the oldest entries from ``since`` on were released, or have given way to newer ones.
        """
        # Whose an entry is, is decided afterwards.
        fields = {name: value for name, value in match.items() if name != "origin"}

        async def look(count: int, timeout_s: float) -> list[JournalEntry]:
            await self._fetch()
            entries = await self._journal.wait(since, fields, count, timeout_s, lambda s: self._fetch("wait", s))
            check_kept(since, self._journal.first)
            return self.sessions.attribute(entries, self._journal.peers)

        return await self.sessions.wait(look, match, count=count, timeout_s=timeout_s)

    async def poke(self, **params: object) -> None:
        """Set a value out of band."""
        await self.ask("poke", params=params)

    async def fault(self, *rules: Mapping[str, object]) -> None:
        await self.ask("fault", rules=[dict(rule) for rule in rules])
        self.faulty = bool(rules)

    async def delay(self, seconds: float) -> None:
        """Give every answer so many seconds late from now on; 0 ends that. It takes the place of the fault plan."""
        rules = [{**rule, "action": {"delay_s": seconds}} for rule in protocols()[self._name].delayed]
        await self.fault(*(rules if seconds else ()))

    async def reset(self) -> bool:
        """Bring back start-up values without faults, with the simulation paused; connections and journal stay. Return whether a connection
        is dead that its client may not have given up."""
        answer = await self.ask("reset")
        self.faulty = False
        await self.ask("pause")
        await self.preset(self._presets)
        return bool(answer["dead_connections"])

    async def tick(self, steps: int = 1) -> None:
        """Advance the simulation by ``steps`` seconds of plant time."""
        await self.ask("tick", steps=steps)


async def _end_of(stream: asyncio.StreamReader) -> bytes:
    """Read a stream to its end; return its last bytes."""
    kept = b""
    while block := await stream.read(_STDERR_KEPT):
        kept = (kept + block)[-_STDERR_KEPT:]
    return kept
