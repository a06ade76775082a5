"""Mocks and reference adapters with software of the npm registry: MCP's own tools, clients for Node.js."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.plant.mock_device import MockDevice

from .conftest import PATIENCE_S, Npm, mock

pytestmark = pytest.mark.long

PROGRAMS = Path(__file__).parent

PROTOCOLS = ("modbus", "mqtt", "opcua")


# -- MCP's own tools ------------------------------------------------------------------------------------------------

SCENARIOS = (
    "server-initialize",
    "ping",
    "tools-list",
    "server-sse-multiple-streams",
    "server-sse-polling",
    "dns-rebinding-protection",
)
"""Scenarios of the official conformance suite that want no tool, prompt or resource of their own."""


@contextmanager
def over_http(protocol: str, device: MockDevice) -> Iterator[str]:
    """A reference adapter at a mock device, over streamable HTTP; its URL."""
    settings = {
        "modbus": {"MODBUS_HOST": device.host, "MODBUS_PORT": str(device.port), "MODBUS_WRITES_ENABLED": "true"},
        "mqtt": {"MQTT_URL": f"mqtt://{device.host}:{device.port}"},
        "opcua": {"OPCUA_URL": f"opc.tcp://{device.host}:{device.port}"},
    }[protocol]
    with subprocess.Popen(
        [sys.executable, "-P", "-m", "pytest_otmcp.reference_adapters", protocol],
        env={**os.environ, "MCP_TRANSPORT": "streamable-http", "MCP_HTTP_PORT": "0", **settings},
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert process.stderr is not None
            next(process.stderr)
            yield next(process.stderr).split()[-1]
        finally:
            process.terminate()


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_the_official_conformance_suite_has_no_complaint(npm: Npm, protocol: str) -> None:
    with mock(protocol) as (_, device), over_http(protocol, device) as url:
        for scenario in SCENARIOS:
            done = npm.run("conformance", "server", "--url", url, "--scenario", scenario)
            assert done.returncode == 0, done.stdout + done.stderr
            counted = re.search(r"Passed: (\d+)/(\d+), 0 failed", done.stdout)
            assert counted is not None, done.stdout
            assert int(counted[1]) > 0 or scenario == "server-sse-polling", done.stdout


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_the_inspector_lists_the_tools_in_each_era_without_an_error_in_a_schema(npm: Npm, protocol: str) -> None:
    with mock(protocol) as (_, device), over_http(protocol, device) as url:
        asked = ["mcp-inspector", "--cli", url, "--transport", "http", "--method", "tools/list", "--strict"]
        listed = {}
        for era in ("modern", "legacy"):
            done = npm.run(*asked, "--protocol-era", era)
            assert done.returncode == 0, done.stderr
            listed[era] = json.loads(done.stdout)["tools"]
        assert listed["modern"]
        assert listed["modern"] == listed["legacy"]


def test_the_inspector_writes_through_an_adapter_and_the_device_has_it(npm: Npm) -> None:
    with mock("modbus") as (loop, device), over_http("modbus", device) as url:
        call = ["mcp-inspector", "--cli", url, "--transport", "http", "--method", "tools/call"]
        done = npm.run(*call, "--tool-name", "write_register", "--tool-arg", "address=1", "--tool-arg", "value=4711")
        assert json.loads(done.stdout)["structuredContent"]["success"] is True, done.stderr
        assert loop.run(device.image())["units"]["1"]["holding_registers"][1] == 4711


# -- clients for Node.js --------------------------------------------------------------------------------------------


def said(output: Iterable[str]) -> Iterator[dict[str, Any]]:
    """Read what a program says, a JSON object in a line; libraries of Node.js write other lines in between."""
    return (json.loads(line) for line in output if line.startswith("{"))


def test_a_node_clients_subscription_survives_a_restart_of_the_opcua_mock(npm: Npm) -> None:
    with mock("opcua") as (loop, device):
        url = f"opc.tcp://{device.host}:{device.port}"
        with npm.node(PROGRAMS / "opcua_client.cjs", url, "ns=2;s=ValvePosition") as client:
            assert client.stdout is not None
            assert client.stdin is not None
            events = said(client.stdout)
            assert next(events) == {"event": "value", "value": 50}
            loop.run(device.stop())
            loop.run(device.start())
            seen: Counter[str] = Counter()
            while not seen["reestablished"]:
                seen[next(events)["event"]] += 1
            loop.run(device.poke(node="ValvePosition", value=12.5))
            assert {"event": "value", "value": 12.5} in events
            kinds = Counter(
                entry["kind"] for entry in loop.run(device.journal(0)).entries if entry["direction"] == "in"
            )
            # It asks once for each subscription whether a notification was lost, and is told that there is none.
            assert kinds["Republish"] <= 2
            client.stdin.close()
            assert client.wait(PATIENCE_S) == 0


def metrics(messages: list[Mapping[str, Any]], kind: str, device: str | None) -> Mapping[str, Any]:
    return next(one["metrics"] for one in messages if (one["kind"], one["device"]) == (kind, device))


def test_an_npm_sparkplug_host_reads_the_births_and_writes_a_metric(npm: Npm) -> None:
    with mock("mqtt") as (loop, device):
        loop.run(device.reset())
        held = loop.run(device.image())["edge_node"]
        (name, _), *_ = held["devices"].items()
        options = [f"mqtt://{device.host}:{device.port}", held["group"], held["edge_node"], name, "setpoint"]
        with npm.node(PROGRAMS / "sparkplug_host.cjs", *options) as host:
            assert host.stdout is not None
            messages: list[Mapping[str, Any]] = []
            for message in said(host.stdout):
                messages.append(message)
                if messages[-1]["kind"] == "DDATA" and messages[-1]["metrics"].get("setpoint") == 42.5:
                    break
        assert [one["seq"] for one in messages] == list(range(messages[0]["seq"], messages[0]["seq"] + len(messages)))
        assert (messages[0]["kind"], messages[0]["seq"]) == ("NBIRTH", 0)
        assert metrics(messages, "NBIRTH", None)["Node Control/Rebirth"] is False
        for each, tags in held["devices"].items():
            assert set(tags) == set(metrics(messages, "DBIRTH", each))
        assert loop.run(device.image())["edge_node"]["devices"][name]["setpoint"] == 42.5
