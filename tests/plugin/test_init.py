"""``otmcp init`` and ``otmcp doctor`` as a vendor uses them: real adapters, real mocks, from an empty directory."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from pytest_otmcp.cli import main
from pytest_otmcp.cli.init import recognise_protocol
from pytest_otmcp.core.errors import UsageError
from pytest_otmcp.protocols.own import OWN
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.soundness.warm_start import WarmStart
from pytest_otmcp.subject import Adapter, load_subject

FOREIGN = Path(__file__).parents[1] / "soundness" / "foreign.py"
OTMCP = [sys.executable, "-m", "pytest_otmcp.cli"]

# A typical adapter: two tools, answers in prose, isError always false, one-based addresses.
PROSE = '''
import os
from mcp.server import MCPServer
from pymodbus.client import ModbusTcpClient

server = MCPServer("prose")
client = ModbusTcpClient(os.environ["PLC_HOST"], port=int(os.environ["PLC_PORT"]), retries=0)


@server.tool(structured_output=False)
def get_holding_registers(start: int, quantity: int) -> str:
    """Read holding registers."""
    client.connect()
    answer = client.read_holding_registers(start - 1, count=quantity, device_id=1)
    return f"Error: {answer}" if answer.isError() else f"The registers are {answer.registers}"


@server.tool(structured_output=False)
def set_register(register: int, value: int) -> str:
    """Write a holding register."""
    client.connect()
    try:
        answer = client.write_register(register - 1, value, device_id=1)
    except Exception as error:
        return f"Error: {error}"
    return f"Error: {answer}" if answer.isError() else "done"


server.run()
'''

# A server on an old SDK: it ends at a request that it does not know before "initialize", or with an argument more it waits
# for that for ever. Its address comes from a file, beside which it says how each of its processes was first addressed.
OLD = """
import json
import sys
from pathlib import Path
from pymodbus.client import ModbusTcpClient

host, port = Path(sys.argv[1]).read_text().split()
addressed = False
client = ModbusTcpClient(host, port=int(port), retries=0)
schema = {"type": "object", "properties": {"address": {"type": "integer"}, "count": {"type": "integer"}}}
schema["required"] = list(schema["properties"])
greeted = False
for line in sys.stdin:
    message = json.loads(line)
    if not addressed:
        addressed = True
        with open("addressed", "a") as log:
            log.write(message["method"] + " ")
    if message["method"] == "initialize":
        greeted = True
        info = {"name": "old", "version": "1.9.4"}
        result = {"protocolVersion": "2024-11-05", "capabilities": {"tools": {}}, "serverInfo": info}
    elif not greeted and sys.argv[2:]:
        continue
    elif not greeted:
        sys.exit("received a request before initialization was complete")
    elif message["method"] == "tools/list":
        result = {"tools": [{"name": "read_holding_registers", "inputSchema": schema}]}
    elif message["method"] == "tools/call":
        asked = message["params"]["arguments"]
        client.connect()
        found = client.read_holding_registers(asked["address"], count=asked["count"], device_id=1)
        text = json.dumps({"error": str(found)} if found.isError() else {"registers": found.registers})
        result = {"content": [{"type": "text", "text": text}]}
    else:
        continue
    print(json.dumps({"jsonrpc": "2.0", "id": message["id"], "result": result}), flush=True)
