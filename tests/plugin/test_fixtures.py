"""The public fixtures beyond their documentation: isolation of tests, misuse, lifetimes."""

from __future__ import annotations

import asyncio
import inspect
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import psutil
import pytest

from pytest_otmcp import devices, sessions
from pytest_otmcp.plugin.fixtures.handle import Handle
from pytest_otmcp.session.loop import LoopThread

from .vendor import Outcome, Repository

TOY = Path(__file__).parents[1] / "toy" / "site"

ISOLATION = """
PORTS = set()

def test_one_leaves_everything_behind(otmcp_modbus_device, otmcp_session):
    PORTS.add(otmcp_modbus_device.port)
    session = otmcp_session("modbus")
    assert session.call("write_holding", address=30, value=7).success
    otmcp_modbus_device.fault({"action": {"exception": 6}})
    otmcp_modbus_device.stop()
    assert not otmcp_modbus_device.running
    assert [entry.values for entry in otmcp_modbus_device.journal() if entry.writes] == [[7]]

def test_two_finds_nothing_of_it(otmcp_modbus_device, otmcp_session):
    PORTS.add(otmcp_modbus_device.port)
    assert len(PORTS) == 1
    assert otmcp_modbus_device.journal() == []
    assert otmcp_modbus_device.image()["units"]["1"]["holding_registers"][30] == 0
    session = otmcp_session("modbus")
    assert session.call("read_holding", address=30, count=1).outputs["values"] == [0]

def test_three_begins_with_an_empty_journal_although_a_session_has_just_ended(otmcp_modbus_device):
    assert otmcp_modbus_device.journal() == []

def test_the_journal_goes_on_over_an_outage(otmcp_modbus_device, otmcp_session):
    session = otmcp_session("modbus")
    session.call("read_input", address=0, count=1)
    otmcp_modbus_device.stop()
    otmcp_modbus_device.stop()
    otmcp_modbus_device.start()
    otmcp_modbus_device.start()
    session.call("read_input", address=1, count=1)
    requests = otmcp_modbus_device.wait_for(kind="request", count=2)
    assert [entry.address for entry in requests] == [0, 1]
    assert [entry.address for entry in otmcp_modbus_device.journal() if entry.kind == "request"] == [0, 1]

def test_plant_time_passes_only_when_it_is_told_to(otmcp_modbus_device):
    before = otmcp_modbus_device.image()
    assert otmcp_modbus_device.image() == before
    otmcp_modbus_device.tick(60)
    assert otmcp_modbus_device.image() != before
    otmcp_modbus_device.reset()
    assert otmcp_modbus_device.image() == before

def test_a_device_is_a_device_to_anybody(otmcp_broker):
    from paho.mqtt.client import CallbackAPIVersion, Client
    client = Client(CallbackAPIVersion.VERSION2, client_id="anybody")
    client.connect(otmcp_broker.host, otmcp_broker.port)
    client.publish("a/topic", "text", qos=0)
    client.loop()
    [message] = otmcp_broker.wait_for(kind="PUBLISH", client_id="anybody")
    client.disconnect()
    assert message.writes
    assert (message.topic, message.payload) == ("a/topic", b"text")
    otmcp_broker.poke("another/topic", "from nowhere")
    [message] = otmcp_broker.wait_for(kind="PUBLISH", topic="another/topic")
    assert message.simulated
    assert not message.writes

def test_nothing_that_was_waited_for_is_an_empty_list(otmcp_opcua_plant):
    assert otmcp_opcua_plant.wait_for(kind="Write", timeout_s=0.1) == []
"""
MISUSE = """
def test_protocol(otmcp_session):
    otmcp_session("modbuss")

def test_not_in_subject(otmcp_session):
    otmcp_session("opcua")

def test_variant(otmcp_session):
    otmcp_session("modbus", variant="readonly")

def test_inputs(otmcp_session):
    otmcp_session("modbus").call("write_holding", address=1)

def test_closed(otmcp_session):
    session = otmcp_session("modbus")
    session.close()
    session.call("ping")

def test_stopped(otmcp_modbus_device):
    otmcp_modbus_device.stop()
    otmcp_modbus_device.image()

def test_stopped_session(otmcp_modbus_device, otmcp_session):
    otmcp_modbus_device.stop()
    otmcp_session("modbus")

def test_fault(otmcp_modbus_device):
    otmcp_modbus_device.fault({"function": 3, "action": {"explode": True}})

def test_trial(_otmcp_trial):
    _otmcp_trial(None)

async def test_asynchronous(otmcp_session):
    await otmcp_session.aio("modbus", variant="readonly")
"""
SENTENCES = (
    "otmcp_session('modbuss'): there is no protocol 'modbuss'; did you mean 'modbus'?",
    "otmcp_session('opcua'): a vendor's adapter has no adapter for OPC UA, only for Modbus; add [adapter.opcua] to ",
    "otmcp_session('modbus'): there is no variant 'readonly'",
    "session of modbus: write_holding takes address, value, unit; given: address",
    "session of modbus: it was closed",
    "otmcp_modbus_device.image(): the device is stopped; start() it first",
    "otmcp_session('modbus'): the device is stopped; start() it first",
    "otmcp_modbus_device.fault(): unknown member 'explode' of a fault rule",
)


