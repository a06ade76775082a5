"""The EtherNet/IP reference adapter against the mock controller: its replies and the controller's journal."""

# In the checkout mypy does not find the installed name of the adapters' folder.
# mypy: disable-error-code="import-not-found"

from __future__ import annotations

import struct
from typing import Any

import pytest
from pytest_otmcp.reference_adapters.core import BadReply
from pytest_otmcp.reference_adapters.ethernetip.wire import (
    connected_message,
    modify_service,
    parts_of,
    read_service,
    reply_of,
    several,
)

from .cases import ETHERNETIP, ETHERNETIP_ALIASES

pytestmark = pytest.mark.usefixtures("clean")
CASE = ETHERNETIP
LATE_S = 60.0
"""Seconds after which a late answer would come. The tests do not wait so long: they move the adapter's clock on."""
NUMBERS = {
    "SINT": ("b", [-128, 127]),
    "INT": ("h", [-32768, -2, 32767]),
    "DINT": ("i", [-(2**31), 2**31 - 1]),
    "USINT": ("B", [0, 255]),
    "UINT": ("H", [65535]),
    "UDINT": ("I", [2**32 - 1]),
    "REAL": ("f", [-0.5, 3.4028234663852886e38]),
    "LREAL": ("d", [3.141592653589793, 5e-324]),
}


def poke(device: Any, tag: str, value: object) -> None:
    device("poke", params={"tag": tag, "value": value})


def held(device: Any, tag: str) -> Any:
    return device("image")["points"][tag]


def requests(device: Any, mark: int, **fields: Any) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = device.since(mark, kind="request", **fields)
    return found


def services(device: Any, mark: int) -> list[tuple[str, str | None]]:
    """Return what was asked of the controller, and for which tag."""
    return [(item["asks"], item.get("tag")) for request in requests(device, mark) for item in request["items"]]


def refused(reply: Any) -> tuple[str, str]:
    return reply.error["code"], reply.error["outcome"]


# -- what is read and written --------------------------------------------------------------------------------


def test_there_are_the_seventeen_tools_of_the_paper(adapter: Any) -> None:
    assert set(adapter.tools) == set(ETHERNETIP.tools)
    assert len(adapter.tools) == 17


@pytest.mark.parametrize(("kind", "form", "values"), [(kind, *rest) for kind, rest in NUMBERS.items()], ids=[*NUMBERS])
def test_numbers_are_written_and_read_exactly(
    adapter: Any, device: Any, kind: str, form: str, values: list[Any]
) -> None:
    tag = f"Free{kind.capitalize()}"
    for value in values:
        raw = struct.pack(f"<{form}", value).hex()
        written = adapter.call("write_tag", tag_name=tag, value=value, data_type=kind).data
        assert written == {"tag_name": tag, "type": kind, "value": value, "raw": raw, "status": 0}
        assert held(device, tag) == value
        read = adapter.call("read_tag", tag_name=tag).data
        assert (read["type"], read["value"], read["raw"], read["special"]) == (kind, value, raw, None)


@pytest.mark.parametrize("name", ["NaN", "Infinity", "-Infinity"])
def test_what_json_has_no_number_for_is_named(adapter: Any, device: Any, name: str) -> None:
    poke(device, "FreeReal", name)
    poke(device, "Levels[1]", name)
    data = adapter.call("read_tag", tag_name="FreeReal").data
    assert (data["value"], data["special"]) == (None, name)
    array = adapter.call("read_array", tag_name="Levels", elements=3).data
    assert (array["values"][1], array["specials"]) == (None, [None, name, None])


@pytest.mark.parametrize(("kind", "value"), [("LINT", -(2**63)), ("LINT", 2**53 - 1), ("ULINT", 2**64 - 1)])
def test_whole_numbers_of_64_bits_keep_every_digit(adapter: Any, device: Any, kind: str, value: int) -> None:
    tag = {"tag_name": f"Free{kind.capitalize()}"}
    shown = value if abs(value) < 2**53 else str(value)
    assert adapter.call("write_tag", {**tag, "value": value}).data["value"] == shown
    assert int(held(device, tag["tag_name"])) == value
    assert adapter.call("read_tag", tag).data["value"] == shown