"""

Otmcp = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def otmcp(tmp_path: Path) -> Otmcp:
    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [*OTMCP, *arguments], cwd=tmp_path, capture_output=True, text=True, timeout=180, check=False
        )

    return run


Proposed = Callable[..., tuple[str, Adapter]]


@pytest.fixture
def proposed(otmcp: Otmcp, tmp_path: Path, warm_start: WarmStart) -> Proposed:
    """Return what ``otmcp init`` prints about a script, and the adapter that it describes; the script is told host and port by variables."""

    def run(script: str, protocol: str, prefix: str, *options: str) -> tuple[str, Adapter]:
        (tmp_path / "adapter.py").write_text(script, encoding="utf-8")
        places = ("--env", f"{prefix}_HOST={{host}}", "--env", f"{prefix}_PORT={{port}}")
        done = otmcp("init", *options, "--protocol", protocol, *places, "--", *warm_start.python, "adapter.py")
        assert done.returncode == 0, done.stderr
        return done.stdout, load_subject(tmp_path / "otmcp.toml").adapters[protocol]

    return run


@pytest.mark.long
def test_a_prose_adapter_is_described_by_what_the_device_saw(
    otmcp: Otmcp, tmp_path: Path, warm_start: WarmStart
) -> None:
    (tmp_path / "prose.py").write_text(PROSE, encoding="utf-8")
    launch = (
        "--protocol",
        "modbus",
        "--env",
        "PLC_HOST={host}",
        "--env",
        "PLC_PORT={port}",
        "--",
        *warm_start.python,
        "prose.py",
    )
    done = otmcp("init", *launch)
    assert done.returncode == 0, done.stderr
    assert "read_holding    get_holding_registers (proven: the device saw function 3 for address 10" in done.stdout
    assert "ping (is the device reachable): no tool was found" in done.stdout
    adapter = load_subject(tmp_path / "otmcp.toml").adapters["modbus"]
    (read,), (write,) = adapter.operations["read_holding"], adapter.operations["write_holding"]
    assert read.fill({"address": 0, "count": 4}, {}) == {"start": 1, "quantity": 4}
    assert write.fill({"address": 0, "value": 7}, {}) == {"register": 1, "value": 7}
    assert adapter.answering.form == "text"
    assert [rule.success for rule in adapter.answering.outcome] == [False]
    assert "illegal_address" in [rule.code for rule in adapter.answering.errors]
    assert adapter.variants["rw"].command[-1] == "{dir}/prose.py"
    first = (tmp_path / "otmcp.toml").read_text(encoding="utf-8").splitlines()[0]
    assert (
        json.loads(Path(first.removeprefix("#:schema ")).read_text(encoding="utf-8"))["$id"] == "urn:otmcp:subject-file"
    )
    assert adapter.unclaimed == {
        "guard": "otmcp init does not know how writes are disabled",
        "ping": "otmcp init found no tool for it",
        "read_input": "otmcp init found no tool for it",
    }


# It connects in the background, and until then refuses whatever it is asked for.
BACKGROUND = "import time\n" + PROSE.replace(
    "    client.connect()\n",
    "    if not connected():\n        return 'Error: still connecting'\n    client.connect()\n",
).replace(
    "server.run()\n",
    """started = time.monotonic()


def connected() -> bool:
    return time.monotonic() > started + 0.5


@server.tool(structured_output=False)
def connection_status() -> str:
    return f"state: {'connected' if connected() else 'connecting'}"


server.run()
""",
)


@pytest.mark.long
def test_an_adapter_that_connects_in_the_background_is_waited_for(proposed: Proposed) -> None:
    told, adapter = proposed(BACKGROUND, "modbus", "PLC")
    assert "ready           connection_status (it said 'state: connecting' at first)" in told
    assert "write_holding   set_register (proven" in told
    ready = adapter.ready
    assert ready is not None
    assert (ready.tool, ready.answering.outcome[0].text) == ("connection_status", "(?m)^state: connected$")


# It opens its connection when it starts, and never again.
ONCE = """
import os, socket, struct
from mcp.server import MCPServer

server = MCPServer("once")
plc = socket.create_connection((os.environ["PLC_HOST"], int(os.environ["PLC_PORT"])))


@server.tool(structured_output=False)
def read_holding_registers(address: int, count: int) -> str:
    plc.sendall(struct.pack(">HHHBBHH", 1, 0, 6, 1, 3, address, count))
    answer = plc.recv(300)
    if not answer:
        raise ConnectionError("the connection was lost")
    if answer[7] & 0x80:
        raise ValueError(f"exception code {answer[8]}")
    return str(list(struct.unpack(f">{count}H", answer[9:])))


server.run()
"""


@pytest.mark.long
def test_an_adapter_that_needs_a_new_session_after_an_outage_is_described_so(proposed: Proposed) -> None:
    told, adapter = proposed(ONCE, "modbus", "PLC")
    assert "recovery        new_session (after the device was away nothing else helped)" in told
    assert adapter.recovery == "new_session"


# A value that does not fit leaves it unable to answer anything in that session, whether or not its device is there.
HANGS = "import time\n" + PROSE.replace(
    """def set_register(register: int, value: int) -> str:
    \"\"\"Write a holding register.\"\"\"
""",
    """async def set_register(register: int, value: int) -> str:
    \"\"\"Write a holding register.\"\"\"
    while value > 65535:
        time.sleep(1)
""",
)


@pytest.mark.long
def test_what_a_bad_argument_did_to_a_session_is_not_taken_for_what_an_outage_does(proposed: Proposed) -> None:
    told, adapter = proposed(HANGS, "modbus", "PLC")
    assert "write_holding   set_register (proven" in told
    assert adapter.recovery == "same_session"


# Writes have to be allowed, and the tool that writes is not listed before.
GUARDED = PROSE.replace(
    """@server.tool(structured_output=False)
