"""One MCP session with a subject, over a transport that records every frame.

The official SDK's client gives the semantics (both protocol eras, cancellation on timeout). Frames are recorded below it, because a judgement needs data that an ordinary client throws away:
raw bytes, the times of request and reply, stray output, stderr and the way in which the process ended.

This module does not judge. It turns calls into :class:`~pytest_otmcp.session.exchange.Exchange` records.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import time
from collections import Counter
from collections.abc import Callable, Coroutine, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

from mcp import Client, MCPError
from mcp.types import CallToolResult, RequestParamsMeta, Tool
from mcp.types.version import HANDSHAKE_PROTOCOL_VERSIONS
from pydantic import ValidationError

from ..core.errors import ExhaustedError, KitError, SubjectError
from ..core.exhaustion import exhausted
from ..core.tool_entry import TWICE
from ..record.schema import Footprint, ToolsChanged
from .caller import Caller
from .canary import SecretSearch
from .exchange import CANCELLED, TOO_LONG, Exchange
from .footprint import command_lines, footprint
from .frames import MAX_STRAY_LINES, META_KEY, FrameRecorder, Measurement
from .http import HttpTransport
from .isolation import Walls
from .limits import TOO_LARGE, Allowance
from .output_schema import OutputCheck
from .pace import Pace
from .person import Person
from .process import StopReport, subject_environment
from .starvation import LOOK_S, Patience
from .stdio import StdioTransport

__all__ = ["McpSession", "SessionOptions"]

_LIST_S = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionOptions:
    """Options for opening and closing sessions; all times in seconds.

    Attributes:
        era: MCP protocol era, ``auto`` or ``legacy``.
        start_timeout_s: limit for start and handshake.
        exit_grace_s: time that the process gets to end after each step before SIGKILL.
        url: URL of the subject's streamable HTTP endpoint; None for stdio.
        pace: the adapter's limit of calls; None without one.
        allowance: the room for its answers to calls.
        secrets: what the adapter must not tell.
        work: the adapter's working folder; empty where it has none. Sentences call it ``{work}``, as a subject file does.
        walls: around the adapter, or None for none.
        person: answers its questions; None for a client that cannot be asked.
        caller: makes the headers by which an adapter over HTTP knows who calls; None for an adapter that asks nobody.
    """

    era: str = "auto"
    start_timeout_s: float = 30.0
    exit_grace_s: float = 3.0
    url: str | None = None
    pace: Pace | None = None
    allowance: Allowance = field(default_factory=Allowance)
    secrets: SecretSearch = field(default_factory=SecretSearch)
    work: str = ""
    walls: Walls | None = None
    person: Person | None = None
    caller: Caller | None = None


class McpSession:
    """One session. Use :meth:`open` and :meth:`close`; both may be called from different tasks.

    Attributes:
        tools: name to entry of ``tools/list``.
        calls: how often each tool was called.
        state: values that the functions of a bindings file keep from one call to the next.
        spawned_ns, ready_ns: monotonic times at which the process was started and the session was open.
    """

    def __init__(self, command: Sequence[str], env: Mapping[str, str], cwd: Path | None, options: SessionOptions):
        self._command = list(command)
        self._options = options
        self._recorder = FrameRecorder(allowance=options.allowance, secrets=options.secrets)
        self._transport: StdioTransport | HttpTransport
        env = subject_environment(env)
        if options.url is None:
            self._transport = StdioTransport(command, env, cwd, self._recorder, options.exit_grace_s, options.walls)
        else:
            self._transport = HttpTransport(
                command,
                env,
                cwd,
                options.url,
                self._recorder,
                options.exit_grace_s,
                walls=options.walls,
                caller=options.caller,
            )
        self._client: Client | None = None
        self._owner: asyncio.Task[None] | None = None
        self._closing = asyncio.Event()
        self.tools: dict[str, dict[str, object]] = {}
        self.calls = Counter[str]()
        self._first_list = ""
        self._is_silent = False
        self._output_schemas: dict[str, bytes] = {}
        self.state: dict[str, object] = {}
        self.server_name = ""
        self.server_version = ""
        self.protocol_version = ""
        self.spawned_ns = 0
        self.ready_ns = 0

    def look_at_arguments(self) -> None:
        """Look for secrets in the arguments of the processes that the adapter runs at this moment."""
        # To find the adapter's processes, all of the machine have to be asked.
        for line in command_lines(self.pid) if self._options.secrets else ():
            self._options.secrets.look(line, lambda: "the arguments of a process")

    @property
    def by_handshake(self) -> bool:
        """The session is one of the era in which client and server agree by ``initialize``, MCP 2025-11-25 and older."""
        return self.protocol_version in HANDSHAKE_PROTOCOL_VERSIONS

    @property
    def stop_report(self) -> StopReport | None:
        """The end of the process; None while it runs."""
        return self._transport.stop_report

    # -- open and close ------------------------------------------------------------------------------------

    async def open(self) -> None:
        """Start the subject, agree on a protocol version and list its tools.

        Raises:
            SubjectError: the command cannot be run, the process ended, or it did not answer in time; the message
                carries its last stderr lines. The process has ended when this is raised.
            KitError: no process could be started, for a reason that is not the adapter's.
        """
        ready: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.spawned_ns = time.monotonic_ns()
        self._owner = asyncio.create_task(self._hold_client(ready), name="otmcp-session")
        try:
            await self._ready_in_time(ready)
        except TimeoutError:
            stderr = self._stderr_excerpt()
            await self._give_up(self._owner, ready)
            raise SubjectError(
                "start_timeout",
                f"the adapter did not finish its handshake within {self._options.start_timeout_s:g} s "
                f"(command: {self._command_line()}){stderr}",
            ) from None
        except asyncio.CancelledError:
            await self._give_up(self._owner, ready)
            raise
        except BaseException as error:
            await self.close()
            if isinstance(error, SubjectError | KitError):
                raise
            if (cure := exhausted(error)) is not None:
                raise ExhaustedError(f"no session could be opened with the adapter: {cure}") from error
            raise SubjectError("cannot_start", self._explain_failed_start(error)) from error
        self.ready_ns = time.monotonic_ns()
        self.look_at_arguments()

    async def _ready_in_time(self, ready: asyncio.Future[None]) -> None:
        """Wait for the end of the handshake; the time in which the machine does not let the adapter run is not the adapter's.

        Raises:
            TimeoutError: it takes too long.
        """
        patience = Patience(self._options.start_timeout_s)
        watched = False
        while (left := patience.left_s()) > 0:
            done, _ = await asyncio.wait({ready}, timeout=min(left, LOOK_S))
            if done:
                return ready.result()
            if not watched and (process := self._transport.process) is not None:
                patience.watch(process.pids)
                watched = True
        raise TimeoutError

    async def _give_up(self, owner: asyncio.Task[None], ready: asyncio.Future[None]) -> None:
        # The owner is still busy with the handshake, which took too long; a second wait would not help, so cancel it.
        owner.cancel()
        await self.close()
        # No task awaits this future any more; its exception is fetched so that asyncio does not report it as lost.
        if ready.done() and not ready.cancelled():
            ready.exception()

    async def _hold_client(self, ready: asyncio.Future[None]) -> None:
        # anyio's cancel scopes must be left by the task that entered them: this task owns the client from
        # beginning to end, and other tasks may open and close the session.
        try:
            async with Client(
                self._transport.streams(),
                cache=None,
                mode=self._options.era,
                elicitation_callback=self._options.person,
            ) as client:
                # See output_schema: the check of results is made elsewhere, with a limit.
                client.session.validate_tool_result = _unchecked  # type: ignore[method-assign]
                await self._list_tools(client)
                self._client = client
                info = client.server_info
                self.server_name, self.server_version = (info.name, info.version) if info else ("", "")
                self.protocol_version = str(client.protocol_version)
                if not ready.done():
                    ready.set_result(None)
                await self._closing.wait()
        except BaseException as error:
            if not ready.done():
                ready.set_exception(_innermost(error))
                return
            if isinstance(error, asyncio.CancelledError):
                raise
            # After a good start faults show in the exchanges, and errors of the client while it closes say nothing.
        finally:
            self._client = None

    async def _list_tools(self, client: Client) -> None:
        # Listing before the first call also keeps the SDK from sending a hidden tools/list after it.
        cursor: str | None = None
        entries: list[str] = []
        while True:
            page = await client.list_tools(cursor=cursor)
            for tool in page.tools:
                entries.append(_entry(tool))
                listed = tool.model_dump(by_alias=True, mode="json", exclude_none=True)
                if (known := self.tools.get(tool.name)) is not None:
                    # Which of them a call reaches, nobody can know.
                    alike = listed == {name: value for name, value in known.items() if name != TWICE}
                    known[TWICE] = "alike" if alike and known.get(TWICE) != "other" else "other"
                    continue
                self.tools[tool.name] = listed
                if tool.output_schema is not None:
                    self._output_schemas[tool.name] = json.dumps(tool.output_schema).encode()
            cursor = page.next_cursor
            if cursor is None:
                self._first_list = _digests(entries)
                return

    async def close(self) -> StopReport | None:
        """Close the session and end the process. It never raises and never leaves a process behind."""
        self._closing.set()
        if self._owner is not None:
            done, _ = await asyncio.wait({self._owner}, timeout=3 * self._options.exit_grace_s + 6.0)
            if not done:
                self._owner.cancel()
                await asyncio.wait({self._owner}, timeout=5.0)
            if not self._owner.cancelled():
                self._owner.exception()
        return await self._transport.stop()

    # -- calls --------------------------------------------------------------------------------------------

    async def call(
        self, tool: str, arguments: Mapping[str, object], *, timeout_s: float, cancel: asyncio.Event | None = None
    ) -> Exchange:
        """Call a tool and return the recorded exchange; no outcome of the call is an exception.

        Args:
            cancel: when it is set before the response has come, the call is cancelled by the client: with
                ``notifications/cancelled`` on stdio, and as the transport has it elsewhere (MCP, Cancellation).

        Raises:
            KitError: the result could not be checked against the tool's ``outputSchema``.
        """
        self.calls[tool] += 1
        asked, person = dict(arguments), self._options.person
        brought = {} if person is None else person.brought()
        exchange = await self._exchange(
            tool, asked, lambda client, meta: client.call_tool(tool, asked, meta=meta, **brought), timeout_s, cancel
        )
        if person is not None:
            person.left_open(exchange.response)
        return exchange

    async def list_anew(self, *, timeout_s: float) -> str:
        """Ask for the list of tools again and return the digest of its entries, after a blank that of their order, and after another
        one the word ``announced`` if the adapter has announced in this session that its tools have changed.

        Raises:
            SubjectError: there is no answer.
        """
        entries: list[str] = []
        cursor: str | None = None
        # The lists of before are not kept: a session may be asked hundreds of times.
        self._recorder.listing.renew()
        try:
            async with asyncio.timeout(timeout_s):
                while self._client is not None:
                    page = await self._client.list_tools(cursor=cursor)
                    entries += map(_entry, page.tools)
                    cursor = page.next_cursor
                    if cursor is None:
                        return f"{_digests(entries)}{' announced' if self._recorder.list_changes else ''}"
        except (MCPError, TimeoutError, RuntimeError, ValueError) as error:
            if isinstance(error, TimeoutError) and not self.died:
                raise SubjectError("no_reply", f"tools/list was not answered within {timeout_s:g} s") from None
            why = f"the adapter sent {TOO_LARGE}" if self.overflow else await self.death_note() if self.died else error
            raise SubjectError("session_lost", f"tools/list was not answered: {why}") from None
        raise SubjectError("session_lost", await self.death_note())

    async def tools_changed(self) -> ToolsChanged | None:
        """Ask for the list of tools once more and compare it with the first; None where it is the same, or there is no answer.

        A young session is asked as well: how long an item takes must not decide what is found. One that has left its last call without
        an answer is not: it would be waited for again.
        """
        if self.died or self._floods or self._is_silent or not self.ready_ns:
            return None
        try:
            now = await self.list_anew(timeout_s=_LIST_S)
        except Exception:
            # That an adapter does not answer, or not in MCP, is found where it is called; its session is ended all the same.
            return None
        if now.startswith(self._first_list):
            return None
        if now.partition(" ")[0] == self._first_list.partition(" ")[0]:
            return "order"
        return "announced" if now.endswith("announced") else "changed"

    @property
    def _floods(self) -> bool:
        return self._recorder.overflow or self._recorder.stray_count >= MAX_STRAY_LINES

    def write_line(self, line: bytes) -> bool:
        """Write a line to the standard input of the subject as it is; return whether there is such a stream."""
        return self._transport.write_line(line)

    def footprint(self) -> Footprint:
        """Return the figures of the subject's processes together; zeros when there is none."""
        return footprint(self.pid)

    async def read_resource(self, uri: str, *, timeout_s: float) -> Exchange:
        """Read a resource and return the recorded exchange, as :meth:`call` does."""
        return await self._exchange(uri, {}, lambda client, meta: client.read_resource(uri, meta=meta), timeout_s)

    async def _exchange(
        self,
        tool: str,
        arguments: Mapping[str, object],
        request: Callable[[Client, RequestParamsMeta], Coroutine[Any, Any, object]],
        timeout_s: float,
        cancel: asyncio.Event | None = None,
    ) -> Exchange:
        async with nullcontext() if self._options.pace is None else self._options.pace.call():
            return await self._recorded(tool, arguments, request, timeout_s, cancel)

    async def _recorded(
        self,
        tool: str,
        arguments: Mapping[str, object],
        request: Callable[[Client, RequestParamsMeta], Coroutine[Any, Any, object]],
        timeout_s: float,
        cancel: asyncio.Event | None,
    ) -> Exchange:
        measured = Measurement()
        failure = complaint = None
        answer: object = None
        client = self._client
        asked_ns = returned_ns = time.monotonic_ns()
        starved_s = 0.0
        if client is None or self.died:
            failure = "connection_closed"
        else:
            patience = Patience(timeout_s)
            if (pid := self.process_pid) is not None:
                patience.watch([pid])
            token = self._recorder.begin(measured)
            try:
                answer = await _answer(request(client, cast(RequestParamsMeta, {META_KEY: token})), patience, cancel)
            except CancelledByKit:
                if measured.response is None:
                    failure = CANCELLED
            except (MCPError, TimeoutError) as error:
                if measured.refusal is not None:
                    failure = measured.refusal
                elif measured.response is None:
                    timed_out = isinstance(error, TimeoutError) or error.code == -32001
                    failure = "timeout" if timed_out and not self.died else "connection_closed"
            except (RuntimeError, ValidationError, ValueError) as error:
                complaint = str(error).splitlines()[0][:300]
                if measured.response is None:
                    failure = "connection_closed"
            finally:
                returned_ns = time.monotonic_ns()
                self._recorder.end(token)
                if returned_ns - asked_ns >= LOOK_S * 1e9:
                    starved_s = patience.starved_s()
        if failure == "connection_closed" and self.overflow:
            failure = TOO_LONG
        self._is_silent = failure == "timeout"
        schema = self._output_schemas.get(tool)
        if isinstance(answer, CallToolResult) and not answer.is_error and schema and measured.response is not None:
            complaint = await OutputCheck.of_running_loop().objection(tool, schema, measured.response)
        return Exchange(
            tool=tool,
            arguments=arguments,
            request=measured.request,
            response=measured.response,
            sent_ns=measured.sent_ns,
            received_ns=measured.received_ns,
            starved_ns=round(starved_s * 1e9),
            failure=failure,
            client_complaint=complaint,
            asked_ns=asked_ns,
            returned_ns=returned_ns,
        )

    @property
    def pid(self) -> int | None:
        """Number of the process from which everything descends that the subject starts; None as long as there is none."""
        process = self._transport.process
        return None if process is None else process.root

    @property
    def process_pid(self) -> int | None:
        """Number of the subject's own process; None as long as there is none."""
        process = self._transport.process
        return None if process is None else process.pids[0]

    @property
    def died(self) -> bool:
        """True when the session has no process, or the process has closed the connection."""
        return self._transport.died

    async def death_note(self) -> str:
        """Describe in one sentence how the subject ended, with its last stderr lines."""
        process = self._transport.process
        if process is None:
            return "the adapter is not running"
        await process.settle()
        code = process.returncode
        how = "closed its stdout" if code is None else _describe_exit(code)
        return f"the adapter {how}{self._stderr_excerpt()}"

    def stderr_tail(self) -> list[str]:
        """Return the newest lines on stderr, oldest first."""
        process = self._transport.process
        return [] if process is None else process.stderr_tail()

    def stray_output(self) -> tuple[int, list[str]]:
        """Return the number of lines on stdout that are no MCP message, and the first few of them."""
        return self._recorder.stray_count, [line[:200].decode("utf-8", "replace") for line in self._recorder.stray]

    def unknown_responses(self) -> list[str]:
        """Return the ids of responses to requests that were never sent."""
        return list(self._recorder.unknown_ids)

    def repeated_responses(self) -> list[str]:
        """Return the ids of requests that were answered more than once."""
        return list(self._recorder.repeated_ids)

    @property
    def too_deep(self) -> int:
        """Number of messages that are nested deeper than can be read."""
        return self._recorder.too_deep

    @property
    def overflow(self) -> bool:
        """True when a message arrived that is larger than the kit accepts; it ends the session."""
        return self._recorder.overflow

    # -- descriptions -------------------------------------------------------------------------------------

    def _command_line(self) -> str:
        return self._anywhere(" ".join(self._command))

    def _anywhere(self, text: str) -> str:
        """Return a text without what is of this machine and of this session, so that it tells equal failures alike."""
        return _without_home(text.replace(self._options.work, "{work}") if self._options.work else text)

    def _stderr_excerpt(self) -> str:
        tail = [self._anywhere(line) for line in self.stderr_tail()]
        return "; last stderr lines:\n    " + "\n    ".join(tail) if tail else "; it wrote nothing to stderr"

    def _explain_failed_start(self, error: BaseException) -> str:
        if isinstance(error, FileNotFoundError):
            return f"the command {self._command[0]!r} was not found; the launch command is: {self._command_line()}"
        if self._recorder.overflow:
            return f"the adapter sent {TOO_LARGE} during its handshake"
        if self._recorder.stray_count >= MAX_STRAY_LINES:
            first = self._recorder.stray[0][:120].decode("utf-8", "replace")
            return f"the adapter floods stdout with lines that are no MCP messages, the first: {first!r}"
        report = self.stop_report
        if report is not None and report.how == "exited":
            how = _describe_exit(report.returncode)
            return f"the adapter {how} during its handshake ({self._command_line()}){self._stderr_excerpt()}"
        if isinstance(error, OSError):
            return f"the command cannot be executed ({error.strerror or error}): {self._command_line()}"
        reason = str(error).splitlines()[0][:300] if str(error) else type(error).__name__
        return f"the adapter's handshake failed: {reason} ({self._command_line()}){self._stderr_excerpt()}"


