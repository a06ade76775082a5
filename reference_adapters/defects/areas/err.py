"""Defects that the checks of the area ERR notice."""

from __future__ import annotations

from typing import Any

from ...core import AdapterError, AdapterServer, Call
from ...modbus import link as modbus_link
from ...mqtt import connection as mqtt_connection
from ...mqtt import link as mqtt_link
from ..any_protocol import guard_after_sending, named_after_exceptions, result
from ..defect import Change, Data, Defect, Handler, around, defect, failing, succeeding

__all__ = ["DEFECTS"]


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


def one_code(code: str) -> Change:
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


async def errors_among_values(genuine: Handler, call: Call, arguments: Any) -> Data:
    try:
        data = await genuine(call, arguments)
    except AdapterError as error:
        if error.code != "partial_failure":
            raise
        items = error.partial["items"]
        shown = [item if item["success"] else {**item, "value": f"Error: {item}"} for item in items]
        return {"items": [{**item, "success": True} for item in shown]}
    return data


def as_if_all_were_written(status: str) -> Change:
    """Return the defect that a write of several items is a success when some are refused.

    Args:
        status: what is told of those.
    """

    @around("write_multiple_opcua_nodes")
    async def all_written(genuine: Handler, call: Call, arguments: Any) -> Data:
        try:
            return await genuine(call, arguments)
        except AdapterError as error:
            if error.code != "partial_failure":
                raise
            told = [(item["node_id"], item.get("status", status)) for item in error.partial["items"]]
            return {"items": [{"node_id": node, "success": True, "status": found} for node, found in told]}

    return all_written


@around("read_multiple_opcua_nodes")
async def the_first_twenty_again(genuine: Handler, call: Call, arguments: Any) -> Data:
    items = (await genuine(call, arguments))["items"]
    return {"items": [{**items[index % 20], "node_id": item["node_id"]} for index, item in enumerate(items)]}


def last_good_value(server: AdapterServer) -> None:
    known: dict[str, Data] = {}

    @around("read_multiple_opcua_nodes")
    async def from_memory(genuine: Handler, call: Call, arguments: Any) -> Data:
        try:
            items = (await genuine(call, arguments))["items"]
        except AdapterError as error:
            told = (error.partial or {}).get("items", [])
            if not told or any(not item["success"] and item["node_id"] not in known for item in told):
                raise
            return {"items": [item if item["success"] else known[item["node_id"]] for item in told]}
        known.update((item["node_id"], item) for item in items)
        return {"items": items}

    from_memory(server)


def nothing_of_the_rest(call: Call, error: AdapterError) -> Exception | None:
    if error.code != "partial_failure":
        return None
    return AdapterError("partial_failure", error.message, partial={"items": []})


def retries_when_back(*names: str) -> Change:
    """Return the defect that a write by these tools that failed is done again after the next call of another one that succeeds."""
    kept: list[tuple[Handler, Any]] = []

    @around(*names)
    async def keeping(genuine: Handler, call: Call, arguments: Any) -> Data:
        try:
            return await genuine(call, arguments)
        except AdapterError as error:
            if error.code == "connect_failed":
                kept.append((genuine, arguments))
            raise

    async def delivering(genuine: Handler, call: Call, arguments: Any) -> Data:
        data = await genuine(call, arguments)
        while kept:
            write, earlier = kept.pop()
            await write(Call(protocol="", operation="", endpoint="", writes=True), earlier)
        return data

    def apply(server: AdapterServer) -> None:
        keeping(server)
        around(*server._tools.keys() - names)(delivering)(server)

    return apply