def set_register(register: int, value: int) -> str:
""",
    """def set_register(register: int, value: int) -> str:
""",
).replace(
    "server.run()",
    """if os.environ.get("PLC_WRITES") == "1":
    server.tool(structured_output=False)(set_register)
server.run()""",
)


@pytest.mark.parametrize("usually", ["refused", pytest.param("allowed", marks=pytest.mark.long)])
def test_what_disables_writes_is_found_in_the_program_and_proven(proposed: Proposed, usually: str) -> None:
    script = GUARDED if usually == "refused" else GUARDED.replace('get("PLC_WRITES") ==', 'get("PLC_READ_ONLY") !=')
    told, adapter = proposed(script, "modbus", "PLC")
    name = "PLC_WRITES" if usually == "refused" else "PLC_READ_ONLY"
    assert "write_holding   set_register (proven" in told
    assert f"guard           {name} (proven: it disables writes, and enables them)" in told
    assert adapter.variants["ro"].env[name] == ("0" if usually == "refused" else "1")
    assert adapter.variants["rw"].env[name] == ("1" if usually == "refused" else "0")
    assert "guard" not in adapter.unclaimed


# A vocabulary of its own, and no tool that reads what the kit knows.
LAMP = """
import json, os
from mcp.server import MCPServer
from paho.mqtt.client import Client, CallbackAPIVersion

server = MCPServer("lamp")
client = Client(CallbackAPIVersion.VERSION2)
client.connect(os.environ["MQTT_HOST"], int(os.environ["MQTT_PORT"]))
client.loop_start()


def tell(topic: str, **members: object) -> str:
    client.publish(topic, json.dumps(members), qos=1).wait_for_publish(2)
    return "ok"


@server.tool(structured_output=False)
def set_brightness(lamp: str, level: float) -> str:
    \"\"\"Set the brightness, 0.0-1.0.\"\"\"
    return tell(f"home/{lamp}/set", brightness=round(level * 254))


@server.tool(structured_output=False)
def turn_heating(on: bool) -> str:
    return tell("home/heating/set", state="ON" if on else "OFF")


@server.tool(structured_output=False)
def trigger_show(length: int) -> str:
    tell("home/show", step=1)
    return tell("home/show", step=2)


@server.tool(structured_output=False)
def delete_device(name: str) -> str:
    return tell("home/devices/delete", name=name)


def note(what: str) -> str:
    with open("noted", "a") as log:
        log.write(what + " ")
    return "ok"


@server.tool(structured_output=False)
def say_aloud(text: str, loud: bool = False) -> str:
    return note("said")


@server.tool(structured_output=False)
def run_script(name: str) -> str:
    return note("ran")


server.run()
"""


def test_tools_of_another_vocabulary_are_proposed_with_the_effect_that_the_device_saw(
    proposed: Proposed, tmp_path: Path
) -> None:
    # What the adapter notes in its folder would be gone with it behind walls.
    _, adapter = proposed(LAMP, "mqtt", "MQTT", "--isolation=off")
    found = {binding.tool: binding.command for binding in adapter.operations["publish"]}
    # What tells the device nothing, or two things at once, is called once; what acts elsewhere, or on the adapter itself, never.
    assert (tmp_path / "noted").read_text() == "said "
    assert found.keys() == {"set_brightness", "turn_heating"}
    dimmed, heated = found["set_brightness"], found["turn_heating"]
    assert dimmed is not None
    assert heated is not None
    assert dimmed.effect == {"topic": "home/$lamp/set", "payload": {"brightness": "$level"}}
    assert dimmed.draws["level"].means == (0, 64, 127, 254)
    assert heated.effect == {"topic": "home/heating/set", "payload": {"state": "$on"}}
    assert "publish" not in adapter.unclaimed


PLANT = """
import asyncio
import os
import struct
from typing import Literal
from mcp.server import MCPServer
from pymodbus.client import AsyncModbusTcpClient

server = MCPServer("plant")

async def held(address, count, table="holding_registers"):
    client = AsyncModbusTcpClient(os.environ["PLC_HOST"], port=int(os.environ["PLC_PORT"]), timeout=1, retries=0)
    try:
        if not await client.connect():
            raise RuntimeError("could not connect")
        answer = await getattr(client, f"read_{table}")(address, count=count)
        if answer.isError():
            raise RuntimeError(f"refused: {answer}")
        return answer.bits if table == "coils" else answer.registers
    finally:
        client.close()

