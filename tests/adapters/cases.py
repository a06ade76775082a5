"""The cases of the contract suite: one :class:`Case` for each reference adapter.

A new reference adapter adds a case; ``test_contract`` is then its acceptance test.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

__all__ = [
    "BACNET",
    "CASES",
    "DNP3",
    "ETHERNETIP",
    "ETHERNETIP_ALIASES",
    "MODBUS",
    "MODBUS_TAGS",
    "MQTT",
    "OPCUA",
    "S7",
    "S7_TAGS",
    "Case",
    "Unfit",
]

Tools = Mapping[str, Mapping[str, Any]]
Fields = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Unfit:
    """Arguments that must be refused before anything is sent.

    Attributes:
        in_tool: the tool itself finds the fault, after the write guard; else the argument model finds it, before the guard.
    """

    tool: str
    arguments: Any
    code: str
    in_tool: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One reference adapter.

    Attributes:
        protocol: name of the adapter and of the mock device.
        settings: makes the adapter's settings from the device's port, the adapter's name and a folder for files.
        prefix: that of the names of its settings for time-out, deadline and write switch.
        reads: tools that read, with arguments that succeed; ``silent`` of them do not ask the device.
        writes: tools that write, with arguments that the device accepts, unless the tool is in ``stateful``.
        stateful: writing tools that the adapter's own state refuses in a fresh session.
        probe: a tool that the device answers, and its arguments.
        write: the tool of the tests that need one write.
        answered: writing tools whose requests the device answers, every one.
        requests: fields of a journal entry for the request of a tool.
        background: recognises requests that the adapter makes without a call.
        rules: members of the device's fault rule that select the request of a tool.
        silence: the action of a fault rule by which the device does not answer.
        image: members of the device's image that only a write changes.
        unfit: arguments that are refused.
        bad_settings: names and values that stop the start.
        unknown_host: settings that lead to a host name that does not exist.
        farewell: the last journal entries of a connection that the adapter closes.
        concurrent: True when requests of several calls are on their way at the same time.
        readmitted: for an adapter that makes a lost connection again without a call: the fields of the journal entry
            that shows that the device has accepted the adapter of this name.
    """

    protocol: str
    settings: Callable[[int, str, Path], dict[str, str]]
    prefix: str
    reads: Tools
    silent: frozenset[str] = frozenset()
    writes: Tools
    stateful: frozenset[str] = frozenset()
    probe: str
    write: str
    answered: Sequence[str]
    requests: Callable[[str], Fields]
    background: Callable[[Mapping[str, Any]], bool] = lambda entry: False
    rules: Callable[[str], Fields] = lambda tool: {}
    silence: Fields = field(default_factory=lambda: {"drop": True})
    image: Sequence[str]
    unfit: Sequence[Unfit]
    bad_settings: Sequence[tuple[str, str]]
    unknown_host: Fields
    farewell: Sequence[str]
    concurrent: bool = True
    readmitted: Callable[[str], Fields] | None = None

    @property
    def tools(self) -> Tools:
        """Every tool with its arguments."""
        return {**self.reads, **self.writes}

    def __str__(self) -> str:
        return self.protocol


# -- Modbus ------------------------------------------------------------------------------------------------------

MODBUS_TAGS: dict[str, dict[str, Any]] = {
    "valve": {"address": 30, "scale": 0.1, "unit": "%", "writable": True},
    "negative": {"address": 31, "type": "int16", "scale": -0.5, "offset": 10, "writable": True},
    "counter": {"address": 32, "type": "uint64", "writable": True},
    "speed": {"address": 36, "type": "float32", "order": "CDAB", "writable": True},
    "locked": {"address": 38},
    "inlet": {"table": "input", "address": 40, "type": "int16", "scale": 0.1, "unit": "degC"},
}


def _modbus_settings(port: int, name: str, folder: Path) -> dict[str, str]:
    tags = folder / "tags.json"
    tags.write_text(json.dumps(MODBUS_TAGS))
    return {"MODBUS_HOST": "127.0.0.1", "MODBUS_PORT": str(port), "MODBUS_TAG_MAP": str(tags)}


