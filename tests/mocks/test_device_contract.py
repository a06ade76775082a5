"""The duties of every mock device, whatever its protocol: one suite, a case for each protocol.

A new protocol adds a client of its own and a :class:`Case`. One case is a device from a package outside the product.
"""

# asyncua's exports are not declared.
# mypy: disable-error-code="attr-defined, import-not-found"

from __future__ import annotations

import asyncio
import base64
import contextlib
import itertools
import os
import stat
import sys
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import psutil
import pytest
import pytest_asyncio
from asyncua import Client, ua
from dnp3_tools import RawDnp3, crob
from ethernetip_tools import RawEip, cip, symbol
from mock_program import PATIENCE_S, MockProgram, RefusedError
from mqtt_tools import connect_bytes, frame, utf8
from profibus_tools import Master, request
from profinet_tools import Controller
from pytest_otmcp.mocks.packages import built_in
from s7_tools import RawS7, item

from pytest_otmcp.core.journal_entry import JournalEntry
from pytest_otmcp.session.cable import cable_refused

pytestmark = pytest.mark.asyncio(loop_scope="module")

# -- clients --------------------------------------------------------------------------------------------------


class AnyClient(Protocol):
    """A client of a device with one connection for its requests; each method returns when the answer has come."""

    async def open(self, program: MockProgram) -> None:
        """Connect."""

    async def read(self) -> None:
        """Ask for something that changes nothing."""

    async def write(self) -> None:
        """Change one point of the plant."""

    async def close(self) -> None:
        """Close the connection in an orderly way."""


class StreamClient:
    """The base of clients whose connection is a stream of bytes."""

    async def open(self, program: MockProgram) -> None:
        self.reader, self.writer = await asyncio.open_connection(program.host, program.port)

    async def exchange(self, request: bytes, answer_head: int, rest: Callable[[bytes], int]) -> bytes:
        """Send a request and return its answer, whose first bytes tell its length."""
        self.writer.write(request)
        head = await asyncio.wait_for(self.reader.readexactly(answer_head), PATIENCE_S)
        return head + await asyncio.wait_for(self.reader.readexactly(rest(head)), PATIENCE_S)

    async def close(self) -> None:
        self.writer.close()
        await self.writer.wait_closed()


class ModbusClient(StreamClient):
    async def ask(self, pdu: str) -> bytes:
        body = bytes.fromhex(pdu)
        request = b"\0\1\0\0" + (len(body) + 1).to_bytes(2) + b"\1" + body
        return await self.exchange(request, 6, lambda head: int.from_bytes(head[4:]))

    async def read(self) -> None:
        await self.ask("03 0000 0001")

    async def write(self) -> None:
        await self.ask("06 0032 0007")


class MqttClient(StreamClient):
    _numbers = itertools.count(1)

    async def open(self, program: MockProgram) -> None:
        await super().open(program)
        # A second connection with the same client identifier would end the first.
        await self.ask(connect_bytes(f"contract-{next(self._numbers)}"))

    async def ask(self, packet: bytes) -> bytes:
        return await self.exchange(packet, 2, lambda head: head[1])

    async def read(self) -> None:
        await self.ask(frame(0x82, b"\0\1", utf8("nothing/here"), b"\1"))

    async def write(self) -> None:
        await self.ask(frame(0x33, utf8("contract"), b"\0\2", b"7"))

    async def close(self) -> None:
        self.writer.write(frame(0xE0))
        await super().close()


class OpcUaClient:
    async def open(self, program: MockProgram) -> None:
        url = f"opc.tcp://{program.host}:{program.port}"
        self._client = Client(url, timeout=PATIENCE_S, watchdog_intervall=600)
        await self._client.connect()

    async def read(self) -> None:
        item = ua.ReadValueId(NodeId=ua.NodeId("Pressure", 2), AttributeId=ua.AttributeIds.Value)
        await self._client.uaclient.read(ua.ReadParameters(NodesToRead=[item]))

    async def write(self) -> None:
        value = ua.DataValue(ua.Variant(77.0, ua.VariantType.Double))
        node, attribute = ua.NodeId("FanSpeed", 2), ua.AttributeIds.Value
        item = ua.WriteValue(NodeId=node, AttributeId=attribute, Value=value)
        await self._client.uaclient.write(ua.WriteParameters(NodesToWrite=[item]))

    async def close(self) -> None:
        await self._client.disconnect()


class S7ContractClient:
    """A client for the S7 controller, whose requests are one read and one write of a byte."""

    async def open(self, program: MockProgram) -> None:
        self._raw = RawS7()
        await self._raw.open(program)

    async def read(self) -> None:
        await self._raw.read(item(0x84, 10, 0))

    async def write(self) -> None:
        await self._raw.write(item(0x84, 10, 50), 4, 8, "07")

    async def close(self) -> None:
        await self._raw.close()


class Answers(asyncio.DatagramProtocol):
    """What comes back to a client of datagrams."""

    def __init__(self) -> None:
        self.queue: asyncio.Queue[bytes] = asyncio.Queue()

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self.queue.put_nowait(data)


