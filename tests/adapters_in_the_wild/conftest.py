"""A fixture that installs an example's adapter, as its file says, into an environment that later runs find again."""

from __future__ import annotations

import fcntl
import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
INSTALL_TIMEOUT_S = 300.0

Install = Callable[[str], Path]


@pytest.fixture(scope="session")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Install:
    """``installed(name)``: the example's subject file in a directory of its own with its adapter in ``.venv``.

    The test is skipped where the packages cannot be installed, or where OTMCP_NO_NETWORK forbids to install them.
    """
    # The cache lies beside pytest's own directories, which belong to this user alone; pytest removes those in time, but
    # not the cache.
    cache = tmp_path_factory.getbasetemp().parent / "adapters-in-the-wild"

    def install(name: str) -> Path:
        example = EXAMPLES / name
        requirements = (example / "requirements.txt").read_bytes()
        key = hashlib.sha256(b"%d.%d\n" % sys.version_info[:2] + requirements).hexdigest()[:12]
        home = cache / f"{name}-{key}"
        home.mkdir(parents=True, exist_ok=True)
        with (home / "lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not (home / "complete").exists():
                _install(name, home / ".venv", example / "requirements.txt")
                (home / "complete").touch()
        for file in example.iterdir():
            if file.is_file():
                shutil.copy(file, home)
        return home / "otmcp.toml"

    return install


def _install(name: str, environment: Path, requirements: Path) -> None:
    if os.environ.get("OTMCP_NO_NETWORK"):
        pytest.skip(f"{name} is not installed, and OTMCP_NO_NETWORK forbids to install it")
    shutil.rmtree(environment, ignore_errors=True)
    python = str(environment / "bin" / "python")
    if importlib.util.find_spec("uv") is not None:
        steps = [
            [sys.executable, "-m", "uv", "venv", "--quiet", "--python", sys.executable, str(environment)],
            [sys.executable, "-m", "uv", "pip", "install", "--quiet", "--python", python, "-r", str(requirements)],
        ]
    else:
        steps = [
            [sys.executable, "-m", "venv", "--without-pip", str(environment)],
            [sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "-r", str(requirements)],
        ]
    for step in steps:
        try:
            done = subprocess.run(
                step, cwd=environment.parent, capture_output=True, text=True, timeout=INSTALL_TIMEOUT_S, check=False
            )
        except subprocess.TimeoutExpired:
            pytest.skip(f"{name} could not be installed within {INSTALL_TIMEOUT_S:g} s")
        if done.returncode:
            reason = (done.stderr.strip() or done.stdout.strip() or "no reason given").splitlines()[-1]
            pytest.skip(f"{name} cannot be installed here: {reason}")
