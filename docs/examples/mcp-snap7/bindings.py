"""Values of a type with mcp-snap7, whose tools know bytes alone."""

import struct

from pytest_otmcp.subject import Refused

FORMATS = {"BYTE": "B", "WORD": "H", "DWORD": "I", "INT": "h", "DINT": "i", "REAL": "f", "LREAL": "d"}


async def read_typed(tools, *, db, start, type):
    code = ">" + FORMATS[type]
    answer = await tools.call("db_read", db_number=db, start=start, size=struct.calcsize(code))
    if answer.is_error:
        raise Refused("unclassified", answer.text)
    return {"value": struct.unpack(code, bytes.fromhex(answer.structured["result"]))[0]}


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
