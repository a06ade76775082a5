"""The twenty S7 tools. Offsets and sizes are in bytes, numbers are big-endian."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from snap7.datatypes import S7Area

from ..core import AdapterError, BadReply, Call, NameMap, Nothing, device_text, exact_in_json, tool
from .codec import DataType, Plain, Value, decode, encode, width
from .cpu import Cpu
from .link import Link
from .refusals import refusal
from .shapes import (
    AreaBytes,
    BlockBytes,
    BlockValue,
    OneVariable,
    ReadBytes,
    ReadVariables,
    TagList,
    TagName,
    TagValue,
    TagWritten,
    TypedValue,
    Values,
    WriteAreaValue,
    WriteBlockValue,
    WriteTag,
    WriteVariables,
    Written,
    WrittenValues,
)
from .tags import Tag
from .wire import SUCCESS, Variable, items_of, read_job, write_job

__all__ = ["Tools"]

_AREAS = {"DB": S7Area.DB, "I": S7Area.PE, "Q": S7Area.PA, "M": S7Area.MK}
_ANSWER_HEAD = 18
"""Bytes of an answer to a read before the data of its only variable."""


def _bytes(area: str, db: int, byte: int, size: int) -> Variable:
    return Variable(area=_AREAS[area], db=db, byte=byte, size=size)


def _value(area: str, db: int, byte: int, kind: DataType, bit: int) -> Variable:
    return Variable(area=_AREAS[area], db=db, byte=byte, size=width(kind), bit=bit if kind == "BOOL" else None)


def _address(variable: Variable) -> str:
    """Return an address as STEP 7 writes it, with its width: ``DB10.DBW2``, ``MX3.5``."""
    (area,) = (name for name, one in _AREAS.items() if one is variable.area)
    within = f"DB{variable.db}.DB" if area == "DB" else area
    if variable.bit is not None:
        return f"{within}X{variable.byte}.{variable.bit}"
    width = {1: "B", 2: "W", 4: "D", 8: "L"}.get(variable.size)
    return f"{within}{width}{variable.byte}" if width else f"{within}B{variable.byte}[{variable.size}]"


def _told(call: Call, place: str, content: bytes, kind: DataType) -> Value:
    """Return the value that bytes hold, for this place of the answer; a text is marked as the device's, ``raw`` has its bytes."""
    value = decode(content, kind)
    if isinstance(value["value"], str) and kind in ("CHAR", "STRING"):
        value["value"] = device_text(call, f"{place}/value", value["value"])
    return value


