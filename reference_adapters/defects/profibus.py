"""Defects of a PROFIBUS DP adapter."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

from pydantic import create_model, field_validator

from ..core import AdapterError, AdapterServer, Call
from .any_protocol import guard_after_sending
from .areas.further import module_of
from .defect import Data, Handler, around, defect, failing, succeeding, tools_of, wrap

__all__ = ["DEFECTS"]

_READ, _WRITE, _SCAN = "read_inputs", "write_outputs", "scan_bus"
_LOCK_WITHOUT_WATCHDOG = 0x80

_module = partial(module_of, "profibus")


def _master(server: AdapterServer) -> Any:
    return tools_of(server, _WRITE)._master


def cut_off(server: AdapterServer) -> None:
    def masked(cls: Any, values: Any) -> Any:
        return [value & 0xFF if type(value) is int else value for value in values]

    check: Any = field_validator("data", mode="before")(classmethod(masked))
    genuine = server._tools[_WRITE].model
    wrap(
        server,
        _WRITE,
        lambda handler: handler,
        model=create_model(genuine.__name__, __base__=genuine, __validators__={"cut": check}),
    )


def any_length(server: AdapterServer) -> None:
    master = _master(server)

    @around(_WRITE)
    async def unchecked(genuine: Handler, call: Call, arguments: Any) -> Data:
        held = await master.write(call, arguments.slave_address, lambda _: bytes(arguments.data))
        return {
            "slave_address": arguments.slave_address,
            "bytes": list(held),
            "watchdog_s": master.watchdog_s,
        }

    unchecked(server)


def write_not_sent(server: AdapterServer) -> None:
    master = _master(server)

    async def write(call: Call, station: int, change: Callable[[bytes], bytes]) -> bytes:
        return change(bytes(master.slaves[station].output_length))

    master.write = write


def sent_before_refused(server: AdapterServer) -> None:
    master = _master(server)

    @around(_WRITE)
    async def sending(genuine: Handler, call: Call, arguments: Any) -> Data:
        try:
            data = await genuine(call, arguments)
        except AdapterError as error:
            if error.code == "config_error":
                hidden = Call(protocol="", operation="", endpoint="", writes=True)
                with suppress(AdapterError):
                    await master._exchange_data(hidden, arguments.slave_address, bytes(arguments.data))
            raise
        return data

    sending(server)


def written_once(server: AdapterServer) -> None:
    async def never() -> None:
        return

    _master(server)._cycle = never


def left_on(server: AdapterServer) -> None:
    module, master = _module("master"), _master(server)
    module._LOCK_AND_WATCHDOG = _LOCK_WITHOUT_WATCHDOG
    master.line.send = lambda telegram: None


def reading_owns(server: AdapterServer) -> None:
    master = _master(server)

    @around(_READ)
    async def owning(genuine: Handler, call: Call, arguments: Any) -> Data:
        if arguments.slave_address in master.slaves:
            # What it sends beside the reading is not told.
            hidden = Call(protocol="", operation="", endpoint="", writes=True)
            try:
                await master.write(hidden, arguments.slave_address, lambda held: held)
            except AdapterError as error:
                if error.code != "access_denied":
                    raise
        data = await genuine(call, arguments)
        return data

    owning(server)


def listed_not_asked(server: AdapterServer) -> None:
    master = _master(server)

    @around(_SCAN)
    async def from_the_map(genuine: Handler, call: Call, arguments: Any) -> Data:
        return {"stations": [{"address": address, "type": "slave"} for address in sorted(master.slaves)]}

    from_the_map(server)


def _zeros(call: Call, arguments: Any) -> Data:
    return {"slave_address": arguments.slave_address, "bytes": [0, 0]}


def _one_code(call: Call, error: AdapterError) -> Exception | None:
    if error.code not in ("config_error", "access_denied"):
        return None
    return AdapterError("session_error", error.message, outcome="not_sent")


DEFECTS = (
    defect(
        "MU-08p",
        "profibus",
        "300 is written to an output byte as 44, and told as a success.",
        cut_off,
        "FP3",
        "ADR-003",
    ),
    defect(
        "MU-10p",
        "profibus",
        "Outputs of another length than the slave's are sent as they are.",
        any_length,
        "FP2",
        "ADR-004 ERR-006",
    ),
    defect(
        "MU-14p",
        "profibus",
        "Outputs are told as written, and nothing is sent.",
        write_not_sent,
        "P3 P4 P5 FP3 FP4 FP5 SP2 SP4",
        "WR-001 ERR-002",
    ),
    defect(
        "MU-17p",
        "profibus",
        "Outputs are written once and not repeated, so they fall at the slave's watchdog.",
        written_once,
        "P3",
        "WR-001",
    ),
    defect(
        "MU-20p",
        "profibus",
        "With writes disabled the outputs are sent, and then denied.",
        guard_after_sending(_WRITE),
        "P4 SP4",
        "WR-004 ERR-006",
    ),
    defect(
        "MU-20pi",
        "profibus",
        "Outputs are sent to a slave of another kind, and refused afterwards.",
        sent_before_refused,
        "FP5",
        "ERR-006",
    ),
    defect(
        "MU-35p",
        "profibus",
        "A scan of the line lists the configured slaves, and asks nobody.",
        listed_not_asked,
        "P6",
        "RD-001 RD-004",
    ),
    defect(
        "MU-40p",
        "profibus",
        "The inputs of a slave that does not answer are zero.",
        succeeding(_READ, code="timeout", answer=_zeros),
        "FP1 SP4",
        "ERR-002 REC-002",
    ),
    defect(
        "MU-45p",
        "profibus",
        "A slave of another kind, and one of another master, are told as the same error of a session.",
        failing(_WRITE, change=_one_code),
        "FP4 FP5",
        "ERR-002",
    ),
    defect(
        "MU-52p",
        "profibus",
        "Slaves have no watchdog and no farewell, so outputs stay on when the adapter has ended.",
        left_on,
        "P5",
        "MCP-009 WR-001",
    ),
    defect(
        "MU-53p",
        "profibus",
        "Reading inputs parameterises the slave and exchanges data with it, also with writes disabled.",
        reading_owns,
        "P4",
        "WR-004",
    ),
)
