"""The codec of PROFIBUS DP: telegrams of the fieldbus data link (IEC 61158-4-3, EN 50170 volume 2, part 4), and the services that their
access points stand for (part 8 of the same).

Four start delimiters: ``10`` without data, ``68`` with 1 to 246 bytes, ``A2`` with 8 bytes, ``DC`` token; ``E5`` is the short
acknowledgement. The checksum is the sum of the bytes from the destination address on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .framing import MalformedError

__all__ = [
    "BROADCAST",
    "NO_ACKNOWLEDGEMENT",
    "SERVICES",
    "SHORT_ACKNOWLEDGEMENT",
    "TOKEN",
    "Telegram",
    "request_fields",
    "service_of",
    "telegram_length",
]

NO_DATA, VARIABLE, FIXED, TOKEN, SHORT_ACKNOWLEDGEMENT = 0x10, 0x68, 0xA2, 0xDC, 0xE5
BROADCAST = 127

_END = 0x16
_LENGTHS = {NO_DATA: 6, FIXED: 14, TOKEN: 3, SHORT_ACKNOWLEDGEMENT: 1}
_EXTENSION = 0x80
_ADDRESS = 0x7F
_SAP = 0x3F


MASTER_SAP = 62
"""SSAP of a master's requests to a slave (MS0)."""

_BY_SAP = {
    55: "set_slave_add",
    56: "rd_inp",
    57: "rd_outp",
    58: "global_control",
    59: "get_cfg",
    60: "slave_diag",
    61: "set_prm",
    62: "chk_cfg",
}
SERVICES = ("fdl_status", "data_exchange", *_BY_SAP.values(), "other")
"""Names of all services, as the journal and fault rules have them."""

NO_ACKNOWLEDGEMENT = frozenset({4, 6})
"""Functions of requests without acknowledgement: SDN with low and with high priority."""
REPLY = frozenset({12, 13})
"""Functions of requests with reply: SRD with low and with high priority."""
_FDL_STATUS = 9


def telegram_length(buffer: bytes | bytearray) -> int | None:
    """Return the length of the telegram at the beginning of the buffer; None while too little of it has arrived.

    Raises:
        MalformedError: no telegram begins like that.
    """
    start = buffer[0]
    if start in _LENGTHS:
        return _LENGTHS[start]
    if start != VARIABLE:
        raise MalformedError(f"no telegram begins with {start:02X}")
    if len(buffer) < 4:
        return None
    if buffer[1] != buffer[2] or buffer[3] != VARIABLE or not 4 <= buffer[1] <= 249:
        raise MalformedError(f"no header of a telegram with data: {buffer[:4].hex(' ')}")
    return buffer[1] + 6


@dataclass(frozen=True, slots=True, kw_only=True)
class Telegram:
    """A telegram with addresses and a frame control byte.

    Attributes:
        destination, source: addresses of stations, 0 to 126; 127 is everybody.
        control: the frame control byte.
        dsap, ssap: service access points; None for the default one.
        data: what follows them.
    """

    destination: int
    source: int
    control: int
    dsap: int | None = None
    ssap: int | None = None
    data: bytes = b""

    @property
    def is_request(self) -> bool:
        """Tell whether an initiator sends it."""
        return bool(self.control & 0x40)

    @property
    def function(self) -> int:
        """Function of the frame control byte."""
        return self.control & 0x0F

    @property
    def count_is_valid(self) -> bool:
        """Tell whether the frame count bit counts (FCV)."""
        return bool(self.control & 0x10)

    @property
    def count(self) -> bool:
        """The frame count bit (FCB)."""
        return bool(self.control & 0x20)

    @classmethod
    def parse(cls, raw: bytes) -> Telegram:
        """Read a telegram that is no token and no short acknowledgement.

        Raises:
            MalformedError: its length, its checksum, its end or its address extensions are wrong.
        """
        if not raw or raw[0] in (TOKEN, SHORT_ACKNOWLEDGEMENT) or telegram_length(raw) != len(raw):
            raise MalformedError("it has no start or length of a telegram")
        body = raw[4:-2] if raw[0] == VARIABLE else raw[1:-2]
        if raw[-1] != _END:
            raise MalformedError(f"the end delimiter is {raw[-1]:02X}")
        if sum(body) & 0xFF != raw[-2]:
            raise MalformedError(f"the checksum is {raw[-2]:02X}, not {sum(body) & 0xFF:02X}")
        data = body[3:]
        saps: list[int | None] = [None, None]
        for index, address in enumerate(body[:2]):
            if address & _EXTENSION:
                if not data or data[0] & ~_SAP:
                    raise MalformedError("an address extension that is no service access point")
                saps[index], data = data[0], data[1:]
        return cls(
            destination=body[0] & _ADDRESS,
            source=body[1] & _ADDRESS,
            control=body[2],
            dsap=saps[0],
            ssap=saps[1],
            data=data,
        )

    def encoded(self) -> bytes:
        """Return the telegram as it is on the wire, in the form without data or in that of variable length."""
        extensions = bytes(sap for sap in (self.dsap, self.ssap) if sap is not None)
        marks = [_EXTENSION if sap is not None else 0 for sap in (self.dsap, self.ssap)]
        body = bytes([self.destination | marks[0], self.source | marks[1], self.control]) + extensions + self.data
        check = bytes([sum(body) & 0xFF, _END])
        if len(body) == 3:
            return bytes([NO_DATA]) + body + check
        return bytes([VARIABLE, len(body), len(body), VARIABLE]) + body + check


def service_of(telegram: Telegram) -> str:
    """Return the name of the service that a request asks for."""
    if telegram.function == _FDL_STATUS:
        return "fdl_status"
    if telegram.function not in REPLY | NO_ACKNOWLEDGEMENT:
        return "other"
    if telegram.dsap is None and telegram.ssap is None:
        return "data_exchange" if telegram.function in REPLY else "other"
    service = _BY_SAP.get(telegram.dsap or 0, "other") if telegram.ssap == MASTER_SAP else "other"
    # Only the global control has no acknowledgement, and nothing else.
    return service if (service == "global_control") == (telegram.function in NO_ACKNOWLEDGEMENT) else "other"


def request_fields(telegram: Telegram) -> dict[str, Any]:
    """Return what a request says: the members of its journal entry, see :class:`~pytest_otmcp.protocols.profibus.entries.ProfibusEntry`."""
    service = service_of(telegram)
    fields: dict[str, Any] = {
        "service": service,
        "station": telegram.destination,
        "master": telegram.source,
        "function": telegram.function,
        "dsap": telegram.dsap,
        "ssap": telegram.ssap,
        "data": telegram.data.hex(),
    }
    if telegram.count_is_valid:
        fields["count"] = telegram.count
    if service == "set_prm" and len(telegram.data) >= 7:
        fields["ident"] = telegram.data[4:6].hex()
    return fields