MODBUS = Case(
    protocol="modbus",
    settings=_modbus_settings,
    prefix="MODBUS",
    reads={
        "ping": {},
        "read_register": {"address": 20},
        "read_multiple_holding_registers": {"address": 20, "count": 2},
        "read_input_registers": {"address": 20, "count": 2},
        "read_coils": {"address": 20, "count": 9},
        "read_discrete_inputs": {"address": 20, "count": 9},
        "read_holding_typed": {"address": 20, "data_type": "float32"},
        "read_input_typed": {"address": 20, "data_type": "int32"},
        "read_device_information": {},
        "list_tags": {},
        "read_tag": {"tag": "valve"},
    },
    silent=frozenset({"list_tags"}),
    writes={
        "write_register": {"address": 20, "value": 7},
        "write_registers": {"address": 20, "values": [7, 8]},
        "write_coil": {"address": 20, "value": True},
        "write_coils_bulk": {"address": 20, "values": [True, False, True]},
        "mask_write_register": {"address": 20, "and_mask": 0xF2, "or_mask": 0x25},
        "write_tag": {"tag": "valve", "value": 12.5},
    },
    probe="ping",
    write="write_register",
    answered=(
        "write_register",
        "write_registers",
        "write_coil",
        "write_coils_bulk",
        "mask_write_register",
        "write_tag",
    ),
    requests=lambda tool: {"kind": "request"},
    image=("units",),
    unfit=(
        Unfit("write_register", {"address": 1, "value": 70000}, "range_overflow"),
        Unfit("write_register", {"address": 1, "value": -1}, "range_overflow"),
        Unfit("write_register", {"address": 1, "value": 40.7}, "invalid_input"),
        Unfit("write_register", {"address": 1, "value": 1, "unit": 7}, "invalid_input"),
        Unfit("write_register", {"address": 65536, "value": 1}, "invalid_input"),
        Unfit("write_register", {"address": -1, "value": 1}, "invalid_input"),
        Unfit("write_register", {"address": 1, "value": 1, "unit_id": 256}, "invalid_input"),
        Unfit("write_register", {"address": 1, "value": 1, "unit_id": 248}, "invalid_input"),
        Unfit("write_register", {"address": 1, "value": 1, "unit_id": None}, "invalid_input"),
        Unfit("write_registers", {"address": 0, "values": [1] * 124}, "limit_exceeded"),
        Unfit("write_registers", {"address": 0, "values": []}, "invalid_input"),
        Unfit("write_registers", {"address": 0, "values": [1, 65536]}, "range_overflow"),
        Unfit("write_registers", {"address": 65535, "values": [1, 2]}, "invalid_input"),
        Unfit("write_coil", {"address": 0, "value": 1}, "invalid_input"),
        Unfit("write_coils_bulk", {"address": 0, "values": [True] * 1969}, "limit_exceeded"),
        Unfit("mask_write_register", {"address": 0, "and_mask": 65536, "or_mask": 0}, "range_overflow"),
        Unfit("read_multiple_holding_registers", {"address": 0, "count": 2001}, "limit_exceeded"),
        Unfit("read_multiple_holding_registers", {"address": 0, "count": 0}, "invalid_input"),
        Unfit("read_multiple_holding_registers", {"address": 0, "count": -1}, "invalid_input"),
        Unfit("read_multiple_holding_registers", {"address": 65535, "count": 2}, "invalid_input"),
        Unfit("read_coils", {"address": 0, "count": 2001}, "limit_exceeded"),
        Unfit("read_holding_typed", {"address": 65535, "data_type": "float32"}, "invalid_input"),
        Unfit("read_holding_typed", {"address": 0, "data_type": "float16"}, "invalid_input"),
    ),
    bad_settings=(
        ("MODBUS_PORT", "many"),
        ("MODBUS_PORT", "70000"),
        ("MODBUS_UNIT_ID", "250"),
        ("MODBUS_TIMEOUT_S", "nan"),
        ("MODBUS_DEADLINE_S", "-1"),
        ("MODBUS_TAG_MAP", "/does/not/exist.json"),
        ("MODBUS_TLS_CA", "/does/not/exist.pem"),
    ),
    unknown_host={"MODBUS_HOST": "no-such-host.invalid"},
    farewell=("DISCONNECTED",),
    concurrent=False,
)

# -- BACnet ------------------------------------------------------------------------------------------------------

BACNET_ALIASES: dict[str, dict[str, Any]] = {
    "zone": {"device_id": 12345, "object_type": "analog-input", "object_instance": 1, "unit": "degF"},
    "valve": {
        "device_id": 12345,
        "object_type": "analog-output",
        "object_instance": 1,
        "writable": True,
        "priority": 10,
    },
}


def _bacnet_settings(port: int, name: str, folder: Path) -> dict[str, str]:
    aliases = folder / "aliases.json"
    aliases.write_text(json.dumps(BACNET_ALIASES))
    return {"BACNET_HOST": "127.0.0.1", "BACNET_PORT": str(port), "BACNET_ALIAS_MAP": str(aliases)}


_ZONE = {"device_id": 12345, "object_type": "analog-input", "object_instance": 1}
_VALVE = {"device_id": 12345, "object_type": "analog-output", "object_instance": 1}

