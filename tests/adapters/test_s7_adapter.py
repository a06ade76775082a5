"""The S7 reference adapter against the mock controller: its replies and the controller's journal."""

# In the checkout mypy does not find the installed name of the adapters' folder.
# mypy: disable-error-code="import-not-found"

from __future__ import annotations

import math
import struct
from typing import Any

import pytest
from pytest_otmcp.reference_adapters.core import BadReply
from pytest_otmcp.reference_adapters.s7.wire import items_of, reply_of
from snap7.s7protocol import S7Protocol

from .cases import S7, S7_TAGS

pytestmark = pytest.mark.usefixtures("clean")
CASE = S7
LATE_S = 60.0
"""Seconds after which a late answer would come. The tests do not wait so long: they move the adapter's clock on."""


def poke(device: Any, area: str, byte: int, content: bytes) -> None:
    device("poke", params={"area": area, "byte": byte, "data": content.hex()})


def area(device: Any, name: str) -> bytes:
    return bytes.fromhex(device("image")["areas"][name])


def requests(device: Any, mark: int, **fields: Any) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = device.since(mark, kind="request", **fields)
    return found


def valve(**members: Any) -> dict[str, Any]:
    return {"db_number": 10, "start_offset": 0, "data_type": "INT", **members}


# -- what is read and written --------------------------------------------------------------------------------


def test_there_are_the_twenty_tools_of_the_paper(adapter: Any) -> None:
    assert len(adapter.tools) == 20


def test_the_areas_are_told_apart(adapter: Any, device: Any) -> None:
    for number, name in enumerate(("DB10", "I", "Q", "M")):
        poke(device, name, 5, bytes([number + 40]))
    assert adapter.call("read_db", db_number=10, start_offset=5, size=1).data == {"start": 5, "bytes": [40]}
    assert adapter.call("read_input", start_byte=5, size=1).data["bytes"] == [41]
    assert adapter.call("read_output", start_byte=5, size=1).data["bytes"] == [42]
    assert adapter.call("read_marker", start_byte=5, size=1).data["bytes"] == [43]


@pytest.mark.parametrize(
    ("kind", "code", "values"),
    [
        ("BYTE", "B", [0, 255]),
        ("WORD", "H", [0x1234]),
        ("DWORD", "I", [0x01020304]),
        ("SINT", "b", [-128, 127]),
        ("USINT", "B", [255]),
        ("INT", "h", [-32768, -2, 32767]),
        ("UINT", "H", [65535]),
        ("DINT", "i", [-(2**31), 2**31 - 1]),
        ("UDINT", "I", [2**32 - 1]),
        ("REAL", "f", [-0.5, 3.4028234663852886e38]),
        ("LREAL", "d", [math.pi, 5e-324]),
    ],
)
def test_numbers_are_written_and_read_exactly(
    adapter: Any, device: Any, kind: str, code: str, values: list[Any]
) -> None:
    for value in values:
        mark = device.mark()
        arguments = {"db_number": 10, "start_offset": 41, "data_type": kind}
        raw = struct.pack(f">{code}", value)
        written = adapter.call("write_db", {**arguments, "value": value})
        assert written.data == {"start": 41, "type": kind, "value": value, "raw": raw.hex()}
        assert area(device, "DB10")[41 : 41 + len(raw)] == raw
        read = adapter.call("read_db_typed", arguments).data
        assert (read["value"], read["raw"], read["special"]) == (value, raw.hex(), None)
        assert [request["service"] for request in requests(device, mark)] == ["write", "read"]


@pytest.mark.parametrize(("raw", "special"), [("7fc00000", "NaN"), ("7f800000", "Infinity"), ("ff800000", "-Infinity")])
def test_what_json_has_no_number_for_is_named(adapter: Any, device: Any, raw: str, special: str) -> None:
    poke(device, "DB10", 8, bytes.fromhex(raw))
    data = adapter.call("read_db_typed", valve(start_offset=8, data_type="REAL")).data
    assert (data["value"], data["special"]) == (None, special)


@pytest.mark.parametrize(
    ("kind", "value"), [("LINT", -(2**63)), ("LINT", 2**53 - 1), ("ULINT", 2**64 - 1), ("LWORD", 2**53 + 1)]
)
def test_whole_numbers_of_64_bits_keep_every_digit(adapter: Any, device: Any, kind: str, value: int) -> None:
    place = valve(start_offset=48, data_type=kind)
    shown = value if abs(value) < 2**53 else str(value)
    assert adapter.call("write_db", {**place, "value": value}).data["value"] == shown
    assert area(device, "DB10")[48:56] == (value % 2**64).to_bytes(8, "big")
    assert adapter.call("read_db_typed", place).data["value"] == shown


