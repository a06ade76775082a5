"""A bare protocol client in a process of its own: ``python -m benchmarks.raw_client EXCHANGE HOST PORT``.

It makes one exchange for every line on its standard input, and then answers. So it is in an adapter's situation: a pipe
wakes it, the device has slept too, and both compete with the caller for the processors. The exchange ``nothing`` does
nothing: it is the floor, two processes and two pipes.
"""

from __future__ import annotations

import asyncio
import gc
import json
import os
import sys
from collections.abc import Awaitable, Callable

import paho.mqtt.client as paho
from asyncua import Client as OpcUaClient
from asyncua import ua
from paho.mqtt.enums import CallbackAPIVersion
from pymodbus.client import AsyncModbusTcpClient

from .workload import INPUT_REGISTERS, PAYLOAD, TEMPERATURE, TOPIC

__all__ = ["EXCHANGES", "Exchange"]

Exchange = Callable[[], Awaitable[None]]


async def _nothing(host: str, port: int) -> Exchange:
    async def nothing() -> None:
        return

    return nothing


async def _modbus(host: str, port: int) -> Exchange:
    client = AsyncModbusTcpClient(host, port=port, retries=0, reconnect_delay=0)
    assert await client.connect()

    async def read() -> None:
        reply = await client.read_input_registers(0, count=INPUT_REGISTERS, device_id=1)
        assert not reply.isError()

    return read


async def _publishing(host: str, port: int, qos: int) -> Exchange:
    connected, published = asyncio.Event(), asyncio.Event()
    client = paho.Client(CallbackAPIVersion.VERSION2, f"benchmark-{os.getpid()}", protocol=paho.MQTTv311)
    client.on_connect = lambda c, u, flags, reason, properties: connected.set()
    client.on_publish = lambda c, u, mid, reason, properties: published.set()
    client.connect(host, port, keepalive=3600)
    sock = client.socket()
    assert sock is not None
    asyncio.get_running_loop().add_reader(sock, client.loop_read)
    await connected.wait()

    async def publish() -> None:
        published.clear()
        # Without its thread and its socket callbacks paho writes within publish(): no hand-over is measured.
        client.publish(TOPIC, PAYLOAD, qos)
        await published.wait()

    return publish


async def _mqtt(host: str, port: int) -> Exchange:
    return await _publishing(host, port, 0)


async def _mqtt_exchange(host: str, port: int) -> Exchange:
    return await _publishing(host, port, 1)


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


EXCHANGES: dict[str, Callable[[str, int], Awaitable[Exchange]]] = {
    "nothing": _nothing,
    "modbus": _modbus,
    "mqtt": _mqtt,
    "mqtt_exchange": _mqtt_exchange,
    "opcua": _opcua,
    "opcua_variables": _opcua_variables,
}
"""Functions that connect to a host and port, and return a function that makes one exchange."""


async def _serve(name: str, host: str, port: int) -> None:
    exchange = await EXCHANGES[name](host, port)
    loop, lines = asyncio.get_running_loop(), asyncio.StreamReader()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), sys.stdin)
    # The floor must not include the time of the garbage collector.
    gc.disable()
    while line := await lines.readline():
        request = json.loads(line)
        await exchange()
        os.write(1, json.dumps({"jsonrpc": "2.0", "id": request["id"], "result": {}}).encode() + b"\n")


if __name__ == "__main__":
    asyncio.run(_serve(sys.argv[1], sys.argv[2], int(sys.argv[3])))
