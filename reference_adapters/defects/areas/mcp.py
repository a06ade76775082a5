"""Defects that the checks of the area MCP notice."""

from __future__ import annotations

import asyncio
import os
from typing import Any

from mcp.types.version import HANDSHAKE_PROTOCOL_VERSIONS
from pydantic import field_validator

from ...core import AdapterError, AdapterServer, Call, stdio
from ...core import server as core_server
from ...modbus.shapes import WriteRegister
from ...mqtt.shapes import Publish
from ..any_protocol import banner, complains, is_error_never_set, result, stays, text_says_otherwise
from ..claims import bare_schema
from ..life import exits_without_a_device
from ..modbus import heartbeat as modbus_heartbeat
from ..mqtt import heartbeat as mqtt_heartbeat
from ..mutant import Bend, Data, Handler, Mutant, also, each, on, wrap
from ..opcua import heartbeat as opcua_heartbeat

__all__ = ["MUTANTS"]


def unknown_arguments_ignored(server: AdapterServer) -> None:
    for tool in server._tools.values():
        tool.model.model_config["extra"] = "ignore"
        tool.model.model_rebuild(force=True)


class Lax(WriteRegister):
    """A register and its value; true is 1, and a text of digits is a number."""

    @field_validator("value", mode="before")
    @classmethod
    def _made_a_number(cls, value: Any) -> Any:
        return int(value) if isinstance(value, bool) or (isinstance(value, str) and value.isdecimal()) else value


class LaxPublish(Publish):
    """A message; its QoS may be a text."""

    @field_validator("qos", mode="before")
    @classmethod
    def _made_a_number(cls, value: Any) -> Any:
        return int(bool(value)) if isinstance(value, bool | str | None) else value


def true_is_one(server: AdapterServer) -> None:
    wrap(server, "write_register", lambda genuine: genuine, model=Lax)


def any_qos(server: AdapterServer) -> None:
    wrap(server, "publish_message", lambda genuine: genuine, model=LaxPublish)


