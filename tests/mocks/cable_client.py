"""A client on a cable: it sends each word that it is told as a frame, and prints the word of each frame that it gets.

The word ``lost`` is never answered: one second is enough to see that.
"""

import select
import socket
import sys

with socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(0x88B5)) as end:
    end.bind((sys.argv[1], 0))
    for word in sys.argv[2:]:
        end.send(b"\xff" * 6 + b"\x02" * 6 + b"\x88\xb5" + word.encode().ljust(46, b"\0"))
    wait_s = 1.0 if sys.argv[2:] == ["lost"] else 30.0
    heard: list[str] = []
    while len(heard) < len(sys.argv) - 2 and select.select([end], [], [], wait_s)[0]:
        frame, address = end.recvfrom(2048)
        if address[2] != socket.PACKET_OUTGOING:
            heard.append(frame[14:18].decode())
    print(*heard, sys.argv[1], [name for _, name in socket.if_nameindex()], flush=True)
