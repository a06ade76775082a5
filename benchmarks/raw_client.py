"""A bare protocol client in a process of its own: ``python -m benchmarks.raw_client EXCHANGE HOST PORT``, with the path of a line, or with
the address of a device on a cable.

It makes one exchange for every line on its standard input, and then answers. So it is in an adapter's situation: a pipe
wakes it, the device has slept too, and both compete with the caller for the processors. The exchange ``nothing`` does
nothing: it is the floor, two processes and two pipes.
"""

from __future__ import annotations

import asyncio
import gc
import itertools
import json
import os
import socket
import struct
import sys
import tty
from collections.abc import Awaitable, Callable
from functools import partial

import paho.mqtt.client as paho
from asyncua import Client as OpcUaClient
from asyncua import ua
from paho.mqtt.enums import CallbackAPIVersion
from pymodbus.client import AsyncModbusTcpClient

from .workload import (
    ANALOG_INPUTS,
    BLOCKS,
    DB,
    DB_BYTES,
    ENTRY,
    FLOOD,
    INBOX,
    INPUT_REGISTERS,
    OBJECT,
    OUTSTATION,
    PARALLEL,
    PAYLOAD,
    PDU_REGISTERS,
    SLAVE,
    SLOT,
    TAG,
    TEMPERATURE,
    TOPIC,
)

__all__ = ["Exchange", "connect"]

_MASTER = 2
"""Address of the PROFIBUS master."""
_RPC_PORT, _READ_IMPLICIT = 34964, 5
"""UDP port of PROFINET devices, and the operation that reads without a relation."""

Exchange = Callable[[], Awaitable[None]]


async def _nothing() -> Exchange:
    async def nothing() -> None:
        return

    return nothing


async def _modbus_client(host: str, port: int) -> AsyncModbusTcpClient:
    client = AsyncModbusTcpClient(host, port=port, retries=0, reconnect_delay=0)
    assert await client.connect()
    return client


async def _modbus(host: str, port: int) -> Exchange:
    client = await _modbus_client(host, port)

    async def read() -> None:
        reply = await client.read_input_registers(0, count=INPUT_REGISTERS, device_id=1)
        assert not reply.isError()

    return read


async def _modbus_block(count: int, host: str, port: int) -> Exchange:
    client = await _modbus_client(host, port)

    async def read() -> None:
        for start in range(0, count, PDU_REGISTERS):
            size = min(PDU_REGISTERS, count - start)
            reply = await client.read_holding_registers(start, count=size, device_id=1)
            assert len(reply.registers) == size

    return read


async def _together(connect: Callable[[str, int], Awaitable[Exchange]], host: str, port: int) -> Exchange:
    exchange = await connect(host, port)

    async def all_at_once() -> None:
        await asyncio.gather(*(exchange() for _ in range(PARALLEL)))

    return all_at_once


async def _paho(host: str, port: int) -> paho.Client:
    connected = asyncio.Event()
    client = paho.Client(CallbackAPIVersion.VERSION2, f"benchmark-{os.getpid()}", protocol=paho.MQTTv5)
    client.max_inflight_messages_set(0)
    client.on_connect = lambda c, u, flags, reason, properties: connected.set()
    client.connect(host, port, keepalive=3600)
    sock = client.socket()
    assert sock is not None
    asyncio.get_running_loop().add_reader(sock, client.loop_read)
    await connected.wait()
    return client


async def _publishing(qos: int, count: int, host: str, port: int) -> Exchange:
    client, published, missing = await _paho(host, port), asyncio.Event(), 0

    def one_published(*_: object) -> None:
        nonlocal missing
        missing -= 1
        if not missing:
            published.set()

    client.on_publish = one_published

    async def publish() -> None:
        nonlocal missing
        published.clear()
        missing = count
        for _ in range(count):
            # Without its thread and its socket callbacks paho writes within publish(): no hand-over is measured.
            client.publish(TOPIC, PAYLOAD, qos)
        await published.wait()

    return publish


async def _mqtt_inbox(host: str, port: int) -> Exchange:
    client, answered = await _paho(host, port), asyncio.Event()
    received: list[bytes | bytearray] = []
    client.on_message = lambda c, u, message: received.append(message.payload)
    client.on_subscribe = lambda c, u, mid, reasons, properties: answered.set()
    client.subscribe(f"{INBOX}/raw/#")
    await answered.wait()

    async def receive() -> None:
        # What the broker had for this client before comes before its answer.
        answered.clear()
        client.subscribe(f"{INBOX}/nothing")
        await answered.wait()
        # The first exchange is before the first flood.
        assert len(received) in (0, FLOOD)
        received.clear()

    return receive


