"""The wheel with the oldest pytest that is supported."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from pytest_otmcp.record import load

from .conftest import CHECKOUT, environment
from .test_wheel import run

pytestmark = [pytest.mark.long, pytest.mark.weekly]


def test_the_whole_suite_passes_with_the_oldest_pytest(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    settings = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())
    oldest = settings["tool"]["pytest"]["ini_options"]["minversion"]
    root = environment(tmp_path_factory, wheel)
    python = str(root / ".venv" / "bin" / "python")
    # It lies beside the wheel and comes before the pytest of this environment.
    pip = [sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps", f"pytest=={oldest}.*"]
    installed = subprocess.run(pip, cwd=root, capture_output=True, text=True, check=False)
    if installed.returncode != 0:
        pytest.skip(f"pytest {oldest} cannot be had from an index: {installed.stderr.strip().splitlines()[-1]}")
    done = run(root, "python", "-m", "pytest", "--otmcp-reps=2", timeout=1800)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"pytest-{oldest}." in done.stdout
    assert "VERDICT: CONFORMANT (38 of 38 items passed" in done.stdout
    assert load(root / "reports" / "latest" / "run.json")["settings"]["narrowed"] == []