BACNET = Case(
    protocol="bacnet",
    settings=_bacnet_settings,
    prefix="BACNET",
    reads={
        "ping": {},
        "discover_devices": {"timeout_ms": 50},
        "list_objects": {"device_id": 12345},
        "read_property": _ZONE,
        "read_object_by_alias": {"alias": "zone"},
    },
    writes={
        "write_property": {**_VALVE, "value": 40.5},
        "write_object_by_alias": {"alias": "valve", "value": 41.5},
    },
    probe="ping",
    write="write_property",
    answered=("write_property", "write_object_by_alias"),
    requests=lambda tool: {"kind": "request"},
    image=("points",),
    unfit=(
        Unfit("write_property", {**_VALVE, "value": "abc"}, "type_mismatch", in_tool=True),
        Unfit("write_property", {**_VALVE, "value": True}, "type_mismatch", in_tool=True),
        Unfit("write_property", {**_VALVE, "value": 1e39}, "range_overflow", in_tool=True),
        Unfit("write_property", {**_VALVE, "value": 1.0, "priority": 17}, "invalid_input"),
        Unfit("write_property", {**_VALVE, "value": 1.0, "priority": 6}, "invalid_input"),
        Unfit("write_property", {**_VALVE, "value": 1.0, "property_id": "no-such"}, "invalid_input", in_tool=True),
        Unfit(
            "write_property", {**_VALVE, "value": 1.0, "property_id": "object-list"}, "writes_disabled", in_tool=True
        ),
        Unfit("write_property", {**_VALVE, "object_type": "binary-output", "value": 2}, "range_overflow", in_tool=True),
        Unfit("write_property", {**_VALVE, "object_instance": 4194303, "value": 1.0}, "invalid_input"),
        Unfit("write_object_by_alias", {"alias": "zone", "value": 1.0}, "not_writable", in_tool=True),
        Unfit("write_object_by_alias", {"alias": "nobody", "value": 1.0}, "illegal_address", in_tool=True),
        Unfit("read_property", {**_ZONE, "device_id": -1}, "invalid_input"),
        Unfit("read_property", {**_ZONE, "object_type": "thermometer"}, "invalid_input"),
        Unfit("discover_devices", {"timeout_ms": 0}, "invalid_input"),
    ),
    bad_settings=(
        ("BACNET_PORT", "many"),
        ("BACNET_PRIORITY", "6"),
        ("BACNET_PRIORITY", "17"),
        ("BACNET_TIMEOUT_S", "nan"),
        ("BACNET_ALIAS_MAP", "/does/not/exist.json"),
    ),
    unknown_host={"BACNET_HOST": "no-such-host.invalid"},
    farewell=(),
)

# -- DNP3 --------------------------------------------------------------------------------------------------------

DNP3_ALIASES: dict[str, dict[str, Any]] = {
    "level": {"outstation_address": 10, "point_type": "analog_input", "index": 1, "unit": "m"},
    "flow": {"outstation_address": 10, "point_type": "analog_input", "index": 7, "unit": "m3/h"},
    "stale": {"outstation_address": 10, "point_type": "analog_input", "index": 6},
    "pulses": {"outstation_address": 10, "point_type": "counter", "index": 1},
    "pump": {"outstation_address": 10, "point_type": "binary_output", "index": 2, "writable": True},
    "setpoint": {
        "outstation_address": 10,
        "point_type": "analog_output",
        "index": 0,
        "data_type": "float32",
        "writable": True,
    },
    "limited": {
        "outstation_address": 10,
        "point_type": "analog_output",
        "index": 2,
        "data_type": "float64",
        "writable": True,
    },
    "batch": {
        "outstation_address": 10,
        "point_type": "analog_output",
        "index": 3,
        "data_type": "int32",
        "writable": True,
    },
    "short": {
        "outstation_address": 10,
        "point_type": "analog_output",
        "index": 3,
        "data_type": "int16",
        "writable": True,
    },
    "note": {"outstation_address": 10, "point_type": "octet_string", "index": 0, "writable": True},
    "beyond": {"outstation_address": 10, "point_type": "binary_output", "index": 300, "writable": True},
}


def _dnp3_settings(port: int, name: str, folder: Path) -> dict[str, str]:
    aliases = folder / "aliases.json"
    aliases.write_text(json.dumps(DNP3_ALIASES))
    return {"DNP3_HOST": "127.0.0.1", "DNP3_PORT": str(port), "DNP3_ALIAS_MAP": str(aliases)}


_INPUTS = {"outstation_address": 10, "start_index": 0, "count": 4}
_PUMP = {"outstation_address": 10, "index": 2}

