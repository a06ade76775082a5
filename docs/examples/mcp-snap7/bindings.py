"""Values of a type with mcp-snap7, whose tools know bytes alone."""

import struct

from pytest_otmcp.subject import Refused

FORMATS = {
    "BYTE": "B", "WORD": "H", "DWORD": "I", "USINT": "B", "UINT": "H", "UDINT": "I", "ULINT": "Q",
    "SINT": "b", "INT": "h", "DINT": "i", "LINT": "q", "REAL": "f", "LREAL": "d",
}  # fmt: skip
LONGEST = 254
"""Characters of the longest STRING, which lie behind a byte with their declared number and one with the present one."""


async def read_typed(tools, *, db, start, type):
    if type == "BOOL":
        return {"value": bool((await _read(tools, db, start, 1))[0] & 1)}
    if type == "STRING":
        _, length = await _read(tools, db, start, 2)
        return {"value": (await _read(tools, db, start + 2, min(length, LONGEST))).decode("latin-1") if length else ""}
    code = ">" + FORMATS[type]
    return {"value": struct.unpack(code, await _read(tools, db, start, struct.calcsize(code)))[0]}


async def write_db(tools, *, db, start, type, value):
    try:
        data = struct.pack(">" + FORMATS[type], value).hex()
    except struct.error:
        # What the type cannot hold has no bytes: the tool is given it as it is, and has to refuse it.
        data = str(value)
    answer = await tools.call("db_write", db_number=db, start=start, data=data)
    if answer.is_error:
        raise Refused("unclassified", answer.text)
    return {}


async def _read(tools, db, start, size):
    answer = await tools.call("db_read", db_number=db, start=start, size=size)
    if answer.is_error:
        raise Refused("unclassified", answer.text)
    return bytes.fromhex(answer.structured["result"])
