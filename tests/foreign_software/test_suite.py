"""The whole suite in one process: behind brokers that are not the kit's own device, and with adapters over HTTP."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from pytest_otmcp.record import load
from tests.reference_text import reference_text

from .conftest import mock, running_mosquitto

pytestmark = pytest.mark.long


def suite(directory: Path, *options: str) -> Mapping[str, str]:
    """Run the whole suite in one process, two repetitions; return the status of each item."""
    command = [sys.executable, "-P", "-m", "pytest", "-p", "no:cacheprovider", "--pyargs", "pytest_otmcp.conformance"]
    report = directory / "report"
    done = subprocess.run(
        [*command, "--otmcp-reps=2", f"--otmcp-report-dir={report}", *options],
        cwd=directory,
        env={**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_PLUGINS": "pytest_otmcp.plugin"},
        capture_output=True,
        text=True,
        timeout=580,
        check=False,
    )
    statuses = {item["id"]: item["status"] for item in load(report / "run.json")["items"]}
    assert len(statuses) == 38, done.stdout
    assert done.returncode == 0, done.stdout[-4000:]
    return statuses


def passes_behind(port: int, directory: Path) -> None:
    """Nothing fails, and what does not apply are items that need to know what the broker holds."""
    statuses = suite(directory, f"--otmcp-broker=mqtt://127.0.0.1:{port}")
    assert set(statuses.values()) <= {"PASS", "NOT_APPLICABLE"}, statuses
    assert {statuses[item] for item in ("Q1", "Q2", "Q3", "Q4", "S8", "R-mqtt")} == {"PASS"}


def test_the_whole_suite_passes_with_mosquitto_as_the_broker(tmp_path: Path) -> None:
    with running_mosquitto(tmp_path) as port:
        passes_behind(port, tmp_path)


@pytest.mark.weekly
def test_the_whole_suite_passes_with_a_mock_as_a_broker_of_the_users_own(tmp_path: Path) -> None:
    with mock("mqtt") as (_, device):
        passes_behind(device.port, tmp_path)


@pytest.mark.weekly
def test_the_whole_suite_passes_with_all_three_adapters_over_http(tmp_path: Path) -> None:
    shipped = reference_text()
    tables = len(re.findall(r"^\[adapter\.\w+\]$", shipped, re.MULTILINE))
    over_http = re.sub(
        r"^command = (.*)\nenv = { ",
        'transport = "http"\nurl = "http://127.0.0.1:{http_port}/mcp"\ncommand = \\1\n'
        'env = { MCP_TRANSPORT = "streamable-http", MCP_HTTP_PORT = "{http_port}", ',
        shipped.replace("{kit_version}", "1"),
        flags=re.MULTILINE,
    )
    added = over_http.count("MCP_TRANSPORT") - shipped.count("MCP_TRANSPORT")
    assert tables == over_http.count('transport = "http"') == added == 3
    subject = tmp_path / "otmcp.toml"
    subject.write_text(over_http)
    assert set(suite(tmp_path, f"--otmcp-subject={subject}").values()) == {"PASS"}
