"""The DNP3 reference adapter against the mock outstation: its replies and the outstation's journal."""

# In the checkout mypy does not find the installed name of the adapters' folder.
# mypy: disable-error-code="import-not-found"

from __future__ import annotations

import json
from importlib import import_module
from typing import Any

import pytest
from pytest_otmcp.reference_adapters.core import ConfigError

from .cases import DNP3, Unfit

CASE = DNP3
CONFIRM, READ, WRITE, SELECT, OPERATE, DIRECT_OPERATE = range(6)
PUMP = {"outstation_address": 10, "index": 2}
AT_ONCE = {"outstation_address": 10, "start_index": 0, "count": 4}
CLASS_1 = {"outstation_address": 10, "event_class": 1}
CONTACT = "binary_input/3"


@pytest.fixture(autouse=True)
def clean(device: Any) -> None:
    device("reset")
    # Whoever shows that the outstation has restarted is told so once; the tests are about what follows.
    device("poke", params={"restarted": False})


def points(device: Any) -> dict[str, Any]:
    found: dict[str, Any] = device("image")["points"]
    return found


def functions(device: Any, mark: int) -> list[int]:
    """Return the functions of the requests that have reached the outstation."""
    return [entry["function"] for entry in device.since(mark, kind="request")]


def test_there_are_the_eight_tools_of_the_paper(adapter: Any) -> None:
    assert set(adapter.tools) == set(DNP3.tools)
    assert len(DNP3.tools) == 8


# -- reading -----------------------------------------------------------------------------------------------------


def test_what_the_outstation_holds_is_told(adapter: Any, device: Any) -> None:
    device("poke", params={"point": "analog_input/1", "value": -70, "flags": ["ONLINE", "LOCAL_FORCED"]})
    told = adapter.call("read_analog_inputs", AT_ONCE).data["points"]
    assert [point["value"] for point in told] == [points(device)[f"analog_input/{index}"] for index in range(4)]
    assert (told[1]["value"], told[1]["flags"]) == (-70, ["ONLINE", "LOCAL_FORCED"])
    states = adapter.call("read_binary_inputs", {**AT_ONCE, "count": 16}).data["points"]
    assert [(one["index"], one["value"], one["flags"]) for one in states] == [
        (index, index % 2 == 0, ["ONLINE"]) for index in range(16)
    ]
    assert adapter.call("read_point_by_alias", alias="pulses").data["value"] == 1000
    assert adapter.call("read_point_by_alias", alias="flow").data["value"] == 1.5
    assert adapter.call("read_point_by_alias", alias="note").data["value"] == "ready"
    assert adapter.call("ping").data == {"reachable": True, "outstation_address": 10}


def test_a_range_is_one_request_for_that_range(adapter: Any, device: Any) -> None:
    mark = device.mark()
    reply = adapter.call("read_analog_inputs", AT_ONCE)
    (request,) = device.since(mark, kind="request")
    assert (request["function"], request["apdu"][4:]) == (READ, "1e00000003")
    assert (reply.meta["attempts"], reply.meta["trace"]["sequences"]) == (1, [request["sequence"]])


def test_a_point_that_the_outstation_does_not_vouch_for_is_no_success(adapter: Any, device: Any) -> None:
    stale = adapter.call("read_point_by_alias", alias="stale")
    assert stale.error["code"] == "bad_quality"
    assert stale.envelope["data"]["partial"]["flags"] == ["COMM_LOST"]
    some = adapter.call("read_analog_inputs", {**AT_ONCE, "start_index": 5, "count": 3})
    assert (some.error["code"], some.error["details"]) == ("partial_failure", {"indexes": [6]})
    assert [point["index"] for point in some.envelope["data"]["partial"]["points"]] == [5, 6, 7]
    device("poke", params={"trouble": True})
    troubled = adapter.call("read_analog_inputs", AT_ONCE)
    assert troubled.error["code"] == "bad_quality"
    assert "DEVICE_TROUBLE" in troubled.meta["trace"]["indications"]


@pytest.mark.parametrize("flag", ["RESTART", "COMM_LOST", "OVER_RANGE", "REFERENCE_ERR"])
def test_each_flag_that_makes_a_value_doubtful_is_heeded(adapter: Any, device: Any, flag: str) -> None:
    device("poke", params={"point": "analog_input/1", "flags": ["ONLINE", flag]})
    assert adapter.call("read_point_by_alias", alias="level").error["code"] == "bad_quality"


