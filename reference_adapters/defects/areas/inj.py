"""Defects that the checks of the area INJ notice."""

from __future__ import annotations

import asyncio
import json
import re
import sys
import unicodedata
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from ...core import AdapterError, AdapterServer, Call
from ...core import device_text as genuine_text
from ...modbus import tools as modbus_tools
from ...mqtt import sparkplug_tools
from ...mqtt import tools as mqtt_tools
from ...opcua import tools as opcua_tools
from ..defect import Change, Data, Defect, Handler, around, defect, failing, told
from .further import module_of

__all__ = ["DEFECTS"]

Text = Callable[[Call, str, Any], str]
"""As :func:`~...core.device_text`."""


# -- INJ-001 ----------------------------------------------------------------------------------------------------------


def _described(tool: str, change: Callable[[Data], str]) -> Change:
    """Return the defect that a tool's description says what the tool has told last."""

    def apply(server: AdapterServer) -> None:
        @around(tool)
        async def changed(genuine: Handler, call: Call, arguments: Any) -> Data:
            data = await genuine(call, arguments)
            listed = server._tools[tool]
            description = f"{(listed.listing.description or '').partition(' Seen: ')[0]} Seen: {change(data)}"
            listing = listed.listing.model_copy(update={"description": description})
            server._tools[tool] = replace(listed, listing=listing)
            return data

        changed(server)

    return apply


def _vendor_in_errors(server: AdapterServer) -> None:
    seen = {"vendor": "the device"}

    @around("read_device_information")
    async def remembering(genuine: Handler, call: Call, arguments: Any) -> Data:
        data = await genuine(call, arguments)
        seen["vendor"] = data["objects"].get("0", seen["vendor"])
        return data

    def named(call: Call, error: AdapterError) -> AdapterError:
        error.message = f"{seen['vendor']}: {error.message}"
        return error

    remembering(server)
    failing(change=named)(server)


def _last_value_in_errors(tool: str) -> Change:
    def apply(server: AdapterServer) -> None:
        last: list[Any] = []

        @around(tool)
        async def remembering(genuine: Handler, call: Call, arguments: Any) -> Data:
            try:
                data = await genuine(call, arguments)
            except AdapterError as error:
                if last:
                    error.message = f"{error.message}; the last value was {last[-1]}"
                raise
            last.append(data["value"])
            return data

        remembering(server)

    return apply


def _unmarked(server: AdapterServer) -> None:
    genuine = Call._meta

    def meta(self: Call) -> Data:
        return {name: value for name, value in genuine(self).items() if name != "untrusted"}

    Call._meta = meta


# -- INJ-002 ----------------------------------------------------------------------------------------------------------


def _texts(text: Text, *modules: Callable[[], Any]) -> Change:
    """Return the defect that these modules clean texts of the device in this way."""

    def apply(server: AdapterServer) -> None:
        for module in modules:
            module().device_text = text

    return apply


def _as_it_is(call: Call, pointer: str, text: Any) -> str:
    call.extra.setdefault("untrusted", []).append(pointer)
    return text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text)


def _without(categories: str, *, known: str = "") -> Text:
    """Return a way to clean texts that knows these categories alone, or these characters."""

    def clean(call: Call, pointer: str, text: Any) -> str:
        raw = _as_it_is(call, pointer, text)
        kept = "".join(
            one for one in raw if one not in known and (not categories or unicodedata.category(one) != categories)
        )
        if kept != raw:
            call.extra["sanitised"] = True
        return kept

    return clean


def _silently(call: Call, pointer: str, text: Any) -> str:
    cleaned = genuine_text(call, pointer, text)
    call.extra.pop("sanitised", None)
    return cleaned


def _nodes_as_they_are(server: AdapterServer) -> None:
    def cleaner(call: Call, pointer: str) -> Any:
        return lambda text: _as_it_is(call, pointer, text or "")

    opcua_tools.cleaner = cleaner


def _nodes_cut_silently(server: AdapterServer) -> None:
    genuine = opcua_tools.cleaner

    def cleaner(call: Call, pointer: str) -> Any:
        clean = genuine(call, pointer)
        return lambda text: clean((text or "")[:1000])

    opcua_tools.cleaner = cleaner


# -- INJ-003 ----------------------------------------------------------------------------------------------------------


def _by_hand(data: Data) -> Data:
    """Make the JSON of a value by hand, where that is JSON again."""
    if isinstance(data["value"], str):
        try:
            made = json.loads(f'{{"value":"{data["value"]}"}}')
        except ValueError:
            return data
        return {**data, **made}
    return data


def _objects_by_hand(data: Data) -> Data:
    members = ",".join(f'"{name}":"{text}"' for name, text in data["objects"].items())
    try:
        return {"objects": json.loads("{" + members + "}")}
    except ValueError:
        return data


def _template(data: Data) -> Data:
    def product(found: re.Match[str]) -> str:
        return str(int(found[1]) * int(found[2]))

    if isinstance(data["value"], str):
        data["value"] = re.sub(r"\{\{(\d+)\*(\d+)\}\}", product, data["value"])
    return data


def _to_a_shell(tool: str, argument: str) -> Change:
    """Return the defect that an argument is written to a log by way of a shell."""

    def apply(server: AdapterServer) -> None:
        @around(tool)
        async def changed(genuine: Handler, call: Call, arguments: Any) -> Data:
            command = f'echo "{getattr(arguments, argument)}" >/dev/null 2>&1'
            process = await asyncio.create_subprocess_shell(
                command, stdin=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.DEVNULL
            )
            await process.wait()
            data = await genuine(call, arguments)
            return data

        changed(server)

    return apply


