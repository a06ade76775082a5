"""Defects of envelope, session and guard: they could be any adapter's, and one adapter or several have them here."""

from __future__ import annotations

import asyncio
import itertools
import json
import os
from collections.abc import Callable
from typing import Any

from ..core import AdapterError, AdapterServer, Call
from ..core import server as core_server
from .defect import Change, Data, Defect, Handler, around, defect, failing

__all__ = [
    "DEFECTS",
    "answers_twice_from_one_exchange",
    "banner",
    "complains",
    "error_is_a_word",
    "extra_member",
    "is_error_never_set",
    "named_after_exceptions",
    "result",
    "stays",
    "text_says_otherwise",
]

_GONE = ("connect_failed", "connection_lost")


# -- envelope -----------------------------------------------------------------------------------------------


def result(change: Callable[[Data, Callable[[Data], Data]], Data]) -> Change:
    """Return the defect that results are made otherwise.

    Args:
        change: returns the result for an envelope; it is given the genuine function for it as well.
    """

    def apply(server: AdapterServer) -> None:
        genuine = core_server._result
        core_server._result = lambda envelope: change(envelope, genuine)

    return apply


def is_error_never_set(envelope: Data, genuine: Callable[[Data], Data]) -> Data:
    return {**genuine(envelope), "isError": False}


def text_says_otherwise(envelope: Data, genuine: Callable[[Data], Data]) -> Data:
    text = json.dumps({**envelope, "data": None})
    return {**genuine(envelope), "content": [{"type": "text", "text": text}]}


def extra_member(envelope: Data, genuine: Callable[[Data], Data]) -> Data:
    return genuine({**envelope, "status": "ok"})


def error_is_a_word(envelope: Data, genuine: Callable[[Data], Data]) -> Data:
    error = envelope["error"]
    return genuine({**envelope, "error": error and error["code"]})


def named_after_exceptions() -> Callable[[Data, Callable[[Data], Data]], Data]:
    """Return a function that gives errors the names of exceptions, one and then the other."""
    names = itertools.cycle(("ModbusIOException", "ConnectionException"))

    def change(envelope: Data, genuine: Callable[[Data], Data]) -> Data:
        error = envelope["error"]
        return genuine({**envelope, "error": error and {**error, "code": next(names)}})

    return change


def endpoint_with_password(server: AdapterServer) -> None:
    scheme, _, place = server.endpoint.partition("://")
    server.endpoint = f"{scheme}://operator:geheim@{place}"


# -- session ------------------------------------------------------------------------------------------------


def banner(server: AdapterServer) -> None:
    print("Connected to Modbus device", flush=True)


def complains(server: AdapterServer) -> None:
    # While the adapter serves, its own print() goes to stderr.
    stdout = os.dup(1)

    def change(call: Call, error: AdapterError) -> None:
        os.write(stdout, f"Modbus error: {error}\n".encode())

    failing(change=change)(server)


def _dies(call: Call, error: AdapterError) -> None:
    os._exit(1)


def stays(server: AdapterServer) -> None:
    async def for_ever() -> None:
        await asyncio.Event().wait()

    server._close = for_ever


async def rejects_everything(genuine: Handler, call: Call, arguments: Any) -> Data:
    raise AdapterError("access_denied", "this is not allowed", outcome="not_sent" if call.writes else None)


# -- guard --------------------------------------------------------------------------------------------------


def guard_after_sending(name: str) -> Change:
    """Return the defect that a tool writes, and then says that writes are disabled."""

    def apply(server: AdapterServer) -> None:
        enabled = server.writes_enabled

        @around(name, writes=False)
        async def guarded(genuine: Handler, call: Call, arguments: Any) -> Data:
            data = await genuine(call, arguments)
            if enabled:
                return data
            raise AdapterError("writes_disabled", "writes are disabled", outcome="not_sent")

        guarded(server)

    return apply


