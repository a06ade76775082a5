"""What ``otmcp init`` takes for a proof, and what not: small adapters that are nearly right."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from pytest_otmcp.soundness.warm_start import WarmStart
from pytest_otmcp.subject import Adapter, load_subject

# It asks the device for its state, and may say the same whatever came of it.
STATUS = """
import os
from mcp.server import MCPServer
from pymodbus.client import ModbusTcpClient

server = MCPServer("status")
client = ModbusTcpClient(os.environ["PLC_HOST"], port=int(os.environ["PLC_PORT"]), retries=0)


def found() -> bool:
    try:
        return client.connect() and not client.read_holding_registers(0, count=1, device_id=1).isError()
    except Exception:
        return False


@server.tool()
def connection_status() -> dict[str, bool]:
    return {"success": True, "connected": found() or "ALWAYS" in os.environ}


@server.tool()
def mtconnect_ping() -> dict[str, bool]:
    return {"connected": found()}


server.run()
"""

# Its calls wait for messages, and one of them gives the last message only; the broker is an entry of its configuration.
WAITING = """
import os
import time
from typing import Any
import paho.mqtt.client as paho
from mcp.server import MCPServer

server = MCPServer("waiting")


def collected(topic: str, timeout: int, endpoint: str) -> list[dict[str, str]]:
    if endpoint != "main":
        raise ValueError(f"no endpoint {endpoint!r}")
    received = []
    client = paho.Client(paho.CallbackAPIVersion.VERSION2)
    client.on_message = lambda *told: received.append({"topic": told[2].topic, "payload": told[2].payload.decode()})
    client.on_connect = lambda *told: client.subscribe(topic)
    client.connect(os.environ["BROKER"], int(os.environ["BROKER_PORT"]))
    until = time.monotonic() + timeout
    while time.monotonic() < until:
        client.loop(0.05)
    client.disconnect()
    return received


@server.tool()
def read_message(topic: str, timeout: int = 1, endpoint: str = "main") -> dict[str, Any]:
    return {"messages": collected(topic, timeout, endpoint)[-1:]}


@server.tool()
def mqtt_subscribe(topic: str, timeout: int = 1, endpoint: str = "main") -> dict[str, Any]:
    return {"messages": collected(topic, timeout, endpoint)}


@server.tool()
def mqtt_publish(topic: str, payload: str, qos: int = 0, endpoint: str = "main", dry_run: bool = True) -> dict[str, Any]:
    if not dry_run:
        client = paho.Client(paho.CallbackAPIVersion.VERSION2)
        client.connect(os.environ["BROKER"], int(os.environ["BROKER_PORT"]))
        client.loop_start()
        sent = client.publish(topic, payload, qos)
        sent.wait_for_publish(2)
        client.disconnect()
    return {"published": not dry_run}


server.run()
"""

Init = Callable[..., tuple[str, Adapter]]


@pytest.fixture
def init(tmp_path: Path, warm_start: WarmStart) -> Init:
    """``init(protocol, source, **env)``: what ``otmcp init`` says about an adapter, and the adapter of its file."""

    def run(protocol: str, source: str, **env: str) -> tuple[str, Adapter]:
        (tmp_path / "adapter.py").write_text(source, encoding="utf-8")
        variables = [part for name, value in env.items() for part in ("--env", f"{name}={value}")]
        done = subprocess.run(
            [
                *(sys.executable, "-m", "pytest_otmcp.cli", "init", "--protocol", protocol),
                *(*variables, "--", *warm_start.python, "adapter.py"),
            ],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=180,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout, load_subject(tmp_path / "otmcp.toml").adapters[protocol]

    return run


def test_a_status_is_proven_by_what_it_says_while_the_device_is_gone(init: Init) -> None:
    told, adapter = init("modbus", STATUS, PLC_HOST="{host}", PLC_PORT="{port}")
    assert "ping            connection_status (proven: the device saw an exchange)" in told
    (ping,) = adapter.operations["ping"]
    assert ping.outputs["reachable"].path == "connected"


def test_a_status_that_says_the_same_while_the_device_is_gone_is_not_proven(init: Init) -> None:
    told, adapter = init("modbus", STATUS, PLC_HOST="{host}", PLC_PORT="{port}", ALWAYS="yes")
    words = json.dumps({"success": True, "connected": True})
    assert (
        "ping            connection_status (not proven: with the device gone it says nothing of that: it answered"
        in told
    )
    assert words.replace(" ", "") in told.replace(" ", "")
    # The tool whose name is that of another protocol was not tried.
    assert "ping" not in adapter.operations


@pytest.mark.long
def test_a_tool_that_gives_the_last_message_only_is_no_inbox(init: Init) -> None:
    told, adapter = init("mqtt", WAITING, BROKER="{host}", BROKER_PORT="{port}")
    assert "subscribe       mqtt_subscribe (not proven: no subscription for later" in told
    assert "messages        mqtt_subscribe (proven" in told
    (messages,) = adapter.operations["messages"]
    assert (messages.blocking, messages.fill({"filter": "a/#", "seconds": 3}, {})) == (
        True,
        {"topic": "a/#", "timeout": 3},
    )
    assert adapter.unclaimed == {"subscribe": "receives by a call that waits"}
    # Neither the entry's name nor an address for it was invented, and what would only be a dry run is said to be none.
    (publish,) = adapter.operations["publish"]
    sent = {"topic": "a", "payload": "b", "qos": 0}
    assert publish.fill(sent, {}) == {**sent, "dry_run": False}
