"""Bindings of a subject file at work: each operation is performed with inputs that ``otmcp init`` did not use, and the device
and the answer are looked at without any of its code.
"""

from __future__ import annotations

import asyncio
import base64
import random
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

from pytest_otmcp.plant.mock_device import MockDevice
from pytest_otmcp.protocols.oracle import state_changing
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.subject.model import READ_WRITE, Adapter, Binding, Function
from pytest_otmcp.trial.adapter_under_test import AdapterUnderTest, BenchOptions
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.session_proof import prove_session

__all__ = ["wrong_bindings"]


class Work:
    """An adapter with the bindings of its subject file, at a device of its own."""

    def __init__(self, adapter: Adapter, device: MockDevice) -> None:
        self.under_test = AdapterUnderTest(adapter, READ_WRITE, device, BenchOptions())
        self.device = device
        self.entries: list[Any] = []

    async def call(self, operation: str, **inputs: object) -> Reply:
        """Perform the operation; ``entries`` is then what the device saw."""
        since = await self.device.mark()
        reply = await self.under_test.call(operation, inputs)
        await self.device.wait(since, {"direction": "in"}, timeout_s=1.0)
        self.entries = [*(await self.device.journal(since)).entries]
        return reply

    @property
    def changes(self) -> list[Any]:
        """What may have changed the device, during the last call."""
        return state_changing(self.entries)


async def reads_registers(work: Work, operation: str) -> bool:
    table, function = {"read_input": ("input_registers", 4), "read_holding": ("holding_registers", 3)}[operation]
    for count in (4, 1):
        values = [random.randrange(0x10000) for _ in range(count)]
        await work.device.poke(unit=1, table=table, address=3, values=values)
        reply = await work.call(operation, address=3, count=count)
        if reply.outputs != {"values": values} or {entry.get("function") for entry in work.entries} - {None} != {
            function
        }:
            return False
    return True


async def reads_bits(work: Work, operation: str) -> bool:
    table, function = {"read_coils": ("coils", 1), "read_discrete_inputs": ("discrete_inputs", 2)}[operation]
    for count in (9, 1):
        values = [random.random() < 0.5 for _ in range(count)]
        await work.device.poke(unit=1, table=table, address=3, values=values)
        reply = await work.call(operation, address=3, count=count)
        if reply.outputs != {"values": values} or {entry.get("function") for entry in work.entries} - {None} != {
            function
        }:
            return False
    return True


async def writes_a_register(work: Work, operation: str) -> bool:
    await work.call(operation, address=7, value=40123)
    held = (await work.device.image())["points"]["1/holding_registers/7"]
    return bool(held == 40123 and len(work.changes) == 1)


async def writes_several_registers(work: Work, operation: str) -> bool:
    await work.call(operation, address=7, values=[40123, 7, 61000])
    points = (await work.device.image())["points"]
    return [points[f"1/holding_registers/{at}"] for at in (7, 8, 9)] == [40123, 7, 61000]


async def writes_coils(work: Work, operation: str) -> bool:
    asked: dict[str, object] = {"values": [True, False, True]} if operation == "write_coils" else {"value": True}
    await work.device.poke(unit=1, table="coils", address=6, values=[False, False, True, False, False])
    await work.call(operation, address=7, **asked)
    points = (await work.device.image())["points"]
    held = [points[f"1/coils/{at}"] for at in (6, 7, 8, 9, 10)]
    return held == [False, True, *([False, True] if operation == "write_coils" else [True, False]), False]


async def writes_by_a_mask(work: Work, operation: str) -> bool:
    await work.device.poke(unit=1, table="holding_registers", address=7, values=[0b1010])
    await work.call(operation, address=7, and_mask=0b1100, or_mask=0b0101)
    return bool((await work.device.image())["points"]["1/holding_registers/7"] == 0b1001)


async def tells_the_state(work: Work, operation: str) -> bool:
    await work.call(operation)
    with_device = await work.call(operation)
    exchanged = any(entry["answers"] for entry in work.entries)
    await work.device.stop()
    without = await work.under_test.call(operation, {})
    await work.device.start()
    return exchanged and not _says_no(with_device) and _says_no(without)


def _says_no(reply: Reply) -> bool:
    return not reply.answered or not (reply.envelope or {}).get("success")


async def publishes(work: Work, operation: str) -> bool:
    await work.call(operation, topic="wild/target", payload="23.5", qos=1)
    sent = [(entry["topic"], base64.b64decode(entry["payload"])) for entry in work.changes]
    return sent == [("wild/target", b"23.5")]


async def subscribes(work: Work, operation: str) -> bool:
    await work.call(operation, filter="wild/+/level", qos=1)
    return any("wild/+/level" in str(client) for client in (await work.device.image())["clients"])


async def unsubscribes(work: Work, operation: str) -> bool:
    since = await work.device.mark()
    await work.call("subscribe", filter="otmcp/work/ended", qos=0)
    reply = await work.call(operation, filter="otmcp/work/ended")
    entries = (await work.device.journal(since)).entries
    return bool(reply.success) and any(
        entry["kind"] == "UNSUBSCRIBE" and "otmcp/work/ended" in str(entry) for entry in entries
    )


