"""One adapter variant at its device: its session, and abstract operations turned into tool calls.

A session that broke is replaced. This module knows no tasks and judges nothing.
"""

from __future__ import annotations

import asyncio
import io
import os
import socket
import stat
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import BinaryIO, Literal, TypedDict, cast
from urllib.parse import urlsplit

from .. import __version__
from ..core.errors import KitError, NoBindingError, NoHandleError, SubjectError, UsageError
from ..core.files import new_file_below, remove_below
from ..core.strict_json import parse_strict
from ..core.text import recorded_name
from ..core.tool_entry import TWICE
from ..plant.device import Device
from ..plant.endpoint import endpoint_values
from ..plant.field_device import FieldDevice
from ..plant.owners import TOKEN_VARIABLE, new_token
from ..protocols.envelope import check_result
from ..protocols.registry import protocols
from ..record.schema import (
    AdapterFacts,
    Footprint,
    Question,
    StoredBinding,
    Tested,
    ToolListing,
    ToolsChanged,
    ToolSurface,
    VariantName,
)
from ..record.schema import Device as DeviceFacts
from ..session.caller import ISSUER, Caller, Guise
from ..session.canary import CANARY_VARIABLE, Leak, SecretSearch, new_canary
from ..session.exchange import Answer as PersonsAnswer
from ..session.exchange import Exchange, joined, joint
from ..session.footprint import footprint, limit_file
from ..session.free_port import free_port
from ..session.http import connected
from ..session.isolation import Walls
from ..session.limits import Allowance
from ..session.pace import Pace
from ..session.person import Person
from ..session.process import StopReport, SubjectProcess, subject_environment
from ..session.session import McpSession, SessionOptions
from ..subject.addressing import addressed_by, carries_address
from ..subject.answers import Answer, interpret, read_answer
from ..subject.claims import Claims
from ..subject.comparison import stored_bindings
from ..subject.functions import Refused, ToolAnswer, checked_outputs
from ..subject.handles import Handles
from ..subject.imports import libraries_used
from ..subject.model import (
    CONNECT,
    GOVERNED,
    READ_WRITE,
    WITH_TOKENS,
    Adapter,
    Answering,
    Binding,
    Function,
    Governed,
    Variant,
    handles,
    replace_placeholders,
    replace_template,
)
from ..subject.tested import fingerprint
from .alteration import Alteration, expanded
from .cursor import JournalCursor
from .reply import Expectation, Reply, kept_of, observe, replace_outputs
from .subject_in_rig import SubjectInRig
from .tool_surface import surface
from .work_folder import WorkFolder

__all__ = ["MAIN", "AdapterUnderTest", "BenchOptions", "EndedSession"]

_EXIT_GRACE_S = 5.0
"""Time that an adapter has from the end of its stdin to its exit (requirement MCP-009)."""

_MEANINGLESS = "otmcp-neither-on-nor-off"
"""No adapter can take this for "on" or "off"."""

_CREDENTIALS = "otmcp-tls"
"""Folder of the adapter's certificates, in the one that it works in."""

_KEY_SET = "otmcp-keys.json"
"""The public key of the issuer of tokens, in the folder that the adapter works in."""

_OTHER_ADDRESS = "127.0.0.2"
"""Of this machine, as is all of 127.0.0.0/8, and in no subject file."""

_READY_PAUSE_S = 0.05
"""Time between two questions whether the adapter is ready."""

_MOST_FAILED_STARTS = 2
"""Starts in a row that may fail before an adapter is not started any more."""

_COMMAND_S = 30.0
"""Time within which a command of the subject file, such as its verifier, has ended."""

_MOST_OF_LOG, _MOST_LINES = 1 << 20, 1000
"""Bytes, or lines of a command, that are read of an audit log at once."""

AUTO = "auto"
"""The era in which an adapter is asked what it speaks."""

MAIN = "main"
"""Name of the worker of a run that has only one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchOptions:
    """Settings of a run that the bench needs.

    Attributes:
        era: MCP protocol era, ``auto`` or ``legacy``.
        time_scale: factor on deadlines and windows, for slow machines.
        soak: steps that have a long form take it.
        worker: name of this process among those of the run.
        devices: the real devices of the run by protocol, as its record has them.
    """

    era: str = "auto"
    time_scale: float = 1.0
    soak: bool = False
    worker: str = MAIN
    devices: Mapping[str, Mapping[str, object]] = field(default_factory=dict)


class ServerFacts(TypedDict, total=False):
    """How an adapter's server introduced itself; empty as long as no session was opened."""

    server_name: str
    server_version: str
    protocol_version: str
    tools: int


@dataclass(frozen=True, slots=True, kw_only=True)
class EndedSession:
    """The facts of a session that is over. The session itself, a quarter of a megabyte, is not kept: an item may have a thousand.

    Attributes:
        stray_lines, first_stray: number of lines on stdout that are no MCP message, and the first of them.
        report: the end of the process; None when there was none.
        tools_changed: how the list of tools was another one at the end; or None.
    """

    stray_lines: int
    first_stray: str
    report: StopReport | None
    tools_changed: ToolsChanged | None = None


