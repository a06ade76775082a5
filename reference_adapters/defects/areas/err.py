"""Defects that the checks of the area ERR notice."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ...core import AdapterError, AdapterServer, Call
from ...modbus import link as modbus_link
from ...mqtt import connection as mqtt_connection
from ...mqtt import link as mqtt_link
from ..any_protocol import guard_after_sending, named_after_exceptions, result
from ..mutant import Bend, Data, Handler, Mutant, each, failing, on, succeeding, wrap

__all__ = ["MUTANTS"]


_GONE = ("connect_failed", "connection_lost", "timeout")


def collapsed(call: Call, error: AdapterError) -> Exception | None:
    return AdapterError("protocol_error", "Modbus error") if "exception_code" in call.trace else None


def _nothing(call: Call, arguments: Any) -> Data:
    return {"address": arguments.address, "count": 0, "values": []}


def parity_is_unknown(server: AdapterServer) -> None:
    del modbus_link._EXCEPTIONS[8]


def no_exception_code(call: Call, error: AdapterError) -> Exception | None:
    call.trace.pop("exception_code", None)
    return None


def all_alike(call: Call, error: AdapterError) -> Exception | None:
    outcome = error.outcome if call.writes else None
    return AdapterError("protocol_error", "OPC UA error", outcome=outcome) if "status_code" in call.trace else None


def denied_is_an_address(call: Call, error: AdapterError) -> Exception | None:
    if error.code != "access_denied":
        return None
    return AdapterError("illegal_address", error.message, outcome=error.outcome)


def refusal_is_a_timeout(server: AdapterServer) -> None:
    for reason in [*mqtt_connection._REFUSALS]:
        mqtt_connection._REFUSALS[reason] = "timeout"


def subscriptions_are_always_granted(server: AdapterServer) -> None:
    mqtt_link._REFUSED = 0x100


def one_code(code: str) -> Bend:
    """Return the defect that every failure of the connection has this code."""

    def change(call: Call, error: AdapterError) -> Exception | None:
        return AdapterError(code, error.message) if error.code in _GONE else None

    return failing(change=change)


def says_not_sent(server: AdapterServer) -> None:
    """Take every write that failed for one that was not sent."""

    def change(call: Call, error: AdapterError) -> Exception | None:
        if error.code not in _GONE or not call.writes:
            return None
        return AdapterError(error.code, error.message, outcome="not_sent")

    failing(change=change)(server)


def connects_first(server: AdapterServer) -> None:
    """Connect before the arguments are looked at."""
    genuine = server._perform
    reading = server._tools["get_broker_info"] if "get_broker_info" in server._tools else server._tools["ping"]

    async def perform(tool: Any, call: Call, arguments: Any) -> Data:
        if tool.writes:
            await reading.handler(Call(protocol="", operation="", endpoint="", writes=False), reading.model())
        return await genuine(tool, call, arguments)

    server._perform = perform


def connects_first_opcua(server: AdapterServer) -> None:
    genuine = server._perform
    reading = server._tools["read_opcua_node"]

    async def perform(tool: Any, call: Call, arguments: Any) -> Data:
        if tool.writes:
            asked = reading.model(node_id="i=2259")
            await reading.handler(Call(protocol="", operation="", endpoint="", writes=False), asked)
        return await genuine(tool, call, arguments)

    server._perform = perform


def errors_among_values(genuine: Handler) -> Handler:
    async def handler(call: Call, arguments: Any) -> Data:
        try:
            data: Data = await genuine(call, arguments)
        except AdapterError as error:
            if error.code != "partial_failure":
                raise
            items = error.partial["items"]
            shown = [item if item["success"] else {**item, "value": f"Error: {item}"} for item in items]
            return {"items": [{**item, "success": True} for item in shown]}
        return data

    return handler


def as_if_all_were_written(status: str) -> Callable[[Handler], Handler]:
    """Return the defect that a write of several items is a success when some are refused.

    Args:
        status: what is told of those.
    """

    def change(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            try:
                data: Data = await genuine(call, arguments)
            except AdapterError as error:
                if error.code != "partial_failure":
                    raise
                told = [(item["node_id"], item.get("status", status)) for item in error.partial["items"]]
                data = {"items": [{"node_id": node, "success": True, "status": found} for node, found in told]}
            return data

        return handler

    return change


def nothing_of_the_rest(call: Call, error: AdapterError) -> Exception | None:
    if error.code != "partial_failure":
        return None
    return AdapterError("partial_failure", error.message, partial={"items": []})


def retries_when_back(*names: str) -> Bend:
    """Return the defect that a write by these tools that failed is done again after the next call of another one that succeeds."""
    kept: list[tuple[Handler, Any]] = []

    def keeping(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            try:
                data: Data = await genuine(call, arguments)
            except AdapterError as error:
                if error.code == "connect_failed":
                    kept.append((genuine, arguments))
                raise
            return data

        return handler

    def delivering(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            data: Data = await genuine(call, arguments)
            while kept:
                write, earlier = kept.pop()
                await write(Call(protocol="", operation="", endpoint="", writes=True), earlier)
            return data

        return handler

    def bend(server: AdapterServer) -> None:
        for name in list(server._tools):
            wrap(server, name, keeping if name in names else delivering)

    return bend


MUTANTS: tuple[Mutant, ...] = (
    Mutant(
        id="MU-20b",
        protocol="modbus",
        sentence="With writes disabled the write is sent, and then denied.",
        bend=guard_after_sending("write_register"),
        items=on("modbus", "ERR-002 ERR-005 ERR-006"),
        requirements="ERR-006 WR-003",
        areas="err",
    ),
    Mutant(
        id="MU-20u",
        protocol="opcua",
        sentence="A write whose answer never came was not sent.",
        bend=says_not_sent,
        items=on("opcua", "ERR-003 ERR-005 ERR-006"),
        requirements="ERR-006",
        areas="err",
    ),
    Mutant(
        id="MU-29e",
        protocol="modbus",
        sentence="A write that failed for want of a connection is made up for at the next call.",
        bend=retries_when_back("write_register"),
        items="ERR-006.modbus",
        requirements="ERR-006",
        areas="err",
    ),
    Mutant(
        id="MU-45b",
        protocol="modbus",
        sentence="Every exception of the device is a protocol_error.",
        bend=failing(change=collapsed),
        items="ERR-002.modbus",
        requirements="ERR-002",
        areas="err",
    ),
    Mutant(
        id="MU-45c",
        protocol="modbus",
        sentence="A parity error of the device's memory is an unknown exception.",
        bend=parity_is_unknown,
        items="ERR-002.modbus",
        requirements="ERR-002",
        areas="err",
    ),
    Mutant(
        id="MU-46b",
        protocol="modbus",
        sentence="A busy device is a success without data.",
        bend=succeeding("read_multiple_holding_registers", code="device_busy", answer=_nothing),
        items="ERR-002.modbus",
        requirements="ERR-002",
        areas="err",
    ),
    Mutant(
        id="MU-61",
        protocol="opcua",
        sentence="In a list of values there is the text of an error.",
        bend=each("read_multiple_opcua_nodes", change=errors_among_values),
        items="ERR-008.opcua",
        requirements="ERR-008",
        areas="err",
    ),
    Mutant(
        id="MU-61w",
        protocol="opcua",
        sentence="Of several writes all are told as written when the server has refused one.",
        bend=each("write_multiple_opcua_nodes", change=as_if_all_were_written("Good")),
        items="WR-001.opcua",
        requirements="ERR-008",
        areas="wr",
    ),
    Mutant(
        id="MU-61l",
        protocol="opcua",
        sentence="Several writes of which one was refused are a success, with the refusal in the list.",
        bend=each("write_multiple_opcua_nodes", change=as_if_all_were_written("BadUserAccessDenied")),
        items="WR-001.opcua",
        requirements="ERR-008",
        areas="wr",
    ),
    Mutant(
        id="MU-61p",
        protocol="opcua",
        sentence="Of several nodes none is told when one is missing.",
        bend=failing("read_multiple_opcua_nodes", change=nothing_of_the_rest),
        items="ERR-008.opcua",
        requirements="ERR-008",
        areas="err",
    ),
    Mutant(
        id="MU-62",
        protocol="modbus",
        sentence="While the device is off, invalid input is a failed connection.",
        bend=connects_first,
        items="ERR-007.modbus",
        requirements="ERR-007",
        areas="err",
    ),
    Mutant(
        id="MU-62q",
        protocol="mqtt",
        sentence="While the broker is off, invalid input is a failed connection.",
        bend=connects_first,
        items="ERR-007.mqtt",
        requirements="ERR-007",
        areas="err",
    ),
    Mutant(
        id="MU-62o",
        protocol="opcua",
        sentence="While the server is off, invalid input is a failed connection.",
        bend=connects_first_opcua,
        items="ERR-007.opcua",
        requirements="ERR-007",
        areas="err",
    ),
    Mutant(
        id="MU-117b",
        protocol="opcua",
        sentence="Error codes are names of exceptions, and the same failure has now one, then another.",
        bend=result(named_after_exceptions()),
        items=on("opcua", "ERR-001 ERR-003 ERR-005 ERR-006 ERR-007 ERR-008"),
        requirements="ENV-001 ERR-001",
        areas="err",
    ),
    Mutant(
        id="MU-118b",
        protocol="opcua",
        sentence="Every Bad status is a protocol_error.",
        bend=failing("read_opcua_node", "write_opcua_node", change=all_alike),
        items="ERR-003.opcua",
        requirements="ERR-003",
        areas="err",
    ),
    Mutant(
        id="MU-118d",
        protocol="opcua",
        sentence="A denied access is a missing node.",
        bend=failing(change=denied_is_an_address),
        items="ERR-003.opcua",
        requirements="ERR-003",
        areas="err",
    ),
    Mutant(
        id="MU-119",
        protocol="mqtt",
        sentence="A connection that the broker refuses is a timeout.",
        bend=refusal_is_a_timeout,
        items="ERR-004.mqtt",
        requirements="ERR-004",
        areas="err",
    ),
    Mutant(
        id="MU-119s",
        protocol="mqtt",
        sentence="A subscription that the broker refuses is a success.",
        bend=subscriptions_are_always_granted,
        items=on("mqtt", "ERR-001 ERR-004"),
        requirements="ERR-001 ERR-004",
        areas="err",
    ),
    Mutant(
        id="MU-120b",
        protocol="opcua",
        sentence="A refused, a reset and a silent connection are all a lost one.",
        bend=one_code("connection_lost"),
        items=on("opcua", "ERR-003 ERR-005"),
        requirements="ERR-003 ERR-005",
        areas="err",
    ),
    Mutant(
        id="MU-120c",
        protocol="mqtt",
        sentence="A refused, a reset and a silent connection are all a timeout.",
        bend=one_code("timeout"),
        items=on("mqtt", "ERR-004 ERR-005"),
        requirements="ERR-004 ERR-005",
        areas="err",
    ),
)
