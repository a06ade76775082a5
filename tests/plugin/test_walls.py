"""Nothing that an adapter does reaches what is outside of a run, whichever command has started it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable, Collection, Iterator
from importlib import resources
from pathlib import Path

import pytest

from pytest_otmcp.core.walls import WALLS
from tests.walls.outside import Outside
from tests.walls.test_walls import isolation_or_skip

REACHING_OUT = Path(__file__).parents[1] / "walls" / "reaching_out.py"
ALL = {"tcp", "udp", "abstract", "path", "home"}

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def outside() -> Iterator[Outside]:
    isolation_or_skip().close()
    made = Outside(REACHING_OUT.parent)
    yield made
    made.close()


LAUNCH = '["{python}", "-P", "-m", "pytest_otmcp.reference_adapters", '


@pytest.fixture
def run(tmp_path: Path, outside: Outside) -> Run:
    """Runs Python in a folder with a subject file whose adapters are the reference adapters for these protocols, and reach out."""
    targets = tmp_path / "outside.json"
    targets.write_text(json.dumps(outside.addresses()), encoding="utf-8")
    shipped = resources.files("pytest_otmcp.subject").joinpath("reference.toml").read_text(encoding="utf-8")
    tables = re.split(r"(?m)^(?=\[)", shipped.replace(LAUNCH, f'["{{python}}", "{REACHING_OUT}", "{targets}", '))

    def run(protocols: Collection[str], *words: str) -> subprocess.CompletedProcess[str]:
        asked = [
            table for table in tables if not (known := re.match(r"\[adapter\.(\w+)", table)) or known[1] in protocols
        ]
        (tmp_path / "reaching.toml").write_text("".join(asked), encoding="utf-8")
        command = [sys.executable, *words]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=1200, check=False)

    return run


MODES = [("require", set[str]()), pytest.param("off", ALL, marks=pytest.mark.long)]


@pytest.mark.parametrize(("mode", "came"), MODES)
def test_doctor(run: Run, outside: Outside, mode: str, came: set[str]) -> None:
    done = run(("modbus",), "-m", "pytest_otmcp.cli", "doctor", "--subject=reaching.toml", f"--isolation={mode}")
    assert done.returncode == 0, done.stdout + done.stderr
    assert set(outside.came) == came


@pytest.mark.long
@pytest.mark.parametrize(("mode", "came"), MODES)
def test_call(run: Run, outside: Outside, mode: str, came: set[str]) -> None:
    words = ("call", "--subject=reaching.toml", f"--isolation={mode}", "read_holding", "address=1", "count=1")
    done = run(("modbus",), "-m", "pytest_otmcp.cli", *words)
    assert done.returncode == 0, done.stdout + done.stderr
    assert set(outside.came) == came


@pytest.mark.long
@pytest.mark.parametrize(("mode", "came"), MODES)
def test_init(run: Run, outside: Outside, tmp_path: Path, mode: str, came: set[str]) -> None:
    variables = ("MODBUS_HOST={host}", "MODBUS_PORT={port}", "MODBUS_WRITES_ENABLED=true")
    words = [part for variable in variables for part in ("--env", variable)]
    command = (sys.executable, str(REACHING_OUT), str(tmp_path / "outside.json"), "modbus")
    done = run((), "-m", "pytest_otmcp.cli", "init", f"--isolation={mode}", *words, "--", *command)
    assert done.returncode == 0, done.stdout + done.stderr
    assert set(outside.came) == came


@pytest.mark.long
@pytest.mark.parametrize(("mode", "came"), MODES)
def test_suite(run: Run, outside: Outside, tmp_path: Path, mode: str, came: set[str]) -> None:
    words = ("--otmcp-subject=reaching.toml", "--otmcp-reps=1", "--otmcp-suite=normal", f"--otmcp-isolation={mode}")
    done = run(("modbus", "mqtt", "opcua", "profibus"), "-m", "pytest", "-q", *words)
    record = json.loads((tmp_path / "reports" / "latest" / "run.json").read_text(encoding="utf-8"))
    assert {item["status"] for item in record["items"]} == {"PASS"}, done.stdout + done.stderr
    assert set(outside.came) == came
    assert record["environment"]["walls"] == dict.fromkeys(
        WALLS, None if mode == "require" else "they were switched off"
    )
