"""The Modbus reference adapter against the mock device: what it says and what the device saw."""

# In the checkout mypy does not find the installed name of the adapters' folder.
# mypy: disable-error-code="import-not-found"

from __future__ import annotations

import json
import math
import os
import struct
import subprocess
from collections.abc import Iterator
from typing import Any

import pytest
from pytest_otmcp.reference_adapters.modbus.wire import BadReply, reply_pdu, request_facts

TIMEOUT_S, DEADLINE_S = 2.5, 5.0
"""For what must time out. Whoever is held up for two seconds is held up for less than either, and than what is between
them."""
WRITES = {
    "write_register": {"address": 20, "value": 7},
    "write_registers": {"address": 20, "values": [7, 8]},
    "write_coil": {"address": 20, "value": True},
    "write_coils_bulk": {"address": 20, "values": [True, False, True]},
    "mask_write_register": {"address": 20, "and_mask": 0xF2, "or_mask": 0x25},
    "write_tag": {"tag": "valve", "value": 12.5},
}
READS: dict[str, dict[str, Any]] = {
    "ping": {},
    "read_register": {"address": 20},
    "read_multiple_holding_registers": {"address": 20, "count": 2},
    "read_input_registers": {"address": 20, "count": 2},
    "read_coils": {"address": 20, "count": 9},
    "read_discrete_inputs": {"address": 20, "count": 9},
    "read_holding_typed": {"address": 20, "data_type": "float32"},
    "read_input_typed": {"address": 20, "data_type": "int32"},
    "read_device_information": {},
    "read_tag": {"tag": "valve"},
}
TAGS: dict[str, dict[str, Any]] = {
    "valve": {"address": 30, "scale": 0.1, "unit": "%", "writable": True},
    "negative": {"address": 31, "type": "int16", "scale": -0.5, "offset": 10, "writable": True},
    "counter": {"address": 32, "type": "uint64", "writable": True},
    "speed": {"address": 36, "type": "float32", "order": "CDAB", "writable": True},
    "locked": {"address": 38},
    "inlet": {"table": "input", "address": 40, "type": "int16", "scale": 0.1, "unit": "degC"},
}


@pytest.fixture(scope="module")
def device(mocks: Any) -> Any:
    return mocks("modbus")


@pytest.fixture(autouse=True)
def clean(device: Any) -> None:
    device("reset")


