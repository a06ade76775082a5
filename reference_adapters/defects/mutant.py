"""The declaration of a defective adapter, and the changes that defects of several protocols have in common.

A defect changes the server that a reference adapter has built. It may use the private members of the adapter.
"""

from __future__ import annotations

import re
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from typing import Any

from ..core import AdapterError, AdapterServer, Call

__all__ = [
    "Bend",
    "Data",
    "Handler",
    "Mutant",
    "also",
    "catalogue_id",
    "each",
    "failing",
    "mutants_of",
    "number",
    "on",
    "succeeding",
    "told",
    "wrap",
]

Handler = Callable[[Call, Any], Any]
Bend = Callable[[AdapterServer], None]
Data = dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Mutant:
    """A reference adapter with one defect of the catalogue, and how the suite must notice it.

    Attributes:
        id: the catalogue's number; a letter behind it tells several ways to have the defect apart.
        protocol: of the adapter.
        sentence: what it does.
        bend: changes the adapter.
        items: ids of the items that fail, no more and no fewer.
        requirements: ids of the requirements that the findings cite, and codes of findings that cite none, no more and no fewer.
        areas: areas of the requirement suite whose checks are run, such as ``wr tmo``; empty for a defect that the benchmark notices.
        recovers: the defect shows when the device has gone, so the recovery trials are run as well.
        waits: the suite waits for what never comes, so its deadlines are shortened.
        cold: its own processes are looked at, so it is started as users start it, not forked from one that is warm.
        quick: it is run in every test run; the others are run with the long tests.
        anywhere: it is the same change of any adapter, and can be had at the adapter of every protocol.
        named: the adapter is the one with a vocabulary of its own.
    """

    id: str
    protocol: str
    sentence: str
    bend: Bend
    items: str
    requirements: str
    areas: str = ""
    recovers: bool = False
    waits: bool = False
    cold: bool = False
    quick: bool = False
    anywhere: bool = False
    named: bool = False

    @property
    def catalogue_id(self) -> str:
        """The id without the letter of the variant."""
        return catalogue_id(self.id)


def mutants_of(areas: str) -> Callable[..., Mutant]:
    """Return what declares the defects that the checks of these areas notice: a function of id, protocol, sentence, bend, items and
    requirements, in this order, and of the other attributes of :class:`Mutant` by name."""

    def mutant(
        id: str, protocol: str, sentence: str, bend: Bend, items: str, requirements: str, **more: bool
    ) -> Mutant:
        return Mutant(
            id=id,
            protocol=protocol,
            sentence=sentence,
            bend=bend,
            items=items,
            requirements=requirements,
            areas=areas,
            **more,
        )

    return mutant


def catalogue_id(identifier: str) -> str:
    """Return an id without the letter of the variant."""
    return re.sub("[a-z]+$", "", identifier)


def number(identifier: str) -> tuple[int, str]:
    """Return what ids are sorted by: the number of the defect, then the letter of the variant."""
    return int(catalogue_id(identifier).removeprefix("MU-")), identifier


def on(protocol: str, rows: str) -> str:
    """Return the ids of the checks of these rows on a protocol."""
    return " ".join(f"{row}.{protocol}" for row in rows.split())


def wrap(server: AdapterServer, name: str, handler: Callable[[Handler], Handler], **changes: Any) -> None:
    """Replace a tool's handler by one that is made from the original."""
    tool = server._tools[name]
    server._tools[name] = replace(tool, handler=handler(tool.handler), **changes)


def each(*names: str, change: Callable[[Handler], Handler]) -> Bend:
    """Return the defect that all these tools, or all tools, have a handler made from the original."""

    def bend(server: AdapterServer) -> None:
        for name in names or list(server._tools):
            wrap(server, name, change)

    return bend


def told(*names: str, change: Callable[[Data], Data]) -> Bend:
    """Return the defect that these tools tell something else than what they have found."""

    def changed(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            return change(await genuine(call, arguments))

        return handler

    return each(*names, change=changed)


def also(*names: str, action: Callable[[AdapterServer, Call], Awaitable[None]]) -> Bend:
    """Return the defect that these tools do something else as well."""

    def bend(server: AdapterServer) -> None:
        def acting(genuine: Handler) -> Handler:
            async def handler(call: Call, arguments: Any) -> Data:
                data: Data = await genuine(call, arguments)
                await action(server, call)
                return data

            return handler

        each(*names, change=acting)(server)

    return bend


def succeeding(*names: str, code: str, answer: Callable[[Call, Any], Data]) -> Bend:
    """Return the defect that these tools succeed where they ought to fail with this code, with data made from the arguments."""

    def changed(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            try:
                data: Data = await genuine(call, arguments)
            except AdapterError as error:
                if error.code != code:
                    raise
                return answer(call, arguments)
            return data

        return handler

    return each(*names, change=changed)


def failing(*names: str, change: Callable[[Call, AdapterError], Exception | None]) -> Bend:
    """Return the defect that these tools, or all, fail otherwise; the failure stays as it is where ``change`` returns None."""

    def changed(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            try:
                data: Data = await genuine(call, arguments)
            except AdapterError as error:
                raise change(call, error) or error from None
            return data

        return handler

    return each(*names, change=changed)
