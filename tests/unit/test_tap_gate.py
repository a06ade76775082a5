"""The tap before a real device: no byte of a request that writes reaches it, unless a person consents.

The stand-in counts what reaches it. Each mutant of the tap lets one kind of request through, and the same stand-in shows it.
"""

from __future__ import annotations

import asyncio
import datetime
import re
import socket
import struct
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from asyncua import ua as untyped_ua
from asyncua.ua.ua_binary import struct_to_binary

from pytest_otmcp.core.errors import NoBindingError
from pytest_otmcp.errors import KitError, UsageError
from pytest_otmcp.plant.consent import read_consent
from pytest_otmcp.plant.endpoint import Endpoint
from pytest_otmcp.plant.field_device import FieldDevice, Gate
from pytest_otmcp.plant.field_dnp3 import Dnp3FieldDevice
from pytest_otmcp.plant.field_opcua import OpcUaClient
from pytest_otmcp.plant.tap.datagram import DatagramTap
from pytest_otmcp.plant.tap.lane import Lane
from pytest_otmcp.plant.tap.stream import StreamTap
from pytest_otmcp.plant.tap.tap import new_tap
from pytest_otmcp.protocols.bacnet.field import FIELD as BACNET
from pytest_otmcp.protocols.bacnet.field import UNHEARD
from pytest_otmcp.protocols.dnp3.field import FIELD as DNP3
from pytest_otmcp.protocols.field import Consent, Field, Writable
from pytest_otmcp.protocols.modbus.field import FIELD
from pytest_otmcp.protocols.opcua.field import FIELD as OPCUA
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.protocols.s7.field import FIELD as S7
from pytest_otmcp.wire.dnp3.link import crc
from pytest_otmcp.wire.modbus import frame
from pytest_otmcp.wire.s7 import JOB, USER_DATA, Pdu, data_frame

asynchronous = pytest.mark.asyncio
ua: Any = untyped_ua

READ = frame(1, 1, bytes.fromhex("03 0000 0004"))
"""What passes; in each case it comes first, so that the tap has connected."""
ALLOWED = frame(2, 1, bytes.fromhex("06 0064 0005"))

NEVER = {
    "a register": frame(2, 1, bytes.fromhex("06 0001 0007")),
    "a coil": frame(2, 1, bytes.fromhex("05 0001 FF00")),
    "registers": frame(2, 1, bytes.fromhex("10 0001 0001 02 0007")),
    "coils": frame(2, 1, bytes.fromhex("0F 0001 0001 01 01")),
    "a mask": frame(2, 1, bytes.fromhex("16 0064 FFFF 0005")),
    "read and write": frame(2, 1, bytes.fromhex("17 0000 0001 0064 0001 02 0005")),
    "a restart of communication": frame(2, 1, bytes.fromhex("08 0001 0000")),
    "a file record": frame(2, 1, bytes.fromhex("15 09 06 0001 0000 0001 0005")),
    "CANopen": frame(2, 1, bytes.fromhex("2B 0D 00 00")),
    "a vendor's own function": frame(2, 1, bytes.fromhex("5A 00 02")),
    "function 0": frame(2, 1, bytes.fromhex("00 0000 0000")),
    "an answer": frame(2, 1, bytes.fromhex("83 02")),
    "a read and more": frame(2, 1, bytes.fromhex("03 0000 0004 06 0001 0007")),
    "a read that is cut off": frame(2, 1, bytes.fromhex("03 0000")),
    "another unit": frame(2, 2, bytes.fromhex("06 0064 0005")),
    "every unit": frame(2, 0, bytes.fromhex("06 0064 0005")),
    "another address": frame(2, 1, bytes.fromhex("06 0068 0005")),
    "the address before": frame(2, 1, bytes.fromhex("06 0063 0005")),
    "the same coil": frame(2, 1, bytes.fromhex("05 0064 0000")),
    "too large a value": frame(2, 1, bytes.fromhex("06 0064 01F5")),
    "a block across the end": frame(2, 1, bytes.fromhex("10 0067 0002 04 0005 0005")),
    "a block with one value too large": frame(2, 1, bytes.fromhex("10 0064 0002 04 0005 01F5")),
    "a block of another length than it says": frame(2, 1, bytes.fromhex("10 0064 0002 02 0005 0005")),
    "more bytes than the block": frame(2, 1, bytes.fromhex("10 0064 0001 04 0005 0005")),
    "a block of nothing": frame(2, 1, bytes.fromhex("10 0064 0000 00")),
    "a register and more": frame(2, 1, bytes.fromhex("06 0064 0005 00")),
}
"""What never passes a tap with the consent below, open or not. A device may understand more than the kit does."""

UNCUT = {
    "another protocol": ALLOWED[:2] + b"\0\1" + ALLOWED[4:],
    "no length": struct.pack(">HHHB", 2, 0, 0, 1) + ALLOWED,
    "half a frame": ALLOWED[:-1],
}

CONSENT = Consent(
    device="modbus=tcp://127.0.0.1:1502",
    identity=None,
    name="a test",
    date=datetime.date(2026, 1, 1),
    expires=datetime.date(2026, 12, 31),
    writable=(Writable(target="1/holding_registers/100..103", lowest=0, highest=500),),
)


async def reached(gate: Callable[[bytes], bool], *sent: bytes, key: str = "modbus", first: bytes = READ) -> bytes:
    """Return all bytes that reach a stand-in behind a guarded tap, of a client that sends what passes, these bytes, and its end."""
    arrived, over = bytearray(), asyncio.Event()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while data := await reader.read(4096):
                arrived.extend(data)
                writer.write(data)
        except ConnectionResetError:
            pass
        finally:
            writer.close()
            over.set()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    tap = StreamTap("127.0.0.1", server.sockets[0].getsockname()[1], framing=protocols()[key].framing, gate=gate)
    await tap.start()
    reader, writer = await asyncio.open_connection("127.0.0.1", tap.port)
    try:
        writer.write(first)
        assert await asyncio.wait_for(reader.readexactly(len(first)), 60) == first
        for data in sent:
            writer.write(data)
        writer.write_eof()
        await asyncio.wait_for(over.wait(), 60)
    finally:
        writer.transport.abort()
        await tap.aclose()
        server.close()
    return bytes(arrived).removeprefix(first)


