"""The protocols whose adapters are measured: one call of each, and the bare exchange that it is compared with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

from pytest_otmcp.session.cable import cable_refused

from .workload import (
    ANALOG_INPUTS,
    DB,
    DB_BYTES,
    DEVICE,
    ENTRY,
    INPUT_REGISTERS,
    OBJECT,
    OUTSTATION,
    PAYLOAD,
    SLAVE,
    SLOT,
    STATION,
    TAG,
    TEMPERATURE,
    TOPIC,
)

__all__ = ["FAMILIES", "Family"]

_PAPER_TARGET, _FURTHER_TARGET = 1.15, 1.2


@dataclass(frozen=True, slots=True, kw_only=True)
class Family:
    """A protocol.

    Attributes:
        key: name of the mock device, of the reference adapter and of the raw exchange.
        item: the item of the conformance suite that makes the same call.
        raw: what the raw exchange does.
        does: what the call does.
        tool, arguments: the call.
        env: variables of the adapter's environment, with ``{host}`` and ``{port}`` for the device's, ``{serial}`` for its line, or ``{interface}`` for
            the end of its cable.
        target: largest ratio of the call to the null tool and the raw exchange together.
        library: module of an optional dependency that adapter and raw exchange need.
        cable: the device is on a cable, which not every machine allows.
        told: what the raw exchange is told, of what its device has.
    """

    key: str
    item: str
    raw: str
    does: str
    tool: str
    arguments: Mapping[str, Any]
    env: Mapping[str, str]
    target: float = _FURTHER_TARGET
    library: str | None = None
    cable: bool = False
    told: str = "host port"

    @property
    def alone(self) -> bool:
        """A line has one master."""
        return self.told in ("serial", "interface")


_ALL = (
    Family(
        key="modbus",
        item="M2",
        raw="pymodbus, read 4 input registers",
        does="read 4 input registers",
        tool="read_input_registers",
        arguments={"address": 0, "count": INPUT_REGISTERS},
        env={"MODBUS_HOST": "{host}", "MODBUS_PORT": "{port}"},
        target=_PAPER_TARGET,
    ),
    Family(
        key="mqtt",
        item="Q3",
        raw="paho, publish QoS 0 until written",
        does="publish QoS 0",
        tool="publish_message",
        arguments={"topic": TOPIC, "payload": PAYLOAD, "qos": 0},
        env={"MQTT_URL": "mqtt://{host}:{port}", "MQTT_WRITES_ENABLED": "true"},
        target=_PAPER_TARGET,
    ),
    Family(
        key="opcua",
        item="O1",
        raw="asyncua, read one node",
        does="read one node",
        tool="read_opcua_node",
        arguments={"node_id": TEMPERATURE},
        env={"OPCUA_URL": "opc.tcp://{host}:{port}"},
        target=_PAPER_TARGET,
    ),
    Family(
        key="s7",
        item="K2",
        raw="python-snap7, read 16 bytes of a data block",
        does="read 16 bytes of a data block",
        tool="read_db",
        arguments={"db_number": DB, "start_offset": 0, "size": DB_BYTES},
        env={"S7_HOST": "{host}", "S7_PORT": "{port}"},
        library="snap7",
    ),
    Family(
        key="bacnet",
        item="B2",
        raw="bacpypes3, read one present value",
        does="read one present value",
        tool="read_property",
        arguments={"device_id": DEVICE, "object_type": OBJECT[0], "object_instance": OBJECT[1]},
        env={"BACNET_HOST": "{host}", "BACNET_PORT": "{port}"},
        library="bacpypes3",
    ),
    Family(
        key="ethernetip",
        item="E2",
        raw="pylogix, read one tag",
        does="read one tag",
        tool="read_tag",
        arguments={"tag_name": TAG},
        env={"ETHERNETIP_HOST": "{host}", "ETHERNETIP_PORT": "{port}"},
        library="pylogix",
    ),
    Family(
        key="dnp3",
        item="D2",
        raw="dnp3py, read 4 analog inputs",
        does="read 4 analog inputs",
        tool="read_analog_inputs",
        arguments={"outstation_address": OUTSTATION, "start_index": 0, "count": ANALOG_INPUTS},
        env={"DNP3_HOST": "{host}", "DNP3_PORT": "{port}"},
        library="dnp3",
    ),
    Family(
        key="profibus",
        item="P2",
        raw="no library, RD_Inp of one slave",
        does="read the inputs of one slave",
        tool="read_inputs",
        arguments={"slave_address": SLAVE},
        env={"PROFIBUS_SERIAL": "{serial}"},
        told="serial",
    ),
    Family(
        key="ethercat",
        item="C2",
        raw="pysoem, SDO upload of one object",
        does="read one object",
        tool="read_sdo",
        arguments={"slave_position": ENTRY[0], "index": ENTRY[1], "subindex": ENTRY[2], "data_type": "UINT32"},
        env={"ETHERCAT_INTERFACE": "{interface}"},
        library="pysoem",
        cable=True,
        told="interface",
    ),
    Family(
        key="profinet",
        item="N2",
        raw="no library, Read of the record 8028",
        does="read the inputs of one slot",
        tool="read_io_data",
        arguments={"device_name": STATION, "slot": SLOT, "subslot": 1},
        env={"PROFINET_INTERFACE": "{interface}"},
        cable=True,
        told="device_ip",
    ),
)

FAMILIES = tuple(
    family
    for family in _ALL
    if (family.library is None or find_spec(family.library)) and not (family.cable and cable_refused())
)
"""The protocols of the paper, and the further ones whose extra is installed and that this machine allows."""