@pytest.fixture(scope="module")
def env(device: Any, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    tags = tmp_path_factory.mktemp("tags") / "tags.json"
    tags.write_text(json.dumps(TAGS))
    return {
        "MODBUS_HOST": "127.0.0.1",
        "MODBUS_PORT": str(device.port),
        "MODBUS_TIMEOUT_S": "7",
        "MODBUS_DEADLINE_S": "9",
        "MODBUS_TAG_MAP": str(tags),
    }


@pytest.fixture(scope="module")
def adapter(sessions: Any, adapter_command: Any, env: dict[str, str]) -> Any:
    return sessions(adapter_command("modbus"), {**env, "MODBUS_WRITES_ENABLED": "true"})


@pytest.fixture(scope="module")
def guarded(sessions: Any, adapter_command: Any, env: dict[str, str]) -> Any:
    return sessions(adapter_command("modbus"), env)


@pytest.fixture(scope="module")
def crowd(sessions: Any, adapter_command: Any, env: dict[str, str]) -> Iterator[list[Any]]:
    """For what must time out, one for each writing tool: at the same time they wait no longer than one of them."""
    hasty = {"MODBUS_WRITES_ENABLED": "true", "MODBUS_TIMEOUT_S": str(TIMEOUT_S), "MODBUS_DEADLINE_S": str(DEADLINE_S)}
    clients = [sessions(adapter_command("modbus"), {**env, **hasty}) for _ in WRITES]
    yield clients
    for client in clients:
        client.abandon()


@pytest.fixture(scope="module")
def impatient(crowd: list[Any]) -> Any:
    return crowd[0]


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
    assert set(adapter.tools) == {*READS, *WRITES, "list_tags"}
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


@pytest.mark.parametrize("tool", WRITES)
def test_every_write_is_one_request_and_does_what_it_says(adapter: Any, device: Any, tool: str) -> None:
    poke(device, "holding_registers", 20, 0x12)
    mark = device.mark()
    reply = adapter.call(tool, WRITES[tool])
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
    address: int = TAGS[tag]["address"]
    assert table(device, "holding_registers")[address : address + len(registers)] == registers
    read = adapter.call("read_tag", tag=tag).data
    assert float(read["value"]) == pytest.approx(value, abs=abs(float(TAGS[tag].get("scale", 0))) / 2 + 1e-9)


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
    assert {tag["tag"] for tag in reply.data["tags"]} == set(TAGS)
    assert reply.meta["source"] == "none"
    assert requests(device, mark) == []


# -- what is not sent ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tool", WRITES)
def test_a_denied_write_puts_nothing_on_the_wire(guarded: Any, device: Any, tool: str) -> None:
    guarded.call("ping")
    mark = device.mark()
    reply = guarded.call(tool, WRITES[tool])
    assert (reply.error["code"], reply.error["outcome"]) == ("writes_disabled", "not_sent")
    assert device.since(mark) == []


def test_read_only_hints_are_true(adapter: Any, device: Any) -> None:
    mark = device.mark()
    for tool, arguments in READS.items():
        assert adapter.tools[tool]["annotations"]["readOnlyHint"]
        assert adapter.call(tool, arguments).envelope["success"]
    assert requests(device, mark, state_changing=True) == []
    assert not any(adapter.tools[tool]["annotations"]["readOnlyHint"] for tool in WRITES)


@pytest.mark.parametrize(
    ("tool", "arguments", "code"),
    [
        ("write_register", {"address": 1, "value": 70000}, "range_overflow"),
        ("write_register", {"address": 1, "value": -1}, "range_overflow"),
        ("write_register", {"address": 1, "value": 40.7}, "invalid_input"),
        ("write_register", {"address": 1, "value": 1, "unit": 7}, "invalid_input"),
        ("write_register", {"address": 65536, "value": 1}, "invalid_input"),
        ("write_register", {"address": -1, "value": 1}, "invalid_input"),
        ("write_register", {"address": 1, "value": 1, "unit_id": 256}, "invalid_input"),
        ("write_register", {"address": 1, "value": 1, "unit_id": 248}, "invalid_input"),
        ("write_register", {"address": 1, "value": 1, "unit_id": None}, "invalid_input"),
        ("write_registers", {"address": 0, "values": [1] * 124}, "limit_exceeded"),
        ("write_registers", {"address": 0, "values": []}, "invalid_input"),
        ("write_registers", {"address": 0, "values": [1, 65536]}, "range_overflow"),
        ("write_registers", {"address": 65535, "values": [1, 2]}, "invalid_input"),
        ("write_coil", {"address": 0, "value": 1}, "invalid_input"),
        ("write_coils_bulk", {"address": 0, "values": [True] * 1969}, "limit_exceeded"),
        ("mask_write_register", {"address": 0, "and_mask": 65536, "or_mask": 0}, "range_overflow"),
        ("read_multiple_holding_registers", {"address": 0, "count": 126}, "limit_exceeded"),
        ("read_multiple_holding_registers", {"address": 0, "count": 0}, "invalid_input"),
        ("read_multiple_holding_registers", {"address": 0, "count": -1}, "invalid_input"),
        ("read_multiple_holding_registers", {"address": 65535, "count": 2}, "invalid_input"),
        ("read_coils", {"address": 0, "count": 2001}, "limit_exceeded"),
        ("read_holding_typed", {"address": 65535, "data_type": "float32"}, "invalid_input"),
        ("read_holding_typed", {"address": 0, "data_type": "float16"}, "invalid_input"),
    ],
)
def test_what_no_request_can_carry_is_not_sent(
    adapter: Any, guarded: Any, device: Any, tool: str, arguments: dict[str, Any], code: str
) -> None:
    adapter.call("ping")
    mark = device.mark()
    for subject in (adapter, guarded):
        error = subject.call(tool, arguments).error
        assert (error["code"], error["outcome"]) == (code, "not_sent")
    assert device.since(mark) == []


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


def test_what_is_no_reply_to_the_request_is_never_data(crowd: list[Any], device: Any) -> None:
    # The first one's next reply has identifier 0.
    last = crowd[0].call("ping").meta["trace"]["transaction_ids"][-1]
    actions = [
        {"transaction_id": -(last + 1)},
        {"transaction_id": 1},
        {"answer_unit": 9},
        {"garbage": True},
        {"truncate": 10},
    ]
    subjects = list(zip(crowd, range(20, 20 + len(actions)), strict=False))
    poke(device, "holding_registers", 20, *(4700 + address for _, address in subjects))
    device.fault(*({"address": 20 + i, "times": 1, "action": action} for i, action in enumerate(actions)))
    mark = device.mark()
    # The adapters wait for something better until the time is up, so they do it at the same time.
    started = [(subject, subject.start("read_register", {"address": address})) for subject, address in subjects]
    replies = [subject.reply("read_register", identifier) for subject, identifier in started]
    assert [reply.error["code"] for reply in replies] == ["protocol_error"] * len(actions)
    assert len(device.since(mark, kind="response", transaction_id=0)) == 1
    for subject, address in subjects:
        assert subject.call("read_register", address=address).data["value"] == 4700 + address


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
    # What belongs to an earlier request is passed over (section 4.4.1.3).
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


# -- time and connections --------------------------------------------------------------------------------------


@pytest.mark.parametrize("tool", WRITES)
@pytest.mark.parametrize("action", [{"reset": True}, {"close": True}])
def test_a_write_over_a_connection_that_breaks_is_sent_once(
    adapter: Any, device: Any, tool: str, action: dict[str, Any]
) -> None:
    device.fault({"action": action})
    mark = device.mark()
    reply = adapter.call(tool, WRITES[tool])
    assert (reply.error["code"], reply.error["outcome"]) == ("connection_lost", "unknown")
    assert not reply.error["retryable"]
    device.fault()
    assert adapter.call("ping").envelope["success"]
    assert len(requests(device, mark, state_changing=True)) == 1
    assert reply.meta["attempts"] == 1


def test_a_write_that_is_not_answered_is_sent_once(crowd: list[Any], device: Any) -> None:
    device.fault({"action": {"drop": True}})
    mark = device.mark()
    started = [(each, tool, each.start(tool, WRITES[tool])) for each, tool in zip(crowd, WRITES, strict=True)]
    for subject, tool, identifier in started:
        reply = subject.reply(tool, identifier)
        assert (reply.error["code"], reply.error["outcome"], reply.error["retryable"]) == ("timeout", "unknown", False)
        assert reply.meta["attempts"] == 1
    device.wait(mark, len(WRITES), kind="request", state_changing=True)
    device.fault()
    assert all(subject.call("ping").envelope["success"] for subject in crowd)
    # Each over its own connection.
    connections = [request["connection"] for request in requests(device, mark, state_changing=True)]
    assert len(connections) == len(set(connections)) == len(WRITES)


@pytest.mark.parametrize("action", [{"reset": True}, {"close": True}])
def test_a_read_is_repeated_once_over_a_new_connection(adapter: Any, device: Any, action: dict[str, Any]) -> None:
    adapter.call("ping")
    device.fault({"times": 1, "action": action})
    mark = device.mark()
    reply = adapter.call("read_register", address=1)
    assert reply.envelope["success"]
    assert (reply.meta["attempts"], len(requests(device, mark))) == (2, 2)
    assert reply.meta["connection"]["state"] == "reconnected"
    device.fault({"action": action})
    mark = device.mark()
    reply = adapter.call("read_register", address=1)
    assert (reply.error["code"], reply.meta["attempts"], len(requests(device, mark))) == ("connection_lost", 2, 2)


def test_a_late_reply_is_not_the_answer_to_the_next_request(impatient: Any, device: Any) -> None:
    poke(device, "holding_registers", 20, 1111, 2222)
    # Late enough for an adapter that is held up when its time is over.
    device.fault({"address": 20, "times": 1, "action": {"delay_s": TIMEOUT_S + 3.0}})
    mark = device.mark()
    assert impatient.call("read_register", address=20).error["code"] == "timeout"
    for _ in range(3):
        assert impatient.call("read_register", address=21).data["value"] == 2222
    # The late reply reaches nobody: its connection is gone.
    (late,) = requests(device, mark, address=20)
    device.wait(mark, kind="DISCONNECTED", connection=late["connection"])
    assert device.since(mark, kind="response", connection=late["connection"]) == []


def test_every_call_ends_by_its_deadline_though_the_device_swallows_them_all(impatient: Any, device: Any) -> None:
    device.fault({"action": {"drop": True}})
    mark = device.mark()
    ids = impatient.start_together(*(("write_register", {"address": 20, "value": i}) for i in range(8)))
    replies = [impatient.reply("write_register", identifier) for identifier in ids]
    assert {reply.error["code"] for reply in replies} == {"timeout"}
    sent = [reply for reply in replies if reply.error["outcome"] == "unknown"]
    kept = [reply for reply in replies if reply.error["outcome"] == "not_sent"]
    assert len(sent) + len(kept) == 8
    # One after the other they would all be sent; the deadline came first.
    assert kept
    # The device may not even have accepted the last connection yet.
    device.wait(mark, len(sent), kind="request")
    assert len(requests(device, mark)) == len(sent) == sum(reply.meta["attempts"] for reply in replies)


def test_tools_are_listed_while_the_device_stalls(impatient: Any, device: Any) -> None:
    device.fault({"times": 1, "action": {"drop": True}})
    stalled, listed = impatient.start_together(("ping", {}), ("list_tags", {}))
    while not impatient._answers.keys() >= {stalled, listed}:
        assert impatient._read(60.0)
    # They are kept in the order in which they came.
    assert list(impatient._answers) == [listed, stalled]
    assert impatient.reply("list_tags", listed).envelope["success"]
    assert impatient.reply("ping", stalled).error["code"] == "timeout"


def test_a_cancelled_call_sends_nothing_more_and_the_next_one_works(adapter: Any, device: Any) -> None:
    adapter.call("ping")
    device.fault({"times": 1, "action": {"drop": True}})
    mark = device.mark()
    identifier = adapter.start("write_register", {"address": 20, "value": 5})
    device.wait(mark, kind="request")
    queued = adapter.start("write_register", {"address": 21, "value": 6})
    for cancelled in (queued, identifier):
        adapter.write({"jsonrpc": "2.0", "method": "notifications/cancelled", "params": {"requestId": cancelled}})
    assert adapter.call("read_register", address=1).envelope["success"]
    assert [request["address"] for request in requests(device, mark)] == [20, 1]
    for cancelled in (identifier, queued):
        with pytest.raises(TimeoutError):
            adapter.answer(cancelled, timeout_s=0.0)


def test_parallel_calls_get_their_own_answers_over_one_connection(adapter: Any, device: Any) -> None:
    values = [1000 + i for i in range(64)]
    poke(device, "holding_registers", 20, *values)
    adapter.call("ping")
    mark = device.mark()
    ids = [adapter.start("read_register", {"address": 20 + i}) for i in range(64)]
    assert [adapter.reply("read_register", identifier).data["value"] for identifier in ids] == values
    assert device.since(mark, kind="CONNECTED") == []


def test_the_adapter_starts_without_its_device_and_heals_in_the_same_session(
    sessions: Any, adapter_command: Any, env: Any, device: Any
) -> None:
    with device.outage():
        fresh = sessions(adapter_command("modbus"), {**env, "MODBUS_WRITES_ENABLED": "true"})
        assert len(fresh.tools) == 17
        for tool, arguments in {**READS, **WRITES}.items():
            reply = fresh.call(tool, arguments)
            assert (reply.error["code"], reply.error["retryable"]) == ("connect_failed", True)
            assert (reply.meta["attempts"], reply.meta["connection"]["state"]) == (0, "disconnected")
        assert fresh.call("write_register", address=1, value=70000).error["code"] == "range_overflow"
    assert fresh.call("ping").meta["connection"] == {"state": "connected", "generation": 1}
    with device.outage():
        assert fresh.call("ping").error["code"] == "connect_failed"
        assert fresh.call("write_register", address=1, value=1).error["outcome"] == "not_sent"
    assert fresh.call("ping").meta["connection"] == {"state": "reconnected", "generation": 2}
    assert fresh.call("ping", x=1).meta["connection"] == {"state": "connected", "generation": 2}


def test_an_unknown_host_is_named_as_such(sessions: Any, adapter_command: Any, env: Any) -> None:
    lost = sessions(adapter_command("modbus"), {**env, "MODBUS_HOST": "no-such-host.invalid", "MODBUS_DEADLINE_S": "5"})
    error = lost.call("ping").error
    assert error["code"] in ("dns_error", "timeout")


def test_closing_stdin_closes_the_connection(sessions: Any, adapter_command: Any, env: Any, device: Any) -> None:
    mark = device.mark()
    fresh = sessions(adapter_command("modbus"), env)
    fresh.call("ping")
    code, _ = fresh.close()
    assert code == 0
    (request,) = requests(device, mark)
    device.wait(mark, kind="DISCONNECTED", connection=request["connection"])


@pytest.mark.parametrize(
    ("value", "enabled"), [("true", True), ("1", True), ("flase", False), ("", False), (" true ", False)]
)
def test_only_a_clear_yes_enables_writes(
    sessions: Any, adapter_command: Any, env: Any, value: str, enabled: bool
) -> None:
    subject = sessions(adapter_command("modbus"), {**env, "MODBUS_WRITES_ENABLED": value})
    assert subject.call("write_register", address=20, value=1).envelope["success"] is enabled
    assert (b"writes ENABLED" if enabled else b"writes disabled") in subject.stderr
    subject.close()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("MODBUS_PORT", "many"),
        ("MODBUS_PORT", "70000"),
        ("MODBUS_UNIT_ID", "250"),
        ("MODBUS_TIMEOUT_S", "nan"),
        ("MODBUS_DEADLINE_S", "-1"),
        ("MODBUS_TAG_MAP", "/does/not/exist.json"),
        ("MCP_TRANSPORT", "pigeon"),
    ],
)
def test_a_bad_setting_is_one_sentence_and_exit_code_2(adapter_command: Any, env: Any, name: str, value: str) -> None:
    done = subprocess.run(
        adapter_command("modbus"),
        env={**os.environ, **env, name: value},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1
    assert name in done.stderr
