"""Ethernet frames, and the UDP datagrams in some of them (IEEE 802.3, 802.1Q; RFC 791, 768, 826)."""

from __future__ import annotations

import ipaddress
import struct
from dataclasses import dataclass

from ..framing import MalformedError

__all__ = ["ARP", "IPV4", "PROFINET", "RPC_PORT", "Datagram", "Frame"]

PROFINET, IPV4, ARP = 0x8892, 0x0800, 0x0806
RPC_PORT = 34964
_VLAN = 0x8100
_SHORTEST = 60
_HEADER, _IP, _UDP = 14, 20, 8
_UDP_PROTOCOL = 17
_FRAGMENT = 0x3FFF


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """An Ethernet frame without its check sequence.

    Attributes:
        destination, source: addresses, six bytes each.
        ethertype: what it carries; a VLAN tag before it is passed over.
        payload: what follows, with its padding.
    """

    destination: bytes
    source: bytes
    ethertype: int
    payload: bytes

    @classmethod
    def parse(cls, raw: bytes) -> Frame:
        """Read a frame.

        Raises:
            MalformedError: it is shorter than its header.
        """
        at = _HEADER + (4 if raw[12:14] == _VLAN.to_bytes(2) else 0)
        if len(raw) < at:
            raise MalformedError(f"a frame of {len(raw)} bytes")
        ethertype = int.from_bytes(raw[at - 2 : at])
        return cls(destination=raw[:6], source=raw[6:12], ethertype=ethertype, payload=raw[at:])

    def encoded(self) -> bytes:
        """Return the frame, padded to the length that a wire needs."""
        raw = self.destination + self.source + self.ethertype.to_bytes(2) + self.payload
        return raw.ljust(_SHORTEST, b"\0")


@dataclass(frozen=True, slots=True, kw_only=True)
class Datagram:
    """A UDP datagram in an IPv4 packet.

    Attributes:
        source, destination: addresses as text, with ports.
        data: what it carries.
    """

    source: tuple[str, int]
    destination: tuple[str, int]
    data: bytes

    @classmethod
    def parse(cls, packet: bytes) -> Datagram:
        """Read a packet. Its checksums are not looked at: those of a virtual cable are left to a card that is not there.

        Raises:
            MalformedError: it is no whole UDP datagram.
        """
        if len(packet) < _IP + _UDP or packet[0] >> 4 != 4:
            raise MalformedError("no IPv4 packet")
        header = (packet[0] & 0x0F) * 4
        total, _, fragment = struct.unpack_from(">HHH", packet, 2)
        if packet[9] != _UDP_PROTOCOL or fragment & _FRAGMENT:
            raise MalformedError("a packet that is no whole UDP datagram")
        datagram = packet[header:total]
        if header < _IP or total > len(packet) or len(datagram) < _UDP:
            raise MalformedError("an IPv4 packet whose lengths are wrong")
        source, destination, length = struct.unpack_from(">HHH", datagram)
        if not _UDP <= length <= len(datagram):
            raise MalformedError("a UDP datagram whose length is wrong")
        return cls(
            source=(_text(packet[12:16]), source),
            destination=(_text(packet[16:20]), destination),
            data=datagram[_UDP:length],
        )

    def encoded(self) -> bytes:
        """Return the packet; its UDP checksum is left out, which RFC 768 allows."""
        addresses = b"".join(ipaddress.IPv4Address(one[0]).packed for one in (self.source, self.destination))
        total = _IP + _UDP + len(self.data)
        head = struct.pack(">BBHHHBBH", 0x45, 0, total, 0, 0x4000, 64, _UDP_PROTOCOL, 0) + addresses
        head = head[:10] + _checksum(head).to_bytes(2) + head[12:]
        ports = struct.pack(">HHHH", self.source[1], self.destination[1], _UDP + len(self.data), 0)
        return head + ports + self.data


def _text(address: bytes) -> str:
    return str(ipaddress.IPv4Address(address))


def _checksum(header: bytes) -> int:
    total: int = sum(struct.unpack(f">{len(header) // 2}H", header))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return total ^ 0xFFFF