@pytest.mark.parametrize("special", ["NaN", "Infinity", "-Infinity"])
def test_numbers_that_json_does_not_have_are_told_as_special(adapter: Any, device: Any, special: str) -> None:
    device("poke", params={"point": "analog_input/7", "value": special})
    told = adapter.call("read_point_by_alias", alias="flow").data
    assert (told["value"], told["special"]) == (None, special)


@pytest.mark.parametrize(
    ("objects", "values"),
    [
        ("1e02000003" + "01ffff" * 4, [-1] * 4),
        ("1e03000003" + "feffffff" * 4, [-2] * 4),
        ("1e04000003" + "0300" * 4, [3] * 4),
        ("1e05000003" + "010000c03f" * 4, [1.5] * 4),
        ("1e06000003" + "01000000000000f83f" * 4, [1.5] * 4),
        ("1e01000001" + "0107000000" * 2 + "1e02000203" + "010800" * 2, [7, 7, 8, 8]),
    ],
)
def test_every_variation_of_an_analog_input_is_read(
    adapter: Any, device: Any, objects: str, values: list[float]
) -> None:
    device.fault({"function": READ, "action": {"answer_objects": objects}})
    assert [one["value"] for one in adapter.call("read_analog_inputs", AT_ONCE).data["points"]] == values


def test_packed_bits_beyond_the_first_octet_are_read(adapter: Any, device: Any) -> None:
    device.fault({"function": READ, "action": {"answer_objects": "010100040f" + "a50c"}})
    told = adapter.call("read_binary_inputs", {**AT_ONCE, "start_index": 4, "count": 12}).data["points"]
    assert [one["value"] for one in told] == [bool(0x0CA5 >> bit & 1) for bit in range(12)]
    assert {one["flags"] is None for one in told} == {True}


@pytest.mark.parametrize(
    "action",
    [
        {"answer_index": 1},
        {"answer_objects": ""},
        {"answer_objects": "1e01000002" + "0107000000" * 3},
        {"answer_objects": "0102000003" + "81" * 4},
        {"answer_objects": "1e01000003"},
        {"answer_objects": "1e63000003" + "00" * 4},
    ],
    ids=["other indexes", "nothing", "too few", "another type", "no data", "unknown objects"],
)
def test_an_answer_to_something_else_is_not_data(adapter: Any, device: Any, action: Any) -> None:
    device.fault({"function": READ, "action": action})
    assert adapter.call("read_analog_inputs", AT_ONCE).error["code"] == "protocol_error"


@pytest.mark.parametrize(
    ("iin", "code"), [(0x0100, "unsupported_operation"), (0x0200, "illegal_address"), (0x1000, "device_busy")]
)
def test_a_refusal_by_indications_has_its_code(adapter: Any, device: Any, iin: int, code: str) -> None:
    device.fault({"function": READ, "action": {"iin": iin}})
    reply = adapter.call("read_analog_inputs", AT_ONCE)
    assert (reply.error["code"], reply.meta["trace"]["iin"]) == (code, iin)


def test_points_that_do_not_exist_are_an_illegal_address(adapter: Any) -> None:
    error = adapter.call("read_analog_inputs", {**AT_ONCE, "start_index": 2, "count": 8}).error
    assert (error["code"], error["outcome"]) == ("illegal_address", "not_applicable")


# -- events ------------------------------------------------------------------------------------------------------


def test_events_are_told_with_their_time_confirmed_and_then_gone(adapter: Any, device: Any) -> None:
    for value in (True, False):
        device("poke", params={"point": CONTACT, "value": value})
    mark = device.mark()
    told = adapter.call("poll_class", CLASS_1).data
    assert [(one["point_type"], one["index"], one["value"]) for one in told["points"]] == [
        ("binary_input", 3, True),
        ("binary_input", 3, False),
    ]
    assert all(one["timestamp"].endswith("+00:00") for one in told["points"])
    (response,) = device.since(mark, kind="response")
    (confirm,) = device.wait(mark, kind="confirm")
    assert (confirm["sequence"], confirm["unsolicited"]) == (response["sequence"], False)
    assert adapter.call("poll_class", CLASS_1).data["points"] == []


