"""The kit's knowledge of a mock device: its endpoints, and everything that reached it, or that something is missing."""

from __future__ import annotations

import asyncio
import base64
import os
import signal
import socket
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from pytest_otmcp.errors import KitError, SubjectError
from pytest_otmcp.plant.devices import Plant
from pytest_otmcp.plant.endpoint import Endpoint, endpoint_values
from pytest_otmcp.plant.mock_device import MockDevice
from pytest_otmcp.subject import load_subject
from pytest_otmcp.subject.model import replace_template
from pytest_otmcp.suite.catalogue import tasks_by_id
from pytest_otmcp.trial.adapter_under_test import AdapterUnderTest, BenchOptions
from pytest_otmcp.trial.bench import Bench
from pytest_otmcp.trial.live_driver import LiveDriver

pytestmark = pytest.mark.asyncio

WRITE = bytes.fromhex("0001 0000 0006 01 06 0001 002A")
CONNECT = b"\x10\x0d\x00\x04MQTT\x04\x02\x00\x3c\x00\x01x"
PUBLISH = b"\x30\x0e\x00\x0ccontrol/pump"


@asynccontextmanager
async def running(protocol: str) -> AsyncIterator[MockDevice]:
    device = MockDevice(protocol)
    await device.launch()
    try:
        yield device
    finally:
        await device.close()


@pytest.mark.parametrize(
    ("protocol", "sent", "expected"),
    [("modbus", WRITE, {"kind": "request", "function": 6}), ("mqtt", CONNECT + PUBLISH, {"kind": "PUBLISH"})],
    ids=["modbus", "mqtt"],
)
async def test_what_arrived_before_the_question_is_in_the_answer(
    protocol: str, sent: bytes, expected: dict[str, object]
) -> None:
    async with running(protocol) as device:
        mark = await device.mark()
        pid = (await device.ask("ready"))["pid"]
        # The device stands still, as if the machine had no time for it: the client's bytes and the question both wait.
        os.kill(pid, signal.SIGSTOP)
        try:
            with socket.create_connection((device.host, device.port)) as client:
                client.sendall(sent)
            asking = asyncio.create_task(device.journal(mark))
            for _ in range(3):
                await asyncio.sleep(0)
        finally:
            os.kill(pid, signal.SIGCONT)
        entries = (await asking).entries
    assert [entry for entry in entries if expected.items() <= entry.items()], entries


RETAINED = """
[subject]
name = "x"
version = "1"
[adapter.mqtt]
command = ["{python}", "-m", "pytest_otmcp.reference_adapters", "mqtt"]
env = { MQTT_HOST = "{host}", MQTT_PORT = "{port}" }
retained = ['estate/devices=[{"name": "lamp"}]', "estate/state=a=b"]
"""


async def test_what_others_have_retained_is_there_before_an_adapter_and_after_a_reset_and_an_outage(
    tmp_path: Path,
) -> None:
    (tmp_path / "otmcp.toml").write_text(RETAINED, encoding="utf-8")
    adapter = load_subject(tmp_path / "otmcp.toml").adapters["mqtt"]

    async def retained(device: MockDevice) -> set[tuple[str, bytes]]:
        image = await device.image()
        return {(topic, base64.b64decode(payload)) for topic, payload in image["retained"].items()}

    there = {("estate/devices", b'[{"name": "lamp"}]'), ("estate/state", b"a=b")}
    async with running("mqtt") as device:
        under_test = AdapterUnderTest(adapter, "rw", device, BenchOptions())
        try:
            await under_test.open()
            assert await retained(device) >= there
            await device.reset()
            assert await retained(device) >= there
            await device.stop()
            await device.start()
            assert await retained(device) >= there
        finally:
            await under_test.close()


# -- endpoints ------------------------------------------------------------------------------------------------

THIRD_PARTIES = Path(__file__).parents[1] / "mocks"


