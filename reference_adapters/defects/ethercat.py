"""Defects of an EtherCAT adapter."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

from ..core import AdapterError, AdapterServer, Call
from .any_protocol import guard_after_sending
from .areas.further import last_answer, module_of, reencoded
from .defect import Change, Data, Handler, around, defect, failing, succeeding, told, tools_of

__all__ = ["DEFECTS"]

_READ, _WRITE, _STATE, _SCAN = "read_sdo", "write_sdo", "get_slave_info", "scan_network"
_INPUTS, _OUTPUTS = "read_pdo", "write_pdo"
_CYCLE, _WATCHDOG = 2, 3
"""Numbers of the words that tell the worker its times."""
_NEVER_S = "1000"

_module = partial(module_of, "ethercat")


def _segment(server: AdapterServer, tool: str) -> Any:
    return tools_of(server, tool)._segment


def _objects(arguments: Any, content: bytes) -> Data:
    place = {"slave_position": arguments.slave_position, "index": arguments.index, "subindex": arguments.subindex}
    return {**place, **_module("codec").decode(content, arguments.data_type)}


def _as_asked(call: Call, arguments: Any) -> Data:
    return _objects(arguments, _module("codec").encode(arguments.value, arguments.data_type))


def _outputs(call: Call, arguments: Any) -> Data:
    return {"slave_position": arguments.slave_position, "bytes": arguments.data, "watchdog_s": 2.0}


def _not_sent(tool: str, answer: Callable[[Call, Any], Data]) -> Change:
    @around(tool)
    async def unsent(genuine: Handler, call: Call, arguments: Any) -> Data:
        return answer(call, arguments)

    return unsent


def missing_is_zero(server: AdapterServer) -> None:
    codec = _module("codec")

    @around(_READ)
    async def zero(genuine: Handler, call: Call, arguments: Any) -> Data:
        try:
            return await genuine(call, arguments)
        except AdapterError as error:
            if error.code != "illegal_address" or error.field is not None:
                raise
            return _objects(arguments, bytes(codec.width(arguments.data_type)))

    zero(server)


def last_for_missing(server: AdapterServer) -> None:
    segment = _segment(server, _READ)
    genuine = segment._attempt

    async def attempt(call: Call, op: str, changes: bool, members: Data) -> Any:
        if op == "upload":
            members["position"] = min(members["position"], 1)
        return await genuine(call, op, changes, members)

    segment._attempt = attempt


def swapped(server: AdapterServer) -> None:
    tools = _module("tools")
    encode, decode = tools.encode, tools.decode

    def turned(content: bytes, kind: str) -> bytes:
        return content[::-1] if kind == "INT32" else content

    tools.encode = lambda value, kind: turned(encode(value, kind), kind)
    tools.decode = lambda content, kind: {**decode(turned(content, kind), kind), "raw": content.hex()}


def next_slave(server: AdapterServer) -> None:
    segment = _segment(server, _OUTPUTS)
    genuine = segment.ask

    async def ask(call: Call, op: str, **members: Any) -> Any:
        if op != "drive" or members["position"] != 0:
            return await genuine(call, op, **members)
        held = await genuine(call, op, **{**members, "position": 1, "data": members["data"], "offset": 0})
        return held[: len(members["data"])]

    segment.ask = ask


def twice(server: AdapterServer) -> None:
    segment = _segment(server, _WRITE)
    genuine = segment.ask

    async def ask(call: Call, op: str, **members: Any) -> Any:
        if op == "download":
            await genuine(call, op, **members)
        return await genuine(call, op, **members)

    segment.ask = ask


def with_time(word: int, seconds: str) -> Change:
    """Return the defect that the worker has another time."""

    def apply(server: AdapterServer) -> None:
        _segment(server, _WRITE)._words[word] = seconds

    return apply


def cleared_in_time(server: AdapterServer) -> None:
    segment = _segment(server, _WRITE)
    segment._words[_WATCHDOG] = "0"
    genuine = segment.close

    async def close() -> None:
        for position in (0, 1):
            await segment._request("set_state", {"position": position, "state": "SAFEOP"})
        await genuine()

    server._close = close


def left_again(server: AdapterServer) -> None:
    segment = _segment(server, _OUTPUTS)

    @around(_OUTPUTS)
    async def leaving(genuine: Handler, call: Call, arguments: Any) -> Data:
        data = await genuine(call, arguments)
        await segment.ask(_hidden(), "set_state", position=arguments.slave_position, state="SAFEOP")
        return data

    leaving(server)


def to_op(tool: str) -> Change:
    """Return the defect that a tool takes the slave to OP that it reads."""

    def apply(server: AdapterServer) -> None:
        segment = _segment(server, tool)

        @around(tool)
        async def driving(genuine: Handler, call: Call, arguments: Any) -> Data:
            with suppress(AdapterError):
                await segment.ask(_hidden(), "set_state", position=arguments.slave_position, state="OP")
            data = await genuine(call, arguments)
            return data

        driving(server)

    return apply


def _hidden() -> Call:
    """Return a call for what a tool sends beside its work, which is not told."""
    return Call(protocol="", operation="", endpoint="", writes=False)


def always_in_op(data: Data) -> Data:
    return {**data, "state": "OP"}


def as_asked_for(server: AdapterServer) -> None:
    """The state is the one that the adapter has asked for, once it has asked for one."""
    asked: set[int] = set()

    @around(_OUTPUTS)
    async def driving(genuine: Handler, call: Call, arguments: Any) -> Data:
        data = await genuine(call, arguments)
        asked.add(arguments.slave_position)
        return data

    @around(_STATE)
    async def remembered(genuine: Handler, call: Call, arguments: Any) -> Data:
        data = await genuine(call, arguments)
        return always_in_op(data) if arguments.slave_position in asked else data

    driving(server)
    remembered(server)


def found_once(server: AdapterServer) -> None:
    found: Data = {}

    @around(_SCAN)
    async def remembered(genuine: Handler, call: Call, arguments: Any) -> Data:
        if not found:
            found.update(await genuine(call, arguments))
        return found

    remembered(server)


def _from_1(data: Data) -> Data:
    return {**data, "slaves": [{**one, "slave_position": one["slave_position"] + 1} for one in data["slaves"]]}


def _short(value: Any, kind: str) -> Any:
    return (value + 0x8000) % 0x10000 - 0x8000 if kind == "INT16" and type(value) is int else value


def _zero_for_a_text(value: Any, kind: str) -> Any:
    return 0.0 if kind == "FLOAT32" and isinstance(value, str) else value


def _one_code(call: Call, error: AdapterError) -> Exception | None:
    if error.code not in ("illegal_address", "not_writable", "illegal_value") or error.outcome == "not_sent":
        return None
    return AdapterError("device_failure", error.message, outcome="rejected" if call.writes else "not_applicable")


def _another_reason(call: Call, error: AdapterError) -> Exception | None:
    if error.code != "config_error":
        return None
    return AdapterError("session_error", error.message, outcome="not_sent")


DEFECTS = (
    defect(
        "MU-01ec",
        "ethercat",
        "A scan counts the slaves from 1, all other tools from 0.",
        told(_SCAN, change=_from_1),
        "C7",
        "RD-001",
    ),
    defect(
        "MU-02ec",
        "ethercat",
        "Outputs for the first slave are sent to the second.",
        next_slave,
        "C4 C6 FC5",
        "ADR-001 WR-001 WR-002 RD-001 ERR-002",
    ),
    defect(
        "MU-04ec",
        "ethercat",
        "The bytes of an INT32 are swapped, in reads and writes alike.",
        swapped,
        "C2 SC1 SC2",
        "RD-001 WR-001 ENC-001 CON-004",
    ),
    defect(
        "MU-06ec",
        "ethercat",
        "A position at which there is no slave is that of the last one.",
        last_for_missing,
        "FC6",
        "RD-005",
    ),
    defect(
        "MU-08ec",
        "ethercat",
        "Of a number that is too large the lower bits are sent.",
        reencoded("ethercat", _short),
        "FC2",
        "ADR-003",
    ),
    defect(
        "MU-11ec",
        "ethercat",
        "A text is written to a FLOAT32 as 0.",
        reencoded("ethercat", _zero_for_a_text),
        "FC3",
        "ADR-004",
    ),
    defect(
        "MU-14ec",
        "ethercat",
        "An object is told as written, and nothing is sent.",
        _not_sent(_WRITE, _as_asked),
        "C3 C5 FC2 FC4 SC2 SC4",
        "WR-001 ERR-002",
    ),
    defect(
        "MU-14eco",
        "ethercat",
        "Outputs are told as written, and nothing is sent.",
        _not_sent(_OUTPUTS, _outputs),
        "C4 C6 FC5 SC4",
        "WR-001 ERR-002 RD-001",
    ),
    defect(
        "MU-14ecr",
        "ethercat",
        "An object that the slave refuses is told as written.",
        succeeding(_WRITE, code="illegal_value", answer=_as_asked),
        "FC4",
        "ERR-002",
    ),
    defect(
        "MU-14ecs",
        "ethercat",
        "Outputs of a slave that refuses OP are told as written.",
        succeeding(_OUTPUTS, code="config_error", answer=_outputs),
        "FC5",
        "ERR-002",
    ),
    defect(
        "MU-17ec",
        "ethercat",
        "Outputs are sent once and not repeated, so they fall at the slave's watchdog.",
        with_time(_CYCLE, _NEVER_S),
        "C4",
        "WR-001",
    ),
    defect(
        "MU-17ecs",
        "ethercat",
        "A slave is taken back to SAFEOP as soon as its outputs are written.",
        left_again,
        "C4 C6",
        "WR-001 RD-001",
    ),
    defect(
        "MU-20ec",
        "ethercat",
        "With writes disabled an object is written, and then denied.",
        guard_after_sending(_WRITE),
        "C5 FC4",
        "WR-004 ERR-006",
    ),
    defect("MU-25ec", "ethercat", "An object is written twice.", twice, "C3 C5 FC2 SC2", "WR-003"),
    defect(
        "MU-35ec", "ethercat", "The state of a slave is always OP.", told(_STATE, change=always_in_op), "C6", "RD-001"
    ),
    defect(
        "MU-35ecs",
        "ethercat",
        "A slave is in the state that the adapter has asked for.",
        as_asked_for,
        "C6",
        "RD-001",
    ),
    defect(
        "MU-35eci",
        "ethercat",
        "A scan of the line tells what the first one has found.",
        found_once,
        "C7",
        "RD-001 RD-004",
    ),
    defect(
        "MU-37ec",
        "ethercat",
        "Of several objects that are read at the same time all calls are told the last.",
        last_answer(_READ),
        "SC1",
        "RD-001",
    ),
    defect(
        "MU-40ec", "ethercat", "An object that does not exist reads as zero.", missing_is_zero, "FC1", "ERR-002 RD-007"
    ),
    defect(
        "MU-45ec",
        "ethercat",
        "Whatever a slave refuses is a failure of the slave.",
        failing(_READ, _WRITE, change=_one_code),
        "FC1 FC4 FC6",
        "ERR-002",
    ),
    defect(
        "MU-45ecs",
        "ethercat",
        "A slave that does not take its configuration is told as an error of the session.",
        failing(_OUTPUTS, change=_another_reason),
        "FC5",
        "ERR-002",
    ),
    defect(
        "MU-52ec",
        "ethercat",
        "Slaves have no watchdog, so outputs stay on when the adapter has ended.",
        with_time(_WATCHDOG, "0"),
        "C4",
        "WR-001 MCP-009",
    ),
    defect(
        "MU-52ecs",
        "ethercat",
        "Slaves have no watchdog: their outputs are cleared by an adapter that ends in order, and by no other.",
        cleared_in_time,
        "C4",
        "WR-001",
    ),
    defect(
        "MU-53ec",
        "ethercat",
        "Reading inputs takes the slave to OP, also with writes disabled.",
        to_op(_INPUTS),
        "C5",
        "WR-004",
    ),
    defect(
        "MU-53ecs",
        "ethercat",
        "Reading an object takes the slave to OP, also with writes disabled.",
        to_op(_READ),
        "C5",
        "WR-004",
    ),
)
