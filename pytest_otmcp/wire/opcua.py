"""The chunks of OPC UA over TCP (OPC 10000-6, section 7.1). What is in them the mock leaves to its library, and the kit reads by itself."""

from __future__ import annotations

import struct

from .framing import MalformedError

__all__ = ["LARGEST_CHUNK", "chunk_length"]

_MESSAGES = frozenset({b"HEL", b"ACK", b"ERR", b"RHE", b"OPN", b"MSG", b"CLO"})
LARGEST_CHUNK = 64 * 1024 * 1024


def chunk_length(buffer: bytes | bytearray) -> int | None:
    """Return the length of the message chunk at the beginning of the buffer (section 7.1.2.2).

    Raises:
        MalformedError: unknown message or chunk type, or an impossible size.
    """
    if len(buffer) < 8:
        return None
    kind, final, size = struct.unpack_from("<3scI", buffer)
    if kind not in _MESSAGES or final not in b"FCA":
        raise MalformedError(f"{bytes(buffer[:4])!r} begins no chunk")
    if not 8 <= size <= LARGEST_CHUNK:
        raise MalformedError(f"the chunk size is {size}")
    return int(size)
