"""A device with an endpoint of every kind: three latches, set over TCP, UDP and a pseudo terminal.

A telegram is one byte. Zero only asks for an answer; any other byte sets the latch of the endpoint on which it came.
The answer is the byte plus one. The plant's own latch, ``clock``, counts seconds.
"""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from pytest_otmcp.mocks.device import Device
from pytest_otmcp.mocks.endpoint import Endpoint, OpenEndpoint
from pytest_otmcp.mocks.fault_plan import FaultRule, Plan
from pytest_otmcp.mocks.fault_rules import Table, integer

__all__ = ["ENDPOINTS", "create", "warm"]

ENDPOINTS = (
    Endpoint(name="stream", kind="tcp"),
    Endpoint(name="datagram", kind="udp"),
    Endpoint(name="line", kind="pty"),
)


def warm() -> None:
    """Do nothing: nothing is slow here."""


def create() -> Latches:
    """Return a device whose latches are 0."""
    return Latches()


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule(FaultRule):
    """The answer that a fault rule gives, as often as it says."""

    answer: int


class FaultPlan(Plan[Rule]):
    """The plan that the rules of the control channel make."""

    table = Table(conditions={}, actions={"answer": integer(0, 255)}, example="{'answer': 7}")
    rule = Rule


class Latches(Device):
    """A device that serves one stream client at a time, any number of senders of datagrams, and the line."""

    protocol = "latches"

    def __init__(self) -> None:
        super().__init__()
        self.latches = {"clock": 0, **{endpoint.name: 0 for endpoint in ENDPOINTS}}
        self.faults = FaultPlan([])
        self.clients = 0

    async def serve(self, endpoints: Mapping[str, OpenEndpoint]) -> None:
        loop = asyncio.get_running_loop()
        for name, endpoint in endpoints.items():
            if isinstance(endpoint, socket.socket) and name == "stream":
                await asyncio.start_server(self._stream, sock=endpoint)
            elif isinstance(endpoint, socket.socket):
                await loop.create_datagram_endpoint(lambda: _Datagrams(self), sock=endpoint)
            else:
                os.set_blocking(endpoint, False)
                loop.add_reader(endpoint, self._line, endpoint)

    def _line(self, master: int) -> None:
        self.execute("line", 0, os.read(master, 4096), lambda answer: os.write(master, answer))

    async def _stream(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.clients += 1
        connection = self.clients
        self.journal.event(connection=connection, direction="in", kind="CONNECTED")
        while data := await reader.read(4096):
            self.execute("stream", connection, data, writer.write)
        self.journal.event(connection=connection, direction="in", kind="DISCONNECTED")
        writer.close()

    def execute(self, endpoint: str, connection: int, telegrams: bytes, answer: Callable[[bytes], Any]) -> None:
        """Execute telegrams and answer each."""
        for telegram in telegrams:
            asked = self.journal.event(
                connection=connection,
                direction="in",
                kind="SET" if telegram else "ASK",
                request=True,
                state_changing=telegram > 0,
                endpoint=endpoint,
                value=telegram,
            )
            if telegram:
                self.latches[endpoint] = telegram
            rule = self.faults.first(lambda rule: True)
            self.journal.event(connection=connection, direction="out", kind="DONE", answers=asked, endpoint=endpoint)
            answer(bytes([telegram + 1 if rule is None else rule.answer]))

    async def aclose(self) -> None:
        """Do nothing: the process ends right after this."""

    def image(self) -> dict[str, Any]:
        return {"points": dict(self.latches)}

    async def poke(self, params: Mapping[str, Any]) -> None:
        if params["latch"] not in self.latches:
            raise ValueError(f"there is no latch {params['latch']!r}")
        self.latches[params["latch"]] = params["value"]

    def fault(self, rules: list[dict[str, Any]]) -> list[int]:
        plan = FaultPlan(rules)
        hits, self.faults = self.faults.hits, plan
        return hits

    async def reset(self) -> None:
        self.latches = dict.fromkeys(self.latches, 0)
        self.faults = FaultPlan([])

    async def tick(self) -> None:
        self.latches["clock"] += 1


class _Datagrams(asyncio.DatagramProtocol):
    def __init__(self, device: Latches) -> None:
        self._device = device

    def connection_made(self, transport: asyncio.DatagramTransport) -> None:  # type: ignore[override]
        self._transport = transport

    def datagram_received(self, data: bytes, address: Any) -> None:
        self._device.execute("datagram", 0, data, lambda answer: self._transport.sendto(answer, address))