DNP3 = Case(
    protocol="dnp3",
    settings=_dnp3_settings,
    prefix="DNP3",
    reads={
        "ping": {},
        "read_binary_inputs": _INPUTS,
        "read_analog_inputs": _INPUTS,
        "poll_class": {"outstation_address": 10, "event_class": 1},
        "list_points": {},
        "read_point_by_alias": {"alias": "level"},
    },
    silent=frozenset({"list_points"}),
    writes={
        "write_binary_output": {**_PUMP, "value": True},
        "write_point_by_alias": {"alias": "setpoint", "value": 41.5},
    },
    probe="ping",
    write="write_binary_output",
    answered=("write_binary_output", "write_point_by_alias"),
    requests=lambda tool: {"request": True},
    image=("points",),
    unfit=(
        Unfit("read_binary_inputs", {**_INPUTS, "outstation_address": 65520}, "invalid_input"),
        Unfit("read_binary_inputs", {**_INPUTS, "count": 501}, "limit_exceeded"),
        Unfit("read_binary_inputs", {**_INPUTS, "count": 0}, "invalid_input"),
        Unfit("read_analog_inputs", {**_INPUTS, "start_index": 65535, "count": 2}, "invalid_input"),
        Unfit("read_analog_inputs", {**_INPUTS, "start_index": -1}, "invalid_input"),
        Unfit("poll_class", {"outstation_address": 10, "event_class": 4}, "invalid_input"),
        Unfit("read_point_by_alias", {"alias": "nobody"}, "illegal_address", in_tool=True),
        Unfit("write_binary_output", {**_PUMP, "value": 1}, "invalid_input"),
        Unfit("write_binary_output", {**_PUMP, "value": "true"}, "invalid_input"),
        Unfit("write_binary_output", {**_PUMP, "outstation_address": 65535, "value": True}, "invalid_input"),
        Unfit("write_binary_output", {**_PUMP, "value": True, "code": "latch_off"}, "invalid_input"),
        Unfit("write_binary_output", {**_PUMP, "value": True, "code": "trip"}, "invalid_input"),
        Unfit("write_binary_output", {**_PUMP, "value": True, "on_time_ms": 100}, "invalid_input"),
        Unfit(
            "write_binary_output", {**_PUMP, "value": True, "mode": "direct_operate"}, "writes_disabled", in_tool=True
        ),
        Unfit("write_point_by_alias", {"alias": "level", "value": 1}, "not_writable", in_tool=True),
        Unfit("write_point_by_alias", {"alias": "nobody", "value": 1}, "illegal_address", in_tool=True),
        Unfit("write_point_by_alias", {"alias": "pump", "value": 1}, "type_mismatch", in_tool=True),
        Unfit("write_point_by_alias", {"alias": "setpoint", "value": True}, "type_mismatch", in_tool=True),
        Unfit("write_point_by_alias", {"alias": "setpoint", "value": "7"}, "type_mismatch", in_tool=True),
        Unfit("write_point_by_alias", {"alias": "setpoint", "value": 1e39}, "range_overflow", in_tool=True),
        Unfit("write_point_by_alias", {"alias": "batch", "value": 2**31}, "range_overflow", in_tool=True),
        Unfit("write_point_by_alias", {"alias": "batch", "value": 1.5}, "type_mismatch", in_tool=True),
        Unfit("write_point_by_alias", {"alias": "short", "value": 32768}, "range_overflow", in_tool=True),
        Unfit("write_point_by_alias", {"alias": "note", "value": 7}, "type_mismatch", in_tool=True),
        Unfit("write_point_by_alias", {"alias": "note", "value": ""}, "limit_exceeded", in_tool=True),
        Unfit("write_point_by_alias", {"alias": "note", "value": "x" * 256}, "limit_exceeded", in_tool=True),
    ),
    bad_settings=(
        ("DNP3_PORT", "many"),
        ("DNP3_OUTSTATION_ADDRESS", "65520"),
        ("DNP3_MASTER_ADDRESS", "-1"),
        ("DNP3_TIMEOUT_S", "nan"),
        ("DNP3_ALIAS_MAP", "/does/not/exist.json"),
        ("DNP3_TLS_CA", "/does/not/exist.pem"),
    ),
    unknown_host={"DNP3_HOST": "no-such-host.invalid"},
    farewell=("DISCONNECTED",),
    concurrent=False,
)

# -- MQTT --------------------------------------------------------------------------------------------------------

_METRIC = {"name": "level", "datatype": "Int32", "value": 1}
_PACKETS = {"get_broker_info": "UNSUBSCRIBE", "publish_message": "PUBLISH"}


def _mqtt_settings(port: int, name: str, folder: Path) -> dict[str, str]:
    return {"MQTT_URL": f"mqtt://127.0.0.1:{port}", "MQTT_CLIENT_ID": f"mqtt-tests-{name}"}