def test_members_elements_and_tags_of_programs_have_names(adapter: Any, device: Any) -> None:
    for tag, value in (
        ("Recipe.Rate", 2.5),
        ("Recipe.Enabled", True),
        ("Recipe.Name", "stopp\xfc"),
        ("Counts[63]", -7),
        ("Program:MainProgram.Step", 9),
        ("Program:MainProgram.Tank_Levels[2]", 1.25),
    ):
        assert adapter.call("write_tag", tag_name=tag, value=value).data["value"] == value
        assert held(device, tag) == value
        assert adapter.call("read_tag", tag_name=tag).data["value"] == value
    assert adapter.call("read_tag", tag_name="recipe.RATE").data["value"] == 2.5


def test_an_array_is_one_request(adapter: Any, device: Any) -> None:
    adapter.call("read_tag", tag_name="Counts[0]")
    mark = device.mark()
    values = [*range(-30, 30)]
    written = adapter.call("write_array", tag_name="Counts[2]", values=values).data
    assert (written["type"], written["values"]) == ("INT", values)
    assert adapter.call("read_array", tag_name="Counts[2]", elements=60).data["values"] == values
    assert services(device, mark) == [("write", "Counts[2]"), ("read", "Counts[2]")]
    assert refused(adapter.call("read_array", tag_name="Counts[60]", elements=5)) == (
        "illegal_address",
        "not_applicable",
    )
    assert refused(adapter.call("write_array", tag_name="Counts[63]", values=[1, 2])) == ("illegal_address", "rejected")


def test_a_text_is_read_written_and_never_cut_off(adapter: Any, device: Any) -> None:
    """pylogix writes the first 82 characters of a longer text."""
    longest = "x" * 81 + "\xfc"
    assert adapter.call("write_string", tag_name="Message", value=longest).data["value"] == longest
    assert held(device, "Message") == longest
    assert adapter.call("read_string", tag_name="Message").data == {"tag_name": "Message", "value": longest}
    mark = device.mark()
    for value, code in (("x" * 83, "limit_exceeded"), ("\u20ac", "type_mismatch")):
        assert refused(adapter.call("write_string", tag_name="Message", value=value)) == (code, "not_sent")
    assert requests(device, mark, state_changing=True) == []
    assert refused(adapter.call("read_string", tag_name="FreeInt")) == ("type_mismatch", "not_applicable")
    assert refused(adapter.call("write_string", tag_name="FreeInt", value="5")) == ("type_mismatch", "not_sent")


def test_a_text_whose_length_cannot_be_is_no_value(adapter: Any, device: Any) -> None:
    content = struct.pack("<i", 83) + bytes(84)
    device.fault({"service": "read", "action": {"answer_data": content.hex()}})
    assert adapter.call("read_string", tag_name="Message").error["code"] == "bad_quality"


# -- the controller knows the type -----------------------------------------------------------------------------


def test_the_controller_is_asked_once_for_a_type(rig: Any, device: Any) -> None:
    client = rig.start("types", writes="true")
    mark = device.mark()
    first = client.call("write_tag", tag_name="Counts[3]", value=1)
    again = client.call("write_tag", tag_name="counts[4]", value=2)
    assert (first.meta["attempts"], again.meta["attempts"]) == (2, 1)
    assert services(device, mark) == [("read", "Counts[3]"), ("write", "Counts[3]"), ("write", "counts[4]")]
    assert [request["state_changing"] for request in requests(device, mark)] == [False, True, True]


