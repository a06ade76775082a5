"""FDL telegrams as bytes (IEC 61158-4-3; the formats are in the public manuals of slave controllers, such as Siemens' SPC3)."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = [
    "FDL_STATUS",
    "MOST_DATA",
    "SERVICES",
    "BadTelegram",
    "Telegram",
    "is_short_acknowledgement",
    "service_of",
    "take",
]

SHORT_ACKNOWLEDGEMENT = 0xE5
_NO_DATA, _VARIABLE, _FIXED, _TOKEN, _END = 0x10, 0x68, 0xA2, 0xDC, 0x16
_EXTENSION = 0x80
_FIXED_DATA = 8
MOST_DATA = 244
"""Bytes of data of a telegram with access points."""
FDL_STATUS = 0x49
"""Control byte of a request for the status of a station."""
SERVICES = {
    "RD_Inp": 56,
    "RD_Outp": 57,
    "Global_Control": 58,
    "Get_Cfg": 59,
    "Slave_Diag": 60,
    "Set_Prm": 61,
    "Chk_Cfg": 62,
    "Data_Exchange": None,
}
"""Services of DP to their access points at the slave (IEC 61158-6-3); None for the default one."""


class BadTelegram(Exception):
    """What is on the line is no telegram."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Telegram:
    """One telegram; a short acknowledgement has no addresses, which are None.

    Attributes:
        destination, source: addresses, 0 to 127.
        control: the frame control byte.
        dsap, ssap: destination and source access points; None for the default one.
        data: the data after them.
    """

    destination: int | None
    source: int | None
    control: int
    dsap: int | None = None
    ssap: int | None = None
    data: bytes = b""

    @property
    def function(self) -> int:
        """The function code: of an answer its status."""
        return self.control & 0x0F

    def encoded(self) -> bytes:
        """Return the bytes on the line."""
        assert self.destination is not None
        assert self.source is not None
        body = bytes([self.destination, self.source, self.control]) + self.data
        if self.dsap is not None and self.ssap is not None:
            addresses = [self.destination | _EXTENSION, self.source | _EXTENSION]
            body = bytes([*addresses, self.control, self.dsap, self.ssap]) + self.data
        end = bytes([sum(body) & 0xFF, _END])
        if len(body) == 3:
            return bytes([_NO_DATA]) + body + end
        return bytes([_VARIABLE, len(body), len(body), _VARIABLE]) + body + end


def is_short_acknowledgement(telegram: Telegram) -> bool:
    """Tell whether a telegram is the single character SC."""
    return telegram.source is None


def service_of(telegram: Telegram) -> str:
    """Return the name of the service that a request is for."""
    if telegram.control == FDL_STATUS:
        return "FDL_Status"
    return next(name for name, dsap in SERVICES.items() if dsap == telegram.dsap)


def take(buffer: bytearray) -> Telegram | None:
    """Remove the first telegram of what was received and return it; None while it is not complete. Tokens are passed over.

    Raises:
        BadTelegram: it begins, or goes on, as no telegram does.
    """
    while buffer:
        length = _length(buffer)
        if length is None or len(buffer) < length:
            return None
        frame = bytes(buffer[:length])
        del buffer[:length]
        if frame[0] == SHORT_ACKNOWLEDGEMENT:
            return Telegram(destination=None, source=None, control=0)
        if frame[0] != _TOKEN:
            return _decoded(frame)
    return None


def _length(buffer: bytearray) -> int | None:
    """Return the number of bytes of the first telegram; None while that is not known."""
    match buffer[0]:
        case 0xE5:
            return 1
        case 0xDC:
            return 3
        case 0x10:
            return 6
        case 0xA2:
            return 6 + _FIXED_DATA
        case 0x68:
            if len(buffer) < 4:
                return None
            length, repeated, again = buffer[1:4]
            if length != repeated or again != _VARIABLE or not 4 <= length <= 249:
                raise BadTelegram("its length is contradicted")
            return length + 6
    raise BadTelegram("no telegram begins like this")


def _decoded(frame: bytes) -> Telegram:
    body = frame[4 if frame[0] == _VARIABLE else 1 : -2]
    if frame[-1] != _END or frame[-2] != sum(body) & 0xFF:
        raise BadTelegram("its checksum or its end is wrong")
    destination, source, control, data = body[0], body[1], body[2], body[3:]
    points: list[int | None] = []
    for address in (destination, source):
        if address & _EXTENSION:
            if not data or data[0] & _EXTENSION:
                raise BadTelegram("an access point is missing")
            points.append(data[0])
            data = data[1:]
        else:
            points.append(None)
    return Telegram(
        destination=destination & 0x7F,
        source=source & 0x7F,
        control=control,
        dsap=points[0],
        ssap=points[1],
        data=data,
    )