def test_a_string_is_read_and_written_within_its_declared_length(adapter: Any, device: Any) -> None:
    text = valve(start_offset=20, data_type="STRING")
    assert adapter.call("read_db_typed", text).data["value"] == "ready"
    mark = device.mark()
    reply = adapter.call("write_db", {**text, "value": "stopp"})
    # It asks for the declared length, and writes from the second length on.
    assert [(request["service"], request["items"][0]["byte"]) for request in requests(device, mark)] == [
        ("read", 20),
        ("write", 21),
    ]
    assert reply.meta["attempts"] == 2
    assert area(device, "DB10")[20:27] == b"\x1e\x05stopp"
    mark = device.mark()
    error = adapter.call("write_db", {**text, "value": "x" * 31}).error
    assert (error["code"], error["outcome"]) == ("limit_exceeded", "not_sent")
    assert requests(device, mark, service="write") == []
    poke(device, "DB10", 20, b"\x1e\x40")
    assert adapter.call("read_db_typed", text).error["code"] == "bad_quality"


def test_a_bit_is_written_as_a_bit(adapter: Any, device: Any) -> None:
    poke(device, "M", 3, b"\x4a")
    device("poke", params={"restless": [{"area": "M", "byte": 3, "bits": 0x40}]})
    mark = device.mark()
    for bit, value in ((5, True), (1, False)):
        adapter.call("write_marker", start_byte=3, bit_index=bit, data_type="BOOL", value=value)
    assert area(device, "M")[3] == 0x68
    assert [request["items"][0]["transport"] for request in requests(device, mark)] == [1, 1]


def test_several_variables_are_one_request(adapter: Any, device: Any) -> None:
    poke(device, "DB10", 0, struct.pack(">hh", -7, 8))
    places = [
        {"area": "DB", "db_number": 10, "start_byte": 1, "data_type": "BYTE"},
        {"area": "M", "start_byte": 3, "bit_index": 5, "data_type": "BOOL"},
        {"area": "DB", "db_number": 10, "start_byte": 2, "data_type": "INT"},
    ]
    mark = device.mark()
    read = adapter.call("read_multiple_vars", variables=places)
    assert [value["value"] for value in read.data["values"]] == [0xF9, False, 8]
    values = [{**place, "value": value} for place, value in zip(places, (1, True, -2), strict=True)]
    assert len(adapter.call("write_multiple_vars", variables=values).data["values"]) == 3
    assert len(requests(device, mark)) == 2
    assert (area(device, "DB10")[:4].hex(), area(device, "M")[3]) == ("ff01fffe", 0x20)


def test_a_write_of_which_a_part_is_refused_says_so(adapter: Any, device: Any) -> None:
    values = [{"area": "DB", "db_number": block, "start_byte": 0, "data_type": "INT", "value": 5} for block in (10, 99)]
    reply = adapter.call("write_multiple_vars", variables=values)
    assert (reply.error["code"], reply.error["outcome"]) == ("partial_failure", "partial")
    assert [item["written"] for item in reply.envelope["data"]["partial"]] == [True, False]
    assert area(device, "DB10")[:2] == b"\0\5"


def test_the_trace_is_what_was_on_the_wire(adapter: Any, device: Any) -> None:
    mark = device.mark()
    trace = adapter.call("read_db", db_number=10, start_offset=5, size=3).meta["trace"]
    (request,) = requests(device, mark)
    assert trace == {
        "function": 4,
        "area": 0x84,
        "db": 10,
        "start": 5,
        "references": [request["reference"]],
        "pdus": 1,
    }


# -- the CPU ---------------------------------------------------------------------------------------------------


def test_the_state_is_the_controllers(adapter: Any, device: Any) -> None:
    """python-snap7's own ``get_cpu_state`` says RUN whatever the controller answers."""
    for state in ("STOP", "RUN"):
        device("poke", params={"cpu": state})
        assert adapter.call("read_cpu_state").data == {"state": state}


def test_the_cpu_is_stopped_and_started_and_the_state_is_read(adapter: Any, device: Any) -> None:
    for state in ("STOP", "STOP", "RUN"):
        assert adapter.call("set_cpu_state", state=state).data == {"state": state}
        assert device("image")["cpu"] == state
    device.fault({"service": "stop", "action": {"ack_only": True}})
    error = adapter.call("set_cpu_state", state="STOP").error
    assert (error["code"], error["outcome"]) == ("accepted_pending", "unknown")


