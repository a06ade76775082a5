"""A client of the EtherCAT mock that takes the drive to PREOP, and then reads or writes an object for each line that it is told; it prints
a line when the answer is there."""

import itertools
import socket
import sys

from pytest_otmcp.wire.ethercat import Datagram, encoded, parse, sdo_of

ETHERNET = bytes.fromhex("ffffffffffff 020000000001 88a4")
DRIVE = 0xFFFF
"""The position of the second slave, which the first counts down to 0."""

end = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(0x88A4))
end.bind((sys.argv[1], 0))
numbers = itertools.count(1)


def pass_through(command: int, offset: int, data: bytes) -> Datagram:
    """Send a datagram to the drive, and return what comes back."""
    number = next(numbers) % 256
    end.send(encoded(ETHERNET, [Datagram(command=command, index=number, position=DRIVE, offset=offset, data=data)]))
    while True:
        frame, address = end.recvfrom(2048)
        if address[2] != socket.PACKET_OUTGOING:
            [found] = parse(frame)
            if found.index == number:
                return found


pass_through(2, 0x0120, b"\x02\0")
print("ready", flush=True)
for line in sys.stdin:
    request = b"\0\x20\x40\x01\x20\x02" + bytes(4) if line == "read\n" else b"\0\x20\x2f\x01\x20\x02\x07\0\0\0"
    pass_through(2, 0x1000, (b"\x0a\0\0\0\0\x13" + request).ljust(0x80, b"\0"))
    answer = sdo_of(pass_through(1, 0x1080, bytes(0x80)).data)
    print(answer, flush=True)
