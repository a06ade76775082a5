"""Captured network traffic, read while it is being written: the TCP segments of a pcap or pcapng file.

Sources: draft-ietf-opsawg-pcap and draft-ietf-opsawg-pcapng (files), tcpdump.org/linktypes.html (link layers), RFC 791, RFC 8200 and
RFC 9293, section 3.1 (headers). IPv6 extension headers and fragments are left out: TCP does without them.
"""

from __future__ import annotations

import ipaddress
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

from .framing import MalformedError

__all__ = ["Capture", "Segment", "Stream"]

Address = tuple[str, int]

_PCAP = {
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
    b"\xa1\xb2\x3c\x4d": (">", 1),
}
"""Magic numbers of a pcap file: byte order, and nanoseconds in the unit of its times."""
_PCAP_HEADER, _PCAP_RECORD = 24, 16
_SECTION, _INTERFACE, _PACKET = 0x0A0D0D0A, 1, 6
"""Types of blocks of a pcapng file; others have no packets with times, and are left out."""
_RESOLUTION, _END_OF_OPTIONS = 9, 0
_LONGEST = 1 << 24
_IPV4, _IPV6, _VLANS = 0x0800, 0x86DD, (0x8100, 0x88A8)
_TCP, _FIN, _SYN, _RST, _ACK = 6, 1, 2, 4, 16
_SHORTEST = 20
"""Bytes of an IPv4 header without options."""
_HALF = 1 << 31


@dataclass(frozen=True, slots=True, kw_only=True)
class Segment:
    """One TCP segment.

    Attributes:
        t_ns: when it was captured, in nanoseconds of the capturing machine's clock.
        source, target: address and port.
        seq: sequence number of its first byte.
        opens: it is the SYN of whoever opens the connection; ``answers``: that of the other side.
        ends: it has FIN; ``resets``: RST.
        data: what it carries.
        cut: bytes of it that the capture does not have.
    """

    t_ns: int
    source: Address
    target: Address
    seq: int
    opens: bool
    answers: bool
    ends: bool
    resets: bool
    data: bytes
    cut: int