def test_class_0_is_the_present_values_of_all_points(adapter: Any) -> None:
    told = adapter.call("poll_class", {**CLASS_1, "event_class": 0}).data["points"]
    assert {one["point_type"] for one in told} >= {
        "binary_input",
        "binary_output",
        "counter",
        "analog_input",
        "analog_output",
    }


def test_a_time_that_is_relative_to_another_object_is_told_as_one(adapter: Any, device: Any) -> None:
    # g51v1 with the common time 2026-01-01T00:00:00Z, g2v3 250 ms later.
    common = 1767225600000
    objects = "330107" + "01" + common.to_bytes(6, "little").hex() + "020317" + "01" + "03" + "81" + "fa00"
    device.fault({"function": READ, "action": {"answer_objects": objects}})
    (event,) = adapter.call("poll_class", CLASS_1).data["points"]
    assert (event["value"], event["timestamp"]) == (True, "2026-01-01T00:00:00.250+00:00")


def test_an_unsolicited_response_within_a_poll_is_confirmed_and_kept_apart(adapter: Any, device: Any) -> None:
    device("poke", params={"point": CONTACT, "value": True})
    device.fault({"function": READ, "times": 1, "action": {"unsolicited": True}})
    mark = device.mark()
    told = adapter.call("read_analog_inputs", AT_ONCE).data["points"]
    assert [one["value"] for one in told] == [points(device)[f"analog_input/{index}"] for index in range(4)]
    device.wait(mark, kind="confirm", unsolicited=True)
    polled = adapter.call("poll_class", CLASS_1).data
    assert polled["points"] == []
    assert [(one["index"], one["value"]) for one in polled["unsolicited"]] == [(3, True)]
    assert adapter.call("poll_class", CLASS_1).data["unsolicited"] == []


def test_an_unsolicited_response_between_calls_is_confirmed_too(adapter: Any, device: Any) -> None:
    adapter.call("ping")
    device("poke", params={"point": "binary_input/4", "value": False})
    mark = device.mark()
    device("poke", params={"unsolicited": [1]})
    device.wait(mark, kind="confirm", unsolicited=True)
    (event,) = adapter.call("poll_class", CLASS_1).data["unsolicited"]
    assert (event["index"], event["value"]) == (4, False)


def test_events_beyond_what_can_be_kept_stay_with_the_outstation(device: Any, rig: Any) -> None:
    subject = rig.start("forgetful")
    subject.call("ping")
    mark = device.mark()
    for _ in range(11):
        for number in range(100):
            device("poke", params={"point": CONTACT, "value": bool(number % 2)})
        device("poke", params={"unsolicited": [1]})
        subject.call("ping")
    device.since(mark, kind="confirm", unsolicited=True)
    assert len(subject.call("poll_class", CLASS_1).data["unsolicited"]) == 1000
    subject.close()


# -- commands ----------------------------------------------------------------------------------------------------


def test_an_output_is_selected_operated_once_and_read(adapter: Any, device: Any) -> None:
    mark = device.mark()
    reply = adapter.call("write_binary_output", **PUMP, value=True)
    assert reply.data["state"] is points(device)["binary_output/2"] is True
    assert (reply.data["code"], reply.data["status"]) == ("latch_on", "SUCCESS")
    select, operate, read = device.since(mark, kind="request")
    assert (select["function"], operate["function"], read["function"]) == (SELECT, OPERATE, READ)
    assert select["apdu"][4:] == operate["apdu"][4:] == "0c01170102" + "0301" + "00" * 9
    assert operate["sequence"] == (select["sequence"] + 1) % 16
    assert (reply.meta["attempts"], reply.meta["trace"]["functions"]) == (3, [SELECT, OPERATE, READ])


def test_the_sequence_numbers_go_round(adapter: Any) -> None:
    assert {
        adapter.call("write_binary_output", **PUMP, value=bool(number % 2)).data["status"] for number in range(20)
    } == {"SUCCESS"}


def test_an_index_above_255_is_written_in_two_octets_as_its_count_is(adapter: Any, device: Any) -> None:
    mark = device.mark()
    error = adapter.call("write_point_by_alias", alias="beyond", value=True).error
    (select,) = device.since(mark, kind="request")
    assert select["apdu"][4:] == "0c012801002c01" + "0301" + "00" * 9
    assert "problem" not in select
    assert (error["code"], error["outcome"]) == ("unsupported_operation", "rejected")