def gate(*, is_open: bool, field: Field = FIELD, consent: Consent | None = CONSENT) -> Gate:
    made = Gate(field, consent)
    made.is_open = is_open
    return made


@asynchronous
@pytest.mark.parametrize("is_open", [False, True])
@pytest.mark.parametrize("kind", NEVER)
async def test_what_nobody_consents_to_never_reaches_the_device(kind: str, is_open: bool) -> None:
    assert await reached(gate(is_open=is_open), NEVER[kind]) == b""


@asynchronous
@pytest.mark.parametrize("kind", UNCUT)
async def test_what_cannot_be_cut_never_reaches_the_device_nor_does_anything_after_it(kind: str) -> None:
    # What follows half a frame is its other half.
    after = () if kind == "half a frame" else (READ, ALLOWED)
    assert await reached(gate(is_open=True), UNCUT[kind], *after) == b""


@asynchronous
async def test_a_consented_write_passes_while_the_tap_is_open_for_it() -> None:
    opened = gate(is_open=True)
    block = frame(3, 1, bytes.fromhex("10 0064 0002 04 0005 01F4"))
    assert await reached(opened, ALLOWED, block, READ) == ALLOWED + block + READ
    assert opened.passed == {"1/holding_registers/100": [5, 5], "1/holding_registers/101": [500]}
    shut = gate(is_open=False)
    assert await reached(shut, ALLOWED, READ) == READ
    assert shut.passed == {}
    assert await reached(gate(is_open=True, consent=None), ALLOWED, READ) == READ


@asynchronous
async def test_a_read_in_the_same_segment_as_a_write_passes_alone() -> None:
    assert await reached(gate(is_open=False), NEVER["a register"] + READ + NEVER["a coil"]) == READ


# -- mutants of the tap ---------------------------------------------------------------------------------------------------


def also(function: int) -> Field:
    """A field that takes one more function for harmless."""
    return replace(FIELD, harmless=lambda frame: frame[7] == function or FIELD.harmless(frame))


FUNCTIONS = {
    "a register": 6,
    "a coil": 5,
    "registers": 16,
    "coils": 15,
    "a mask": 22,
    "read and write": 23,
    "a restart of communication": 8,
    "a file record": 21,
    "CANopen": 43,
    "a vendor's own function": 0x5A,
    "function 0": 0,
    "an answer": 0x83,
    "a read and more": 3,
    "a read that is cut off": 3,
}


@asynchronous
@pytest.mark.parametrize(("kind", "function"), FUNCTIONS.items())
async def test_a_tap_that_lets_one_function_through_is_noticed(kind: str, function: int) -> None:
    assert await reached(gate(is_open=False, field=also(function)), NEVER[kind]) == NEVER[kind]


def without_unit(frame: bytes) -> Mapping[str, object] | None:
    return FIELD.written(frame[:6] + b"\1" + frame[7:])


def without_lengths(frame: bytes) -> Mapping[str, object] | None:
    if frame[7] == 16:
        return {"1/holding_registers/100": 5}
    return FIELD.written(frame[:5] + b"\6" + frame[6:12])


class _AnyRegister(Consent):
    def allows(self, written: Mapping[str, object]) -> bool:
        return "coils" not in str(written) and "2/" not in str(written)


class _FirstValue(Consent):
    def allows(self, written: Mapping[str, object]) -> bool:
        return super().allows(dict([next(iter(written.items()))]))


class _AnyTable(Consent):
    def allows(self, written: Mapping[str, object]) -> bool:
        return super().allows(
            {name.replace("coils", "holding_registers"): int(value == 1) for name, value in written.items()}
        )


def told_by(kind: type[Consent]) -> Consent:
    return kind(**{name: getattr(CONSENT, name) for name in CONSENT.__slots__})


MUTANTS = {
    "another unit": gate(is_open=True, field=replace(FIELD, written=without_unit)),
    "every unit": gate(is_open=True, field=replace(FIELD, written=without_unit)),
    "another address": gate(is_open=True, consent=told_by(_AnyRegister)),
    "the address before": gate(is_open=True, consent=told_by(_AnyRegister)),
    "the same coil": gate(is_open=True, consent=told_by(_AnyTable)),
    "too large a value": gate(is_open=True, consent=told_by(_AnyRegister)),
    "a block across the end": gate(is_open=True, consent=told_by(_FirstValue)),
    "a block with one value too large": gate(is_open=True, consent=told_by(_FirstValue)),
    "a block of another length than it says": gate(is_open=True, field=replace(FIELD, written=without_lengths)),
    "more bytes than the block": gate(is_open=True, field=replace(FIELD, written=without_lengths)),
    "a block of nothing": gate(is_open=True, field=replace(FIELD, written=without_lengths)),
    "a register and more": gate(is_open=True, field=replace(FIELD, written=without_lengths)),
}


@asynchronous
@pytest.mark.parametrize("kind", MUTANTS)
async def test_a_tap_that_lets_one_kind_of_write_through_is_noticed(kind: str) -> None:
    assert await reached(MUTANTS[kind], NEVER[kind]) == NEVER[kind]


def test_every_kind_has_its_mutant() -> None:
    assert FUNCTIONS.keys() | MUTANTS.keys() == NEVER.keys()


@asynchronous
async def test_a_tap_without_its_guard_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Lane, "_is_guarded", False)
    for kind in UNCUT:
        assert await reached(gate(is_open=False), UNCUT[kind]) == UNCUT[kind]


