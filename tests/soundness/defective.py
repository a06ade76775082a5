"""Reference adapters with one defect each: run as ``python defective.py NAME``.

A defect is a small function that takes the built server and changes one thing. It may use the private members of the
server: nothing else in the project may.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from typing import Any

from pytest_otmcp.reference_adapters.core import AdapterError, AdapterServer, Call
from pytest_otmcp.reference_adapters.core import server as core_server
from pytest_otmcp.reference_adapters.core.run import serve

Handler = Callable[[Call, Any], Any]


def wrap(server: AdapterServer, name: str, handler: Callable[[Handler], Handler], **changes: Any) -> None:
    """Replace a tool's handler by one that is made from the original."""
    tool = server._tools[name]
    server._tools[name] = replace(tool, handler=handler(tool.handler), **changes)


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


def lying_guard(name: str) -> Callable[[AdapterServer], None]:
    """Return a defect: the tool writes, and then says that writes are disabled."""

    def bend(server: AdapterServer) -> None:
        tool = server._tools[name]
        enabled = server.writes_enabled

        async def handler(call: Call, arguments: Any) -> dict[str, Any]:
            data: dict[str, Any] = await tool.handler(call, arguments)
            if enabled:
                return data
            raise AdapterError("writes_disabled", "writes are disabled", outcome="not_sent")

        server._tools[name] = replace(tool, handler=handler, writes=False)

    return bend


