"""Another program on the machine, which speaks to devices that are none of its business: ``python scanner.py WHAT PAUSE_S PORT...``.

It goes on until its standard input ends, from port to port, with a pause between the rounds. After the first round it says so.
"""

from __future__ import annotations

import contextlib
import selectors
import socket
import sys
from collections.abc import Callable
from pathlib import Path

PATIENCE_S = 2.0
STAYS_S = 0.3


def utf8(text: str) -> bytes:
    return len(text).to_bytes(2) + text.encode()


def packet(first: int, content: bytes = b"") -> bytes:
    return bytes([first, len(content)]) + content


CONNECT = packet(0x10, utf8("MQTT") + b"\4\2\0\0" + utf8("stranger"))
PING = packet(0xC0)


def asked(port: int, *requests: bytes) -> None:
    """Send one request after the other, each when the one before it has been answered."""
    with socket.create_connection(("127.0.0.1", port), PATIENCE_S) as connection:
        for request in requests:
            connection.sendall(request)
            connection.recv(4096)


def modbus(pdu: str) -> bytes:
    body = bytes.fromhex(pdu)
    return b"\0\1\0\0" + (len(body) + 1).to_bytes(2) + b"\1" + body


def http(port: int) -> None:
    asked(port, b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")


def http_and_gone(port: int) -> None:
    """Be gone before anybody can find out who it was."""
    with socket.create_connection(("127.0.0.1", port), PATIENCE_S) as connection:
        connection.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")


def silence(port: int) -> None:
    stay(port, b"")


def stay(port: int, begin: bytes) -> None:
    """Send the beginning of something and wait for a while what comes."""
    with socket.create_connection(("127.0.0.1", port), PATIENCE_S) as connection:
        connection.sendall(begin)
        connection.settimeout(STAYS_S)
        with contextlib.suppress(TimeoutError):
            connection.recv(4096)


def half_a_handshake(port: int) -> None:
    # The beginning of what each of the three protocols begins with.
    for begin in (b"\0\1\0\0\0\6\1", CONNECT[:9], b"HELF\x30\0\0\0"):
        stay(port, begin)


def modbus_read(port: int) -> None:
    asked(port, modbus("04 0000 0004"), modbus("03 0001 0001"))


def modbus_refused_write(port: int) -> None:
    """Write to registers that the device does not have."""
    asked(port, modbus("06 270F 0007"))


def modbus_write(port: int) -> None:
    asked(port, modbus("06 0001 0028"))


def mqtt_exchange(port: int) -> None:
    asked(port, CONNECT, PING, PING)


def mqtt_publish(port: int) -> None:
    asked(port, CONNECT, packet(0x30, utf8("control/pump") + b"stop") + PING)


def mqtt_retain(port: int) -> None:
    asked(port, CONNECT, packet(0x31, utf8("control/pump") + b"stop") + PING)


def opcua_read(port: int) -> None:
    from asyncua.sync import Client  # type: ignore[attr-defined]

    with Client(f"opc.tcp://127.0.0.1:{port}", timeout=PATIENCE_S) as client:
        client.get_node("ns=2;s=Temperature").read_value()


def opcua_write(port: int) -> None:
    from asyncua.sync import Client  # type: ignore[attr-defined]

    with Client(f"opc.tcp://127.0.0.1:{port}", timeout=PATIENCE_S) as client:
        client.get_node("ns=2;s=FanSpeed").write_value(55.0)


def opcua_refused_write(port: int) -> None:
    from asyncua import ua
    from asyncua.sync import Client  # type: ignore[attr-defined]

    with Client(f"opc.tcp://127.0.0.1:{port}", timeout=PATIENCE_S) as client, contextlib.suppress(ua.UaError):
        client.get_node("ns=2;s=Temperature").write_value("hot")


KINDS: dict[str, Callable[[int], None]] = {
    function.__name__.replace("_", "-"): function
    for function in (
        *(http, http_and_gone, silence, half_a_handshake, modbus_read, modbus_refused_write, modbus_write),
        *(mqtt_exchange, mqtt_publish, mqtt_retain, opcua_read, opcua_write, opcua_refused_write),
    )
}


def main() -> None:
    what, pause_s, *ports = sys.argv[1:]
    # What the kernel calls it, in 15 letters.
    Path("/proc/self/comm").write_text(what)
    ended = selectors.DefaultSelector()
    ended.register(sys.stdin, selectors.EVENT_READ)
    said = False
    while not ended.select(float(pause_s)):
        for port in map(int, ports):
            # A device may be down just now, and need not like what it is asked.
            with contextlib.suppress(OSError, TimeoutError):
                KINDS[what](port)
        if not said:
            said = True
            print("scanned", flush=True)


if __name__ == "__main__":
    main()