@pytest.fixture
def repository(empty_repository: Repository) -> Repository:
    """A repository with the Modbus reference adapter as its subject."""
    empty_repository.subject()
    return empty_repository


def run(repository: Repository, test: str) -> Outcome:
    repository.write(tests__test_it_py=test)
    options = ("-W", "error", "-o", "asyncio_mode=auto", "-o", "asyncio_default_fixture_loop_scope=function")
    return repository.pytest(*options, plugins="pytest_asyncio.plugin")


@pytest.mark.long
def test_every_test_finds_the_devices_as_they_are_at_their_start(repository: Repository) -> None:
    outcome = run(repository, ISOLATION)
    assert "7 passed" in outcome.output, outcome.output


@pytest.mark.long
def test_misuse_is_one_sentence_at_the_line_of_the_test(repository: Repository) -> None:
    outcome = run(repository, MISUSE)
    assert "10 failed" in outcome.output, outcome.output
    for sentence in SENTENCES:
        assert f"UsageError: {sentence}" in outcome.output, sentence
    assert "_otmcp_trial runs the shipped suite only: pytest --pyargs pytest_otmcp.conformance" in outcome.output
    assert "tests/test_it.py:3: UsageError" in outcome.output
    assert "pytest_otmcp/session/loop.py" not in outcome.output
    assert "pytest_otmcp/trial/adapter_under_test.py" not in outcome.output


def test_an_adapter_that_cannot_start_is_said_with_its_last_words(repository: Repository) -> None:
    repository.write(
        otmcp_toml='[subject]\nname = "x"\nversion = "1"\n[adapter.modbus]\n'
        'command = ["{python}", "-c", "raise SystemExit(\'no licence found\')"]\n'
    )
    outcome = run(repository, "def test_it(otmcp_session):\n    otmcp_session('modbus')\n")
    assert outcome.code == 1
    assert "SubjectError: the adapter exited with code 1 during its handshake" in outcome.output
    assert "no licence found" in outcome.output


def test_a_broken_subject_file_is_an_error_of_whoever_asks_for_the_subject(repository: Repository) -> None:
    repository.write(otmcp_toml="[subject\n")
    outcome = run(
        repository,
        "def test_device(otmcp_modbus_device):\n    assert otmcp_modbus_device.port\n\n"
        "def test_session(otmcp_session):\n    pass\n\n"
        "def test_subject(otmcp_subject):\n    pass\n",
    )
    assert "1 passed, 2 errors" in outcome.output, outcome.output
    assert outcome.output.count("not valid TOML") >= 2
    assert "Traceback" not in outcome.output


@pytest.mark.long
def test_the_subject_can_be_overridden(repository: Repository) -> None:
    repository.write(
        tests__conftest_py="import dataclasses\nimport pytest\nfrom pytest_otmcp.subject import reference_subject\n\n"
        "@pytest.fixture\ndef otmcp_subject():\n"
        "    return dataclasses.replace(reference_subject(), name='another')\n"
    )
    test = "def test_it(otmcp_subject, otmcp_session):\n    assert otmcp_subject.name == 'another'\n"
    outcome = run(repository, test + "    assert otmcp_session('opcua').tools\n")
    assert "1 passed" in outcome.output, outcome.output


def test_nothing_is_left_running(repository: Repository) -> None:
    repository.write(
        tests__test_it_py="import os\nimport psutil\n\n"
        "def test_it(otmcp_modbus_device, otmcp_session):\n"
        "    otmcp_session('modbus')\n"
        "    pids = [str(child.pid) for child in psutil.Process().children(recursive=True)]\n"
        "    assert len(pids) >= 3\n"
        "    open('pids', 'w').write(' '.join(pids))\n"
        "    assert False\n"
    )
    outcome = repository.pytest()
    assert outcome.code == 1
    assert not [pid for pid in (repository.root / "pids").read_text().split() if psutil.pid_exists(int(pid))]


def test_what_a_test_has_in_its_context_does_not_reach_the_kits_loop() -> None:
    whose = ContextVar("whose", default="nobody's")

    async def seen() -> str:
        return whose.get()

    loop = LoopThread()
    try:
        token = whose.set("the test's")
        assert loop.run(seen()) == "nobody's"
        assert asyncio.run(loop.wait(seen())) == "nobody's"
        whose.reset(token)
    finally:
        loop.close()


