"""Real adapters over real pipes, and real mock devices with their control channel, for the tests of the adapters.

The client is written by hand: it sees every byte that the adapter writes to stdout, can send what no library would send,
and checks every result against the rules of the envelope and the output schema that its tool declares.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import selectors
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from pytest_otmcp.core.strict_json import parse_strict
from pytest_otmcp.plant.journal import DeviceJournal
from pytest_otmcp.protocols.envelope import check_result
from pytest_otmcp.protocols.registry import protocols

from .cases import Case

LEGACY, MODERN = "2025-11-25", "2026-07-28"
_META = {
    "io.modelcontextprotocol/protocolVersion": MODERN,
    "io.modelcontextprotocol/clientCapabilities": {},
    "io.modelcontextprotocol/clientInfo": {"name": "tests", "version": "1"},
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """The result of one tool call."""

    result: dict[str, Any]

    @property
    def envelope(self) -> dict[str, Any]:
        envelope: dict[str, Any] = self.result["structuredContent"]
        return envelope

    @property
    def data(self) -> Any:
        assert self.envelope["success"], self.envelope
        return self.envelope["data"]

    @property
    def error(self) -> dict[str, Any]:
        assert not self.envelope["success"], self.envelope
        error: dict[str, Any] = self.envelope["error"]
        return error

    @property
    def meta(self) -> dict[str, Any]:
        meta: dict[str, Any] = self.envelope["meta"]
        return meta


PATIENCE_S = 120.0
"""Seconds to wait for something that must come; each wait ends as soon as it has come."""


class ForkServer:
    """The process that forks adapters, see :mod:`fork_server`."""

    def __init__(self) -> None:
        self._channel, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._channel.settimeout(PATIENCE_S)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, str(Path(__file__).with_name("fork_server.py")), str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
            )
        self._codes: dict[int, int] = {}

    def start(self, command: list[str], env: Mapping[str, str]) -> Forked:
        """Fork an adapter that runs the command of a Python program."""
        (stdin, *sources), (sink, *outputs) = zip(*(os.pipe() for _ in range(3)), strict=True)
        request = json.dumps({"command": command[1:], "env": dict(env)}).encode()
        socket.send_fds(self._channel, [request], [stdin, *outputs])
        for descriptor in (stdin, *outputs):
            os.close(descriptor)
        while "started" not in (answer := self._next()):
            pass
        return Forked(self, answer["started"], sink, *sources)

    def _next(self) -> dict[str, int]:
        answer: dict[str, int] = json.loads(self._channel.recv(1 << 16))
        if "ended" in answer:
            self._codes[answer["ended"]] = answer["code"]
        return answer

    def code(self, pid: int, timeout_s: float) -> int | None:
        """Return the exit code of a process, or None if it has not ended in time."""
        deadline = time.monotonic() + timeout_s
        while pid not in self._codes:
            ready, _, _ = select.select([self._channel], [], [], max(0.0, deadline - time.monotonic()))
            if not ready:
                return None
            self._next()
        return self._codes[pid]

    def close(self) -> None:
        self._channel.close()
        self._process.wait(timeout=PATIENCE_S)


class Forked:
    """A forked adapter, with the part of the interface of :class:`subprocess.Popen` that :class:`Client` uses."""

    def __init__(self, server: ForkServer, pid: int, stdin: int, stdout: int, stderr: int) -> None:
        self._server = server
        self.pid = pid
        self.stdin, self.stdout, self.stderr = (
            os.fdopen(stdin, "wb", buffering=0),
            os.fdopen(stdout, "rb", buffering=0),
            os.fdopen(stderr, "rb", buffering=0),
        )

    def poll(self) -> int | None:
        return self._server.code(self.pid, 0.0)

    def wait(self, timeout: float) -> int:
        code = self._server.code(self.pid, timeout)
        assert code is not None, "the adapter did not end"
        return code

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


class Client:
    """One adapter process and a raw JSON-RPC client on its pipes.

    Args:
        command: of a Python program.
        env: settings on top of this process's environment.
        era: version of the protocol.
        server: forks the adapter; without it the command is started.
        capabilities: those that the client declares.

    Attributes:
        asked: requests of the adapter, which nobody answers by itself.
    """

    def __init__(
        self,
        command: list[str],
        env: Mapping[str, str] | None = None,
        era: str = MODERN,
        server: ForkServer | None = None,
        capabilities: Mapping[str, Any] | None = None,
    ) -> None:
        self.era = era
        self.capabilities = dict(capabilities or {})
        self.asked: list[dict[str, Any]] = []
        environment = {**os.environ, **(env or {})}
        self.process: subprocess.Popen[bytes] | Forked
        if server is not None:
            self.process = server.start(command, environment)
        else:
            pipe = subprocess.PIPE
            self.process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, bufsize=0, env=environment)
        assert self.process.stdin
        assert self.process.stdout
        assert self.process.stderr
        self.stdin, self.stdout = self.process.stdin, self.process.stdout
        self.stderr = b""
        self._selector = selectors.DefaultSelector()
        self._selector.register(self.stdout, selectors.EVENT_READ)
        self._selector.register(self.process.stderr, selectors.EVENT_READ)
        self._buffer = b""
        self._answers: dict[Any, dict[str, Any]] = {}
        self._id = 0
        self.ended = False
        try:
            self._shake_hands()
        except BaseException:
            self.abandon()
            raise

    def _shake_hands(self) -> None:
        if self.era == LEGACY:
            info = {"name": "t", "version": "1"}
            parameters = {"protocolVersion": LEGACY, "capabilities": self.capabilities, "clientInfo": info}
            self.server = self.request("initialize", parameters)["result"]
            self.write({"jsonrpc": "2.0", "method": "notifications/initialized"})
        else:
            self.server = self.request("server/discover", {})["result"]
        self.tools = {tool["name"]: tool for tool in self.request("tools/list", {})["result"]["tools"]}
        self._schemas = {name: Draft202012Validator(tool["outputSchema"]) for name, tool in self.tools.items()}

    def write(self, message: Mapping[str, Any] | bytes) -> None:
        data = message if isinstance(message, bytes) else json.dumps(message).encode()
        view = memoryview(data + b"\n")
        while view:
            view = view[os.write(self.stdin.fileno(), view) :]

    def send(self, method: str, params: Mapping[str, Any]) -> int:
        """Write a request and return its id."""
        request = self._request(method, params)
        self.write(request)
        return int(request["id"])

    def _request(self, method: str, params: Mapping[str, Any]) -> dict[str, Any]:
        self._id += 1
        if self.era == MODERN:
            own = {"io.modelcontextprotocol/clientCapabilities": self.capabilities}
            params = {**params, "_meta": _META | own}
        return {"jsonrpc": "2.0", "id": self._id, "method": method, "params": params}

    def answer(self, identifier: Any, timeout_s: float = PATIENCE_S) -> dict[str, Any]:
        """Return the response to a request.

        Raises:
            TimeoutError: it did not come.
        """
        deadline = time.monotonic() + timeout_s
        while identifier not in self._answers:
            if self.ended or not self._read(deadline - time.monotonic()):
                raise TimeoutError(f"no answer to {identifier!r}; stderr: {self.stderr[-2000:].decode()}")
        return self._answers.pop(identifier)

    def _read(self, timeout_s: float) -> bool:
        ready = self._selector.select(max(0.0, timeout_s))
        for key, _ in ready:
            data = os.read(key.fd, 1 << 20)
            if not data:
                self._selector.unregister(key.fileobj)
                self.ended = self.ended or key.fileobj is self.stdout
            elif key.fileobj is not self.stdout:
                self.stderr += data
            else:
                *lines, self._buffer = (self._buffer + data).split(b"\n")
                for line in lines:
                    # Every line is a message: nothing else may ever be on stdout.
                    message = parse_strict(line)
                    assert message["jsonrpc"] == "2.0"
                    if "method" in message:
                        self.asked.append(message)
                    else:
                        self._answers[message["id"]] = message
        return bool(ready)

    def question(self) -> dict[str, Any]:
        """Return the next request of the adapter."""
        while not self.asked:
            assert self._read(PATIENCE_S), "nothing was asked"
        return self.asked.pop(0)

    def request(self, method: str, params: Mapping[str, Any]) -> dict[str, Any]:
        return self.answer(self.send(method, params))

    def call(self, tool: str, arguments: Any = None, **members: Any) -> Reply:
        """Call a tool; ``arguments`` as a mapping, as keywords, or any other JSON value."""
        return self.reply(tool, self.start(tool, members if arguments is None else arguments))

    def start(self, tool: str, arguments: Any) -> int:
        return self.send("tools/call", {"name": tool, "arguments": arguments})

    def start_together(self, *calls: tuple[str, Any]) -> list[int]:
        """Start calls, each a tool and its arguments, with one write, so nothing comes between; return their ids."""
        requests = [self._request("tools/call", {"name": tool, "arguments": given}) for tool, given in calls]
        self.write(b"\n".join(json.dumps(request).encode() for request in requests))
        return [request["id"] for request in requests]

    def reply(self, tool: str, identifier: int, timeout_s: float = PATIENCE_S) -> Reply:
        response = self.answer(identifier, timeout_s)
        assert "result" in response, response
        result = response["result"]
        findings = [finding for finding in check_result(result) if finding.code != "internal_error"]
        assert findings == []
        self._schemas[tool].validate(result["structuredContent"])
        return Reply(result=result)

    def pass_time(self) -> None:
        """Move the clock of a forked adapter's event loop on, after the adapter has handled everything sent to it.

        Every time-out of an exchange that has begun elapses; a call's deadline elapses with the second time. Nothing else may
        be about to happen at the same moment, such as the end of a connection attempt: their order is not defined.
        """
        assert isinstance(self.process, Forked)
        self.request("tools/list", {})
        self.process.send_signal(signal.SIGUSR1)

    def close(self) -> tuple[int, float]:
        """Close stdin; return the exit code and the seconds until the process ended."""
        started = time.monotonic()
        self.stdin.close()
        while self._selector.get_map() and time.monotonic() < started + PATIENCE_S:
            self._read(1.0)
        code = self.process.wait(timeout=PATIENCE_S)
        elapsed = time.monotonic() - started
        self.stdout.close()
        assert self.process.stderr
        self.process.stderr.close()
        self._selector.close()
        return code, elapsed

    def abandon(self) -> None:
        """End the process, whatever its state is."""
        if self.process.poll() is None:
            self.process.kill()
        if not self.stdin.closed:
            self.close()


class Mock:
    """A mock device with its launcher and control channel."""

    def __init__(self, protocol: str) -> None:
        self.launcher = subprocess.Popen(
            [sys.executable, "-m", "pytest_otmcp.mocks", protocol],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
        )
        self._framing = protocols()[protocol].framing
        self._control: socket.socket | None = None
        self._connect()
        self("pause")

    def _connect(self) -> None:
        ready = self._event("ready")
        self.port: int = ready["port"]
        self.endpoints: dict[str, dict[str, Any]] = ready["endpoints"]
        self.pid: int = ready["pid"]
        self._control = socket.socket(socket.AF_UNIX)
        self._control.settimeout(2 * PATIENCE_S)
        self._control.connect(ready["control"])
        self._lines = self._control.makefile("rb")
        assert self._framing is not None
        self._journal = DeviceJournal(self._framing.conversation)

    def _event(self, expected: str) -> dict[str, Any]:
        assert self.launcher.stdout
        event: dict[str, Any] = json.loads(self.launcher.stdout.readline())
        assert event["event"] == expected, event
        return event

    def __call__(self, operation: str, **members: Any) -> dict[str, Any]:
        assert self._control
        self._control.sendall(json.dumps({"id": 1, "op": operation, **members}).encode() + b"\n")
        answer = json.loads(self._lines.readline())
        assert answer["ok"], answer
        result: dict[str, Any] = answer["result"]
        return result

    def fault(self, *rules: Mapping[str, Any]) -> None:
        self("fault", rules=list(rules))

    def _decoded(self, operation: str = "journal", **members: Any) -> DeviceJournal:
        self._journal.take(self(operation, since=self._journal.taken, **members))
        return self._journal

    def mark(self) -> int:
        """Return the sequence number that the next journal entry will get."""
        return self._decoded().next

    def since(self, mark: int, **fields: Any) -> list[dict[str, Any]]:
        """Return the journal entries from the mark on that have these fields."""
        entries: list[Any] = self._decoded().since(mark)
        return [entry for entry in entries if all(entry.get(name) == value for name, value in fields.items())]

    def wait(self, mark: int, count: int = 1, timeout_s: float = PATIENCE_S, **fields: Any) -> list[dict[str, Any]]:
        """Return the journal entries with these fields as soon as there are ``count``; fail if there never are."""
        entries = self._wait(mark, count, timeout_s, fields)
        assert len(entries) >= count, f"{fields} happened {len(entries)} time(s)"
        return entries

    def within(self, seconds: float, mark: int, **fields: Any) -> list[dict[str, Any]]:
        """Return the journal entries with these fields that exist after so many seconds."""
        return self._wait(mark, 1 << 30, seconds, fields)

    def _wait(self, mark: int, count: int, timeout_s: float, fields: Mapping[str, Any]) -> list[dict[str, Any]]:
        end = time.monotonic() + timeout_s
        found = self.since(mark, **fields)
        while len(found) < count and (rest_s := end - time.monotonic()) > 0:
            self._decoded("wait", timeout_s=rest_s)
            found = self.since(mark, **fields)
        return found

    def stop(self) -> None:
        assert self.launcher.stdin
        self._hang_up()
        self.launcher.stdin.write("stop\n")
        self._event("stopped")

    def start(self) -> None:
        assert self.launcher.stdin
        self.launcher.stdin.write("start\n")
        self._connect()
        self("pause")

    @contextlib.contextmanager
    def outage(self) -> Iterator[None]:
        """Stop the device for a while; start it again for the tests that follow, even if this test fails."""
        self.stop()
        try:
            yield
        finally:
            self.start()

    def _hang_up(self) -> None:
        if self._control is not None:
            self._lines.close()
            self._control.close()
            self._control = None

    def close(self) -> None:
        assert self.launcher.stdin
        assert self.launcher.stdout
        self._hang_up()
        self.launcher.stdin.close()
        self.launcher.wait(timeout=PATIENCE_S)
        self.launcher.stdout.close()


OverHttp = Callable[[list[str], Mapping[str, str]], contextlib.AbstractContextManager[str]]


@pytest.fixture(scope="session")
def over_http() -> OverHttp:
    """A function that starts an adapter over streamable HTTP, and gives its URL."""
    return _over_http


@contextlib.contextmanager
def _over_http(command: list[str], settings: Mapping[str, str]) -> Iterator[str]:
    env = {**os.environ, "MCP_TRANSPORT": "streamable-http", "MCP_HTTP_PORT": "0", **settings}
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, env=env) as process:
        try:
            assert process.stderr
            next(process.stderr)
            # The URL is used as soon as it is announced.
            yield next(process.stderr).split()[-1]
        finally:
            process.terminate()


@pytest.fixture(scope="session")
def fork_server() -> Iterator[ForkServer]:
    server = ForkServer()
    yield server
    server.close()


@pytest.fixture(scope="session")
def sessions(fork_server: ForkServer) -> Iterator[Callable[..., Client]]:
    """Function that starts adapters, which live until the test run ends: ``sessions(command, env, era, forked)``."""
    opened: list[Client] = []

    def start(
        command: list[str],
        env: Mapping[str, str] | None = None,
        era: str = MODERN,
        *,
        forked: bool = True,
        capabilities: Mapping[str, Any] | None = None,
    ) -> Client:
        opened.append(Client(command, env, era, fork_server if forked else None, capabilities))
        return opened[-1]

    yield start
    for client in opened:
        client.abandon()


@pytest.fixture(scope="session")
def mocks() -> Iterator[Callable[[str], Mock]]:
    """Function that starts mock devices, which live until the test run ends: ``mocks(protocol)``."""
    opened: list[Mock] = []

    def start(protocol: str) -> Mock:
        opened.append(Mock(protocol))
        return opened[-1]

    yield start
    for mock in opened:
        mock.close()


@pytest.fixture(scope="session")
def adapter_command() -> Callable[[str], list[str]]:
    """Command that starts a reference adapter: ``adapter_command(protocol)``."""
    return lambda protocol: [sys.executable, "-m", "pytest_otmcp.reference_adapters", protocol]


TIMEOUT_S, DEADLINE_S = 20.0, 30.0
"""Settings of the adapters of a rig. No call lasts so long in real time; :meth:`Client.pass_time` makes them elapse."""


class Rig:
    """A mock device of one protocol, and two reference adapters for it: one may write, one may not."""

    def __init__(self, case: Case, device: Mock, start: Callable[..., Client], folder: Path) -> None:
        self.case = case
        self.device = device
        self._start = start
        self._folder = folder
        self.adapter = self.start("rw", writes="true")
        self.guarded = self.start("ro")
        self.ask(self.adapter)
        self.ask(self.guarded)

    def settings(self, name: str, *, writes: str | None = None, **more: str) -> dict[str, str]:
        """Return the settings of an adapter for this device."""
        prefix = self.case.prefix
        return {
            **self.case.settings(self.device.port, name, self._folder),
            f"{prefix}_TIMEOUT_S": f"{TIMEOUT_S:g}",
            f"{prefix}_DEADLINE_S": f"{DEADLINE_S:g}",
            **({} if writes is None else {f"{prefix}_WRITES_ENABLED": writes}),
            **more,
        }

    def start(
        self,
        name: str,
        *,
        writes: str | None = None,
        forked: bool = True,
        era: str = MODERN,
        capabilities: Mapping[str, Any] | None = None,
        **more: str,
    ) -> Client:
        """Start another adapter for this device."""
        command = [sys.executable, "-m", "pytest_otmcp.reference_adapters", self.case.protocol]
        settings = self.settings(name, writes=writes, **more)
        return self._start(command, settings, era, forked=forked, capabilities=capabilities)

    def ask(self, client: Client | None = None) -> Reply:
        """Make the device answer; everything that the client sent before is then in the journal."""
        reply = (client or self.adapter).call(self.case.probe, self.case.reads[self.case.probe])
        assert reply.envelope["success"], reply.envelope
        return reply

    def fault(self, tool: str, action: Mapping[str, Any], **more: Any) -> None:
        """Make the device apply this action to the requests of a tool."""
        self.device.fault({**self.case.rules(tool), "action": action, **more})

    def requests(self, mark: int, tool: str) -> list[dict[str, Any]]:
        """Return the requests of a tool that reached the device since the mark."""
        entries = self.device.since(mark, **self.case.requests(tool))
        return [entry for entry in entries if not self.case.background(entry)]

    def await_requests(self, mark: int, tool: str, count: int = 1) -> None:
        """Wait until ``count`` requests of a tool have reached the device since the mark."""
        self.device.wait(mark, count, **self.case.requests(tool))

    @contextlib.contextmanager
    def outage(self) -> Iterator[None]:
        """Stop the device for a while; afterwards both adapters are connected to it again."""
        with self.device.outage():
            yield
        for name, client in (("rw", self.adapter), ("ro", self.guarded)):
            self.reconnected(0, name)
            self.ask(client)

    def reconnected(self, mark: int, name: str = "rw") -> None:
        """Wait until an adapter that reconnects by itself has done so; an earlier call could join a failing attempt."""
        if self.case.readmitted is not None:
            self.device.wait(mark, **self.case.readmitted(name))


@pytest.fixture(scope="session")
def rigs(
    sessions: Callable[..., Client], mocks: Callable[[str], Mock], tmp_path_factory: pytest.TempPathFactory
) -> Callable[[Case], Rig]:
    """The rig of a case, one for the whole test run: ``rigs(case)``."""
    made: dict[str, Rig] = {}

    def rig(case: Case) -> Rig:
        if case.protocol not in made:
            folder = tmp_path_factory.mktemp(case.protocol)
            made[case.protocol] = Rig(case, mocks(case.protocol), sessions, folder)
        return made[case.protocol]

    return rig


@pytest.fixture(scope="module")
def rig(request: pytest.FixtureRequest, rigs: Callable[[Case], Rig]) -> Rig:
    """The rig of the case that the test module names as ``CASE``."""
    return rigs(request.module.CASE)


@pytest.fixture(scope="module")
def device(rig: Rig) -> Mock:
    """The mock device of the module's rig."""
    return rig.device


@pytest.fixture(scope="module")
def adapter(rig: Rig) -> Client:
    """The adapter of the module's rig, which may write."""
    return rig.adapter


@pytest.fixture
def clean(device: Mock) -> None:
    """Start-up values in the device of the module's rig."""
    device("reset")