@pytest.mark.parametrize(
    ("tag", "value", "code"),
    [
        ("ValvePosition", 2**40, "range_overflow"),
        ("ValvePosition", "abc", "type_mismatch"),
        ("ValvePosition", 3.7, "type_mismatch"),
        ("ValvePosition", True, "type_mismatch"),
        ("FreeUsint", -1, "range_overflow"),
        ("FreeReal", 1e39, "range_overflow"),
        ("FreeReal", "1.5", "type_mismatch"),
        ("PumpEnabled", 5, "type_mismatch"),
        ("Flags.3", 1, "type_mismatch"),
        ("Flags.32", True, "illegal_address"),
        ("FreeReal.3", True, "illegal_address"),
        ("Recipe", 1, "unsupported_operation"),
        ("NoSuchTag", 1, "illegal_address"),
        ("Hidden", 1, "illegal_address"),
        ("Counts[64]", 1, "illegal_address"),
    ],
)
def test_what_a_tag_cannot_hold_is_not_sent(adapter: Any, device: Any, tag: str, value: object, code: str) -> None:
    """pylogix raises ``struct.error`` for 3.7 to a DINT, and writes 5 to a BOOL as true."""
    mark = device.mark()
    expected = (code, "not_sent")
    if tag == "Counts[64]" and adapter.call("read_tag", tag_name="Counts[0]").data:
        # Its type is known from another element, so the controller refuses the write itself.
        expected = (code, "rejected")
        mark = device.mark()
    assert refused(adapter.call("write_tag", tag_name=tag, value=value)) == expected
    assert len(requests(device, mark, state_changing=True)) == (expected[1] == "rejected")


def test_a_type_that_is_not_the_tags_is_refused(adapter: Any, device: Any) -> None:
    mark = device.mark()
    reply = adapter.call("write_tag", tag_name="ValvePosition", value=5, data_type="REAL")
    assert (*refused(reply), reply.error["field"]) == ("type_mismatch", "not_sent", "/data_type")
    assert adapter.call("write_tag", tag_name="Flags.3", value=True, data_type="BOOL").data["type"] == "BOOL"
    assert len(requests(device, mark, state_changing=True)) == 1


def test_a_type_that_has_changed_is_asked_for_again(adapter: Any, device: Any) -> None:
    adapter.call("write_tag", tag_name="ValvePosition", value=5)
    device.fault({"service": "write", "times": 1, "action": {"status": 0xFF, "extended": 0x2107}})
    assert refused(adapter.call("write_tag", tag_name="ValvePosition", value=6)) == ("type_mismatch", "rejected")
    mark = device.mark()
    assert adapter.call("write_tag", tag_name="ValvePosition", value=7).data["value"] == 7
    assert [asked for asked, _ in services(device, mark)] == ["read", "write"]


@pytest.mark.parametrize("tag", ["Recipe", "FreeDint"])
def test_what_is_no_elementary_value_is_not_read_as_one(adapter: Any, device: Any, tag: str) -> None:
    """The index of an array of BOOL is that of 32 of them: pylogix divides it, whoever forgets that reads another one."""
    device.fault({"tag": "FreeDint", "action": {"answer_type": 0xD3}})
    assert refused(adapter.call("read_tag", tag_name=tag)) == ("unsupported_operation", "not_applicable")


def test_a_bit_is_written_as_a_bit(adapter: Any, device: Any) -> None:
    poke(device, "Flags", 0x4A)
    adapter.call("read_tag", tag_name="Flags")
    device("poke", params={"restless": [{"tag": "Flags", "bits": 0x40}]})
    mark = device.mark()
    for bit, value in ((5, True), (1, False), (31, True)):
        assert adapter.call("write_tag", tag_name=f"Flags.{bit}", value=value).data["value"] is value
    device("poke", params={"restless": []})
    assert held(device, "Flags") == 0x28 - 2**31
    assert services(device, mark) == [("modify", "Flags")] * 3
    assert [adapter.call("read_tag", tag_name=f"Flags.{bit}").data["value"] for bit in (5, 1, 31)] == [
        True,
        False,
        True,
    ]


def test_the_masks_of_a_bit_leave_every_other_bit_alone() -> None:
    path = bytes.fromhex("9105") + b"Flags\0"
    assert modify_service(path, 4, 3, True).hex() == "4e04" + path.hex() + "0400" + "08000000" + "ffffffff"
    assert modify_service(path, 4, 3, False).hex() == "4e04" + path.hex() + "0400" + "00000000" + "f7ffffff"


# -- several tags by one request -------------------------------------------------------------------------------