def texts_are_numbers(server: AdapterServer) -> None:
    def guessing(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            if isinstance(arguments.value, str | bool):
                arguments = arguments.model_copy(update={"value": 1.0})
            data: Data = await genuine(call, arguments)
            return data

        return handler

    each("write_opcua_node", change=guessing)(server)


def listed_without(word: str) -> Bend:
    """Return the defect that no schema has this member."""

    def bend(server: AdapterServer) -> None:
        for tool in server._tools.values():
            tool.listing.input_schema.pop(word, None)

    return bend


def no_schema(server: AdapterServer) -> None:
    for tool in server._tools.values():
        tool.listing.input_schema["properties"] = [*tool.listing.input_schema.get("properties", {})]


def named_with_blanks(server: AdapterServer) -> None:
    server._tools["list_tags"].listing.name = "list tags!"


def hinted(**hints: bool) -> Bend:
    """Return the defect that the annotations of every tool that writes have these values."""

    def bend(server: AdapterServer) -> None:
        for tool in server._tools.values():
            if tool.writes:
                tool.listing.annotations = tool.listing.annotations.model_copy(update=hints)

    return bend


def described_by_the_device(server: AdapterServer) -> None:
    """Append what the device calls itself to a description."""

    def learning(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            data: Data = await genuine(call, arguments)
            listing = server._tools["read_device_information"].listing
            listing.description = f"Read the identification of {data['objects'].get('0')}."
            return data

        return handler

    each("read_device_information", change=learning)(server)


def described_anew(server: AdapterServer) -> None:
    listing = server._tools["subscribe_topic"].listing
    listing.description = f"{listing.description} (process {os.getpid()})"


def wrong_types_end_it(server: AdapterServer) -> None:
    genuine = core_server.parse_arguments

    def parse(model: Any, arguments: Any) -> Any:
        try:
            return genuine(model, arguments)
        except AdapterError:
            os._exit(1)

    core_server.parse_arguments = parse


def unknown_tools_succeed(server: AdapterServer) -> None:
    answer_calls = server._answer_calls
    reading = next(iter(server._tools))

    async def lenient(ctx: Any, call_next: Any) -> Any:
        if ctx.method == "tools/call" and (ctx.params or {}).get("name") not in server._tools:
            ctx.params["name"], ctx.params["arguments"] = reading, {}
        return await answer_calls(ctx, call_next)

    server.mcp.middleware[:] = [lenient]


def bounds_are_for_reading_only(server: AdapterServer) -> None:
    genuine = core_server.parse_arguments

    def parse(model: Any, arguments: Any) -> Any:
        if isinstance(arguments, dict) and isinstance(arguments.get("count"), int):
            arguments = {**arguments, "count": min(max(arguments["count"], 1), 125)}
        return genuine(model, arguments)

    core_server.parse_arguments = parse


def is_error_never_set_by_handshake(server: AdapterServer) -> None:
    answer_calls = server._answer_calls

    async def answering(ctx: Any, call_next: Any) -> Any:
        result: Any = await answer_calls(ctx, call_next)
        if ctx.method == "tools/call" and ctx.protocol_version in HANDSHAKE_PROTOCOL_VERSIONS:
            return {**result, "isError": False}
        return result

    server.mcp.middleware[:] = [answering]


def garbage_ends_it(server: AdapterServer) -> None:
    def second_reading(line: bytes) -> Any:
        os._exit(1)

    stdio._second_reading = second_reading


def lingers(server: AdapterServer) -> None:
    async def for_long() -> None:
        await asyncio.sleep(60.0)

    server._close = for_long


_ALL = "MCP-001 MCP-002 MCP-003 MCP-004 MCP-005 MCP-006 MCP-007 MCP-008 MCP-009 MCP-010"


MUTANTS: tuple[Mutant, ...] = (
    Mutant(
        id="MU-11b",
        protocol="opcua",
        sentence="true and every text are written as the number 1.",
        bend=texts_are_numbers,
        items="MCP-005.opcua",
        requirements="MCP-005",
        areas="mcp",
    ),
    Mutant(
        id="MU-12",
        protocol="modbus",
        sentence="true is written as 1.",
        bend=true_is_one,
        items="MCP-005.modbus",
        requirements="MCP-005",
        areas="mcp",
        quick=True,
    ),
    Mutant(
        id="MU-12q",
        protocol="mqtt",
        sentence="A text or null is taken for a QoS.",
        bend=any_qos,
        items="MCP-005.mqtt",
        requirements="MCP-005",
        areas="mcp",
    ),
    Mutant(
        id="MU-13",
        protocol="modbus",
        sentence="An argument with an unknown name is ignored.",
        bend=unknown_arguments_ignored,
        items="MCP-004.modbus",
        requirements="MCP-004",
        areas="mcp",
        quick=True,
    ),
    Mutant(
        id="MU-47b",
        protocol="opcua",
        sentence="isError is always false.",
        bend=result(is_error_never_set),
        items=on("opcua", "MCP-001 MCP-002 MCP-004 MCP-005 MCP-006 MCP-007 MCP-008 MCP-010"),
        requirements="MCP-006",
        areas="mcp",
    ),
    Mutant(
        id="MU-47h",
        protocol="modbus",
        sentence="isError is always false in sessions that begin with the handshake of MCP 2025-11-25.",
        bend=is_error_never_set_by_handshake,
        items=on("modbus", "MCP-001 MCP-002 MCP-004 MCP-005 MCP-006 MCP-007 MCP-008 MCP-010"),
        requirements="MCP-006",
        areas="mcp",
    ),
    Mutant(
        id="MU-48b",
        protocol="mqtt",
        sentence="The text block is JSON, and it is not the structured content.",
        bend=result(text_says_otherwise),
        items=on("mqtt", _ALL),
        requirements="MCP-006",
        areas="mcp",
    ),
    Mutant(
        id="MU-49b",
        protocol="opcua",
        sentence="A banner is printed to stdout at the start.",
        bend=banner,
        items=on("opcua", _ALL),
        requirements="MCP-001",
        areas="mcp",
    ),
    Mutant(
        id="MU-50b",
        protocol="mqtt",
        sentence="Failures are printed to stdout.",
        bend=complains,
        items=on("mqtt", "MCP-001 MCP-002 MCP-006 MCP-008 MCP-010"),
        requirements="MCP-001",
        areas="mcp",
    ),
    Mutant(
        id="MU-51b",
        protocol="opcua",
        sentence="The adapter does not start while its server is off.",
        bend=exits_without_a_device,
        items="MCP-002.opcua",
        requirements="MCP-002",
        areas="mcp",
    ),
    Mutant(
        id="MU-52b",
        protocol="mqtt",
        sentence="The process does not exit when its stdin ends.",
        bend=stays,
        items=on("mqtt", "MCP-002 MCP-009 MCP-010"),
        requirements="MCP-009",
        areas="mcp",
        waits=True,
    ),
    Mutant(
        id="MU-52g",
        protocol="modbus",
        sentence="A line that is no message ends the process.",
        bend=garbage_ends_it,
        items="MCP-009.modbus",
        requirements="MCP-007 MCP-009",
        areas="mcp",
    ),
    Mutant(
        id="MU-53t",
        protocol="modbus",
        sentence="Listing the tags writes a heartbeat register.",
        bend=also("list_tags", action=modbus_heartbeat),
        items="MCP-008.modbus",
        requirements="MCP-008",
        areas="mcp",
    ),
    Mutant(
        id="MU-53s",
        protocol="mqtt",
        sentence="Listing the subscriptions publishes a heartbeat.",
        bend=also("list_subscriptions", action=mqtt_heartbeat),
        items="MCP-008.mqtt",
        requirements="MCP-008",
        areas="mcp",
    ),
    Mutant(
        id="MU-53v",
        protocol="opcua",
        sentence="Listing all variables writes a heartbeat.",
        bend=also("get_all_variables", action=opcua_heartbeat),
        items=on("opcua", "MCP-008 MCP-010"),
        requirements="MCP-008 WR-010",
        areas="mcp",
    ),
    Mutant(
        id="MU-53d",
        protocol="modbus",
        sentence="The tools that write have a destructiveHint of false.",
        bend=hinted(destructive_hint=False),
        items="",
        requirements="MCP-008",
        areas="mcp",
    ),
    Mutant(
        id="MU-53e",
        protocol="opcua",
        sentence="The tools that write have a destructiveHint of false.",
        bend=hinted(destructive_hint=False),
        items="",
        requirements="MCP-008",
        areas="mcp",
    ),
    Mutant(
        id="MU-53i",
        protocol="mqtt",
        sentence="The tools that publish have an idempotentHint.",
        bend=hinted(idempotent_hint=True),
        items="",
        requirements="MCP-008",
        areas="mcp",
    ),
    Mutant(
        id="MU-54",
        protocol="modbus",
        sentence="A tool's description holds what the device calls itself.",
        bend=described_by_the_device,
        items="MCP-008.modbus MCP-010.modbus",
        requirements="MCP-010",
        areas="mcp",
    ),
    Mutant(
        id="MU-54p",
        protocol="mqtt",
        sentence="A tool's description is another one in each process.",
        bend=described_anew,
        items="MCP-010.mqtt",
        requirements="MCP-010",
        areas="mcp",
    ),
    Mutant(
        id="MU-112b",
        protocol="opcua",
        sentence="The schemas of the arguments are bare objects.",
        bend=bare_schema,
        items=on("opcua", _ALL),
        requirements="MCP-003",
        areas="mcp",
    ),
    Mutant(
        id="MU-112r",
        protocol="modbus",
        sentence="No schema says which arguments are required.",
        bend=listed_without("required"),
        items="MCP-003.modbus",
        requirements="MCP-003",
        areas="mcp",
    ),
    Mutant(
        id="MU-112n",
        protocol="modbus",
        sentence="A tool has a name with a blank.",
        bend=named_with_blanks,
        items=on("modbus", "MCP-003 MCP-008"),
        requirements="MCP-003 MCP-007",
        areas="mcp",
    ),
    Mutant(
        id="MU-112s",
        protocol="mqtt",
        sentence="The schemas of the arguments are no JSON Schema.",
        bend=no_schema,
        items="MCP-003.mqtt",
        requirements="MCP-003",
        areas="mcp",
    ),
    Mutant(
        id="MU-113b",
        protocol="opcua",
        sentence="An argument of the wrong type ends the process.",
        bend=wrong_types_end_it,
        items=on("opcua", "MCP-001 MCP-004 MCP-005 MCP-006 MCP-007 MCP-008 MCP-010"),
        requirements="MCP-007",
        areas="mcp",
    ),
    Mutant(
        id="MU-113u",
        protocol="modbus",
        sentence="A tool that does not exist is another tool.",
        bend=unknown_tools_succeed,
        items="MCP-007.modbus",
        requirements="MCP-007",
        areas="mcp",
    ),
    Mutant(
        id="MU-113c",
        protocol="modbus",
        sentence="A count that the schema does not let through is made one that it does.",
        bend=bounds_are_for_reading_only,
        items="MCP-007.modbus",
        requirements="MCP-007",
        areas="mcp",
    ),
)
