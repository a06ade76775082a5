"""Adapters at a real device that is cut off and brought back by the commands of a consent, for which a process stands that is killed."""

from __future__ import annotations

import asyncio
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest

from pytest_otmcp.core.errors import NoBindingError
from pytest_otmcp.errors import KitError
from pytest_otmcp.plant import field_device
from pytest_otmcp.plant.devices import Plant
from pytest_otmcp.plant.field_device import UnrestoredError
from pytest_otmcp.protocols.field import Consent
from pytest_otmcp.session.loop import LoopThread
from tests.foreign_software.conftest import Npm, npm

from .conftest import DEFECT, HERE, failing, words
from .test_real_devices import Judge, consent_to, judge, statuses

__all__ = ["judge", "npm"]

pytestmark = pytest.mark.long


@pytest.fixture
def switched(tmp_path: Path) -> Iterator[tuple[str, Consent]]:
    """URL of a device that runs, and the consent to switch it."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port: int = free.getsockname()[1]
    file = tmp_path / "device"
    on, off = ((sys.executable, str(HERE / "switched.py"), what, str(port), str(file)) for what in ("on", "off"))
    subprocess.run(on, check=True)
    url = f"tcp://127.0.0.1:{port}"
    try:
        yield url, replace(consent_to(url, None), writable=(), stop=off, start=on)
    finally:
        subprocess.run(off, check=False)
    assert not file.with_suffix(".writes").exists()


HONEST = (str(HERE / "honest" / "adapter.py"), "modbus/connection-per-request")


@pytest.mark.parametrize(
    ("program", "failed"),
    [
        ((), set()),
        (HONEST, set()),
        ((*DEFECT, "MU-35"), {"F6-modbus"}),
        ((*DEFECT, "MU-126"), {"F6-modbus"}),
    ],
)
def test_an_adapter_is_judged_while_the_device_is_away_and_when_it_is_back(
    switched: tuple[str, Consent], judge: Judge, program: tuple[str, ...], failed: set[str]
) -> None:
    url, consent = switched
    results = judge(url, *program, consent=consent)
    assert failing(results) == failed, words(results)
    assert statuses(results) == ["PASS", "PASS", *["NOT_APPLICABLE"] * 3]


@pytest.mark.parametrize(("program", "failed"), [((), set()), ((*DEFECT, "MU-35o"), {"F6-opcua"})])
def test_an_adapter_is_judged_while_an_opcua_server_is_away(
    npm: Npm, judge: Judge, tmp_path: Path, program: tuple[str, ...], failed: set[str]
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = str(free.getsockname()[1])
    environment = [f"{name}={npm.environment[name]}" for name in ("PATH", "NODE_PATH", "HOME")]
    server = (str(HERE / "standing_in_opcua.cjs"), port, str(npm.directory), "stays")
    switch = (sys.executable, str(HERE / "switched.py"))
    on = (*switch, "on", port, str(tmp_path / "server"), "env", *environment, "node", *server)
    off = (*switch, "off", port, str(tmp_path / "server"))
    subprocess.run(on, check=True)
    try:
        url = f"opc.tcp://127.0.0.1:{port}"
        consent = replace(consent_to(url), device=f"opcua={url}", writable=(), stop=off, start=on)
        results = judge(url, *program, key="opcua", consent=consent)
        assert failing(results) == failed, words(results)
        assert statuses(results) == ["PASS", "PASS", *["NOT_APPLICABLE"] * 3]
    finally:
        subprocess.run(off, check=False)


def test_without_the_commands_nothing_is_cut_off(switched: tuple[str, Consent], judge: Judge) -> None:
    url, consent = switched
    for lesser in (None, replace(consent, stop=(), start=())):
        results = judge(url, consent=lesser)
        assert results["F6-modbus"]["status"] == "NOT_APPLICABLE"
        assert "no consent file has the commands" in (results["F6-modbus"]["reason"] or "")


def test_a_command_that_does_not_cut_off_is_told(switched: tuple[str, Consent], judge: Judge) -> None:
    url, consent = switched
    for stop, problem in (
        (("false",), "'false' ended with code 1"),
        (("/nowhere",), "'/nowhere' cannot be run: No such file"),
    ):
        results = judge(url, consent=replace(consent, stop=stop, start=("true",)))
        assert results["F6-modbus"]["status"] == "NOT_TESTABLE"
        assert problem in words(results)


UNLESS_IT_ANSWERS = """
import socket, subprocess, sys
with socket.socket() as probe:
    answers = probe.connect_ex(("127.0.0.1", int(sys.argv[1]))) == 0
sys.exit(0 if answers else subprocess.call(sys.argv[2:]))
"""


def test_what_brings_a_device_back_does_not_overtake_what_cuts_it_off(
    switched: tuple[str, Consent], loop: LoopThread
) -> None:
    url, consent = switched
    slow = ("sh", "-c", 'sleep 2; exec "$@"', "sh", *consent.stop)
    port = url.rpartition(":")[2]
    # As an outlet does: nothing where the power is on.
    start = (sys.executable, "-c", UNLESS_IT_ANSWERS, port, *consent.start)
    plant = Plant({"modbus": url}, consents={"modbus": replace(consent, stop=slow, start=start)})

    async def interrupted() -> None:
        stopping = asyncio.create_task((await plant.device("modbus")).stop())
        await asyncio.sleep(0.5)
        stopping.cancel()
        with suppress(asyncio.CancelledError):
            await stopping

    try:
        loop.run(interrupted())
    finally:
        loop.run(plant.close())
    time.sleep(2.5)
    socket.create_connection(("127.0.0.1", int(port)), timeout=10).close()


def test_a_command_that_does_not_end_is_killed_with_what_it_has_started(
    switched: tuple[str, Consent], loop: LoopThread, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    url, consent = switched
    monkeypatch.setattr(field_device, "_COMMAND_S", 1.0)
    child = tmp_path / "child"
    endless = ("sh", "-c", f"sleep 600 & echo $! >{child}; wait")
    plant = Plant({"modbus": url}, consents={"modbus": replace(consent, stop=endless, start=("true",))})
    try:
        device = loop.run(plant.device("modbus"))
        with pytest.raises(NoBindingError, match="'sh' did not end within 1 s"):
            loop.run(device.stop())
        status = Path("/proc", child.read_text().strip(), "status")
        for _ in range(300):
            if not status.exists() or "State:\tZ" in status.read_text():
                break
            time.sleep(0.1)
        else:
            pytest.fail("what the command has started still runs")
    finally:
        loop.run(plant.close())


def test_a_device_that_is_not_back_is_told_at_the_end(switched: tuple[str, Consent], loop: LoopThread) -> None:
    url, consent = switched
    plant = Plant({"modbus": url}, consents={"modbus": replace(consent, start=("false",))})
    device = loop.run(plant.device("modbus"))
    loop.run(device.stop())
    with pytest.raises(
        UnrestoredError, match="was stopped and is not back: start, of the consent: 'false' ended with code 1"
    ):
        loop.run(plant.close())
    subprocess.run(consent.start, check=True)
    plant = Plant({"modbus": url}, consents={"modbus": replace(consent, stop=(), start=())})
    try:
        with pytest.raises(KitError, match="nothing says how"):
            loop.run(loop.run(plant.device("modbus")).stop())
    finally:
        loop.run(plant.close())