def test_several_tags_are_one_request(adapter: Any, device: Any) -> None:
    values = {"ValvePosition": -3, "Flags.7": True, "Recipe.Rate": 0.5, "Message": "go"}
    payloads = [{"tag_name": tag, "value": value} for tag, value in values.items()]
    adapter.call("write_multiple_tags", payloads=payloads)
    mark = device.mark()
    written = adapter.call("write_multiple_tags", payloads=payloads)
    assert [tag["status"] for tag in written.data["tags"]] == [0, 0, 0, 0]
    assert written.meta["attempts"] == 1
    read = adapter.call("read_multiple_tags", tags=[*values]).data["tags"]
    assert {tag["tag_name"]: tag["value"] for tag in read} == values
    assert [request["service"] for request in requests(device, mark)] == ["multiple", "multiple"]


def test_the_types_of_several_tags_are_asked_for_by_one_request(rig: Any, device: Any) -> None:
    client = rig.start("several", writes="true")
    mark = device.mark()
    payloads = [{"tag_name": tag, "value": 1} for tag in ("ValvePosition", "HeaterPower", "Counts[1]", "Counts[2]")]
    assert client.call("write_multiple_tags", payloads=payloads).meta["attempts"] == 2
    assert [len(request["items"]) for request in requests(device, mark)] == [3, 4]
    mark = device.mark()
    payloads.append({"tag_name": "NoSuchTag", "value": 1})
    assert refused(client.call("write_multiple_tags", payloads=payloads)) == ("illegal_address", "not_sent")
    assert requests(device, mark, state_changing=True) == []


def test_a_write_of_which_a_part_is_refused_says_so(adapter: Any, device: Any) -> None:
    payloads = [{"tag_name": "ValvePosition", "value": 5}, {"tag_name": "Locked", "value": 5}]
    reply = adapter.call("write_multiple_tags", payloads=payloads)
    assert refused(reply) == ("partial_failure", "partial")
    assert reply.envelope["data"]["partial"] == [
        {"tag_name": "ValvePosition", "written": True, "status": 0, "extended_status": None},
        {"tag_name": "Locked", "written": False, "status": 0x0F, "extended_status": None},
    ]
    assert (held(device, "ValvePosition"), held(device, "Locked")) == (5, 4711)
    reply = adapter.call("write_multiple_tags", payloads=payloads[1:] * 2)
    assert refused(reply) == ("access_denied", "rejected")


def test_a_read_of_which_a_part_is_refused_says_so(adapter: Any) -> None:
    reply = adapter.call("read_multiple_tags", tags=["ValvePosition", "NoSuchTag"])
    assert refused(reply) == ("partial_failure", "not_applicable")
    assert [tag["read"] for tag in reply.envelope["data"]["partial"]] == [True, False]
    reply = adapter.call("read_multiple_tags", tags=["Missing", "NoSuchTag"])
    assert refused(reply) == ("illegal_address", "not_applicable")


# -- the controller ----------------------------------------------------------------------------------------------


def test_the_controller_says_who_it_is(adapter: Any) -> None:
    reply = adapter.call("get_plc_info")
    assert (reply.data["product_name"][:6], reply.data["vendor_id"], reply.data["device_type"]) == ("1756-L", 1, 14)
    assert reply.meta["untrusted"] == ["/data/product_name"]
    assert adapter.call("get_connection_status").data == {"connected": True, "message_size": 4002}


def test_a_ping_is_an_exchange_and_any_answer_will_do(adapter: Any, device: Any) -> None:
    mark = device.mark()
    assert adapter.call("ping").data == {"reachable": True}
    assert len(requests(device, mark)) == 1
    device.fault({"action": {"status": 0x08}})
    assert adapter.call("ping").data == {"reachable": True}


