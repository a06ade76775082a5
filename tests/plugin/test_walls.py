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
from pytest_otmcp.record import load
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


def reference(protocols: Collection[str], launch: str) -> str:
    """Return the subject file of the reference adapters for these protocols, started in another way."""
    shipped = resources.files("pytest_otmcp.subject").joinpath("reference.toml").read_text(encoding="utf-8")
    assert LAUNCH in shipped
    tables = re.split(r"(?m)^(?=\[(?:subject|adapter)\b)", shipped.replace(LAUNCH, launch))
    names = [re.match(r"\[adapter\.(\w+)", table) for table in tables]
    return "".join(table for table, name in zip(tables, names, strict=True) if name is None or name[1] in protocols)


@pytest.fixture
def run(tmp_path: Path, outside: Outside) -> Run:
    """Runs Python in a folder with a subject file whose adapters are the reference adapters for these protocols, and reach out."""
    targets = tmp_path / "outside.json"
    targets.write_text(json.dumps(outside.addresses()), encoding="utf-8")

    def run(protocols: Collection[str], *words: str) -> subprocess.CompletedProcess[str]:
        text = reference(protocols, f'["{{python}}", "{REACHING_OUT}", "{targets}", ')
        (tmp_path / "reaching.toml").write_text(text, encoding="utf-8")
        command = [sys.executable, *words]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=1200, check=False)

    return run


MODES = [("require", set[str]()), pytest.param("off", ALL, marks=pytest.mark.long)]


@pytest.mark.long
@pytest.mark.parametrize(("mode", "came"), MODES)
def test_doctor(run: Run, outside: Outside, mode: str, came: set[str]) -> None:
    done = run(("modbus",), "-m", "pytest_otmcp.cli", "doctor", "--subject=reaching.toml", f"--isolation={mode}")
    assert done.returncode == 0, done.stdout + done.stderr
    assert outside.reached() == came


@pytest.mark.long
@pytest.mark.parametrize(("mode", "came"), MODES)
def test_call(run: Run, outside: Outside, mode: str, came: set[str]) -> None:
    words = ("call", "--subject=reaching.toml", f"--isolation={mode}", "read_holding", "address=1", "count=1")
    done = run(("modbus",), "-m", "pytest_otmcp.cli", *words)
    assert done.returncode == 0, done.stdout + done.stderr
    assert outside.reached() == came


@pytest.mark.long
@pytest.mark.parametrize(("mode", "came"), MODES)
def test_init(run: Run, outside: Outside, tmp_path: Path, mode: str, came: set[str]) -> None:
    variables = ("MODBUS_HOST={host}", "MODBUS_PORT={port}", "MODBUS_WRITES_ENABLED=true")
    words = [part for variable in variables for part in ("--env", variable)]
    command = (sys.executable, str(REACHING_OUT), str(tmp_path / "outside.json"), "modbus")
    done = run((), "-m", "pytest_otmcp.cli", "init", f"--isolation={mode}", *words, "--", *command)
    assert done.returncode == 0, done.stdout + done.stderr
    assert outside.reached() == came


@pytest.mark.long
@pytest.mark.parametrize(("mode", "came"), MODES)
def test_suite(run: Run, outside: Outside, tmp_path: Path, mode: str, came: set[str]) -> None:
    words = ("--otmcp-subject=reaching.toml", "--otmcp-reps=1", "--otmcp-suite=normal", f"--otmcp-isolation={mode}")
    done = run(("modbus", "mqtt", "opcua", "profibus"), "-m", "pytest", "-q", *words)
    record = load(tmp_path / "reports" / "latest" / "run.json", allow_incomplete=True)
    assert {item["status"] for item in record["items"]} == {"PASS"}, done.stdout + done.stderr
    assert outside.reached() == came
    assert record["environment"]["walls"] == dict.fromkeys(
        WALLS, None if mode == "require" else "they were switched off"
    )


@pytest.mark.long
def test_what_a_shell_makes_in_the_working_directory_is_seen(tmp_path: Path) -> None:
    isolation_or_skip().close()
    defective = LAUNCH.replace("reference_adapters", "reference_adapters.defects")
    text = reference(("mqtt",), defective).replace('defects", "mqtt"]', 'defects", "MU-109q"]')
    assert "MU-109q" in text
    (tmp_path / "otmcp.toml").write_text(text, encoding="utf-8")
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "--otmcp-reps=1",
        "--otmcp-only=INJ-003",
        "--otmcp-isolation=require",
    ]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 1, done.stdout + done.stderr
    assert "a file is there that a shell makes of a text" in " ".join(done.stdout.split())
    assert {path.name for path in tmp_path.iterdir() if not path.name.startswith(".")} == {"otmcp.toml", "reports"}
