"""What ``otmcp init`` takes for a proof, and what not: small adapters that are nearly right."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from pytest_otmcp.soundness.warm_start import WarmStart
from pytest_otmcp.subject import Adapter, load_subject
from pytest_otmcp.subject.answers import extract, read_answer

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

# The names of its arguments say nothing, and the likeliest one is misleading.
WORDS = """
import os
from mcp.server import MCPServer
from pymodbus.client import ModbusTcpClient

server = MCPServer("words")


def connected() -> ModbusTcpClient:
    client = ModbusTcpClient(os.environ["PLC_HOST"], port=int(os.environ["PLC_PORT"]), retries=0)
    client.connect()
    return client


@server.tool()
def get_word(number: int, how_many: int) -> dict[str, list[int]]:
    return {"words": connected().read_holding_registers(number, count=how_many, device_id=1).registers}


@server.tool()
def put_word(content: int, place: int) -> dict[str, bool]:
    return {"done": not connected().write_register(place, content, device_id=1).isError()}


server.run()
"""

# Its calls wait for messages, and one of them gives the last message only; the broker is an entry of its configuration.
INBOX = """
import os
from typing import Any
import paho.mqtt.client as paho
from mcp.server import MCPServer

server = MCPServer("inbox")
received = []
client = paho.Client(paho.CallbackAPIVersion.VERSION2)
client.on_message = lambda *told: received.append({"topic": told[2].topic, "payload": told[2].payload.decode()})


def connected() -> paho.Client:
    if not client.is_connected():
        client.connect(os.environ["BROKER"], int(os.environ["BROKER_PORT"]))
        client.loop_start()
    return client


@server.tool()
def subscribe(topic: str) -> dict[str, Any]:
    connected().subscribe(topic)
    return {"subscribed": topic}


@server.tool()
def unsubscribe(topic: str) -> dict[str, Any]:
    connected().unsubscribe(topic)
    return {"unsubscribed": topic}


@server.tool()
def get_messages(topic: str | None = None) -> dict[str, Any]:
    return {"messages": [one for one in received if topic in (None, one["topic"])]}


server.run()
"""


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

# Its answers have the shapes of public servers, by the variable SHAPE; it asks the server for each node that it is told.
NODES = """
import json
import os
from typing import Any
from asyncua import Client
from mcp.server import MCPServer

server = MCPServer("nodes")


async def held(node: str) -> Any:
    async with Client(os.environ["PLANT"]) as client:
        return await client.get_node(node).get_value()


@server.tool(structured_output=False)
async def read_opcua_node(node_id: str) -> str:
    value = await held(node_id)
    match os.environ["SHAPE"]:
        case "member":
            return json.dumps({"values": {node_id: value}}, default=str)
        case "prose":
            return f"Node {node_id} value: {value}"
        case "unit":
            return f"Node {node_id} value: {value} bar"
        case "rounded":
            return json.dumps({"value": float(value) if isinstance(value, int) else value}, default=str)
        case "doubles":
            if not isinstance(value, float):
                raise TypeError(f"{type(value).__name__} cannot be read")
            return f"{value}"
        case "first":
            return f"Node {node_id} value: {await held('ns=2;s=Temperature')}"
    raise ValueError(os.environ["SHAPE"])


server.run()
"""

# Written by hand for an earlier draft of MCP: each of its answers has a content block of the type "json", or is an error.
DRAFT = """
import json
import os
import sys
from pymodbus.client import ModbusTcpClient