class AdapterUnderTest:
    """One adapter variant, its session, and the device it talks to.

    Attributes:
        tools: what the adapter last listed, name to its entry; None as long as no session was opened.
        first: sequence number at which the adapter took over the journal of its device.
        cursor: where the adapter is in the journal of its device.
        stated: what the subject states of the adapter.
        used: operations that were performed.
        legacy: the adapter ended at the first request of today's handshake, and was started with the one of 2025-11-25.
        unmet: requirements of the envelope that the adapter's own answers do not meet, where it does not claim to have one.
        caller: who calls, of the adapter that takes tokens; None for one that asks nobody.
        person: answers the questions of the adapter with a policy; None for a client that cannot be asked.
        unconnected: the connect step failed; where the device was away, it is made again once it is back.
    """

    def __init__(
        self,
        adapter: Adapter,
        variant: str,
        device: Device,
        options: BenchOptions,
        *,
        first: int = 0,
        allowance: Allowance | None = None,
    ) -> None:
        self.adapter = adapter
        self.variant = variant
        self.device = device
        device.sessions.expect()
        self.session: McpSession | None = None
        self.tools: Mapping[str, Mapping[str, object]] | None = None
        self.unmet: set[str] = set()
        self._options = options
        self._allowance = allowance or Allowance()
        self._failed_starts: list[SubjectError] = []
        self.unconnected = False
        self._work: WorkFolder | None = None
        self._token: str | None = None
        self._server: ServerFacts = {}
        self.used: dict[str, None] = {}
        self._called: set[str] = set()
        self._calls = Counter[str]()
        self._ended: list[EndedSession] = []
        self._searches: list[SecretSearch] = []
        self._told: set[str] = set()
        self._addressed = False
        self._handles = self._no_handles()
        self._launched: Variant | None = None
        self._placeholders: Mapping[str, str] = {}
        self._tested: Tested | None = None
        self.legacy = False
        self._garbled: Mapping[str, str] = {}
        self._withheld: tuple[str, ...] = ()
        self._persona: Mapping[str, str] = {}
        self.person = self._new_person() if variant == GOVERNED else None
        self.caller = Caller(adapter.tokens.scopes) if variant == WITH_TOKENS and adapter.tokens is not None else None
        self._read_of_log = 0
        self._by_handshake = self._refuses_handshake = False
        # One for all sessions: the kit cannot know whether the adapter forgets with its process.
        limit = adapter.call_limit
        self._pace = None if limit is None else Pace(limit.calls, limit.per_s)
        self.first = first
        self.cursor = JournalCursor(adapter.protocol, first)
        claims = Claims.of_subject({adapter.protocol: adapter})
        self.stated = SubjectInRig(adapter.protocol, adapter.facts(), claims, addressed_by=addressed_by(adapter))

    @property
    def deadline_s(self) -> float:
        """Seconds within which every call must have answered."""
        return self.adapter.deadline_s * self._options.time_scale

    @property
    def device_name(self) -> str:
        """Name of the device in the run record."""
        name = self.adapter.protocol if self.variant == READ_WRITE else f"{self.adapter.protocol}@{self.variant}"
        return name if self._options.worker == MAIN else f"{self._options.worker}:{name}"

    @property
    def endpoint(self) -> dict[str, str]:
        """Values of the placeholders of a subject file, by name."""
        return endpoint_values(protocols()[self.adapter.protocol].scheme, self.device.endpoints)

    def facts(self) -> AdapterFacts:
        """Return what ``run.json`` says about the adapter."""
        adapter = self.adapter
        facts: AdapterFacts = {
            **adapter.facts(),
            **self._server,
            "bindings": {
                name: cast("list[StoredBinding] | None", stored_bindings(adapter, name))
                for name in self.used
                if name in adapter.operations
            },
            "unmet": sorted(self.unmet),
            "listing": {tool: entry for tool in sorted(self._called) if (entry := self.listing(tool)) is not None},
            "addressed_by": addressed_by(adapter),
            "libraries": self._libraries(),
        }
        if self._tested is not None:
            facts["tested"] = self._tested
        calls = Counter(self._calls)
        if self.session is not None:
            calls.update(_calls_of(self.session))
        if calls:
            facts["calls"] = dict(sorted(calls.items()))
        return facts

    def _libraries(self) -> dict[str, str]:
        return {} if self._launched is None else libraries_used(self._launched.command, self._launched.cwd)

    def listing(self, tool: str) -> ToolListing | None:
        """Return what ``tools/list`` says of a tool, as far as it is judged; None where it says nothing."""
        entry = (self.tools or {}).get(tool)
        if entry is None:
            return None
        listed: ToolListing = {"inputSchema": entry.get("inputSchema"), "annotations": entry.get("annotations")}
        if TWICE in entry:
            listed["twice"] = cast(Literal["alike", "other"], entry[TWICE])
        return listed

    def consulted(self, operation: str, tool: str) -> ToolListing | None:
        """Return what ``tools/list`` says of a tool; the record has it then, whether or not the tool is ever called."""
        if operation in self.adapter.operations:
            self.used[operation] = None
        self._called.add(tool)
        return self.listing(tool)

    def device_facts(self) -> DeviceFacts:
        """Return what ``run.json`` says about the device."""
        facts: DeviceFacts = {
            "protocol": self.adapter.protocol,
            "variant": cast(VariantName, self.variant),
            "worker": self._options.worker,
            "endpoints": [endpoint.facts() for endpoint in self.device.endpoints.values()],
            "placeholders": self.endpoint,
            "first": self.first,
        }
        if isinstance(self.device, FieldDevice):
            facts["witnesses"] = witnesses = self.device.witnesses.copy()
            if self.device.library in self._libraries():
                witnesses["state"] += ", as the adapter is"
        return facts

    # -- life ---------------------------------------------------------------------------------------------

    def new_session(self) -> McpSession:
        """Return a session that has not been opened yet, with a process of its own."""
        if self._work is None:
            self._work = WorkFolder()
        url = self.adapter.url_of(self.variant)
        values = {
            **self.endpoint,
            "python": sys.executable,
            "kit_version": __version__,
            "dir": str(self.adapter.directory),
            "work": self._work.name,
            "http_port": str(self._free_port(socket.SOCK_STREAM)) if url is not None else "",
            "local_port": str(self._free_port(socket.SOCK_DGRAM)),
            **self.device.account,
            **{name: str(Path(self._work.name, _CREDENTIALS, f"{name}.pem")) for name in self.device.credentials},
        }
        url = None if url is None else str(replace_placeholders(url, values))
        files = {f"{_CREDENTIALS}/{name}.pem": content for name, content in self.device.credentials.items()}
        if self.caller is not None:
            assert url is not None
            self.caller.begin(url)
            files[_KEY_SET] = self.caller.key_set
            values |= {"issuer": ISSUER, "issuer_keys": str(Path(self._work.name, _KEY_SET)), "audience": url}
        self._placeholders = values
        launch = self.adapter.variants[self.variant].for_endpoint(values)
        canaries = {name: new_canary() for name in (CANARY_VARIABLE, *self.adapter.secret_env)}
        canaries |= {name: launch.env[name] for name in self.adapter.secret_env if name in launch.env}
        search = SecretSearch(canaries, self.adapter.telling_secrets(launch.env))
        self._launched = launch
        if self._tested is None:
            self._tested = fingerprint(launch.command, launch.cwd)
        files |= {name: content.encode() for name, content in launch.files.items()}
        withheld = [f"{_CREDENTIALS}/{name}.pem" for name in self._withheld]
        for name, content in files.items():
            # An earlier session of the adapter may have put something else there.
            if name in withheld:
                remove_below(self._work.name, name)
                continue
            with new_file_below(self._work.name, name) as made:
                made.write(content)
        options = SessionOptions(
            era="legacy" if self.legacy or self._by_handshake else self.adapter.era or self._options.era,
            start_timeout_s=self.adapter.start_timeout_s * self._options.time_scale,
            exit_grace_s=_EXIT_GRACE_S * self._options.time_scale,
            pace=self._pace,
            allowance=self._allowance,
            secrets=search,
            work=self._work.name,
            url=url,
            walls=self._walls(),
            person=self.person,
            caller=self.caller,
        )
        self._token = new_token()
        env = {**canaries, **launch.env, **self._garbled, **self._persona, TOKEN_VARIABLE: self._token}
        self._read_of_log = 0
        session = McpSession(launch.command, env, launch.cwd, options)
        self._searches = [*(one for one in self._searches if one.leaks), search]
        self.device.sessions.begin(self._token, lambda: session.pid)
        return session

    def _walls(self) -> Walls | None:
        if self.device.walls is None or self._work is None:
            return None
        for path in self.adapter.openings.writes:
            if not path.exists():
                raise SubjectError("cannot_start", f"isolation.write in the subject file: {path} is not there")
        lines = [endpoint.path for endpoint in self.device.endpoints.values() if endpoint.kind == "pty"]
        return self.device.walls.open_to(
            reads=(*lines, *map(str, self.adapter.openings.reads)),
            writes=(self._work.name, *map(str, self.adapter.openings.writes)),
        )

    def _free_port(self, kind: socket.SocketKind) -> int:
        walls = self.device.walls
        return free_port(partial(socket.socket, type=kind) if walls is None else partial(walls.socket, kind))

    # -- policy, audit log and approval -----------------------------------------------------------------------

    async def play(self, *, viewer: bool, can_ask: bool) -> None:
        """Be a caller who may write nothing, or the one of the launch, from the next session on, and a client that can be asked or not."""
        self.person = self._new_person() if can_ask else None
        self._persona = self._governed.viewer or {} if viewer else {}

    def _new_person(self) -> Person:
        return Person((self._governed.told.approval or {}).get("form", {}))

    async def disguise(self, guise: Guise) -> None:
        """Send the requests that follow as another caller."""
        assert self.caller is not None, "only steps of the launch for tokens are another caller"
        self.caller.guise = guise

    async def listens_beyond(self) -> bool:
        """Return whether the server of the launch for tokens takes connections at an address that it was not told: on which it listens only
        if it does on every one of this machine."""
        url = urlsplit(self._placeholders["audience"])
        try:
            (await connected(self.device.walls, _OTHER_ADDRESS, url.port or 80)).close()
        except OSError:
            return False
        return True

    async def answer(self, answer: PersonsAnswer) -> None:
        """Answer so what the adapter asks from now on."""
        if self.person is not None:
            self.person.answer = answer

    async def redeem(self) -> None:
        """Let the next call bring the acceptance of the newest question that had no answer."""
        if self.person is not None:
            self.person.redeem()

    async def questions(self) -> list[Question]:
        """Return what the adapter has asked since the last look."""
        if self.person is None:
            return []
        asked, self.person.questions = self.person.questions, []
        return asked

    async def approve(self, request: str) -> bool:
        """Approve a request outside of MCP; return whether that could be done."""
        return (await self._run(self._governed.approve, {"approval": request}))[0] == 0

    async def decline(self, request: str) -> bool:
        """Decline a request outside of MCP; return whether that could be done."""
        return (await self._run(self._governed.decline, {"approval": request}))[0] == 0

    async def audit_lines(self) -> list[str]:
        """Return the lines of the audit log that are new since the last look at the log of this session; of very many, the first."""
        if self._governed.log:
            with self._opened_log() as file:
                file.seek(self._read_of_log)
                new = file.read(_MOST_OF_LOG)
            self._read_of_log += len(new)
            lines = new.splitlines()
        else:
            _, every = await self._run(self._governed.records)
            lines, self._read_of_log = every[self._read_of_log :], len(every)
        if self._searches:
            self._searches[-1].look(b"\n".join(lines), lambda: "the audit log")
        return [line.decode("utf-8", "backslashreplace") for line in lines]

    async def cramp(self, more: int | None) -> bool:
        """Let the audit log grow by so many bytes at most, or as it will; return whether it is so limited now."""
        marker = f"{TOKEN_VARIABLE}={self._token}".encode()
        return limit_file(self._current().pid, marker, self._log(), more)

    async def verified(self, anchor: str, edits: Mapping[str, Callable[[list[bytes]], list[bytes]]]) -> dict[str, bool]:
        """Return for each edit whether the verifier takes the edited audit log for whole. Afterwards it is as it was.
        Nothing is returned of one that is too long.

        Args:
            anchor: what the newest answer says of its record.
            edits: name to what makes other lines of those of the log.
        """
        found: dict[str, bool] = {}
        with self._opened_log() as file:
            whole = file.read(_MOST_OF_LOG)
            if len(whole) == _MOST_OF_LOG:
                return found
            try:
                for name, edit in edits.items():
                    _overwrite(file, b"".join(edit(whole.splitlines(keepends=True))))
                    found[name] = (await self._run(self._governed.verify, {"anchor": anchor}))[0] == 0
            finally:
                _overwrite(file, whole)
        return found

    @property
    def _governed(self) -> Governed:
        assert self.adapter.governed is not None, "only steps of the launch with a policy look there"
        return self.adapter.governed

    def _log(self) -> Path:
        return Path(str(replace_placeholders(self._governed.log, self._placeholders)))

    def _opened_log(self) -> BinaryIO:
        """Open the file with the audit records; an empty one in its place where there is none.

        It lies where the adapter may put something else in its place, such as a link to a file that is none of its own.
        """
        try:
            file = os.fdopen(os.open(self._log(), os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC), "r+b")
        except OSError:
            return io.BytesIO()
        found = os.fstat(file.fileno())
        if stat.S_ISREG(found.st_mode) and found.st_nlink == 1 and self._is_its_own(file):
            return file
        file.close()
        return io.BytesIO()

    def _is_its_own(self, file: BinaryIO) -> bool:
        """Tell whether an open log lies where its path says, if that is where the adapter may write: a link may have led elsewhere."""
        assert self._work is not None
        place = Path(os.readlink(f"/proc/self/fd/{file.fileno()}"))
        return all(
            place.is_relative_to(folder.resolve())
            for folder in (Path(self._work.name), *self.adapter.openings.writes)
            if self._log().is_relative_to(folder)
        )

    async def _run(
        self, command: Sequence[str], more: Mapping[str, str] = MappingProxyType({})
    ) -> tuple[int, list[bytes]]:
        """Run a command of the subject file within the adapter's walls; return its exit code and the lines that it prints.

        Raises:
            SubjectError: it cannot be run, or takes too long.
        """
        lines: list[bytes] = []
        words = [str(replace_placeholders(word, {**self._placeholders, **more})) for word in command]
        env = subject_environment(self._launched.env if self._launched is not None else {})
        try:
            process = await SubjectProcess.start(
                words,
                env=env,
                cwd=None if self._launched is None else self._launched.cwd,
                on_line=lambda _, line: lines.append(line) if len(lines) < _MOST_LINES else None,
                on_overflow=lambda _: None,
                walls=self._walls(),
            )
        except OSError as error:
            raise SubjectError("cannot_start", f"{words[0]!r} cannot be run: {error.strerror}") from None
        try:
            await asyncio.wait_for(process.exited.wait(), _COMMAND_S)
            await process.settle()
        except TimeoutError:
            raise SubjectError("cannot_start", f"{words[0]!r} did not end within {_COMMAND_S:g} s") from None
        finally:
            report = await process.stop(grace_s=0.0)
        code = process.returncode if report.returncode is None else report.returncode
        return -1 if code is None else code, lines

    async def footprint(self) -> Footprint:
        """Return what the processes of the session take of the machine."""
        return footprint(None if self.session is None else self.session.pid)

    async def listed(self) -> dict[str, ToolListing]:
        """Return what the session's ``tools/list`` says, name to entry, as far as it is judged."""
        return {name: entry for name in self._current().tools if (entry := self.listing(name)) is not None}

    async def surface(self) -> dict[str, ToolSurface]:
        """Return what a model reads of each tool of the session, by name."""
        return {name: surface(entry) for name, entry in self._current().tools.items()}

    async def list_anew(self) -> str:
        """Ask for the list of tools again; see :meth:`pytest_otmcp.session.session.McpSession.list_anew`."""
        return await self._current().list_anew(timeout_s=self.deadline_s)

    async def write_line(self, line: str) -> bool:
        """Write a line to the adapter's standard input as it is; return whether there is such a stream."""
        return self._current().write_line(line.encode("utf-8", "surrogateescape"))

    async def stderr_tail(self) -> list[str]:
        """Return the newest lines that the adapter has written to standard error, oldest first."""
        return self._current().stderr_tail()

    async def made_file(self, name: str) -> bool:
        """Return whether a file of this name is in a folder that the adapter works in, and remove it."""
        return self._take_file(name)

    def _take_file(self, name: str) -> bool:
        folders = {self.adapter.variants[self.variant].cwd or Path.cwd()}
        if self._work is not None:
            folders.add(Path(self._work.name))
        if self.session is not None and self.session.pid is not None:
            with suppress(OSError):
                # An adapter may have gone to a folder of its own, and what it writes in this one may lie where only it can see it.
                folders.add(Path(f"/proc/{self.session.process_pid}/cwd"))
        found = False
        for file in (folder / name for folder in folders):
            with suppress(OSError):
                file.unlink()
                found = True
        return found

    async def open(self) -> None:
        """Make sure that there is a usable session.

        Raises:
            SubjectError: the adapter cannot be started. Once that was so twice in a row it is raised again at once, so that
                not every item waits for a start that runs into its deadline. One failed start proves nothing about the next.
            NoBindingError: so it is because the tap before a real device cannot see what it asks for.
        """
        if len(self._failed_starts) == _MOST_FAILED_STARTS:
            raise self._failed_starts[-1]
        if self.session is not None and not self.session.died:
            return
        await self.close()
        if self.device.running:
            known = protocols()[self.adapter.protocol]
            await self.device.preset(known.presets(self.adapter.lists))
        # Everything that this session does at its device is in the journal from this sequence number on.
        self.cursor.open_session(await self.device.mark() if self.device.running else self.cursor.next)
        try:
            session = await self._opened()
            self._handles = self._no_handles()
            self.session, self.tools = session, session.tools
            if not self._by_handshake:
                self._server = {
                    "server_name": recorded_name(session.server_name),
                    "server_version": recorded_name(session.server_version),
                    "protocol_version": recorded_name(session.protocol_version),
                    "tools": len(session.tools),
                }
            await self._connect()
            await self._wait_until_ready()
        except SubjectError as failure:
            await self.close()
            if isinstance(self.device, FieldDevice):
                self.device.see()
                self.device.excuse()
            # Without its device, or at one that refuses it as the kit has told it to, an adapter may have failed to start for that reason.
            well = self.device.running and not self.device.faulty
            self._failed_starts = [*self._failed_starts, failure] if well else []
            raise
        self._failed_starts = []

    async def excuse(self) -> None:
        """Make sure that a failure at a real device which is not due is the adapter's own.

        Raises:
            NoBindingError: it may not be.
        """
        if isinstance(self.device, FieldDevice):
            self.device.excuse()

    async def open_garbled(self) -> bool:
        """Start the adapter with a write switch whose value means nothing, and return whether it started.

        There is no session yet. An adapter without such a switch is not started.
        """
        switch = self.adapter.write_switch
        if switch is None:
            return False
        self._garbled = {switch: _MEANINGLESS}
        return await self._open_if_it_can()

    async def open_without_certificate(self) -> bool:
        """Start the adapter without the files of its own certificate, and return whether it started. There is no session yet."""
        self._withheld = ("cert", "key")
        return await self._open_if_it_can()

    async def _open_if_it_can(self) -> bool:
        try:
            await self.open()
        except SubjectError:
            # To refuse to start is as good as to refuse to write.
            self._failed_starts = []
            return False
        finally:
            self._garbled, self._withheld = {}, ()
        return True

    async def open_by_handshake(self) -> str | None:
        """Start the adapter anew in the era of the handshake, in which it is started until :meth:`close_handshake_era`.

        Returns:
            The revision that was agreed on; None where the adapter does not speak any of that era. Then there is no session.
        """
        await self.close()
        self._by_handshake = True
        try:
            await self.open()
        except SubjectError:
            # A server need not speak the older revisions.
            self._failed_starts = []
            self._by_handshake, self._refuses_handshake = False, True
            return None
        assert self.session is not None
        return recorded_name(self.session.protocol_version)

    @property
    def may_speak_by_handshake(self) -> bool:
        """The session is of the newer era, and nothing has shown that the adapter does not speak the one of the handshake."""
        return self.session is not None and not self.session.by_handshake and not self._refuses_handshake

    async def close_handshake_era(self) -> None:
        """End the session that was opened by :meth:`open_by_handshake`; the next one is opened as always."""
        await self.close()
        self._by_handshake = False

    async def _opened(self) -> McpSession:
        """Start the adapter; one that ends, or stops, at the first request of today's handshake is started with the one of 2025.

        Raises:
            SubjectError: it cannot be started in either way; what is said is about the first.
        """
        session = self.new_session()
        try:
            await session.open()
        except SubjectError as failure:
            ended = session.stop_report is not None and session.stop_report.how == "exited"
            # A server of an older SDK fails in its reader; the rest of the process may go on and never answer.
            stopped = ended or failure.code == "start_timeout"
            if not stopped or (self.adapter.era or self._options.era) != AUTO or self.legacy:
                raise
            self.legacy = True
            session = self.new_session()
            try:
                await session.open()
            except SubjectError:
                self.legacy = False
                raise failure from None
        return session

    async def _connect(self) -> None:
        failure = await self.connect()
        if failure is not None and self.device.running:
            tool = self.adapter.connect.tool if self.adapter.connect is not None else ""
            raise SubjectError("connect_step", f"the connect step {tool!r} failed: {failure[:2000]}")

    async def connect(self) -> str | None:
        """Perform the subject's connect step, if it has one; returns the words of its failure, or None."""
        failure = await self._step()
        self.unconnected = failure is not None
        return failure

    async def _step(self) -> str | None:
        step = self.adapter.connect
        if step is None:
            return None
        answer, message = await self._asked(step.tool, step.arguments, self.adapter.answering)
        if not answer.success or not step.keep:
            return None if answer.success else answer.text
        values = kept_of(step.keep, message, self.adapter.answering)
        if lacking := [name for name, value in values.items() if value is None]:
            return f"its answer has nothing where 'keep' looks for {' and '.join(lacking)}; it said: {answer.text}"
        self._handles.keep(CONNECT, step.tool, {}, values)
        return None

    def _no_handles(self) -> Handles:
        return Handles(protocols()[self.adapter.protocol].covers)

    def _taken(self, binding: Binding, inputs: Mapping[str, object]) -> dict[str, object]:
        try:
            return self._handles.take(handles(binding.arguments), inputs)
        except LookupError as gap:
            raise NoHandleError(f"{self.adapter.protocol}: {binding.tool} takes {gap.args[0]}") from None

    async def _wait_until_ready(self) -> None:
        """Wait until the adapter says that it is ready, where its subject names a tool that does. Without its device it need not be.

        Raises:
            SubjectError: it does not say so within the time for its start.
        """
        ready = self.adapter.ready
        if ready is None or not self.device.running:
            return
        if ready.tool not in self._current().tools:
            raise SubjectError("not_ready", f"'ready' names the tool {ready.tool!r}, which the adapter does not list")
        limit_s = self.adapter.start_timeout_s * self._options.time_scale
        until = asyncio.get_running_loop().time() + limit_s
        while not (answer := (await self._asked(ready.tool, ready.arguments, ready.answering))[0]).success:
            if asyncio.get_running_loop().time() > until:
                said = answer.text[:2000]
                message = f"{ready.tool!r} did not say within {limit_s:g} s of the start that the adapter is ready; it said: {said}"
                raise SubjectError("not_ready", message)
            await asyncio.sleep(_READY_PAUSE_S)

    async def _asked(
        self, tool: str, arguments: Mapping[str, object], answering: Answering
    ) -> tuple[Answer, Mapping[str, object]]:
        """Call a tool for which no operation stands; return its answer as the rules read it, and as it came."""
        told = replace_template(arguments, self._handles.take(handles(arguments), {}), self.endpoint)
        exchange = await self._current().call(tool, told, timeout_s=1.2 * self.deadline_s)
        if exchange.response is None:
            return Answer(success=False, document=None, text=f"no reply ({exchange.failure})"), {}
        try:
            message = parse_strict(exchange.response)
        except ValueError as error:
            return Answer(success=False, document=None, text=f"the response is not strict JSON: {error}"), {}
        return interpret(message, answering), message

    async def close(self) -> None:
        """Close the session, if there is one."""
        session, self.session = self.session, None
        self.cursor.close_session()
        if session is not None:
            changed = await session.tools_changed()
            session.look_at_arguments()
            await session.close()
            self._calls.update(_calls_of(session))
            stray, first = session.stray_output()
            self._ended.append(
                EndedSession(
                    stray_lines=stray,
                    first_stray=first[0] if stray else "",
                    report=session.stop_report,
                    tools_changed=changed,
                )
            )
        token, self._token = self._token, None
        if token is not None:
            if self.device.running:
                # What its process has sent before it ended is its own; it is in the journal before the answer.
                with suppress(KitError):
                    await self.device.mark()
            self.device.sessions.end(token)
        work, self._work = self._work, None
        if work is not None:
            work.cleanup()

    def take_ended(self) -> list[EndedSession]:
        """Return the sessions that have ended since the last question."""
        ended, self._ended = self._ended, []
        return ended

    def take_leaks(self) -> tuple[Leak, ...]:
        """Return the secrets that were told in the session that there is, and in those that have ended, or were never opened, since the
        last question; each variable at each place once."""
        if self.session is not None:
            self.session.look_at_arguments()
        found = dict.fromkeys(leak for search in self._searches for leak in search.leaks)
        self._told = self.told_secrets
        self._searches = [] if self.session is None else self._searches[-1:]
        return tuple(found)

    @property
    def told_secrets(self) -> set[str]:
        """The secrets that were told in any session; they must not get into what the run keeps."""
        return self._told.union(*(search.told for search in self._searches))

    def _current(self) -> McpSession:
        if self.session is None:
            raise KitError(f"the {self.adapter.protocol} session was used before it was opened")
        return self.session

    # -- calls --------------------------------------------------------------------------------------------

    async def call(
        self,
        operation: str,
        inputs: Mapping[str, object],
        *,
        altered: Alteration | None = None,
        cancel: asyncio.Event | None = None,
    ) -> Reply:
        """Perform an abstract operation through the adapter's own tools.

        Args:
            operation: name of the operation.
            inputs: the operation's inputs.
            altered: change to the arguments of the tool; for an operation that a Python function performs there is none.
            cancel: the call is cancelled when this is set before the answer has come.

        Raises:
            NoBindingError: the subject does not say how it is performed.
            NoHandleError: it takes a handle that no call has yielded.
            KitError: the operation writes, and the session is not proven to talk to the mock device.
        """
        self._guard(operation, writes=protocols()[self.adapter.protocol].operations[operation].writes)
        bound = self.adapter.operations.get(operation)
        self.used[operation] = None
        session = self._current()
        if isinstance(bound, Function):
            return await self._perform(bound, session, dict(inputs))
        binding = next((case for case in bound or () if case.fits(inputs)), None)
        if binding is None:
            asked = ", ".join(f"{name}={value!r}" for name, value in inputs.items()) if bound else "any input"
            raise NoBindingError(
                f"{self.adapter.protocol}: the subject binds no tool to the operation {operation!r} for {asked}"
            )
        # The client gives up a little later than the deadline, so that a late answer is seen to be late.
        timeout_s = 1.2 * self.deadline_s
        taken: dict[str, object] = {}
        if binding.resource:
            exchange = await session.read_resource(binding.tool, timeout_s=timeout_s)
        else:
            taken = self._taken(binding, inputs)
            arguments = filled = binding.fill(inputs, self.endpoint, taken)
            tool, writes = binding.tool, protocols()[self.adapter.protocol].operations[operation].writes
            if altered is not None:
                arguments, tool = altered.applied(arguments), altered.tool or tool
            # What a check adds to a read is no way in which the adapter is told where its device is.
            self.check_address(tool, arguments if writes else filled, writes=writes)
            self._called.add(tool)
            exchange = await session.call(tool, expanded(arguments), timeout_s=timeout_s, cancel=cancel)
            if tool != binding.tool:
                # What another tool than the one that is bound answers is not judged: it counts as not called.
                session.calls[tool] -= 1
            exchange = replace(exchange, arguments=arguments)
        listed = self.variant == READ_WRITE or binding.resource or binding.tool in session.tools
        if altered is not None and altered.tool is not None:
            listed = altered.tool in session.tools
        expected = Expectation.of(
            binding,
            inputs,
            adapter=self.adapter.protocol,
            variant=self.variant,
            operation=operation,
            deadline_s=self.deadline_s,
            listed=listed,
        )
        if not binding.answering.native:
            self._note_unmet(exchange)
        reply = replace(observe(exchange, expected), taken=taken)
        if binding.keep and altered is None and reply.success and exchange.response is not None:
            rules = {name: rule.about(binding.told(inputs)) for name, rule in binding.keep.items()}
            values = kept_of(rules, parse_strict(exchange.response), binding.answering)
            self._handles.keep(operation, binding.tool, dict(inputs), values)
        return reply

    async def call_tool(
        self, tool: str, arguments: Mapping[str, object], *, writes: bool, timeout_s: float
    ) -> Exchange:
        """Call a tool by its own name.

        Args:
            writes: it may write, as far as is known.

        Raises:
            KitError: the tool may write, and the session is not proven to talk to the mock device.
        """
        self._guard(tool, writes=writes)
        self.check_address(tool, arguments, writes=writes)
        return await self._current().call(tool, arguments, timeout_s=timeout_s)

    async def refuses(self, tool: str) -> bool | None:
        """Call a tool that is not listed, and return whether the answer is a failure by the subject's rules; None where there is none.

        Raises:
            KitError: the adapter has such a tool.
        """
        session = self._current()
        if tool in session.tools:
            raise KitError(f"{tool} is a tool of this adapter")
        exchange = await session.call(tool, {}, timeout_s=1.2 * self.deadline_s)
        try:
            return None if exchange.response is None else not self._interpreted(exchange.response).success
        except ValueError:
            return None

    def _interpreted(self, response: bytes) -> Answer:
        return interpret(parse_strict(response), self.adapter.answering)

    def _guard(self, what: str, *, writes: bool) -> None:
        # The last of several: whoever wants to write has proven the session before, or was told why that is not possible.
        if writes and self.cursor.proven is None:
            raise KitError(f"{what} may write, and nothing has proven that the session talks to the mock device")

    def check_address(self, tool: str, arguments: Mapping[str, object], *, writes: bool) -> None:
        """Refuse a call that may write and is not told where the device is, although calls that read are.

        Raises:
            NoBindingError: it would reach whatever the tool takes without being told.
        """
        carries = carries_address(arguments, self.endpoint)
        if not writes:
            self._addressed = self._addressed or carries
        elif self._addressed and not carries and self.adapter.connect is None:
            raise NoBindingError(
                f"{self.adapter.protocol}: {tool} may write and is not told where the mock device is, although tools that read "
                "are; nothing was written"
            )

    def bindings(self, operation: str) -> Sequence[Binding] | None:
        """Return the bindings of an operation; None for one that a Python function performs."""
        bound = self.adapter.operations.get(operation)
        return None if isinstance(bound, Function) else bound or ()

    def is_bound(self, operation: str, inputs: Mapping[str, object], *, first: bool = False) -> bool:
        """Tell whether the subject says how the operation is performed with these inputs.

        Args:
            first: before any other operation.
        """
        bound = self.adapter.operations.get(operation)
        return isinstance(bound, Function) or any(
            case.fits(inputs) and not (first and case.follows) for case in bound or ()
        )

    def _note_unmet(self, exchange: Exchange) -> None:
        try:
            result = parse_strict(exchange.response or b"null")
        except ValueError:
            return
        if isinstance(result, dict) and isinstance(result.get("result"), dict):
            # What is no requirement of the envelope itself is judged of every answer, by what the subject file says of it.
            faults = (fault.requirement or "" for fault in check_result(result["result"]))
            self.unmet |= {requirement for requirement in faults if requirement.startswith("ENV-")}

    async def _perform(self, function: Function, session: McpSession, inputs: dict[str, object]) -> Reply:
        tools = _Tools(self, session, writes=protocols()[self.adapter.protocol].operations[function.name].writes)
        outputs: Mapping[str, object] = {}
        refusal: Refused | None = None
        try:
            outputs = checked_outputs(function, self.adapter.protocol, await function.call(tools, **inputs))
        except Refused as stated:
            refusal = stated
        except (NoBindingError, KitError):
            raise
        except _NoAnswerError:
            pass
        except UsageError as error:
            raise NoBindingError(str(error)) from None
        except Exception as error:
            raise NoBindingError(
                f"the binding function {function.name} failed: {type(error).__name__}: {error}"
            ) from error
        if not tools.exchanges:
            raise NoBindingError(f"the binding function {function.name} called no tool")
        exchange = joined(tools.exchanges, inputs)
        expected = Expectation(
            adapter=self.adapter.protocol,
            variant=self.variant,
            operation=function.name,
            deadline_s=self.deadline_s,
            answering=Answering(form="text"),
            outputs={},
            calls=joint(exchange.tool),
        )
        reply = observe(exchange, expected)
        return replace_outputs(reply, outputs, None if refusal is None else (refusal.code, str(refusal)))