class Tools(Cpu):
    """The tools over one connection; those about the CPU itself are the base class's.

    Args:
        link: the connection.
        tags: the tag map.
        control_enabled: starting and stopping the CPU is allowed.
    """

    def __init__(self, link: Link, *, tags: Mapping[str, Tag], control_enabled: bool) -> None:
        super().__init__(link, control_enabled=control_enabled)
        self._tags = NameMap(tags, kind="tag", argument="name", listed_by="list_tags")

    # -- reading ------------------------------------------------------------------------------------------

    @tool("s7.read_db")
    async def read_db(self, call: Call, arguments: BlockBytes) -> ReadBytes:
        """Read bytes of a data block, in one request."""
        return await self._read_bytes(call, "DB", arguments.db_number, arguments.start_offset, arguments.size)

    @tool("s7.read_typed")
    async def read_db_typed(self, call: Call, arguments: BlockValue) -> TypedValue:
        """Read one value of a data block, in one request."""
        kind, start = arguments.data_type, arguments.start_offset
        if kind == "STRING":
            variable = await self._string(call, arguments)
        else:
            variable = _value("DB", arguments.db_number, start, kind, arguments.bit_index)
        (content,) = await self._read(call, [variable])
        return {"start": start, **_told(call, "/data", content, kind)}

    @tool("s7.read_input")
    async def read_input(self, call: Call, arguments: AreaBytes) -> ReadBytes:
        """Read bytes of the process image of the inputs (I)."""
        return await self._read_bytes(call, "I", 0, arguments.start_byte, arguments.size)

    @tool("s7.read_output")
    async def read_output(self, call: Call, arguments: AreaBytes) -> ReadBytes:
        """Read bytes of the process image of the outputs (Q)."""
        return await self._read_bytes(call, "Q", 0, arguments.start_byte, arguments.size)

    @tool("s7.read_marker")
    async def read_marker(self, call: Call, arguments: AreaBytes) -> ReadBytes:
        """Read bytes of the flags (bit memory, M)."""
        return await self._read_bytes(call, "M", 0, arguments.start_byte, arguments.size)

    @tool("s7.read_many")
    async def read_multiple_vars(self, call: Call, arguments: ReadVariables) -> Values:
        """Read several variables by one request, so at one moment."""
        wanted = arguments.variables
        contents = await self._read(call, [_of(variable) for variable in wanted])
        return {
            "values": [
                _told(call, f"/data/values/{place}", content, variable.data_type)
                for place, (content, variable) in enumerate(zip(contents, wanted, strict=True))
            ]
        }

    @tool("s7.list_tags")
    async def list_tags(self, call: Call, arguments: Nothing) -> TagList:
        """List the tag map: names, places, types and units. Asks the controller nothing."""
        return {"tags": [{"name": name, **tag.model_dump()} for name, tag in sorted(self._tags.items())]}

    @tool("s7.read_tag")
    async def read_tag(self, call: Call, arguments: TagName) -> TagValue:
        """Read a tag's value."""
        tag = self._tags.known(arguments.name)
        (content,) = await self._read(call, [_value(tag.area, tag.db, tag.start, tag.type, tag.bit)])
        return {"name": arguments.name, "unit": tag.unit, **_told(call, "/data", content, tag.type)}

    # -- writing ------------------------------------------------------------------------------------------

    @tool("s7.write_db", writes=True)
    async def write_db(self, call: Call, arguments: WriteBlockValue) -> Written:
        """Write one value to a data block, in one request. Of a STRING the declared length stays; a longer text is refused."""
        kind, start = arguments.data_type, arguments.start_offset
        content = encode(arguments.value, kind)
        if kind == "STRING":
            declared = await self._declared_length(call, arguments)
            if content[0] > declared:
                message = f"the STRING holds up to {declared} characters"
                raise AdapterError("limit_exceeded", message, field="/value", outcome="not_sent")
            variable = _bytes("DB", arguments.db_number, start + 1, len(content))
        else:
            variable = _value("DB", arguments.db_number, start, kind, arguments.bit_index)
        await self._write(call, [variable], [content], [arguments.value])
        return _written(start, kind, arguments.value, content)

    @tool("s7.write_output", writes=True)
    async def write_output(self, call: Call, arguments: WriteAreaValue) -> Written:
        """Write one value to the process image of the outputs (Q). A program that drives the output writes over it."""
        return await self._write_area(call, "Q", arguments)

    @tool("s7.write_marker", writes=True)
    async def write_marker(self, call: Call, arguments: WriteAreaValue) -> Written:
        """Write one value to the flags (bit memory, M). A BOOL is written as one bit; its neighbours are not touched."""
        return await self._write_area(call, "M", arguments)

    @tool("s7.write_many", writes=True)
    async def write_multiple_vars(self, call: Call, arguments: WriteVariables) -> WrittenValues:
        """Write several variables by one request. The controller confirms each; a call that it confirms in part has failed."""
        wanted = arguments.variables
        contents = [
            encode(variable.value, variable.data_type, f"/variables/{number}/value")
            for number, variable in enumerate(wanted)
        ]
        await self._write(call, [_of(one) for one in wanted], contents, [one.value for one in wanted])
        return {
            "values": [
                _written(variable.start_byte, variable.data_type, variable.value, content)
                for variable, content in zip(wanted, contents, strict=True)
            ]
        }

    @tool("s7.write_tag", writes=True)
    async def write_tag(self, call: Call, arguments: WriteTag) -> TagWritten:
        """Write a tag's value."""
        tag = self._tags.writable(arguments.name)
        content = encode(arguments.value, tag.type)
        variable = _value(tag.area, tag.db, tag.start, tag.type, tag.bit)
        await self._write(call, [variable], [content], [arguments.value])
        return {
            "name": arguments.name,
            "unit": tag.unit,
            **_written(tag.start, tag.type, arguments.value, content),
        }

    # -- requests -----------------------------------------------------------------------------------------

    async def _read(self, call: Call, variables: Sequence[Variable], *, question: bool = False) -> list[bytes]:
        """Read variables by one job; a ``question`` is what a writing tool asks before it writes."""
        size = _ANSWER_HEAD - 4 + sum(4 + variable.size + variable.size % 2 for variable in variables)
        if size - variables[-1].size % 2 > self._link.pdu_size:
            message = f"the answer does not fit into a PDU of {self._link.pdu_size} bytes; ask for less at once"
            raise AdapterError("limit_exceeded", message, outcome="not_sent" if call.writes else "not_applicable")
        request = read_job(self._link.protocol, variables)
        items = await self._items(call, request, changes_state=not question)
        for code, _ in items:
            if code != SUCCESS:
                raise refusal(call, return_code=code)
        return [content for _, content in items]

    async def _write(
        self, call: Call, variables: Sequence[Variable], contents: Sequence[bytes], values: Sequence[Plain]
    ) -> None:
        """Write variables by one job.

        Raises:
            AdapterError: the controller refuses, or ``partial_failure``: it refuses some of them.
        """
        call.changes(*((_address(variable), value) for variable, value in zip(variables, values, strict=True)))
        codes = [code for code, _ in await self._items(call, write_job(self._link.protocol, variables, contents))]
        refused = [code for code in codes if code != SUCCESS]
        if not refused:
            return
        if len(refused) == len(codes):
            raise refusal(call, return_code=refused[0])
        call.trace["return_codes"] = codes
        shown = [{"written": code == SUCCESS, "return_code": code} for code in codes]
        message = f"{len(refused)} of {len(codes)} variables were refused; the others are written"
        raise AdapterError("partial_failure", message, outcome="partial", partial=shown)

    async def _items(self, call: Call, request: bytes, *, changes_state: bool = True) -> list[tuple[int, bytes]]:
        reply = await self._link.exchange(call, request, changes_state=changes_state)
        try:
            return items_of(request, reply)
        except BadReply as fault:
            message = f"the answer is not the one to the request: {fault}"
            raise AdapterError("protocol_error", message) from None

    async def _read_bytes(self, call: Call, area: str, db: int, start: int, size: int) -> ReadBytes:
        (content,) = await self._read(call, [_bytes(area, db, start, size)])
        return {"start": start, "bytes": list(content)}

    async def _write_area(self, call: Call, area: str, arguments: WriteAreaValue) -> Written:
        kind, start = arguments.data_type, arguments.start_byte
        content = encode(arguments.value, kind)
        variable = _value(area, 0, start, kind, arguments.bit_index)
        await self._write(call, [variable], [content], [arguments.value])
        return _written(start, kind, arguments.value, content)

    async def _declared_length(self, call: Call, arguments: BlockValue) -> int:
        """Return the declared length of a STRING, which the controller is asked for where the caller does not say it."""
        if arguments.string_length is not None:
            return arguments.string_length
        (head,) = await self._read(call, [_bytes("DB", arguments.db_number, arguments.start_offset, 1)], question=True)
        return head[0]

    async def _string(self, call: Call, arguments: BlockValue) -> Variable:
        size = width("STRING", await self._declared_length(call, arguments))
        return _bytes("DB", arguments.db_number, arguments.start_offset, size)


def _of(variable: OneVariable) -> Variable:
    return _value(variable.area, variable.db_number, variable.start_byte, variable.data_type, variable.bit_index)


def _written(start: int, kind: DataType, value: Plain, content: bytes) -> Written:
    return {"start": start, "type": kind, "value": exact_in_json(value), "raw": content.hex()}