client = ModbusTcpClient(os.environ["PLC_HOST"], port=int(os.environ["PLC_PORT"]), retries=0)
names = ("read_holding_registers", "read_input_registers")
schema = {"type": "object", "properties": {"address": {"type": "integer"}, "count": {"type": "integer"}}}
schema["required"] = list(schema["properties"])
writes = {"type": "object", "properties": {"address": {"type": "integer"}, "value": {"type": "integer"}}}
for line in sys.stdin:
    message, content = json.loads(line), None
    match message["method"]:
        case "initialize":
            info = {"name": "draft", "version": "0.1"}
            content = {"protocolVersion": "2025-11-25", "capabilities": {"tools": {}}, "serverInfo": info}
        case "tools/list":
            tools = [{"name": name, "inputSchema": schema} for name in names]
            content = {"tools": [*tools, {"name": "write_register", "inputSchema": writes}]}
        case "tools/call":
            asked = message["params"]["arguments"]
            client.connect()
            if "value" in asked:
                found = client.write_register(asked["address"], asked["value"], device_id=1)
            else:
                read = getattr(client, message["params"]["name"])
                found = read(asked["address"], count=asked["count"], device_id=1)
            content = {"content": [{"type": "json", "json": {"values": getattr(found, "registers", [])}}]}
    if "id" in message:
        answer = {"result": content}
        if content is None or (message["method"] == "tools/call" and "ERRORS" in os.environ):
            answer = {"error": {"code": -32602, "message": "Invalid tools/call result: [ {type} ]"}}
        print(json.dumps({"jsonrpc": "2.0", "id": message["id"], **answer}), flush=True)
"""

# Its tool for writing takes registers of one table and a setpoint's name for an address: whatever it is told, it writes register 12.
SETPOINT = """
import os
from mcp.server import MCPServer
from pymodbus.client import ModbusTcpClient

server = MCPServer("setpoint")
client = ModbusTcpClient(os.environ["PLC_HOST"], port=int(os.environ["PLC_PORT"]), retries=0)


@server.tool(structured_output=False)
def read_holding_registers(address: int, count: int) -> str:
    client.connect()
    found = client.read_holding_registers(address, count=count, device_id=1)
    if found.isError():
        raise ValueError(str(found))
    signed = [word - 0x10000 if word >= 0x8000 and "SIGNED" in os.environ else word for word in found.registers]
    return f"{count} registers: {signed}"


@server.tool(structured_output=False)
def set_register(address: int, value: int) -> str:
    client.connect()
    if "REFUSES" in os.environ and address != 12:
        raise ValueError("register 12 is the only one")
    client.write_register(12, value, device_id=1)
    return "written"


server.run()
"""

# It has to be told where the device is by a tool, in other words than most.
STEPS = """
import os
from mcp.server import MCPServer
from pymodbus.client import ModbusTcpClient

server = MCPServer("steps")
devices = {}


def read(device: str, address: int, count: int) -> str:
    found = devices[device].read_holding_registers(address, count=count, device_id=1)
    if found.isError():
        raise ValueError(str(found))
    return str(found.registers)


if os.environ["STEP"] == "register":

    @server.tool(structured_output=False)
    def add_device(device_id: str, ip_address: str, port: int) -> str:
        devices[device_id] = ModbusTcpClient(ip_address, port=port, retries=0)
        return "added"

    @server.tool(structured_output=False)
    def read_holding_registers(device: str, address: int, count: int) -> str:
        devices[device].connect()
        return read(device, address, count)

else:

    @server.tool(structured_output=False)
    def connect_plc(address: str, licence: str = "") -> str:
        host, _, port = address.partition(":")
        devices[""] = ModbusTcpClient(host, port=int(port), retries=0)
        if os.environ["STEP"] == "refused" or not devices[""].connect():
            raise ValueError("no licence")
        return "connected"

    @server.tool(structured_output=False)
    def read_holding_registers(address: int, count: int) -> str:
        return read("", address, count)


server.run()
"""

# Its likeliest tool fails with the first calls of a session.
COLD = """
import os
from mcp.server import MCPServer
from pymodbus.client import ModbusTcpClient

server = MCPServer("cold")
client = ModbusTcpClient(os.environ["PLC_HOST"], port=int(os.environ["PLC_PORT"]), retries=0)
failing = int(os.environ["FAILING"])


@server.tool()
def read_input_registers(address: int, count: int) -> dict[str, list[int]]:
    global failing
    failing -= 1
    if failing >= 0:
        raise TimeoutError("no answer in time")
    client.connect()
    return {"values": client.read_input_registers(address, count=count, device_id=1).registers}


@server.tool()
def read_input_registers_of_block(address: int, count: int) -> dict[str, list[int]]:
    client.connect()
    return {"values": client.read_input_registers(address, count=count, device_id=1).registers}


