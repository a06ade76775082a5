"""Honest S7 adapters."""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from pytest_otmcp.reference_adapters.core import AdapterError, AdapterServer, Call
from pytest_otmcp.reference_adapters.defects.mutant import Handler, wrap

from pytest_otmcp.subject.model import Answering

from .choice import choices

if TYPE_CHECKING:
    from pytest_otmcp.subject import Adapter

__all__ = ["CHOICES"]

CHOICES, choice = choices("s7")

WRITTEN = ("BOOL", "BYTE", "WORD", "DWORD", "INT", "DINT", "REAL")
READ = (*WRITTEN, "STRING")
_MOST = 40
"""Characters of a text, for an adapter that takes no long ones."""


def without_codes(adapter: Adapter) -> Adapter:
    """Return a description by which the adapter's answers are documents without error codes."""
    answering = Answering(form="structured")
    operations = {
        name: tuple(dataclasses.replace(one, answering=answering) for one in bound)
        for name, bound in adapter.operations.items()
    }
    return dataclasses.replace(adapter, answering=answering, operations=operations)


@choice(
    "tells a REAL by the fewest digits that make it: 0.1, not 0.10000000149011612",
    "these digits have the same bits when they are put into a REAL again",
)
def shortest_digits(server: AdapterServer) -> None:
    def shorter(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            data = await genuine(call, arguments)
            if data["type"] != "REAL" or data["value"] is None:
                return data
            return {**data, "value": _shortest(data["value"])}

        return handler

    wrap(server, "read_db_typed", shorter)


def _shortest(value: float) -> float:
    candidates = (float(f"{value:.{digits}g}") for digits in range(1, 10))
    return next(one for one in candidates if _bits(one) == _bits(value))


def _bits(value: float) -> bytes | None:
    try:
        return struct.pack(">f", value)
    except OverflowError:
        return None


@choice(
    "writes texts of up to 40 characters, which the schema says, and refuses longer ones",
    "how long a text may be is its author's choice as far as the schema tells it",
)
def short_texts(server: AdapterServer) -> None:
    listing = server._tools["write_db"].listing
    properties = {
        **listing.input_schema["properties"],
        "value": {"anyOf": [{"type": ["boolean", "number"]}, {"type": "string", "maxLength": _MOST}]},
    }
    schema = {**listing.input_schema, "properties": properties}

    def refusing(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            if isinstance(arguments.value, str) and len(arguments.value) > _MOST:
                message = f"a text may have {_MOST} characters"
                raise AdapterError("limit_exceeded", message, field="/value", outcome="not_sent")
            return await genuine(call, arguments)

        return handler

    wrap(server, "write_db", refusing, listing=listing.model_copy(update={"input_schema": schema}))


@choice(
    "has no tool that starts and stops the CPU unless control is enabled",
    "a tool that is not there cannot be used",
)
def control_tools_hidden(server: AdapterServer) -> None:
    if not server._tools["set_cpu_state"].handler.__self__._control_enabled:  # type: ignore[attr-defined]
        del server._tools["set_cpu_state"]


@choice(
    "reads types of up to 32 bits, and texts, which it does not write; refuses others in words without a code",
    "which types an adapter offers is its author's choice, and an answer need not have a code",
    described=without_codes,
)
def few_types(server: AdapterServer) -> None:
    def only(offered: tuple[str, ...]) -> Callable[[Handler], Handler]:
        def of_these_types(genuine: Handler) -> Handler:
            async def handler(call: Call, arguments: Any) -> Any:
                if arguments.data_type not in offered:
                    raise AdapterError("unsupported_operation", f"the types are {', '.join(offered)}")
                return await genuine(call, arguments)

            return handler

        return of_these_types

    wrap(server, "read_db_typed", only(READ))
    wrap(server, "write_db", only(WRITTEN))