def test_the_tags_of_each_scope_are_listed(adapter: Any) -> None:
    listed = adapter.call("get_tag_list").data
    tags = {tag["tag_name"]: (tag["type"], tag["dimensions"]) for tag in listed["tags"]}
    assert listed["programs"] == ["Program:MainProgram"]
    assert tags["ValvePosition"] == ("DINT", [])
    assert (tags["Levels"], tags["Message"], tags["Recipe"]) == (("REAL", [10]), ("STRING", []), ("STRUCT", []))
    assert tags["PumpEnabled"] == ("BOOL", [])
    assert "Hidden" not in tags
    assert not any(":" in name or name.startswith("__") for name in tags)
    listed = adapter.call("get_tag_list", program="Program:MainProgram").data
    assert [tag["tag_name"] for tag in listed["tags"]] == [
        "Program:MainProgram.MotorSpeed",
        "Program:MainProgram.Tank_Levels",
        "Program:MainProgram.Step",
    ]
    assert adapter.call("get_tag_list", program="Program:Nobody").error["code"] == "illegal_address"


def test_the_clock_is_read_and_set_to_the_time_that_is_given(adapter: Any, device: Any) -> None:
    """pylogix sets the time of the machine that it runs on."""
    assert adapter.call("get_plc_time").data["time"] >= "2024"
    for given, shown in (("2031-05-06T07:08:09", "07:08"), ("2031-05-06T07:08:09+02:00", "05:08")):
        mark = device.mark()
        assert adapter.call("set_plc_time", time=given).data["time"].startswith(f"2031-05-06T{shown}")
        assert [asked for asked, _ in services(device, mark)] == ["set_clock", "clock"]
    device.fault({"service": "set_clock", "action": {"ack_only": True}})
    reply = adapter.call("set_plc_time", time="2032-05-06T07:08:09")
    assert refused(reply) == ("verify_failed", "applied")


def test_setting_the_clock_needs_a_switch_of_its_own(rig: Any, device: Any) -> None:
    mark = device.mark()
    client = rig.start("switch", writes="true", ETHERNETIP_CONTROL_ENABLED="")
    reply = client.call("set_plc_time", time="2031-05-06T07:08:09")
    assert refused(reply) == ("writes_disabled", "not_sent")
    assert "ETHERNETIP_CONTROL_ENABLED" in reply.error["message"]
    assert client.call("write_tag", tag_name="ValvePosition", value=3).data["value"] == 3
    assert [asked for asked, _ in services(device, mark)] == ["read", "write"]


def test_aliases_are_listed_read_and_written(adapter: Any, device: Any) -> None:
    mark = device.mark()
    assert {tag["alias"] for tag in adapter.call("list_tags").data["tags"]} == set(ETHERNETIP_ALIASES)
    assert requests(device, mark) == []
    assert adapter.call("write_tag_by_alias", alias="manual", value=True).data["tag_name"] == "Flags.5"
    assert adapter.call("read_tag_by_alias", alias="manual").data["value"] is True
    assert adapter.call("read_tag_by_alias", alias="temperature").data["unit"] == "degC"
    for value, code in ((2**31, "range_overflow"), ("x", "type_mismatch")):
        assert refused(adapter.call("write_tag_by_alias", alias="valve", value=value)) == (code, "not_sent")


# -- what the controller refuses ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("status", "extended", "code", "outcome"),
    [
        (0x02, None, "device_busy", "rejected"),
        (0x03, None, "illegal_value", "rejected"),
        (0x04, 0, "illegal_address", "rejected"),
        (0x05, None, "illegal_address", "rejected"),
        (0x08, None, "unsupported_operation", "rejected"),
        (0x0C, None, "device_busy", "rejected"),
        (0x0E, None, "not_writable", "rejected"),
        (0x0F, None, "access_denied", "rejected"),
        (0x10, None, "device_busy", "rejected"),
        (0x11, None, "limit_exceeded", "rejected"),
        (0x13, None, "protocol_error", "unknown"),
        (0x20, None, "illegal_value", "rejected"),
        (0x26, None, "protocol_error", "unknown"),
        (0xFF, 0x2104, "illegal_address", "rejected"),
        (0xFF, 0x2105, "illegal_address", "rejected"),
        (0xFF, 0x2107, "type_mismatch", "rejected"),
        (0xFF, 0x9999, "protocol_error", "unknown"),
        (0x7E, None, "protocol_error", "unknown"),
    ],
)
def test_refusals_have_their_codes(
    adapter: Any, device: Any, status: int, extended: int | None, code: str, outcome: str
) -> None:
    adapter.call("write_tag", tag_name="ValvePosition", value=1)
    action = {"status": status} if extended is None else {"status": status, "extended": extended}
    device.fault({"service": "read", "action": action}, {"service": "write", "action": action})
    read = adapter.call("read_tag", tag_name="ValvePosition")
    write = adapter.call("write_tag", tag_name="ValvePosition", value=1)
    assert refused(read) == (code, "not_applicable")
    assert refused(write) == (code, outcome)
    trace = read.meta["trace"]
    assert (trace["status"], trace.get("extended_status")) == (status, extended)
    assert (read.meta["attempts"], read.meta["source"]) == (1, "device")