MQTT = Case(
    protocol="mqtt",
    settings=_mqtt_settings,
    prefix="MQTT",
    reads={
        "get_broker_info": {},
        "subscribe_topic": {"topic": "reads/#"},
        "read_messages": {"topic": "reads/#"},
        "list_subscriptions": {},
        "unsubscribe_topic": {"topic": "reads/#"},
        "list_sparkplug_nodes": {},
        "read_sparkplug_device": {"edge_node_id": "edge-node-1", "device_id": "device-1"},
        "decode_sparkplug_payload": {"payload": ""},
    },
    silent=frozenset({"read_messages", "list_subscriptions", "decode_sparkplug_payload"}),
    writes={
        "publish_message": {"topic": "plain/denied", "payload": "x", "qos": 1, "retain": True},
        "publish_node_birth": {"metrics": [_METRIC]},
        "publish_node_death": {},
        "publish_device_birth": {"device_id": "d", "metrics": [_METRIC]},
        "publish_device_death": {"device_id": "d"},
        "publish_node_data": {"metrics": [{"name": "level", "value": 1}]},
        "publish_device_data": {"device_id": "d", "metrics": [{"name": "level", "value": 1}]},
        "publish_node_command": {"edge_node_id": "n", "metrics": [_METRIC]},
        "publish_device_command": {"edge_node_id": "n", "device_id": "d", "metrics": [_METRIC]},
    },
    stateful=frozenset({"publish_node_death", "publish_device_death", "publish_node_data", "publish_device_data"}),
    probe="get_broker_info",
    write="publish_message",
    answered=("publish_message",),
    requests=lambda tool: {"kind": _PACKETS[tool], "direction": "in"},
    rules=lambda tool: {"packet": _PACKETS[tool]},
    background=lambda entry: entry["kind"] == "PINGREQ",
    silence={"no_answer": True},
    image=("retained", "edge_node"),
    unfit=(
        *(
            Unfit("publish_message", {"payload": "x", **arguments}, code, in_tool=in_tool)
            for arguments, code, in_tool in (
                ({"topic": ""}, "invalid_input", True),
                ({"topic": "a/+"}, "invalid_input", True),
                ({"topic": "a/#"}, "invalid_input", True),
                ({"topic": "a\0b"}, "invalid_input", True),
                ({"topic": "$SYS/x"}, "invalid_input", True),
                ({"topic": "ü" * 32_768}, "invalid_input", True),
                ({"topic": "spBv1.0/factory/DDATA/edge-node-1/device-1"}, "invalid_input", True),
                ({"topic": "a\ud800"}, "invalid_input", False),
                ({"topic": "a", "payload": "\ud800"}, "invalid_input", False),
                ({"topic": "a", "payload": "###", "encoding": "base64"}, "invalid_input", True),
                ({"topic": "a", "encoding": "latin-1"}, "invalid_input", False),
                ({"topic": "a", "payload": "x" * (1024 * 1024 + 1)}, "limit_exceeded", True),
                ({"topic": "a", "payload": "x" * (2 * 1024 * 1024 + 1)}, "limit_exceeded", False),
                ({"topic": "a", "qos": 3}, "invalid_input", False),
                ({"topic": "a", "qos": -1}, "invalid_input", False),
                ({"topic": "a", "qos": True}, "invalid_input", False),
                ({"topic": "a", "qos": "1"}, "invalid_input", False),
                ({"topic": "a", "retain": 1}, "invalid_input", False),
                ({"topic": "a", "payload": 5}, "invalid_input", False),
                ({"topic": "a", "payload": {"speed": 5}}, "invalid_input", False),
                ({"topic": "a", "payload": None}, "invalid_input", False),
                ({"topic": "a", "quality": 1}, "invalid_input", False),
            )
        ),
        Unfit("publish_message", {"topic": "a"}, "invalid_input"),
        Unfit("subscribe_topic", {"topic": "sensors/#", "qos": 5}, "invalid_input"),
        *(
            Unfit("subscribe_topic", {"topic": topic}, "invalid_input", in_tool=True)
            for topic in ("", "a#", "a/#/b", "a/b+", "$share/g/a")
        ),
        Unfit("unsubscribe_topic", {"topic": "a#"}, "invalid_input", in_tool=True),
        Unfit("read_messages", {"topic": "a#"}, "invalid_input", in_tool=True),
        Unfit("read_messages", {"topic": "#", "limit": 0}, "invalid_input"),
        Unfit("read_messages", {"topic": "#", "limit": 1001}, "invalid_input"),
        Unfit("get_broker_info", {"verbose": True}, "invalid_input"),
    ),
    bad_settings=(
        ("MQTT_URL", "tcp://127.0.0.1:1883"),
        ("MQTT_URL", "mqtt://127.0.0.1:x"),
        ("MQTT_URL", "mqtt://"),
        ("MQTT_URL", "mqtt://user:canary@127.0.0.1"),
        ("SPARKPLUG_GROUP_ID", "a/b"),
        ("SPARKPLUG_EDGE_NODE_ID", ""),
        ("MQTT_TIMEOUT_S", "0"),
        ("MQTT_TLS_CA", "/does/not/exist.pem"),
    ),
    unknown_host={"MQTT_URL": "mqtt://no-such-host.invalid"},
    farewell=("DISCONNECT", "DISCONNECTED"),
    readmitted=lambda name: {"kind": "CONNACK", "client_id": f"mqtt-tests-{name}", "reason_codes": [0]},
)

# -- OPC UA ------------------------------------------------------------------------------------------------------

_FAN, _TEMPERATURE = "ns=2;s=FanSpeed", "ns=2;s=Temperature"
_METHOD = {"object_id": "ns=2;s=Methods", "method_id": "ns=2;s=SetProductionRate"}
_SERVICES = {"call_opcua_method": "Call", "read_opcua_node": "Read"}
# The Read with which the library of another adapter checks its server must not use a rule up.
_SERVICE_RULES = {
    "call_opcua_method": {"service": "Call"},
    "read_opcua_node": {"service": "Read", "node": _TEMPERATURE},
}


def _opcua_settings(port: int, name: str, folder: Path) -> dict[str, str]:
    return {"OPCUA_URL": f"opc.tcp://127.0.0.1:{port}"}


def _is_watchdog(entry: Mapping[str, Any]) -> bool:
    """Recognise the Read of ServerStatus.State by which the library checks once a minute that the server is alive."""
    return entry.get("nodes") == [{"node_id": "i=2259", "attribute": "Value"}]