@asynchronous
async def test_a_tap_that_hands_on_what_is_left_at_the_end_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    genuine = Lane._take_eof

    def careless(lane: Lane) -> None:
        lane._write(b"" if lane._framer is None else lane._framer.pending)
        genuine(lane)

    monkeypatch.setattr(Lane, "_take_eof", careless)
    assert await reached(gate(is_open=False), UNCUT["half a frame"]) == UNCUT["half a frame"]


@asynchronous
async def test_a_guard_that_fails_lets_nothing_through() -> None:
    def broken(frame: bytes) -> bool:
        if frame == READ:
            return True
        raise RuntimeError

    for failing in (replace(FIELD, harmless=broken), replace(FIELD, written=broken)):
        assert await reached(gate(is_open=True, field=failing), ALLOWED) == b""


def test_what_cannot_be_cut_into_frames_has_no_guard() -> None:
    guard = gate(is_open=False)
    with pytest.raises(KitError, match="without its frames"):
        new_tap(Endpoint(name="x", kind="tcp", host="127.0.0.1", port=1), None, guard)
    with pytest.raises(KitError, match="rewrites nothing at those"):
        new_tap(Endpoint(name="x", kind="udp", host="127.0.0.1", port=1), None, guard, lambda frame: frame)


# -- S7 -------------------------------------------------------------------------------------------------------------------

_POINTER = bytes.fromhex("12 0a 10 02 0001 0001 84 000000")


def job(function: int, rest: bytes = b"", data: bytes = b"", *, kind: int = JOB) -> bytes:
    return data_frame(Pdu(rosctr=kind, reference=1, parameters=bytes([function]) + rest, data=data).encoded())


def user(method: int, group: int, subfunction: int, data: bytes = bytes.fromhex("0a000000")) -> bytes:
    parameters = bytes([0, 1, 0x12, 4, method, group, subfunction, 0])
    return data_frame(Pdu(rosctr=USER_DATA, reference=1, parameters=parameters, data=data).encoded())


CONNECT = bytes.fromhex("03000016 11e00000000100 c0010a c1020100 c2020101")
S7_READS = {
    "setup": job(0xF0, bytes.fromhex("00 0001 0001 01e0")),
    "read": job(4, b"\1" + _POINTER),
    "status list": user(0x11, 0x44, 1, bytes.fromhex("ff090004 0011 0001")),
    "clock": user(0x11, 0x47, 1),
    "end of a connection": bytes.fromhex("0300000b 0680 0001 0001 00"),
}
S7_NEVER = {
    "write": job(5, b"\1" + _POINTER, bytes.fromhex("00 04 0008 07")),
    "stop": job(0x29, bytes.fromhex("0000000000") + b"\x09P_PROGRAM"),
    "start": job(0x28, bytes.fromhex("000000000000fd0000") + b"\x09P_PROGRAM"),
    "download": job(0x1A, bytes(17)),
    "block of a download": job(0x1B, bytes(17)),
    "end of a download": job(0x1C, bytes(17)),
    "upload": job(0x1D, bytes(17)),
    "a read with data": job(4, b"\1" + _POINTER, b"\0\4\0\x08\7\0"),
    "a read without a pointer": job(4, b"\1" + bytes(12)),
    "a job in an answer": job(4, b"\1" + _POINTER, kind=3),
    "set the clock": user(0x11, 0x47, 2, bytes(14)),
    "a password": user(0x11, 0x45, 1, bytes(12)),
    "force": user(0x11, 0x41, 9, bytes(12)),
    "an answer": user(0x12, 0x44, 1),
    "a push": user(0x11, 0x04, 1),
    "a part of a PDU": S7_READS["read"][:6] + b"\0" + S7_READS["read"][7:],
    "another TPDU": S7_READS["read"][:5] + b"\x10" + S7_READS["read"][6:],
    "no S7": data_frame(b"\x72\1\0\4" + bytes(8)),
}


@asynchronous
@pytest.mark.parametrize("kind", S7_READS)
async def test_what_reads_passes_to_a_controller(kind: str) -> None:
    guard = gate(is_open=True, field=S7)
    assert await reached(guard, S7_READS[kind], key="s7", first=CONNECT) == S7_READS[kind]


@asynchronous
@pytest.mark.parametrize("kind", S7_NEVER)
async def test_what_may_change_a_controller_never_passes(kind: str) -> None:
    sent = S7_NEVER[kind], S7_READS["read"]
    assert await reached(gate(is_open=True, field=S7), *sent, key="s7", first=CONNECT) == S7_READS["read"]
    mutant = replace(S7, harmless=lambda frame: frame == S7_NEVER[kind] or S7.harmless(frame))
    assert await reached(gate(is_open=False, field=mutant), *sent, key="s7", first=CONNECT) == b"".join(sent)


# -- BACnet ---------------------------------------------------------------------------------------------------------------


def bvll(npdu: str, function: int = 0x0A, kind: int = 0x81) -> bytes:
    data = bytes.fromhex(npdu)
    return struct.pack(">BBH", kind, function, 4 + len(data)) + data


def confirmed(service: int, data: str) -> bytes:
    return bvll(f"0104 00 05 01 {service:02x} {data}")


