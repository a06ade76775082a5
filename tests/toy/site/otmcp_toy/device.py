"""The mock device: ten registers behind TCP and UDP."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Mapping
from typing import Any, cast

from pytest_otmcp.mocks.datagrams import Datagrams
from pytest_otmcp.mocks.endpoint import Endpoint, OpenEndpoint
from pytest_otmcp.mocks.framed_connection import FramedConnection
from pytest_otmcp.mocks.tcp_device import TcpDevice

__all__ = ["ENDPOINTS", "create", "line_length", "parsed", "warm"]

ENDPOINTS = (Endpoint(name="toy", kind="tcp"), Endpoint(name="udp", kind="udp"))
_KINDS = {"R": "read", "W": "write", "V": "value", "K": "written", "E": "error"}


def warm() -> None:
    """Do nothing: nothing is slow here."""


def parsed(line: bytes) -> dict[str, Any]:
    """Return the kind of a line, and the numbers that it names."""
    letter, *numbers = line.decode("ascii", "replace").split() or [""]
    kind = _KINDS.get(letter, "malformed")
    named = dict(zip(("address", "value"), map(int, numbers), strict=False))
    return {"kind": kind, **named, "request": kind in ("read", "write"), "state_changing": kind == "write"}


def line_length(buffer: bytes | bytearray) -> int | None:
    """Return the length of the line at the beginning of the buffer; None while its end has not come."""
    return buffer.find(b"\n") + 1 or None


class ToyDevice(TcpDevice):
    """The toy device: it answers ``E`` to an address that does not exist."""

    protocol = "toy"

    def __init__(self) -> None:
        super().__init__()
        self.registers = [0] * 10

    def connection(self) -> asyncio.Protocol:
        return _Connection(self, line_length)

    async def serve(self, endpoints: Mapping[str, OpenEndpoint]) -> None:
        await super().serve(endpoints)
        await asyncio.get_running_loop().create_datagram_endpoint(
            lambda: Datagrams(self.journal, self.answer), sock=cast(socket.socket, endpoints["udp"])
        )

    def image(self) -> dict[str, Any]:
        return {"points": {str(address): value for address, value in enumerate(self.registers)}}

    async def poke(self, params: Mapping[str, Any]) -> None:
        self.registers[params["address"]] = params["value"]

    def fault(self, rules: list[dict[str, Any]]) -> list[int]:
        return []

    async def reset(self) -> None:
        self.registers = [0] * 10

    async def tick(self) -> None:
        """Do nothing: no register changes by itself."""

    def answer(self, connection: int, line: bytes, send: Callable[[bytes], None]) -> None:
        """Do what a line asks for, and answer it."""
        fields = parsed(line)
        asked = self.journal.frame(line, connection=connection, direction="in")
        address, reply = fields.get("address", -1), b"E\n"
        if fields["request"] and 0 <= address < len(self.registers):
            self.registers[address] = fields.get("value", self.registers[address])
            letter = "K" if fields["kind"] == "write" else "V"
            reply = f"{letter} {address} {self.registers[address]}\n".encode()
        self.journal.frame(reply, connection=connection, direction="out", answers=asked)
        send(reply)


class _Connection(FramedConnection[ToyDevice]):
    def frame(self, raw: bytes) -> None:
        self.device.answer(self.number, raw, self.transport.write)


create = ToyDevice