OPCUA = Case(
    protocol="opcua",
    settings=_opcua_settings,
    prefix="OPCUA",
    reads={
        "read_opcua_node": {"node_id": _TEMPERATURE},
        "read_multiple_opcua_nodes": {"node_ids": [_TEMPERATURE, "ns=2;s=Mode"]},
        "browse_opcua_node_children": {"node_id": "ns=2;s=Actuators"},
        "get_all_variables": {},
    },
    writes={
        "write_opcua_node": {"node_id": _FAN, "value": 12.5},
        "write_multiple_opcua_nodes": {
            "items": [{"node_id": _FAN, "value": 12.5}, {"node_id": "ns=2;s=AlarmActive", "value": True}]
        },
        "call_opcua_method": {**_METHOD, "arguments": [120]},
    },
    probe="read_opcua_node",
    write="write_opcua_node",
    answered=("write_opcua_node", "write_multiple_opcua_nodes", "call_opcua_method"),
    requests=lambda tool: {"kind": _SERVICES.get(tool, "Write"), "direction": "in"},
    background=_is_watchdog,
    rules=lambda tool: _SERVICE_RULES.get(tool, {"service": "Write"}),
    image=("variables", "folders", "methods"),
    unfit=(
        Unfit("read_opcua_node", {}, "invalid_input"),
        Unfit("read_opcua_node", {"node_id": 5}, "invalid_input"),
        Unfit("read_opcua_node", {"node_id": ""}, "invalid_input"),
        Unfit("read_opcua_node", {"node_id": "garbage"}, "invalid_input", in_tool=True),
        Unfit("read_opcua_node", {"node_id": "s=" + "x" * 5000}, "limit_exceeded"),
        Unfit("read_opcua_node", {"node_id": _TEMPERATURE, "attribute": 4}, "invalid_input"),
        Unfit("read_opcua_node", {"node_id": _TEMPERATURE, "url": "opc.tcp://127.0.0.1:1"}, "invalid_input"),
        Unfit("read_multiple_opcua_nodes", {"node_ids": []}, "invalid_input"),
        Unfit("read_multiple_opcua_nodes", {"node_ids": [_TEMPERATURE] * 1001}, "limit_exceeded"),
        Unfit("read_multiple_opcua_nodes", {"node_ids": _TEMPERATURE}, "invalid_input"),
        Unfit("get_all_variables", {"depth": 3}, "invalid_input"),
        Unfit("write_opcua_node", {"node_id": _FAN}, "invalid_input"),
        Unfit("write_opcua_node", {"node_id": _FAN, "value": 1, "type": "Double"}, "invalid_input"),
        Unfit("write_opcua_node", {"node_id": "FanSpeed", "value": 1}, "invalid_input", in_tool=True),
        Unfit("write_multiple_opcua_nodes", {"items": [{"node_id": _FAN, "value": 1}] * 1001}, "limit_exceeded"),
        Unfit("call_opcua_method", {**_METHOD, "arguments": 1}, "invalid_input"),
        Unfit("call_opcua_method", {**_METHOD, "arguments": [1] * 101}, "limit_exceeded"),
    ),
    bad_settings=(
        ("OPCUA_URL", "opc.tcp://127.0.0.1:many"),
        ("OPCUA_URL", "http://127.0.0.1:4840"),
        ("OPCUA_URL", "opc.tcp://"),
        ("OPCUA_TIMEOUT_S", "nan"),
        ("OPCUA_DEADLINE_S", "-1"),
    ),
    unknown_host={"OPCUA_URL": "opc.tcp://no-such-host.invalid:4840"},
    farewell=("CloseSession", "CloseSecureChannel", "DISCONNECTED"),
)

# -- S7comm ------------------------------------------------------------------------------------------------------

S7_TAGS: dict[str, dict[str, Any]] = {
    "valve": {"db": 10, "start": 0, "type": "INT", "unit": "%", "writable": True},
    "rate": {"db": 10, "start": 8, "type": "REAL", "writable": True},
    "manual": {"area": "M", "start": 3, "bit": 5, "type": "BOOL", "writable": True},
    "temperature": {"db": 1, "start": 16, "type": "REAL", "unit": "degC"},
}
_VALVE = {"db_number": 10, "start_offset": 0, "data_type": "INT"}
_S7_SERVICES = {"ping": "szl"}


def _s7_settings(port: int, name: str, folder: Path) -> dict[str, str]:
    tags = folder / "tags.json"
    tags.write_text(json.dumps(S7_TAGS))
    return {"S7_HOST": "127.0.0.1", "S7_PORT": str(port), "S7_TAG_MAP": str(tags), "S7_CONTROL_ENABLED": "true"}


def _refused_value(data_type: str, value: object, code: str) -> Unfit:
    arguments = {"db_number": 10, "start_offset": 0, "data_type": data_type, "value": value}
    return Unfit("write_db", arguments, code, in_tool=True)


