"""``otmcp console`` in a terminal: what it is given, and how it ends."""

from __future__ import annotations

import http.client
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest

from pytest_otmcp.cli import main

from ..plugin.command import OTMCP
from .conftest import END_S

LOST = """
[subject]
name = "acme"
version = "1"

[adapter.modbus]
command = ["a-command-that-is-not-there"]
env = { MODBUS_HOST = "{host}", MODBUS_PORT = "{port}" }
"""

REFERENCE = """
[subject]
name = "acme"
version = "1"

[adapter.modbus]
start_timeout_s = 300
command = ["{python}", "-P", "-m", "pytest_otmcp.reference_adapters", "modbus"]
env = { MODBUS_HOST = "{host}", MODBUS_PORT = "{port}" }
"""


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Return the one sentence with which the command ends."""
    assert main(["console", *arguments]) == 2
    [line] = [line for line in capsys.readouterr().err.splitlines() if line.startswith("otmcp: ")]
    return line.removeprefix("otmcp: ")


def test_what_is_not_there_is_named(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert refused(capsys, "lost.toml") == "lost.toml: there is no such file"
    os.mkfifo(here / "pipe.toml")
    assert refused(capsys, "pipe.toml") == "pipe.toml: this is no regular file"
    (here / "empty" / ".git").mkdir(parents=True)
    (here / "empty" / ".git" / "otmcp.toml").touch()
    assert refused(capsys, "empty") == "empty: there is no otmcp.toml and no run.json in this directory"


def test_a_subject_file_that_is_wrong_is_named(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "below").mkdir()
    (here / "below" / "otmcp.toml").write_text('[subject]\nname = "x"\nversion = "1"\n')
    assert refused(capsys, ".") == "below/otmcp.toml: adapter: expected a table, found nothing"


def test_a_port_that_is_taken_is_named(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        sentence = refused(capsys, f"--port={port}")
    assert sentence == f"--port {port}: 127.0.0.1:{port} cannot be had: Address already in use"


def test_an_assistant_needs_an_address_and_a_model(capsys: pytest.CaptureFixture[str]) -> None:
    assert refused(capsys, "--chat=http://127.0.0.1:1/v1") == "--chat and --chat-model belong together"
    assert refused(capsys, "--chat-model=x") == "--chat and --chat-model belong together"
    sentence = "--chat: expected an http or https URL, found 'file:///x'"
    assert refused(capsys, "--chat=file:///x", "--chat-model=x") == sentence


def test_only_this_command_pays_for_its_server() -> None:
    heavy = "import sys; from pytest_otmcp.cli import main; main(['explain', 'M3']); print(sorted({'starlette', 'uvicorn'} & {*sys.modules}))"
    done = subprocess.run([sys.executable, "-P", "-c", heavy], capture_output=True, text=True, timeout=300, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


class Started:
    """A console in a process of its own, asked without a browser, and ended by a signal."""

    def __init__(self, *arguments: str) -> None:
        command = [*OTMCP, "console", *arguments]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        origin, _, token = self.process.stdout.readline().split()[-1].partition("/#")
        self.host = origin.removeprefix("http://")
        self.headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}

    @contextmanager
    def answer(self, method: str, path: str, asked: object = None) -> Iterator[http.client.HTTPResponse]:
        """Give the answer to a request, whose body is still to be read."""
        connection = http.client.HTTPConnection(self.host, timeout=400)
        connection.request(method, f"/api/{path}", json.dumps(asked), self.headers)
        answer = connection.getresponse()
        yield answer
        answer.close()
        connection.close()

    def ask(self, path: str, **asked: object) -> object:
        """Return the document that answers a question."""
        with self.answer("POST", path, asked) as answer:
            return json.load(answer)

    def end(self, how: signal.Signals) -> list[psutil.Process]:
        """Send a signal, and return the processes that are left a while after the end."""
        family = psutil.Process(self.process.pid).children(recursive=True)
        self.process.send_signal(how)
        self.process.communicate(timeout=END_S)
        left: list[psutil.Process] = psutil.wait_procs(family, timeout=END_S)[1]
        return left


@pytest.mark.long
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_nothing_that_it_started_outlives_it_however_it_ends(here: Path, how: signal.Signals) -> None:
    (here / "otmcp.toml").write_text(REFERENCE)
    console = Started()
    with console.answer("GET", "events") as events:
        assert json.loads(events.readline())["kind"] == "console"
        assert console.ask("adapter", bench=0, do="start", variant="rw") == {}
        assert console.ask("run", do="start", subject=0, suites=["stress"], reps=30) == {}
        while b"starting 1 device" not in events.readline():
            pass
        assert console.end(how) == []
    assert console.process.returncode == (-how if how == signal.SIGKILL else 0)


@pytest.mark.long
def test_why_an_adapter_does_not_start_is_said_and_its_device_ends(here: Path) -> None:
    (here / "otmcp.toml").write_text(LOST)
    console = Started("otmcp.toml")
    answer = console.ask("adapter", bench=0, do="start", variant="rw")
    assert isinstance(answer, dict)
    assert "a-command-that-is-not-there" in answer["problem"]
    assert not [
        one
        for one in psutil.Process(console.process.pid).children(recursive=True)
        if any("mocks" in word for word in one.cmdline())
    ]
    assert console.ask("call", bench=0, tool="x", arguments="{}") == {"problem": "the adapter is not started"}
    assert console.ask("device", bench=0, do="stop") == {"problem": "the device is not running"}
    assert console.ask("adapter", bench=0, do="start", variant="x") == {"problem": "there is no launch 'x'"}
    assert console.end(signal.SIGINT) == []
    assert console.process.returncode == 0


@pytest.mark.long
def test_an_adapter_that_never_starts_does_not_delay_the_end(here: Path) -> None:
    (here / "otmcp.toml").write_text(LOST.replace('"a-command-that-is-not-there"', '"sleep", "1000"'))
    console = Started("otmcp.toml")
    connection = http.client.HTTPConnection(console.host)
    asked = json.dumps({"bench": 0, "do": "start", "variant": "rw"})
    with console.answer("GET", "events") as events:
        connection.request("POST", "/api/adapter", asked, console.headers)
        while b'"new"' not in events.readline():
            pass
        while not [
            one for one in psutil.Process(console.process.pid).children(recursive=True) if one.name() == "sleep"
        ]:
            time.sleep(0.05)
        assert console.end(signal.SIGINT) == []
    connection.close()
    assert console.process.returncode == 0
