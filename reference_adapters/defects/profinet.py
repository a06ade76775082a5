"""Defects of a PROFINET adapter."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from ..core import AdapterError, AdapterServer, Call
from .any_protocol import guard_after_sending
from .areas.further import altered
from .defect import Data, Handler, around, defect, failing, succeeding, tools_of

__all__ = ["DEFECTS"]

_READ, _WRITE, _RECORD = "read_io_data", "write_io_data", "write_record"
_SET_NAME, _IDENTIFY, _DISCOVER = "set_device_name", "identify_device", "discover_devices"


def _controller(server: AdapterServer) -> Any:
    return tools_of(server, _WRITE)._controller


def any_length(server: AdapterServer) -> None:
    controller = _controller(server)

    @around(_WRITE)
    async def unchecked(genuine: Handler, call: Call, arguments: Any) -> Data:
        place = arguments.slot, arguments.subslot
        held = await controller.drive(call, arguments.device_name, place, lambda _: bytes(arguments.data))
        return _data(arguments, held)

    unchecked(server)


def not_sent(server: AdapterServer) -> None:
    @around(_WRITE)
    async def pretending(genuine: Handler, call: Call, arguments: Any) -> Data:
        return _data(arguments, arguments.data)

    pretending(server)


def sent_once(server: AdapterServer) -> None:
    async def never(exchange: Any) -> None:
        return

    _controller(server)._cycle = never


def believed(server: AdapterServer) -> None:
    """A frame is sent without a relation, to the identifier that the last one had."""
    controller = _controller(server)

    async def take(call: Call, name: str, exchange: Any) -> None:
        await genuine(call, name, exchange)
        controller._release(exchange)

    async def verified(call: Call, name: str, place: Any, outputs: bytes) -> bytes:
        return outputs

    genuine, controller._take, controller._verified = controller._take, take, verified


def reading_owns(server: AdapterServer) -> None:
    controller = _controller(server)

    @around(_READ)
    async def owning(genuine: Handler, call: Call, arguments: Any) -> Data:
        # What it sends beside the reading is not told.
        hidden = Call(protocol="", operation="", endpoint="", writes=False)
        exchange = controller.exchanges.get(arguments.device_name)
        if exchange is not None and exchange.state != "data_exchange":
            with suppress(AdapterError):
                await controller._take(hidden, arguments.device_name, exchange)
        data = await genuine(call, arguments)
        return data

    owning(server)


def listed_not_asked(server: AdapterServer) -> None:
    controller = _controller(server)

    @around(_DISCOVER)
    async def from_the_map(genuine: Handler, call: Call, arguments: Any) -> Data:
        known = {"mac": "", "ip_address": "", "vendor": "", "vendor_id": "", "device_id": ""}
        return {"devices": [{"device_name": name, **known} for name in sorted(controller.devices)]}

    from_the_map(server)


def shown_by_nobody(server: AdapterServer) -> None:
    @around(_IDENTIFY)
    async def pretending(genuine: Handler, call: Call, arguments: Any) -> Data:
        return {"device_mac": arguments.device_mac, "duration_s": arguments.duration_s}

    pretending(server)


def named_by_nobody(server: AdapterServer) -> None:
    @around(_SET_NAME)
    async def pretending(genuine: Handler, call: Call, arguments: Any) -> Data:
        return {"device_mac": arguments.device_mac, "name": arguments.name}

    pretending(server)


def _data(arguments: Any, content: Any) -> Data:
    return {
        "device_name": arguments.device_name,
        "slot": arguments.slot,
        "subslot": arguments.subslot,
        "bytes": list(content),
    }


def _zeros(call: Call, arguments: Any) -> Data:
    return _data(arguments, [0, 0])


def _as_asked(call: Call, arguments: Any) -> Data:
    return {**_data(arguments, arguments.data), "index": arguments.index}


def _one_code(call: Call, error: AdapterError) -> Exception | None:
    if error.code not in ("illegal_address", "illegal_value"):
        return None
    return AdapterError("device_failure", error.message, outcome="rejected")


def _made_legal(value: Any) -> Any:
    return value.lower().replace("_", "-") if isinstance(value, str) else value


DEFECTS = (
    defect(
        "MU-08pn",
        "profinet",
        "300 is written to an output byte as 44, and told as a success.",
        altered(_WRITE, "data", lambda data: [one & 0xFF if type(one) is int else one for one in data]),
        "FN7",
        "ADR-003",
    ),
    defect(
        "MU-10pn",
        "profinet",
        "Outputs of another length than the slot's are sent as they are.",
        any_length,
        "FN6",
        "ADR-004 ERR-006",
    ),
    defect(
        "MU-14pn",
        "profinet",
        "Outputs are told as written, and nothing is sent.",
        not_sent,
        "N3 N5 N6 FN6 FN7 FN8 FN9 SN2 SN4",
        "WR-001 ERR-002 ADR-004",
    ),
    defect(
        "MU-17pn",
        "profinet",
        "Outputs are sent once and not repeated, so they fall at the device's watchdog.",
        sent_once,
        "N3",
        "WR-001",
    ),
    defect(
        "MU-17pnr",
        "profinet",
        "Outputs are sent after the relation was given up, and told as written.",
        believed,
        "N3 N5 N6 FN7 SN2",
        "WR-001",
    ),
    defect(
        "MU-20pn",
        "profinet",
        "With writes disabled the outputs are sent, and then denied.",
        guard_after_sending(_WRITE),
        "N5 SN4",
        "WR-004 ERR-006",
    ),
    defect(
        "MU-35pn",
        "profinet",
        "A search for stations lists the configured devices, and asks nobody.",
        listed_not_asked,
        "N7",
        "RD-004",
    ),
    defect(
        "MU-40pn",
        "profinet",
        "The inputs of a slot that the device does not have are zero.",
        succeeding(_READ, code="illegal_address", answer=_zeros),
        "FN1",
        "ERR-002",
    ),
    defect(
        "MU-14pnr",
        "profinet",
        "A record that the device refuses is told as written.",
        succeeding(_RECORD, code="illegal_value", answer=_as_asked),
        "FN3",
        "ERR-002",
    ),
    defect(
        "MU-14gpn",
        "profinet",
        "While the device is gone, a record is told as written.",
        succeeding(_RECORD, code="timeout", answer=_as_asked),
        "SN4",
        "WR-001",
    ),
    defect(
        "MU-45pn",
        "profinet",
        "An index that does not exist, and a value out of range, are told as the same failure of the device.",
        failing(_RECORD, change=_one_code),
        "FN2 FN3",
        "ERR-002",
    ),
    defect(
        "MU-53pn",
        "profinet",
        "Reading inputs makes the adapter the device's controller, also with writes disabled.",
        reading_owns,
        "N5",
        "WR-004",
    ),
    defect(
        "MU-12pn",
        "profinet",
        "A name that no station can have is made one that can, and set.",
        altered(_SET_NAME, "name", _made_legal),
        "FN10",
        "ERR-002",
    ),
    defect(
        "MU-14pns",
        "profinet",
        "A station is told to have a name, and was not asked.",
        named_by_nobody,
        "N8 FN10",
        "WR-001 ERR-002",
    ),
    defect(
        "MU-35pni",
        "profinet",
        "A station is told to show itself, and was not asked.",
        shown_by_nobody,
        "N9",
        "RD-004",
    ),
)