S7 = Case(
    protocol="s7",
    settings=_s7_settings,
    prefix="S7",
    reads={
        "ping": {},
        "get_connection_status": {},
        "read_plc_info": {},
        "read_cpu_state": {},
        "read_system_time": {},
        "read_szl": {"szl_id": 0x0424},
        "read_db": {"db_number": 1, "start_offset": 0, "size": 20},
        "read_db_typed": _VALVE,
        "read_input": {"start_byte": 0, "size": 1},
        "read_output": {"start_byte": 0, "size": 1},
        "read_marker": {"start_byte": 3, "size": 1},
        "read_multiple_vars": {
            "variables": [
                {"area": "DB", "db_number": 1, "start_byte": 16, "data_type": "REAL"},
                {"area": "Q", "start_byte": 0, "data_type": "BOOL"},
            ]
        },
        "list_tags": {},
        "read_tag": {"name": "valve"},
    },
    silent=frozenset({"list_tags"}),
    writes={
        "write_db": {**_VALVE, "value": 7},
        "write_output": {"start_byte": 0, "data_type": "BOOL", "value": False},
        "write_marker": {"start_byte": 3, "bit_index": 5, "data_type": "BOOL", "value": True},
        "write_multiple_vars": {
            "variables": [
                {"area": "DB", "db_number": 10, "start_byte": 2, "data_type": "BYTE", "value": 7},
                {"area": "M", "start_byte": 3, "bit_index": 5, "data_type": "BOOL", "value": True},
            ]
        },
        "write_tag": {"name": "rate", "value": 12.5},
        "set_cpu_state": {"state": "STOP"},
    },
    probe="ping",
    write="write_db",
    answered=("write_db", "write_output", "write_marker", "write_multiple_vars", "write_tag"),
    requests=lambda tool: {"kind": "request", "service": _S7_SERVICES.get(tool, "write")},
    rules=lambda tool: {"service": _S7_SERVICES.get(tool, "write")},
    image=("areas", "cpu"),
    unfit=(
        _refused_value("INT", 70000, "range_overflow"),
        _refused_value("UINT", -1, "range_overflow"),
        _refused_value("INT", 40.7, "type_mismatch"),
        _refused_value("INT", True, "type_mismatch"),
        _refused_value("BOOL", 1, "type_mismatch"),
        _refused_value("REAL", "abc", "type_mismatch"),
        _refused_value("REAL", 1e39, "range_overflow"),
        _refused_value("CHAR", "ab", "type_mismatch"),
        _refused_value("CHAR", "\u20ac", "type_mismatch"),
        _refused_value("STRING", "x" * 255, "limit_exceeded"),
        Unfit("write_db", {**_VALVE, "value": [1]}, "invalid_input"),
        Unfit("write_db", {**_VALVE, "value": None}, "invalid_input"),
        Unfit("write_db", {**_VALVE, "value": 1, "bit_index": 1}, "invalid_input"),
        Unfit("write_db", {**_VALVE, "value": 1, "string_length": 5}, "invalid_input"),
        Unfit("write_db", {**_VALVE, "value": 1, "db_number": 0}, "invalid_input"),
        Unfit("write_db", {**_VALVE, "value": 1, "start_offset": -1}, "invalid_input"),
        Unfit("write_db", {**_VALVE, "value": 1, "data_type": "int"}, "invalid_input"),
        Unfit("write_db", {**_VALVE, "value": 1, "rack": 1}, "invalid_input"),
        Unfit("write_output", {"start_byte": 0, "value": "x", "data_type": "STRING"}, "unsupported_operation"),
        Unfit("set_cpu_state", {"state": "HALT"}, "invalid_input"),
        Unfit("read_db", {"db_number": 1, "start_offset": 0, "size": 463}, "limit_exceeded"),
        Unfit("read_db", {"db_number": 1, "start_offset": 0, "size": 0}, "invalid_input"),
        Unfit("read_multiple_vars", {"variables": []}, "invalid_input"),
        Unfit(
            "read_multiple_vars",
            {"variables": [{"area": "M", "start_byte": 0, "data_type": "INT"}] * 21},
            "limit_exceeded",
        ),
        Unfit(
            "read_multiple_vars", {"variables": [{"area": "DB", "start_byte": 0, "data_type": "INT"}]}, "invalid_input"
        ),
    ),
    bad_settings=(
        ("S7_PORT", "many"),
        ("S7_SLOT", "32"),
        ("S7_RACK", "-1"),
        ("S7_TIMEOUT_S", "nan"),
        ("S7_DEADLINE_S", "-1"),
        ("S7_TAG_MAP", "/does/not/exist.json"),
    ),
    unknown_host={"S7_HOST": "no-such-host.invalid"},
    farewell=("DISCONNECTED",),
    concurrent=False,
)

# -- EtherNet/IP -------------------------------------------------------------------------------------------------

ETHERNETIP_ALIASES: dict[str, dict[str, Any]] = {
    "valve": {"tag": "ValvePosition", "unit": "%", "writable": True},
    "manual": {"tag": "Flags.5", "writable": True},
    "temperature": {"tag": "Temperature", "unit": "degC"},
}
_ETHERNETIP_SERVICES = {"ping": "identity", "write_multiple_tags": "multiple"}
_ONE_TAG = {"tag_name": "ValvePosition"}


def _ethernetip_settings(port: int, name: str, folder: Path) -> dict[str, str]:
    aliases = folder / "aliases.json"
    aliases.write_text(json.dumps(ETHERNETIP_ALIASES))
    return {
        "ETHERNETIP_HOST": "127.0.0.1",
        "ETHERNETIP_PORT": str(port),
        "ETHERNETIP_ALIAS_MAP": str(aliases),
        "ETHERNETIP_CONTROL_ENABLED": "true",
    }


