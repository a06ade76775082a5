"""Three Modbus adapters of foreign shape, and their lies.

``modbus-prose``: sentences, ``isError`` never set, addresses as on paper (40001), one tool for one register and one for
several; read-only by leaving the writing tool out.
``modbus-json``: JSON in a text, ``isError`` never set, host and port in every call, addresses from one; refuses in words.
``modbus-http``: structured content over streamable HTTP, ``isError`` set, often without a text.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from foreign import Failure, Result, Shape, json_text, no_such_method, prose, structured
from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ModbusException

READS = {
    "coils": "read_coils",
    "discrete": "read_discrete_inputs",
    "input": "read_input_registers",
    "holding": "read_holding_registers",
}


READS_OF_S10 = 2
"""The number of reads that S10 makes after its write has failed."""


async def transact(host: str, port: int, ask: Callable[[AsyncModbusTcpClient], Awaitable[Any]]) -> Any:
    client = AsyncModbusTcpClient(host, port=port, timeout=4.0, retries=0, reconnect_delay=0)
    try:
        if not await client.connect():
            raise Failure("offline", f"could not connect to {host}:{port}")
        answer = await ask(client)
    except ModbusException as error:
        raise Failure("offline", f"no answer: {error}") from None
    finally:
        client.close()
    if answer.isError():
        raise Failure("exception", f"the device answered with exception 0x{answer.exception_code:02X}")
    return answer


async def read(host: str, port: int, table: str, address: int, count: int) -> list[int | bool]:
    answer = await transact(host, port, lambda client: getattr(client, READS[table])(address, count=count))
    return list((answer.bits if table in ("coils", "discrete") else answer.registers)[:count])


async def write(host: str, port: int, address: int, value: int) -> None:
    if type(value) is not int or not 0 <= value <= 65535:
        raise Failure("range", f"{value} is not in 0..65535")
    await transact(host, port, lambda client: client.write_register(address, value))


def endpoint() -> tuple[str, int]:
    return os.environ["PLC_HOST"], int(os.environ["PLC_PORT"])


# -- prose ------------------------------------------------------------------------------------------------------------


CONNECTS_FOR_S = {"in-the-background": 0.5, "never-ready": math.inf}
"""Seconds after its start for which the prose adapter says that it is still connecting."""


def modbus_prose(lie: str | None, read_only: bool) -> Shape:
    connected_at = time.monotonic() + CONNECTS_FOR_S.get(lie or "", 0.0)

    connected = lie != "connects-by-a-step"

    def must_be_connected() -> None:
        if time.monotonic() < connected_at:
            raise Failure("offline", "not connected: still connecting")
        if not connected:
            raise Failure("offline", "could not connect: nobody has called 'connect'")

    async def connect() -> Result:
        nonlocal connected
        try:
            await read(*endpoint(), "holding", 0, 1)
        except Failure as failure:
            return prose(f"Error: {failure}")
        connected = True
        return prose("connected")

    async def status() -> Result:
        try:
            must_be_connected()
            await read(*endpoint(), "holding", 0, 1)
        except Failure as failure:
            return prose(f"state: {'connecting' if 'connecting' in str(failure) else 'disconnected'}")
        return prose("state: connected")

    async def fetch(number: int, count: int) -> list[int | bool]:
        must_be_connected()
        tables = {3: "input", 4: "holding", 1: "discrete", 0: "coils"}
        digit, offset = divmod(number, 10_000)
        if lie == "wrong-table" and digit == 3:
            digit = 4
        if lie == "forgives-offset" and number < 10_000:
            # As modbus-mcp does: a number that is no number of a register is taken for the number of a coil.
            return await read(*endpoint(), "coils", number, count)
        if digit not in tables or offset < 1:
            raise Failure("range", f"there is no register {number}")
        return await read(*endpoint(), tables[digit], offset - 1, count)

    def demo(sentence: str) -> Result:
        return prose(f"{sentence} (Demo Mode - No Modbus Connection)")

    async def read_one(address: int) -> Result:
        if lie == "demo-mode":
            return demo(f"Register {address} = 110")
        try:
            (value,) = await fetch(address, 1)
        except Failure as failure:
            return prose(f"Error: {failure}")
        return prose(f"Register {address} = {value}")

    async def read_many(first: int, quantity: int) -> Result:
        if lie == "demo-mode":
            return demo(f"Registers from {first}: 250, 150, 60, 500")
        try:
            values = await fetch(first, quantity)
        except Failure as failure:
            return prose(f"Error: {failure}")
        return prose(f"Registers from {first}: {', '.join(map(str, values))}")

    async def write_register(address: int, value: int) -> Result:
        if lie == "demo-mode":
            return demo(f"Successfully wrote {value} to register {address}")
        if lie == "partial-write" and value > 65535:
            await write(*endpoint(), address - 40_001, value & 0xFFFF)
            return prose(f"Error: the high word of {value} could not be written")
        try:
            must_be_connected()
            await write(*endpoint(), address - 40_001, value)
        except Failure as failure:
            return prose(f"Error: {failure}")
        if lie == "guard-in-words" and read_only:
            return prose("Error: the adapter is in read-only mode")
        if lie == "reads-back":
            held = await read_many(address, 1)
            return prose(f"{held['content'][0]['text']}. Successfully wrote {value} to register {address}")
        return prose(f"Successfully wrote {value} to register {address}")

    tools: dict[str, Any] = {
        "read_one": ({"address": "integer"}, read_one),
        "read_many": ({"first": "integer", "quantity": "integer"}, read_many),
    }
    if lie == "connects-by-a-step":
        tools["connect"] = ({}, connect)
    if lie in CONNECTS_FOR_S:
        tools["connection_status"] = ({}, status)
    if not read_only or lie in ("guard-in-words", "guard-by-hiding"):
        tools["write_register"] = ({"address": "integer", "value": "integer"}, write_register)
    return Shape(tools=tools, unlisted=("write_register",) if read_only and lie == "guard-by-hiding" else ())


# -- JSON in a text ---------------------------------------------------------------------------------------------------


def modbus_json(lie: str | None, read_only: bool) -> Shape:
    memory: dict[tuple[str, int, int], list[int | bool]] = {}
    later: set[asyncio.Task[None]] = set()
    # Writes that were reported as failed, and the number of reads that have succeeded since.
    kept: list[tuple[int, int]] = []
    reads = 0

    def bad(failure: Failure) -> Result:
        return json_text({"ok": False, "error": {"kind": failure.kind, "detail": str(failure)}})

    async def probe(host: str, port: int) -> Result:
        try:
            await read(host, port, "holding", 0, 1)
        except Failure as failure:
            return bad(failure)
        return json_text({"ok": True, "data": {"alive": True}})

    async def read_block(host: str, port: int, table: str, start: int, length: int = 1) -> Result:
        nonlocal reads
        key = (table, start, length)
        if lie == "silent-cache" and key in memory:
            return json_text({"ok": True, "data": {"values": memory[key]}})
        try:
            memory[key] = await read(host, port, table, start - 1, length)
        except Failure as failure:
            if lie == "cache" and failure.kind == "offline" and key in memory:
                return json_text({"ok": True, "data": {"values": memory[key]}, "source": "cache"})
            return bad(failure)
        if kept:
            reads += 1
            if lie == "makes-up-late" and reads == READS_OF_S10 + 1:
                await write(host, port, *kept.pop())
            if lie == "makes-up-between-items" and reads == READS_OF_S10:
                later.add(asyncio.create_task(write_when_told(host, port)))
        values = [math.nan] if lie == "not-a-number" and table == "input" else memory[key]
        return json_text({"ok": True, "data": {"values": values}})

    async def write_point(host: str, port: int, start: int, value: int) -> Result:
        if read_only:
            if lie == "applied-later":
                later.add(asyncio.create_task(write_soon(host, port, start, value)))
            return bad(Failure("read_only", "started with --read-only"))
        if lie == "dry-run":
            return json_text({"ok": True, "dry_run": True, "data": {"written": value}})
        if lie == "clamps-value":
            value = min(value, 65535)
        if lie == "applied-late":
            if value > 65535:
                kept.append((start - 1, value % 65536))
            else:
                while kept:
                    await write(host, port, *kept.pop())
        try:
            await write(host, port, start - 1, value)
        except Failure as failure:
            if lie == "makes-up-for-it" and failure.kind == "offline":
                later.add(asyncio.create_task(write_soon(host, port, start, value)))
            if lie in ("makes-up-late", "makes-up-between-items") and failure.kind == "offline":
                kept.append((start - 1, value))
            return bad(failure)
        return json_text({"ok": True, "data": {"written": value}})

    async def write_soon(host: str, port: int, start: int, value: int) -> None:
        while True:
            with contextlib.suppress(Failure):
                return await write(host, port, start - 1, value)
            await asyncio.sleep(0.005)

    async def write_when_told(host: str, port: int) -> None:
        # The file is a FIFO: it can be read as soon as the test writes to it.
        await asyncio.to_thread(Path(os.environ["FOREIGN_TRIGGER"]).read_bytes)
        await write(host, port, *kept.pop())

    where = {"host": "string", "port": "integer"}
    return Shape(
        tools={
            "probe": (where, probe),
            "read_block": (where | {"table": "string", "start": "integer", "length": "integer"}, read_block),
            "write_point": (where | {"start": "integer", "value": "integer"}, write_point),
        },
        open_arguments=True,
    )


# -- HTTP -------------------------------------------------------------------------------------------------------------


def modbus_http(lie: str | None, read_only: bool) -> Shape:
    def bad(failure: Failure) -> Result:
        # Many servers answer with an error without a text when the exception has none.
        return prose("" if failure.kind == "offline" else f"{failure.kind}: {failure}", is_error=True)

    async def registers(table: str, address: int, count: int) -> Result:
        try:
            values = await read(*endpoint(), table, address + (lie == "reads-neighbour"), count)
        except Failure as failure:
            return bad(failure)
        return structured({"registers": values})

    async def set_register(address: int, value: int) -> Result:
        try:
            await write(*endpoint(), address, value)
        except Failure as failure:
            return bad(failure)
        return structured({"result": "done"})

    tools: dict[str, Any] = {"registers": ({"table": "string", "address": "integer", "count": "integer"}, registers)}
    if not read_only:
        tools["set_register"] = ({"address": "integer", "value": "integer"}, set_register)
    return Shape(tools=tools, unknown=no_such_method, served="http")
