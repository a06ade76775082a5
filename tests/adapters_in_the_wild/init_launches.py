"""How a new user would call ``otmcp init`` for public adapters, and what it then has to find out about each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

__all__ = ["LAUNCHES", "Launch"]

_HOME = ".ot-aiops/config.yaml=endpoints:\n  - {{ name: here, protocol: {}, {} }}\n"


@dataclass(frozen=True, slots=True, kw_only=True)
class Launch:
    """One adapter of ``docs/examples``, with one of the protocols that it speaks.

    Attributes:
        example: name of the example, in whose environment it is installed.
        command: how it is started, from the directory in which its environment lies.
        proven: operations that are bound, each to the tool; a binding that is proven is right.
        unfilled: operations whose tool is proven, and whose result is left to fill in.
        commands: tools that are bound by a named command, with the effect that the device saw.
        guard: the variable or option that disables writes; None where nothing does.
        left: the number of entries that are left to fill in.
        env, files: what its documentation asks for.
    """

    example: str
    protocol: str
    command: tuple[str, ...]
    proven: Mapping[str, str]
    left: int
    guard: str | None = None
    unfilled: Mapping[str, str] = field(default_factory=dict)
    commands: tuple[str, ...] = ()
    env: Mapping[str, str] = field(default_factory=dict)
    files: tuple[str, ...] = ()
    url: str | None = None

    @property
    def name(self) -> str:
        """Name of the example and the protocol."""
        return f"{self.example} {self.protocol}"

    def options(self) -> list[str]:
        """Return the command line for ``otmcp init`` without the adapter's command."""
        options = ["--protocol", self.protocol, *(() if self.url is None else ("--url", self.url))]
        for name, value in self.env.items():
            options += ["--env", f"{name}={value}"]
        for file in self.files:
            options += ["--file", file]
        return options


