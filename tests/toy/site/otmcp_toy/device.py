"""The mock device: ten registers behind TCP or UDP."""

from __future__ import annotations

import asyncio
import itertools
import socket
from collections.abc import Callable, Mapping
from typing import Any, cast

from pytest_otmcp.mocks.device import Device
from pytest_otmcp.mocks.endpoint import OpenEndpoint
from pytest_otmcp.mocks.peer import holder, process_of, socket_of

from otmcp_toy.wire import parsed

__all__ = ["ToyDevice"]

_REGISTERS = 10


class ToyDevice(Device):
    """The toy device: it serves on all its endpoints, and answers ``E`` to an address that does not exist."""

    protocol = "toy"

    def __init__(self) -> None:
        super().__init__()
        self.registers = [0] * _REGISTERS
        self.acknowledge_only = False
        self.connections = itertools.count(1)

    async def serve(self, endpoints: Mapping[str, OpenEndpoint]) -> None:
        loop = asyncio.get_running_loop()
        for opened in endpoints.values():
            listener = cast(socket.socket, opened)
            if listener.type == socket.SOCK_STREAM:
                await loop.create_server(lambda: _Stream(self), sock=listener)
            else:
                await loop.create_datagram_endpoint(lambda: _Datagrams(self), sock=listener)

    async def aclose(self) -> None:
        """Do nothing: the process ends right after this."""

    def image(self) -> dict[str, Any]:
        return {"points": {str(address): value for address, value in enumerate(self.registers)}}

    async def poke(self, params: Mapping[str, Any]) -> None:
        self.registers[params["address"]] = params["value"]

    def fault(self, rules: list[dict[str, Any]]) -> list[int]:
        self.acknowledge_only = any(rule["action"] == "acknowledge" for rule in rules)
        return []

    async def reset(self) -> None:
        self.registers = [0] * _REGISTERS
        self.acknowledge_only = False

    async def tick(self) -> None:
        """Do nothing: no register changes by itself."""

    def answer(self, connection: int, line: bytes, send: Callable[[bytes], None]) -> None:
        """Do what a line asks for, and answer it."""
        fields = parsed(line)
        asked = self.journal.frame(line, connection=connection, direction="in")
        address, reply = fields.get("address", -1), b"E\n"
        if fields["request"] and 0 <= address < _REGISTERS:
            if fields["kind"] == "write" and not self.acknowledge_only:
                self.registers[address] = fields["value"]
            shown = fields.get("value", self.registers[address])
            reply = f"{'K' if fields['kind'] == 'write' else 'V'} {address} {shown}\n".encode()
        self.journal.frame(reply, connection=connection, direction="out", answers=asked)
        send(reply)


class _Stream(asyncio.Protocol):
    def __init__(self, device: ToyDevice) -> None:
        self._device = device
        self._number = next(device.connections)
        self._buffer = b""
        self._transport: asyncio.Transport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        self._device.journal.connected(self._number, process_of(transport))

    def connection_lost(self, exc: Exception | None) -> None:
        self._device.journal.event(connection=self._number, direction="in", kind="DISCONNECTED")

    def data_received(self, data: bytes) -> None:
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        for line in lines:
            self._device.answer(self._number, line, self._transport.write)


class _Datagrams(asyncio.DatagramProtocol):
    def __init__(self, device: ToyDevice) -> None:
        self._device = device
        self._clients: dict[tuple[Any, int], int] = {}
        self._transport: asyncio.DatagramTransport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, addr: Any) -> None:
        own = self._transport.get_extra_info("sockname")
        client = socket_of(own, addr)
        number = self._clients.get((addr, client))
        if number is None:
            number = self._clients[addr, client] = next(self._device.connections)
            self._device.journal.heard_of(number, holder(client))
        self._device.answer(number, data, lambda reply: self._transport.sendto(reply, addr))