_PROPERTY = "0c 00000001 19 55"
BN_READ, BN_WRITE = f"00 05 01 0c {_PROPERTY}", f"00 05 02 0f {_PROPERTY} 3e 44 41200000 3f"
BN_READS = {
    "a property": bvll(f"0104 {BN_READ}"),
    "an element of an urgent one": bvll("0107 00 05 01 0c 0c 02003039 19 4c 29 00"),
    "one that may be answered in segments": bvll(f"0104 02 75 01 0c {_PROPERTY}"),
    "several properties": confirmed(14, "0c 00000001 1e 09 55 09 4d 1f 0c 00400001 1e 09 08 1f"),
    "a subscription for an hour": confirmed(5, "09 01 1c 00000001 29 00 3a 0e10"),
    "the end of a subscription": confirmed(5, "09 01 1c 00000001"),
    "Who-Is": bvll("0100 10 08"),
    "Who-Is of one": bvll("0100 10 08 0a 3039 1a 3039"),
    "Who-Has by its name": bvll("0100 10 07 3d 04 00 616263"),
    "Who-Has by its identifier": bvll("0100 10 07 0a 3039 1a 3039 2c 00000001"),
    "the next segments, please": bvll("0100 40 01 00 04"),
    "that segment again": bvll("0100 42 01 00 04"),
    "the end of an exchange": bvll("0100 70 01 00"),
}
BN_NEVER = {
    **{f"service {number}": confirmed(number, _PROPERTY) for number in range(35) if number not in (12, 14)},
    "a subscription for ever": confirmed(5, "09 01 1c 00000001 29 00 39 00"),
    "a longer subscription": confirmed(5, "09 01 1c 00000001 29 00 3a 0e11"),
    "a subscription to be confirmed": confirmed(5, "09 01 1c 00000001 29 01 39 3c"),
    "a subscription that says nothing of its end": confirmed(5, "09 01 1c 00000001 29 00"),
    "a subscription and more": confirmed(5, "09 01 1c 00000001 29 00 39 3c 49 00"),
    "a subscription of another shape": confirmed(5, "09 01 1c 00000001 2e 39 3c 2f"),
    "a write": bvll(f"0104 {BN_WRITE}"),
    "several writes": confirmed(16, "0c 00000001 1e 09 55 2e 44 41200000 2f 1f"),
    **{f"unconfirmed service {number}": bvll(f"0100 10 {number:02x}") for number in range(16) if number != 8},
    "I-Am": bvll("0100 10 00 c4 02003039 22 05c4 91 03 21 0f"),
    "I-Have": bvll("0100 10 01 c4 02003039 c4 00000001 75 02 00 61"),
    "a read and more": bvll(f"0104 {BN_READ} 39 55"),
    "a read and a write": bvll(f"0104 {BN_READ} {BN_WRITE}"),
    "a message behind a read": bvll(f"0104 {BN_READ}") + bvll(f"0104 {BN_WRITE}"),
    "several reads and more": confirmed(14, "0c 00000001 1e 09 55 1f 2e 44 41200000 2f"),
    "a read of nothing": confirmed(14, ""),
    "a Who-Is with one bound": bvll("0100 10 08 0a 3039"),
    "a Who-Is and more": bvll("0100 10 08 0a 3039 1a 3039 0a 3039"),
    "a Who-Has and more": bvll("0100 10 07 2c 00000001 2c 00000001"),
    "a segment of a read": bvll(f"0104 08 05 01 00 04 0c {_PROPERTY}"),
    "a segment of a write": bvll(f"0104 0c 05 01 00 04 0f {_PROPERTY}"),
    "a segment of a subscription": bvll("0104 08 05 01 00 04 05 09 01 1c 00000001"),
    "a reserved bit of a request": bvll(f"0104 01 05 01 0c {_PROPERTY}"),
    "a reserved bit of a Who-Is": bvll("0100 11 08"),
    "a segment of an answer": bvll("0100 38 01 00 04 0c 00"),
    **{f"an answer {first}": bvll(f"0100 {first} 01 0f 00") for first in ("20", "30", "41", "43", "50", "60", "71")},
    "a device's end of an exchange": bvll("0100 71 01 00"),
    "an acknowledgement and more": bvll("0100 40 01 00 04 00"),
    "an end and more": bvll("0100 70 01 00 00"),
    **{f"the PDU type {kind}": bvll(f"0100 {kind:x}0 01 00 04") for kind in range(8, 16)},
    **{f"function {number} of the link": bvll(f"0104 {BN_READ}", number) for number in range(16) if number != 10},
    "a Who-Is to everybody": bvll("0100 10 08", 0x0B),
    "a Who-Is to all networks": bvll("0120 ffff 00 ff 10 08"),
    "a write to all networks": bvll(f"0124 ffff 00 ff {BN_WRITE}"),
    "a read of another network": bvll(f"0124 0005 01 07 ff {BN_READ}"),
    "a read from another network": bvll(f"010c 0005 01 07 {BN_READ}"),
    "a forwarded read": bvll(f"7f000001 bac0 0104 {BN_READ}", 0x04),
    "a foreign device": bvll("0258", 0x05),
    "the table of broadcasts": bvll("", 0x02),
    "another table of broadcasts": bvll("7f000001 bac0 ffffffff", 0x01),
    "a routing table": bvll("0180 06 00"),
    "a vendor's message of the network": bvll("0184 80 0005 00"),
    "a reserved bit of the network": bvll(f"0144 {BN_READ}"),
    "another reserved bit of the network": bvll(f"0114 {BN_READ}"),
    "another version of the network": bvll(f"0204 {BN_READ}"),
    "BACnet/IPv6": bvll(f"0104 {BN_READ}", kind=0x82),
    "a length that is wrong": BN_READS["a property"][:3] + b"\x05" + BN_READS["a property"][4:],
    "nothing": b"",
    "half a head": b"\x81\x0a",
}
BN_UNSEEN = {
    "looks for devices": {"a Who-Is to everybody", "a Who-Is to all networks", "a reserved bit of a Who-Is"},
    "subscribes to values": {kind for kind in BN_NEVER if "subscription" in kind}
    | {"service 5", "service 28", "service 30"},
    "several segments": {"a segment of a read"},
    "foreign device": {"a foreign device", "function 5 of the link"},
}
"""What an honest adapter may send that does not pass: it is not judged."""