LAUNCHES = (
    Launch(
        example="kukapay-modbus-mcp",
        protocol="modbus",
        command=(".venv/bin/modbus-mcp",),
        env={"MODBUS_HOST": "{host}", "MODBUS_PORT": "{port}"},
        proven={
            "read_input": "read_input_registers",
            "read_holding": "read_multiple_holding_registers",
            "read_coils": "read_coils",
            "write_holding": "write_register",
            "write_coil": "write_coil",
        },
        left=2,
    ),
    Launch(
        example="modbus-connector-mcp",
        protocol="modbus",
        command=(".venv/bin/modbus-connector-mcp",),
        proven={"read_input": "modbus_read", "read_holding": "modbus_read", "write_holding": "modbus_write"},
        guard="--read-only",
        left=1,
    ),
    Launch(
        example="plctap",
        protocol="modbus",
        command=(".venv/bin/plctap",),
        env={"PLCTAP_AUDIT_LOG": "{work}/audit.jsonl"},
        proven={"ping": "probe_device", "read_holding": "plc_read", "write_holding": "plc_write"},
        guard="PLCTAP_ALLOW_WRITE",
        left=1,
    ),
    Launch(
        example="plctap",
        protocol="opcua",
        command=(".venv/bin/plctap",),
        env={"PLCTAP_AUDIT_LOG": "{work}/audit.jsonl"},
        proven={"read": "plc_read", "browse": "plc_browse"},
        left=4,
    ),
    Launch(
        example="ezhuk-modbus-mcp",
        protocol="modbus",
        command=(".venv/bin/modbus-mcp", "--host", "127.0.0.1", "--port", "{http_port}"),
        url="http://127.0.0.1:{http_port}/mcp",
        env={"MODBUS_MCP_MODBUS__HOST": "{host}", "MODBUS_MCP_MODBUS__PORT": "{port}"},
        proven={
            "read_input": "read_registers",
            "read_holding": "read_registers",
            "read_coils": "read_coils",
            "read_discrete_inputs": "read_discrete_inputs",
            "write_holding": "write_register",
            "mask_write": "mask_write_register",
            "write_coil": "write_coil",
            "write_coils": "write_coils",
            "write_registers": "write_registers",
        },
        left=2,
    ),
    Launch(
        example="ot-aiops",
        protocol="modbus",
        command=(".venv/bin/ot-aiops-mcp",),
        env={"HOME": "{work}"},
        files=(_HOME.format("modbus", 'host: "{host}", port: {port}, unit_id: 1'),),
        proven={"read_input": "modbus_read_input", "read_holding": "modbus_read_holding"},
        left=2,
    ),
    Launch(
        example="ot-aiops",
        protocol="mqtt",
        command=(".venv/bin/ot-aiops-mcp",),
        env={"HOME": "{work}"},
        files=(_HOME.format("mqtt", 'host: "{host}", port: {port}'),),
        proven={"messages": "mqtt_read_topic", "publish": "mqtt_publish"},
        left=2,
    ),
    Launch(
        example="ot-aiops",
        protocol="opcua",
        command=(".venv/bin/ot-aiops-mcp",),
        env={"HOME": "{work}"},
        files=(_HOME.format("opcua", 'endpoint_url: "{url}"'),),
        proven={"read": "opcua_read_node", "read_many": "opcua_read_many", "browse": "opcua_browse"},
        left=3,
    ),
    Launch(
        example="industriagents",
        protocol="modbus",
        command=(".venv/bin/modbus-mcp",),
        env={"MODBUS_HOST": "{host}", "MODBUS_PORT": "{port}"},
        proven={
            "ping": "ping",
            "read_input": "read_values",
            "read_holding": "read_values",
            "write_holding": "write_values",
            "mask_write": "mask_write_register",
        },
        guard="MODBUS_WRITES_ENABLED",
        left=0,
    ),
    Launch(
        example="industriagents",
        protocol="mqtt",
        command=(".venv/bin/mqtt-mcp",),
        env={"MQTT_BROKER_URL": "{url}"},
        proven={
            "subscribe": "subscribe_topic",
            "messages": "read_messages",
            "publish": "publish_message",
            "unsubscribe": "unsubscribe_topic",
            "subscriptions": "list_subscriptions",
        },
        guard="MQTT_WRITES_ENABLED",
        left=2,
    ),
    Launch(
        example="industriagents",
        protocol="opcua",
        command=(".venv-opcua/bin/opcua-mcp-server",),
        env={"OPCUA_SERVER_URL": "{url}", "OPCUA_PROFILE": "full", "OPCUA_ALLOW_INSECURE_CONTROL": "true"},
        proven={
            "read": "read_opcua_nodes",
            "read_many": "read_opcua_nodes",
            "browse": "browse_opcua_nodes",
            "write": "write_opcua_nodes",
        },
        left=2,
    ),
    Launch(
        example="kukapay-opcua-mcp",
        protocol="opcua",
        command=(".venv/bin/python", "-c", "import main; main.mcp.run()"),
        env={"OPCUA_SERVER_URL": "{url}"},
        proven={"read": "read_opcua_node", "write": "write_opcua_node"},
        left=5,
    ),
    Launch(
        example="mcmqtt",
        protocol="mqtt",
        command=(".venv/bin/mcmqtt",),
        proven={
            "subscribe": "mqtt_subscribe",
            "publish": "mqtt_publish",
            "unsubscribe": "mqtt_unsubscribe",
            "subscriptions": "mqtt_list_subscriptions",
        },
        left=3,
    ),
    Launch(
        example="mqtt-mcp-server",
        protocol="mqtt",
        command=(".venv/bin/python", "-m", "mqtt_mcp.server"),
        env={"MQTT_HOST": "{host}", "MQTT_PORT": "{port}", "HOME": "{work}"},
        proven={"publish": "publish"},
        unfilled={"messages": "record"},
        left=3,
    ),
    Launch(
        example="mqtt5-mcp-server",
        protocol="mqtt",
        command=(".venv/bin/mqtt5-mcp-server",),
        env={"MQTT_HOST": "{host}", "MQTT_PORT": "{port}", "MQTT_USERNAME": "operator", "MQTT_PASSWORD": "of the mock"},
        proven={"subscribe": "start_subscription", "publish": "publish_message"},
        left=3,
    ),
    Launch(
        example="industriagents-s7comm-mcp",
        protocol="s7",
        command=(".venv/bin/s7comm-mcp",),
        env={"S7_HOST": "{host}", "S7_PORT": "{port}", "S7_SLOT": "1"},
        proven={"read_db": "read_values", "read_typed": "read_values", "write_db": "write_values"},
        guard="S7_WRITES_ENABLED",
        left=0,
    ),
    Launch(
        example="industriagents-bacnet-mcp",
        protocol="bacnet",
        command=(".venv/bin/bacnet-mcp",),
        env={"BACNET_PORT": "{local_port}"},
        proven={"read": "read_property", "write": "write_property"},
        guard="BACNET_WRITES_ENABLED",
        left=0,
    ),
    Launch(
        example="industriagents-ethernetip-mcp",
        protocol="ethernetip",
        command=(".venv/bin/ethernetip-mcp",),
        env={"ENIP_HOST": "{host}", "ENIP_PORT": "{port}"},
        proven={"ping": "get_plc_info", "read_tag": "read_tags", "read_array": "read_tags", "write_tag": "write_tags"},
        guard="ENIP_WRITES_ENABLED",
        left=0,
    ),
    Launch(
        example="industriagents-dnp3-mcp",
        protocol="dnp3",
        command=(".venv/bin/dnp3-mcp",),
        env={"DNP3_HOST": "{host}", "DNP3_PORT": "{port}"},
        proven={"read_binary": "read_inputs", "read_analog": "read_inputs", "write_binary": "control_binary_output"},
        guard="DNP3_WRITES_ENABLED",
        left=0,
    ),
    Launch(
        example="hue-go-mcp",
        protocol="mqtt",
        command=(".venv/bin/hue-go-mcp",),
        env={"MQTT_BROKER": "{host}", "MQTT_PORT": "{port}", "Z2M_DEVICE": "lamp"},
        proven={},
        commands=("set_power", "set_brightness", "set_color_rgb", "set_color_temp"),
        left=4,
    ),
    Launch(
        example="labmcp-modbus",
        protocol="modbus",
        command=(".venv/bin/labmcp-modbus", "--address", "tcp://{host}:{port}"),
        proven={
            "read_input": "read_registers",
            "read_holding": "read_registers",
            "read_coils": "read_coils",
            "read_discrete_inputs": "read_discrete_inputs",
            "write_holding": "write_register",
            "write_coil": "write_coil",
            "write_registers": "write_registers",
        },
        left=1,
    ),
)