def test_pulses_trip_and_close_have_codes_and_times(adapter: Any, device: Any) -> None:
    mark = device.mark()
    pulse = {"outstation_address": 10, "index": 6, "value": True, "code": "pulse_on", "count": 2, "on_time_ms": 300}
    told = adapter.call("write_binary_output", pulse).data
    assert (told["state"], points(device)["binary_output/6/pulses"]) == (None, 2)
    assert device.since(mark, kind="request")[0]["apdu"][14:] == "0102" + "2c010000" + "00000000" + "00"
    for value, code in ((True, "close"), (False, "trip")):
        adapter.call("write_binary_output", outstation_address=10, index=7, value=value, code=code)
        assert points(device)["binary_output/7"] is value


@pytest.mark.parametrize(
    ("index", "code"), [(99, "unsupported_operation"), (5, "access_denied"), (6, "unsupported_operation")]
)
def test_a_select_that_is_refused_is_followed_by_nothing(adapter: Any, device: Any, index: int, code: str) -> None:
    mark = device.mark()
    error = adapter.call("write_binary_output", outstation_address=10, index=index, value=True).error
    assert (error["code"], error["outcome"]) == (code, "rejected")
    assert functions(device, mark) == [SELECT]


@pytest.mark.parametrize(
    ("status", "code", "outcome"),
    [
        (1, "session_error", "rejected"),
        (2, "session_error", "rejected"),
        (3, "protocol_error", "unknown"),
        (4, "unsupported_operation", "rejected"),
        (5, "device_busy", "rejected"),
        (6, "device_failure", "unknown"),
        (7, "access_denied", "rejected"),
        (8, "limit_exceeded", "rejected"),
        (9, "access_denied", "rejected"),
        (10, "access_denied", "rejected"),
        (11, "device_busy", "rejected"),
        (12, "illegal_value", "rejected"),
        (99, "protocol_error", "unknown"),
    ],
)
def test_every_status_of_an_operate_has_its_code(
    adapter: Any, device: Any, status: int, code: str, outcome: str
) -> None:
    device.fault({"function": OPERATE, "action": {"status": status}})
    mark = device.mark()
    reply = adapter.call("write_binary_output", **PUMP, value=True)
    assert (reply.error["code"], reply.error["outcome"], reply.meta["trace"]["status"]) == (code, outcome, status)
    assert functions(device, mark) == [SELECT, OPERATE]


@pytest.mark.parametrize(
    "action", [{"answer_objects": ""}, {"answer_index": 1}, {"answer_objects": "0c01170102" + "0401" + "00" * 9}]
)
def test_a_command_that_is_not_repeated_in_the_answer_is_no_success(adapter: Any, device: Any, action: Any) -> None:
    device.fault({"function": OPERATE, "action": action})
    error = adapter.call("write_binary_output", **PUMP, value=True).error
    assert (error["code"], error["outcome"]) == ("protocol_error", "unknown")


@pytest.mark.parametrize(
    ("tool", "arguments", "function"),
    [
        ("write_binary_output", {**PUMP, "value": True}, OPERATE),
        ("write_point_by_alias", {"alias": "setpoint", "value": 7.5}, OPERATE),
        ("write_point_by_alias", {"alias": "note", "value": "gone"}, WRITE),
    ],
)
def test_an_outstation_that_says_yes_and_does_nothing_is_found_out(
    adapter: Any, device: Any, tool: str, arguments: Any, function: int
) -> None:
    device.fault({"function": function, "action": {"ack_only": True}})
    error = adapter.call(tool, arguments).error
    assert (error["code"], error["outcome"]) == ("verify_failed", "applied")


@pytest.mark.parametrize(
    ("alias", "value", "objects"),
    [
        ("setpoint", 40.7, "2903170100" + "cdcc2242" + "00"),
        ("limited", 40.5, "2904170102" + "0000000000404440" + "00"),
        ("batch", -7, "2901170103" + "f9ffffff" + "00"),
        ("short", 300.0, "2902170103" + "2c01" + "00"),
        ("pump", False, "0c01170102" + "0401" + "00" * 9),
    ],
)
def test_an_alias_is_written_as_its_type(adapter: Any, device: Any, alias: str, value: Any, objects: str) -> None:
    mark = device.mark()
    told = adapter.call("write_point_by_alias", alias=alias, value=value).data
    assert [entry["apdu"][4:] for entry in device.since(mark, state_changing=True)] == [objects] * 2
    assert told["value"] == value
    assert told["state"] == points(device)[f"{told['point_type']}/{told['index']}"]


