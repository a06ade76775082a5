"""The tools about the CPU itself: is it there, who is it, what time has it, does it run."""

from __future__ import annotations

import struct
from typing import Literal

from snap7.error import S7Error

from ..core import AdapterError, Call, Nothing, device_text, tool
from .link import Link
from .refusals import refusal
from .shapes import Connected, CpuState, PlcInfo, Reachable, State, StatusList, StatusRecords, SystemTime
from .wire import SUCCESS, Reply

__all__ = ["Cpu"]

_OPERATING_STATE = 0x0424
_IDENTIFICATION, _COMPONENTS = 0x0011, 0x001C
_FIRMWARE = 7
# Byte 3 of the record of SZL 0424; a CPU 1200 says 3 in STOP.
_STATES: dict[int, Literal["RUN", "STOP"]] = {8: "RUN", 4: "STOP", 3: "STOP"}
_ALREADY = 0x8402


class Cpu:
    """The tools about the CPU, over one connection."""

    def __init__(self, link: Link, *, control_enabled: bool) -> None:
        self._link = link
        self._control_enabled = control_enabled

    @tool("s7.ping")
    async def ping(self, call: Call, arguments: Nothing) -> Reachable:
        """Confirm that the controller answers: reads its operating state and accepts any well-formed answer."""
        await self._ask(call)
        return {"reachable": True}

    @tool("s7.connection_status")
    async def get_connection_status(self, call: Call, arguments: Nothing) -> Connected:
        """Tell whether the controller answers now, and the size of the PDUs that it agreed to. Asks it."""
        await self._ask(call)
        return {"connected": True, "pdu_size": self._link.pdu_size}

    async def _ask(self, call: Call) -> None:
        try:
            await self._records(call, _OPERATING_STATE, 0)
        except AdapterError:
            # A refusal is an answer, too: the controller is there.
            if "error_code" not in call.trace and "return_code" not in call.trace:
                raise

    @tool("s7.plc_info")
    async def read_plc_info(self, call: Call, arguments: Nothing) -> PlcInfo:
        """Read order number, firmware, names, type and serial number (SZL 0011 and 001C): texts that the controller supplies."""
        modules = {_number(record): record for record in (await self._records(call, _IDENTIFICATION, 0))[1]}
        parts = {_number(record): record for record in (await self._records(call, _COMPONENTS, 0))[1]}

        def text(name: str, found: bytes | None) -> str | None:
            shown = (found or b"").split(b"\0")[0].strip()
            return device_text(call, f"/data/{name}", shown) if shown else None

        firmware = modules.get(_FIRMWARE, b"")[-3:]
        return {
            "order_number": text("order_number", modules.get(1, b"")[2:22]),
            "firmware": "V{}.{}.{}".format(*firmware) if len(firmware) == 3 else None,
            "station_name": text("station_name", parts.get(1, b"")[2:]),
            "module_name": text("module_name", parts.get(2, b"")[2:]),
            "serial_number": text("serial_number", parts.get(5, b"")[2:]),
            "module_type": text("module_type", parts.get(7, b"")[2:]),
        }

    @tool("s7.cpu_state")
    async def read_cpu_state(self, call: Call, arguments: Nothing) -> State:
        """Read whether the CPU is in RUN or in STOP (SZL 0424)."""
        return {"state": await self._state(call)}

    @tool("s7.system_time")
    async def read_system_time(self, call: Call, arguments: Nothing) -> SystemTime:
        """Read the controller's clock."""
        protocol = self._link.protocol
        reply = await self._link.exchange(call, protocol.build_get_clock_request())
        try:
            moment = protocol.parse_get_clock_response({"data": {"data": _content(call, reply)}})
        except S7Error:
            raise AdapterError("protocol_error", "the controller's answer holds no time") from None
        return {"time": moment.isoformat(timespec="milliseconds")}

    @tool("s7.read_szl")
    async def read_szl(self, call: Call, arguments: StatusList) -> StatusRecords:
        """Read a system status list (SZL) by id and index."""
        length, records = await self._records(call, arguments.szl_id, arguments.szl_index)
        return {
            "szl_id": arguments.szl_id,
            "szl_index": arguments.szl_index,
            "record_length": length,
            "records": [record.hex() for record in records],
        }

    @tool("s7.set_cpu_state", writes=True)
    async def set_cpu_state(self, call: Call, arguments: CpuState) -> State:
        """Start the CPU's program (RUN, a warm restart) or stop it (STOP), and read the state that it then has."""
        if not self._control_enabled:
            message = "starting and stopping the CPU is disabled; set S7_CONTROL_ENABLED=true to enable it"
            raise AdapterError("writes_disabled", message, outcome="not_sent")
        call.changes(("CPU", None))
        operation = "hot_start" if arguments.state == "RUN" else "stop"
        try:
            await self._link.exchange(call, self._link.protocol.build_plc_control_request(operation))
        except AdapterError:
            # A CPU that is in this state already refuses; what counts is the state that it tells.
            if call.trace.get("error_code") != _ALREADY or await self._state(call) != arguments.state:
                raise
            return {"state": arguments.state}
        state = await self._state(call)
        if state != arguments.state:
            message = f"the CPU has accepted the command and is in {state}; read its state later"
            raise AdapterError("accepted_pending", message, outcome="unknown")
        return {"state": state}

    # -- requests -----------------------------------------------------------------------------------------

    async def _state(self, call: Call) -> Literal["RUN", "STOP"]:
        # python-snap7's get_cpu_state sends a malformed job and calls every positive answer RUN (3.3.0).
        _, records = await self._records(call, _OPERATING_STATE, 0)
        state = _STATES.get(records[0][3]) if records and len(records[0]) > 3 else None
        if state is None:
            raise AdapterError("protocol_error", "the controller's answer names no operating state that is known")
        return state

    async def _records(self, call: Call, identifier: int, index: int) -> tuple[int, list[bytes]]:
        """Return the length of the records of a list, and the records."""
        request = self._link.protocol.build_read_szl_request(identifier, index)
        replies = await self._link.parts(call, request)
        content = b"".join(_content(call, reply) for reply in replies)
        if len(content) < 8 or struct.unpack_from(">HH", content) != (identifier, index):
            raise AdapterError("protocol_error", "the controller's answer is about another system status list")
        length, count = struct.unpack_from(">HH", content, 4)
        if not length or len(content) != 8 + length * count:
            raise AdapterError("protocol_error", "the controller's answer is no whole system status list")
        return length, [content[start : start + length] for start in range(8, len(content), length)]


def _content(call: Call, reply: Reply) -> bytes:
    """Return the content of an answer to user data.

    Raises:
        AdapterError: its return code is a refusal.
    """
    if len(reply.data) < 4 or reply.data[0] != SUCCESS:
        raise refusal(call, return_code=reply.data[0] if reply.data else 0)
    return reply.data[4:]


def _number(record: bytes) -> int:
    """Return the number that a record begins with."""
    return int.from_bytes(record[:2], "big")