def enabled_by_default(switch: str) -> Change:
    """Return the defect that writes are enabled unless the switch says otherwise."""

    def apply(server: AdapterServer) -> None:
        server.writes_enabled = server.writes_enabled or switch not in os.environ

    return apply


def enabled_by_any_word(server: AdapterServer) -> None:
    word = os.environ.get("MODBUS_WRITES_ENABLED", "").lower()
    server.writes_enabled = word not in ("", "false", "no", "off", "0")


# -- memory and outages -------------------------------------------------------------------------------------


def answers_from_memory_when_gone(name: str, *, silent: bool = False) -> Change:
    """Return the defect that a tool that finds its device gone answers what it has last found, as a success.

    Args:
        silent: there is no connection that could break: a device that is gone does not answer.
    """
    gone = (*_GONE, "timeout") if silent else _GONE
    memory: dict[str, Data] = {}

    @around(name)
    async def remembering(genuine: Handler, call: Call, arguments: Any) -> Data:
        asked = arguments.model_dump_json()
        try:
            memory[asked] = await genuine(call, arguments)
        except AdapterError as error:
            if error.code not in gone or asked not in memory:
                raise
        return memory[asked]

    return remembering


def succeeds_when_gone(name: str, **said: object) -> Change:
    """Return the defect that a tool that writes and finds its device gone says what it says of a write that was done.

    Args:
        said: of a write, by a tool whose answer has more members than its arguments.
    """
    known: Data = dict(said)

    @around(name)
    async def claiming(genuine: Handler, call: Call, arguments: Any) -> Data:
        given = arguments.model_dump(mode="json", exclude_none=True)
        try:
            known.update(await genuine(call, arguments))
        except AdapterError as error:
            if error.code not in (*_GONE, "timeout"):
                raise
            return {**known, **{name: value for name, value in given.items() if name in known or not known}}
        return dict(known)

    return claiming


def answers_twice_from_one_exchange(name: str) -> Change:
    """Return the defect that every other call with the same arguments is answered from memory, as if from the device.

    A cache that is valid for half a second does this to two calls within this time, on a machine of any speed.
    """
    memory: dict[str, tuple[Data, Call]] = {}

    @around(name)
    async def remembering(genuine: Handler, call: Call, arguments: Any) -> Data:
        asked = arguments.model_dump_json()
        if asked in memory:
            data, earlier = memory.pop(asked)
            call.source, call.attempts, call.trace = earlier.source, earlier.attempts, earlier.trace
            return data
        found: Data = await genuine(call, arguments)
        memory[asked] = found, call
        return found

    return remembering


def never_reconnects() -> Change:
    """Return the defect that a lost connection is never made again."""
    lost = False

    @around()
    async def once(genuine: Handler, call: Call, arguments: Any) -> Data:
        nonlocal lost
        if lost:
            raise AdapterError("connect_failed", "the connection is gone", outcome="not_sent")
        try:
            data = await genuine(call, arguments)
        except AdapterError as error:
            lost = error.code in _GONE
            raise
        return data

    return once


def _written_without_device(
    letters: str, protocol: str, what: str, tool: str, items: str, requirements: str, **said: object
) -> Defect:
    return defect(
        f"MU-14{letters}",
        protocol,
        f"While the device is gone, {what} is told as written.",
        succeeds_when_gone(tool, **said),
        items,
        requirements,
    )