@server.tool()
async def read_temperature(sensor: Literal["inlet", "outlet", "ambient"]) -> dict:
    (raw,) = await held({"inlet": 20, "outlet": 21, "ambient": 25}[sensor], 1, "input_registers")
    return {"sensor": sensor, "celsius": (raw - 65536 if raw > 32767 else raw) / 10}

@server.tool()
async def tank_level() -> str:
    (raw,) = await held(30, 1)
    return f"The tank is {raw / 276.48:.1f} % full."

@server.tool()
async def overview() -> dict:
    block = await held(40, 6)
    return {"bar": round(block[0] * 0.01, 2), "flow": block[2], "kwh": (block[5] << 16 | block[4]) / 100, "ok": True}

@server.tool()
async def pump_state() -> dict:
    bits = await held(7, 1, "coils")
    return {"state": "running" if bits[0] else "stopped"}

@server.tool()
async def operating_mode() -> str:
    (mode,) = await held(60, 1)
    return ["off", "heating", "cooling"][mode]

@server.tool()
async def power() -> dict:
    block = await held(70, 2)
    (kilowatts,) = struct.unpack(">f", struct.pack(">HH", block[1], block[0]))
    return {"kw": round(kilowatts, 2)}

@server.tool()
async def read_serial_number() -> str:
    await held(40, 6)
    return "4711"

