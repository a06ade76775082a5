"""What each wall stops: a hostile program tries it with walls and without."""

from __future__ import annotations

import asyncio
import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from pytest_otmcp.core.errors import UsageError
from pytest_otmcp.core.walls import OFF, REQUIRE
from pytest_otmcp.session.isolation import Isolation, Walls
from pytest_otmcp.session.process import SubjectProcess

from .outside import Outside

INTRUDER = Path(__file__).parent / "intruder.py"
HERE = Path(__file__).parent
GRACE_S = 5.0


@dataclass(frozen=True, kw_only=True)
class Seen:
    """What an intruder could do.

    Attributes:
        worked: attempt to whether it worked.
        came: what came outside.
        left: files that it left.
        own: it saw its own file in its working directory.
        alive: processes that it had started and that were there after its end.
    """

    worked: dict[str, bool]
    came: set[str]
    left: set[str]
    alive: int


def isolation_or_skip() -> Isolation:
    try:
        return Isolation(REQUIRE)
    except UsageError as refused:
        pytest.skip(str(refused))


@pytest.fixture(scope="module", params=["walls", "no walls"])
def seen(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Seen]:
    isolation = isolation_or_skip() if request.param == "walls" else Isolation(OFF)
    cwd, work = tmp_path_factory.mktemp("cwd"), tmp_path_factory.mktemp("work")
    # A folder that is not below /tmp: what is there stays visible.
    outside = Outside(HERE)
    files = {
        "file": HERE / f"{outside.name}.txt",
        "temporary": Path("/tmp", outside.name),  # noqa: S108
        "own": cwd / "own.txt",
        "work": work / "done.txt",
    }
    # Without walls nothing ends such a chain as long as it lasts.
    breed = 60 if request.param == "walls" else 0
    target = {**outside.addresses(), "file": str(files["file"]), "work": str(files["work"]), "breed": breed}
    shell = subprocess.Popen(["/bin/sleep", "600"], env={"SECRET_OF_THE_SHELL": "1"})
    try:
        worked = asyncio.run(_intrude(isolation, [sys.executable, str(INTRUDER), json.dumps(target)], cwd, work))
        left = {name for name, path in files.items() if path.exists()}
        yield Seen(worked=worked, came=outside.reached(), left=left, alive=_alive(outside.name))
    finally:
        shell.kill()
        shell.wait()
        outside.close()
        isolation.close()
        for path in files.values():
            path.unlink(missing_ok=True)


async def _intrude(isolation: Isolation, command: list[str], cwd: Path, work: Path) -> dict[str, bool]:
    walls = isolation.walls()
    return await _start(None if walls is None else walls.open_to(reads=(), writes=(str(work),)), command, cwd)


async def _start(walls: Walls | None, command: list[str], cwd: Path) -> dict[str, bool]:
    said: asyncio.Queue[bytes] = asyncio.Queue()
    process = await SubjectProcess.start(
        command,
        env={"PATH": os.environ["PATH"], "HOME": os.environ["HOME"]},
        cwd=cwd,
        on_line=lambda now, line: said.put_nowait(line),
        on_overflow=lambda now: None,
        walls=walls,
    )
    worked: dict[str, bool] = json.loads(await said.get())
    await process.stop(grace_s=GRACE_S)
    return worked


def _alive(name: str) -> int:
    found = 0
    for entry in Path("/proc").iterdir():
        try:
            found += entry.name.isdigit() and name.encode() in (entry / "cmdline").read_bytes()
        except OSError:
            continue
    return found


@pytest.fixture
def walled(seen: Seen, request: pytest.FixtureRequest) -> bool:
    """Whether there are walls."""
    return "no walls" not in request.node.name


@pytest.mark.parametrize("kind", ["tcp", "udp", "abstract", "path", "home"])
def test_nothing_comes_out(seen: Seen, walled: bool, kind: str) -> None:
    assert (kind in seen.came) == (not walled)


@pytest.mark.parametrize("attempt", ["signal", "secret", "file"])
def test_other_processes_and_files_are_out_of_reach(seen: Seen, walled: bool, attempt: str) -> None:
    assert seen.worked[attempt] == (not walled)


def test_no_privilege_is_left(seen: Seen, walled: bool) -> None:
    assert not (walled and (seen.worked["privileges"] or seen.worked["disk"]))


def test_what_is_written_is_private_but_for_the_working_folder(seen: Seen, walled: bool) -> None:
    assert seen.worked["own"]
    assert seen.worked["temporary"]
    assert seen.left == ({"work"} if walled else {"file", "own", "temporary", "work"})


def test_nothing_survives(seen: Seen, walled: bool) -> None:
    assert seen.worked["breed"] == walled
    assert seen.alive == 0


