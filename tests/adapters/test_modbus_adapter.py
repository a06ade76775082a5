"""The Modbus reference adapter against the mock device: its replies and the device's journal."""

# In the checkout mypy does not find the installed name of the adapters' folder.
# mypy: disable-error-code="import-not-found"

from __future__ import annotations

import math
import struct
from typing import Any

import pytest
from pytest_otmcp.reference_adapters.core import BadReply
from pytest_otmcp.reference_adapters.modbus.wire import is_other_reply, reply_pdu, request_facts

from .cases import MODBUS, MODBUS_TAGS

pytestmark = pytest.mark.usefixtures("clean")
CASE = MODBUS
LATE_S = 60.0
"""Seconds after which a late reply would come. The tests do not wait so long: they move the adapter's clock on."""


def poke(device: Any, table: str, address: int, *values: Any) -> None:
    device("poke", params={"table": table, "address": address, "values": list(values)})


def table(device: Any, name: str) -> list[Any]:
    cells: list[Any] = device("image")["units"]["1"][name]
    return cells


def requests(device: Any, mark: int, **fields: Any) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = device.since(mark, kind="request", **fields)
    return found


# -- what is read and written --------------------------------------------------------------------------------


def test_there_are_the_seventeen_tools_of_the_paper(adapter: Any) -> None:
    assert len(adapter.tools) == 17


def test_the_four_tables_are_told_apart(adapter: Any, device: Any) -> None:
    poke(device, "holding_registers", 20, 0xA5A5)
    poke(device, "input_registers", 20, 0x5A5A)
    poke(device, "coils", 20, True)
    poke(device, "discrete_inputs", 20, False)
    assert adapter.call("read_register", address=20).data == {"address": 20, "value": 0xA5A5}
    assert adapter.call("read_input_registers", address=20, count=1).data["values"] == [0x5A5A]
    assert adapter.call("read_coils", address=20, count=1).data["values"] == [True]
    assert adapter.call("read_discrete_inputs", address=20, count=1).data["values"] == [False]


@pytest.mark.parametrize("count", [1, 7, 8, 9, 13, 80])
def test_bits_are_as_many_as_were_asked_for(adapter: Any, device: Any, count: int) -> None:
    pattern = [i % 3 == 0 for i in range(80)]
    poke(device, "coils", 20, *pattern)
    assert adapter.call("read_coils", address=20, count=count).data["values"] == pattern[:count]


@pytest.mark.parametrize("tool", MODBUS.writes)
def test_every_write_is_one_request_and_does_what_it_says(adapter: Any, device: Any, tool: str) -> None:
    poke(device, "holding_registers", 20, 0x12)
    mark = device.mark()
    reply = adapter.call(tool, MODBUS.writes[tool])
    assert reply.envelope["success"]
    assert len(requests(device, mark)) == 1
    assert (reply.meta["attempts"], reply.meta["source"]) == (1, "device")
    registers, coils = table(device, "holding_registers"), table(device, "coils")
    expected = {
        "write_register": registers[20] == 7,
        "write_registers": registers[20:22] == [7, 8],
        "write_coil": coils[20] is True,
        "write_coils_bulk": coils[20:23] == [True, False, True],
        # The example of section 6.16.
        "mask_write_register": registers[20] == 0x17,
        "write_tag": registers[30] == 125,
    }
    assert expected[tool]


def test_the_trace_is_what_was_on_the_wire(adapter: Any, device: Any) -> None:
    mark = device.mark()
    trace = adapter.call("read_input_registers", address=5, count=3).meta["trace"]
    (request,) = requests(device, mark)
    assert trace == {
        "unit": request["unit"],
        "function": request["function"],
        "address": request["address"],
        "count": request["quantity"],
        "transaction_ids": [request["transaction_id"]],
        "pdus": 1,
    }


@pytest.mark.parametrize(("count", "sizes"), [(125, [125]), (126, [125, 1]), (2000, [125] * 16)])
def test_a_large_block_is_read_by_as_few_requests_as_possible(
    adapter: Any, device: Any, count: int, sizes: list[int]
) -> None:
    device("poke", params={"unit": 1, "cells": 65536})
    values = [(7 * number + 3) % 65536 for number in range(count)]
    poke(device, "holding_registers", 500, *values)
    mark = device.mark()
    reply = adapter.call("read_multiple_holding_registers", address=500, count=count)
    assert reply.data == {"address": 500, "count": count, "values": values}
    asked = requests(device, mark)
    assert [request["quantity"] for request in asked] == sizes
    assert reply.meta.get("atomic", True) is (len(sizes) == 1)
    assert reply.meta["attempts"] == reply.meta["trace"]["pdus"] == len(sizes)