@pytest.mark.parametrize(
    ("status", "code", "outcome"),
    [(0x64, "session_error", "rejected"), (0x02, "device_busy", "rejected"), (0x03, "protocol_error", "unknown")],
)
def test_a_refusal_of_the_frame_ends_the_connection(
    adapter: Any, device: Any, status: int, code: str, outcome: str
) -> None:
    generation = adapter.call("write_tag", tag_name="ValvePosition", value=1).meta["connection"]["generation"]
    device.fault({"service": "write", "times": 1, "action": {"encapsulation": status}})
    assert refused(adapter.call("write_tag", tag_name="ValvePosition", value=2)) == (code, outcome)
    reply = adapter.call("write_tag", tag_name="ValvePosition", value=3)
    assert (reply.data["value"], reply.meta["connection"]["generation"]) == (3, generation + 1)


def test_messages_say_what_helps(rig: Any, device: Any) -> None:
    slot = rig.start("slot", ETHERNETIP_SLOT="2").call("ping").error
    assert (slot["code"], "ETHERNETIP_SLOT" in slot["message"]) == ("config_error", True)
    device("poke", params={"connection_limit": 0})
    busy = rig.start("full").call("ping").error
    assert (busy["code"], busy["retryable"]) == ("device_busy", True)


# -- answers that are none ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "action",
    [
        {"answer_data": "07"},
        {"answer_data": ""},
        {"answer_data": "0000000000"},
        {"answer_type": 0xC3},
        {"answer_service": 0x4D},
        {"sequence": 1},
        {"connection": 1},
        {"length": -1},
        {"garbage": True},
    ],
    ids=str,
)
def test_what_is_no_answer_to_the_request_is_never_data(adapter: Any, device: Any, action: dict[str, Any]) -> None:
    """pylogix looks at the status of an answer alone."""
    poke(device, "ValvePosition", 4711)
    device.fault({"service": "read", "times": 1, "action": action})
    assert adapter.call("read_tag", tag_name="ValvePosition").error["code"] == "protocol_error"
    assert adapter.call("read_tag", tag_name="ValvePosition").data["value"] == 4711


def test_only_the_reply_to_the_request_is_accepted() -> None:
    right = bytes.fromhex("cc000000c40007000000")
    assert reply_of(0x4C, right).data.hex() == "c40007000000"
    for wrong in (b"", right[:3], b"\xcd" + right[1:], b"\x4c" + right[1:], bytes.fromhex("cc00ff020421")):
        with pytest.raises(BadReply):
            reply_of(0x4C, wrong)


def test_only_the_replies_to_all_requests_are_accepted() -> None:
    request = several([read_service(b"\x91\x01a\0", 1), read_service(b"\x91\x01b\0", 1)])
    part = bytes.fromhex("cc000000c1000a")
    data = struct.pack("<3H", 2, 6, 6 + len(part)) + 2 * part
    right = reply_of(0x0A, b"\x8a\0\0\0" + data)
    assert [reply.data.hex() for reply in parts_of(request, right)] == ["c1000a", "c1000a"]
    for place, value in ((0, 1), (0, 3), (2, 7), (2, 5), (4, 3), (4, 200), (6, 0xCD), (13, 0x4C)):
        wrong = bytearray(data)
        wrong[place] = value
        with pytest.raises(BadReply):
            parts_of(request, reply_of(0x0A, b"\x8a\0\0\0" + bytes(wrong)))