async def reached_device(gate: Callable[[bytes], bool], *sent: bytes) -> list[bytes]:
    """Return the datagrams that reach a stand-in behind a guarded tap, of a client that sends these and one that passes."""
    last, loop = BN_READS["the end of an exchange"], asyncio.get_running_loop()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as device, socket.socket(type=socket.SOCK_DGRAM) as client:
        device.bind(("127.0.0.1", 0))
        device.setblocking(False)
        tap = DatagramTap(*device.getsockname(), framing=protocols()["bacnet"].framing, gate=gate)
        await tap.start()
        try:
            for data in (*sent, last):
                client.sendto(data, (tap.host, tap.port))
                # The tap takes one at a time, and its socket holds some hundred.
                await asyncio.sleep(0)
            arrived = [await asyncio.wait_for(loop.sock_recv(device, 65535), 60)]
            while arrived[-1] != last:
                arrived.append(await asyncio.wait_for(loop.sock_recv(device, 65535), 60))
            seen = [(bytes.fromhex(entry["bytes"]), entry.get("fault")) for entry in tap.journal.since(0)]
            assert [data for data, _ in seen] == [*sent, last]
            assert [data for data, fault in seen if fault != "withheld"] == arrived
        finally:
            await tap.aclose()
    return arrived[:-1]


@asynchronous
@pytest.mark.parametrize("field", [BACNET, UNHEARD])
async def test_what_reads_passes_to_a_bacnet_device(field: Field) -> None:
    guard = gate(is_open=True, field=field)
    sent = [data for kind, data in BN_READS.items() if kind != "the end of an exchange"]
    looks = [data for kind, data in BN_READS.items() if kind.startswith("Who")]
    passing = [data for data in sent if field is BACNET or data not in looks]
    assert await reached_device(guard, *sent) == passing
    assert (guard.unseen is None) == (field is BACNET)


@asynchronous
async def test_a_part_of_what_reads_passes_where_it_is_whole_by_itself() -> None:
    cut: list[bytes] = []
    for data in BN_READS.values():
        parts = [data[:end] for end in range(4, len(data))]
        cut += [*parts, *(part[:2] + len(part).to_bytes(2) + part[4:] for part in parts)]
    whole = [
        bvll("0107 00 05 01 0c 0c 02003039 19 4c"),
        confirmed(14, "0c 00000001 1e 09 55 09 4d 1f"),
        BN_READS["the end of a subscription"],
        bvll("0100 10 08"),
    ]
    assert await reached_device(gate(is_open=True, field=BACNET), *cut) == whole


@asynchronous
@pytest.mark.parametrize("kind", BN_NEVER)
async def test_what_may_change_a_bacnet_device_never_passes(kind: str) -> None:
    sent, guard = BN_NEVER[kind], gate(is_open=True, field=BACNET)
    assert await reached_device(guard, sent) == []
    assert [words for words in BN_UNSEEN if words in (guard.unseen or "")] == [
        words for words, kinds in BN_UNSEEN.items() if kind in kinds
    ]
    mutant = replace(BACNET, harmless=lambda frame: frame == sent or BACNET.harmless(frame))
    assert await reached_device(gate(is_open=False, field=mutant), sent) == [sent]


# -- DNP3 -----------------------------------------------------------------------------------------------------------------


def link(data: bytes = b"", *, control: int = 0xC4, to: int = 10) -> bytes:
    head = b"\x05\x64" + struct.pack("<BBHH", 5 + len(data), control, to, 1)
    blocks = (data[start : start + 16] for start in range(0, len(data), 16))
    return head + crc(head) + b"".join(block + crc(block) for block in blocks)


def ask(request: str, *, transport: int = 0xC0, application: int = 0xC0, **of_link: int) -> bytes:
    """A frame with a whole request: function and objects."""
    return link(bytes([transport, application]) + bytes.fromhex(request), **of_link)


STATUS = link(control=0xC9)
DNP3_READ = ask("01 1e0006")
DNP3_PASSES = {
    **{f"control {control:02X}": link(control=control) for control in (0xC0, 0xD2, 0xF2, 0x80, 0x81, 0x8B, 0x8F)},
    **{f"a read of group {group}": ask(f"01 {group:02x}0006") for group in (0, 1, 3, 10, 20, 21, 30, 31, 34, 40, 110)},
    "class 0": ask("01 3c0106"),
    "a range": ask("01 010200 0007"),
    "a long range": ask("01 280001 00010002"),
    "a number of points": ask("01 1e0507 04"),
    "a long number of points": ask("01 1e0508 0400"),
    "points by index": ask("01 1e0117 02 0107"),
    "points by long index": ask("01 140128 0100 2c01"),
    "several objects": ask("01 1e0000 0003 010206 3c0106"),
    "another sequence": ask("01 1e0006", transport=0xFF, application=0xCF),
    "confirmed user data": ask("01 1e0006", control=0xD3) + ask("01 1e0006", control=0xF3),
    "the last address": ask("01 1e0006", to=0xFFEF),
    "a confirmation": ask("00"),
}
DNP3_NEVER = {
    **{f"function {number}": ask(f"{number:02x} 1e0006") for number in (*range(2, 34), 127, 128, 129, 130, 255)},
    **{f"events of group {group}": ask(f"01 {group:02x}0006") for group in (2, 4, 11, 13, 22, 23, 32, 33, 42, 43, 111)},
    **{f"events of class {number}": ask(f"01 3c{number + 1:02x}06") for number in range(4) if number},
    "class 0 and events": ask("01 3c0206 3c0106"),
    "any class": ask("01 3c0006"),
    "a file": ask("01 460500 0000"),
    "the restart indication": ask("02 500100 0707 00"),
    "the clock": ask("02 320107 01 000000000000"),
    "unsolicited responses off": ask("15 3c0206 3c0306 3c0406"),
    **{f"a read of all at {to:04X}": ask("01 1e0006", to=to) for to in (0xFFF0, 0xFFFC, 0xFFFD, 0xFFFE, 0xFFFF)},
    "a confirmation with objects": ask("00 1e0006"),
    "a confirmation of what came unasked": ask("00", application=0xD0),
    "a read of nothing": ask("01"),
    "a read with half an object": ask("01 1e0000 00"),
    "a read and more": ask("01 1e0006 00"),
    "a range from its end": ask("01 1e0000 0700"),
    "another qualifier": ask("01 1e005b 01"),
    **{
        f"the application header {head:02X}": ask("01 1e0006", application=head) for head in (0x40, 0x80, 0, 0xE0, 0xD0)
    },
    **{f"the transport header {head:02X}": ask("01 1e0006", transport=head) for head in (0x40, 0x80, 0)},
    "a first segment with an operation": ask("05 0c0117 01 00", transport=0x40),
    **{
        f"a read with the control {control:02X}": ask("01 1e0006", control=control)
        for control in (0x44, 0x84, 0xD4, 0xE4, 0xC3, 0xE3, 0xC0, 0xC9, 0x8B)
    },
    "no user data": link(),
    "no fragment": link(b"\xc0"),
    "half a header of a fragment": link(b"\xc0\xc0"),
    **{f"control {control:02X} alone": link(control=control) for control in (0xC2, 0xD9, 0x4B, 0x40, 0xC1, 0xD3, 0x84)},
    "a wrong check sum of the header": DNP3_READ[:8] + b"\0\0" + DNP3_READ[10:],
    "a wrong check sum of the data": DNP3_READ[:-2] + b"\0\0",
    "a wrong check sum of a later block": ask("01" + " 1e0006" * 9)[:-1] + b"\0",
}
DNP3_UNCUT = {
    "no start": b"\0" + DNP3_READ,
    "too short a length": b"\x05\x64\x04" + DNP3_READ[3:],
    "more bytes than the length says": b"\x05\x64\x05" + DNP3_READ[3:],
}
UNANSWERED = {
    "events of class 1": "asks for events",
    "class 0 and events": "asks for events",
    "a confirmation of what came unasked": "reports events unasked",
    "the restart indication": "writes the clock or the restart indication",
    "the clock": "writes the clock or the restart indication",
    "unsolicited responses off": "switches unsolicited responses",
    "a first segment with an operation": "in several segments",
    "function 3": None,
    "function 5": None,
    "function 13": None,
    "function 2": None,
    "a read and more": None,
    "half a header of a fragment": None,
    "a wrong check sum of the data": None,
}


