"""The identity of the controller: the object of class 1, and what the encapsulation layer tells of it."""

from __future__ import annotations

import ipaddress
import struct

from pytest_otmcp.wire.ethernetip.messages import Refusal

__all__ = ["attribute", "every_attribute", "identity_item", "program_name", "services_item"]

_VENDOR, _DEVICE_TYPE, _PRODUCT = 1, 0x0E, 0xA8
_REVISION = bytes([36, 11])
_STATUS = 0x3160
"""Owned, in run mode, the key switch at remote."""
_SERIAL = 0x00C0FFEE
_NAME = b"1756-L83E/B"
_PROGRAM = b"KitController"
_OPERATIONAL = 3


def _attributes() -> tuple[bytes, ...]:
    numbers = [struct.pack("<H", number) for number in (_VENDOR, _DEVICE_TYPE, _PRODUCT)]
    return (*numbers, _REVISION, struct.pack("<H", _STATUS), struct.pack("<I", _SERIAL), bytes([len(_NAME)]) + _NAME)


def every_attribute() -> bytes:
    """Return vendor, device type, product code, revision, status, serial number and name."""
    return b"".join(_attributes())


def attribute(number: int | None) -> bytes:
    """Return one of them, from 1.

    Raises:
        Refusal: there is none of this number.
    """
    known = _attributes()
    if number is None or not 1 <= number <= len(known):
        raise Refusal(0x14)
    return known[number - 1]


def program_name() -> bytes:
    """Return the name of the controller's project."""
    return struct.pack("<H", len(_PROGRAM)) + _PROGRAM


def identity_item(address: tuple[str, int]) -> bytes:
    """Return the item with which ListIdentity is answered (volume 2, 2-4.2)."""
    host, port = address
    socket_address = struct.pack(">HH", 2, port) + ipaddress.IPv4Address(host).packed + bytes(8)
    body = struct.pack("<H", 1) + socket_address + every_attribute() + bytes([_OPERATIONAL])
    return struct.pack("<HHH", 1, 0x0C, len(body)) + body


def services_item() -> bytes:
    """Return the item with which ListServices is answered: messages over TCP."""
    body = struct.pack("<HH", 1, 0x20) + b"Communications\0\0"
    return struct.pack("<HHH", 1, 0x100, len(body)) + body