def test_a_large_block_of_which_a_part_cannot_be_read_is_no_data(adapter: Any, device: Any) -> None:
    device("poke", params={"unit": 1, "cells": 65536})
    device.fault({"address": 625, "action": {"exception": 2}})
    reply = adapter.call("read_multiple_holding_registers", address=500, count=300)
    assert (reply.error["code"], reply.envelope["data"]) == ("illegal_address", None)


def test_a_ping_is_an_exchange_and_any_answer_of_the_device_will_do(adapter: Any, device: Any) -> None:
    mark = device.mark()
    assert adapter.call("ping").data == {"reachable": True}
    assert len(requests(device, mark)) == 1
    device.fault({"action": {"exception": 2}})
    assert adapter.call("ping").data == {"reachable": True}
    device.fault({"action": {"exception": 11}})
    assert adapter.call("ping").error["code"] == "gateway_target_no_response"


def test_the_identification_is_the_devices_and_marked_as_such(adapter: Any) -> None:
    reply = adapter.call("read_device_information")
    assert reply.data["objects"]["1"] == "MOCK-MB-1"
    assert "/data/objects/1" in reply.meta["untrusted"]


@pytest.mark.parametrize("order", ["ABCD", "CDAB", "BADC", "DCBA"])
@pytest.mark.parametrize(
    ("kind", "code", "values"),
    [
        ("int16", "h", [-32768, -1, 32767]),
        ("uint16", "H", [0, 65535]),
        ("int32", "i", [-(2**31), -2, 2**31 - 1]),
        ("uint32", "I", [0x01020304, 2**32 - 1]),
        ("int64", "q", [-(2**63), -1, 2**53 - 1]),
        ("uint64", "Q", [2**53 + 1, 2**64 - 1]),
        ("float32", "f", [-0.0, 1.401298464324817e-45, 3.4028234663852886e38, struct.unpack("f", b"\xdb\x0fI@")[0]]),
        ("float64", "d", [math.pi, -2.0, 5e-324]),
    ],
)
def test_typed_reads_are_exact(adapter: Any, device: Any, order: str, kind: str, code: str, values: list[Any]) -> None:
    for value in values:
        raw = struct.pack(f">{code}", value)
        words = [raw[i : i + 2] for i in range(0, len(raw), 2)]
        if order in ("CDAB", "DCBA"):
            words.reverse()
        if order in ("BADC", "DCBA"):
            words = [word[::-1] for word in words]
        poke(device, "holding_registers", 50, *(int.from_bytes(word, "big") for word in words))
        data = adapter.call("read_holding_typed", address=50, data_type=kind, order=order).data
        expected = str(value) if isinstance(value, int) and abs(value) >= 2**53 else value
        assert data["value"] == expected
        assert math.copysign(1, float(data["value"])) == math.copysign(1, value)
        assert (data["special"], data["type"], data["raw"]) == (None, kind, b"".join(words).hex())


@pytest.mark.parametrize(
    ("words", "special"), [([0x7FC0, 0], "NaN"), ([0x7F80, 0], "Infinity"), ([0xFF80, 0], "-Infinity")]
)
def test_what_json_has_no_number_for_is_named(adapter: Any, device: Any, words: list[int], special: str) -> None:
    poke(device, "input_registers", 50, *words)
    data = adapter.call("read_input_typed", address=50, data_type="float32").data
    assert (data["value"], data["special"]) == (None, special)


# -- tags ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("tag", "value", "raw", "registers"),
    [
        ("valve", 25.3, 253, [253]),
        ("valve", 25.35, 254, [254]),
        ("valve", 6553.5, 65535, [65535]),
        ("negative", 10, 0, [0]),
        ("negative", 12, -4, [0xFFFC]),
        ("counter", 2**53 + 1, 2**53 + 1, [0x20, 0, 0, 1]),
        ("speed", 1.5, 1.5, [0, 0x3FC0]),
    ],
)
def test_a_tag_is_written_rounded_and_read_back(
    adapter: Any, device: Any, tag: str, value: float, raw: float, registers: list[int]
) -> None:
    data = adapter.call("write_tag", tag=tag, value=value).data
    assert data["raw"] == raw
    address: int = MODBUS_TAGS[tag]["address"]
    assert table(device, "holding_registers")[address : address + len(registers)] == registers
    read = adapter.call("read_tag", tag=tag).data
    assert float(read["value"]) == pytest.approx(value, abs=abs(float(MODBUS_TAGS[tag].get("scale", 0))) / 2 + 1e-9)