@pytest.mark.parametrize(
    ("plain", "awaited", "names"),
    [
        (devices.ModbusDevice, devices.AsyncModbusDevice, ("image", "wait_for", "poke")),
        (devices.AnyDevice, devices.AsyncAnyDevice, ("journal", "fault", "poke")),
        (sessions.Session, sessions.AsyncSession, ("call", "tool", "close")),
    ],
)
def test_a_handle_and_its_twin_have_the_same_methods(
    plain: type[Handle], awaited: type[Handle], names: tuple[str, ...]
) -> None:
    handle: Any = plain.__new__(plain)
    twin = handle.aio
    assert type(twin) is awaited
    assert handle.aio is twin
    for name in names:
        method, other = getattr(handle, name), getattr(twin, name)
        assert inspect.signature(method) == inspect.signature(other)
        assert method.__doc__ == other.__doc__
        assert (inspect.iscoroutinefunction(method), inspect.iscoroutinefunction(other)) == (False, True)


FURTHER = """
def test_s7(otmcp_s7_device, otmcp_session):
    otmcp_s7_device.poke("DB10", 44, bytes([4, 210]))
    assert otmcp_session("s7").call("read_typed", db=10, start=44, type="INT").outputs["value"] == 1234
    (asked,) = otmcp_s7_device.wait_for(kind="request", service="read")
    assert asked.items[0]["db"] == 10

def test_bacnet(otmcp_bacnet_device, otmcp_session):
    otmcp_bacnet_device.poke("analog-input,1", 1234.5)
    asked = {"device": 12345, "type": "analog-input", "instance": 1}
    assert otmcp_session("bacnet").call("read", **asked).outputs["value"] == 1234.5
    assert any(entry.reads for entry in otmcp_bacnet_device.journal())

def test_ethernetip(otmcp_ethernetip_device, otmcp_session):
    otmcp_ethernetip_device.poke("BatchTarget", 1234)
    assert otmcp_session("ethernetip").call("read_tag", tag="BatchTarget").outputs["value"] == 1234
    (asked,) = otmcp_ethernetip_device.wait_for(kind="request", service="read")
    assert asked.items[0]["tag"] == "BatchTarget"

def test_dnp3(otmcp_dnp3_device, otmcp_session):
    otmcp_dnp3_device.poke("analog_input/1", 1234)
    reply = otmcp_session("dnp3").call("read_analog", outstation=10, start=1, count=1)
    assert reply.outputs["values"] == [1234]
    (asked,) = otmcp_dnp3_device.wait_for(kind="request", function=1)
    assert asked.objects[0]["group"] == 30

def test_profibus(otmcp_profibus_device, otmcp_session):
    otmcp_profibus_device.poke(5, bytes([4, 210]))
    assert otmcp_session("profibus").call("read_inputs", slave=5).outputs["values"] == [4, 210]
    (asked,) = otmcp_profibus_device.wait_for(kind="request", service="rd_inp")
    assert asked.station == 5

def test_ethercat(otmcp_ethercat_device, otmcp_session):
    otmcp_ethercat_device.poke(0, bytes([4, 210]))
    assert otmcp_session("ethercat").call("read_inputs", slave=0).outputs["values"] == [4, 210]
    (asked,) = otmcp_ethercat_device.wait_for(kind="request", service="inputs")
    assert asked.slave == 0

def test_profinet(otmcp_profinet_device, otmcp_session):
    otmcp_profinet_device.poke(3, bytes([4, 210]))
    reply = otmcp_session("profinet").call("read_inputs", station="kit-device", slot=3, subslot=1)
    assert reply.outputs["values"] == [4, 210]
    (asked,) = otmcp_profinet_device.wait_for(kind="request", service="read")
    assert (asked.slot, asked.index) == (3, 0x8028)
"""


@pytest.mark.long
def test_devices_of_further_protocols_are_poked_and_say_what_they_have_seen(empty_repository: Repository) -> None:
    empty_repository.write(tests__test_it_py=FURTHER)
    outcome = empty_repository.pytest()
    assert "7 passed" in outcome.output, outcome.output


THIRD_PARTY = """
import socket

import pytest

from pytest_otmcp.devices import AnyDevice, UsageError

def test_toy(otmcp_device):
    toy = otmcp_device("toy")
    assert type(toy) is AnyDevice
    toy.poke(address=3, value=7)
    assert toy.image()["points"]["3"] == 7
    with socket.create_connection((toy.host, toy.port)) as client:
        client.sendall(b"W 3 8\\n")
        (asked,) = toy.wait_for(kind="write")
    assert (asked.writes, asked.received, asked.fields["value"]) == (True, True, 8)
    toy.stop()
    with pytest.raises(UsageError, match=r"otmcp_device\\('toy'\\).poke\\(\\): the device is stopped"):
        toy.poke(address=3, value=7)

async def test_twin(otmcp_device):
    toy = otmcp_device("toy").aio
    await toy.poke(address=3, value=7)
    assert (await toy.image())["points"]["3"] == 7
"""


@pytest.mark.long
def test_the_device_of_a_third_partys_protocol_is_poked_and_says_what_it_has_seen(
    empty_repository: Repository,
) -> None:
    empty_repository.write(tests__test_it_py=THIRD_PARTY)
    outcome = empty_repository.pytest("-o", "asyncio_mode=auto", plugins="pytest_asyncio.plugin", path=(TOY,))
    assert "2 passed" in outcome.output, outcome.output