DEFECTS: tuple[Defect, ...] = (
    defect(
        "MU-20b",
        "modbus",
        "With writes disabled the write is sent, and then denied.",
        guard_after_sending("write_register"),
        "ERR-002 ERR-005 ERR-006",
        "ERR-006 WR-003",
    ),
    defect(
        "MU-20u",
        "opcua",
        "A write whose answer never came was not sent.",
        says_not_sent,
        "ERR-003 ERR-005 ERR-006",
        "ERR-006",
    ),
    defect(
        "MU-29e",
        "modbus",
        "A write that failed for want of a connection is made up for at the next call.",
        retries_when_back("write_register"),
        "ERR-006",
    ),
    defect(
        "MU-45b", "modbus", "Every exception of the device is a protocol_error.", failing(change=collapsed), "ERR-002"
    ),
    defect(
        "MU-45c",
        "modbus",
        "A parity error of the device's memory is an unknown exception.",
        parity_is_unknown,
        "ERR-002",
    ),
    defect(
        "MU-46b",
        "modbus",
        "A busy device is a success without data.",
        succeeding("read_multiple_holding_registers", code="device_busy", answer=_nothing),
        "ERR-002",
    ),
    defect(
        "MU-61",
        "opcua",
        "In a list of values there is the text of an error.",
        around("read_multiple_opcua_nodes")(errors_among_values),
        "ERR-008",
    ),
    defect(
        "MU-61w",
        "opcua",
        "Of several writes all are told as written when the server has refused one.",
        as_if_all_were_written("Good"),
        "WR-001",
        "ERR-008",
    ),
    defect(
        "MU-61l",
        "opcua",
        "Several writes of which one was refused are a success, with the refusal in the list.",
        as_if_all_were_written("BadUserAccessDenied"),
        "WR-001",
        "ERR-008",
    ),
    defect(
        "MU-61p",
        "opcua",
        "Of several nodes none is told when one is missing.",
        failing("read_multiple_opcua_nodes", change=nothing_of_the_rest),
        "ERR-008",
    ),
    defect(
        "MU-62", "modbus", "While the device is off, invalid input is a failed connection.", connects_first, "ERR-007"
    ),
    defect(
        "MU-62q", "mqtt", "While the broker is off, invalid input is a failed connection.", connects_first, "ERR-007"
    ),
    defect(
        "MU-62o",
        "opcua",
        "While the server is off, invalid input is a failed connection.",
        connects_first_opcua,
        "ERR-007",
    ),
    defect(
        "MU-61t",
        "opcua",
        "Of a batch of nodes those after the twentieth have the values of the first ones.",
        the_first_twenty_again,
        "ERR-008",
    ),
    defect(
        "MU-61m",
        "opcua",
        "Of several nodes one whose value is bad has the value that it had last.",
        last_good_value,
        "ERR-008",
    ),
    defect(
        "MU-117b",
        "opcua",
        "Error codes are names of exceptions, and the same failure has now one, then another.",
        result(named_after_exceptions()),
        "ERR-001 ERR-003 ERR-005 ERR-006 ERR-007 ERR-008",
        "ENV-001 ERR-001",
    ),
    defect(
        "MU-118b",
        "opcua",
        "Every Bad status is a protocol_error.",
        failing("read_opcua_node", "write_opcua_node", change=all_alike),
        "ERR-003",
    ),
    defect("MU-118d", "opcua", "A denied access is a missing node.", failing(change=denied_is_an_address), "ERR-003"),
    defect(
        "MU-119",
        "mqtt",
        "A connection that the broker refuses is a timeout.",
        refusal_is_a_timeout,
        "ERR-004",
        "ERR-004 ERR-006",
    ),
    defect(
        "MU-119s",
        "mqtt",
        "A subscription that the broker refuses is a success.",
        subscriptions_are_always_granted,
        "ERR-001 ERR-004",
        "ERR-004 MQT-002",
    ),
    defect(
        "MU-120b",
        "opcua",
        "A refused, a reset and a silent connection are all a lost one.",
        one_code("connection_lost"),
        "ERR-003 ERR-005",
    ),
    defect(
        "MU-120c",
        "mqtt",
        "A refused, a reset and a silent connection are all a timeout.",
        one_code("timeout"),
        "ERR-004 ERR-005",
    ),
)
