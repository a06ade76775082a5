"""A vendor's repository for a test: files in a directory, pytest in a process of its own, what came of it."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pytest_otmcp.record.run_file import load

__all__ = ["DEFECTIVE", "Outcome", "Repository"]

DEFECTIVE = Path(__file__).parents[1] / "soundness" / "defective.py"
_ADAPTER = """
[subject]
name = "a vendor's adapter"
version = "1.0"

[adapter.modbus]
command = ["{{python}}", "{program}", "{mode}"]
env = {{ MODBUS_HOST = "{{host}}", MODBUS_PORT = "{{port}}", MODBUS_TIMEOUT_S = "20", MODBUS_DEADLINE_S = "25" }}
rw = {{ env = {{ MODBUS_WRITES_ENABLED = "true" }} }}
deadline_s = 30
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What one pytest run in the repository came to."""

    code: int
    output: str
    report: Path

    @property
    def record(self) -> dict[str, Any]:
        """The run record, complete or not."""
        return load(self.report / "run.json", allow_incomplete=True)

    @property
    def narrowed(self) -> list[str]:
        """What the record says narrowed or shadowed the suite."""
        sentences: list[str] = self.record["settings"]["narrowed"]
        return sentences

    @property
    def statuses(self) -> dict[str, str]:
        """Item id to status."""
        return {item["id"]: item["status"] for item in self.record["items"]}

    @property
    def verdict(self) -> str:
        """The footer's verdict."""
        return str(self.record["footer"]["verdict"])


class Repository:
    """A directory with a vendor's files."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def write(self, **files: str) -> None:
        """Write files; ``conftest_py`` stands for ``conftest.py``, ``tests__test_own_py`` for ``tests/test_own.py``."""
        for name, content in files.items():
            path = self.root / ".".join(name.replace("__", "/").rsplit("_", 1))
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(content)

    def subject(self, mode: str = "none", more: str = "") -> None:
        """An ``otmcp.toml`` for the Modbus adapter with this defect."""
        self.write(otmcp_toml=_ADAPTER.format(program=DEFECTIVE, mode=mode) + more)

    def pytest(self, *options: str, plugins: str | None = "", env: dict[str, str] | None = None) -> Outcome:
        """Run ``pytest`` with these options here.

        Args:
            plugins: names of the plugins to load besides this one, separated by blanks; None for all that are
                installed, as it is for a vendor.
        """
        environment = {**os.environ, **(env or {})}
        loaded: list[str] = []
        if plugins is not None:
            environment["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
            loaded = [part for name in ("pytest_otmcp.plugin", *plugins.split()) for part in ("-p", name)]
        done = subprocess.run(
            [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *loaded, *options],
            cwd=self.root,
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
            env=environment,
        )
        return Outcome(code=done.returncode, output=done.stdout + done.stderr, report=self.root / "reports" / "latest")

    def collected(self, *options: str, plugins: str | None = "") -> list[str]:
        """Names of the items that pytest would run."""
        outcome = self.pytest("--collect-only", "-q", *options, plugins=plugins)
        return [line.rpartition("::")[2] for line in outcome.output.splitlines() if "::" in line]