def test_stopping_needs_a_switch_of_its_own(rig: Any, device: Any) -> None:
    mark = device.mark()
    client = rig.start("switch", writes="true", S7_CONTROL_ENABLED="")
    error = client.call("set_cpu_state", state="STOP").error
    assert (error["code"], error["outcome"]) == ("writes_disabled", "not_sent")
    assert "S7_CONTROL_ENABLED" in error["message"]
    assert client.call("write_db", valve(value=3)).data["value"] == 3
    assert [request["service"] for request in requests(device, mark)] == ["write"]


def test_the_controller_says_who_it_is_also_in_small_pdus(rig: Any, device: Any) -> None:
    expected = {
        "order_number": "6ES7 315-2EH14-0AB0",
        "firmware": "V3.2.6",
        "station_name": "KIT-STATION",
        "module_name": "KIT-CPU",
        "module_type": "CPU 315-2 PN/DP",
        "serial_number": "S C-KIT000012026",
    }
    reply = rig.adapter.call("read_plc_info")
    assert reply.data == expected
    assert "/data/order_number" in reply.meta["untrusted"]
    device("poke", params={"pdu_size": 240})
    client = rig.start("small")
    assert client.call("read_plc_info").data == expected
    assert client.call("get_connection_status").data == {"connected": True, "pdu_size": 240}
    assert client.call("read_db", db_number=1, start_offset=0, size=222).data["start"] == 0
    assert client.call("read_db", db_number=1, start_offset=0, size=223).error["code"] == "limit_exceeded"


def test_a_ping_is_an_exchange_and_any_answer_will_do(adapter: Any, device: Any) -> None:
    mark = device.mark()
    assert adapter.call("ping").data == {"reachable": True}
    assert len(requests(device, mark)) == 1
    device.fault({"action": {"error": 0xD401}})
    assert adapter.call("ping").data == {"reachable": True}


def test_the_clock_and_a_status_list_are_read(adapter: Any) -> None:
    assert adapter.call("read_system_time").data["time"] >= "2024"
    read = adapter.call("read_szl", szl_id=0x0424).data
    assert (read["record_length"], [record[:8] for record in read["records"]]) == (20, ["4302ff08"])
    assert adapter.call("read_szl", szl_id=0x0999).error["code"] == "unsupported_operation"


# -- tags ------------------------------------------------------------------------------------------------------


def test_tags_are_listed_read_and_written(adapter: Any, device: Any) -> None:
    mark = device.mark()
    assert {tag["name"] for tag in adapter.call("list_tags").data["tags"]} == set(S7_TAGS)
    assert requests(device, mark) == []
    assert adapter.call("write_tag", name="manual", value=True).data["raw"] == "01"
    assert adapter.call("read_tag", name="manual").data["value"] is True
    assert adapter.call("read_tag", name="temperature").data["unit"] == "degC"
    for name, value, code in (
        ("valve", 70000, "range_overflow"),
        ("valve", "x", "type_mismatch"),
        ("temperature", 1, "not_writable"),
        ("nobody", 1, "illegal_address"),
    ):
        error = adapter.call("write_tag", name=name, value=value).error
        assert (error["code"], error["outcome"]) == (code, "not_sent")


# -- what the controller refuses -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("action", "code", "outcome"),
    [
        ({"return_code": 0x01}, "device_failure", "unknown"),
        ({"return_code": 0x03}, "access_denied", "rejected"),
        ({"return_code": 0x05}, "illegal_address", "rejected"),
        ({"return_code": 0x06}, "type_mismatch", "rejected"),
        ({"return_code": 0x07}, "type_mismatch", "rejected"),
        ({"return_code": 0x0A}, "illegal_address", "rejected"),
        ({"return_code": 0x42}, "protocol_error", "unknown"),
        ({"error": 0x8104}, "access_denied", "rejected"),
        ({"error": 0x8302}, "device_busy", "rejected"),
        ({"error": 0x8500}, "protocol_error", "unknown"),
        ({"error": 0x9999}, "protocol_error", "unknown"),
    ],
)
def test_refusals_have_their_codes(adapter: Any, device: Any, action: dict[str, int], code: str, outcome: str) -> None:
    device.fault({"action": action})
    read, write = adapter.call("read_db_typed", valve()), adapter.call("write_db", valve(value=1))
    assert (read.error["code"], read.error["outcome"]) == (code, "not_applicable")
    assert (write.error["code"], write.error["outcome"]) == (code, outcome)
    ((name, number),) = action.items()
    assert read.meta["trace"]["error_code" if name == "error" else "return_code"] == number
    assert (read.meta["attempts"], read.meta["source"]) == (1, "device")


