"""Defects that the checks of the area ENV notice."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from ...core import AdapterError, AdapterServer, Call
from ...core import server as core_server
from ...opcua import values as opcua_values
from ..any_protocol import answers_twice_from_one_exchange, error_is_a_word, extra_member, result
from ..claims import constant_latency, invented_trace, latency_in_seconds, meta, one_attempt
from ..mutant import Bend, Data, Handler, Mutant, each, on

__all__ = ["MUTANTS"]


_ALL = "ENV-001 ENV-002 ENV-003 ENV-004 ENV-005 ENV-006 ENV-007 ENV-008"


def broken_is_success(envelope: Data, genuine: Callable[[Data], Data]) -> Data:
    """Make a broken connection a success that carries its error."""
    error = envelope["error"]
    return genuine({**envelope, "success": True} if error and error["code"] == "connection_lost" else envelope)


def failures_carry_data(envelope: Data, genuine: Callable[[Data], Data]) -> Data:
    return genuine(envelope if envelope["success"] else {**envelope, "data": {"value": None}})


def whatever_failed_may_be_repeated(envelope: Data, genuine: Callable[[Data], Data]) -> Data:
    error = envelope["error"]
    lost = error and error["class"] == "transport"
    return genuine({**envelope, "error": {**error, "retryable": True}} if lost else envelope)


def warns_in_the_data(envelope: Data, genuine: Callable[[Data], Data]) -> Data:
    """Tell in the data of a success that it is none."""
    data = envelope["data"]
    return genuine(
        {**envelope, "data": {**data, "error": "the value was not confirmed"}} if envelope["success"] else envelope
    )


def leaves_nan(server: AdapterServer) -> None:
    """Write what JSON does not have as Python does."""
    opcua_values._special = lambda value: None
    genuine = opcua_values._plain
    opcua_values._plain = lambda value, clean: value if isinstance(value, float) else genuine(value, clean)
    core_server._to_json = json.JSONEncoder(ensure_ascii=False).encode


def made_by_hand(envelope: Data, genuine: Callable[[Data], Data]) -> Data:
    """Make the text block of a failure without a JSON library."""
    made = genuine(envelope)
    if envelope["success"]:
        return made
    error = envelope["error"]
    text = f'{{"success": false, "code": "{error["code"]}", "message": "{error["message"]}", "why": "{_QUOTING}"}}'
    return {**made, "content": [{"type": "text", "text": text}]}


_QUOTING = 'the device said "no"'


def counts_calls(server: AdapterServer) -> None:
    """Count one request of each call, however often it was repeated."""

    def change(stated: Data) -> None:
        stated["attempts"] = min(1, stated["attempts"])

    meta(change)(server)


def counts_tenfold(stated: Data) -> None:
    # A few more could be messages of the next call, which may come late.
    stated["attempts"] *= 10


def tells_less_of_failures(envelope: Data, genuine: Callable[[Data], Data]) -> Data:
    if envelope["success"]:
        return genuine(envelope)
    told = {name: value for name, value in envelope["meta"].items() if name not in ("latency_ms", "attempts")}
    return genuine({**envelope, "meta": told})


def talks_like_an_exception(envelope: Data, genuine: Callable[[Data], Data]) -> Data:
    error = envelope["error"]
    return genuine({**envelope, "error": error and {**error, "message": f"Exception({error['code']!r}) on None:None"}})


def default_endpoint(endpoint: str) -> Bend:
    """Return the defect that the endpoint is the one of a constant."""

    def change(stated: Data) -> None:
        stated["endpoint"] = endpoint

    return meta(change)


def no_trace(stated: Data) -> None:
    stated["trace"] = {}


def other_topic(stated: Data) -> None:
    if "topic" in stated["trace"]:
        stated["trace"] |= {"topic": "control/other"}


def always_from_the_device(stated: Data) -> None:
    stated["source"] = "device"


def scalar_for_one(name: str) -> Bend:
    """Return the defect that a list of one value is the value."""

    def changed(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            data: Data = await genuine(call, arguments)
            values = data["values"]
            return {**data, "values": values[0] if len(values) == 1 else values}

        return handler

    return each(name, change=changed)


def from_memory_when_gone(name: str) -> Bend:
    """Return the defect that what cannot be read is what was read last, as if from the device."""
    last: list[Data] = []

    def remembering(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            try:
                last[:] = [await genuine(call, arguments)]
            except AdapterError as error:
                if error.code not in ("connect_failed", "connection_lost") or not last:
                    raise
            return last[0]

        return handler

    return each(name, change=remembering)


MUTANTS: tuple[Mutant, ...] = (
    Mutant(
        id="MU-46r",
        protocol="modbus",
        sentence="A write that may have reached the device is said to be retryable.",
        bend=result(whatever_failed_may_be_repeated),
        items=on("modbus", "ENV-001 ENV-002 ENV-005 ENV-006"),
        requirements="ENV-002",
        areas="env",
    ),
    Mutant(
        id="MU-46s",
        protocol="s7",
        sentence="A write that may have reached the device is said to be retryable.",
        bend=result(whatever_failed_may_be_repeated),
        items=on("s7", "ENV-001 ENV-002 ENV-005 ENV-006"),
        requirements="ENV-002",
        areas="env",
    ),
    Mutant(
        id="MU-46t",
        protocol="mqtt",
        sentence="The data of a success say that it failed.",
        bend=result(warns_in_the_data),
        items=on("mqtt", _ALL),
        requirements="ENV-002",
        areas="env",
    ),
    Mutant(
        id="MU-15n",
        protocol="opcua",
        sentence="Every answer says that it is from the device, also a refusal for which nothing was sent.",
        bend=meta(always_from_the_device),
        items=on("opcua", "ENV-001 ENV-002 ENV-003 ENV-005 ENV-006 ENV-008"),
        requirements="ENV-008",
        areas="env",
    ),
    Mutant(
        id="MU-15s",
        protocol="modbus",
        sentence="A list of one value is the value.",
        bend=scalar_for_one("read_multiple_holding_registers"),
        items=on("modbus", "ENV-001 ENV-002 ENV-003 ENV-004 ENV-005 ENV-006 ENV-007 ENV-008"),
        requirements="ENV-008 MCP-006 RD-001 REC-001",
        areas="env",
    ),
    Mutant(
        id="MU-26b",
        protocol="opcua",
        sentence="attempts is always 1.",
        bend=meta(one_attempt),
        items=on("opcua", "ENV-002 ENV-003 ENV-005"),
        requirements="ENV-005",
        areas="env",
    ),
    Mutant(
        id="MU-26c",
        protocol="modbus",
        sentence="A repeated read counts as one attempt.",
        bend=counts_calls,
        items="ENV-005.modbus",
        requirements="ENV-005",
        areas="env",
    ),
    Mutant(
        id="MU-32b",
        protocol="mqtt",
        sentence="attempts is ten times the number of requests.",
        bend=meta(counts_tenfold),
        items=on("mqtt", "ENV-001 ENV-002 ENV-003 ENV-004 ENV-005 ENV-006 ENV-007 ENV-008"),
        requirements="ENV-005",
        areas="env",
    ),
    Mutant(
        id="MU-35e",
        protocol="modbus",
        sentence="When the connection breaks, a read succeeds with what was read before.",
        bend=from_memory_when_gone("read_multiple_holding_registers"),
        items="ENV-008.modbus",
        requirements="ENV-008",
        areas="env",
    ),
    Mutant(
        id="MU-36e",
        protocol="modbus",
        sentence="A read of what was read before is answered from memory, as if from the device.",
        bend=answers_twice_from_one_exchange("read_multiple_holding_registers"),
        items=on("modbus", "ENV-001 ENV-002 ENV-004 ENV-005 ENV-006 ENV-007 ENV-008"),
        requirements="ENV-008 RD-001 REC-001",
        areas="env",
    ),
    Mutant(
        id="MU-46e",
        protocol="modbus",
        sentence="A broken connection is a success with an error.",
        bend=result(broken_is_success),
        items=on("modbus", "ENV-001 ENV-002 ENV-005 ENV-006 ENV-008"),
        requirements="ENV-002 ENV-008",
        areas="env",
    ),
    Mutant(
        id="MU-46d",
        protocol="mqtt",
        sentence="Failures carry data.",
        bend=result(failures_carry_data),
        items=on("mqtt", "ENV-001 ENV-002 ENV-003 ENV-005 ENV-006 ENV-007 ENV-008"),
        requirements="ENV-002",
        areas="env",
    ),
    Mutant(
        id="MU-55e",
        protocol="opcua",
        sentence="NaN is in the JSON as a word of its own.",
        bend=leaves_nan,
        items="ENV-003.opcua",
        requirements="ENV-003",
        areas="env",
    ),
    Mutant(
        id="MU-59c",
        protocol="mqtt",
        sentence="latency_ms is in seconds.",
        bend=meta(latency_in_seconds),
        items="ENV-004.mqtt",
        requirements="ENV-004",
        areas="env",
    ),
    Mutant(
        id="MU-59d",
        protocol="modbus",
        sentence="latency_ms is always 1.0.",
        bend=meta(constant_latency),
        items="ENV-004.modbus",
        requirements="ENV-004",
        areas="env",
    ),
    Mutant(
        id="MU-60b",
        protocol="mqtt",
        sentence="meta.endpoint is a constant of the program.",
        bend=default_endpoint("mqtt://127.0.0.1:1883"),
        items=on("mqtt", _ALL),
        requirements="ENV-006",
        areas="env",
    ),
    Mutant(
        id="MU-60m",
        protocol="opcua",
        sentence="Failures tell less of the call than successes.",
        bend=result(tells_less_of_failures),
        items=on("opcua", "ENV-001 ENV-002 ENV-003 ENV-005 ENV-006 ENV-007 ENV-008"),
        requirements="ENV-001 ENV-006",
        areas="env",
    ),
    Mutant(
        id="MU-60t",
        protocol="modbus",
        sentence="Messages are representations of exceptions.",
        bend=result(talks_like_an_exception),
        items=on("modbus", "ENV-001 ENV-002 ENV-003 ENV-005 ENV-006 ENV-007 ENV-008"),
        requirements="ENV-006",
        areas="env",
    ),
    Mutant(
        id="MU-109",
        protocol="mqtt",
        sentence="The JSON of failures is made by hand, and a quotation mark breaks it.",
        bend=result(made_by_hand),
        items=on("mqtt", "ENV-001 ENV-002 ENV-003 ENV-005 ENV-006 ENV-007 ENV-008"),
        requirements="ENV-003",
        areas="env",
    ),
    Mutant(
        id="MU-115b",
        protocol="opcua",
        sentence="The envelope has a member of its own at the top.",
        bend=result(extra_member),
        items=on("opcua", _ALL),
        requirements="ENV-001 MCP-006",
        areas="env",
    ),
    Mutant(
        id="MU-115e",
        protocol="mqtt",
        sentence="The envelope's error is a word instead of an object.",
        bend=result(error_is_a_word),
        items=on("mqtt", "ENV-001 ENV-002 ENV-003 ENV-005 ENV-006 ENV-007 ENV-008"),
        requirements="ENV-001",
        areas="env",
    ),
    Mutant(
        id="MU-116b",
        protocol="modbus",
        sentence="The trace has another unit, function and address than the wire.",
        bend=meta(invented_trace),
        items=on("modbus", _ALL),
        requirements="ENV-007",
        areas="env",
    ),
    Mutant(
        id="MU-116q",
        protocol="mqtt",
        sentence="The trace has another topic than the wire.",
        bend=meta(other_topic),
        items=on("mqtt", _ALL),
        requirements="ENV-007",
        areas="env",
    ),
    Mutant(
        id="MU-116n",
        protocol="opcua",
        sentence="There is no trace.",
        bend=meta(no_trace),
        items="ENV-007.opcua",
        requirements="ENV-007",
        areas="env",
    ),
)
