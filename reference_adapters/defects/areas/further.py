"""Defects that adapters for several further protocols have.

The library of each is an extra: an adapter's modules are imported when a defect is built in, not when the table is read.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Hashable
from importlib import import_module
from typing import Any

from pydantic import create_model, field_validator

from ...core import AdapterServer, Call
from ..defect import Change, Data, Handler, around, tools_of, wrap

__all__ = [
    "altered",
    "beginning",
    "controls_always",
    "cut_off",
    "last_answer",
    "lower_half",
    "merged",
    "module_of",
    "reencoded",
    "stripped",
    "truth",
]

_GATHERED_S = 0.02
"""Seconds for which an adapter gathers writes to one target: longer than the kit takes to send both."""


def module_of(protocol: str, name: str) -> Any:
    """Return a module of the reference adapter for a protocol."""
    return import_module(f"...{protocol}.{name}", __package__)


def last_answer(tool: str) -> Change:
    """Return the defect that of several calls at the same time all are told what the last of them has found."""

    def apply(server: AdapterServer) -> None:
        last: Data = {}
        under_way = 0
        all_done = asyncio.Condition()

        @around(tool)
        async def shared(genuine: Handler, call: Call, arguments: Any) -> Data:
            nonlocal under_way
            under_way += 1
            try:
                last.update(await genuine(call, arguments))
            finally:
                under_way -= 1
                async with all_done:
                    all_done.notify_all()
            async with all_done:
                await all_done.wait_for(lambda: under_way == 0)
            return dict(last)

        shared(server)

    return apply


def merged(tool: str, target: Callable[[Any], Hashable], answer: Callable[[Any], Data]) -> Change:
    """Return the defect that of several writes to one target at the same time only the last is sent, and all are told as successes."""

    def apply(server: AdapterServer) -> None:
        waiting: dict[Hashable, int] = {}

        @around(tool)
        async def merging(genuine: Handler, call: Call, arguments: Any) -> Data:
            place = target(arguments)
            waiting[place] = mine = waiting.get(place, 0) + 1
            await asyncio.sleep(_GATHERED_S)
            if waiting[place] != mine:
                return answer(arguments)
            data = await genuine(call, arguments)
            return data

        merging(server)

    return apply


def cut_off(tool: str, argument: str, bits: int) -> Change:
    """Return the defect that of a whole number of any size only the last bits count."""

    return altered(tool, argument, lambda value: value & (1 << bits) - 1 if type(value) is int else value)


def altered(tool: str, argument: str, change: Callable[[Any], Any]) -> Change:
    """Return the defect that an argument is changed before it is checked."""

    def changed(cls: Any, value: Any) -> Any:
        return change(value)

    def apply(server: AdapterServer) -> None:
        check: Any = field_validator(argument, mode="before")(classmethod(changed))
        genuine = server._tools[tool].model
        model = create_model(genuine.__name__, __base__=genuine, __validators__={"altered": check})
        wrap(server, tool, lambda handler: handler, model=model)

    return apply


def reencoded(protocol: str, change: Callable[[Any, str], Any]) -> Change:
    """Return the defect that a value is changed before it is encoded.

    Args:
        change: returns the value that is encoded, from that of the call and the name of its data type.
    """

    def apply(server: AdapterServer) -> None:
        tools = module_of(protocol, "tools")
        encode = tools.encode
        tools.encode = lambda value, kind, *rest: encode(change(value, kind), kind, *rest)

    return apply


def lower_half(value: Any, kind: str) -> Any:
    """Return what an INT keeps of a whole number of any size."""
    return (value + 0x8000) % 0x10000 - 0x8000 if kind == "INT" and type(value) is int else value


def truth(value: Any, kind: str) -> Any:
    """Return True for a BOOL that is any text but the empty one."""
    return bool(value) if kind == "BOOL" else value


def beginning(data: Data) -> Data:
    return {**data, "value": data["value"][:20]} if isinstance(data["value"], str) else data


def controls_always(tool: str) -> Change:
    """Return the defect that a tool's switch of its own is not looked at: writes that are enabled are enough."""

    def apply(server: AdapterServer) -> None:
        tools_of(server, tool)._control_enabled = True

    return apply


def stripped(data: Data) -> Data:
    return {**data, "value": data["value"].strip()} if isinstance(data["value"], str) else data