def _entry(tool: Tool) -> str:
    return tool.model_dump_json(by_alias=True, exclude_none=True)


def _digests(entries: Sequence[str]) -> str:
    """Return the digest of the entries of ``tools/list`` in whatever order, and after a blank that of their order."""
    return f"{_digest(sorted(entries))} {_digest(entries)}"


def _digest(entries: Sequence[str]) -> str:
    return f"sha256:{hashlib.sha256(json.dumps(entries).encode()).hexdigest()}"


async def _unchecked(name: str, result: CallToolResult) -> None:
    """Take the result of a tool as it is."""


def _without_home(text: str) -> str:
    """Write ``~`` for the home directory: a record goes to others, whom it does not tell who ran the kit."""
    home = str(Path.home())
    return text.replace(home, "~") if home != "/" else text


def _describe_exit(code: int | None) -> str:
    if code is None:
        return "did not exit"
    return f"was killed by signal {-code}" if code < 0 else f"exited with code {code}"


def _innermost(error: BaseException) -> BaseException:
    while isinstance(error, BaseExceptionGroup) and error.exceptions:
        error = error.exceptions[0]
    return error


class CancelledByKit(Exception):
    """The kit has cancelled a call."""


async def _answer(asking: Coroutine[Any, Any, object], patience: Patience, cancel: asyncio.Event | None) -> object:
    """Return what is awaited, unless the time is over or the event comes first; then it has been cancelled.

    Raises:
        CancelledByKit: the event came first.
        TimeoutError: the time was over.
    """
    # A task of its own: the client's cancel scopes must not see the cancellation of their caller.
    answer = asyncio.ensure_future(asking)
    awaited = {answer} if cancel is None else {answer, asyncio.ensure_future(cancel.wait())}
    done: set[asyncio.Future[object]] = set()
    try:
        while not done and (left := patience.left_s()) > 0:
            done, _ = await asyncio.wait(awaited, timeout=left, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in awaited:
            task.cancel()
        if not answer.done():
            await asyncio.wait({answer})
    if not answer.cancelled():
        return answer.result()
    raise CancelledByKit if done else TimeoutError