@pytest.fixture
def third_parties(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lets mocks outside the product be imported by their dotted names."""
    monkeypatch.setenv("PYTHONPATH", str(THIRD_PARTIES))


@pytest.mark.usefixtures("third_parties")
async def test_a_device_tells_all_its_endpoints_and_keeps_them() -> None:
    async with running("thirdparty.latches") as device:
        stream, datagram, line = device.endpoints.values()
        assert list(device.endpoints) == ["stream", "datagram", "line"]
        assert [endpoint.kind for endpoint in (stream, datagram, line)] == ["tcp", "udp", "pty"]
        assert (stream.name, stream.host, stream.port) == ("stream", device.host, device.port)
        assert (datagram.host, datagram.path) == ("127.0.0.1", "")
        assert (line.host, line.port) == ("", 0)
        before, begun = device.endpoints, device.accepting_ns
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
            client.connect((datagram.host, datagram.port))
            client.send(b"\x07")
            assert await device.wait(0, {"endpoint": "datagram", "value": 7}, timeout_s=60.0)
            await device.stop()
            client.send(b"\x08")
            await device.start()
            # A datagram endpoint accepts nothing: it is ready when it says so, and reads what is sent from then on.
            assert device.accepting_ns > begun
            client.send(b"\x09")
            (set_now,) = await device.wait(0, {"kind": "SET"}, timeout_s=60.0)
        assert device.endpoints == before
        assert set_now["seq"] == 0
        assert (await device.image())["points"]["datagram"] == 9


@pytest.mark.usefixtures("third_parties")
async def test_sentences_name_the_protocol_and_not_the_package() -> None:
    device = MockDevice("thirdparty.latches", "latches")
    with pytest.raises(KitError, match=r"^the latches mock is not running \(asked for 'image'\)$"):
        await device.image()
    missing = MockDevice("thirdparty.missing", "lamps")
    try:
        with pytest.raises(
            KitError, match=r"(?s)^the lamps mock ended unexpectedly: .*thirdparty\.missing cannot be imported"
        ):
            await missing.launch()
    finally:
        await missing.close()


TCP = Endpoint(name="explicit", kind="tcp", host="127.0.0.1", port=44818)
UDP = Endpoint(name="implicit", kind="udp", host="127.0.0.1", port=2222)
PTY = Endpoint(name="bus", kind="pty", path="/dev/pts/7")
AT_TCP = {"host": "127.0.0.1", "port": "44818", "url": "enip://127.0.0.1:44818"}


@pytest.mark.parametrize(
    ("endpoints", "expected"),
    [
        ([TCP], AT_TCP),
        ([TCP, UDP], {**AT_TCP, "implicit_port": "2222"}),
        ([TCP, PTY, UDP], {**AT_TCP, "implicit_port": "2222", "serial": "/dev/pts/7"}),
        ([UDP], {"host": "127.0.0.1", "port": "2222", "url": "enip://127.0.0.1:2222"}),
        ([PTY, TCP], {**AT_TCP, "serial": "/dev/pts/7"}),
        ([PTY], {"serial": "/dev/pts/7", "url": "enip:///dev/pts/7"}),
        ([], {}),
    ],
)
async def test_placeholders_stand_for_every_endpoint(endpoints: list[Endpoint], expected: dict[str, str]) -> None:
    assert endpoint_values("enip", {endpoint.name: endpoint for endpoint in endpoints}) == expected


# An adapter that does not start where its broker refuses it.
EXACTING = """
import sys
from mcp.server import MCPServer
from paho.mqtt.client import CallbackAPIVersion, Client

client = Client(CallbackAPIVersion.VERSION2)
granted = []
client.on_connect = lambda client, userdata, flags, reason, properties: granted.append(not reason.is_failure)
client.connect(sys.argv[1], int(sys.argv[2]))
while not granted:
    client.loop(0.1)
if not granted[0]:
    sys.exit("refused")
client.loop_start()
MCPServer("exacting").run()
"""


async def test_a_start_that_failed_at_a_device_with_a_fault_is_tried_again_without_it(tmp_path: Path) -> None:
    (tmp_path / "exacting.py").write_text(EXACTING)
    subject = tmp_path / "otmcp.toml"
    subject.write_text(
        '[subject]\nname = "x"\nversion = "1"\n[adapter.mqtt]\n'
        f'command = ["{sys.executable}", "{{dir}}/exacting.py", "{{host}}", "{{port}}"]\n[adapter.mqtt.bind]\n'
    )
    async with running("mqtt") as device:
        under_test = AdapterUnderTest(load_subject(subject).adapters["mqtt"], "rw", device, BenchOptions())
        try:
            await device.fault({"packet": "CONNECT", "action": {"reason_code": 0x87}})
            with pytest.raises(SubjectError, match="refused"):
                await under_test.open()
            await device.fault()
            await under_test.open()
        finally:
            await under_test.close()


# An adapter that does not start so many times, and says in a file how often it was started.
RELUCTANT = """
import pathlib, sys
from mcp.server import MCPServer

tries = pathlib.Path(sys.argv[1])
tries.write_text(tries.read_text() + "x" if tries.exists() else "x")
if len(tries.read_text()) <= int(sys.argv[2]):
    sys.exit("not yet")
MCPServer("reluctant").run()
"""


# An adapter that ends at once is started a second time, with the handshake of 2025: that is one start here.
@pytest.mark.parametrize(
    ("failing", "starts", "outcomes"), [(2, 3, ["cannot_start", *["open"] * 3]), (9, 4, ["cannot_start"] * 4)]
)
async def test_an_adapter_that_did_not_start_once_is_started_for_the_next_item_and_after_two_failures_no_more(
    tmp_path: Path, failing: int, starts: int, outcomes: list[str]
) -> None:
    (tmp_path / "reluctant.py").write_text(RELUCTANT)
    tries, subject = tmp_path / "tries", tmp_path / "otmcp.toml"
    subject.write_text(
        '[subject]\nname = "x"\nversion = "1"\n[adapter.modbus]\n'
        f'command = ["{sys.executable}", "{{dir}}/reluctant.py", "{tries}", "{failing}"]\n[adapter.modbus.bind]\n'
    )
    async with running("modbus") as device:
        under_test = AdapterUnderTest(load_subject(subject).adapters["modbus"], "rw", device, BenchOptions())
        found = []
        try:
            for _ in range(4):
                try:
                    await under_test.open()
                except SubjectError as error:
                    found.append(error.code)
                else:
                    found.append("open")
        finally:
            await under_test.close()
    assert found == outcomes
    assert len(tries.read_text()) == starts


@pytest.mark.usefixtures("third_parties")
async def test_an_adapter_is_told_all_endpoints_where_it_is_launched_and_asked_to_connect(tmp_path: Path) -> None:
    subject = tmp_path / "otmcp.toml"
    subject.write_text(
        '[subject]\nname = "Line"\nversion = "1"\n[adapter.modbus]\n'
        'command = ["{python}", "{serial}"]\n'
        'env = { AT = "{host}:{port} {datagram_port}" }\n'
        'connect = { tool = "open", arguments = { line = "{serial}", port = "{datagram_port:int}", at = "{url}" } }\n'
    )
    adapter = load_subject(subject).adapters["modbus"]
    assert adapter.connect is not None
    async with running("thirdparty.latches") as device:
        under_test = AdapterUnderTest(adapter, "rw", device, BenchOptions())
        _, datagram, line = device.endpoints.values()
        launch = adapter.variants["rw"].for_endpoint({**under_test.endpoint, "python": "python"})
        assert launch.command == ("python", line.path)
        assert launch.env["AT"] == f"{device.host}:{device.port} {datagram.port}"
        assert replace_template(adapter.connect.arguments, {}, under_test.endpoint) == {
            **{"line": line.path, "port": datagram.port, "at": f"modbus+tcp://{device.host}:{device.port}"},
        }


async def test_what_steps_wanted_of_a_device_and_could_not_end_does_not_meet_the_next_start(tmp_path: Path) -> None:
    (tmp_path / "otmcp.toml").write_text(RETAINED, encoding="utf-8")
    plant = Plant()
    bench = Bench(load_subject(tmp_path / "otmcp.toml"), BenchOptions(), plant)
    try:
        await bench.prepare(["mqtt"])
        driver = LiveDriver(bench, tasks_by_id(["mqtt"])["Q1"], seed=1)
        await driver.prepare()
        device = (await bench.adapter("mqtt")).device
        await device.fault({"packet": "CONNECT", "action": {"delay_s": 60}})
        await driver.end_sessions()
        assert not device.faulty
        await driver.open_sessions()
    finally:
        await bench.close()
        await plant.close()
