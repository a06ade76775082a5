"""The wheel works with the tools that make an environment for one program: uvx, uv tool and pipx."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from pytest_otmcp import __version__

pytestmark = pytest.mark.long

Run = Callable[..., str]
ONE_ITEM = ("pytest", "--pyargs", "pytest_otmcp.conformance", "--otmcp-reps=1", "-k", "[M1]")


@pytest.fixture(scope="module")
def tools(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A function that runs a program of an environment with uv and pipx, in an empty directory, and returns what it printed."""
    root = tmp_path_factory.mktemp("tools")
    made = subprocess.run([sys.executable, "-m", "venv", root / "v"], check=False)
    install = [root / "v" / "bin" / "pip", "install", "--quiet", "uv", "pipx"]
    if made.returncode or subprocess.run(install, check=False, capture_output=True).returncode:
        pytest.skip("uv and pipx cannot be had from a package index")
    folders = {
        **{name: str(root / name) for name in ("UV_CACHE_DIR", "UV_TOOL_DIR", "PIPX_HOME")},
        **dict.fromkeys(("UV_TOOL_BIN_DIR", "PIPX_BIN_DIR"), str(root / "bin")),
        "UV_PYTHON": sys.executable,
        "UV_PYTHON_DOWNLOADS": "never",
        "PIPX_DEFAULT_PYTHON": sys.executable,
        "PATH": os.pathsep.join((str(root / "bin"), str(root / "v" / "bin"), os.environ["PATH"])),
    }
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "PYTEST", "VIRTUAL"))}
    (root / "empty").mkdir()

    def run(*command: str | Path, code: int = 0) -> str:
        done = subprocess.run(
            list(map(str, command)),
            cwd=root / "empty",
            env=kept | folders,
            capture_output=True,
            text=True,
            timeout=900,
            check=False,
        )
        assert done.returncode == code, done.stdout + done.stderr
        return done.stdout

    return run


def test_uvx_runs_a_command_and_the_suite_from_the_wheel(tools: Run, wheel: Path) -> None:
    assert tools("uvx", "--from", wheel, "otmcp", "--version") == f"pytest-otmcp {__version__}\n"
    # One item of the suite is not the whole of it.
    assert "VERDICT: INCOMPLETE (1 of " in tools("uvx", "--from", wheel, *ONE_ITEM, code=1)


@pytest.mark.weekly
@pytest.mark.parametrize(
    "install",
    [
        ("uv", "tool", "install", "--force", "--with-executables-from", "pytest"),
        ("pipx", "install", "--force", "--include-deps"),
    ],
    ids=["uv tool", "pipx"],
)
def test_an_installed_tool_brings_the_command_and_the_pytest_that_has_the_kit(
    tools: Run, wheel: Path, install: tuple[str, ...]
) -> None:
    tools(*install, wheel)
    assert tools("otmcp", "--version") == f"pytest-otmcp {__version__}\n"
    assert "VERDICT: INCOMPLETE (1 of " in tools(*ONE_ITEM, code=1)