def test_messages_say_what_helps(rig: Any, device: Any) -> None:
    """Optimized data blocks and PUT/GET answer like wrong addresses and unknown services; the reader has to be told."""
    optimized = rig.adapter.call("read_db", db_number=20, start_offset=0, size=2).error
    assert (optimized["code"], "optimized" in optimized["message"]) == ("illegal_address", True)
    device("poke", params={"put_get": False})
    refused = rig.adapter.call("read_db", db_number=10, start_offset=0, size=2).error
    assert (refused["code"], "PUT/GET" in refused["message"]) == ("access_denied", True)
    slot = rig.start("slot", S7_SLOT="2").call("ping").error
    assert (slot["code"], "S7_SLOT" in slot["message"]) == ("config_error", True)


# -- answers that are none -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "action",
    [
        {"answer_data": "07"},
        {"answer_data": ""},
        {"answer_data": "000000"},
        {"answer_count": 2},
        {"answer_function": 5},
        {"answer_reference": 0},
        {"reference": 1},
        {"data_length": 16},
        {"garbage": True},
    ],
)
def test_what_is_no_answer_to_the_request_is_never_data(adapter: Any, device: Any, action: dict[str, Any]) -> None:
    poke(device, "DB10", 0, struct.pack(">h", 4711))
    device.fault({"service": "read", "times": 1, "action": action})
    assert adapter.call("read_db_typed", valve()).error["code"] == "protocol_error"
    assert adapter.call("read_db_typed", valve()).data["value"] == 4711


def test_only_the_reply_to_the_request_is_accepted() -> None:
    protocol = S7Protocol()
    request = bytes.fromhex("3201 0000 0007 000e 0000 0401 120a1002 0002 000a 84 000000".replace(" ", ""))
    right = bytes.fromhex("3203 0000 0007 0002 0006 0000 0401 ff040010 0032".replace(" ", ""))
    assert items_of(request, reply_of(protocol, request, right)) == [(0xFF, b"\0\x32")]
    for position in (0, 1, 7, 9, 12, 13, 15, 17):
        wrong = bytearray(right)
        wrong[position] ^= 0x11
        with pytest.raises(BadReply):
            items_of(request, reply_of(protocol, request, bytes(wrong)))
    for wrong_length in (right[:-1], right + b"\0", right[:12], b""):
        with pytest.raises(BadReply):
            items_of(request, reply_of(protocol, request, wrong_length))


def test_an_answer_that_comes_twice_is_not_the_next_one(adapter: Any, device: Any) -> None:
    poke(device, "DB10", 0, struct.pack(">hh", 1111, 2222))
    device.fault({"times": 1, "action": {"duplicate": True}})
    assert adapter.call("read_db_typed", valve()).data["value"] == 1111
    assert adapter.call("read_db_typed", valve(start_offset=2)).data["value"] == 2222


# -- time and connections --------------------------------------------------------------------------------------


def test_a_late_answer_is_not_the_answer_to_the_next_request(adapter: Any, device: Any) -> None:
    poke(device, "DB10", 0, struct.pack(">hh", 1111, 2222))
    device.fault({"byte": 0, "times": 1, "action": {"delay_s": LATE_S}})
    mark = device.mark()
    identifier = adapter.start("read_db_typed", valve())
    device.wait(mark, kind="request", service="read")
    adapter.pass_time()
    assert adapter.reply("read_db_typed", identifier).error["code"] == "timeout"
    assert adapter.call("read_db_typed", valve(start_offset=2)).data["value"] == 2222
    late = requests(device, mark)[0]
    device.wait(mark, kind="DISCONNECTED", connection=late["connection"])


def test_parallel_calls_get_their_own_answers(adapter: Any, device: Any) -> None:
    values = list(range(1000, 1064))
    poke(device, "DB1", 100, struct.pack(">64h", *values))
    ids = [
        adapter.start("read_db_typed", {"db_number": 1, "start_offset": 100 + 2 * i, "data_type": "INT"})
        for i in range(64)
    ]
    assert [adapter.reply("read_db_typed", identifier).data["value"] for identifier in ids] == values
