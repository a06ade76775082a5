"""The system status list (SZL) of the controller: its lists by id and index, as records of equal length."""

from __future__ import annotations

import struct

from .image import Plant

__all__ = ["system_status"]

_ORDER_NUMBER = b"6ES7 315-2EH14-0AB0 "
_RUN, _STOP = 8, 4


def system_status(plant: Plant, identifier: int, index: int) -> bytes | None:
    """Return a list with its header (id, index, length of a record, number of records); None if there is no such list."""
    lists = {
        (0x0011, 0): _identification(),
        (0x001C, 0): _components(),
        # Communication: largest PDU, connections, rates of MPI and backplane bus.
        (0x0131, 1): [struct.pack(">HHHII", 1, plant.pdu_size, 16, 187500, 187500).ljust(40, b"\0")],
        (0x0424, 0): [_operating_state(plant.running)],
    }
    lists[0, 0] = [struct.pack(">H", known) for known, _ in sorted([*lists, (0, 0)])]
    records = lists.get((identifier, index))
    if records is None:
        return None
    return struct.pack(">4H", identifier, index, len(records[0]), len(records)) + b"".join(records)


def _identification() -> list[bytes]:
    """Module identification: order number, hardware, firmware V3.2.6."""
    return [
        struct.pack(">H20sHBBBB", number, _ORDER_NUMBER, 0x00C0, ord("V"), *version)
        for number, version in ((1, (1, 0, 0)), (6, (1, 0, 0)), (7, (3, 2, 6)))
    ]


def _components() -> list[bytes]:
    # A client that picks fields by their position needs these records in this order, each 34 bytes long.
    texts = {
        1: b"KIT-STATION",
        2: b"KIT-CPU",
        3: b"",
        4: b"pytest-otmcp",
        5: b"S C-KIT000012026",
        7: b"CPU 315-2 PN/DP",
        8: b"MMC KIT0001",
    }
    return [struct.pack(">H32s", number, text) for number, text in texts.items()]


def _operating_state(running: bool) -> bytes:
    """Return the record of SZL 0424: an event, and the operating state in its byte 3."""
    state = _RUN if running else _STOP
    return struct.pack(">HBBIHHII", 0x4302 if running else 0x4303, 0xFF, state, 0, 0, 0, 0, 0)[:20]