def _calls_of(session: McpSession) -> dict[str, int]:
    """Return how often each tool that a session lists was called."""
    return {name: session.calls[name] for name in session.tools}


def _overwrite(file: BinaryIO, data: bytes) -> None:
    file.seek(0)
    file.truncate()
    file.write(data)
    file.flush()


class _NoAnswerError(Exception):
    """A tool gave no answer, or an unreadable one, so the binding function cannot go on; the exchange says why."""


class _Tools:
    """The object that a function of the bindings file is given: it calls the adapter's tools and records every exchange."""

    def __init__(self, under_test: AdapterUnderTest, session: McpSession, *, writes: bool) -> None:
        self.host = under_test.device.host
        self.port = under_test.device.port
        self.url = under_test.endpoint["url"]
        self.state = session.state
        self.exchanges: list[Exchange] = []
        self._under_test = under_test
        self._writes = writes
        self._told = False
        self._session = session
        self._timeout_s = 1.2 * under_test.deadline_s

    async def call(self, tool: str, /, **arguments: object) -> ToolAnswer:
        # A function may open a connection first, which the calls after it use.
        self._told = self._told or carries_address(arguments, self._under_test.endpoint)
        self._under_test.check_address(tool, arguments, writes=self._writes and not self._told)
        return self._answer(await self._session.call(tool, arguments, timeout_s=self._timeout_s))

    async def read_resource(self, uri: str) -> ToolAnswer:
        return self._answer(await self._session.read_resource(uri, timeout_s=self._timeout_s))

    def _answer(self, exchange: Exchange) -> ToolAnswer:
        self.exchanges.append(exchange)
        if exchange.response is None:
            raise _NoAnswerError
        try:
            message = parse_strict(exchange.response)
        except ValueError:
            # The fault is reported where every response is read.
            raise _NoAnswerError from None
        structured, text, is_error = read_answer(message, "structured")
        return ToolAnswer(text=text, structured=structured, is_error=is_error)