async def _opcua(host: str, port: int) -> Exchange:
    client = OpcUaClient(f"opc.tcp://{host}:{port}")
    await client.connect()
    parameters = ua.ReadParameters()
    node = ua.NodeId.from_string(TEMPERATURE)
    parameters.NodesToRead = [ua.ReadValueId(NodeId=node, AttributeId=ua.AttributeIds.Value)]

    async def read() -> None:
        (result,) = await client.uaclient.read(parameters)
        assert result.StatusCode.is_good()

    return read


async def _opcua_variables(host: str, port: int) -> Exchange:
    # Decoding thousands of values keeps the loop from the library's watchdog, which would take the connection for lost.
    client = OpcUaClient(f"opc.tcp://{host}:{port}", timeout=60, watchdog_intervall=600)
    await client.connect()
    classes, hierarchical = ua.NodeClass.Object | ua.NodeClass.Variable, ua.NodeId(ua.ObjectIds.HierarchicalReferences)

    async def browse(nodes: list[ua.NodeId]) -> list[ua.ReferenceDescription]:
        asked = [
            ua.BrowseDescription(
                NodeId=node,
                ReferenceTypeId=hierarchical,
                IncludeSubtypes=True,
                NodeClassMask=classes,
                ResultMask=ua.BrowseResultMask.All,
            )
            for node in nodes
        ]
        pages = await client.uaclient.browse(ua.BrowseParameters(NodesToBrowse=asked))
        found = [reference for page in pages for reference in page.References]
        while points := [page.ContinuationPoint for page in pages if page.ContinuationPoint]:
            following = ua.BrowseNextParameters(ReleaseContinuationPoints=False, ContinuationPoints=points)
            pages = await client.uaclient.browse_next(following)
            found += [reference for page in pages for reference in page.References]
        return [reference for reference in found if reference.NodeId.NamespaceIndex]

    # What the folders are is found out before anything is measured.
    folders = level = [ua.NodeId(ua.ObjectIds.ObjectsFolder)]
    while level:
        below = await browse(level)
        level = [reference.NodeId for reference in below if reference.NodeClass == ua.NodeClass.Object]
        folders = folders + level

    async def enumerate_variables() -> None:
        found = await browse(folders)
        variables = [client.get_node(one.NodeId) for one in found if one.NodeClass == ua.NodeClass.Variable]
        values = await client.read_values(variables)
        assert len(values) == len(variables)

    return enumerate_variables


async def _s7(host: str, port: int) -> Exchange:
    from snap7.async_client import AsyncClient

    client = AsyncClient()
    await client.connect(host, 0, 1, port)

    async def read() -> None:
        assert len(await client.db_read(DB, 0, DB_BYTES)) == DB_BYTES

    return read


async def _bacnet(host: str, port: int) -> Exchange:
    from bacpypes3.ipv4.app import NormalApplication
    from bacpypes3.local.device import DeviceObject
    from bacpypes3.pdu import Address, IPv4Address

    own = DeviceObject(objectIdentifier=("device", 4194302), objectName="benchmark", vendorIdentifier=15)
    application, device = NormalApplication(own, IPv4Address(f"{host}:0")), Address(f"{host}:{port}")

    async def read() -> None:
        value = await application.read_property(device, ",".join(map(str, OBJECT)), "present-value")
        assert isinstance(value, float)

    return read


async def _ethernetip(host: str, port: int) -> Exchange:
    from pylogix import PLC

    client = PLC(host, port=port)

    async def read() -> None:
        assert isinstance(client.Read(TAG).Value, float)

    return read


async def _dnp3(host: str, port: int) -> Exchange:
    from dnp3.master import DefaultSOEHandler, Master, MasterConfig, MasterTcpRunner

    master = Master(config=MasterConfig(address=1, outstation_address=OUTSTATION), handler=DefaultSOEHandler())
    client = MasterTcpRunner(master, host, port)
    await client.open()

    async def read() -> None:
        # Group 30, variation 0: analog inputs as the outstation has them.
        assert await client.request(master.build_range_poll(30, 0, 0, ANALOG_INPUTS - 1))

    return read