@asynchronous
@pytest.mark.parametrize("kind", DNP3_PASSES)
async def test_what_reads_passes_to_an_outstation(kind: str) -> None:
    guard = gate(is_open=True, field=DNP3)
    assert await reached(guard, DNP3_PASSES[kind], key="dnp3", first=STATUS) == DNP3_PASSES[kind]
    assert guard.unanswered == set()


@asynchronous
@pytest.mark.parametrize("kind", DNP3_NEVER)
async def test_what_may_change_an_outstation_never_passes(kind: str) -> None:
    sent = DNP3_NEVER[kind], DNP3_READ
    assert await reached(gate(is_open=True, field=DNP3), *sent, key="dnp3", first=STATUS) == DNP3_READ
    mutant = replace(DNP3, harmless=lambda frame: frame == DNP3_NEVER[kind] or DNP3.harmless(frame))
    assert await reached(gate(is_open=False, field=mutant), *sent, key="dnp3", first=STATUS) == b"".join(sent)


@asynchronous
@pytest.mark.parametrize("kind", DNP3_UNCUT)
async def test_what_is_no_link_frame_ends_the_connection_to_an_outstation(kind: str) -> None:
    guard = gate(is_open=True, field=DNP3)
    assert DNP3_READ not in await reached(guard, DNP3_UNCUT[kind], DNP3_READ, key="dnp3", first=STATUS)


def test_a_frame_and_another_one_are_no_frame() -> None:
    cut = link(bytes(3), control=0xC9)[:10]
    for frames in (DNP3_READ + DNP3_READ, DNP3_READ + DNP3_NEVER["function 5"], DNP3_READ[:-1], cut):
        assert not gate(is_open=True, field=DNP3)(frames)


@pytest.mark.parametrize("kind", UNANSWERED)
def test_a_failure_is_excused_by_what_masters_need_alone(kind: str) -> None:
    device = Dnp3FieldDevice("tcp://127.0.0.1:1")
    device.excuse()
    for sent in (kind, kind, "function 5"):
        assert not device.gate(DNP3_NEVER[sent])
        if sent == kind and (told := UNANSWERED[kind]) is not None:
            with pytest.raises(NoBindingError, match=told):
                device.excuse()
        else:
            device.excuse()


# -- OPC UA ---------------------------------------------------------------------------------------------------------------

_POLICY = "http://opcfoundation.org/UA/SecurityPolicy#"


def service(
    number: int, rest: bytes = bytes(28), *, kind: bytes = b"MSGF", policy: str = "None", head: bytes = b"\1\0"
) -> bytes:
    """A chunk of a request whose service has this number."""
    uri = f"{_POLICY}{policy}".encode()
    security = struct.pack("<i", len(uri)) + uri + struct.pack("<ii", -1, -1) if kind[:3] == b"OPN" else bytes(4)
    size = 2 if head == b"\1\0" else 4
    content = bytes(4) + security + bytes(8) + head + number.to_bytes(size, "little") + rest
    return kind + (8 + len(content)).to_bytes(4, "little") + content