@pytest.mark.parametrize("text", ["käthe", " spaces ", "x" * 255])
def test_a_text_is_written_and_read_as_it_is(adapter: Any, device: Any, text: str) -> None:
    assert adapter.call("write_point_by_alias", alias="note", value=text).data["state"] == text
    assert points(device)["octet_string/0"] == text
    assert adapter.call("read_point_by_alias", alias="note").data["value"] == text


def test_a_value_beyond_the_limits_of_the_point_is_refused_by_the_outstation(adapter: Any) -> None:
    error = adapter.call("write_point_by_alias", alias="limited", value=1e9).error
    assert (error["code"], error["outcome"]) == ("illegal_value", "rejected")


def test_direct_operate_needs_a_switch_of_its_own(rig: Any, adapter: Any, device: Any) -> None:
    wanted = {**PUMP, "value": True, "mode": "direct_operate"}
    assert adapter.call("write_binary_output", wanted).error["code"] == "writes_disabled"
    direct = rig.start("direct", writes="true", DNP3_DIRECT_OPERATE_ENABLED="true")
    mark = device.mark()
    assert direct.call("write_binary_output", wanted).data["state"] is True
    assert functions(device, mark) == [DIRECT_OPERATE, READ]
    direct.close()


# -- the guard and what every master writes ----------------------------------------------------------------------


@pytest.mark.parametrize("unfit", DNP3.unfit, ids=lambda unfit: f"{unfit.tool}-{unfit.code}")
def test_unfit_arguments_are_refused_before_anything_is_sent(adapter: Any, device: Any, unfit: Unfit) -> None:
    mark = device.mark()
    error = adapter.call(unfit.tool, unfit.arguments).error
    assert (error["code"], error["outcome"]) == (unfit.code, "not_sent")
    adapter.call("ping")
    assert functions(device, mark) == []


@pytest.mark.parametrize("tool", DNP3.writes)
def test_a_denied_write_puts_nothing_on_the_wire(rig: Any, device: Any, tool: str) -> None:
    mark, before = device.mark(), points(device)
    assert rig.guarded.call(tool, DNP3.writes[tool]).error["code"] == "writes_disabled"
    rig.ask(rig.guarded)
    assert functions(device, mark) == []
    assert points(device) == before


def test_the_indication_of_a_restart_is_cleared_once_and_only_where_writes_are_enabled(rig: Any, device: Any) -> None:
    device("poke", params={"restarted": True})
    mark = device.mark()
    assert "DEVICE_RESTART" in rig.guarded.call("read_analog_inputs", AT_ONCE).meta["trace"]["indications"]
    assert functions(device, mark) == [READ]
    subject = rig.start("clearing", writes="true")
    mark = device.mark()
    reply = subject.call("read_analog_inputs", AT_ONCE)
    assert (functions(device, mark), reply.meta["attempts"]) == ([READ, WRITE], 2)
    assert device("image")["restarted"] is False
    assert device.since(mark, state_changing=True) == []
    device("poke", params={"restarted": True})
    mark = device.mark()
    subject.call("read_analog_inputs", AT_ONCE)
    assert functions(device, mark) == [READ]
    subject.close()


# -- connections that fail ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("action", [{"close": True}, {"reset": True}])
def test_a_read_is_repeated_once_over_a_new_connection(adapter: Any, device: Any, action: Any) -> None:
    device.fault({"function": READ, "times": 1, "action": action})
    mark = device.mark()
    reply = adapter.call("read_analog_inputs", AT_ONCE)
    assert (functions(device, mark), reply.meta["attempts"]) == ([READ, READ], 2)
    assert reply.meta["connection"]["state"] == "reconnected"
    first, second = device.since(mark, kind="request")
    assert first["sequence"] != second["sequence"]