async def _profibus(path: str) -> Exchange:
    line = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    tty.setraw(line)
    loop, answered, answer = asyncio.get_running_loop(), asyncio.Event(), bytearray()

    def take() -> None:
        answer.extend(os.read(line, 256))
        # A telegram of variable length says its length in its second byte, which six further bytes do not count in.
        if len(answer) > 1 and len(answer) == answer[1] + 6:
            answered.set()

    loop.add_reader(line, take)
    count = itertools.cycle((0x5D, 0x7D))

    async def read() -> None:
        # Station and master with an extension each, the frame count bit, RD_Inp (56) of the master's access point 62.
        body = bytes([0x80 | SLAVE, 0x80 | _MASTER, next(count), 56, 62])
        answered.clear()
        answer.clear()
        os.write(line, bytes([0x68, len(body), len(body), 0x68, *body, sum(body) & 0xFF, 0x16]))
        await answered.wait()
        assert answer[3] == 0x68

    return read


async def _ethercat(interface: str) -> Exchange:
    import pysoem

    master = pysoem.Master()
    master.open(interface)
    assert master.config_init() > 0
    # SOEM's 2 ms are too few on a machine that does something else as well.
    pysoem.settings.timeouts.ret = 50_000
    position, index, subindex = ENTRY

    async def read() -> None:
        assert len(master.slaves[position].sdo_read(index, subindex)) == 4

    return read


async def _profinet(host: str) -> Exchange:
    loop, made = asyncio.get_running_loop(), socket.socket(socket.AF_INET, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
    made.connect((host, _RPC_PORT))
    # IODReadReqHeader: no relation, API 0, slot, subslot 1, record 8028, at most 4096 bytes; and what the arrays of NDR say of it.
    block = struct.pack(">HHBBH16xIHHHHI24x", 0x0009, 60, 1, 0, 0, 0, SLOT, 1, 0, 0x8028, 4096)
    body = struct.pack(">5I", 4100, len(block), 4100, 0, len(block)) + block
    # Connectionless RPC, version 4, a request in big-endian order to the object and the interface of an IO device.
    who = bytes.fromhex("0400200000000000 dea000006c9711d18271000100010abc dea000016c9711d1827100a02442df7d")
    numbers = struct.pack(">IIIHHHHHBB", 0, 1, 0, _READ_IMPLICIT, 0xFFFF, 0xFFFF, len(body), 0, 0, 0)

    async def read() -> None:
        # A call of its own each time: one with the same activity is the same call.
        await loop.sock_sendall(made, who + os.urandom(16) + numbers + body)
        answer = await loop.sock_recv(made, 2048)
        # Behind the header of 80 bytes is the status.
        assert answer[80:84] == bytes(4)

    return read


EXCHANGES: dict[str, Callable[..., Awaitable[Exchange]]] = {
    "nothing": _nothing,
    "modbus": _modbus,
    "mqtt": partial(_publishing, 0, 1),
    "mqtt_exchange": partial(_publishing, 1, 1),
    "mqtt_inbox": _mqtt_inbox,
    "opcua": _opcua,
    "opcua_variables": _opcua_variables,
    "s7": _s7,
    "bacnet": _bacnet,
    "ethernetip": _ethernetip,
    "dnp3": _dnp3,
    "profibus": _profibus,
    "ethercat": _ethercat,
    "profinet": _profinet,
    "modbus_together": partial(_together, _modbus),
    "mqtt_together": partial(_publishing, 1, PARALLEL),
    "opcua_together": partial(_together, _opcua),
    **{f"modbus_{count}": partial(_modbus_block, count) for count in BLOCKS},
}
"""Functions that connect to a host and port, or open a line, and return a function that makes one exchange."""


def connect(name: str, *where: str) -> Awaitable[Exchange]:
    """Connect to a host and port, or open a line, as the command line has them."""
    return EXCHANGES[name](*(int(part) if part.isdecimal() else part for part in where))


async def _serve(name: str, *where: str) -> None:
    exchange = await connect(name, *where)
    loop, lines = asyncio.get_running_loop(), asyncio.StreamReader()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), sys.stdin)
    # The floor must not include the time of the garbage collector.
    gc.disable()
    while line := await lines.readline():
        request = json.loads(line)
        await exchange()
        os.write(1, json.dumps({"jsonrpc": "2.0", "id": request["id"], "result": {}}).encode() + b"\n")


if __name__ == "__main__":
    asyncio.run(_serve(*sys.argv[1:]))