class BacnetClient:
    _numbers = itertools.count()

    async def open(self, program: MockProgram) -> None:
        self._transport, self._answers = await asyncio.get_running_loop().create_datagram_endpoint(
            Answers, remote_addr=(program.host, program.port)
        )

    async def ask(self, apdu: str) -> None:
        body = b"\1\4\0\5" + bytes([next(self._numbers) & 0xFF]) + bytes.fromhex(apdu)
        self._transport.sendto(b"\x81\x0a" + (4 + len(body)).to_bytes(2) + body)
        await asyncio.wait_for(self._answers.queue.get(), PATIENCE_S)

    async def read(self) -> None:
        await self.ask("0c 0c00000001 1955")

    async def write(self) -> None:
        await self.ask("0f 0c01400001 1955 3e 9100 3f")

    async def close(self) -> None:
        self._transport.close()


class EthernetIpClient:
    """A client for the Logix controller, without a CIP connection."""

    async def open(self, program: MockProgram) -> None:
        self._raw = RawEip()
        await self._raw.open(program)

    async def read(self) -> None:
        await self._raw.unconnected(cip(0x4C, symbol("FanSpeed"), "0100"))

    async def write(self) -> None:
        await self._raw.unconnected(cip(0x4D, symbol("FanSpeed"), "c400 0100 07000000"))

    async def close(self) -> None:
        await self._raw.close()


class Dnp3Client:
    """A master whose requests are one read of an analog input and one direct operation of a latch."""

    async def open(self, program: MockProgram) -> None:
        self._raw = RawDnp3()
        await self._raw.dial(program)

    async def read(self) -> None:
        await self._raw.ask("01 1e0000 0101")

    async def write(self) -> None:
        await self._raw.ask("05" + crob(2, 3))

    async def close(self) -> None:
        await self._raw.close()


class ProfibusClient:
    """A master of station 8, which sends each time other outputs: those that a slave has already are no write."""

    async def open(self, program: MockProgram) -> None:
        self._master = Master(program)
        await self._master.exchange(8, bytes(8).hex(), ident="80a5", cfg="1727")
        self._values = itertools.cycle((7, 8))

    async def read(self) -> None:
        await self._master.ask(request(8, 56))

    async def write(self) -> None:
        await self._master.ask(request(8, None, bytes([*bytes(7), next(self._values)]).hex()))

    async def close(self) -> None:
        self._master.close()


class EthercatClient:
    """A process in the network of the cable."""

    async def open(self, program: MockProgram) -> None:
        cable = program.ready_event["endpoints"]["ethercat"]
        self._process = await asyncio.create_subprocess_exec(
            *("nsenter", "-t", str(cable["join"]), "-U", "-n", "--preserve-credentials"),
            *(sys.executable, str(Path(__file__).with_name("ethercat_client.py")), cable["path"]),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
        )
        await self._line()

    async def _line(self) -> None:
        assert self._process.stdout is not None
        assert await asyncio.wait_for(self._process.stdout.readline(), PATIENCE_S)

    async def _ask(self, word: bytes) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(word)
        await self._line()

    async def read(self) -> None:
        await self._ask(b"read\n")

    async def write(self) -> None:
        await self._ask(b"write\n")

    async def close(self) -> None:
        self._process.kill()
        await self._process.wait()


class ProfinetClient:
    """Reads and writes the record of slot 3."""

    async def open(self, program: MockProgram) -> None:
        self._controller = await Controller.join(program)
        await self._controller.supervise()

    async def read(self) -> None:
        await self._controller.read(3, 3)

    async def write(self) -> None:
        await self._controller.write(3, 3, b"\7\0")

    async def close(self) -> None:
        await self._controller.close()


class LatchClient(StreamClient):
    async def read(self) -> None:
        await self.exchange(b"\0", 1, lambda head: 0)

    async def write(self) -> None:
        await self.exchange(b"\7", 1, lambda head: 0)