def write_not_sent(server: AdapterServer) -> None:
    """Say that the value was written, write nothing, and serve the value from memory when it is read back."""
    claimed: dict[int, int] = {}

    async def write(call: Call, arguments: Any) -> dict[str, Any]:
        claimed[arguments.address] = arguments.value
        return {"address": arguments.address, "value": arguments.value}

    def read(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> dict[str, Any]:
            data: dict[str, Any] = await genuine(call, arguments)
            data["values"][0] = claimed.get(arguments.address, data["values"][0])
            return data

        return handler

    wrap(server, "write_register", lambda genuine: write)
    wrap(server, "read_multiple_holding_registers", read)


def write_sent_twice(server: AdapterServer) -> None:
    def twice(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> dict[str, Any]:
            await genuine(call, arguments)
            data: dict[str, Any] = await genuine(call, arguments)
            return data

        return handler

    wrap(server, "write_register", twice)


def never_reconnects(server: AdapterServer) -> None:
    """Never connect again after the first lost connection."""
    lost = False

    def once(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> dict[str, Any]:
            nonlocal lost
            if lost:
                raise AdapterError("connect_failed", "the connection is gone", outcome="not_sent")
            try:
                data: dict[str, Any] = await genuine(call, arguments)
            except AdapterError as error:
                lost = error.code in ("connect_failed", "connection_lost")
                raise
            return data

        return handler

    for name in list(server._tools):
        wrap(server, name, once)


def hang(server: AdapterServer) -> None:
    """Never answer a read, and take the deadline away."""

    async def handler(call: Call, arguments: Any) -> dict[str, Any]:
        await asyncio.Event().wait()
        return {}

    server._deadline_s = 3600.0
    wrap(server, "read_input_registers", lambda genuine: handler)


def stdout_noise(server: AdapterServer) -> None:
    print("Connected to Modbus device", flush=True)


def wrong_value(server: AdapterServer) -> None:
    def off(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> dict[str, Any]:
            data: dict[str, Any] = await genuine(call, arguments)
            data["values"] = [(value + 1) % 65536 for value in data["values"]]
            return data

        return handler

    wrap(server, "read_input_registers", off)


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


def truncates_overflow(server: AdapterServer) -> None:
    """Write 70000 as 4464, and call that a success."""
    tool = server._tools["write_register"]
    bare = type("Anything", (tool.model,), {"__annotations__": {"value": int}, "__module__": __name__})

    def cut(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> dict[str, Any]:
            value = arguments.value
            sent = tool.model(address=arguments.address, value=value & 0xFFFF)
            await genuine(call, sent)
            return {"address": arguments.address, "value": value}

        return handler

    wrap(server, "write_register", cut, model=bare)


def is_error_never_set(server: AdapterServer) -> None:
    genuine = core_server._result

    def result(envelope: dict[str, Any]) -> dict[str, Any]:
        return {**genuine(envelope), "isError": False}

    core_server._result = result


def error_is_a_word(server: AdapterServer) -> None:
    """Reduce the envelope's error to its code alone, as adapters in the wild do."""
    genuine = core_server._result

    def result(envelope: dict[str, Any]) -> dict[str, Any]:
        error = envelope["error"]
        return genuine({**envelope, "error": error and error["code"]})

    core_server._result = result


# -- MQTT -----------------------------------------------------------------------------------------------------


def cached_status(server: AdapterServer) -> None:
    """Answer broker info from memory after the first time."""

    def cached(genuine: Handler) -> Handler:
        memory: dict[str, Any] = {}

        async def handler(call: Call, arguments: Any) -> dict[str, Any]:
            if not memory:
                memory.update(await genuine(call, arguments))
            return memory

        return handler

    wrap(server, "get_broker_info", cached)


def clamps_qos(server: AdapterServer) -> None:
    tool = server._tools["subscribe_topic"]
    bare = type("Anything", (tool.model,), {"__annotations__": {"qos": int}, "__module__": __name__})

    def clamp(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> dict[str, Any]:
            data: dict[str, Any] = await genuine(call, tool.model(topic=arguments.topic, qos=min(arguments.qos, 2)))
            return data

        return handler

    wrap(server, "subscribe_topic", clamp, model=bare)


def publish_not_sent(server: AdapterServer) -> None:
    async def handler(call: Call, arguments: Any) -> dict[str, Any]:
        return {"topic": arguments.topic, "qos": 0, "retain": False, "payload_bytes": 1, "delivery": "unacknowledged"}

    def unless_invalid(genuine: Handler) -> Handler:
        async def choose(call: Call, arguments: Any) -> dict[str, Any]:
            chosen = handler if arguments.topic else genuine
            data: dict[str, Any] = await chosen(call, arguments)
            return data

        return choose

    wrap(server, "publish_message", unless_invalid)


# -- OPC UA ---------------------------------------------------------------------------------------------------


def incomplete_enumeration(server: AdapterServer) -> None:
    def short(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> dict[str, Any]:
            data: dict[str, Any] = await genuine(call, arguments)
            data["variables"].pop()
            return data

        return handler

    wrap(server, "get_all_variables", short)


def bad_code(server: AdapterServer) -> None:
    """Report illegal_address as protocol_error."""

    def collapsed(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> dict[str, Any]:
            try:
                data: dict[str, Any] = await genuine(call, arguments)
            except AdapterError as error:
                if error.code == "illegal_address":
                    raise AdapterError("protocol_error", "something went wrong") from None
                raise
            return data

        return handler

    wrap(server, "read_opcua_node", collapsed)


DEFECTS: dict[str, tuple[str, Callable[[AdapterServer], None]]] = {
    "unknown-tool": ("modbus", unknown_tool),
    "traceback-as-text": ("modbus", traceback_as_text),
    "lying-guard": ("modbus", lying_guard("write_register")),
    "write-not-sent": ("modbus", write_not_sent),
    "write-sent-twice": ("modbus", write_sent_twice),
    "never-reconnects": ("modbus", never_reconnects),
    "hang": ("modbus", hang),
    "stdout-noise": ("modbus", stdout_noise),
    "wrong-value": ("modbus", wrong_value),
    "swapped-parallel-replies": ("modbus", swapped_parallel_replies),
    "truncates-overflow": ("modbus", truncates_overflow),
    "is-error-never-set": ("modbus", is_error_never_set),
    "error-is-a-word": ("modbus", error_is_a_word),
    "lying-guard-mqtt": ("mqtt", lying_guard("publish_message")),
    "cached-status": ("mqtt", cached_status),
    "clamps-qos": ("mqtt", clamps_qos),
    "publish-not-sent": ("mqtt", publish_not_sent),
    "lying-guard-opcua": ("opcua", lying_guard("write_opcua_node")),
    "incomplete-enumeration": ("opcua", incomplete_enumeration),
    "bad-code": ("opcua", bad_code),
    "none": ("modbus", lambda server: None),
}


def main() -> None:
    protocol, bend = DEFECTS[sys.argv[1]]
    server = import_module(f"pytest_otmcp.reference_adapters.{protocol}").build()
    bend(server)
    sys.exit(serve(server))


if __name__ == "__main__":
    main()
