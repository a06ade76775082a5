"""Honest adapters that treat texts of a device, and texts in arguments, in other ways than the reference adapters do."""

from __future__ import annotations

import base64
import dataclasses
import json
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from pytest_otmcp.reference_adapters.core import AdapterError, AdapterServer, Call, device_text
from pytest_otmcp.reference_adapters.core import server as core_server
from pytest_otmcp.reference_adapters.defects.defect import Handler, wrap
from pytest_otmcp.reference_adapters.modbus import tools as modbus_tools
from pytest_otmcp.reference_adapters.mqtt import tools as mqtt_tools
from pytest_otmcp.reference_adapters.opcua import tools as opcua_tools

from pytest_otmcp.subject.model import Answering

from .choice import Choice, choices

if TYPE_CHECKING:
    from pytest_otmcp.subject import Adapter

__all__ = ["CHOICES"]

_MODBUS, on_modbus = choices("modbus")
_MQTT, on_mqtt = choices("mqtt")
_OPCUA, on_opcua = choices("opcua")
_S7, on_s7 = choices("s7")
_DNP3, on_dnp3 = choices("dnp3")


def escaped(text: str) -> str:
    return "".join(one if one.isprintable() else one.encode("unicode_escape").decode() for one in text)


@on_opcua(
    "shows hidden characters as escapes, such as \\x1b", "requirement INJ-002: escaped or removed, and that is said"
)
def escapes_as_text(server: AdapterServer) -> None:
    def cleaner(call: Call, pointer: str) -> Any:
        def clean(text: str | None) -> str:
            shown = escaped(text or "")
            if pointer not in (untrusted := call.extra.setdefault("untrusted", [])):
                untrusted.append(pointer)
            if shown != (text or ""):
                call.extra["sanitised"] = True
            return shown

        return clean

    opcua_tools.cleaner = cleaner


@on_opcua("returns texts of any length whole", "requirement INJ-002 asks that what is cut off is said to be")
def texts_in_full(server: AdapterServer) -> None:
    from pytest_otmcp.reference_adapters.core import text as core_text
    from pytest_otmcp.reference_adapters.opcua import texts

    core_text._LONGEST = texts._LONGEST = 10**6


@on_modbus("marks all its data as texts of somebody else", "whatever is below a pointer is marked by it (RFC 6901)")
def marks_a_whole_subtree(server: AdapterServer) -> None:
    genuine = Call._meta

    def meta(self: Call) -> dict[str, Any]:
        found = genuine(self)
        return {**found, "untrusted": ["/data"]} if "untrusted" in found else found

    Call._meta = meta


@on_modbus(
    "logs each text of the device on standard error, in quotation marks",
    "MCP, transports, stdio: servers MAY log there",
)
def logs_what_it_reads(server: AdapterServer) -> None:
    def logged(call: Call, pointer: str, text: Any) -> str:
        print(f"the device says {text!r}", file=sys.stderr)
        return device_text(call, pointer, text)

    modbus_tools.device_text = logged


def answers_in_texts(adapter: Adapter) -> Adapter:
    """Return a description by which the adapter's answers are JSON in a text block, without our envelope."""
    answering = Answering(form="json")
    operations = {
        name: tuple(dataclasses.replace(one, answering=answering) for one in bound)
        for name, bound in adapter.operations.items()
    }
    return dataclasses.replace(adapter, answering=answering, operations=operations)


def data_as_text(envelope: Mapping[str, Any]) -> dict[str, Any]:
    """Return a result as ``json.dumps`` of what a tool returns makes it, which escapes all that is not ASCII."""
    said = {"data": envelope["data"]} if envelope["success"] else {"error": envelope["error"]["message"]}
    if "audit_id" in envelope["meta"]:
        # Without it nobody could tell that the audit log was cut off.
        said["meta"] = {"audit_id": envelope["meta"]["audit_id"]}
    return {"content": [{"type": "text", "text": json.dumps(said)}], "isError": not envelope["success"]}


def as_it_is(call: Call, pointer: str, text: Any) -> str:
    return text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text)


def without_schemas(server: AdapterServer) -> None:
    for name, tool in server._tools.items():
        listing = tool.listing.model_copy(update={"output_schema": None})
        server._tools[name] = dataclasses.replace(tool, listing=listing)


@on_modbus(
    "has no envelope, marks nothing and cleans nothing: its texts are JSON in ASCII",
    "what a host shows of such a block is escaped; only an envelope has a place for marks",
    described=answers_in_texts,
)
def json_in_ascii(server: AdapterServer) -> None:
    without_schemas(server)
    modbus_tools.device_text = as_it_is
    core_server._result = data_as_text


@on_mqtt("refuses topics with characters that a shell or a template knows", "a topic is what its author allows")
def refuses_strange_topics(server: AdapterServer) -> None:
    def refusing(genuine: Any) -> Any:
        def check(topic: str) -> Any:
            if set(topic) & set("\"'`;$(){}%"):
                raise AdapterError("invalid_input", "the topic has a character that is not allowed", field="/topic")
            return genuine(topic)

        return check

    mqtt_tools.check_name = refusing(mqtt_tools.check_name)
    mqtt_tools.check_filter = refusing(mqtt_tools.check_filter)


@on_s7("drops hidden characters", "requirement INJ-002: escaped or removed, and that is said")
def drops_hidden_characters(server: AdapterServer) -> None:
    from pytest_otmcp.reference_adapters.s7 import tools

    def dropped(call: Call, pointer: str, text: Any) -> str:
        kept = "".join(one for one in text if one.isprintable())
        call.extra.setdefault("untrusted", []).append(pointer)
        if kept != text:
            call.extra["sanitised"] = True
        return kept

    tools.device_text = dropped


@on_dnp3(
    "has the bytes of a text that it cleaned beside it, as base64",
    "data may have more members for some values than for others; base64 is no text",
)
def bytes_beside_a_text(server: AdapterServer) -> None:
    from pytest_otmcp.reference_adapters.dnp3 import tools

    last: list[str] = []

    def remembered(call: Call, pointer: str, text: str) -> str:
        cleaned = device_text(call, pointer, text)
        if cleaned != text:
            last.append(text)
        return cleaned

    def with_bytes(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            last.clear()
            data = await genuine(call, arguments)
            return {**data, "bytes": base64.b64encode(last[0].encode()).decode()} if last else data

        return handler

    tools.device_text = remembered
    listing = server._tools["read_point_by_alias"].listing.model_copy(update={"output_schema": None})
    wrap(server, "read_point_by_alias", with_bytes, listing=listing)


CHOICES: Mapping[str, Choice] = {**_MODBUS, **_MQTT, **_OPCUA, **_S7, **_DNP3}
