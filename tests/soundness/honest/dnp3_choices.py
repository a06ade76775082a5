"""Honest DNP3 adapters."""

from __future__ import annotations

from typing import Any

from pytest_otmcp.reference_adapters.core import AdapterError, AdapterServer, Call
from pytest_otmcp.reference_adapters.defects.mutant import Handler, wrap
from pytest_otmcp.reference_adapters.dnp3.conversions import shown

from .choice import choices

__all__ = ["CHOICES"]

CHOICES, choice = choices("dnp3")


@choice(
    "has no pulses: latches, trips and closes alone, and refuses the other codes by itself",
    "which controls an adapter offers is its author's choice",
)
def no_pulses(server: AdapterServer) -> None:
    def without(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            if arguments.control.startswith("pulse"):
                raise AdapterError("unsupported_operation", "outputs are not pulsed", field="/code", outcome="not_sent")
            return await genuine(call, arguments)

        return handler

    wrap(server, "write_binary_output", without)


@choice(
    "tells an event that came unasked in the answer to the read that it came before, and not once more with the next poll",
    "it is told once, as soon as there is an answer that can tell it",
)
def events_beside_a_read(server: AdapterServer) -> None:
    tools = server._tools["read_analog_inputs"].handler.__self__

    def with_unsolicited(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            data = await genuine(call, arguments)
            return {**data, "unsolicited": [shown(one) for one in tools._link.kept(arguments.outstation_address)]}

        return handler

    listing = server._tools["read_analog_inputs"].listing
    wrap(server, "read_analog_inputs", with_unsolicited, listing=listing.model_copy(update={"output_schema": None}))
