"""``otmcp init`` on public adapters: what it calls proven is right, and it touches nothing but the mock device."""

from __future__ import annotations

import asyncio
import json
import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.plant.journal import DeviceJournal
from pytest_otmcp.plant.mock_device import MockDevice
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.subject import Adapter, load_subject
from pytest_otmcp.subject.model import Function
from tests.soundness.document import DOCUMENT, with_section

from .bindings_at_work import wrong_bindings
from .conftest import Install
from .init_launches import LAUNCHES, Launch
from .init_section import section

WATCH = Path(__file__).parent / "watch"
USUAL_PORTS = {
    "modbus": 502,
    "mqtt": 1883,
    "opcua": 4840,
    "s7": 102,
    "bacnet": 47808,
    "ethernetip": 44818,
    "dnp3": 20000,
}
"""Where an adapter may go that was not told where its device is."""

AT_A_TIME = 3
TIMEOUT_S = 300

NAMES = [launch.name for launch in LAUNCHES]


class AtUsualPort:
    """A second device of a protocol, at the port that is usual for it: the plant."""

    def __init__(self, protocol: str) -> None:
        self._protocol = protocol
        command = [sys.executable, "-P", "-m", "pytest_otmcp.mocks", protocol, "--port", str(USUAL_PORTS[protocol])]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self._process.stdout is not None
        ready = self._process.stdout.readline()
        # Another program may serve there, or this user may not.
        self.control = json.loads(ready)["control"] if ready else None

    def seen(self) -> list[dict[str, Any]]:
        """What came from clients, beside connections without a word."""
        if self.control is None:
            return []
        with closing(socket.socket(socket.AF_UNIX)) as channel:
            channel.connect(self.control)
            channel.sendall(b'{"id": 1, "op": "journal", "since": 0}\n')
            with channel.makefile() as answers:
                told = json.loads(answers.readline())["result"]
        framing = protocols()[self._protocol].framing
        journal = DeviceJournal(None if framing is None else framing.conversation)
        journal.take(told)
        entries: list[Any] = journal.since(0)
        return [entry for entry in entries if entry["origin"] == "client" and entry["request"]]

    def close(self) -> None:
        with self._process:
            assert self._process.stdin is not None
            self._process.stdin.close()


async def at_a_mock(adapter: Adapter) -> list[str]:
    device = MockDevice(protocols()[adapter.protocol].mock, adapter.protocol)
    try:
        await device.launch()
        return await wrong_bindings(adapter, device)
    finally:
        await device.close()


class Done:
    """One call of ``otmcp init``, what the adapter's processes connected to meanwhile, and what is wrong with its bindings."""

    def __init__(self, launch: Launch, directory: Path, environment: Path) -> None:
        for venv in environment.glob(".venv*"):
            (directory / venv.name).symlink_to(venv)
        log = directory / "connections"
        watch = {"PYTHONPATH": str(WATCH), "WATCH_LOG": str(log), "WATCH_MOCK": "{host}:{port}"}
        options = [part for name, value in watch.items() for part in ("--env", f"{name}={value}")]
        self.process = subprocess.run(
            # Connections in a network of the run's own could not be watched from here.
            [
                sys.executable,
                "-m",
                "pytest_otmcp.cli",
                "init",
                "--isolation=off",
                *launch.options(),
                *options,
                "--",
                *launch.command,
            ],
            cwd=directory,
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
            check=False,
        )
        file = directory / "otmcp.toml"
        self.file = file.read_text(encoding="utf-8") if file.exists() else ""
        lines = log.read_text(encoding="utf-8").splitlines() if log.exists() else []
        self.connections = [tuple(line.split()) for line in lines]
        self.adapter = load_subject(file).adapters[launch.protocol] if file.exists() else None
        self.wrong = [] if self.adapter is None else asyncio.run(at_a_mock(self.adapter))

    def told(self, mark: str) -> dict[str, str]:
        """Operation to tool, of the lines with this mark."""
        return dict(re.findall(rf"^  (\w+) +(\S+) \({mark}: ", self.process.stdout, re.MULTILINE))


@pytest.fixture(scope="module")
def plants() -> Iterator[list[AtUsualPort]]:
    with ExitStack() as stack:
        devices = [AtUsualPort(protocol) for protocol in USUAL_PORTS]
        for device in devices:
            stack.callback(device.close)
        yield devices


@pytest.fixture(scope="module")
def calls(
    installed: Install, plants: list[AtUsualPort], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[dict[str, Future[Done]]]:
    """Every launch's call; several at a time, because adapters wait more than they work."""
    with ThreadPoolExecutor(AT_A_TIME) as pool:
        started = {}
        for launch in LAUNCHES:
            try:
                environment = installed(launch.example).parent
            except pytest.skip.Exception:
                continue
            if (environment / launch.command[0]).exists():
                directory = tmp_path_factory.mktemp(launch.name.replace(" ", "-"))
                started[launch.name] = pool.submit(Done, launch, directory, environment)
        yield started


@pytest.fixture
def done(calls: dict[str, Future[Done]], launch: Launch) -> Done:
    if launch.name not in calls:
        pytest.skip(f"{launch.example} is not installed here")
    return calls[launch.name].result()


@pytest.mark.long
@pytest.mark.parametrize("launch", LAUNCHES, ids=NAMES)
def test_what_init_proves_is_right_and_nothing_but_the_mock_is_touched(
    launch: Launch, done: Done, plants: list[AtUsualPort]
) -> None:
    assert done.process.returncode == 0, done.process.stdout + done.process.stderr
    told = done.told("proven")
    assert told.pop("guard", None) == launch.guard, done.process.stdout
    assert told == launch.proven, f"{done.process.stdout}\n{done.file}"
    assert done.told("asked, but not read") == launch.unfilled, done.process.stdout
    assert done.process.stdout.count("\n  - ") == launch.left, done.process.stdout
    assert done.adapter is not None
    assert tools(done.adapter) == launch.proven
    assert commands(done.adapter) == {*launch.commands}

    assert done.connections, "nobody watched"
    assert [address for address, mock in done.connections if address != mock] == []
    assert [seen for plant in plants if (seen := plant.seen())] == []

    assert done.wrong == []


def tools(adapter: Adapter) -> dict[str, str]:
    """Operation to tool, where a table binds one."""
    bound = {name: cases for name, cases in adapter.operations.items() if not isinstance(cases, Function)}
    tables = {name: [case.tool for case in cases if case.command is None] for name, cases in bound.items()}
    return {name: found[0] for name, found in tables.items() if found}


def commands(adapter: Adapter) -> set[str]:
    """The tools of its named commands."""
    bound = [case for cases in adapter.operations.values() if not isinstance(cases, Function) for case in cases]
    return {case.tool for case in bound if case.command is not None}


@pytest.mark.parametrize("launch", LAUNCHES, ids=NAMES)
def test_what_init_proves_is_what_the_example_binds(launch: Launch) -> None:
    by_hand = tools(
        load_subject(DOCUMENT.parent / "examples" / launch.example / "otmcp.toml").adapters[launch.protocol]
    )
    found = {**launch.proven, **launch.unfilled}
    assert {name: tool for name, tool in found.items() if name in by_hand} == {
        name: tool for name, tool in by_hand.items() if name in found
    }


def test_ten_adapters_are_tried() -> None:
    assert len({launch.example for launch in LAUNCHES}) >= 10


def test_the_documentation_has_what_init_proves() -> None:
    current = with_section("init", section())
    assert DOCUMENT.read_text(encoding="utf-8") == current, "python -m tests.adapters_in_the_wild.init_section"