# -- cases ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """The facts about one protocol that the suite needs.

    Attributes:
        client: function that makes a client.
        connectionless: a client has no connection whose beginning and end the journal could have.
        on_cable: the device is at the end of a cable, which not every machine allows.
        one_client: several clients cannot be told apart, because they share one line.
        asked_by_connecting: kinds of the requests that opening and closing a connection make.
        asked_by_reading, asked_by_writing: kind of the one request that ``read`` or ``write`` makes.
        written: the point that ``write`` changes, and its new value.
        poke, poked: a poke, and the point that it changes with its new value.
        wrong_pokes: pokes that must be refused, each with words of the refusal.
        fault: a rule that applies to the request of ``read``.
        wrong_rules: rules that must be refused, each with words of the refusal.
    """

    client: Callable[[], AnyClient]
    connectionless: bool = False
    on_cable: bool = False
    one_client: bool = False
    asked_by_connecting: Sequence[str] = ()
    asked_by_reading: str
    asked_by_writing: str
    written: tuple[str, Any]
    poke: Mapping[str, Any]
    poked: tuple[str, Any]
    wrong_pokes: Sequence[tuple[Mapping[str, Any], str]]
    fault: Mapping[str, Any]
    wrong_rules: Sequence[tuple[Mapping[str, Any], str]]


def encoded(text: bytes) -> str:
    return base64.b64encode(text).decode()


CASES = {
    "modbus": Case(
        client=ModbusClient,
        asked_by_reading="request",
        asked_by_writing="request",
        written=("1/holding_registers/50", 7),
        poke={"unit": 1, "table": "holding_registers", "address": 51, "values": [8]},
        poked=("1/holding_registers/51", 8),
        wrong_pokes=[
            ({}, "the poke lacks 'table'"),
            ({"table": "registers", "address": 0, "values": [1]}, "unknown table 'registers'"),
            ({"table": "coils", "address": 99, "values": [True, True]}, "the device has 0..99"),
            ({"table": "coils", "address": -1, "values": [True]}, "the device has 0..99"),
            ({"table": "coils", "address": 0, "values": [1]}, "expected booleans, found 1"),
            ({"table": "holding_registers", "address": 0, "values": [65536]}, "found 65536"),
            ({"table": "holding_registers", "address": 0, "values": [True]}, "found True"),
            ({"table": "holding_registers", "address": 0, "values": ["1"]}, "found '1'"),
            ({"table": "holding_registers", "address": "0", "values": [1]}, "integer address"),
            ({"unit": 2, "table": "coils", "address": 0, "values": []}, "unit 2 is not configured"),
            ({"unit": [], "table": "coils", "address": 0, "values": []}, "unit [] is not configured"),
        ],
        fault={"function": 3, "action": {"exception": 4}},
        wrong_rules=[
            ({"drop": True, "action": {"drop": True}}, "unknown member 'drop'"),
            ({"action": {"times": 1}}, "unknown member 'times'"),
            ({"action": {"exception": "2"}}, "cannot have '2' as 'exception': expected an integer from 0 to 255"),
            ({"action": {"exception": 256}}, "cannot have 256 as 'exception'"),
            ({"action": {"delay_s": -1}}, "cannot have -1 as 'delay_s': expected a number from 0 to 3600"),
            ({"action": {"drop": 1}}, "cannot have 1 as 'drop': expected true or false"),
            ({"action": {"answer_values": [70000]}}, "as 'answer_values'"),
            ({"function": True, "action": {"drop": True}}, "cannot have True as 'function'"),
        ],
    ),
    "mqtt": Case(
        client=MqttClient,
        asked_by_connecting=["CONNECT"],
        asked_by_reading="SUBSCRIBE",
        asked_by_writing="PUBLISH",
        written=("retained/contract", encoded(b"7")),
        poke={"publish": {"topic": "poked", "payload": encoded(b"8"), "retain": True}},
        poked=("retained/poked", encoded(b"8")),
        wrong_pokes=[
            ({}, "an MQTT poke is"),
            ({"publish": {"topic": "a"}}, "an MQTT poke is"),
            ({"publish": {"topic": "a/#", "payload": ""}}, "wildcard"),
            ({"publish": {"topic": "", "payload": ""}}, "empty"),
            ({"publish": {"topic": "a", "payload": "%"}}, "base64"),
            ({"publish": {"topic": "a", "payload": "", "qos": 3}}, "qos"),
        ],
        fault={"packet": "SUBSCRIBE", "action": {"reason_code": 0x80}},
        wrong_rules=[
            ({"packet": "PUBLISH"}, "needs one action"),
            ({"packet": "PUBLISH", "action": {"close": True, "reset": True}}, "needs one action"),
            ({"packet": "PUBLISHED", "action": {"close": True}}, "cannot have 'PUBLISHED' as 'packet'"),
            ({"action": {"close": True}}, "needs 'packet', one of CONNECT, PUBLISH"),
            ({"packet": "PINGREQ", "action": {"reason_code": 0x80}}, "no answer to PINGREQ"),
            ({"packet": "SUBSCRIBE", "action": {"reason_code": 3}}, "no answer to SUBSCRIBE"),
            ({"packet": "PUBLISH", "topic": 7, "action": {"close": True}}, "cannot have 7 as 'topic'"),
            ({"packet": "PUBLISH", "action": {"delay_s": "1"}}, "cannot have '1' as 'delay_s'"),
        ],
    ),
    "opcua": Case(
        client=OpcUaClient,
        asked_by_reading="Read",
        asked_by_writing="Write",
        written=("ns=2;s=FanSpeed", 77.0),
        poke={"node": "HeaterPower", "value": 88.0},
        poked=("ns=2;s=HeaterPower", 88.0),
        wrong_pokes=[
            ({}, "the poke lacks 'node'"),
            ({"node": "Nobody", "value": 1}, "no variable 'Nobody'"),
            ({"node": "FanSpeed", "value": "fast"}, "'fast' does not fit into Double"),
            ({"node": "FanSpeed", "value": True}, "True does not fit into Double"),
            ({"node": "FanSpeed", "value": [1.0]}, "does not fit the variable's rank"),
            ({"node": "Uptime", "value": -1}, "-1 does not fit into UInt32"),
            ({"node": "Uptime", "value": 2**32}, "4294967296 does not fit into UInt32"),
            ({"node": "FanSpeed", "value": 1.0, "status": "BadMood"}, "unknown status code 'BadMood'"),
            ({"limits": {"patience": 1}}, "limits: patience=1; known are"),
            ({"create": [{"variable": "X", "type": "Colour", "value": 1}]}, "create variable 'X': KeyError 'Colour'"),
            (
                {"create": [{"variable": "X", "type": "Int32", "value": 1, "in": "Nowhere"}]},
                "there is no folder or variable 'Nowhere'",
            ),
            ({"create": [{"castle": "X"}]}, "create: expected one of folder, variable"),
        ],
        fault={"service": "Read", "action": {"status": "BadSensorFailure"}},
        wrong_rules=[
            ({"action": {"status": "BadMood"}}, "cannot have 'BadMood' as 'status'"),
            ({"action": {"status": "name"}}, "expected the symbol of a status code"),
            ({"action": {"drop": 1}}, "cannot have 1 as 'drop'"),
            (
                {"action": {"drop": True}, "times": "often"},
                "cannot have 'often' as 'times': expected an integer from 0",
            ),
        ],
    ),
    "s7": Case(
        client=S7ContractClient,
        asked_by_reading="request",
        asked_by_writing="request",
        written=("DB10.DBB50", 7),
        poke={"area": "DB10", "byte": 51, "data": "08"},
        poked=("DB10.DBB51", 8),
        wrong_pokes=[
            ({}, "the poke lacks 'data'"),
            ({"area": "DB99", "byte": 0, "data": "00"}, "unknown area 'DB99'"),
            ({"area": "DB10", "byte": "0", "data": "00"}, "it has 0..63"),
            ({"area": "DB10", "byte": 0, "data": [0]}, "hexadecimal digits, found [0]"),
        ],
        fault={"service": "read", "action": {"error": 0x8104}},
        wrong_rules=[
            ({"action": {"error": 0}}, "cannot have 0 as 'error': expected an integer from 1 to 65535"),
            ({"service": "wish", "action": {"drop": True}}, "cannot have 'wish' as 'service'"),
            ({"action": {"answer_data": "0"}}, "cannot have '0' as 'answer_data'"),
        ],
    ),
    "bacnet": Case(
        client=BacnetClient,
        connectionless=True,
        asked_by_reading="request",
        asked_by_writing="request",
        written=("binary-value,1/present-value", 0),
        poke={"object": "analog-input,1", "value": 70.5},
        poked=("analog-input,1/present-value", 70.5),
        wrong_pokes=[
            ({}, "the poke lacks 'object'"),
            ({"object": "analog-input,7", "value": 1.0}, "there is no object 'analog-input,7'"),
            ({"object": "analog input", "value": 1.0}, "there is no object 'analog input'"),
            ({"object": "analog-input,1"}, "the poke lacks 'value'"),
            ({"object": "analog-input,1", "value": True}, "holds real values, not True"),
            ({"object": "analog-input,1", "value": 1e300}, "cannot hold 1e+300"),
            ({"object": "binary-value,1", "value": 2}, "binary-value,1 cannot hold 2"),
            ({"object": "analog-input,1", "priority": 8, "value": 1.0}, "analog-input,1 has no priority 8"),
            ({"object": "analog-output,1", "priority": 17, "value": 1.0}, "has no priority 17"),
            ({"object": "analog-input,1", "reliability": -1}, "reliability: expected an integer from 0 to 63"),
            ({"objects": 1001}, "objects: expected an integer from 0 to 1000"),
            ({"network": "rainy"}, "one of open, black_hole, stalled"),
        ],
        fault={"service": 12, "action": {"error": [0, 25]}},
        wrong_rules=[
            ({"action": {"error": [1]}}, "expected a list of error class and error code"),
            ({"action": {"answer_values": [{"type": "real", "value": "x"}]}}, "as 'answer_values'"),
            ({"action": {"clamp": [2, 1]}}, "the lower one first"),
            ({"object": "analog-input", "action": {"drop": True}}, "such as 'analog-input,1'"),
        ],
    ),
    "ethernetip": Case(
        client=EthernetIpClient,
        asked_by_reading="request",
        asked_by_writing="request",
        written=("FanSpeed", 7),
        poke={"tag": "Levels[2]", "value": 8.5},
        poked=("Levels[2]", 8.5),
        wrong_pokes=[
            ({}, "the poke lacks 'tag'"),
            ({"tag": "Nobody", "value": 1}, "there is no tag 'Nobody'"),
            ({"tag": ["FanSpeed"], "value": 1}, "there is no tag ['FanSpeed']"),
            ({"tag": "FanSpeed", "value": True}, "a DINT cannot hold True"),
            ({"tag": "FanSpeed", "value": [1]}, "a DINT cannot hold [1]"),
            ({"connection_limit": True}, "connection_limit: expected an integer"),
        ],
        fault={"service": "read", "action": {"status": 5}},
        wrong_rules=[
            ({"action": {"status": 0}}, "cannot have 0 as 'status': expected an integer from 1 to 255"),
            ({"service": "wish", "action": {"drop": True}}, "cannot have 'wish' as 'service'"),
            ({"tag": 7, "action": {"drop": True}}, "cannot have 7 as 'tag'"),
            ({"action": {"answer_data": "0"}}, "cannot have '0' as 'answer_data'"),
        ],
    ),
    "dnp3": Case(
        client=Dnp3Client,
        asked_by_reading="request",
        asked_by_writing="request",
        written=("binary_output/2", True),
        poke={"point": "analog_input/1", "value": 8},
        poked=("analog_input/1", 8),
        wrong_pokes=[
            ({}, "the poke lacks 'point'"),
            ({"point": "analog_input/9", "value": 1}, "there is no point 'analog_input/9'"),
            ({"point": "analog_input/1"}, "the poke lacks 'value'"),
            ({"point": "analog_input/1", "value": True}, "of the kind int32, not True"),
            ({"point": "analog_input/1", "flags": "ONLINE"}, "flags: expected a list of ONLINE"),
            ({"select_timeout_s": -1}, "expected a number from 0 to 3600"),
            ({"network": "rainy"}, "one of open, black_hole, stalled"),
        ],
        fault={"function": 1, "action": {"iin": 0x0400}},
        wrong_rules=[
            ({"action": {"iin": 0x10000}}, "cannot have 65536 as 'iin'"),
            ({"action": {"status": 0}}, "cannot have 0 as 'status': expected an integer from 1 to 127"),
            ({"function": 129, "action": {"drop": True}}, "cannot have 129 as 'function'"),
            ({"action": {"answer_objects": "0"}}, "as 'answer_objects'"),
        ],
    ),
    "profibus": Case(
        client=ProfibusClient,
        connectionless=True,
        one_client=True,
        asked_by_reading="request",
        asked_by_writing="request",
        written=("8.output.7", 7),
        poke={"station": 9, "inputs": "08"},
        poked=("9.input.0", 8),
        wrong_pokes=[
            ({}, "the poke lacks 'station'"),
            ({"station": 7, "inputs": "00"}, "there is no station 7; there are 5, 8, 9"),
            ({"station": "5", "inputs": "0000"}, "there is no station '5'"),
            ({"station": 5}, "a poke has 'station' and one of inputs, outputs"),
            ({"station": 5, "inputs": "0000", "outputs": "0000"}, "one of inputs, outputs"),
            ({"station": 5, "inputs": "00"}, "inputs: expected 2 byte(s), found 1"),
            ({"station": 5, "outputs": [0, 0]}, "hexadecimal digits, found [0, 0]"),
            ({"station": 5, "master": 127}, "an integer from 0 to 126 or null"),
            ({"station": 5, "present": 1}, "expected true or false, found 1"),
            ({"station": 5, "ident": "12"}, "ident: expected 2 bytes"),
            ({"station": 5, "diagnosis": "00" * 239}, "at most 238 bytes"),
            ({"network": "rainy"}, "one of open, black_hole, stalled"),
        ],
        fault={"service": "rd_inp", "action": {"error": 3}},
        wrong_rules=[
            ({"action": {"error": 0}}, "cannot have 0 as 'error': expected an integer from 1 to 15"),
            ({"service": "wish", "action": {"drop": True}}, "cannot have 'wish' as 'service'"),
            ({"station": 128, "action": {"drop": True}}, "cannot have 128 as 'station'"),
            ({"action": {"answer_data": "0"}}, "at most 244 bytes as hexadecimal digits"),
        ],
    ),
    "ethercat": Case(
        client=EthercatClient,
        connectionless=True,
        on_cable=True,
        one_client=True,
        asked_by_reading="request",
        asked_by_writing="request",
        written=("1:2001:2", 7),
        poke={"slave": 0, "inputs": "0802"},
        poked=("0.input.0", 8),
        wrong_pokes=[
            ({}, "the poke lacks 'slave'"),
            ({"slave": 2, "inputs": "00"}, "there is no slave 2; there are 0 to 1"),
            ({"slave": 0}, "a poke has 'slave' and one of inputs, object"),
            ({"slave": 0, "inputs": "00"}, "inputs: expected 2 bytes, found 1"),
            ({"slave": 1, "object": [1, 1], "data": "00"}, "slave 1 has no object [1, 1]"),
            ({"slave": 1, "refuses": 0}, "an integer from 1 to 65535"),
            ({"slave": 1, "present": 1}, "expected true or false, found 1"),
            ({"network": "rainy"}, "one of open, black_hole, stalled"),
        ],
        fault={"service": "sdo_upload", "action": {"abort": 1}},
        wrong_rules=[
            ({"action": {"abort": 0}}, "cannot have 0 as 'abort'"),
            ({"service": "wish", "action": {"drop": True}}, "cannot have 'wish' as 'service'"),
            ({"slave": 2, "action": {"drop": True}}, "cannot have 2 as 'slave'"),
        ],
    ),
    "profinet": Case(
        client=ProfinetClient,
        connectionless=True,
        on_cable=True,
        one_client=True,
        asked_by_reading="request",
        asked_by_writing="request",
        written=("3.1.record.3.0", 7),
        poke={"slot": 3, "inputs": "08d5"},
        poked=("3.1.input.0", 8),
        wrong_pokes=[
            ({}, "a poke has the members of one of these"),
            ({"slot": 9, "inputs": "00"}, "there is no slot 9; there are 0, 1, 2, 3, 4"),
            ({"slot": 3}, "found ['slot']"),
            ({"slot": 3, "inputs": "00"}, "inputs: expected 2 byte(s)"),
            ({"slot": 3, "index": 9, "record": "00"}, "there is no record 9; there are "),
            ({"controller": 1}, "controller: expected true or false, found 1"),
            ({"station": "nobody", "present": False}, "there is no station 'nobody'"),
            ({"network": "rainy"}, "one of open, black_hole, stalled"),
        ],
        fault={"service": "read", "action": {"error": 3}},
        wrong_rules=[
            ({"action": {"error": 0}}, "cannot have 0 as 'error'"),
            ({"service": "wish", "action": {"drop": True}}, "cannot have 'wish' as 'service'"),
            ({"action": {"answer_data": "0"}}, "as 'answer_data'"),
        ],
    ),
    "thirdparty.latches": Case(
        client=LatchClient,
        asked_by_reading="ASK",
        asked_by_writing="SET",
        written=("stream", 7),
        poke={"latch": "line", "value": 8},
        poked=("line", 8),
        wrong_pokes=[({}, "the poke lacks 'latch'"), ({"latch": "none", "value": 8}, "there is no latch 'none'")],
        fault={"action": {"answer": 9}},
        wrong_rules=[({"action": {"answer": 256}}, "cannot have 256 as 'answer'")],
    ),
}


# -- fixtures -------------------------------------------------------------------------------------------------


@pytest_asyncio.fixture(scope="module", loop_scope="module", params=CASES)
async def program(request: pytest.FixtureRequest) -> AsyncIterator[MockProgram]:
    if CASES[request.param].on_cable and (refusal := cable_refused()) is not None:
        pytest.skip(f"no cable here: {refusal}")
    started = await MockProgram.start(request.param)
    try:
        await started.ready()
        yield started
    finally:
        _, stderr = await started.end()
    assert stderr == ""


@pytest.fixture
def case(program: MockProgram) -> Case:
    return CASES[program.ready_event["protocol"]]


@pytest_asyncio.fixture(loop_scope="module")
async def plant(program: MockProgram) -> MockProgram:
    """The mock with its start-up values, and a journal without entries."""
    await program.control.ask("reset")
    await program.control.forget()
    return program


@pytest_asyncio.fixture(loop_scope="module")
async def client(plant: MockProgram, case: Case) -> AsyncIterator[AnyClient]:
    """A connected client; when the test ends it disconnects, and the fixture waits until the device has noticed."""
    opened = case.client()
    mark = await plant.control.next()
    await opened.open(plant)
    if case.connectionless:
        yield opened
        await opened.close()
        return
    (entry, *_) = await plant.control.wait(mark, kind="CONNECTED")
    yield opened
    await opened.close()
    await plant.control.wait(mark, kind="DISCONNECTED", connection=entry["connection"])


def of_clients(entries: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    return [entry for entry in entries if entry["origin"] == "client"]


def changes(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in after.items() if name not in before or before[name] != value}


# -- the suite ------------------------------------------------------------------------------------------------


async def test_every_built_in_device_has_a_case() -> None:
    # The simulator of an edge node is a client of another broker: no client connects to it.
    assert set(built_in()) - {"sparkplug"} <= set(CASES)


# the control channel


async def test_the_ready_line_and_the_control_channel_say_the_same(program: MockProgram) -> None:
    event = program.ready_event
    ready = await program.control.ask("ready")
    assert ready["protocol"] in event["protocol"]
    assert (ready["port"], ready["pid"]) == (event["port"], event["pid"])
    assert event["pid"] != program.process.pid
    first = next(iter(event["endpoints"].values()))
    assert (first.get("host"), first.get("port")) == (event["host"], event["port"])


async def test_the_control_socket_is_in_a_directory_of_this_user_alone(program: MockProgram) -> None:
    control = os.stat(program.ready_event["control"])
    directory = os.stat(os.path.dirname(program.ready_event["control"]))
    assert stat.S_ISSOCK(control.st_mode)
    assert (stat.S_IMODE(directory.st_mode), directory.st_uid) == (0o700, os.getuid())


def shown_by_the_kernel(*pids: int) -> list[bytes]:
    """Return what /proc shows this user of these processes, and of all Unix sockets."""
    shown = [Path("/proc/net/unix").read_bytes()]
    for pid in pids:
        process = Path("/proc") / str(pid)
        shown.append((process / "cmdline").read_bytes())
        # They hide their memory: to any user but root this is not shown.
        with contextlib.suppress(PermissionError):
            shown.append((process / "environ").read_bytes())
            shown += [os.readlink(link).encode() for link in (process / "fd").iterdir()]
    return shown


async def test_the_path_of_the_control_socket_is_told_in_the_ready_line_alone(program: MockProgram) -> None:
    directory = os.path.dirname(program.ready_event["control"]).encode()
    shown = shown_by_the_kernel(program.process.pid, program.ready_event["pid"])
    assert [text for text in shown if directory in text] == []


async def test_a_device_can_be_reached_at_its_endpoints_and_nowhere_else(program: MockProgram) -> None:
    # What comes by another door would be the plant's, or nobody's.
    try:
        sockets = psutil.Process(program.ready_event["pid"]).net_connections("inet")
    except psutil.AccessDenied:
        pytest.skip("of a process that hides its memory only root sees the sockets")
    doors = [one.laddr for one in sockets if one.status in (psutil.CONN_LISTEN, psutil.CONN_NONE)]
    told = {(one["host"], one["port"]) for one in program.ready_event["endpoints"].values() if "port" in one}
    assert set(doors) == told


# the journal


async def test_every_entry_has_the_fields_of_the_contract(plant: MockProgram, client: AnyClient) -> None:
    await plant.control.ask("tick", steps=1)
    await client.read()
    await client.write()
    entries = await plant.control.journal()
    assert [entry["seq"] for entry in entries] == list(range(entries[0]["seq"], entries[-1]["seq"] + 1))
    assert [entry["t_ns"] for entry in entries] == sorted(entry["t_ns"] for entry in entries)
    by_seq = {entry["seq"]: entry for entry in entries}
    for entry in entries:
        assert set(JournalEntry.__annotations__) - {"frame", "process", "told"} <= set(entry), entry
        assert {type(entry[name]) for name in ("seq", "t_ns", "connection")} == {int}
        assert {type(entry[name]) for name in ("request", "state_changing")} == {bool}
        assert entry["direction"] in ("in", "out")
        assert entry["origin"] in ("client", "plant", "kit")
        assert entry["kind"]
        if entry["request"]:
            assert (entry["direction"], entry["origin"], entry["answers"]) == ("in", "client", None)
        if entry["state_changing"]:
            assert entry["request"]
        if entry["answers"] is not None:
            asked = by_seq[entry["answers"]]
            assert entry["direction"] == "out"
            assert asked["direction"] == "in"
            assert asked["seq"] < entry["seq"]
            assert asked["connection"] == entry["connection"]


async def test_a_read_is_one_answered_request_that_changes_nothing(
    plant: MockProgram, case: Case, client: AnyClient
) -> None:
    before, mark = await plant.control.points(), await plant.control.next()
    await client.read()
    entries = of_clients(await plant.control.journal(mark))
    [asked] = [entry for entry in entries if entry["request"]]
    assert (asked["kind"], asked["state_changing"]) == (case.asked_by_reading, False)
    [answer] = [entry for entry in entries if entry["answers"] is not None]
    assert answer["answers"] == asked["seq"]
    assert await plant.control.points() == before


async def test_a_write_is_one_answered_request_that_changes_one_point(
    plant: MockProgram, case: Case, client: AnyClient
) -> None:
    before, mark = await plant.control.points(), await plant.control.next()
    await client.write()
    entries = of_clients(await plant.control.journal(mark))
    [asked] = [entry for entry in entries if entry["state_changing"]]
    assert (asked["kind"], asked["request"]) == (case.asked_by_writing, True)
    assert [entry for entry in entries if entry["request"]] == [asked]
    [answer] = [entry for entry in entries if entry["answers"] is not None]
    assert answer["answers"] == asked["seq"]
    after = await plant.control.points()
    assert changes(before, after) == dict([case.written])
    assert before.keys() <= after.keys()


async def test_every_answer_is_linked_to_its_own_request(plant: MockProgram, client: AnyClient) -> None:
    mark = await plant.control.next()
    for _ in range(5):
        await client.read()
        await client.write()
    entries = of_clients(await plant.control.journal(mark))
    requests = [entry["seq"] for entry in entries if entry["request"]]
    assert len(requests) == 10
    assert [entry["answers"] for entry in entries if entry["answers"] is not None] == requests


async def test_session_keeping_asks_for_nothing(plant: MockProgram, case: Case) -> None:
    if case.connectionless:
        pytest.skip("its clients keep no session")
    mark = await plant.control.next()
    passing = case.client()
    await passing.open(plant)
    await passing.close()
    await plant.control.wait(mark, kind="DISCONNECTED")
    entries = of_clients(await plant.control.journal(mark))
    assert [entry["kind"] for entry in entries if entry["request"]] == list(case.asked_by_connecting)
    assert [entry for entry in entries if entry["state_changing"]] == []
    kinds = [entry["kind"] for entry in entries]
    assert (kinds[0], kinds[-1]) == ("CONNECTED", "DISCONNECTED")
    assert len({entry["connection"] for entry in entries}) == 1


async def test_connections_are_told_apart(plant: MockProgram, case: Case, client: AnyClient) -> None:
    if case.one_client:
        pytest.skip("its clients share a line")
    mark = await plant.control.next()
    other = case.client()
    await other.open(plant)
    await other.read()
    await client.read()
    await other.close()
    ended = [] if case.connectionless else await plant.control.wait(mark, kind="DISCONNECTED")
    first, second = await plant.control.journal(mark, request=True, kind=case.asked_by_reading)
    assert first["connection"] != second["connection"]
    assert {entry["connection"] for entry in ended} <= {first["connection"]}


async def test_released_records_are_gone_and_the_answer_says_so(plant: MockProgram, client: AnyClient) -> None:
    await client.read()
    await client.read()
    whole = await plant.control.ask("journal", since=0)
    third = whole["first"] + 2
    assert await plant.control.ask("forget", before=third) == {"first": third, "next": whole["next"]}
    rest = await plant.control.ask("journal", since=0)
    assert (rest["first"], rest["next"], rest["dropped"]) == (third, whole["next"], whole["dropped"])
    assert rest["records"] == whole["records"][2:]
    # Released records stay released, and the numbers continue.
    assert await plant.control.ask("forget", before=0) == {"first": third, "next": whole["next"]}
    await plant.control.ask("forget", before=whole["next"])
    await client.read()
    again = await plant.control.ask("journal", since=0)
    assert again["first"] == again["records"][0]["number"] == whole["next"]
    assert await plant.control.ask("wait", since=0, timeout_s=0) == again


# the plant


async def test_points_are_flat(plant: MockProgram) -> None:
    found = await plant.control.points()
    assert found
    assert [name for name, value in found.items() if isinstance(value, dict)] == []


async def test_a_poke_changes_what_it_names_and_is_no_request(plant: MockProgram, case: Case) -> None:
    before, mark = await plant.control.points(), await plant.control.next()
    await plant.control.ask("poke", params=case.poke)
    assert changes(before, await plant.control.points()) == dict([case.poked])
    entries = await plant.control.journal(mark)
    assert of_clients(entries) == []
    assert [entry for entry in entries if entry["request"] or entry["state_changing"]] == []
    assert {entry["connection"] for entry in entries if entry["origin"] == "kit"} <= {0}


async def test_a_poke_that_is_not_understood_is_refused_and_changes_nothing(plant: MockProgram, case: Case) -> None:
    before = await plant.control.image()
    for poke, words in case.wrong_pokes:
        with pytest.raises(RefusedError) as refusal:
            await plant.control.ask("poke", params=poke)
        assert words in str(refusal.value)
    assert await plant.control.image() == before


async def test_a_paused_plant_stands_still_and_a_tick_moves_it(plant: MockProgram) -> None:
    start = await plant.control.points()
    await plant.control.ask("tick", steps=0)
    assert await plant.control.points() == start
    await plant.control.ask("tick", steps=3)
    moved = await plant.control.points()
    assert moved != start
    assert moved.keys() == start.keys()


async def test_the_same_ticks_give_the_same_plant(plant: MockProgram) -> None:
    found = []
    for _ in range(2):
        await plant.control.ask("reset")
        await plant.control.ask("tick", steps=5)
        found.append(await plant.control.points())
    assert found[0] == found[1]


async def test_reset_brings_back_the_values_and_keeps_journal_and_connections(
    plant: MockProgram, case: Case, client: AnyClient
) -> None:
    start = await plant.control.points()
    await client.write()
    await plant.control.ask("tick", steps=5)
    await plant.control.ask("fault", rules=[case.fault])
    seen = of_clients(await plant.control.journal())
    await plant.control.ask("reset")
    assert await plant.control.points() == start
    assert await plant.control.ask("fault", rules=[]) == {"hits": []}
    assert of_clients(await plant.control.journal()) == seen
    mark = await plant.control.next()
    await client.read()
    [asked] = of_clients(await plant.control.journal(mark, request=True))
    assert asked["connection"] == seen[0]["connection"]


# faults


async def test_a_fault_plan_is_counted_and_replaced(plant: MockProgram, case: Case, client: AnyClient) -> None:
    assert await plant.control.ask("fault", rules=[{**case.fault, "times": 2}, case.fault]) == {"hits": []}
    for _ in range(3):
        await client.read()
    assert await plant.control.ask("fault", rules=[case.fault]) == {"hits": [2, 1]}
    assert await plant.control.ask("fault", rules=[]) == {"hits": [0]}


async def test_a_rule_that_is_not_understood_leaves_the_old_plan(
    plant: MockProgram, case: Case, client: AnyClient
) -> None:
    await plant.control.ask("fault", rules=[case.fault])
    action: Mapping[str, Any] = case.fault["action"]
    everywhere = [
        ({}, "action, for instance {'action': {"),
        ({**case.fault, "action": {}}, "action, for instance {'action': {"),
        ({**case.fault, "action": {"explode": True}}, "unknown member 'explode' of a fault rule; known are "),
        ({**case.fault, "colour": "red"}, "unknown member 'colour' of a fault rule; known are "),
        ({**case.fault, "times": -1}, "cannot have -1 as 'times'"),
        ({**case.fault, "times": True}, "cannot have True as 'times'"),
        ({**case.fault, "action": {name: [] for name in action}}, "cannot have [] as "),
    ]
    for rule, words in [*everywhere, *case.wrong_rules]:
        with pytest.raises(RefusedError) as refusal:
            await plant.control.ask("fault", rules=[case.fault, rule])
        assert words in str(refusal.value)
    await client.read()
    assert await plant.control.ask("fault", rules=[]) == {"hits": [1]}


# restarts; last, because the program goes on with another device


async def test_a_restart_keeps_the_address_and_forgets_everything_else(plant: MockProgram, case: Case) -> None:
    event, start = plant.ready_event, await plant.control.points()
    writer = case.client()
    await writer.open(plant)
    await writer.write()
    await writer.close()
    await plant.control.ask("fault", rules=[case.fault])
    await plant.restart()
    again = plant.ready_event
    assert {**again, "pid": 0} == {**event, "pid": 0}
    assert again["pid"] != event["pid"]
    # Only one point is compared: the simulation ran freely until it was paused.
    assert (await plant.control.points()).get(case.written[0]) == start.get(case.written[0])
    assert await plant.control.ask("fault", rules=[]) == {"hits": []}
    whole = await plant.control.ask("journal", since=0)
    assert (whole["first"], whole["dropped"], of_clients(await plant.control.journal())) == (0, 0, [])
    returning = case.client()
    await returning.open(plant)
    await returning.read()
    await returning.close()
    assert await plant.control.wait(kind=case.asked_by_reading, request=True)
