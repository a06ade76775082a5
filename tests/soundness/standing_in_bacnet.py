"""A BACnet/IP device built on bacpypes3, which stands for a real one and takes every write: ``python standing_in_bacnet.py PORT``.

It says on its first line that it serves. At each line of its input it tells every datagram that has reached its socket, before the library
has seen it, and what its objects hold. It ends with its input; ``… PORT stays`` goes on, and ``… PORT shouts`` answers a Who-Is by broadcast, which on
one machine reaches nobody.
"""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Callable
from typing import Any

from bacpypes3.ipv4 import IPv4DatagramProtocol
from bacpypes3.ipv4.app import NormalApplication
from bacpypes3.local.analog import AnalogInputObject, AnalogValueObject
from bacpypes3.local.binary import BinaryValueObject
from bacpypes3.local.device import DeviceObject
from bacpypes3.local.multistate import MultiStateValueObject
from bacpypes3.pdu import IPv4Address

REALS = {"analog-input,1": 21.5, "analog-input,2": 1.1, "analog-input,3": -3.25, "analog-value,1": 1480.25}


received: list[str] = []
served = asyncio.Event()


def record(genuine: Callable[..., None]) -> Callable[..., None]:
    def datagram_received(self: Any, data: bytes, address: Any) -> None:
        received.append(data.hex())
        genuine(self, data, address)

    return datagram_received


def tell(genuine: Callable[..., None]) -> Callable[..., None]:
    def connection_made(self: Any, transport: Any) -> None:
        genuine(self, transport)
        served.set()

    return connection_made


class Shouting(NormalApplication):
    async def do_WhoIsRequest(self, apdu: Any) -> None:
        pass


async def main(port: int, how: str) -> None:
    IPv4DatagramProtocol.datagram_received = record(IPv4DatagramProtocol.datagram_received)
    IPv4DatagramProtocol.connection_made = tell(IPv4DatagramProtocol.connection_made)
    own = DeviceObject(
        objectIdentifier=("device", 4711),
        objectName="stand-in",
        vendorIdentifier=999,
        vendorName="Foreign",
        modelName="Stand-in",
        firmwareRevision="1.0",
    )
    device = (Shouting if how == "shouts" else NormalApplication)(own, IPv4Address(f"127.0.0.1:{port}"))
    objects = {}
    for name, value in REALS.items():
        kind = AnalogInputObject if name.startswith("analog-input") else AnalogValueObject
        objects[name] = kind(objectIdentifier=name, objectName=name, presentValue=value)
    objects["binary-value,1"] = BinaryValueObject(
        objectIdentifier="binary-value,1", objectName="pump", presentValue="active"
    )
    objects["multi-state-value,1"] = MultiStateValueObject(
        objectIdentifier="multi-state-value,1", objectName="mode", presentValue=2, numberOfStates=3
    )
    for one in objects.values():
        device.add_object(one)
    await served.wait()
    print(json.dumps({"port": port}), flush=True)
    loop = asyncio.get_running_loop()
    while await loop.run_in_executor(None, sys.stdin.readline):
        held = {name: float(one.presentValue) for name, one in objects.items()}
        print(json.dumps({"received": received, "held": held}), flush=True)
    if how == "stays":
        await loop.create_future()


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), " ".join(sys.argv[2:])))