class Capture:
    """The reader of one file. Bytes are fed as they come."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._next: Callable[[], tuple[int, Segment | None] | None] = self._head
        self._order = "<"
        self._links: list[tuple[int, Callable[[int], int]]] = []

    def feed(self, data: bytes) -> Iterator[Segment]:
        """Add bytes; yield the segments that they complete.

        Raises:
            MalformedError: the file is no capture, or of a link layer that is not read.
        """
        self._buffer += data
        while (found := self._next()) is not None:
            length, segment = found
            del self._buffer[:length]
            if segment is not None:
                yield segment

    def _head(self) -> tuple[int, None] | None:
        if len(self._buffer) < _PCAP_HEADER:
            return None
        magic = bytes(self._buffer[:4])
        if magic in _PCAP:
            self._order, unit = _PCAP[magic]
            (link,) = struct.unpack_from(f"{self._order}I", self._buffer, 20)
            self._links = [(link & 0x0FFFFFFF, lambda ticks: ticks * unit)]
            self._next = partial(self._record, unit)
            return _PCAP_HEADER, None
        if struct.unpack("<I", magic)[0] == _SECTION:
            self._next = self._block
            return 0, None
        raise MalformedError("it is neither pcap nor pcapng")

    def _record(self, unit: int) -> tuple[int, Segment | None] | None:
        if len(self._buffer) < _PCAP_RECORD:
            return None
        seconds, rest, kept, whole = struct.unpack_from(f"{self._order}IIII", self._buffer)
        if kept > _LONGEST:
            raise MalformedError(f"it has a packet of {kept} bytes")
        if len(self._buffer) < _PCAP_RECORD + kept:
            return None
        packet = bytes(self._buffer[_PCAP_RECORD : _PCAP_RECORD + kept])
        t_ns = seconds * 1_000_000_000 + rest * unit
        return _PCAP_RECORD + kept, _segment(self._links[0][0], packet, whole - kept, t_ns)

    def _block(self) -> tuple[int, Segment | None] | None:
        if len(self._buffer) < 12:
            return None
        if struct.unpack_from("<I", self._buffer)[0] == _SECTION:
            self._order = "<" if self._buffer[8:12] == b"\x4d\x3c\x2b\x1a" else ">"
            self._links = []
        kind, length = struct.unpack_from(f"{self._order}II", self._buffer)
        if not 12 <= length <= _LONGEST:
            raise MalformedError(f"it has a block of {length} bytes")
        if len(self._buffer) < length:
            return None
        body = bytes(self._buffer[8 : length - 4])
        if kind == _INTERFACE:
            self._links.append((struct.unpack_from(f"{self._order}H", body)[0], self._resolution(body[8:])))
        if kind != _PACKET:
            return length, None
        interface, high, low, kept, whole = struct.unpack_from(f"{self._order}IIIII", body)
        if interface >= len(self._links):
            raise MalformedError(f"it has a packet of interface {interface}, which it does not describe")
        link, in_ns = self._links[interface]
        return length, _segment(link, body[20 : 20 + kept], whole - kept, in_ns(high << 32 | low))

    def _resolution(self, options: bytes) -> Callable[[int], int]:
        while len(options) >= 4:
            code, length = struct.unpack_from(f"{self._order}HH", options)
            if code == _END_OF_OPTIONS:
                break
            if code == _RESOLUTION and length:
                power = options[4]
                parts = 1 << (power & 0x7F) if power & 0x80 else 10**power
                return lambda ticks: ticks * 1_000_000_000 // parts
            options = options[4 + (length + 3 & ~3) :]
        return lambda ticks: ticks * 1000


def _segment(link: int, packet: bytes, cut: int, t_ns: int) -> Segment | None:
    """Return the TCP segment of a packet; None for another one, or for one that was cut within its headers."""
    try:
        found = _ip(link, packet)
        return None if found is None else _tcp(*found, cut, t_ns)
    except (struct.error, IndexError):
        return None


def _ip(link: int, packet: bytes) -> tuple[bytes, int] | None:
    """Return an IP packet, and its version by the link layer."""
    match link:
        case 0 | 108:
            return packet[4:], packet[4] >> 4
        case 1:
            at = 12
            while (kind := struct.unpack_from(">H", packet, at)[0]) in _VLANS:
                at += 4
            start = at + 2
        case 12 | 14 | 101:
            return packet, packet[0] >> 4
        case 113:
            start, kind = 16, struct.unpack_from(">H", packet, 14)[0]
        case 276:
            start, kind = 20, struct.unpack_from(">H", packet)[0]
        case _:
            raise MalformedError(f"it was captured at a link of type {link}, which the kit does not read")
    return (packet[start:], 4 if kind == _IPV4 else 6) if kind in (_IPV4, _IPV6) else None


def _tcp(packet: bytes, version: int, cut: int, t_ns: int) -> Segment | None:
    if version == 4:
        head, protocol = (packet[0] & 0x0F) * 4, packet[9]
        whole, fragment = struct.unpack_from(">H2xH", packet, 2)
        addresses = packet[12:16], packet[16:20]
        if fragment & 0x3FFF or head < _SHORTEST:
            return None
    else:
        head, protocol = 40, packet[6]
        (rest,) = struct.unpack_from(">H", packet, 4)
        whole = rest and rest + head
        addresses = packet[8:24], packet[24:40]
    if protocol != _TCP:
        return None
    # What a network card is given to cut up has no length yet; a short frame is filled up.
    packet = packet[: whole or None]
    source, target, seq = struct.unpack_from(">HHI", packet, head)
    flags, data = packet[head + 13], packet[head + (packet[head + 12] >> 4) * 4 :]
    hosts = [str(ipaddress.ip_address(address)) for address in addresses]
    return Segment(
        t_ns=t_ns,
        source=(hosts[0], source),
        target=(hosts[1], target),
        seq=seq,
        opens=flags & (_SYN | _ACK) == _SYN,
        answers=flags & (_SYN | _ACK) == _SYN | _ACK,
        ends=bool(flags & _FIN),
        resets=bool(flags & _RST),
        data=data,
        cut=max(0, cut),
    )


class Stream:
    """The bytes of one direction of a connection, in their order, whatever the order of its segments.

    Attributes:
        begun: its SYN was seen.
    """

    def __init__(self) -> None:
        self.begun = False
        self._first = self._next = 0
        self._early: dict[int, bytes] = {}

    @property
    def waiting(self) -> int:
        """Bytes that came before others which have not come yet."""
        return sum(map(len, self._early.values()))

    def begins_with(self, segment: Segment) -> bool:
        """Tell whether this segment's SYN is the one that was seen, sent again."""
        return self.begun and segment.seq == self._first

    def take(self, segment: Segment) -> bytes:
        """Return what a segment continues the stream with; nothing where it comes again or too early."""
        if segment.opens or segment.answers:
            if not self.begins_with(segment):
                self.begun, self._first = True, segment.seq
                self._next = segment.seq + 1 & 0xFFFFFFFF
            return b""
        if not self.begun or not segment.data:
            return b""
        self._early[segment.seq] = max(self._early.get(segment.seq, b""), segment.data, key=len)
        found = b""
        while due := [seq for seq in self._early if (self._next - seq) % (1 << 32) < _HALF]:
            for seq in due:
                fresh = self._early.pop(seq)[(self._next - seq) % (1 << 32) :]
                found += fresh
                self._next = self._next + len(fresh) & 0xFFFFFFFF
        return found