async def tells_subscriptions(work: Work, operation: str) -> bool:
    await work.call("subscribe", filter="otmcp/work/kept", qos=0)
    return "otmcp/work/kept" in ((await work.call(operation)).outputs.get("filters") or [])  # type: ignore[operator]


async def receives(work: Work, operation: str) -> bool:
    topic, text, blocks = "wild/tank", f"{random.getrandbits(40):x}", operation in work.under_test.adapter.blocking
    since = await work.device.mark()
    if not blocks:
        await work.under_test.call("subscribe", {"filter": "wild/#", "qos": 0})
    inputs: dict[str, object] = {"filter": topic, **({"seconds": 2} if blocks else {})}
    call = asyncio.create_task(work.under_test.call(operation, inputs)) if blocks else None
    await work.device.wait(since, {"kind": "SUBACK", "direction": "out"}, timeout_s=10.0)
    payload = base64.b64encode(text.encode()).decode()
    await work.device.poke(publish={"topic": topic, "payload": payload, "qos": 0, "retain": False})
    await work.device.wait(since, {"kind": "PUBLISH", "direction": "out", "topic": topic}, timeout_s=1.0)
    if call is None:
        # What the broker has sent has been read when another exchange is over.
        await work.under_test.call("subscribe", {"filter": "wild/other", "qos": 0})
    reply = await (call or work.under_test.call(operation, inputs))
    return {"topic": topic, "payload": text} in reply.outputs["messages"]  # type: ignore[operator]


async def reads_nodes(work: Work, operation: str) -> bool:
    values = {"Pressure": 3.25, "Temperature": -7.5}
    for name, value in values.items():
        await work.device.poke(node=name, value=value)
    nodes = [f"ns=2;s={name}" for name in values]
    if operation == "read_many":
        return (await work.call(operation, nodes=nodes)).outputs["values"] == list(values.values())
    return [(await work.call(operation, node=node)).outputs["value"] for node in nodes] == list(values.values())


async def writes_a_node(work: Work, operation: str) -> bool:
    node = "ns=2;s=ValvePosition"
    await work.call(operation, node=node, value=61.5)
    return bool((await work.device.image())["points"][node] == 61.5 and len(work.changes) == 1)


async def browses(work: Work, operation: str) -> bool:
    image = await work.device.image()
    folder = image["folders"]["Sensors"]
    inside = {node for node, variable in image["variables"].items() if variable["parent"] == folder}
    reply = await work.call(operation, node=folder)
    found: Any = reply.outputs["node_ids"]
    return set(found) == inside and len(found) == len(inside)


async def reads_a_block(work: Work, operation: str) -> bool:
    content = random.randbytes(5)
    await work.device.poke(area="DB10", byte=20, data=content.hex())
    return (await work.call(operation, db=10, start=20, size=len(content))).outputs == {"values": list(content)}


async def reads_a_typed_value(work: Work, operation: str) -> bool:
    value = random.randrange(-(2**31), 2**31)
    await work.device.poke(area="DB10", byte=20, data=value.to_bytes(4, "big", signed=True).hex())
    return (await work.call(operation, db=10, start=20, type="DINT")).outputs["value"] == value


async def writes_a_typed_value(work: Work, operation: str) -> bool:
    await work.call(operation, db=10, start=24, type="INT", value=-12345)
    points = (await work.device.image())["points"]
    return [points["DB10.DBB24"], points["DB10.DBB25"]] == [*(-12345).to_bytes(2, "big", signed=True)] and len(
        work.changes
    ) == 1


async def reads_present_values(work: Work, operation: str) -> bool:
    values = {1: -7.25, 2: 401.5}
    for instance, value in values.items():
        await work.device.poke(object=f"analog-input,{instance}", value=value)
    inputs = [{"device": 12345, "type": "analog-input", "instance": instance} for instance in values]
    return [(await work.call(operation, **each)).outputs["value"] for each in inputs] == list(values.values())


async def writes_a_present_value(work: Work, operation: str) -> bool:
    await work.call(operation, device=12345, type="analog-output", instance=1, value=61.5, priority=10)
    points = (await work.device.image())["points"]
    return bool(points["analog-output,1/priority-array/10"] == 61.5 and len(work.changes) == 1)


async def reads_a_tag(work: Work, operation: str) -> bool:
    values = {"BatchTarget": -123456789, "Levels[2]": 401.5}
    for tag, value in values.items():
        await work.device.poke(tag=tag, value=value)
    return [(await work.call(operation, tag=tag)).outputs["value"] for tag in values] == list(values.values())


async def reads_elements(work: Work, operation: str) -> bool:
    values = [random.randrange(-(2**15), 2**15) for _ in range(3)]
    for index, value in enumerate(values, 4):
        await work.device.poke(tag=f"Counts[{index}]", value=value)
    found = [(await work.call(operation, tag="Counts[4]", count=count)).outputs["values"] for count in (3, 1)]
    return found == [values, values[:1]]


