"""Defects that the checks of the area RES notice."""

from __future__ import annotations

import contextlib
import socket
import time
from typing import Any

from ...core import AdapterServer, Call
from ...core import server as core_server
from ...mqtt import nodes, sparkplug_tools
from ..life import address_of
from ..mutant import Data, Handler, Mutant, each, failing
from ..refusals import _end

__all__ = ["MUTANTS"]


def keeps_every_answer(server: AdapterServer) -> None:
    kept: list[object] = []

    def keeping(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            data: Data = await genuine(call, arguments)
            kept.append((data, bytearray(b"\1" * 400_000)))
            return data

        return handler

    each(change=keeping)(server)


def keeps_a_socket_of_every_failure(server: AdapterServer) -> None:
    held = []

    def failing_openly(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            try:
                data: Data = await genuine(call, arguments)
            except Exception:
                probe = socket.socket()
                held.append(probe)
                with contextlib.suppress(OSError):
                    probe.connect(address_of(server))
                raise
            return data

        return handler

    each(change=failing_openly)(server)


def takes_every_call(server: AdapterServer) -> None:
    core_server.MOST_CALLS = 10**9


def decodes_without_end(server: AdapterServer) -> None:
    genuine = nodes.decode

    def decode(data: bytes, *others: Any) -> Any:
        while data.startswith(b"\xff" * 10):
            # An integer whose last byte never comes.
            time.sleep(1.0)
        return genuine(data, *others)

    nodes.decode = sparkplug_tools.decode = decode


MUTANTS: tuple[Mutant, ...] = (
    Mutant(
        id="MU-75b",
        protocol="mqtt",
        sentence="An integer in a Sparkplug payload whose last byte never comes is decoded for ever.",
        bend=decodes_without_end,
        items="RES-003.mqtt",
        requirements="TMO-001",
        areas="res",
    ),
    Mutant(
        id="MU-89b",
        protocol="modbus",
        sentence="Everything that was answered is kept.",
        bend=keeps_every_answer,
        items="RES-001.modbus",
        requirements="RES-001",
        areas="res",
        cold=True,
    ),
    Mutant(
        id="MU-90b",
        protocol="modbus",
        sentence="Every failure leaves a connection open.",
        bend=keeps_a_socket_of_every_failure,
        items="RES-001.modbus RES-003.modbus",
        requirements="CON-006 RES-001",
        areas="res",
        cold=True,
    ),
    Mutant(
        id="MU-91",
        protocol="modbus",
        sentence="However many calls there are, every one waits for the device.",
        bend=takes_every_call,
        items="RES-004.modbus",
        requirements="RES-004",
        areas="res",
    ),
    Mutant(
        id="MU-93c",
        protocol="modbus",
        sentence="An answer that does not belong to its request ends the adapter.",
        bend=failing(change=_end),
        items="RES-003.modbus",
        requirements="MCP-007",
        areas="res",
    ),
)