server.run()
"""

Init = Callable[..., tuple[str, Adapter]]


def started(
    directory: Path, warm_start: WarmStart, protocol: str, source: str, **env: str
) -> subprocess.CompletedProcess[str]:
    (directory / "adapter.py").write_text(source, encoding="utf-8")
    variables = [part for name, value in env.items() for part in ("--env", f"{name}={value}")]
    return subprocess.run(
        [
            *(sys.executable, "-m", "pytest_otmcp.cli", "init", "--protocol", protocol),
            *(*variables, "--", *warm_start.python, "adapter.py"),
        ],
        cwd=directory,
        capture_output=True,
        text=True,
        timeout=180,
        check=False,
    )


@pytest.fixture
def init(tmp_path: Path, warm_start: WarmStart) -> Init:
    """``init(protocol, source, **env)``: what ``otmcp init`` says about an adapter, and the adapter of its file."""

    def run(protocol: str, source: str, **env: str) -> tuple[str, Adapter]:
        done = started(tmp_path, warm_start, protocol, source, **env)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout, load_subject(tmp_path / "otmcp.toml").adapters[protocol]

    return run


@pytest.mark.long
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
    assert adapter.unclaimed == {
        "subscribe": "receives by a call that waits",
        "guard": "otmcp init does not know how writes are disabled",
        **dict.fromkeys(("info", "device_birth", "device_data"), "otmcp init found no tool for it"),
    }
    # Neither the entry's name nor an address for it was invented, and what would only be a dry run is said to be none.
    (publish,) = adapter.operations["publish"]
    sent = {"topic": "a", "payload": "b", "qos": 0}
    assert publish.fill(sent, {}) == {**sent, "dry_run": False}


@pytest.mark.long
def test_a_topic_that_is_no_filter_is_left_out(init: Init) -> None:
    told, adapter = init("mqtt", INBOX, BROKER="{host}", BROKER_PORT="{port}")
    assert "messages        get_messages (proven" in told
    assert "unsubscribe     unsubscribe (proven" in told
    (messages,) = adapter.operations["messages"]
    assert messages.arguments == {}


@pytest.fixture
def read_of(init: Init) -> Callable[[str], tuple[str, Adapter]]:
    return lambda shape: init("opcua", NODES, PLANT="{url}", SHAPE=shape)


def text(message: str) -> dict[str, object]:
    return {"result": {"content": [{"type": "text", "text": message}]}}


def read(adapter: Adapter, node: str, message: str) -> object:
    """Return what the proposed binding reads in the answer about a node."""
    (binding,) = adapter.operations["read"]
    form = binding.answering.form
    return extract(binding.outputs_for({"node": node}), read_answer(text(message), form)[0])["value"]


@pytest.mark.long
def test_a_node_that_was_tried_is_no_part_of_a_path(read_of: Callable[[str], tuple[str, Adapter]]) -> None:
    told, adapter = read_of("member")
    assert "read            read_opcua_node (proven: the device saw a Read of the node)" in told
    assert adapter.operations["read"][0].outputs["value"].path == 'values."$node"'
    assert read(adapter, "ns=2;s=Pressure", '{"values": {"ns=2;s=Pressure": 1.5}}') == 1.5


@pytest.mark.long
def test_a_sentence_is_read_whatever_the_type_of_its_value_is(read_of: Callable[[str], tuple[str, Adapter]]) -> None:
    told, adapter = read_of("prose")
    assert "read            read_opcua_node (proven: the device saw a Read of the node)" in told
    for said, value in (
        ("True", True),
        ("25.0", 25.0),
        ("9007199254740993", "9007199254740993"),
        ("2026-11-22 12:00:00", "2026-11-22 12:00:00"),
        ("[1, -2, 3]", [1, -2, 3]),
        (" tank 7, empty ", " tank 7, empty "),
    ):
        assert read(adapter, "ns=2;s=Other", f"Node ns=2;s=Other value: {said}") == value


@pytest.mark.long
def test_a_pattern_that_reads_some_types_only_is_no_binding(read_of: Callable[[str], tuple[str, Adapter]]) -> None:
    told, adapter = read_of("unit")
    assert "read            read_opcua_node (asked, but not read: the device saw a Read of the node; what reads" in told
    assert "of two words bar'" in told
    assert "read: where value is in the answer of 'read_opcua_node'" in told
    assert "read" not in adapter.operations


@pytest.mark.long
def test_a_place_that_takes_everything_is_right_where_the_adapter_is_wrong(
    read_of: Callable[[str], tuple[str, Adapter]], tmp_path: Path
) -> None:
    told, adapter = read_of("rounded")
    assert (
        "read            read_opcua_node (proven: the device saw a Read of the node; not everything, see the file)"
        in told
    )
    assert adapter.operations["read"][0].outputs["value"].path == "value"
    written = (tmp_path / "otmcp.toml").read_text(encoding="utf-8")
    assert re.search(
        r"# not proven: with node ns=2;s=Otmcp.UInt64.\w+ the device holds (\d+), and the answer says (?!\1\b)", written
    )


@pytest.mark.long
def test_a_type_that_a_tool_refuses_says_nothing_about_the_others(
    read_of: Callable[[str], tuple[str, Adapter]], tmp_path: Path
) -> None:
    told, adapter = read_of("doubles")
    assert (
        "read            read_opcua_node (proven: the device saw a Read of the node; not everything, see the file)"
        in told
    )
    assert read(adapter, "ns=2;s=Pressure", "1.5") == 1.5
    written = (tmp_path / "otmcp.toml").read_text(encoding="utf-8")
    assert re.search(
        r"# not proven: with node ns=2;s=Otmcp.Boolean.*; node ns=2;s=Otmcp.String.*: it failed: 'Error executing",
        written,
    )


@pytest.mark.long
def test_a_tool_that_answers_for_one_node_alone_is_no_binding(read_of: Callable[[str], tuple[str, Adapter]]) -> None:
    told, adapter = read_of("first")
    assert (
        "read            read_opcua_node (asked, but not read: the device saw a Read of the node; no one place" in told
    )
    assert "read" not in adapter.operations


@pytest.mark.long
def test_values_that_are_wrong_are_the_adapters_where_their_place_is_right(init: Init, tmp_path: Path) -> None:
    told, adapter = init("modbus", SETPOINT, PLC_HOST="{host}", PLC_PORT="{port}", SIGNED="1")
    assert "quantity 3; not everything, see the file)" in told
    assert "read_holding" in adapter.operations
    assert (
        "# not proven: with address 90, count 4 the device holds [0, 65535, 32768, 1], and the answer says [0, -1, -32768, 1]"
        in (tmp_path / "otmcp.toml").read_text(encoding="utf-8")
    )


@pytest.mark.long
@pytest.mark.parametrize(("failing", "tool"), [(1, "read_input_registers"), (1000, "read_input_registers_of_block")])
def test_the_first_call_may_fail_and_of_a_likelier_tool_the_file_says_why_it_was_not_taken(
    init: Init, tmp_path: Path, failing: int, tool: str
) -> None:
    told, _ = init("modbus", COLD, PLC_HOST="{host}", PLC_PORT="{port}", FAILING=str(failing))
    assert re.search(rf"^  read_input +{tool} \(proven: ", told, re.MULTILINE), told
    reason = "# tried before: read_input_registers: the device saw nothing of it; it failed: "
    assert (reason in (tmp_path / "otmcp.toml").read_text(encoding="utf-8")) == (failing > 1)


@pytest.mark.long
def test_which_argument_is_which_the_device_decides(init: Init) -> None:
    told, adapter = init("modbus", WORDS, PLC_HOST="{host}", PLC_PORT="{port}")
    (read,), (write,) = adapter.operations["read_holding"], adapter.operations["write_holding"]
    assert (read.tool, read.arguments) == ("get_word", {"number": "$address", "how_many": "$count"})
    assert (write.tool, write.arguments) == ("put_word", {"content": "$value", "place": "$address"})
    assert "'get_word' is read_holding, so it is declared as unclaimed" in told
    assert adapter.unclaimed["read_input"] == "otmcp init found no tool for it"


@pytest.mark.long
def test_a_device_that_a_tool_registers_is_read_by_its_name(init: Init) -> None:
    told, adapter = init("modbus", STEPS, STEP="register")
    assert adapter.connect is not None
    assert adapter.connect.tool == "add_device"
    assert adapter.connect.arguments == {"device_id": "otmcp", "ip_address": "{host}", "port": "{port:int}"}
    assert "read_holding    read_holding_registers (proven" in told
    (binding,) = adapter.operations["read_holding"]
    assert binding.arguments == {"device": "otmcp", "address": "$address", "count": "$count"}


@pytest.mark.long
def test_a_step_whose_argument_may_mean_several_things_is_tried_until_the_device_is_reached(init: Init) -> None:
    told, adapter = init("modbus", STEPS, STEP="connect")
    assert "connect         connect_plc (the device was reached)" in told
    assert adapter.connect is not None
    assert adapter.connect.arguments == {"address": "{host}:{port}"}
    assert "read_holding    read_holding_registers (proven" in told


@pytest.mark.long
def test_a_step_that_fails_is_the_reason_why_there_is_no_proposal(tmp_path: Path, warm_start: WarmStart) -> None:
    done = started(tmp_path, warm_start, "modbus", STEPS, STEP="refused")
    assert done.returncode == 1
    told = " ".join(done.stderr.replace("|", " ").split())
    assert "nothing reached the mock device, and nothing was written; connect: with " in told
    for address in ("{host}:{port}", "{url}", "{host}"):
        assert f'with {{"address": "{address}"}} the connect step \'connect_plc\' failed: Error executing tool' in told
    assert not (tmp_path / "otmcp.toml").exists()


@pytest.mark.long
def test_a_write_is_proven_at_several_addresses(init: Init) -> None:
    told, adapter = init("modbus", SETPOINT, PLC_HOST="{host}", PLC_PORT="{port}")
    assert (
        "read_holding    read_holding_registers (proven: the device saw function 3 for address 10, quantity 3)" in told
    )
    assert re.search(
        r"write_holding   set_register \(not proven: the device saw function 6 for address 12, .*, but with address \d+, value \d+ "
        r"the device was not told it, although it answered: 'written'\)",
        told,
    )
    assert "write_holding" not in adapter.operations


@pytest.mark.long
def test_a_write_that_is_refused_elsewhere_is_proven_where_it_is_not(init: Init, tmp_path: Path) -> None:
    told, adapter = init("modbus", SETPOINT, PLC_HOST="{host}", PLC_PORT="{port}", REFUSES="1")
    assert "write_holding   set_register (proven: the device saw function 6 for address 12" in told
    assert "; not everything, see the file)" in told
    written = (tmp_path / "otmcp.toml").read_text(encoding="utf-8")
    assert re.search(
        r"# not proven: with address \d+, value \d+ the device was not told it; it failed: 'Error executing", written
    )
    assert "write_holding" in adapter.operations


@pytest.mark.parametrize("fault", ["block", "error"])
def test_answers_that_are_no_valid_mcp_prove_nothing_and_are_said_to_be_none(
    init: Init, tmp_path: Path, fault: str
) -> None:
    told, adapter = init(
        "modbus", DRAFT, PLC_HOST="{host}", PLC_PORT="{port}", **({"ERRORS": "1"} if fault == "error" else {})
    )
    said = {
        "block": "a content block of the type 'json', which MCP does not know",
        "error": "error -32602 instead of a result: 'Invalid tools/call result: [ {type} ]'",
    }[fault]
    assert (
        f"  - no answer of this server to a tool call is valid MCP ({said}): nothing can be proven until it is mended"
        in told
    )
    assert (
        f"read_holding_registers (not proven: the device saw function 3 for address 10, quantity 3, but the answer is no valid MCP: {said})"
        in told
    )
    assert "(proven" not in told
    assert "# proven" not in (tmp_path / "otmcp.toml").read_text(encoding="utf-8")
    assert not adapter.operations
