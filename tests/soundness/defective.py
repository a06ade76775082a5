"""Reference adapters with one defect each that is not in the catalogue: run as ``python defective.py NAME``.

A defect is a small function that takes the built server and changes one thing. It may use the private members of the
server: nothing else in the project may.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import sys
from collections.abc import Callable
from importlib import import_module
from typing import Any

from pytest_otmcp.reference_adapters.core import AdapterServer, Call
from pytest_otmcp.reference_adapters.core import server as core_server
from pytest_otmcp.reference_adapters.core.run import serve
from pytest_otmcp.reference_adapters.defects.defect import Handler, wrap

# -- Modbus ---------------------------------------------------------------------------------------------------


def unknown_tool(server: AdapterServer) -> None:
    del server._tools["ping"]


def traceback_as_text(server: AdapterServer) -> None:
    """Answer a failure with prose and a traceback instead of an envelope."""
    genuine = core_server._result

    def result(envelope: dict[str, Any]) -> dict[str, Any]:
        if envelope["success"]:
            return genuine(envelope)
        text = 'Traceback (most recent call last):\n  File "adapter.py", line 1\nModbusIOException'
        return {"content": [{"type": "text", "text": text}], "isError": True}

    core_server._result = result


def write_sent_twice(server: AdapterServer) -> None:
    def twice(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> dict[str, Any]:
            await genuine(call, arguments)
            data: dict[str, Any] = await genuine(call, arguments)
            return data

        return handler

    wrap(server, "write_register", twice)


def hang(server: AdapterServer) -> None:
    """Never answer a read, and take the deadline away."""

    async def handler(call: Call, arguments: Any) -> dict[str, Any]:
        await asyncio.Event().wait()
        return {}

    server._deadline_s = 3600.0
    wrap(server, "read_input_registers", lambda genuine: handler)


def wrong_value(server: AdapterServer) -> None:
    def off(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> dict[str, Any]:
            data: dict[str, Any] = await genuine(call, arguments)
            data["values"] = [(value + 1) % 65536 for value in data["values"]]
            return data

        return handler

    wrap(server, "read_input_registers", off)


def wrong_at_first(server: AdapterServer) -> None:
    """Only the first answer of the process is wrong, as that of a buffer that has not been filled yet."""
    answered: list[bool] = []

    def off(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> dict[str, Any]:
            data: dict[str, Any] = await genuine(call, arguments)
            if not answered:
                data["values"] = [0] * len(data["values"])
            answered.append(True)
            return data

        return handler

    wrap(server, "read_input_registers", off)


def demo_without_a_device(server: AdapterServer) -> None:
    """Invent values for ever if there is no device at the start."""
    host, _, port = server.endpoint.partition("://")[2].rpartition(":")
    with contextlib.suppress(OSError), socket.create_connection((host, int(port))):
        return

    async def read(call: Call, arguments: Any) -> dict[str, Any]:
        return {"address": arguments.address, "count": arguments.count, "values": [0] * arguments.count}

    wrap(server, "read_input_registers", lambda genuine: read)


def ping_that_only_connects(server: AdapterServer) -> None:
    """Take an accepted connection, which is closed at once, for an answer of the device."""

    async def ping(call: Call, arguments: Any) -> dict[str, Any]:
        _, connection = await asyncio.open_connection(os.environ["MODBUS_HOST"], int(os.environ["MODBUS_PORT"]))
        connection.close()
        await connection.wait_closed()
        return {"reachable": True}

    wrap(server, "ping", lambda genuine: ping)


def swapped_parallel_replies(server: AdapterServer) -> None:
    """Swap the answers of two reads of the registers 10 to 13 that are made at the same time."""

    def swapped(genuine: Handler) -> Handler:
        waiting: list[tuple[asyncio.Future[Any], Any]] = []

        async def handler(call: Call, arguments: Any) -> Any:
            data = await genuine(call, arguments)
            if arguments.count != 1 or arguments.address not in range(10, 14):
                return data
            if waiting:
                other, others_data = waiting.pop()
                other.set_result(data)
                return others_data
            answer: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
            waiting.append((answer, data))
            # On a busy machine it takes a while until the adapter has read the request that was sent at the same time.
            with contextlib.suppress(TimeoutError):
                return await asyncio.wait_for(answer, 2.0)
            waiting.clear()
            return data

        return handler

    wrap(server, "read_input_registers", swapped)


# -- MQTT -----------------------------------------------------------------------------------------------------


# -- OPC UA ---------------------------------------------------------------------------------------------------


def incomplete_enumeration(server: AdapterServer) -> None:
    def short(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> dict[str, Any]:
            data: dict[str, Any] = await genuine(call, arguments)
            data["variables"].pop()
            return data

        return handler

    wrap(server, "get_all_variables", short)


DEFECTS: dict[str, tuple[str, Callable[[AdapterServer], None]]] = {
    "unknown-tool": ("modbus", unknown_tool),
    "traceback-as-text": ("modbus", traceback_as_text),
    "write-sent-twice": ("modbus", write_sent_twice),
    "hang": ("modbus", hang),
    "wrong-value": ("modbus", wrong_value),
    "wrong-at-first": ("modbus", wrong_at_first),
    "demo-without-a-device": ("modbus", demo_without_a_device),
    "ping-that-only-connects": ("modbus", ping_that_only_connects),
    "swapped-parallel-replies": ("modbus", swapped_parallel_replies),
    "incomplete-enumeration": ("opcua", incomplete_enumeration),
    "none": ("modbus", lambda server: None),
}


def main() -> None:
    protocol, bend = DEFECTS[sys.argv[1]]
    server = import_module(f"pytest_otmcp.reference_adapters.{protocol}").build()
    bend(server)
    sys.exit(serve(server))


if __name__ == "__main__":
    main()
