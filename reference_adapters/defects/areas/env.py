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
from ..defect import Change, Data, Defect, Handler, around, defect

__all__ = ["DEFECTS"]


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


def default_endpoint(endpoint: str) -> Change:
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


def scalar_for_one(name: str) -> Change:
    """Return the defect that a list of one value is the value."""

    @around(name)
    async def changed(genuine: Handler, call: Call, arguments: Any) -> Data:
        data = await genuine(call, arguments)
        values = data["values"]
        return {**data, "values": values[0] if len(values) == 1 else values}

    return changed


def from_memory_when_gone(name: str) -> Change:
    """Return the defect that what cannot be read is what was read last, as if from the device."""
    last: list[Data] = []

    @around(name)
    async def remembering(genuine: Handler, call: Call, arguments: Any) -> Data:
        try:
            last[:] = [await genuine(call, arguments)]
        except AdapterError as error:
            if error.code not in ("connect_failed", "connection_lost") or not last:
                raise
        return last[0]

    return remembering


DEFECTS: tuple[Defect, ...] = (
    defect(
        "MU-46r",
        "modbus",
        "A write that may have reached the device is said to be retryable.",
        result(whatever_failed_may_be_repeated),
        "ENV-001 ENV-002 ENV-005 ENV-006",
        "ENV-002",
    ),
    defect(
        "MU-46s",
        "s7",
        "A write that may have reached the device is said to be retryable.",
        result(whatever_failed_may_be_repeated),
        "ENV-001 ENV-002 ENV-005 ENV-006",
        "ENV-002",
    ),
    defect("MU-46t", "mqtt", "The data of a success say that it failed.", result(warns_in_the_data), _ALL, "ENV-002"),
    defect(
        "MU-15n",
        "opcua",
        "Every answer says that it is from the device, also a refusal for which nothing was sent.",
        meta(always_from_the_device),
        "ENV-001 ENV-002 ENV-003 ENV-005 ENV-006 ENV-008",
        "ENV-008",
    ),
    defect(
        "MU-15s",
        "modbus",
        "A list of one value is the value.",
        scalar_for_one("read_multiple_holding_registers"),
        "ENV-001 ENV-002 ENV-003 ENV-004 ENV-005 ENV-006 ENV-007 ENV-008",
        "ENV-008 MCP-006 MCP-007 RD-001 REC-001",
    ),
    defect("MU-26b", "opcua", "attempts is always 1.", meta(one_attempt), "ENV-002 ENV-003 ENV-005", "ENV-005"),
    defect("MU-26c", "modbus", "A repeated read counts as one attempt.", counts_calls, "ENV-005"),
    defect(
        "MU-32b",
        "mqtt",
        "attempts is ten times the number of requests.",
        meta(counts_tenfold),
        "ENV-001 ENV-002 ENV-003 ENV-004 ENV-005 ENV-006 ENV-007 ENV-008",
        "ENV-005",
    ),
    defect(
        "MU-35e",
        "modbus",
        "When the connection breaks, a read succeeds with what was read before.",
        from_memory_when_gone("read_multiple_holding_registers"),
        "ENV-008",
    ),
    defect(
        "MU-36e",
        "modbus",
        "A read of what was read before is answered from memory, as if from the device.",
        answers_twice_from_one_exchange("read_multiple_holding_registers"),
        "ENV-001 ENV-002 ENV-004 ENV-005 ENV-006 ENV-007 ENV-008",
        "ENV-008 RD-001 REC-001",
    ),
    defect(
        "MU-46e",
        "modbus",
        "A broken connection is a success with an error.",
        result(broken_is_success),
        "ENV-001 ENV-002 ENV-005 ENV-006 ENV-008",
        "ENV-002 ENV-008",
    ),
    defect(
        "MU-46d",
        "mqtt",
        "Failures carry data.",
        result(failures_carry_data),
        "ENV-001 ENV-002 ENV-003 ENV-005 ENV-006 ENV-007 ENV-008",
        "ENV-002",
    ),
    defect("MU-55e", "opcua", "NaN is in the JSON as a word of its own.", leaves_nan, "ENV-003"),
    defect("MU-59c", "mqtt", "latency_ms is in seconds.", meta(latency_in_seconds), "ENV-004"),
    defect("MU-59d", "modbus", "latency_ms is always 1.0.", meta(constant_latency), "ENV-004"),
    defect(
        "MU-60b",
        "mqtt",
        "meta.endpoint is a constant of the program.",
        default_endpoint("mqtt://127.0.0.1:1883"),
        _ALL,
        "ENV-006",
    ),
    defect(
        "MU-60m",
        "opcua",
        "Failures tell less of the call than successes.",
        result(tells_less_of_failures),
        "ENV-001 ENV-002 ENV-003 ENV-005 ENV-006 ENV-007 ENV-008",
        "ENV-001 ENV-006",
    ),
    defect(
        "MU-60t",
        "modbus",
        "Messages are representations of exceptions.",
        result(talks_like_an_exception),
        "ENV-001 ENV-002 ENV-003 ENV-005 ENV-006 ENV-007 ENV-008",
        "ENV-006",
    ),
    defect(
        "MU-109",
        "mqtt",
        "The JSON of failures is made by hand, and a quotation mark breaks it.",
        result(made_by_hand),
        "ENV-001 ENV-002 ENV-003 ENV-005 ENV-006 ENV-007 ENV-008",
        "ENV-003",
    ),
    defect(
        "MU-115b",
        "opcua",
        "The envelope has a member of its own at the top.",
        result(extra_member),
        _ALL,
        "ENV-001 MCP-006",
    ),
    defect(
        "MU-115e",
        "mqtt",
        "The envelope's error is a word instead of an object.",
        result(error_is_a_word),
        "ENV-001 ENV-002 ENV-003 ENV-005 ENV-006 ENV-007 ENV-008",
        "ENV-001",
    ),
    defect(
        "MU-116b",
        "modbus",
        "The trace has another unit, function and address than the wire.",
        meta(invented_trace),
        _ALL,
        "ENV-007",
    ),
    defect("MU-116q", "mqtt", "The trace has another topic than the wire.", meta(other_topic), _ALL, "ENV-007"),
    defect("MU-116n", "opcua", "There is no trace.", meta(no_trace), "ENV-007"),
)