def test_a_keeper_that_was_killed_has_a_successor_with_the_same_walls(tmp_path: Path) -> None:
    isolation = isolation_or_skip()
    outside = Outside(HERE)
    target = {**outside.addresses(), "file": str(HERE / outside.name), "work": str(tmp_path / "done"), "breed": 0}
    command = [sys.executable, str(INTRUDER), json.dumps(target)]
    try:
        asyncio.run(_intrude(isolation, command, tmp_path, tmp_path))
        running = isolation.keeper._running
        assert running is not None
        running.process.kill()
        running.process.wait()
        asyncio.run(_intrude(isolation, command, tmp_path, tmp_path))
        with isolation.socket(socket.SOCK_STREAM) as made, pytest.raises(ConnectionRefusedError):
            made.connect(outside.tcp.getsockname())
        assert outside.reached() == set()
    finally:
        outside.close()
        isolation.close()


def test_what_is_opened_can_be_reached_and_nothing_else(tmp_path: Path) -> None:
    isolation = isolation_or_skip()
    outside = Outside(HERE)
    written = tmp_path / "written"
    written.mkdir()
    target = {**outside.addresses(), "file": str(written / "file"), "work": str(tmp_path / "work"), "breed": 0}
    walls = isolation.walls(outside="it needs the network")
    assert walls is not None
    opened = walls.open_to(reads=[outside.paths["path"]], writes=[str(written)])
    try:
        worked = asyncio.run(_start(opened, [sys.executable, str(INTRUDER), json.dumps(target)], tmp_path))
        assert outside.reached() == {"tcp", "udp", "abstract", "path"}
        assert (written / "file").exists()
        assert not any(worked[attempt] for attempt in ("signal", "secret", "privileges"))
        assert not (tmp_path / "work").exists()
        assert isolation.account() == {"network": "it needs the network", "processes": None, "files": None}
    finally:
        outside.close()
        isolation.close()


# -- machines that refuse ---------------------------------------------------------------------------------------------

REFUSING = """
import os, sys
from pytest_otmcp.session import walls
walls.enter_user()
for name in sys.argv[1].split(","):
    with open(f"/proc/sys/user/max_{name}_namespaces", "w") as file:
        file.write("0")
os.execv(sys.executable, [sys.executable, *sys.argv[2:]])
"""
"""Runs Python where the kernel has no more namespaces of these kinds, as where an administrator forbids them."""


def refused(kinds: str, *command: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    isolation_or_skip().close()
    return subprocess.run(
        [sys.executable, "-c", REFUSING, kinds, *command],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )


DOCTOR = ("-m", "pytest_otmcp.cli", "doctor", "--subject", "otmcp.toml")


@pytest.fixture
def subject(tmp_path: Path) -> Path:
    """A folder with a subject file of the Modbus reference adapter."""
    (tmp_path / "otmcp.toml").write_text(
        """
[subject]
name = "reference"
version = "1"

[adapter.modbus]
command = ["{python}", "-P", "-m", "pytest_otmcp.reference_adapters", "modbus"]
env = { MODBUS_HOST = "{host}", MODBUS_PORT = "{port}" }
rw = { env = { MODBUS_WRITES_ENABLED = "true" } }
unclaimed = {}
"""
    )
    return tmp_path


LOST = {
    "user": "No wall around network, processes and files: this machine refuses a user namespace (No space left on device); ",
    "net": "No wall around network: this machine refuses a network namespace (No space left on device); ",
    "mnt": "No wall around processes and files: this machine refuses a mount namespace (No space left on device); ",
}


@pytest.mark.parametrize(
    "kinds", [pytest.param(name, marks=() if name == "mnt" else pytest.mark.long) for name in LOST]
)
def test_where_the_machine_refuses_it_goes_without_and_says_so(subject: Path, kinds: str) -> None:
    done = refused(kinds, *DOCTOR, cwd=subject)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stderr.startswith(LOST[kinds])
    assert done.stderr.count("\n") == 1


def test_what_is_required_is_not_gone_without(subject: Path) -> None:
    done = refused("mnt", *DOCTOR, "--isolation=require", cwd=subject)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("otmcp: isolation is required, and this machine refuses a mount namespace (")


@pytest.mark.parametrize("mode", ["require", "auto"])
@pytest.mark.long
def test_a_run_where_the_machine_refuses(subject: Path, mode: str) -> None:
    words = ("-m", "pytest", "--otmcp-reps=1", "-k", "M1", f"--otmcp-isolation={mode}", "-p", "no:cacheprovider")
    done = refused("net", *words, cwd=subject)
    if mode == "require":
        assert done.returncode == 2, done.stdout + done.stderr
        assert "isolation is required, and this machine refuses a network namespace (" in done.stdout
    else:
        assert "note: No wall around network: this machine refuses a network namespace" in " ".join(done.stdout.split())