ETHERNETIP = Case(
    protocol="ethernetip",
    settings=_ethernetip_settings,
    prefix="ETHERNETIP",
    reads={
        "ping": {},
        "get_connection_status": {},
        "get_plc_info": {},
        "get_plc_time": {},
        "get_tag_list": {},
        "read_tag": {"tag_name": "Temperature"},
        "read_array": {"tag_name": "Levels[2]", "elements": 3},
        "read_string": {"tag_name": "Message"},
        "read_multiple_tags": {"tags": ["MotorSpeed", "Flags.3"]},
        "list_tags": {},
        "read_tag_by_alias": {"alias": "valve"},
    },
    silent=frozenset({"list_tags"}),
    writes={
        "write_tag": {**_ONE_TAG, "value": 7},
        "write_array": {"tag_name": "Counts[3]", "values": [1, -2]},
        "write_string": {"tag_name": "Message", "value": "stopped"},
        "write_multiple_tags": {"payloads": [{**_ONE_TAG, "value": 8}, {"tag_name": "PumpEnabled", "value": False}]},
        "write_tag_by_alias": {"alias": "valve", "value": 9},
        "set_plc_time": {"time": "2031-05-06T07:08:09"},
    },
    probe="ping",
    write="write_tag",
    answered=("write_tag", "write_array", "write_string", "write_multiple_tags", "write_tag_by_alias"),
    requests=lambda tool: {"kind": "request", "service": _ETHERNETIP_SERVICES.get(tool, "write")},
    rules=lambda tool: {"service": _ETHERNETIP_SERVICES.get(tool, "write")},
    image=("points",),
    unfit=(
        *(
            Unfit("write_tag", {"tag_name": name, "value": 1}, "invalid_input")
            for name in (
                "",
                "1st",
                "a b",
                "Valve-Position",
                "Levels[]",
                "Levels[-1]",
                "Levels[1",
                "Flags.",
                ".3",
                "a..b",
                "a\n",
            )
        ),
        Unfit("write_tag", {"tag_name": "x" * 201, "value": 1}, "limit_exceeded"),
        Unfit("write_tag", {**_ONE_TAG, "value": [1]}, "invalid_input"),
        Unfit("write_tag", {**_ONE_TAG, "value": None}, "invalid_input"),
        Unfit("write_tag", {**_ONE_TAG, "value": 1, "data_type": "dint"}, "invalid_input"),
        Unfit("write_tag", {**_ONE_TAG, "value": 1, "data_type": None}, "invalid_input"),
        Unfit("write_tag", {**_ONE_TAG, "value": 1, "slot": 1}, "invalid_input"),
        Unfit("write_array", {"tag_name": "Counts", "values": []}, "invalid_input"),
        Unfit("write_array", {"tag_name": "Counts", "values": [1] * 2001}, "limit_exceeded"),
        Unfit("write_array", {"tag_name": "Flags.3", "values": [True]}, "invalid_input", in_tool=True),
        Unfit("write_string", {"tag_name": "Message", "value": 5}, "invalid_input"),
        Unfit("write_multiple_tags", {"payloads": []}, "invalid_input"),
        Unfit("write_multiple_tags", {"payloads": [{**_ONE_TAG, "value": 1}] * 51}, "limit_exceeded"),
        Unfit("write_tag_by_alias", {"alias": "temperature", "value": 1}, "not_writable", in_tool=True),
        Unfit("write_tag_by_alias", {"alias": "nobody", "value": 1}, "illegal_address", in_tool=True),
        Unfit("set_plc_time", {"time": "yesterday"}, "invalid_input"),
        Unfit("set_plc_time", {"time": "1969-12-31T23:59:59"}, "range_overflow"),
        Unfit("set_plc_time", {}, "invalid_input"),
        Unfit("read_array", {"tag_name": "Levels", "elements": 0}, "invalid_input"),
        Unfit("read_array", {"tag_name": "Levels", "elements": 2001}, "limit_exceeded"),
        Unfit("read_array", {"tag_name": "Flags.3", "elements": 1}, "invalid_input", in_tool=True),
        Unfit("read_multiple_tags", {"tags": []}, "invalid_input"),
        Unfit("read_multiple_tags", {"tags": ["MotorSpeed"] * 51}, "limit_exceeded"),
        Unfit("get_tag_list", {"program": "MainProgram"}, "invalid_input"),
    ),
    bad_settings=(
        ("ETHERNETIP_PORT", "many"),
        ("ETHERNETIP_SLOT", "17"),
        ("ETHERNETIP_TIMEOUT_S", "nan"),
        ("ETHERNETIP_DEADLINE_S", "-1"),
        ("ETHERNETIP_ALIAS_MAP", "/does/not/exist.json"),
        ("ETHERNETIP_TLS_CA", "/does/not/exist.pem"),
    ),
    unknown_host={"ETHERNETIP_HOST": "no-such-host.invalid"},
    farewell=("forward_close", "unregister", "DISCONNECTED"),
    concurrent=False,
)

CASES = (MODBUS, MQTT, OPCUA, S7, ETHERNETIP)