def test_engineering_values_have_no_binary_dust(adapter: Any, device: Any) -> None:
    poke(device, "holding_registers", 30, 3)
    assert adapter.call("read_tag", tag="valve").data["value"] == 0.3


@pytest.mark.parametrize(
    ("tag", "value", "code"),
    [
        ("valve", 6553.6, "range_overflow"),
        ("valve", -0.1, "range_overflow"),
        ("negative", 20000, "range_overflow"),
        ("counter", 1.5, "type_mismatch"),
        ("counter", -1, "range_overflow"),
        ("speed", 1e39, "range_overflow"),
        ("locked", 1, "not_writable"),
        ("inlet", 1, "not_writable"),
        ("nobody", 1, "illegal_address"),
        ("valve", "12", "invalid_input"),
        ("valve", True, "invalid_input"),
    ],
)
def test_what_a_tag_cannot_hold_is_not_sent(adapter: Any, device: Any, tag: str, value: Any, code: str) -> None:
    mark = device.mark()
    error = adapter.call("write_tag", tag=tag, value=value).error
    assert (error["code"], error["outcome"]) == (code, "not_sent")
    assert requests(device, mark) == []


def test_the_tag_map_can_be_listed_without_the_device(adapter: Any, device: Any) -> None:
    mark = device.mark()
    reply = adapter.call("list_tags")
    assert {tag["tag"] for tag in reply.data["tags"]} == set(MODBUS_TAGS)
    assert reply.meta["source"] == "none"
    assert requests(device, mark) == []


# -- what the device refuses -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("exception", "code", "outcome"),
    [
        (1, "unsupported_operation", "rejected"),
        (2, "illegal_address", "rejected"),
        (3, "illegal_value", "rejected"),
        (4, "device_failure", "unknown"),
        (5, "accepted_pending", "unknown"),
        (6, "device_busy", "rejected"),
        (8, "device_failure", "rejected"),
        (10, "gateway_path_unavailable", "rejected"),
        (11, "gateway_target_no_response", "unknown"),
        (0x7F, "protocol_error", "unknown"),
    ],
)
def test_exceptions_have_their_codes(adapter: Any, device: Any, exception: int, code: str, outcome: str) -> None:
    device.fault({"action": {"exception": exception}})
    read, write = adapter.call("read_register", address=1), adapter.call("write_register", address=1, value=1)
    assert (read.error["code"], read.error["outcome"]) == (code, "not_applicable")
    assert (write.error["code"], write.error["outcome"]) == (code, outcome)
    assert read.meta["trace"]["exception_code"] == exception
    assert (read.meta["attempts"], read.meta["source"]) == (1, "device")


def test_another_unit_is_asked_when_it_is_named(adapter: Any, device: Any) -> None:
    mark = device.mark()
    assert adapter.call("read_register", address=1, unit_id=17).error["code"] == "gateway_target_no_response"
    assert [request["unit"] for request in requests(device, mark)] == [17]


# -- replies that are none -------------------------------------------------------------------------------------


@pytest.mark.parametrize("values", [[1, 2], []])
def test_a_reply_to_another_question_is_never_data(adapter: Any, device: Any, values: list[int]) -> None:
    poke(device, "holding_registers", 20, 4711)
    device.fault({"times": 1, "action": {"answer_values": values}})
    assert adapter.call("read_register", address=20).error["code"] == "protocol_error"
    assert adapter.call("read_register", address=20).data["value"] == 4711


@pytest.mark.parametrize("fault", ["identifier 0", "identifier 1 too high", "other unit", "garbage", "cut short"])
def test_what_is_no_reply_to_the_request_is_never_data(adapter: Any, device: Any, fault: str) -> None:
    poke(device, "holding_registers", 20, 4711)
    last = adapter.call("ping").meta["trace"]["transaction_ids"][-1]
    actions: dict[str, dict[str, Any]] = {
        "identifier 0": {"transaction_id": -(last + 1)},
        "identifier 1 too high": {"transaction_id": 1},
        "other unit": {"answer_unit": 9},
        "garbage": {"garbage": True},
        "cut short": {"truncate": 10},
    }
    device.fault({"address": 20, "times": 1, "action": actions[fault]})
    mark = device.mark()
    identifier = adapter.start("read_register", {"address": 20})
    (answer,) = device.wait(mark, direction="out")
    if fault.startswith("identifier"):
        assert answer["transaction_id"] == (0 if fault == "identifier 0" else last + 2)
    # The adapter waits for a right reply until its time-out.
    adapter.pass_time()
    assert adapter.reply("read_register", identifier).error["code"] == "protocol_error"
    assert adapter.call("read_register", address=20).data["value"] == 4711