DEFECTS = (
    _written_without_device("g", "modbus", "a register", "write_register", "S10", "WR-001"),
    _written_without_device("gc", "modbus", "a coil", "write_coil", "S10", "WR-001"),
    _written_without_device("gq", "mqtt", "a message", "publish_message", "S11", "MQT-001"),
    _written_without_device(
        "gs",
        "mqtt",
        "a metric of a Sparkplug device",
        "publish_device_data",
        "S11",
        "SPB-001",
        edge_node_id="otmcp-adapter",
        device_id="device-1",
        metric_count=1,
        seq=1,
    ),
    _written_without_device("go", "opcua", "a node", "write_opcua_node", "S12", "OUA-001"),
    _written_without_device("gm", "opcua", "a list of nodes", "write_multiple_opcua_nodes", "S12", "OUA-001"),
    _written_without_device("gk", "s7", "a value of a data block", "write_db", "SK4", "WR-001"),
    _written_without_device("gb", "bacnet", "a property", "write_property", "SB4", "WR-001"),
    _written_without_device("ge", "ethernetip", "a tag", "write_tag", "SE4", "WR-001"),
    _written_without_device("gd", "dnp3", "a binary output", "write_binary_output", "SD4", "WR-001"),
    _written_without_device("gp", "profibus", "all output bytes of a slave", "write_outputs", "SP4", "WR-001"),
    defect(
        "MU-20",
        "modbus",
        "With writes disabled the write is sent, and then denied.",
        guard_after_sending("write_register"),
        "M4",
        "WR-004",
    ),
    defect(
        "MU-20q",
        "mqtt",
        "With writes disabled the message is published, and then denied.",
        guard_after_sending("publish_message"),
        "Q3",
        "WR-004",
    ),
    defect(
        "MU-20s",
        "mqtt",
        "With writes disabled the births of a Sparkplug device are published, and then denied.",
        guard_after_sending("publish_device_birth"),
        "Q4",
        "WR-004",
    ),
    defect(
        "MU-20o",
        "opcua",
        "With writes disabled the Write is sent, and then denied.",
        guard_after_sending("write_opcua_node"),
        "O3",
        "WR-004",
    ),
    defect(
        "MU-21",
        "modbus",
        "Writes are enabled where nobody has said so.",
        enabled_by_default("MODBUS_WRITES_ENABLED"),
        "M4",
        "WR-004",
    ),
    defect(
        "MU-21b",
        "modbus",
        "A write switch with a value that means nothing enables writes.",
        enabled_by_any_word,
        "M4",
        "WR-005",
    ),
    defect(
        "MU-21q",
        "mqtt",
        "Messages and births are published where nobody has allowed it.",
        enabled_by_default("MQTT_WRITES_ENABLED"),
        "Q3 Q4",
        "WR-004",
    ),
    defect(
        "MU-21o",
        "opcua",
        "OPC UA nodes are written where nobody has allowed it.",
        enabled_by_default("OPCUA_WRITES_ENABLED"),
        "O3",
        "WR-004",
    ),
    defect(
        "MU-35",
        "modbus",
        "While the device is gone, a read succeeds with the values that were read before.",
        answers_from_memory_when_gone("read_input_registers"),
        "S10 R-modbus",
        "REC-002",
        recovers=True,
    ),
    defect(
        "MU-35q",
        "mqtt",
        "While the broker is gone, its status is told as it was before.",
        answers_from_memory_when_gone("get_broker_info"),
        "S11 R-mqtt",
        "REC-002",
        recovers=True,
    ),
    defect(
        "MU-35o",
        "opcua",
        "While the server is gone, a read succeeds with the value that was read before.",
        answers_from_memory_when_gone("read_opcua_node"),
        "S12 R-opcua",
        "REC-002",
        recovers=True,
    ),
    defect(
        "MU-36",
        "modbus",
        "A read soon after another is answered from memory, as if from the device.",
        answers_twice_from_one_exchange("read_input_registers"),
        "M2 X1 X1p FX1 S7 S10",
        "ENV-008 RD-001 RD-004",
    ),
    defect(
        "MU-36o",
        "opcua",
        "A node read soon after another is answered from memory, as if from the server.",
        answers_twice_from_one_exchange("read_opcua_node"),
        "O1 O3 FO1 S9 S12",
        "ENV-008 OUA-002 RD-001 RD-004",
    ),
    defect(
        "MU-47",
        "modbus",
        "isError is always false.",
        result(is_error_never_set),
        "M4 FM1 FM2 S10",
        "MCP-006",
        anywhere=True,
    ),
    defect(
        "MU-48",
        "modbus",
        "The text block is JSON, and it is not the structured content.",
        result(text_says_otherwise),
        "M1 M2 M3 M4 X1 X2 X1p X2p FM1 FM2 FX1 S1 S4 S7 S10",
        "MCP-006",
        anywhere=True,
    ),
    defect(
        "MU-49",
        "modbus",
        "A banner is printed to stdout at the start.",
        banner,
        "M1 M2 M3 M4 X1 X2 X1p X2p FM1 FM2 FX1 S1 S4 S7 S10",
        "MCP-001",
        anywhere=True,
    ),
    defect("MU-50", "modbus", "Failures are printed to stdout.", complains, "FM1 S10", "MCP-001", anywhere=True),
    defect(
        "MU-52",
        "modbus",
        "The process does not exit when its stdin ends.",
        stays,
        "M2 M4 R-modbus",
        "MCP-009",
        recovers=True,
        waits=True,
    ),
    defect(
        "MU-99",
        "modbus",
        "meta.endpoint holds user name and password.",
        endpoint_with_password,
        "M1 M2 M3 M4 X1 X2 X1p X2p FM1 FM2 FX1 S1 S4 S7 S10",
        "KEY-001",
        anywhere=True,
    ),
    defect(
        "MU-111",
        "modbus",
        "Every call to the Modbus adapter is refused.",
        around()(rejects_everything),
        "M1 M2 M3 M4 X1 X2 X1p X2p FM1 FM2 FX1 S1 S4 S7 S10",
        "ERR-002 RD-001 REC-001 REC-002 not_proven",
        waits=True,
    ),
    defect(
        "MU-111q",
        "mqtt",
        "Every call to the MQTT adapter is refused.",
        around()(rejects_everything),
        "Q1 Q2 Q3 Q4 X1 X2 X1p X2p FQ1 FQ2 FX1 S2 S5 S8 S11",
        "MQT-002 MQT-004 REC-001 REC-002 not_proven",
        waits=True,
    ),
    defect(
        "MU-111o",
        "opcua",
        "Every call to the OPC UA adapter is refused.",
        around()(rejects_everything),
        "O1 O2 O3 O4 X1 X2 X1p X2p FO1 FO2 FX1 S3 S6 S9 S12",
        "ERR-003 OUA-006 RD-001 REC-001 REC-002 not_proven",
        waits=True,
    ),
    defect(
        "MU-113",
        "modbus",
        "A failure in a tool ends the process.",
        failing(change=_dies),
        "FM1 S10",
        "MCP-007",
        anywhere=True,
    ),
    defect(
        "MU-115",
        "modbus",
        "The envelope has a member of its own at the top.",
        result(extra_member),
        "M1 M2 M3 M4 X1 X2 X1p X2p FM1 FM2 FX1 S1 S4 S7 S10",
        "ENV-001 MCP-006",
        anywhere=True,
    ),
    defect(
        "MU-115w",
        "modbus",
        "The envelope's error is a word instead of an object.",
        result(error_is_a_word),
        "M4 FM1 FM2 S10",
        "ENV-001",
        anywhere=True,
    ),
    defect(
        "MU-117",
        "modbus",
        "Error codes are names of exceptions, and the same failure has now one, then another.",
        result(named_after_exceptions()),
        "M4 FM1 FM2 S10",
        "ENV-001 ERR-001",
        anywhere=True,
    ),
    defect(
        "MU-126",
        "modbus",
        "A lost connection to the device is never made again.",
        never_reconnects(),
        "S10 R-modbus",
        "REC-001 not_proven_again",
        recovers=True,
        waits=True,
    ),
    defect(
        "MU-126q",
        "mqtt",
        "A lost connection to the broker is never used again.",
        never_reconnects(),
        "S11 R-mqtt",
        "REC-001 not_proven_again",
        recovers=True,
        waits=True,
    ),
    defect(
        "MU-126o",
        "opcua",
        "A lost session with the server is never made again.",
        never_reconnects(),
        "S12 R-opcua",
        "REC-001 not_proven_again",
        recovers=True,
        waits=True,
    ),
)
