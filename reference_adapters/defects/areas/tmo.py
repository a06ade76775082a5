"""Defects that the checks of the area TMO notice."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Any

from ...core import AdapterError, AdapterServer, Call
from ...mqtt import link as mqtt_link
from ...mqtt.connection import Connection
from ..defect import Change, Data, Defect, Handler, around, defect, failing, tools_of
from .con import over_a_stream

__all__ = ["DEFECTS"]

_READ, _WRITE = "read_multiple_holding_registers", "write_register"
_LIBRARY_RETRIES, _ADAPTER_RETRIES = 4, 3


def patient(seconds: float, tool: str) -> Change:
    """Return the defect that the adapter waits so long, whatever it was told."""

    def apply(server: AdapterServer) -> None:
        server._deadline_s = seconds
        owner = tools_of(server, tool)
        owner._link._timeout_s = seconds

    return apply


def patient_with_every_byte(server: AdapterServer) -> None:
    server._deadline_s = 3600.0
    over_a_stream(_READ, 3, part=1)(server)


def nested_retries(server: AdapterServer) -> None:
    """Repeat a read in the library, which nobody counts, and in the adapter."""
    link = tools_of(server, _READ)._link
    link._timeout_s = 0.3
    attempt = link._attempt

    async def library(call: Call, send: Any) -> Any:
        counted = call.attempts + 1
        for _ in range(1 if call.writes else _LIBRARY_RETRIES - 1):
            try:
                return await attempt(call, send)
            except AdapterError as error:
                if error.code != "timeout" or call.writes:
                    raise
            finally:
                call.attempts = counted
        try:
            return await attempt(call, send)
        finally:
            call.attempts = counted

    link._attempt = library
    asks_again(_READ, _ADAPTER_RETRIES)(server)


def asks_again(tool: str, times: int) -> Change:
    """Return the defect that a read that was not answered is asked so often in all, whatever the adapter was told."""

    @around(tool)
    async def again(genuine: Handler, call: Call, arguments: Any) -> Data:
        for _ in range(times - 1):
            try:
                return await genuine(call, arguments)
            except AdapterError as error:
                if error.code != "timeout":
                    raise
        return await genuine(call, arguments)

    return again


def subscribes_thrice(server: AdapterServer) -> None:
    """A SUBSCRIBE that is not answered at once is sent twice more."""
    genuine = Connection.subscribe

    async def subscribe(connection: Connection, filters: Mapping[str, int]) -> list[int]:
        asked = [asyncio.ensure_future(genuine(connection, filters))]
        while len(asked) < 3 and not (await asyncio.wait(asked, timeout=0.05))[0]:
            asked.append(asyncio.ensure_future(genuine(connection, filters)))
        await asyncio.wait(asked)
        return asked[0].result()

    Connection.subscribe = subscribe


def repeated_when_cancelled(*names: str) -> Change:
    """Return the defect that a call that is cancelled begins anew, where nobody can cancel it."""
    begun: list[asyncio.Future[Data]] = []

    @around(*names)
    async def again(genuine: Handler, call: Call, arguments: Any) -> Data:
        try:
            data = await genuine(call, arguments)
        except asyncio.CancelledError:
            begun.append(asyncio.ensure_future(genuine(call, arguments)))
            raise
        return data

    return again


def deaf_to_cancellation(server: AdapterServer) -> None:
    """Let every call wait until the one before it is over, and be carried out to its end although it has been cancelled."""
    turn = asyncio.Lock()

    async def at_its_turn(genuine: Handler, call: Call, arguments: Any) -> Data:
        async with turn:
            return await genuine(call, arguments)

    @around()
    async def queued(genuine: Handler, call: Call, arguments: Any) -> Data:
        return await asyncio.shield(asyncio.ensure_future(at_its_turn(genuine, call, arguments)))

    queued(server)


def _not_sent(call: Call, error: AdapterError) -> Exception | None:
    return AdapterError("timeout", "the write was given up", outcome="not_sent") if error.code == "timeout" else None


def pausing(seconds: float) -> Change:
    """Return the defect that the pauses between attempts to connect are all so long."""

    def apply(server: AdapterServer) -> None:
        mqtt_link._FIRST_RETRY_S = mqtt_link._LAST_RETRY_S = seconds

    return apply


DEFECTS: tuple[Defect, ...] = (
    defect(
        "MU-30",
        "modbus",
        "A connection whose other end has vanished is waited for without end.",
        patient(3600.0, _READ),
        "TMO-001 TMO-002 TMO-004",
        "TMO-001",
        waits=True,
    ),
    defect(
        "MU-30d",
        "modbus",
        "Every byte of an answer begins the time limit anew.",
        patient_with_every_byte,
        "TMO-001 TMO-002",
    ),
    defect(
        "MU-31",
        "opcua",
        "The timeout that was set has no effect: it is 30 s.",
        patient(30.0, "read_opcua_node"),
        "TMO-001 TMO-002 TMO-004",
        "TMO-001",
    ),
    defect(
        "MU-32",
        "modbus",
        "Adapter and library both repeat a read, so twelve requests leave.",
        nested_retries,
        "TMO-002",
    ),
    defect("MU-31r", "modbus", "Another timeout than the usual one has no effect.", patient(2.4, _READ), "TMO-002"),
    defect("MU-31s", "s7", "Another timeout than the usual one has no effect.", patient(2.4, "read_db"), "TMO-002"),
    defect(
        "MU-32r",
        "modbus",
        "A read that is not answered is asked three times, and the subject file says once.",
        asks_again(_READ, 3),
        "TMO-002",
    ),
    defect(
        "MU-32q",
        "mqtt",
        "A subscription that is not answered is asked for three times, and the subject file says once.",
        subscribes_thrice,
        "TMO-002",
    ),
    defect(
        "MU-32t",
        "bacnet",
        "A question that is not answered is sent four times, and the subject file says twice.",
        asks_again("read_property", 2),
        "TMO-002",
    ),
    defect(
        "MU-33",
        "modbus",
        "A call that was cancelled begins anew.",
        repeated_when_cancelled(_READ, _WRITE),
        "TMO-003",
        "TMO-003 WR-003",
    ),
    defect(
        "MU-33o",
        "opcua",
        "A Write that was cancelled begins anew.",
        repeated_when_cancelled("write_opcua_node"),
        "TMO-003",
        "TMO-003 WR-003",
    ),
    defect(
        "MU-33q",
        "mqtt",
        "A publish that was cancelled begins anew.",
        repeated_when_cancelled("publish_message"),
        "TMO-003",
        "TMO-003 WR-003",
    ),
    defect(
        "MU-33w",
        "modbus",
        "A write that waits for its turn when it is cancelled is carried out.",
        deaf_to_cancellation,
        "",
        "TMO-003",
    ),
    defect(
        "MU-33wo",
        "opcua",
        "A Write that waits for its turn when it is cancelled is carried out.",
        deaf_to_cancellation,
        "",
        "TMO-003",
    ),
    defect(
        "MU-34",
        "modbus",
        "A write whose answer did not come counts as not sent.",
        failing(_WRITE, change=_not_sent),
        "TMO-004",
        "ERR-006 TMO-004",
    ),
    defect(
        "MU-34o",
        "opcua",
        "A Write whose answer did not come counts as not sent.",
        failing("write_opcua_node", change=_not_sent),
        "TMO-004",
        "ERR-006 TMO-004",
    ),
    defect("MU-125", "mqtt", "Connecting again is tried without a pause.", pausing(0.001), "", "TMO-005"),
    defect("MU-125p", "mqtt", "Connecting again is tried every 0.2 s, without end.", pausing(0.2), "", "TMO-005"),
)
