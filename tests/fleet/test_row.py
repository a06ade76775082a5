"""One row by itself: what is in its folder, and what is left of an installation."""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from pytest_otmcp import cli
from pytest_otmcp.cli import fleet_row
from pytest_otmcp.fleet.plan import ROWS, RUNS, write_plan

from .rows import plan, subject

IMAGE = f'image = "acme@sha256:{"0" * 64}"'


def planned(folder: Path, more: str) -> Path:
    """Return the file of the one row of a plan."""
    subject(folder, "one")
    write_plan(plan(folder, f"one 1 one {more}", settings='reps = 1\nisolation = "auto"'), folder / "fleet")
    (file,) = (folder / "fleet" / ROWS).iterdir()
    return file


@pytest.mark.parametrize("more", ["install = ['no-such-program']", IMAGE])
def test_only_a_folder_of_its_own_is_emptied(tmp_path: Path, capsys: pytest.CaptureFixture[str], more: str) -> None:
    file, mine = planned(tmp_path, more), tmp_path / "mine"
    mine.mkdir()
    (mine / "thesis.txt").touch()
    assert cli.main(["fleet", "row", str(file), "--out", str(mine)]) == 2
    assert f"must be called {file.stem}" in capsys.readouterr().err
    assert (mine / "thesis.txt").exists()


def test_a_folder_that_cannot_be_removed_is_emptied(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = planned(tmp_path, "install = ['no-such-program']")
    out = tmp_path / "fleet" / RUNS / file.stem
    (out / "report").mkdir(parents=True)
    (out / "result.json").touch()
    number = out.stat().st_ino
    assert fleet_row.run(argparse.Namespace(row=file, out=out, attempt=1, contained=False)) == 3
    assert "there is no no-such-program" in capsys.readouterr().out
    assert (out.stat().st_ino, [path.name for path in out.iterdir()]) == (number, ["log.txt"])


@pytest.mark.long
def test_an_installation_that_takes_too_long_ends_with_its_children(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pid = tmp_path / "pid"
    file = planned(tmp_path, f"install = ['''sh -c \"sleep 300 & echo $! > {pid}; wait\"''']")
    monkeypatch.setattr(fleet_row, "_INSTALL_S", 5)
    out = tmp_path / "fleet" / RUNS / file.stem
    assert fleet_row.run(argparse.Namespace(row=file, out=out, attempt=1, contained=False)) == 3
    assert "took longer than 5 s" in capsys.readouterr().out
    until(lambda: not running(int(pid.read_text())))


ENGINE = """
import pathlib, signal, subprocess, sys, time
here = pathlib.Path(sys.argv[1])
signal.signal(signal.SIGINT, lambda *_: (here / "told").touch())
apart = subprocess.Popen(["sleep", "300"], start_new_session=True)
(here / "new").write_text(str(apart.pid))
(here / "new").rename(here / "pid")
while True:
    time.sleep(0.1)
"""


@pytest.mark.long
def test_a_second_interruption_ends_engine_and_runs(tmp_path: Path) -> None:
    (tmp_path / "engine.py").write_text(ENGINE)
    program = "import sys; from pytest_otmcp.cli.fleet import _to_its_end; _to_its_end(sys.argv[1:])"
    command = [sys.executable, "-P", "-c", program, sys.executable, str(tmp_path / "engine.py"), str(tmp_path)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
        until((tmp_path / "pid").exists)
        family = psutil.Process(process.pid).children(recursive=True)
        assert int((tmp_path / "pid").read_text()) in {one.pid for one in family}
        os.kill(process.pid, signal.SIGINT)
        until((tmp_path / "told").exists)
        assert process.poll() is None
        os.kill(process.pid, signal.SIGINT)
        process.wait(300)
    until(lambda: not any(running(one.pid) for one in family))


def until(happened: Callable[[], bool]) -> None:
    """Wait until something has happened."""
    deadline = time.monotonic() + 300
    while not happened():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def running(pid: int) -> bool:
    try:
        return bool(psutil.Process(pid).status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False
