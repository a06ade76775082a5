"""The tools about the controller itself: is it there, who is it, which tags does it have, what time is it."""

from __future__ import annotations

import struct
from datetime import UTC, datetime, timedelta

from ..core import AdapterError, BadReply, Call, Nothing, device_text, tool
from .codec import type_name
from .link import Link
from .refusals import refusal
from .shapes import ClockTime, Connected, ListedTag, PlcInfo, PlcTime, Reachable, TagList, TagListOf
from .wire import PARTLY, SUCCESS, attribute_of

__all__ = ["Controller"]

_GET_ATTRIBUTES_ALL, _GET_ATTRIBUTE_LIST, _SET_ATTRIBUTE_LIST = 0x01, 0x03, 0x04
_IDENTITY, _WALL_CLOCK = 0x01, 0x8B
_SET_TIME, _TIME = 0x06, 0x0B
"""Attributes of the clock: both are microseconds since 1970, one to set and one to read."""
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_MOST_PAGES = 200
_SYSTEM = 0x1000
"""Of a symbol's type: the controller's own, not a tag of its program."""
_LAST_INSTANCE = 0xFFFF
_PATIENCE = timedelta(seconds=5)
"""How far a clock may have gone on until it is read after it was set."""


class Controller:
    """The tools about the controller itself, over one connection."""

    def __init__(self, link: Link, *, control_enabled: bool) -> None:
        self._link = link
        self._control_enabled = control_enabled

    @tool("ethernetip.ping")
    async def ping(self, call: Call, arguments: Nothing) -> Reachable:
        """Confirm that the controller answers: reads its identity and accepts any well-formed answer."""
        await self._link.exchange(call, self._identity())
        return {"reachable": True}

    @tool("ethernetip.connection_status")
    async def get_connection_status(self, call: Call, arguments: Nothing) -> Connected:
        """Tell whether the controller answers now, and the size of the messages of the CIP connection. Asks it."""
        await self._link.exchange(call, self._identity())
        return {"connected": True, "message_size": self._link.size}

    @tool("ethernetip.plc_info")
    async def get_plc_info(self, call: Call, arguments: Nothing) -> PlcInfo:
        """Read the controller's identity: name, vendor, type, revision, serial number and status word."""
        reply = await self._link.ask(call, self._identity())
        if len(reply.data) < 15 or len(reply.data) < 15 + reply.data[14]:
            raise AdapterError("protocol_error", "the controller's answer is no whole identity")
        vendor, kind, code, major, minor, status, serial = struct.unpack_from("<HHHBBHI", reply.data)
        return {
            "product_name": device_text(call, "/data/product_name", reply.data[15 : 15 + reply.data[14]]),
            "vendor_id": vendor,
            "device_type": kind,
            "product_code": code,
            "revision": f"{major}.{minor}",
            "serial_number": f"{serial:08X}",
            "status": status,
        }

    @tool("ethernetip.list_tags")
    async def get_tag_list(self, call: Call, arguments: TagListOf) -> TagList:
        """List the tags of the controller, or those of one of its programs: names, types and dimensions, without its own ones."""
        builder = self._link.builder
        tags: list[ListedTag] = []
        programs: list[str] = []
        first = 0
        for _ in range(_MOST_PAGES):
            builder.Offset = first
            request = builder._build_tag_list_request(arguments.program)
            reply = await self._link.exchange(call, request, tag=arguments.program)
            if reply.status not in (SUCCESS, PARTLY):
                raise refusal(call, reply.status, reply.extended)
            last = _symbols(call, reply.data, arguments.program, tags, programs)
            if reply.status == SUCCESS:
                return {"tags": tags, "programs": programs}
            if last is None or not first <= last < _LAST_INSTANCE:
                raise AdapterError("protocol_error", "the controller's tag list does not go on")
            first = last + 1
        raise AdapterError("limit_exceeded", "the controller has more tags than this adapter lists")

    @tool("ethernetip.read_clock")
    async def get_plc_time(self, call: Call, arguments: Nothing) -> PlcTime:
        """Read the controller's clock."""
        return {"time": _shown(await self._time(call))}

    @tool("ethernetip.set_clock", writes=True)
    async def set_plc_time(self, call: Call, arguments: ClockTime) -> PlcTime:
        """Set the controller's clock to a time that is given, and read it: what the program does by the clock moves with it."""
        if not self._control_enabled:
            message = "setting the controller's clock is disabled; set ETHERNETIP_CONTROL_ENABLED=true to enable it"
            raise AdapterError("writes_disabled", message, outcome="not_sent")
        wanted = datetime.fromisoformat(arguments.time)
        # A time without a zone is UTC, as the clock is; pylogix sets the time of the machine that it runs on.
        wanted = wanted.replace(tzinfo=UTC) if wanted.tzinfo is None else wanted.astimezone(UTC)
        call.changes(("Clock", None))
        value = struct.pack("<Q", (wanted - _EPOCH) // timedelta(microseconds=1))
        request = self._link.builder._cip_message(_SET_ATTRIBUTE_LIST, _WALL_CLOCK, 1, [_SET_TIME], [value])
        await self._attribute(call, request, _SET_TIME)
        held = await self._time(call, changes_state=False)
        if not timedelta(0) <= held - wanted <= _PATIENCE:
            message = "the controller has confirmed the time and shows another one; read its clock later"
            raise AdapterError("verify_failed", message, details={"time": _shown(held)})
        return {"time": _shown(held)}

    # -- requests -----------------------------------------------------------------------------------------

    def _identity(self) -> bytes:
        return bytes(self._link.builder._cip_message(_GET_ATTRIBUTES_ALL, _IDENTITY, 1))

    async def _time(self, call: Call, *, changes_state: bool = True) -> datetime:
        request = self._link.builder._cip_message(_GET_ATTRIBUTE_LIST, _WALL_CLOCK, 1, [_TIME])
        value = await self._attribute(call, request, _TIME, changes_state=changes_state)
        try:
            return _EPOCH + timedelta(microseconds=struct.unpack("<Q", value)[0])
        except (struct.error, OverflowError):
            raise AdapterError("protocol_error", "the controller's answer holds no time") from None

    async def _attribute(self, call: Call, request: bytes, attribute: int, *, changes_state: bool = True) -> bytes:
        """Get or set one attribute and return what the answer holds of it.

        Raises:
            AdapterError: a refusal of the request or of the attribute.
        """
        reply = await self._link.ask(call, request, changes_state=changes_state)
        try:
            status, value = attribute_of(reply, attribute)
        except BadReply as fault:
            raise AdapterError("protocol_error", f"the answer is not the one to the request: {fault}") from None
        if status:
            raise refusal(call, status, None)
        return value


def _shown(moment: datetime) -> str:
    return moment.replace(tzinfo=None).isoformat(timespec="milliseconds")


def _symbols(call: Call, data: bytes, program: str | None, tags: list[ListedTag], programs: list[str]) -> int | None:
    """Add the tags of one answer to those that were found; return the number of the last symbol.

    A symbol is its number (UDINT), its name with its length (UINT), its type (UINT) and three dimensions (UDINT).
    """
    last = None
    while data:
        length = int.from_bytes(data[4:6], "little")
        if len(data) < 20 + length:
            raise AdapterError("protocol_error", "the controller's tag list is cut off")
        (last,) = struct.unpack_from("<I", data)
        kind, *dimensions = struct.unpack_from("<H3I", data, 6 + length)
        name, data = data[6 : 6 + length], data[20 + length :]
        if name.startswith(b"Program:"):
            programs.append(device_text(call, f"/data/programs/{len(programs)}", name))
        elif not (kind & _SYSTEM or name.startswith(b"__") or b":" in name):
            shown = device_text(call, f"/data/tags/{len(tags)}/tag_name", name)
            tags.append(
                {
                    "tag_name": shown if program is None else f"{program}.{shown}",
                    "type": type_name(kind),
                    "dimensions": [size for size in dimensions if size],
                }
            )
    return last