@pytest.mark.parametrize("function", [SELECT, OPERATE])
@pytest.mark.parametrize("action", [{"close": True}, {"reset": True}])
def test_a_command_over_a_connection_that_breaks_is_sent_once(
    adapter: Any, device: Any, function: int, action: Any
) -> None:
    device.fault({"function": function, "action": action})
    mark = device.mark()
    reply = adapter.call("write_binary_output", **PUMP, value=True)
    assert (reply.error["code"], reply.error["outcome"]) == ("connection_lost", "unknown")
    device.fault()
    adapter.call("ping")
    assert functions(device, mark).count(OPERATE) == (function == OPERATE)
    assert len(functions(device, mark)) == reply.meta["attempts"]


@pytest.mark.parametrize(
    "action",
    [{"drop": True}, {"garbage": True}, {"truncate": 12}, {"length": 3}, {"sequence": 1}, {"answer_source": 11}],
)
def test_what_is_no_answer_to_a_command_is_waited_for_in_vain(rig: Any, device: Any, action: Any) -> None:
    adapter = rig.adapter
    device.fault({"function": OPERATE, "action": action})
    mark = device.mark()
    identifier = adapter.start("write_binary_output", {**PUMP, "value": True})
    device.wait(mark, kind="request", function=OPERATE)
    adapter.pass_time()
    reply = adapter.reply("write_binary_output", identifier)
    assert (reply.error["code"], reply.error["outcome"], reply.meta["attempts"]) == ("timeout", "unknown", 2)
    assert reply.meta["connection"]["state"] == "disconnected"
    device.fault()
    assert rig.ask().meta["connection"]["state"] == "reconnected"
    assert functions(device, mark) == [SELECT, OPERATE]


def test_an_answer_that_arrives_in_pieces_is_read(adapter: Any, device: Any) -> None:
    device.fault({"function": READ, "action": {"drip_s": 0.001}})
    assert len(adapter.call("read_analog_inputs", AT_ONCE).data["points"]) == 4


def test_an_outage_is_told_and_survived(rig: Any, adapter: Any) -> None:
    with rig.device.outage():
        assert adapter.call("read_analog_inputs", AT_ONCE).error["code"] in ("connect_failed", "connection_lost")
        assert adapter.call("ping").error["code"] == "connect_failed"
        error = adapter.call("write_binary_output", **PUMP, value=True).error
        assert (error["code"], error["outcome"]) == ("connect_failed", "not_sent")
    assert adapter.call("read_analog_inputs", AT_ONCE).envelope["success"]


def test_an_outstation_that_is_not_there_is_not_answered_for_by_another(rig: Any, device: Any) -> None:
    adapter, mark = rig.adapter, device.mark()
    identifier = adapter.start("read_analog_inputs", {**AT_ONCE, "outstation_address": 11})
    device.wait(mark, kind="request", destination=11)
    adapter.pass_time()
    assert adapter.reply("read_analog_inputs", identifier).error["code"] == "timeout"


def test_calls_at_the_same_time_have_their_own_answers(adapter: Any, device: Any) -> None:
    calls = [("read_analog_inputs", {**AT_ONCE, "start_index": number % 6, "count": 1}) for number in range(32)]
    for number, identifier in enumerate(adapter.start_together(*calls)):
        (point,) = adapter.reply("read_analog_inputs", identifier).data["points"]
        assert point["value"] == points(device)[f"analog_input/{number % 6}"]


# -- settings ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "value"), DNP3.bad_settings)
def test_a_setting_that_cannot_be_used_is_named(name: str, value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(name, value)
    with pytest.raises(ConfigError, match=name):
        import_module("pytest_otmcp.reference_adapters.dnp3").build()


@pytest.mark.parametrize(
    "alias",
    [
        {"point_type": "binary_input", "writable": True},
        {"point_type": "analog_output", "writable": True},
        {"point_type": "counter", "data_type": "int32"},
        {"point_type": "valve"},
    ],
)
def test_an_alias_that_makes_no_sense_stops_the_start(
    tmp_path: Any, alias: Any, monkeypatch: pytest.MonkeyPatch
) -> None:

    file = tmp_path / "aliases.json"
    file.write_text(json.dumps({"a": {"outstation_address": 10, "index": 0, **alias}}))
    monkeypatch.setenv("DNP3_ALIAS_MAP", str(file))
    with pytest.raises(ConfigError, match=r"DNP3_ALIAS_MAP.*a"):
        import_module("pytest_otmcp.reference_adapters.dnp3").build()
