"""The declaration of a defective adapter, and the changes that defects of several protocols have in common.

A defect changes the server that a reference adapter has built. It may use the private members of the adapter.
"""

from __future__ import annotations

import re
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from ..core import AdapterError, AdapterServer, Call

__all__ = [
    "Change",
    "Data",
    "Defect",
    "Handler",
    "also",
    "around",
    "catalogue_id",
    "defect",
    "failing",
    "number",
    "succeeding",
    "told",
    "tools_of",
    "wrap",
]

Data = dict[str, Any]
Handler = Callable[[Call, Any], Awaitable[Data]]
"""Does the work of a tool."""
Change = Callable[[AdapterServer], None]
"""Changes an adapter, so that it has a defect."""

_ROW = re.compile(r"([A-Z]+)-\d+")


@dataclass(frozen=True, slots=True, kw_only=True)
class Defect:
    """A reference adapter with one defect of the catalogue, and how the suite must notice it.

    Attributes:
        id: the catalogue's number; a letter behind it tells several ways to have the defect apart.
        protocol: of the adapter.
        sentence: what it does.
        change: gives the adapter the defect.
        items: ids of the items that fail, no more and no fewer.
        requirements: ids of the requirements that the findings cite, and codes of findings that cite none, no more and no fewer.
        areas: areas of the requirement suite whose checks are run, such as ``wr tmo``; empty for a defect that the benchmark notices.
        recovers: the defect shows when the device has gone, so the recovery trials are run as well.
        waits: the suite waits for what never comes, so its deadlines are shortened.
        cold: its own processes are looked at, so it is started as users start it, not forked from one that is warm.
        quick: it is run in every test run; the others are run with the long tests.
        anywhere: it is the same change of any adapter, and can be had at the adapter of every protocol.
        named: the adapter is the one with a vocabulary of its own.
        before: is called before the adapter is built.
    """

    id: str
    protocol: str
    sentence: str
    change: Change
    items: str
    requirements: str
    areas: str = ""
    recovers: bool = False
    waits: bool = False
    cold: bool = False
    quick: bool = False
    anywhere: bool = False
    named: bool = False
    before: Callable[[], None] | None = None

    @property
    def catalogue_id(self) -> str:
        """The id without the letter of the variant."""
        return catalogue_id(self.id)


def defect(
    id: str, protocol: str, sentence: str, change: Change, items: str, requirements: str | None = None, **more: Any
) -> Defect:
    """Declare a defect.

    Args:
        id, protocol, sentence, change: see :class:`Defect`.
        items: those of the benchmark, such as ``M3 FM1``, or rows of the requirement suite, such as ``WR-003 WR-010``, whose checks on the
            protocol fail; empty where the findings of an area are warnings.
        requirements: those that the findings cite; None for those with the ids of the rows.
        more: the further attributes of :class:`Defect`.
    """
    cited = items if requirements is None else requirements
    checked = items or cited
    return Defect(
        id=id,
        protocol=protocol,
        sentence=sentence,
        change=change,
        items=" ".join(f"{item}.{protocol}" if _ROW.fullmatch(item) else item for item in items.split()),
        requirements=cited,
        areas=" ".join(dict.fromkeys(row[1].lower() for item in checked.split() if (row := _ROW.fullmatch(item)))),
        **more,
    )


def catalogue_id(identifier: str) -> str:
    """Return an id without the letter of the variant."""
    return re.sub("[a-z]+$", "", identifier)


def number(identifier: str) -> tuple[int, str]:
    """Return what ids are sorted by: the number of the defect, then the letter of the variant."""
    return int(catalogue_id(identifier).removeprefix("MU-")), identifier


def tools_of(server: AdapterServer, name: str) -> Any:
    """Return the object of which a tool is a method, as long as no defect is around the tool."""
    return server._tools[name].handler.__self__


def wrap(server: AdapterServer, name: str, handler: Callable[[Handler], Handler], **changes: Any) -> None:
    """Replace a tool's handler by one that is made from the original."""
    tool = server._tools[name]
    server._tools[name] = replace(tool, handler=handler(tool.handler), **changes)


def around(*names: str, **changes: Any) -> Callable[[Callable[[Handler, Call, Any], Awaitable[Data]]], Change]:
    """Return a decorator that makes a defect of a function: these tools, or all, call it in their place, with their handler before it::

        @around("read_register")
        async def doubled(genuine: Handler, call: Call, arguments: Any) -> Data:
            data = await genuine(call, arguments)
            return {**data, "value": 2 * data["value"]}

    Args:
        changes: other members of the tools that change with it, such as ``model``.
    """

    def decorate(function: Callable[[Handler, Call, Any], Awaitable[Data]]) -> Change:
        def apply(server: AdapterServer) -> None:
            for name in names or list(server._tools):
                wrap(server, name, lambda genuine: partial(function, genuine), **changes)

        return apply

    return decorate


def told(*names: str, change: Callable[[Data], Data]) -> Change:
    """Return the defect that these tools tell something else than what they have found."""

    @around(*names)
    async def changed(genuine: Handler, call: Call, arguments: Any) -> Data:
        return change(await genuine(call, arguments))

    return changed


def also(*names: str, action: Callable[[AdapterServer, Call], Awaitable[None]]) -> Change:
    """Return the defect that these tools do something else as well."""

    def apply(server: AdapterServer) -> None:
        @around(*names)
        async def acting(genuine: Handler, call: Call, arguments: Any) -> Data:
            data = await genuine(call, arguments)
            await action(server, call)
            return data

        acting(server)

    return apply


def succeeding(*names: str, code: str, answer: Callable[[Call, Any], Data]) -> Change:
    """Return the defect that these tools succeed where they ought to fail with this code, with data made from the arguments."""

    @around(*names)
    async def changed(genuine: Handler, call: Call, arguments: Any) -> Data:
        try:
            return await genuine(call, arguments)
        except AdapterError as error:
            if error.code != code:
                raise
            return answer(call, arguments)

    return changed


def failing(*names: str, change: Callable[[Call, AdapterError], Exception | None]) -> Change:
    """Return the defect that these tools, or all, fail otherwise; the failure stays as it is where ``change`` returns None."""

    @around(*names)
    async def changed(genuine: Handler, call: Call, arguments: Any) -> Data:
        try:
            return await genuine(call, arguments)
        except AdapterError as error:
            raise change(call, error) or error from None

    return changed