async def writes_a_tag(work: Work, operation: str) -> bool:
    await work.call(operation, tag="ValvePosition", value=61, type="DINT")
    return bool((await work.device.image())["points"]["ValvePosition"] == 61 and len(work.changes) == 1)


async def reads_points(work: Work, operation: str) -> bool:
    kind, first = {"read_binary": ("binary_input", 9), "read_analog": ("analog_input", 2)}[operation]
    for values in ([True, False, True], [False]) if operation == "read_binary" else ([-4711, 7, 2**31 - 1], [5]):
        for index, value in enumerate(values, first):
            await work.device.poke(point=f"{kind}/{index}", value=value)
        reply = await work.call(operation, outstation=10, start=first, count=len(values))
        if reply.outputs["values"] != values:
            return False
    return True


async def latches_an_output(work: Work, operation: str) -> bool:
    for value in (True, False):
        await work.call(operation, outstation=10, index=3, value=value)
        if (await work.device.image())["points"]["binary_output/3"] is not value:
            return False
    return True


async def reads_input_bytes(work: Work, operation: str) -> bool:
    content = {8: random.randbytes(8), 5: random.randbytes(2)}
    for station, data in content.items():
        await work.device.poke(station=station, inputs=data.hex())
    found = [(await work.call(operation, slave=station)).outputs["values"] for station in content]
    return found == [list(data) for data in content.values()]


async def writes_output_bytes(work: Work, operation: str) -> bool:
    await work.call(operation, slave=5, data=[7, 8])
    points = (await work.device.image())["points"]
    return [points["5.output.0"], points["5.output.1"]] == [7, 8]


async def reads_an_object(work: Work, operation: str) -> bool:
    value = random.randrange(-(2**31), 2**31)
    await work.device.poke(slave=1, object=[0x2001, 5], data=value.to_bytes(4, "little", signed=True).hex())
    reply = await work.call(operation, slave=1, index=0x2001, subindex=5, type="INT32")
    return bool(reply.outputs["value"] == value)


async def writes_an_object(work: Work, operation: str) -> bool:
    await work.call(operation, slave=1, index=0x2000, subindex=1, type="UINT16", value=321)
    return bool((await work.device.image())["points"]["1:2000:1"] == 321 and len(work.changes) == 1)


Check = Callable[[Work, str], Awaitable[bool]]

CHECKS: dict[str, dict[str, Check]] = {
    "modbus": {
        "read_input": reads_registers,
        "read_holding": reads_registers,
        "read_coils": reads_bits,
        "read_discrete_inputs": reads_bits,
        "write_holding": writes_a_register,
        "write_registers": writes_several_registers,
        "write_coil": writes_coils,
        "write_coils": writes_coils,
        "mask_write": writes_by_a_mask,
        # At last, here and below: an adapter may not come back from an outage.
        "ping": tells_the_state,
    },
    "mqtt": {
        "subscribe": subscribes,
        "messages": receives,
        "publish": publishes,
        "unsubscribe": unsubscribes,
        "subscriptions": tells_subscriptions,
        "info": tells_the_state,
    },
    "opcua": {"read": reads_nodes, "read_many": reads_nodes, "browse": browses, "write": writes_a_node},
    "s7": {
        "read_db": reads_a_block,
        "read_typed": reads_a_typed_value,
        "write_db": writes_a_typed_value,
        "ping": tells_the_state,
    },
    "bacnet": {"read": reads_present_values, "write": writes_a_present_value, "ping": tells_the_state},
    "ethernetip": {
        "read_tag": reads_a_tag,
        "read_array": reads_elements,
        "write_tag": writes_a_tag,
        "ping": tells_the_state,
    },
    "dnp3": {
        "read_binary": reads_points,
        "read_analog": reads_points,
        "write_binary": latches_an_output,
        "ping": tells_the_state,
    },
    "profibus": {"read_inputs": reads_input_bytes, "write_outputs": writes_output_bytes, "ping": tells_the_state},
    "ethercat": {"read_sdo": reads_an_object, "write_sdo": writes_an_object, "ping": tells_the_state},
    "profinet": {"ping": tells_the_state},
}


def _by_table(cases: Sequence[Binding]) -> bool:
    return any(case.command is None for case in cases)


async def wrong_bindings(adapter: Adapter, device: MockDevice) -> list[str]:
    """Perform every bound operation; return those that did something else, or whose result is somewhere else."""
    work, known = Work(adapter, device), protocols()[adapter.protocol].operations
    checks = CHECKS[adapter.protocol]
    try:
        await work.under_test.open()
        if all(known[name].writes for name in adapter.operations):
            # Nothing that is bound can prove the session; where the adapter connects to is looked at elsewhere.
            work.under_test.cursor.proven = "nothing"
        problem = await prove_session(work.under_test)
        if problem is not None:
            return [problem]
        # What named commands do was compared with what the device saw when they were found.
        bound = [name for name, cases in adapter.operations.items() if isinstance(cases, Function) or _by_table(cases)]
        wrong = [name for name, check in checks.items() if name in bound and not await check(work, name)]
        return wrong + [name for name in bound if name not in checks]
    finally:
        await work.under_test.close()
