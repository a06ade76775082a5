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
from .mutant import Data, Handler, Mutant, failing, succeeding, wrap

__all__ = ["MUTANTS"]

_READ, _WRITE, _SCAN = "read_inputs", "write_outputs", "scan_bus"
_LOCK_WITHOUT_WATCHDOG = 0x80

_module = partial(module_of, "profibus")


def _master(server: AdapterServer) -> Any:
    tools: Any = server._tools[_WRITE].handler
    return tools.__self__._master


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

    def unchecked(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            held = await master.write(call, arguments.slave_address, lambda _: bytes(arguments.data))
            return {
                "slave_address": arguments.slave_address,
                "bytes": list(held),
                "watchdog_s": master.watchdog_s,
            }

        return handler

    wrap(server, _WRITE, unchecked)


def write_not_sent(server: AdapterServer) -> None:
    master = _master(server)

    async def write(call: Call, station: int, change: Callable[[bytes], bytes]) -> bytes:
        return change(bytes(master.slaves[station].output_length))

    master.write = write


def sent_before_refused(server: AdapterServer) -> None:
    master = _master(server)

    def sending(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            try:
                data: Data = await genuine(call, arguments)
            except AdapterError as error:
                if error.code == "config_error":
                    hidden = Call(protocol="", operation="", endpoint="", writes=True)
                    with suppress(AdapterError):
                        await master._exchange_data(hidden, arguments.slave_address, bytes(arguments.data))
                raise
            return data

        return handler

    wrap(server, _WRITE, sending)


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

    def owning(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            if arguments.slave_address in master.slaves:
                # What it sends beside the reading is not told.
                hidden = Call(protocol="", operation="", endpoint="", writes=True)
                try:
                    await master.write(hidden, arguments.slave_address, lambda held: held)
                except AdapterError as error:
                    if error.code != "access_denied":
                        raise
            data: Data = await genuine(call, arguments)
            return data

        return handler

    wrap(server, _READ, owning)


def listed_not_asked(server: AdapterServer) -> None:
    master = _master(server)

    def from_the_map(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            return {"stations": [{"address": address, "type": "slave"} for address in sorted(master.slaves)]}

        return handler

    wrap(server, _SCAN, from_the_map)


def _zeros(call: Call, arguments: Any) -> Data:
    return {"slave_address": arguments.slave_address, "bytes": [0, 0]}


def _one_code(call: Call, error: AdapterError) -> Exception | None:
    if error.code not in ("config_error", "access_denied"):
        return None
    return AdapterError("session_error", error.message, outcome="not_sent")


MUTANTS = (
    Mutant(
        id="MU-08p",
        protocol="profibus",
        sentence="300 is written to an output byte as 44, and told as a success.",
        bend=cut_off,
        items="FP3",
        requirements="ADR-003",
    ),
    Mutant(
        id="MU-10p",
        protocol="profibus",
        sentence="Outputs of another length than the slave's are sent as they are.",
        bend=any_length,
        items="FP2",
        requirements="ADR-004 ERR-006",
    ),
    Mutant(
        id="MU-14p",
        protocol="profibus",
        sentence="Outputs are told as written, and nothing is sent.",
        bend=write_not_sent,
        items="P3 P4 P5 FP3 FP4 FP5 SP2 SP4",
        requirements="WR-001 ERR-002",
    ),
    Mutant(
        id="MU-17p",
        protocol="profibus",
        sentence="Outputs are written once and not repeated, so they fall at the slave's watchdog.",
        bend=written_once,
        items="P3",
        requirements="WR-001",
    ),
    Mutant(
        id="MU-20p",
        protocol="profibus",
        sentence="With writes disabled the outputs are sent, and then denied.",
        bend=guard_after_sending(_WRITE),
        items="P4 SP4",
        requirements="WR-004 ERR-006",
    ),
    Mutant(
        id="MU-20pi",
        protocol="profibus",
        sentence="Outputs are sent to a slave of another kind, and refused afterwards.",
        bend=sent_before_refused,
        items="FP5",
        requirements="ERR-006",
    ),
    Mutant(
        id="MU-35p",
        protocol="profibus",
        sentence="A scan of the line lists the configured slaves, and asks nobody.",
        bend=listed_not_asked,
        items="P6",
        requirements="RD-001 RD-004",
    ),
    Mutant(
        id="MU-40p",
        protocol="profibus",
        sentence="The inputs of a slave that does not answer are zero.",
        bend=succeeding(_READ, code="timeout", answer=_zeros),
        items="FP1 SP4",
        requirements="ERR-002 REC-002 not_proven",
    ),
    Mutant(
        id="MU-45p",
        protocol="profibus",
        sentence="A slave of another kind, and one of another master, are told as the same error of a session.",
        bend=failing(_WRITE, change=_one_code),
        items="FP4 FP5",
        requirements="ERR-002",
    ),
    Mutant(
        id="MU-52p",
        protocol="profibus",
        sentence="Slaves have no watchdog and no farewell, so outputs stay on when the adapter has ended.",
        bend=left_on,
        items="P5",
        requirements="MCP-009 WR-001",
    ),
    Mutant(
        id="MU-53p",
        protocol="profibus",
        sentence="Reading inputs parameterises the slave and exchanges data with it, also with writes disabled.",
        bend=reading_owns,
        items="P4",
        requirements="WR-004",
    ),
)
