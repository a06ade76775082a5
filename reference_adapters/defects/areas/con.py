"""Defects that the checks of the area CON notice."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import struct
from typing import Any

from ...core import AdapterError, AdapterServer, Call
from ...modbus.codec import decode
from ..defect import Change, Data, Defect, Handler, around, defect, tools_of
from ..life import address_of

__all__ = ["DEFECTS", "Stream"]

_READ_INPUT, _READ_HOLDING, _WRITE = "read_input_registers", "read_multiple_holding_registers", "write_register"
_HEADER = 9
"""Bytes before the registers of an answer."""


class Stream:
    """A Modbus client that takes answers in the order in which they come, whatever request each of them belongs to.

    Args:
        patience_s: seconds for which it waits for the next part of an answer.
        part: number of bytes in a part; 0 for a whole answer. With parts it makes a new connection when it has waited in vain.
        pipelined: requests are sent while others wait.
    """

    def __init__(
        self, server: AdapterServer, *, patience_s: float = 4.0, part: int = 0, pipelined: bool = False
    ) -> None:
        self._address = address_of(server)
        self._patience_s = patience_s
        self._part = part
        self._sending = asyncio.Semaphore(64 if pipelined else 1)
        self._taking = asyncio.Lock()
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None
        self._number = 0

    async def read(self, call: Call, function: int, address: int, count: int) -> list[int]:
        """Read registers."""
        async with self._sending:
            fresh = self._streams is None
            if self._streams is None:
                self._streams = await asyncio.open_connection(*self._address)
            reader, writer = self._streams
            call.connection(generation=1, fresh=fresh)
            self._number += 1
            writer.write(struct.pack(">HHHBBHH", self._number, 0, 6, 1, function, address, count))
            call.sending()
            async with self._taking:
                try:
                    answer = await self._answer(reader, _HEADER + 2 * count)
                except TimeoutError:
                    if self._part:
                        self._streams = None
                    raise AdapterError("timeout", "the device did not reply in time") from None
                except OSError as error:
                    raise AdapterError("connection_lost", "the connection broke") from error
            call.answered()
            return list(struct.unpack(f">{count}H", answer[_HEADER:]))

    async def _answer(self, reader: asyncio.StreamReader, size: int) -> bytes:
        answer = b""
        while len(answer) < size:
            wanted = min(self._part or size, size - len(answer))
            answer += await asyncio.wait_for(reader.readexactly(wanted), self._patience_s)
        return answer


def over_a_stream(name: str, function: int, **options: Any) -> Change:
    """Return the defect that a tool reads by such a client."""

    def apply(server: AdapterServer) -> None:
        streams: list[Stream] = []

        @around(name)
        async def streaming(genuine: Handler, call: Call, arguments: Any) -> Data:
            if not streams:
                streams.append(Stream(server, **options))
            values = await streams[0].read(call, function, arguments.address, arguments.count)
            return {"address": arguments.address, "count": arguments.count, "values": values}

        streaming(server)

    return apply


def late_answers(server: AdapterServer) -> None:
    """A read that has run out of time is still under way, and the next read is given its answer."""
    link = tools_of(server, "read_opcua_node")._link
    patience_s = link._timeout_s
    link._timeout_s = 3 * patience_s
    late: list[asyncio.Future[Data]] = []

    @around("read_opcua_node")
    async def handed_on(genuine: Handler, call: Call, arguments: Any) -> Data:
        answer = late.pop() if late else asyncio.ensure_future(genuine(call, arguments))
        try:
            data = await asyncio.wait_for(asyncio.shield(answer), patience_s)
        except TimeoutError:
            late.append(answer)
            raise AdapterError("timeout", "the server did not answer in time") from None
        return {**data, "node_id": arguments.node_id}

    handed_on(server)


def torn_numbers(server: AdapterServer) -> None:
    tools = tools_of(server, _READ_INPUT)

    @around("read_holding_typed")
    async def parted(genuine: Handler, call: Call, arguments: Any) -> Data:
        (high,) = await tools._holding(call, arguments, arguments.address, 1)
        (low,) = await tools._holding(call, arguments, arguments.address + 1, 1)
        return {"address": arguments.address, **decode([high, low], arguments.data_type, arguments.order)}

    parted(server)


def lost_update(server: AdapterServer) -> None:
    """Of several writes to one node at the same time only the last is sent, and all are told as successes."""
    waiting: dict[str, int] = {}

    @around("write_opcua_node")
    async def merging(genuine: Handler, call: Call, arguments: Any) -> Data:
        waiting[arguments.node_id] = mine = waiting.get(arguments.node_id, 0) + 1
        await asyncio.sleep(0.02)
        if waiting[arguments.node_id] != mine:
            return {"node_id": arguments.node_id, "value": arguments.value, "data_type": "Double", "status": "Good"}
        data = await genuine(call, arguments)
        return data

    merging(server)


def blocking(server: AdapterServer) -> None:
    """Wait for the device in the event loop."""

    @around(_READ_HOLDING)
    async def synchronous(genuine: Handler, call: Call, arguments: Any) -> Data:
        count = arguments.count
        with socket.create_connection(address_of(server), timeout=3.0) as connection:
            call.connection(generation=1, fresh=True)
            call.sending()
            connection.sendall(struct.pack(">HHHBBHH", 1, 0, 6, 1, 3, arguments.address, count))
            try:
                answer = connection.recv(300)
            except TimeoutError:
                raise AdapterError("timeout", "the device did not reply in time") from None
        call.answered()
        values = list(struct.unpack(f">{count}H", answer[_HEADER:]))
        return {"address": arguments.address, "count": count, "values": values}

    synchronous(server)


def one_message_at_a_time(server: AdapterServer) -> None:
    """Look at a message only when the one before it has been answered."""
    turn = asyncio.Lock()
    (genuine,) = server.mcp.middleware

    async def in_turn(ctx: Any, call_next: Any) -> Any:
        async with turn:
            return await genuine(ctx, call_next)

    server.mcp.middleware[:] = [in_turn]


def connection_for_each_read(server: AdapterServer) -> None:
    held = []

    @around(_READ_HOLDING)
    async def connecting(genuine: Handler, call: Call, arguments: Any) -> Data:
        with contextlib.suppress(OSError):
            held.append(await asyncio.open_connection(*address_of(server)))
        data = await genuine(call, arguments)
        return data

    connecting(server)


def connection_during_each_read(server: AdapterServer) -> None:
    """Every call has a connection of its own, which is closed when it is over."""

    @around(_READ_HOLDING)
    async def connecting(genuine: Handler, call: Call, arguments: Any) -> Data:
        _, writer = await asyncio.open_connection(*address_of(server))
        try:
            # As long as a device takes that answers slowly.
            await asyncio.sleep(0.05)
            data = await genuine(call, arguments)
        finally:
            writer.close()
        return data

    connecting(server)


def _first_granted() -> Change:
    """Return the defect that of several subscriptions at the same time all are told what was granted to the last of them."""
    last: list[int] = [0]

    def apply(server: AdapterServer) -> None:
        @around("subscribe_topic")
        async def shared(genuine: Handler, call: Call, arguments: Any) -> Data:
            data = await genuine(call, arguments)
            last[0] = data["granted_qos"]
            await asyncio.sleep(0.02)
            return {**data, "granted_qos": last[0]}

        shared(server)

    return apply


def exchanged_values(server: AdapterServer) -> None:
    """Of two writes within 10 ms each sends the value of the other."""
    waiting: list[tuple[Any, asyncio.Future[int]]] = []

    @around(_WRITE)
    async def exchanging(genuine: Handler, call: Call, arguments: Any) -> Data:
        value = arguments.value
        if waiting:
            other, given = waiting.pop()
            given.set_result(value)
            value = other.value
        else:
            mine = arguments, asyncio.get_running_loop().create_future()
            waiting.append(mine)
            try:
                async with asyncio.timeout(0.01):
                    value = await mine[1]
            except TimeoutError:
                waiting.remove(mine)
        data = await genuine(call, arguments.model_copy(update={"value": value}))
        return {**data, "value": arguments.value}

    exchanging(server)


def last_value_for_all(server: AdapterServer) -> None:
    """The value to be written is kept in one place for all calls, and sent a moment later."""
    kept: list[Any] = [None]

    @around(_WRITE)
    async def keeping(genuine: Handler, call: Call, arguments: Any) -> Data:
        kept[0] = arguments.value
        await asyncio.sleep(0.01)
        data = await genuine(call, arguments.model_copy(update={"value": kept[0]}))
        return {**data, "value": arguments.value}

    keeping(server)


DEFECTS: tuple[Defect, ...] = (
    defect(
        "MU-37",
        "modbus",
        "Answers that come in another order are given to the wrong calls.",
        over_a_stream(_READ_INPUT, 4, pipelined=True),
        "CON-001",
    ),
    defect(
        "MU-37q",
        "mqtt",
        "Of several subscriptions at the same time each is told what was granted to another.",
        _first_granted(),
        "CON-001",
    ),
    defect("MU-38", "modbus", "A late answer is given to the next call.", over_a_stream(_READ_HOLDING, 3), "CON-002"),
    defect("MU-38o", "opcua", "A late answer is given to the next call.", late_answers, "CON-002"),
    defect("MU-41c", "modbus", "The two registers of a number are read in two requests.", torn_numbers, "CON-004"),
    defect(
        "MU-41o",
        "opcua",
        "Of two writes at the same time only one is sent, and both are told as successes.",
        lost_update,
        "CON-004",
    ),
    defect(
        "MU-37w", "modbus", "Of two writes within 10 ms each sends the value of the other.", exchanged_values, "CON-004"
    ),
    defect(
        "MU-37v",
        "modbus",
        "Of several writes at the same time all send the value of the last.",
        last_value_for_all,
        "CON-004",
    ),
    defect(
        "MU-90h", "modbus", "Every read makes a connection and leaves it open.", connection_for_each_read, "CON-006"
    ),
    defect(
        "MU-90p",
        "modbus",
        "Every read has a connection of its own while it lasts.",
        connection_during_each_read,
        "CON-006",
    ),
    defect("MU-92", "modbus", "A device that is silent holds up the whole session.", blocking, "CON-005"),
    defect(
        "MU-92k",
        "s7",
        "A message is looked at only when the one before it has been answered.",
        one_message_at_a_time,
        "CON-005",
    ),
)