server.run()
"""


@pytest.mark.long
def test_tools_that_read_under_names_of_their_own_are_proposed_with_the_place_that_they_follow(
    proposed: Proposed,
) -> None:
    _, adapter = proposed(PLANT, "modbus", "PLC")
    found = {command.name: (operation, command) for operation, command in adapter.vocabulary(readings=True)}
    assert found.keys() == {
        "read_temperature",
        "tank_level",
        "operating_mode",
        "power",
        "overview bar",
        "overview flow",
        "overview kwh",
        "pump_state",
    }
    rules = {
        case.command.name: rule
        for cases in adapter.operations.values()
        if isinstance(cases, tuple)
        for case in cases
        if case.command is not None
        for rule in case.outputs.values()
    }
    operation, temperature = found["read_temperature"]
    assert (operation, temperature.effect) == ("read_typed_input", {"address": "$sensor", "type": "int16"})
    assert temperature.draws["sensor"].means == (20, 21, 25)
    assert (rules["read_temperature"].path, rules["read_temperature"].means) == ("celsius", "$value * 10")
    assert found["overview kwh"][0] == "read_typed"
    assert found["overview kwh"][1].effect == {"address": 44, "type": "uint32", "byte_order": "CDAB"}
    assert (rules["overview bar"].means, rules["overview flow"].means) == ("$value * 100", None)
    assert found["power"][0] == "read_typed"
    assert found["power"][1].effect == {"address": 70, "type": "float32", "byte_order": "CDAB"}
    assert rules["operating_mode"].means == {"off": 0, "heating": 1, "cooling": 2}
    assert rules["pump_state"].means == {"running": True, "stopped": False}
    level = found["tank_level"][1].holds
    assert level is not None
    assert level.step > 13


QUICK = ("mqtt",)
DEVICES = """{"kit-device": {"vendor_id": "0ABC", "device_id": "0001", "modules": [
{"slot": 2, "module": "00000020", "submodule": "00000001", "outputs": 8}]}}"""
ENDPOINTS = {
    "mqtt": ["--env", "MQTT_URL={url}"],
    "opcua": ["--env", "OPCUA_URL={url}"],
    "profibus": [
        *(
            "--env",
            "PROFIBUS_SERIAL={serial}",
            "--env",
            "PROFIBUS_WATCHDOG_S=10",
            "--env",
            "PROFIBUS_SLAVE_MAP={work}/slaves.json",
        ),
        *("--file", 'slaves.json={"5": {"ident": "809C", "cfg": "11 21"}}'),
    ],
    "ethercat": ["--env", "ETHERCAT_INTERFACE={interface}", "--env", "ETHERCAT_WATCHDOG_S=2"],
    "profinet": [
        *("--env", "PROFINET_INTERFACE={interface}", "--env", "PROFINET_DEVICE_MAP={work}/devices.json"),
        *("--file", f"devices.json={DEVICES}"),
    ],
}
"""How an adapter is told where its device is that is not told host and port."""

PROVEN_ALTHOUGH_VOLUNTARY = {
    "modbus": {"read_coils", "read_discrete_inputs", "write_registers", "write_coil", "write_coils", "mask_write"},
    "opcua": {"write_many"},
    "mqtt": {"unsubscribe", "subscriptions", "sparkplug_metrics", "send_node_command", "send_device_command"},
    "profinet": {"read_record", "write_record"},
}
NOT_PROPOSED = {"s7": {"write_marker"}}
"""Operations that no tool of the reference adapter plainly matches: it writes a bit of a marker by a tool for any type."""


@pytest.mark.parametrize(
    "protocol",
    [
        pytest.param(name, marks=[pytest.mark.long, *[pytest.mark.weekly] * (number % 2 and name not in QUICK)])
        for number, name in enumerate(OWN)
    ],
)
def test_every_tool_of_a_reference_adapter_is_found_and_proven(
    otmcp: Otmcp, tmp_path: Path, warm_start: WarmStart, protocol: str
) -> None:
    name = protocol.upper()
    options = ENDPOINTS.get(protocol, ["--env", f"{name}_HOST={{host}}", "--env", f"{name}_PORT={{port}}"])
    settings = ("WRITES_ENABLED=true", "TIMEOUT_S=20", "DEADLINE_S=25")
    variables = (part for setting in settings for part in ("--env", f"{name}_{setting}"))
    adapter = ("--", *warm_start.python, "-m", "pytest_otmcp.reference_adapters", protocol)
    done = otmcp("init", *options, *variables, *adapter)
    assert done.returncode == 0, done.stderr
    assert "not proven" not in done.stdout
    assert "no tool found" not in done.stdout
    written = load_subject(tmp_path / "otmcp.toml").adapters[protocol]
    assert written.answering.native
    # What nobody has to have is proposed as well: proven where a call of it only reads, else as a comment.
    text = (tmp_path / "otmcp.toml").read_text(encoding="utf-8")
    operations = protocols()[protocol].operations
    proposed = {name for name in operations if f"[adapter.{protocol}.bind.{name}]" in text}
    assert proposed == set(operations) - NOT_PROPOSED.get(protocol, set())
    needed = {name for name, known in operations.items() if not known.voluntary}
    assert set(written.operations) == needed | PROVEN_ALTHOUGH_VOLUNTARY.get(protocol, set())
    assert "(likely: by its name and its arguments; not called)" in done.stdout


@pytest.mark.long
def test_a_call_that_waits_is_proposed_as_one(otmcp: Otmcp, tmp_path: Path, warm_start: WarmStart) -> None:
    endpoint = ("--env", "BROKER_HOST={host}", "--env", "BROKER_PORT={port}")
    done = otmcp("init", "--protocol", "mqtt", *endpoint, "--", *warm_start.python, str(FOREIGN), "mqtt-collect")
    assert done.returncode == 0, done.stderr
    assert (
        "messages        collect (proven: the device saw a SUBSCRIBE, and its message is in the answer)" in done.stdout
    )
    (collect,) = load_subject(tmp_path / "otmcp.toml").adapters["mqtt"].operations["messages"]
    assert collect.blocking
    assert collect.fill({"filter": "a/#", "seconds": 3}, {}) == {"topic": "a/#", "timeout": 3}


@pytest.mark.long
def test_a_sparkplug_host_is_noticed_and_its_commands_are_proven(
    otmcp: Otmcp, tmp_path: Path, warm_start: WarmStart
) -> None:
    endpoint = ("--env", "BROKER_HOST={host}", "--env", "BROKER_PORT={port}")
    done = otmcp("init", "--protocol", "mqtt", *endpoint, "--", *warm_start.python, str(FOREIGN), "mqtt-host")
    assert done.returncode == 0, done.stderr
    assert "send_device_command send_device_command (proven: the device saw the command)" in done.stdout
    assert 'sparkplug = "host"' in (tmp_path / "otmcp.toml").read_text(encoding="utf-8")
    host = load_subject(tmp_path / "otmcp.toml").adapters["mqtt"]
    assert {*host.operations} == {"info", "sparkplug_metrics", "send_node_command", "send_device_command"}
    assert {"publish", "subscribe", "messages", "device_birth"} <= {*host.unclaimed}
    (metrics,) = host.operations["sparkplug_metrics"]
    assert {name: rule.path for name, rule in metrics.outputs.items()} == {"metrics": "metrics", "online": "online"}


@pytest.mark.long
def test_a_host_without_a_status_has_its_metrics_found_in_a_list(
    otmcp: Otmcp, tmp_path: Path, warm_start: WarmStart
) -> None:
    endpoint = ("--env", "BROKER_HOST={host}", "--env", "BROKER_PORT={port}")
    done = otmcp("init", "--protocol", "mqtt", *endpoint, "--", *warm_start.python, str(FOREIGN), "mqtt-listener")
    assert done.returncode == 0, done.stderr
    host = load_subject(tmp_path / "otmcp.toml").adapters["mqtt"]
    assert {*host.operations} == {"sparkplug_metrics", "send_device_command"}
    (metrics,) = host.operations["sparkplug_metrics"]
    assert metrics.outputs["metrics"].path == "@"


@pytest.mark.long
def test_an_old_server_is_described_beside_another_adapter(otmcp: Otmcp, tmp_path: Path) -> None:
    (tmp_path / "old.py").write_text(OLD, encoding="utf-8")
    there = '[subject]\nname = "x"\nversion = "7"\n\n[adapter.mqtt]\ncommand = ["adapter"]\n'
    (tmp_path / "otmcp.toml").write_text(there, encoding="utf-8")
    launch = (
        "--protocol",
        "modbus",
        "--file",
        "address={host} {port}",
        "--",
        sys.executable,
        "old.py",
        "{work}/address",
    )
    done = otmcp("init", *launch)
    assert done.returncode == 0, done.stderr
    assert "read_holding    read_holding_registers (proven" in done.stdout
    text = (tmp_path / "otmcp.toml").read_text(encoding="utf-8")
    assert text.startswith(there)
    subject = load_subject(tmp_path / "otmcp.toml")
    assert subject.version == "7"
    assert set(subject.adapters) == {"mqtt", "modbus"}
    assert subject.adapters["modbus"].era == "legacy"
    assert subject.adapters["modbus"].variants["rw"].files == {"address": "{host} {port}"}
    again = otmcp("init", *launch)
    assert again.returncode == 2
    assert "otmcp.toml: exists already" in again.stderr


@pytest.mark.long
def test_a_server_that_waits_for_the_older_handshake_is_told_by_an_option(otmcp: Otmcp, tmp_path: Path) -> None:
    (tmp_path / "old.py").write_text(OLD, encoding="utf-8")
    address = ("--protocol", "modbus", "--file", "address={host} {port}")
    launch = ("--era", "legacy", "--isolation=off", "--", sys.executable, "old.py", "{work}/address", "waits")
    done = otmcp("init", *address, *launch)
    assert done.returncode == 0, done.stderr
    assert "read_holding    read_holding_registers (proven" in done.stdout
    assert load_subject(tmp_path / "otmcp.toml").adapters["modbus"].era == "legacy"
    assert set((tmp_path / "addressed").read_text(encoding="utf-8").split()) == {"initialize"}


def test_an_era_that_does_not_exist_is_refused(otmcp: Otmcp) -> None:
    done = otmcp("init", "--protocol", "modbus", "--era", "2024", "--", "adapter")
    assert done.returncode == 2
    assert "--era: invalid choice: '2024' (choose from 'auto', 'legacy')" in done.stderr


@pytest.mark.parametrize("era", ["auto", pytest.param("legacy", marks=pytest.mark.long)])
def test_the_doctor_says_by_which_handshake_a_server_must_be_addressed(otmcp: Otmcp, tmp_path: Path, era: str) -> None:
    (tmp_path / "old.py").write_text(OLD, encoding="utf-8")
    text = f'''
[subject]
name = "x"
version = "1"
[adapter.modbus]
command = ["{sys.executable}", "old.py", "{{work}}/address"]
files = {{ address = "{{host}} {{port}}" }}
era = "{era}"
answer = "json"
[adapter.modbus.bind.read_holding]
tool = "read_holding_registers"
arguments = {{ address = "$address", count = "$count" }}
result = {{ values = "registers" }}
'''
    (tmp_path / "otmcp.toml").write_text(text, encoding="utf-8")
    done = otmcp("doctor", "--isolation=off")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "old 1.9.4, MCP 2024-11-05, 1 tool" in done.stdout
    assert "a random value went between the mock device and the adapter: it talks to the mock" in done.stdout
    assert "nothing yet" not in done.stdout
    *_, gaps, last = done.stdout.splitlines()
    assert gaps.startswith("  not bound, and not declared as unclaimed: ping, read_input, write_holding; ")
    assert last == "what is bound is well; bind the rest or declare it as unclaimed, then: pytest --otmcp-reps=3"
    addressed = (tmp_path / "addressed").read_text(encoding="utf-8").split()
    advice = "ends at the first request of today's handshake, or never answers it, so it was given that of 2025: say era = 'legacy'"
    if era == "auto":
        assert advice in done.stdout
        assert addressed == ["server/discover", "initialize"]
    else:
        assert advice not in done.stdout
        assert addressed == ["initialize"]


def test_a_file_that_is_there_is_not_replaced(otmcp: Otmcp, tmp_path: Path) -> None:
    (tmp_path / "otmcp.toml").write_text("mine", encoding="utf-8")
    done = otmcp("init", "--protocol", "modbus", "--", "adapter")
    assert done.returncode == 2
    assert "otmcp.toml: exists already" in done.stderr
    assert (tmp_path / "otmcp.toml").read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize(
    ("imports", "said"),
    [
        ("import pymodbus", "modbus: "),
        ("import json", "the command names no protocol, and no known library of one is imported; add --protocol with"),
        (
            "import pymodbus, paho.mqtt",
            "modbus and mqtt: the command or the imports of the adapter name each; add --pro",
        ),
    ],
)
def test_the_protocol_is_that_of_the_library_that_the_adapter_imports(imports: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "server.py").write_text(imports, encoding="utf-8")
    try:
        recognised = f"{recognise_protocol(['python', str(tmp_path / 'server.py')], {'PORT': '{port}'})}: "
    except UsageError as error:
        recognised = str(error)
    assert recognised.startswith(said)


@pytest.mark.long
def test_an_adapter_that_does_not_start_is_no_proposal(otmcp: Otmcp, tmp_path: Path) -> None:
    done = otmcp("init", "--protocol", "modbus", "--", sys.executable, "-c", "import mcp.server.fastmcp")
    assert done.returncode == 1
    # Without the command it would examine the reference adapters.
    assert done.stderr.startswith("otmcp: no proposal: the adapter exited with code 1")
    assert "-> It was written for version 1 of the MCP SDK" in done.stdout
    # What the adapter wrote stays lines, each marked, without those that only underline.
    assert "\n    | ModuleNotFoundError: No module named 'mcp.server.fastmcp'" in done.stderr
    assert "^^^" not in done.stderr
    assert not (tmp_path / "otmcp.toml").exists()


def test_the_doctor_writes_the_files_that_a_command_needs(otmcp: Otmcp, tmp_path: Path) -> None:
    (tmp_path / "old.py").write_text(OLD, encoding="utf-8")
    address = ("--protocol", "modbus", "--file", "address={host} {port}")
    done = otmcp("doctor", *address, "--", sys.executable, "old.py", "{work}/address")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "old 1.9.4, MCP 2024-11-05, 1 tool" in done.stdout


@pytest.mark.long
def test_the_doctor_names_cause_and_remedy(otmcp: Otmcp) -> None:
    done = otmcp("doctor", "--protocol", "modbus", "--", sys.executable, "-c", "import mcp.server.fastmcp")
    assert done.returncode == 1
    assert "No module named 'mcp.server.fastmcp'" in done.stdout
    assert "Install it into an environment of its own with 'mcp<2'." in done.stdout


@pytest.mark.long
def test_the_doctor_says_with_what_a_read_failed_that_reached_the_device(otmcp: Otmcp, tmp_path: Path) -> None:
    error = '{"code": -32602, "message": "Invalid tools/call result"}'
    refusing = f'**({{"error": {error}}} if "content" in result else {{"result": result}})'
    (tmp_path / "old.py").write_text(OLD.replace('"result": result', refusing), encoding="utf-8")
    text = f'''
[subject]
name = "x"
version = "1"
[adapter.modbus]
command = ["{sys.executable}", "old.py", "{{work}}/address"]
files = {{ address = "{{host}} {{port}}" }}
answer = "json"
[adapter.modbus.bind.read_holding]
tool = "read_holding_registers"
arguments = {{ address = "$address", count = "$count" }}
result = {{ values = "registers" }}
'''
    (tmp_path / "otmcp.toml").write_text(text, encoding="utf-8")
    done = otmcp("doctor")
    assert done.returncode == 1
    assert "the mock saw requests during read_holding_registers(address=" in done.stdout
    assert "which failed (" in done.stdout
    assert "Invalid tools/call result" in done.stdout


def test_the_doctor_compares_a_subject_file_with_the_tools(otmcp: Otmcp, tmp_path: Path) -> None:
    text = f'''
[subject]
name = "x"
version = "1"
[adapter.modbus]
command = ["{sys.executable}", "-m", "pytest_otmcp.reference_adapters", "modbus"]
env = {{ MODBUS_HOST = "{{host}}", MODBUS_PORT = "{{port}}" }}
[adapter.modbus.bind.ping]
tool = "pin"
'''
    (tmp_path / "otmcp.toml").write_text(text, encoding="utf-8")
    done = otmcp("doctor")
    assert done.returncode == 1
    assert "modbus-reference" in done.stdout
    assert "the adapter lists no tool 'pin'; did you mean 'ping'?" in done.stdout
    assert "all is well" not in done.stdout
    assert "nothing is bound to" not in done.stdout
    (tmp_path / "otmcp.toml").write_text(text.replace('"pin"', '"ping"'), encoding="utf-8")
    (line,) = (line for line in otmcp("doctor").stdout.splitlines() if "nothing is bound to" in line)
    assert "write_register" in line
    assert "ping" not in line


def test_the_doctor_without_a_file_examines_the_adapters_that_every_run_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    async def healthy(*_: object) -> bool:
        return True

    # A plain installation has no libraries of the further protocols: their adapters would be called ill.
    monkeypatch.setattr("pytest_otmcp.cli.doctor._examine", healthy)
    monkeypatch.chdir(tmp_path)
    assert main(["doctor"]) == 0
    shown = capsys.readouterr()
    assert [line.partition(":")[0] for line in shown.out.splitlines()[:-1]] == [
        protocol.name for protocol in protocols().values() if protocol.always
    ]
    assert "no subject file otmcp.toml here: these are the reference adapters" in shown.err
    assert shown.out.endswith("all is well, next: otmcp init -- COMMAND, with an adapter of yours\n")
    assert main(["doctor", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [one["protocol"] for one in found] == [protocol.key for protocol in protocols().values() if protocol.always]
    assert all(one["well"] and one["not_bound"] == [] for one in found)


TELLING = """
[subject]
name = "x"
version = "1"
[adapter.modbus]
command = [{shell}]
env = {{ MODBUS_HOST = "{{host}}", MODBUS_PORT = "{{port}}" }}
secret_env = ["PLC_TOKEN"]
bounded = {{ env = {{ TELLS = "1" }}, allowed = ["1/holding_registers/1"] }}
[adapter.modbus.bind.read_holding]
tool = "read_multiple_holding_registers"
arguments = {{ address = "$address", count = "$count" }}
result.values = "data.values"
"""
SHELL = f'test -z "$TELLS" || echo "token is $PLC_TOKEN" >&2; exec {sys.executable} -m pytest_otmcp.reference_adapters modbus'


@pytest.mark.long
def test_the_doctor_looks_at_every_launch_and_says_which_secret_it_tells(otmcp: Otmcp, tmp_path: Path) -> None:
    shell = ", ".join(map(json.dumps, ("sh", "-c", SHELL)))
    (tmp_path / "otmcp.toml").write_text(TELLING.format(shell=shell), encoding="utf-8")
    done = otmcp("doctor")
    assert done.returncode == 1, done.stdout + done.stderr
    told = [line for line in done.stdout.splitlines() if "the value of PLC_TOKEN" in line]
    assert [line.strip().partition(" has ")[0] for line in told] == ["bounded: standard error"]
    assert "  rw: a random value went between the mock device and the adapter" in done.stdout
    assert "all is well" not in done.stdout


@pytest.mark.long
def test_a_call_can_be_made_with_every_launch_of_the_file(otmcp: Otmcp, tmp_path: Path) -> None:
    shell = ", ".join(map(json.dumps, ("sh", "-c", SHELL)))
    (tmp_path / "otmcp.toml").write_text(TELLING.format(shell=shell), encoding="utf-8")
    done = otmcp("call", "--variant", "bounded", "read_holding", "address=1", "count=1")
    assert done.returncode == 0, done.stdout + done.stderr
    done = otmcp("call", "--variant", "retimed", "read_holding", "address=1", "count=1")
    assert done.returncode == 2
    assert "[adapter.modbus] has no such launch, it has rw ro bounded" in done.stderr


@pytest.mark.long
def test_a_variable_that_takes_a_secret_is_proposed_and_has_a_random_value(otmcp: Otmcp, tmp_path: Path) -> None:
    needs = f"test ${{#PLC_TOKEN}} = 32 && exec {sys.executable} -m pytest_otmcp.reference_adapters modbus"
    launch = ("--env", "MODBUS_HOST={host}", "--env", "MODBUS_PORT={port}", "--secret-env", "PLC_TOKEN")
    done = otmcp("init", *launch, "--", "sh", "-c", needs)
    assert done.returncode == 0, done.stdout + done.stderr
    assert load_subject(tmp_path / "otmcp.toml").adapters["modbus"].secret_env == ("PLC_TOKEN",)
    done = otmcp("doctor", *launch, "--", "sh", "-c", needs)
    assert done.returncode == 0, done.stdout + done.stderr
    done = otmcp("doctor", *launch, "--env", "PLC_TOKEN=x", "--", "sh", "-c", needs)
    assert done.returncode == 2
    assert "--secret-env PLC_TOKEN" in done.stderr