HELLO = b"HELF" + struct.pack("<I5Ii", 32, 0, 65536, 65536, 0, 0, -1)
UA_READ, UA_WRITE = 631, 673
UA_PASSES = {
    "a channel": service(446, kind=b"OPNF"),
    "its end": service(452, kind=b"CLOF"),
    "a read": service(UA_READ),
    "a read with a longer identifier": service(UA_READ, head=b"\2\0\0"),
    **{f"service {number}": service(number) for number in (428, 461, 467, 473, 527, 533, 554, 560, 751, 787, 826)},
}
UA_NEVER = {
    **{f"service {number}": service(number) for number in (UA_WRITE, 488, 494, 500, 506, 700, 712)},
    "another session's subscriptions": service(841),
    "a server's registration": service(437),
    "an unknown service": service(60000),
    "an answer": service(634),
    "a write of one chunk and more": service(UA_WRITE, kind=b"MSGC"),
    "the rest of it": service(UA_WRITE, kind=b"MSGC") + service(0x4142, bytes(40)),
    "a read of several chunks": service(UA_READ, kind=b"MSGC"),
    "an abort": service(UA_READ, kind=b"MSGA"),
    "a write in a message that ends a channel": service(UA_WRITE, kind=b"CLOF"),
    "a write in a message that opens one": service(UA_WRITE, kind=b"OPNF"),
    "a read in a message that opens one": service(UA_READ, kind=b"OPNF"),
    "a channel with security": service(446, kind=b"OPNF", policy="Basic256Sha256"),
    "another namespace": service(UA_READ, head=b"\1\1"),
    "another form of the identifier": service(UA_READ, head=b"\x41\0"),
    "an identifier of another namespace": service(UA_READ, head=b"\2\1\0"),
    "too short": b"MSGF" + struct.pack("<II", 12, 0),
    "an acknowledge": b"ACK" + HELLO[3:],
    "a reverse hello": b"RHE" + HELLO[3:],
}


@asynchronous
@pytest.mark.parametrize("kind", UA_PASSES)
async def test_what_reads_passes_to_an_opcua_server(kind: str) -> None:
    guard = gate(is_open=True, field=OPCUA)
    assert await reached(guard, UA_PASSES[kind], key="opcua", first=HELLO) == UA_PASSES[kind]
    assert guard.unseen is None


@asynchronous
@pytest.mark.parametrize("kind", UA_NEVER)
async def test_what_may_change_an_opcua_server_never_passes(kind: str) -> None:
    sent, read = UA_NEVER[kind], UA_PASSES["a read"]
    guard = gate(is_open=True, field=OPCUA)
    assert await reached(guard, sent, read, key="opcua", first=HELLO) == read
    unseen = "security policy Basic256Sha256" if "with security" in kind else "several chunks"
    assert (unseen in (guard.unseen or "")) == (sent[3:4] != b"F" or "with security" in kind)
    mutant = replace(OPCUA, harmless=lambda frame: frame in sent or OPCUA.harmless(frame))
    assert await reached(gate(is_open=False, field=mutant), sent, read, key="opcua", first=HELLO) == sent + read


VALVE = ua.NodeId("Valve", 2)
UA_CONSENT = replace(CONSENT, writable=(Writable(target="ns=2;s=Valve", lowest=0, highest=100),))


def write_request(
    *items: tuple[Any, Any], attribute: int = 13, part: str | None = None, status: int | None = None
) -> bytes:
    request = ua.WriteRequest()
    code = None if status is None else ua.StatusCode(status)
    request.Parameters.NodesToWrite = [
        ua.WriteValue(node, ua.AttributeIds(attribute), part, ua.DataValue(ua.Variant(value), StatusCode=code))
        for node, value in items
    ]
    content = bytes(16) + struct_to_binary(request)
    return b"MSGF" + (8 + len(content)).to_bytes(4, "little") + content


UA_ALLOWED = {
    "a number": write_request((VALVE, 55.5)),
    "a truth value": write_request((VALVE, True)),
    "a good status with it": write_request((VALVE, 1), status=0),
}
UA_REFUSED = {
    "another node": write_request((ua.NodeId("Valve", 3), 55.5)),
    "one of two nodes": write_request((VALVE, 55.5), (ua.NodeId("Fan", 2), 1)),
    "a node twice": write_request((VALVE, 55.5), (VALVE, 101)),
    "too large a value": write_request((VALVE, 100.5)),
    "no number": write_request((VALVE, float("nan"))),
    "a text": write_request((VALVE, "55")),
    "a list": write_request((VALVE, [55.5])),
    "another attribute": write_request((VALVE, 5), attribute=17),
    "a part of a value": write_request((VALVE, 5), part="0:1"),
    "a bad status": write_request((VALVE, 5), status=0x80000000),
    "nothing": write_request(),
    "a node by its namespace's URI": write_request((ua.NodeId.from_string("nsu=urn:x;s=Valve"), 5)),
    "a node of another server": UA_ALLOWED["a number"].replace(b"\3\2\0\5\0\0\0Valve", b"\x43\2\0\5\0\0\0Valve"),
    "a write and more": UA_ALLOWED["a number"][:4]
    + bytes([len(UA_ALLOWED["a number"]) + 1, 0, 0, 0])
    + UA_ALLOWED["a number"][8:]
    + b"\0",
}


@asynchronous
@pytest.mark.parametrize("kind", UA_ALLOWED)
async def test_a_consented_write_passes_to_an_opcua_server_while_the_tap_is_open_for_it(kind: str) -> None:
    opened, shut = (gate(is_open=is_open, field=OPCUA, consent=UA_CONSENT) for is_open in (True, False))
    assert await reached(opened, UA_ALLOWED[kind], key="opcua", first=HELLO) == UA_ALLOWED[kind]
    assert await reached(shut, UA_ALLOWED[kind], key="opcua", first=HELLO) == b""
    assert (opened.passed.keys(), shut.passed) == ({"ns=2;s=Valve"}, {})


@asynchronous
@pytest.mark.parametrize("kind", UA_REFUSED)
async def test_a_write_that_nobody_consents_to_never_passes_to_an_opcua_server(kind: str) -> None:
    sent, read = UA_REFUSED[kind], UA_PASSES["a read"]
    assert sent not in UA_ALLOWED.values()
    opened = gate(is_open=True, field=OPCUA, consent=UA_CONSENT)
    assert await reached(opened, sent, read, key="opcua", first=HELLO) == read
    assert opened.passed == {}
    mutant = replace(OPCUA, written=lambda frame: {"ns=2;s=Valve": 5})
    opened = gate(is_open=True, field=mutant, consent=UA_CONSENT)
    assert await reached(opened, sent, read, key="opcua", first=HELLO) == sent + read


