"""Honest S7 adapters."""

from __future__ import annotations

import dataclasses
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


def without_codes(adapter: Adapter) -> Adapter:
    """Return a description by which the adapter's answers are documents without error codes."""
    answering = Answering(form="structured")
    operations = {
        name: tuple(dataclasses.replace(one, answering=answering) for one in bound)
        for name, bound in adapter.operations.items()
    }
    return dataclasses.replace(adapter, answering=answering, operations=operations)


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
