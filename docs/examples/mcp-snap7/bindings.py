"""Values of a type with mcp-snap7, whose tools know bytes alone."""

import math
import struct

from pytest_otmcp.subject import Refused

FORMATS = {
    "BYTE": "B", "WORD": "H", "DWORD": "I", "LWORD": "Q", "USINT": "B", "UINT": "H", "UDINT": "I", "ULINT": "Q",
    "SINT": "b", "INT": "h", "DINT": "i", "LINT": "q", "REAL": "f", "LREAL": "d",
}  # fmt: skip
SPECIAL = {"nan": "NaN", "inf": "Infinity", "-inf": "-Infinity"}


async def read_typed(tools, *, db, start, type):
    if type == "BOOL":
        return {"value": bool((await _read(tools, db, start, 1))[0] & 1)}
    if type == "STRING":
        # Before its characters: the length that was declared, and the length that it has.
        _, length = await _read(tools, db, start, 2)
        return {"value": (await _read(tools, db, start + 2, length)).decode("latin-1") if length else ""}
    code = ">" + FORMATS[type]
    (value,) = struct.unpack(code, await _read(tools, db, start, struct.calcsize(code)))
    if isinstance(value, float) and not math.isfinite(value):
        return {"value": None, "special": SPECIAL[str(value)]}
    return {"value": value}


async def write_db(tools, *, db, start, type, value):
    try:
        if type == "BOOL":
            held = (await _read(tools, db, start, 1))[0]
            data = bytes([held | 1 if value else held & 0xFE])
        elif type == "STRING":
            start, data = start + 1, await _string(tools, db, start, value)
        else:
            data = struct.pack(">" + FORMATS[type], value)
        digits = data.hex()
    except (struct.error, OverflowError, UnicodeEncodeError):
        # What the type cannot hold has no bytes. The tool is told so in words, which are no digits, and has to refuse them.
        digits = f"{value!r} as {type}"
    answer = await tools.call("db_write", db_number=db, start=start, data=digits)
    if answer.is_error:
        raise Refused("unclassified", answer.text)
    return {}


async def _string(tools, db, start, text):
    """Return the bytes behind the declared length."""
    (declared,) = await _read(tools, db, start, 1)
    if len(text) > declared:
        raise OverflowError
    return struct.pack("B", len(text)) + text.encode("latin-1")


async def _read(tools, db, start, size):
    answer = await tools.call("db_read", db_number=db, start=start, size=size)
    if answer.is_error:
        raise Refused("unclassified", answer.text)
    return bytes.fromhex(answer.structured["result"])