def test_an_opcua_server_that_names_its_address_leads_to_the_tap() -> None:
    def named(number: int, *urls: str, kind: bytes = b"MSGF") -> bytes:
        texts = (struct.pack("<i", len(url)) + url.encode() for url in urls)
        return service(number, bytes(24) + b"".join(texts) + b"the end", kind=kind)

    led = OPCUA.led
    assert led is not None
    for number in (425, 431, 464, 12209):
        assert led(named(number, "opc.tcp://plant:4840", kind=b"MSGC"), "127.0.0.1:7") is None
        told = named(number, "OPC.TCP://plant:4840/a/b", "at opc.tcp://x", "opc.tcp://10.0.0.5:4840")
        assert led(told, "127.0.0.1:7") == named(
            number, "opc.tcp://127.0.0.1:7/a/b", "at opc.tcp://x", "opc.tcp://127.0.0.1:7"
        )
    for other in (
        named(UA_READ + 3, "opc.tcp://plant:4840"),
        named(UA_READ + 3, "opc.tcp://plant:4840", kind=b"MSGC"),
        service(431, b"opc.tcp://"),
        HELLO,
    ):
        assert led(other, "127.0.0.1:7") == other


@asynchronous
async def test_an_answer_that_would_lead_past_the_tap_does_not_reach_the_adapter() -> None:
    told = service(431, bytes(24) + struct.pack("<i", 20) + b"opc.tcp://plant:4840", kind=b"MSGC")

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(await reader.readexactly(len(HELLO)) + told + told[:3] + b"F" + told[4:])
        await reader.read()
        writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    target = Endpoint(name="opcua", kind="tcp", host="127.0.0.1", port=server.sockets[0].getsockname()[1])
    client = OpcUaClient(target.host, target.port, "i=85")
    device = FieldDevice("opcua", "opc.tcp://x", target, client, None)
    await device.tap.start()
    try:
        reader, writer = await asyncio.open_connection(device.host, device.port)
        writer.write(HELLO)
        with pytest.raises(ConnectionResetError):
            await asyncio.wait_for(reader.readexactly(len(HELLO) + 1), 60)
        with pytest.raises(NoBindingError, match="addresses in an answer of several chunks"):
            device.see()
    finally:
        writer.transport.abort()
        await device.tap.aclose()
        server.close()


# -- the consent ----------------------------------------------------------------------------------------------------------

TODAY = datetime.date(2026, 11, 26)
TEXT = """
device = "modbus=tcp://127.0.0.1:1502"
identity = "Foreign Stand-in 1.0"
name = "Ada"
date = 2026-11-26
expires = 2026-11-27
[[writable]]
target = "1/holding_registers/100..103"
lowest = 0
highest = 500
"""


def consent(directory: Path, text: str) -> Consent:
    file = directory / "consent.toml"
    file.write_text(text)
    return read_consent(file, TODAY)


def test_a_consent_is_read(tmp_path: Path) -> None:
    told = consent(tmp_path, TEXT)
    assert told.identity == "Foreign Stand-in 1.0"
    switched = consent(tmp_path, TEXT.partition("[[")[0] + 'stop = ["plug", "off"]\nstart = ["plug", "on"]\n')
    assert (switched.writable, switched.stop, switched.start) == ((), ("plug", "off"), ("plug", "on"))
    assert switched.as_record()["outage"] is True
    node = consent(tmp_path, TEXT.replace("1/holding_registers/100..103", "ns=2;s=Valve 1..3"))
    assert node.writable[0].points == ("ns=2;s=Valve 1..3",)
    assert told.allows({"1/holding_registers/103": 500})
    assert not told.allows({})
    assert consent(tmp_path, TEXT.replace('identity = "Foreign Stand-in 1.0"\n', "")).identity is None


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("2026-11-27", "2026-11-25", "it holds from 2026-11-26 to 2026-11-25, and today is 2026-11-26"),
        ("2026-11-26", "2026-11-27", "it holds from 2026-11-27 to 2026-11-27"),
        ('name = "Ada"\n', "", "the key 'name' is missing"),
        ('"Ada"', '""', "name: expected a text"),
        ("date = 2026-11-26", 'date = "today"', "date: expected a day"),
        ("name =", "Name =", "the key 'Name' is unknown"),
        ("100..103", "*", "names no points"),
        ("100..103", "100..400", "names no points"),
        ("highest = 500", "highest = true", "expected numbers"),
        ("highest = 500", "highest = inf", "expected numbers"),
        ("lowest = 0", "lowest = nan", "expected numbers"),
        ("highest = 500", f"highest = 1{'0' * 400}", "expected numbers"),
        ("lowest = 0", "lowest = 501", "has the lowest value 501"),
        ("[[writable]]", 'stop = ["off"]\n[[writable]]', "both commands are named or none"),
        ("[[writable]]", 'stop = "off"\nstart = ["on"]\n[[writable]]', "stop: expected the words of a command"),
        ("[[writable]]", 'stop = ["off"]\nstart = [1]\n[[writable]]', "start: expected the words of a command"),
        ("[[writable]]", 'stop = ["off", ""]\nstart = ["on"]\n[[writable]]', "stop: expected the words of a command"),
        (
            "[[writable]]",
            'stop = ["off"]\nstart = ["o\\u0000n"]\n[[writable]]',
            "start: expected the words of a command",
        ),
        ("highest = 500\n", "", "expected tables with highest, lowest, target"),
        ("device =", "device", "Expected"),
    ],
)
def test_a_consent_that_does_not_hold_is_refused(tmp_path: Path, old: str, new: str, sentence: str) -> None:
    assert old in TEXT
    with pytest.raises(UsageError, match=rf"--otmcp-consent: .*{re.escape(sentence)}"):
        consent(tmp_path, TEXT.replace(old, new))
