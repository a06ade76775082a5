"""What the device answers to DCP, and to the access to its records: pure, on the plant."""

from __future__ import annotations

import ipaddress
import struct

from pytest_otmcp.wire.profinet import dcp
from pytest_otmcp.wire.profinet.blocks import Block, Record, input_data, output_data
from pytest_otmcp.wire.profinet.dcp import Block as Option
from pytest_otmcp.wire.profinet.dcp import Dcp, is_station_name

from .plant import DEVICE, VENDOR, Plant, Station

__all__ = ["NO_RELATION", "Refused", "answer", "is_for", "read", "status", "write"]

_INVALID_INDEX, _WRITE_LENGTH, _INVALID_SLOT, _ACCESS_DENIED, _INVALID_RANGE = 0xB0, 0xB1, 0xB2, 0xB6, 0xB7
"""Error code 1 of a PNIO status about the access to a record."""
_IDENTIFICATION, _INPUTS, _OUTPUTS = 0xAFF0, 0x8028, 0x8029
"""Indexes that the standard gives a meaning: I&M0, RecordInputDataObjectElement, RecordOutputDataObjectElement."""
NO_RELATION = 0x814005
"""CMRPC, AR UUID unknown."""
_IDS = Option(dcp.IDS, struct.pack(">HHH", 0, VENDOR, DEVICE))


class Refused(Exception):
    """The access to a record is refused.

    Attributes:
        code: error code 1.
    """

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


# -- DCP ------------------------------------------------------------------------------------------------------


def is_for(station: Station, asked: Dcp) -> bool:
    """Tell whether an Identify is about a station: each block is a condition, and that of all is none."""
    name = asked.content(dcp.NAME)
    if name is not None and name.rstrip(b"\0").decode("latin-1") != station.name:
        return False
    told = _told(station)
    return all(
        one.option in (dcp.ALL, dcp.NAME)
        or ((known := told.get(one.option)) is not None and known.content[2:] == one.content)
        for one in asked.blocks
    )


def answer(plant: Plant, station: Station, asked: Dcp, *, apply: bool, error: int | None) -> Dcp:
    """Return what a station answers to a DCP request that is for it.

    Args:
        apply: False to answer as if it were done.
        error: the result of each block of a Set that is not executed; None to execute it.
    """
    if asked.service == dcp.SET:
        blocks = tuple(_result(plant, station, one, apply, error) for one in asked.blocks)
    else:
        known = _told(station)
        wanted = [one.option for one in asked.blocks] if asked.service == dcp.GET else list(known)
        blocks = tuple(known.get(option) or Option(dcp.RESULT, bytes([*option, 1])) for option in wanted)
    return Dcp(
        frame_id=dcp.IDENTIFY_RESPONSE if asked.service == dcp.IDENTIFY else dcp.GET_OR_SET,
        service=asked.service,
        kind=dcp.RESPONSE,
        xid=asked.xid,
        blocks=blocks,
    )


def _told(station: Station) -> dict[tuple[int, int], Option]:
    addresses = b"".join(ipaddress.IPv4Address(one).packed for one in (station.ip, station.mask, station.gateway))
    told = (
        Option(dcp.VENDOR, b"\0\0Kit Station"),
        Option(dcp.NAME, b"\0\0" + station.name.encode()),
        _IDS,
        Option(dcp.ROLE, b"\0\0\1\0"),
        Option(dcp.IP, b"\0\1" + addresses),
    )
    return {one.option: one for one in told}


def _result(plant: Plant, station: Station, block: Option, apply: bool, error: int | None) -> Option:
    if error is None:
        error = _set(plant, station, block, apply)
    return Option(dcp.RESULT, bytes([*block.option, error]))


def _set(plant: Plant, station: Station, block: Option, apply: bool) -> int:
    value = block.content[2:]
    if block.option in (dcp.START, dcp.STOP):
        return dcp.SUCCESS
    if block.option == dcp.SIGNAL:
        plant.signalled += apply
        return dcp.SUCCESS
    permanent = bool(block.content[1] & 1) if len(block.content) > 1 else False
    if block.option == dcp.NAME:
        name = value.decode("latin-1")
        # No name at all is that of a station that has none yet.
        if name and not is_station_name(name):
            return dcp.REFUSED
        if apply:
            station.name, station.permanent = name, permanent
        return dcp.SUCCESS
    if block.option == dcp.IP and len(value) == 12:
        if apply:
            station.ip, station.mask, station.gateway = (
                str(ipaddress.IPv4Address(value[at : at + 4])) for at in (0, 4, 8)
            )
        return dcp.SUCCESS
    return dcp.UNSUPPORTED_OPTION


# -- records --------------------------------------------------------------------------------------------------


def status(kind: int, code: int) -> int:
    """Return the PNIO status of a refused access to a record, or of another refused request.

    Args:
        kind: first byte: DE for a read, DF for a write.
        code: error code 1, or three bytes of which it is the second.
    """
    return kind << 24 | (code if code > 0xFF else 0x800000 | code << 8)


def read(plant: Plant, asked: Record) -> bytes:
    """Return the content of a record.

    Raises:
        Refused: there is no such slot or index.
    """
    one = plant.subslots.get((asked.slot, asked.subslot))
    if one is None:
        raise Refused(_INVALID_SLOT)
    if asked.index == _IDENTIFICATION:
        return _identification()
    if asked.index == _INPUTS and one.inputs:
        return input_data(bytes(one.inputs))
    if asked.index == _OUTPUTS and one.outputs:
        return output_data(bytes(one.outputs), active=bool(plant.controller))
    if asked.index not in one.records:
        raise Refused(_INVALID_INDEX)
    return bytes(one.records[asked.index])


def write(plant: Plant, asked: Record, content: bytes, *, apply: bool) -> None:
    """Write a record.

    Raises:
        Refused: there is no such record, it is only read, or the content is not one that it can have.
    """
    one = plant.subslots.get((asked.slot, asked.subslot))
    if one is None:
        raise Refused(_INVALID_SLOT)
    held = one.records.get(asked.index)
    if held is None:
        raise Refused(_INVALID_INDEX)
    if asked.index in one.read_only:
        raise Refused(_ACCESS_DENIED)
    if len(content) != len(held):
        raise Refused(_WRITE_LENGTH)
    if int.from_bytes(content) > one.limits.get(asked.index, 1 << 64):
        raise Refused(_INVALID_RANGE)
    if apply:
        held[:] = content


def _identification() -> bytes:
    """I&M0: who made the device, and what it is (IEC 61158-6-10, 5.2.4.62)."""
    order, serial = b"KIT-PN-1".ljust(20), b"0001".ljust(16)
    numbers = struct.pack(">HBBBBHHHBBH", 1, ord("V"), 1, 0, 0, 0, 0, 0, 1, 1, 0)
    return Block(0x0020, struct.pack(">H", VENDOR) + order + serial + numbers).encoded()