def test_only_whole_items_are_accepted() -> None:
    body = bytes.fromhex("000000000000 0200 a100 0400 01020304 b100 0600 0500 cc000000")
    assert connected_message(body) == (0x04030201, 5, bytes.fromhex("cc000000"))
    for wrong in (body[:-1], body + b"\0", body[:7], body[:6] + b"\1" + body[7:], body[:8] + b"\xa0" + body[9:]):
        with pytest.raises(BadReply):
            connected_message(wrong)


def test_an_answer_that_comes_twice_is_not_the_next_one(adapter: Any, device: Any) -> None:
    poke(device, "ValvePosition", 1111)
    poke(device, "HeaterPower", 2222)
    device.fault({"times": 1, "action": {"duplicate": True}})
    assert adapter.call("read_tag", tag_name="ValvePosition").data["value"] == 1111
    assert adapter.call("read_tag", tag_name="HeaterPower").data["value"] == 2222


def test_the_trace_is_what_was_on_the_wire(adapter: Any, device: Any) -> None:
    mark = device.mark()
    trace = adapter.call("read_tag", tag_name="Flags.3").meta["trace"]
    (request,) = requests(device, mark)
    assert trace == {"service": 0x4C, "tag": "Flags", "sequences": [request["sequence"]]}


# -- time and connections ----------------------------------------------------------------------------------------


def test_a_late_answer_is_not_the_answer_to_the_next_request(adapter: Any, device: Any) -> None:
    poke(device, "ValvePosition", 1111)
    poke(device, "HeaterPower", 2222)
    device.fault({"tag": "ValvePosition", "times": 1, "action": {"delay_s": LATE_S}})
    mark = device.mark()
    identifier = adapter.start("read_tag", {"tag_name": "ValvePosition"})
    device.wait(mark, kind="request", service="read")
    adapter.pass_time()
    assert adapter.reply("read_tag", identifier).error["code"] == "timeout"
    assert adapter.call("read_tag", tag_name="HeaterPower").data["value"] == 2222
    late = requests(device, mark)[0]
    device.wait(mark, kind="DISCONNECTED", connection=late["connection"])


def test_parallel_calls_get_their_own_answers(adapter: Any, device: Any) -> None:
    values = [*range(1000, 1064)]
    for index, value in enumerate(values):
        poke(device, f"Counts[{index}]", value)
    ids = [adapter.start("read_tag", {"tag_name": f"Counts[{index}]"}) for index in range(64)]
    assert [adapter.reply("read_tag", identifier).data["value"] for identifier in ids] == values


def test_many_calls_use_one_cip_connection(adapter: Any, device: Any) -> None:
    adapter.call("ping")
    before = device("image")["connections"]
    for _ in range(30):
        adapter.call("read_tag", tag_name="ValvePosition")
    assert device("image")["connections"] == before


def test_a_connection_that_the_controller_has_forgotten_is_not_used(rig: Any, adapter: Any, device: Any) -> None:
    """A controller does not answer on a connection that it does not know, so the call would end by its time-out."""
    generation = adapter.call("ping").meta["connection"]["generation"]
    for _ in range(3):
        for client in (adapter, rig.guarded):
            client.pass_time()
    device("poke", params={"connections": "forget"})
    mark = device.mark()
    reply = adapter.call("write_tag", tag_name="ValvePosition", value=4)
    assert (reply.data["value"], reply.meta["connection"]["generation"]) == (4, generation + 1)
    assert len(requests(device, mark, state_changing=True)) == 1


def test_a_controller_without_large_connections_gets_small_ones(rig: Any, device: Any) -> None:
    device.fault({"service": "forward_open", "times": 1, "action": {"status": 0x01, "extended": 0x0109}})
    client = rig.start("small", writes="true")
    assert client.call("get_connection_status").data["message_size"] == 504
    device.fault()
    assert len(client.call("read_array", tag_name="Counts", elements=64).data["values"]) == 64
    listed = client.call("get_tag_list")
    assert listed.meta["attempts"] > 1
    assert listed.data == rig.adapter.call("get_tag_list").data
    payloads = [{"tag_name": "Message", "value": "x"}] * 6
    assert refused(client.call("write_multiple_tags", payloads=payloads)) == ("limit_exceeded", "not_sent")