@around("read_opcua_node")
async def _values_to_a_shell(genuine: Handler, call: Call, arguments: Any) -> Data:
    data = await genuine(call, arguments)
    if isinstance(data["value"], str):
        process = await asyncio.create_subprocess_shell(
            f"echo '{data['value']}' >/dev/null 2>&1",
            stdin=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.DEVNULL,
        )
        await process.wait()
    return data


def _topics_stripped(server: AdapterServer) -> None:
    mqtt_tools.check_name = lambda topic: re.sub(r"[^A-Za-z0-9/_.-]", "", topic)


@around("read_point_by_alias")
async def _aliases_are_files(genuine: Handler, call: Call, arguments: Any) -> Data:
    try:
        data = await genuine(call, arguments)
    except AdapterError as error:
        error.message += _first_line(Path("/etc", arguments.alias))
        raise
    return data


def _first_line(file: Path) -> str:
    try:
        return f"; {file} says {file.read_text().splitlines()[0]}"
    except (OSError, ValueError, IndexError):
        return ""


def _logged_as_it_is(server: AdapterServer) -> None:
    def logged(call: Call, pointer: str, text: Any) -> str:
        raw = text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text)
        print(f"the device says {raw}", file=sys.stderr, flush=True)
        return genuine_text(call, pointer, text)

    modbus_tools.device_text = logged


_SHELLS = "A text reaches a shell"

DEFECTS: tuple[Defect, ...] = (
    defect(
        "MU-54m",
        "modbus",
        "The description of a tool names the vendor that the device has told.",
        _described("read_device_information", lambda data: str(data["objects"].get("0"))),
        "INJ-001 INJ-002 INJ-003",
        "INJ-001 MCP-010",
    ),
    defect(
        "MU-54o",
        "opcua",
        "The description of a tool has the names of the nodes that were browsed last.",
        _described("browse_opcua_node_children", lambda data: str([one["display_name"] for one in data["children"]])),
        "INJ-001 INJ-002 INJ-003",
        "INJ-001 MCP-010",
    ),
    defect(
        "MU-54e",
        "ethernetip",
        "The description of a tool lists the controller's tags.",
        _described("get_tag_list", lambda data: str([one["tag_name"] for one in data["tags"]])),
        "INJ-001 INJ-002 INJ-003",
        "INJ-001 MCP-010",
    ),
    defect(
        "MU-107",
        "modbus",
        "Messages of errors begin with the vendor's name, as the device tells it.",
        _vendor_in_errors,
        "INJ-001",
        quick=True,
    ),
    defect(
        "MU-107o",
        "opcua",
        "Messages of errors have the last value that was read.",
        _last_value_in_errors("read_opcua_node"),
        "INJ-001",
    ),
    defect(
        "MU-107k",
        "s7",
        "Messages of errors have the last value that was read.",
        _last_value_in_errors("read_db_typed"),
        "INJ-001",
    ),
    defect("MU-107q", "mqtt", "Topics and payloads are not marked as texts of somebody else.", _unmarked, "INJ-001"),
    defect("MU-107d", "dnp3", "Octet strings are not marked as texts of the outstation.", _unmarked, "INJ-001"),
    defect("MU-108", "opcua", "Texts of nodes are passed on as they are.", _nodes_as_they_are, "INJ-002", quick=True),
    defect(
        "MU-108m",
        "modbus",
        "Control characters are removed; marks of the reading direction, tags and spaces without width are not.",
        _texts(_without("Cc"), lambda: modbus_tools),
        "INJ-002",
    ),
    defect(
        "MU-108q",
        "mqtt",
        "Names and values of metrics are passed on as they are.",
        _texts(_as_it_is, lambda: sparkplug_tools),
        "INJ-002",
    ),
    defect(
        "MU-108k",
        "s7",
        "Of control characters the escape character alone is removed.",
        _texts(_without("", known="\x1b"), lambda: module_of("s7", "tools")),
        "INJ-002",
    ),
    defect(
        "MU-108e",
        "ethernetip",
        "Texts are cleaned, and nothing says so.",
        _texts(_silently, lambda: module_of("ethernetip", "tools"), lambda: module_of("ethernetip", "controller")),
        "INJ-002",
    ),
    defect(
        "MU-108o",
        "opcua",
        "Texts of nodes are cut off after 1000 characters, and nothing says so.",
        _nodes_cut_silently,
        "INJ-002",
    ),
    defect(
        "MU-109m",
        "modbus",
        "The JSON of the identification is put together by hand.",
        told("read_device_information", change=_objects_by_hand),
        "INJ-003",
        "INJ-003 MCP-006",
        quick=True,
    ),
    defect(
        "MU-109o",
        "opcua",
        "The JSON of a value is put together by hand.",
        told("read_opcua_node", change=_by_hand),
        "INJ-003",
    ),
    defect(
        "MU-109q",
        "mqtt",
        f"{_SHELLS}: each topic that is published on is written to a log by one.",
        _to_a_shell("publish_message", "topic"),
        "INJ-003",
    ),
    defect(
        "MU-109s",
        "opcua",
        f"{_SHELLS}: each text of a node is written to a log by one, in quotation marks.",
        _values_to_a_shell,
        "INJ-003",
    ),
    defect(
        "MU-109t",
        "mqtt",
        "Characters that a topic should not have are left out, and the message is published on what remains.",
        _topics_stripped,
        "INJ-003",
    ),
    defect("MU-109k", "s7", "A text is taken for a template.", told("read_db_typed", change=_template), "INJ-003"),
    defect("MU-109d", "dnp3", "An alias that is not known is looked up as a file.", _aliases_are_files, "INJ-003"),
    defect(
        "MU-109l",
        "modbus",
        "Texts of the device are logged as they are, with their line ends.",
        _logged_as_it_is,
        "",
        "INJ-003",
    ),
)