REQUESTS = {
    1: bytes.fromhex("01 0014 0009"),
    3: bytes.fromhex("03 0014 0002"),
    5: bytes.fromhex("05 0014 ff00"),
    6: bytes.fromhex("06 0014 0007"),
    15: bytes.fromhex("0f 0014 0003 01 05"),
    16: bytes.fromhex("10 0014 0002 04 0007 0008"),
    22: bytes.fromhex("16 0014 00f2 0025"),
    43: bytes.fromhex("2b 0e 02 00"),
}
REPLIES = {
    1: bytes.fromhex("01 02 ff01"),
    3: bytes.fromhex("03 04 0007 0008"),
    5: REQUESTS[5],
    6: REQUESTS[6],
    15: REQUESTS[15][:5],
    16: REQUESTS[16][:5],
    22: REQUESTS[22],
    43: bytes.fromhex("2b 0e 02 82 00 00 01 00 01 41"),
}


def framed(pdu: bytes, *, transaction: int = 7, protocol: int = 0, unit: int = 1, length: int = 0) -> bytes:
    return struct.pack(">HHHB", transaction, protocol, len(pdu) + 1 + length, unit) + pdu


@pytest.mark.parametrize("function", REQUESTS)
def test_only_the_reply_to_the_request_is_accepted(function: int) -> None:
    request, facts = request_facts(framed(REQUESTS[function]))
    assert (facts["unit"], facts["function"]) == (1, function)
    right = REPLIES[function]
    exception = bytes([function | 0x80, 2])
    assert reply_pdu(request, framed(right)) == right
    assert reply_pdu(request, framed(exception)) == exception
    # A reply to an earlier request is skipped (section 4.4.1.3).
    assert reply_pdu(request, framed(exception, transaction=6) + framed(right)) == right
    wrong = [
        framed(right, transaction=0),
        framed(right, transaction=8),
        framed(right, protocol=1),
        framed(right, unit=2),
        framed(right, length=1),
        framed(right, length=-1),
        framed(bytes([function + 1]) + right[1:]),
        framed(exception + b"\0"),
        framed(exception[:1]),
        framed(b""),
        b"",
    ]
    wrong += [framed(right + b"\0"), framed(right[:-1])]
    if function != 43:
        # Any other address, value, quantity, mask or byte count.
        places = [1] if function in (1, 3) else range(1, len(right))
        wrong += [framed(right[:i] + bytes([right[i] ^ 1]) + right[i + 1 :]) for i in places]
    for data in wrong:
        with pytest.raises(BadReply):
            reply_pdu(request, data)


def test_a_frame_that_can_not_be_followed_by_the_reply_is_not_waited_behind() -> None:
    request, _ = request_facts(framed(REQUESTS[3]))
    right = REPLIES[3]
    for early in (framed(right), framed(right)[:-1], framed(right, transaction=6), b""):
        assert not is_other_reply(request, early)
    for other in (framed(right, transaction=0), framed(right, transaction=8), framed(right, unit=2)):
        assert is_other_reply(request, other)


# -- time and connections --------------------------------------------------------------------------------------


def test_a_late_reply_is_not_the_answer_to_the_next_request(adapter: Any, device: Any) -> None:
    poke(device, "holding_registers", 20, 1111, 2222)
    device.fault({"address": 20, "times": 1, "action": {"delay_s": LATE_S}})
    mark = device.mark()
    identifier = adapter.start("read_register", {"address": 20})
    device.wait(mark, kind="request", address=20)
    adapter.pass_time()
    assert adapter.reply("read_register", identifier).error["code"] == "timeout"
    for _ in range(3):
        assert adapter.call("read_register", address=21).data["value"] == 2222
    # The late reply is never sent: its connection has ended.
    (late,) = requests(device, mark, address=20)
    device.wait(mark, kind="DISCONNECTED", connection=late["connection"])
    assert device.since(mark, kind="response", connection=late["connection"]) == []


def test_parallel_calls_get_their_own_answers(adapter: Any, device: Any) -> None:
    values = [1000 + i for i in range(64)]
    poke(device, "holding_registers", 20, *values)
    ids = [adapter.start("read_register", {"address": 20 + i}) for i in range(64)]
    assert [adapter.reply("read_register", identifier).data["value"] for identifier in ids] == values
