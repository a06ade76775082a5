"""``docs/mock-devices.md`` names every action and poke, and the mocks understand every example of it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from pytest_otmcp.mocks.dnp3 import faults as dnp3
from pytest_otmcp.mocks.ethercat import faults as ethercat
from pytest_otmcp.mocks.ethernetip import faults as ethernetip
from pytest_otmcp.mocks.medium import CONDITIONS
from pytest_otmcp.mocks.modbus import faults as modbus
from pytest_otmcp.mocks.mqtt import faults as mqtt
from pytest_otmcp.mocks.opcua import faults as opcua
from pytest_otmcp.mocks.opcua.sample_nodes import SETS
from pytest_otmcp.mocks.profibus import faults as profibus
from pytest_otmcp.mocks.profinet import faults as profinet
from pytest_otmcp.mocks.s7 import faults as s7

from conftest import StartMock
from pytest_otmcp.session.cable import cable_refused

NEEDS_CABLE = pytest.mark.skipif(cable_refused() is not None, reason=f"no cable here: {cable_refused()}")
PAGE = (Path(__file__).parents[2] / "docs" / "mock-devices.md").read_text(encoding="utf-8")
SECTIONS = dict(re.findall(r"^### (.+?)\n(.*?)(?=^##|\Z)", PAGE, re.MULTILINE | re.DOTALL))
TABLES = {
    "Modbus": modbus.TABLE,
    "MQTT": mqtt.TABLE,
    "OPC UA": opcua.TABLE,
    "S7comm": s7.TABLE,
    "EtherNet/IP": ethernetip.TABLE,
    "DNP3": dnp3.TABLE,
    "PROFIBUS DP": profibus.TABLE,
    "EtherCAT": ethercat.TABLE,
    "PROFINET": profinet.TABLE,
}
ANY = SECTIONS["Any TCP device"]


def examples(section: str) -> list[dict[str, object]]:
    return [json.loads(text) for text in re.findall(r"`(\{.*?\})`", section)]


@pytest.mark.parametrize("protocol", TABLES)
def test_every_condition_and_action_is_on_the_page(protocol: str) -> None:
    named = set(re.findall(r"`(\w+)`", PAGE.split("###")[0] + ANY + SECTIONS[protocol]))
    assert {*TABLES[protocol].conditions, *TABLES[protocol].actions} - named == set()


def test_every_set_of_nodes_and_every_condition_of_the_network_is_on_the_page() -> None:
    assert set(SETS) - set(re.findall(r"`(\w+)`", SECTIONS["OPC UA"])) == set()
    assert set(CONDITIONS) - set(re.findall(r'`"(\w+)"`', ANY)) == set()


@pytest.mark.asyncio
@pytest.mark.parametrize(
    ("protocol", "mock"),
    [
        ("Modbus", "modbus"),
        ("MQTT", "mqtt"),
        ("OPC UA", "opcua"),
        ("S7comm", "s7"),
        ("EtherNet/IP", "ethernetip"),
        ("DNP3", "dnp3"),
        ("PROFIBUS DP", "profibus"),
        pytest.param("EtherCAT", "ethercat", marks=NEEDS_CABLE),
        pytest.param("PROFINET", "profinet", marks=NEEDS_CABLE),
    ],
)
async def test_every_example_is_understood(start_mock: StartMock, protocol: str, mock: str) -> None:
    found = examples(SECTIONS[protocol])
    assert len(found) > 8
    device = await start_mock(mock)
    for example in found:
        if "action" in example:
            await device.control.ask("fault", rules=[example])
        else:
            await device.control.ask("poke", params=example)
            # The next example may be about an edge node that this one has sent away.
            await device.control.ask("reset")
    if device.ready_event["port"] is None:
        return
    for example in examples(ANY):
        about = {"packet": "PUBLISH"} if mock == "mqtt" else {}
        conditions = {name: value for name, value in example.items() if name not in ("address", "action")}
        action = {"no_answer": True} if mock == "mqtt" and "drop" in str(example) else example["action"]
        await device.control.ask("fault", rules=[{**about, **conditions, "action": action}])
