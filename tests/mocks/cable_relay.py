"""A packet socket on a cable: each line of hexadecimal digits on standard input is sent as a frame, each frame that comes is printed so."""

import os
import select
import socket
import sys

with socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(int(sys.argv[2], 16))) as end:
    end.bind((sys.argv[1], 0))
    print(end.getsockname()[4].hex(), flush=True)
    rest = b""
    while True:
        for one in select.select([end, sys.stdin], [], [])[0]:
            if one is end:
                frame, address = end.recvfrom(2048)
                if address[2] != socket.PACKET_OUTGOING:
                    print(frame.hex(), flush=True)
                continue
            told = os.read(sys.stdin.fileno(), 65536)
            if not told:
                sys.exit()
            *lines, rest = (rest + told).split(b"\n")
            for line in lines:
                end.send(bytes.fromhex(line.decode()))
