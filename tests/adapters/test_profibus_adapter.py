"""The PROFIBUS DP reference adapter against the mock segment: its replies and the segment's journal."""

# In the checkout mypy does not find the installed name of the adapters' folder.
# mypy: disable-error-code="import-not-found"

from __future__ import annotations

import json
import os
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from pytest_otmcp.reference_adapters.core import ConfigError
from pytest_otmcp.reference_adapters.profibus.gsd import BadGsd, parse
from pytest_otmcp.reference_adapters.profibus.master import _watchdog_factors
from pytest_otmcp.reference_adapters.profibus.telegram import BadTelegram, Telegram, take

TOOLS = (
    "scan_bus read_inputs write_outputs read_diagnosis load_gsd_file list_slaves read_slave_by_alias write_slave_by_alias ping "
    "get_master_status test_slave_communication"
).split()
SLAVES = {
    "5": {"ident": "809C", "cfg": "11 21", "name": "valve terminal"},
    "8": {"ident": "80A5", "cfg": "17 27"},
    "9": {"ident": "80B1", "cfg": "10 20"},
}
ALIASES = {
    "level": {"slave_address": 8, "area": "inputs", "offset": 4, "data_type": "FLOAT32", "unit": "m"},
    "count": {"slave_address": 8, "area": "inputs", "data_type": "UINT64"},
    "valve": {"slave_address": 8, "area": "outputs", "offset": 2, "data_type": "INT16", "writable": True},
    "fan": {"slave_address": 8, "area": "outputs", "offset": 4, "data_type": "UINT8", "writable": True},
    "told": {"slave_address": 8, "area": "outputs", "data_type": "UINT16"},
}
GSD = """#Profibus_DP
; a comment
Vendor_Name = "Kit; works"
Model_Name = "Valve"   ; another
Revision = "V1.0"
Ident_Number = 0x809C
19.2_supp = 1
1.5M_supp = 1
12M_supp = 0
Max_Input_Len = 2
Max_Output_Len = 2
User_Prm_Data = 0x00,0x01, \\
  0x02
PrmText = 1
Text(0) = "off"
EndPrmText
Module = "2 bytes in" 0x11
1
EndModule
Module = "2 bytes out" 0x21, \\
   0x00
EndModule
"""


@dataclass(frozen=True, slots=True)
class Bench:
    """A segment and the only adapter on its line."""

    device: Any
    adapter: Any

    def requests(self, mark: int, **fields: Any) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = self.device.since(mark, kind="request", **fields)
        return found

    def services(self, mark: int) -> list[str]:
        return [request["service"] for request in self.requests(mark)]

    def held(self, station: int) -> list[int]:
        points = self.device("image")["points"]
        prefix = f"{station}.output."
        names = sorted((name for name in points if name.startswith(prefix)), key=lambda name: int(name[len(prefix) :]))
        return [points[name] for name in names]

    def drive(self, *data: int) -> Any:
        return self.adapter.call("write_outputs", slave_address=5, data=list(data))


@pytest.fixture(scope="module")
def bench(sessions: Any, mocks: Any, adapter_command: Any, tmp_path_factory: Any) -> Callable[..., Bench]:
    """Function that starts a segment and an adapter."""
    folder = tmp_path_factory.mktemp("profibus")
    settings = files(folder)

    def start(writes: str = "true", **more: str) -> Bench:
        device = mocks("profibus")
        line = {"PROFIBUS_SERIAL": device.endpoints["profibus"]["path"], "PROFIBUS_WRITES_ENABLED": writes}
        return Bench(device, sessions(adapter_command("profibus"), {**settings, **line, **more}))

    return start


def files(folder: Path, slaves: Mapping[str, Any] = SLAVES, aliases: Mapping[str, Any] = ALIASES) -> dict[str, str]:
    (folder / "slaves.json").write_text(json.dumps(slaves))
    (folder / "aliases.json").write_text(json.dumps(aliases))
    (folder / "valve.gsd").write_text(GSD, encoding="latin-1")
    return {
        "PROFIBUS_SLAVE_MAP": str(folder / "slaves.json"),
        "PROFIBUS_ALIAS_MAP": str(folder / "aliases.json"),
        "PROFIBUS_GSD_FOLDER": str(folder),
        "PROFIBUS_TIMEOUT_S": "20",
        "PROFIBUS_DEADLINE_S": "30",
        "PROFIBUS_SLOT_S": "0.003",
        # Longer than any test: a machine that stands still must not let outputs fall.
        "PROFIBUS_WATCHDOG_S": "60",
    }


@pytest.fixture(scope="module")
def main(bench: Any) -> Bench:
    started: Bench = bench()
    return started


@pytest.fixture(autouse=True)
def clean(main: Bench) -> None:
    main.device("reset")


# -- what is read --------------------------------------------------------------------------------------------


def test_there_are_the_eleven_tools_of_the_paper(main: Bench) -> None:
    assert sorted(main.adapter.tools) == sorted(TOOLS)


def test_a_scan_finds_the_stations_that_answer_and_invents_none(main: Bench) -> None:
    mark = main.device.mark()
    found = main.adapter.call("scan_bus").data["stations"]
    assert found == [{"address": address, "type": "slave"} for address in (5, 8, 9)]
    asked = main.requests(mark)
    assert {request["service"] for request in asked} == {"fdl_status"}
    # Its own address is not asked.
    assert [request["station"] for request in asked] == [*range(2), *range(3, 126)]
    assert main.adapter.call("scan_bus", first_address=6, last_address=60).data["stations"] == found[1:]


def test_reading_drives_nothing(main: Bench) -> None:
    main.device("poke", params={"station": 5, "inputs": "02d5"})
    main.device("poke", params={"station": 9, "inputs": "07"})
    mark = main.device.mark()
    assert main.adapter.call("read_inputs", slave_address=5).data["bytes"] == [0x02, 0xD5]
    assert main.adapter.call("read_inputs", slave_address=5, length=1).data["bytes"] == [0x02]
    # Of a slave that another master has, too.
    assert main.adapter.call("read_inputs", slave_address=9).data["bytes"] == [7]
    assert main.adapter.call("read_inputs", slave_address=5, length=3).error["code"] == "limit_exceeded"
    assert main.services(mark) == ["rd_inp"] * 4


def test_numbers_are_read_exactly(main: Bench) -> None:
    for content, name, value, special in (
        (bytes(4) + struct.pack(">f", -0.5), "level", -0.5, None),
        (bytes(4) + bytes.fromhex("7fc00000"), "level", None, "NaN"),
        ((2**53 + 1).to_bytes(8, "big"), "count", str(2**53 + 1), None),
        ((7).to_bytes(8, "big"), "count", 7, None),
    ):
        main.device("poke", params={"station": 8, "inputs": content.hex()})
        told = main.adapter.call("read_slave_by_alias", alias=name).data
        assert (told["value"], told["special"]) == (value, special)
    assert main.adapter.call("read_slave_by_alias", alias="nobody").error["code"] == "illegal_address"


def test_the_diagnosis_has_the_standards_names(main: Bench) -> None:
    told = main.adapter.call("read_diagnosis", slave_address=5).data
    assert (told["ident"], told["master"], told["extended"]) == ("809C", None, "")
    assert {"station_not_ready", "prm_req"} <= set(told["status"])
    main.device("poke", params={"station": 5, "diagnosis": "030102"})
    told = main.adapter.call("read_diagnosis", slave_address=5).data
    assert "ext_diag" in told["status"]
    assert told["extended"].endswith("030102")
    assert main.adapter.call("read_diagnosis", slave_address=9).data["master"] == 3
    tested = main.adapter.call("test_slave_communication", slave_address=8).data
    assert (tested["cfg"], tested["matches"]) == ("17 27", True)


def test_a_station_that_is_silent_is_a_time_out(main: Bench) -> None:
    identifier = main.adapter.start("read_inputs", {"slave_address": 77})
    main.adapter.pass_time()
    reply = main.adapter.reply("read_inputs", identifier)
    assert (reply.error["code"], reply.meta["attempts"]) == ("timeout", 1)


# -- what is written -------------------------------------------------------------------------------------------


def test_a_write_takes_the_slave_and_the_outputs_stay(main: Bench) -> None:
    # The cycle has what an earlier test wrote: it is another value.
    mark = main.device.mark()
    reply = main.drive(0x12, 0x34)
    assert reply.data == {"slave_address": 5, "bytes": [0x12, 0x34], "watchdog_s": 60}
    assert main.held(5) == [0x12, 0x34]
    assert reply.meta["attempts"] == len(main.requests(mark, station=5))
    # Inputs that change make the slave answer something new, which the journal has: the cycle goes on.
    main.device("poke", params={"station": 5, "inputs": "0102"})
    main.device.wait(mark, kind="cycle", station=5)
    assert main.held(5) == [0x12, 0x34]
    states = {one["slave_address"]: one for one in main.adapter.call("get_master_status").data["slaves"]}
    assert (states[5]["state"], states[5]["outputs"], states[9]["state"]) == ("data_exchange", [0x12, 0x34], "passive")
    # It is parameterised once.
    mark = main.device.mark()
    main.drive(0x56, 0x78)
    assert main.services(mark) == ["slave_diag", "data_exchange", "rd_outp"]


def test_the_first_write_parameterises_and_configures(bench: Any) -> None:
    own = bench()
    mark = own.device.mark()
    reply = own.drive(1, 2)
    assert reply.data["bytes"] == [1, 2]
    *head, diagnosis, exchange, check = own.services(mark)
    assert head[:3] == ["slave_diag", "set_prm", "chk_cfg"]
    assert (diagnosis, exchange, check) == ("slave_diag", "data_exchange", "rd_outp")
    (parameters,) = own.requests(mark, service="set_prm")
    # Lock and watchdog; 60 s are 6000 steps of 10 ms; ident number; group 0.
    first, second = _watchdog_factors(60)
    assert first * second >= 6000
    assert bytes([0x88, first, second, 11, 0x80, 0x9C, 0]).hex() in parameters["telegram"]
    assert reply.meta["attempts"] == len(own.requests(mark))
    assert (reply.meta["trace"]["service"], reply.meta["trace"]["station"]) == ("Data_Exchange", 5)
    # When the adapter ends, its outputs are cleared.
    own.adapter.close()
    own.device.wait(mark, service="global_control", station=5)
    assert own.held(5) == [0, 0]


def test_outputs_fall_when_the_adapter_is_killed(bench: Any) -> None:
    own = bench(PROFIBUS_WATCHDOG_S="0.2", PROFIBUS_CYCLE_S="0.02")
    mark = own.device.mark()
    own.drive(1, 2)
    own.adapter.abandon()
    own.device.wait(mark, kind="watchdog", station=5)
    assert own.held(5) == [0, 0]


def test_an_alias_leaves_the_other_outputs_alone(main: Bench) -> None:
    assert main.adapter.call("write_slave_by_alias", alias="fan", value=9).data["value"] == 9
    assert main.adapter.call("write_slave_by_alias", alias="valve", value=-2).data["value"] == -2
    assert main.held(8) == [0, 0, 0xFF, 0xFE, 9, 0, 0, 0]
    assert main.adapter.call("read_slave_by_alias", alias="valve").data["value"] == -2


@pytest.mark.parametrize(
    ("tool", "arguments", "code"),
    [
        ("write_outputs", {"slave_address": 5, "data": [1]}, "limit_exceeded"),
        ("write_outputs", {"slave_address": 5, "data": [1, 2, 3]}, "limit_exceeded"),
        ("write_outputs", {"slave_address": 5, "data": [300, 0]}, "range_overflow"),
        ("write_outputs", {"slave_address": 5, "data": [0, -1]}, "range_overflow"),
        ("write_outputs", {"slave_address": 5, "data": [1.5, 0]}, "invalid_input"),
        ("write_outputs", {"slave_address": 5, "data": [True, 0]}, "invalid_input"),
        ("write_outputs", {"slave_address": 5, "data": []}, "invalid_input"),
        ("write_outputs", {"slave_address": 5, "data": [0] * 245}, "limit_exceeded"),
        ("write_outputs", {"slave_address": 77, "data": [1, 2]}, "illegal_address"),
        ("write_outputs", {"slave_address": 126, "data": [1, 2]}, "invalid_input"),
        ("write_outputs", {"slave_address": "5", "data": [1, 2]}, "invalid_input"),
        ("write_slave_by_alias", {"alias": "told", "value": 1}, "not_writable"),
        ("write_slave_by_alias", {"alias": "valve", "value": 32768}, "range_overflow"),
        ("write_slave_by_alias", {"alias": "valve", "value": 1.5}, "type_mismatch"),
        ("write_slave_by_alias", {"alias": "valve", "value": "7"}, "type_mismatch"),
        ("write_slave_by_alias", {"alias": "valve", "value": True}, "type_mismatch"),
        ("write_slave_by_alias", {"alias": "nobody", "value": 1}, "illegal_address"),
    ],
)
def test_unfit_arguments_are_refused_before_anything_is_sent(main: Bench, tool: str, arguments: Any, code: str) -> None:
    mark = main.device.mark()
    reply = main.adapter.call(tool, arguments)
    assert (reply.error["code"], reply.error["outcome"], reply.meta["attempts"]) == (code, "not_sent", 0)
    # The cycle of an earlier write may go on.
    assert main.requests(mark, state_changing=True) == []


def test_with_writes_disabled_nothing_is_driven(bench: Any) -> None:
    guarded = bench(writes="")
    mark = guarded.device.mark()
    for tool, arguments in (
        ("write_outputs", {"slave_address": 5, "data": [1, 2]}),
        ("write_slave_by_alias", {"alias": "valve", "value": 1}),
    ):
        assert guarded.adapter.call(tool, arguments).error["code"] == "writes_disabled"
    for tool, arguments in (
        ("ping", {}),
        ("read_inputs", {"slave_address": 5}),
        ("read_slave_by_alias", {"alias": "valve"}),
        ("read_diagnosis", {"slave_address": 5}),
        ("test_slave_communication", {"slave_address": 5}),
        ("get_master_status", {}),
        ("list_slaves", {}),
    ):
        assert guarded.adapter.call(tool, arguments).envelope["success"]
    guarded.adapter.close()
    assert set(guarded.services(mark)) == {"fdl_status", "rd_inp", "rd_outp", "slave_diag", "get_cfg"}


# -- slaves that are not ours ------------------------------------------------------------------------------------


def test_a_slave_of_another_master_is_left_to_it(main: Bench) -> None:
    mark = main.device.mark()
    error = main.adapter.call("write_outputs", slave_address=9, data=[1]).error
    assert (error["code"], error["outcome"], error["details"]) == ("access_denied", "not_sent", {"master": 3})
    assert main.services(mark) == ["slave_diag"]


def test_another_slave_than_the_map_says_is_not_driven(bench: Any, tmp_path: Path) -> None:
    own = bench(**files(tmp_path, {"5": {"ident": "1234", "cfg": "11 21"}}, {}))
    mark = own.device.mark()
    error = own.drive(1, 2).error
    assert (error["code"], error["outcome"]) == ("config_error", "not_sent")
    assert "1234" in error["message"]
    assert own.services(mark) == ["slave_diag"]


def test_a_configuration_that_the_slave_does_not_accept_ends_before_data_exchange(bench: Any, tmp_path: Path) -> None:
    own = bench(**files(tmp_path, {"5": {"ident": "809C", "cfg": "10 21"}}, {}))
    mark = own.device.mark()
    error = own.drive(1, 2).error
    assert (error["code"], error["outcome"]) == ("config_error", "not_sent")
    assert "cfg_fault" in error["message"]
    assert "data_exchange" not in own.services(mark)
    assert own.adapter.call("test_slave_communication", slave_address=5).data["matches"] is False


def test_a_slave_that_another_master_takes_is_given_up(bench: Any) -> None:
    own = bench()
    own.drive(1, 2)
    mark = own.device.mark()
    own.device("poke", params={"station": 5, "master": 3})
    assert own.drive(3, 4).error["code"] == "access_denied"
    lost = own.adapter.call("get_master_status").data["slaves"][0]
    assert (lost["state"], lost["outputs"]) == ("lost", None)
    # What the cycle may have sent before it knew.
    assert len(own.requests(mark, service="data_exchange")) <= 1


# -- answers that are none -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("number", "code", "outcome"),
    [
        (1, "device_failure", "unknown"),
        (2, "device_busy", "rejected"),
        (3, "session_error", "rejected"),
        (9, "device_busy", "rejected"),
        (5, "protocol_error", "unknown"),
    ],
)
def test_refusals_have_their_codes(main: Bench, number: int, code: str, outcome: str) -> None:
    main.device.fault({"service": "rd_inp", "action": {"error": number}})
    read = main.adapter.call("read_inputs", slave_address=5)
    assert (read.error["code"], read.error["outcome"]) == (code, "not_applicable")
    assert (read.meta["trace"]["fdl_status"], read.meta["attempts"]) == (number, 1)
    main.device.fault({"service": "data_exchange", "changes": True, "action": {"error": number}})
    written = main.drive(number, 99)
    assert (written.error["code"], written.error["outcome"]) == (code, outcome)


@pytest.mark.parametrize(
    "action",
    [{"garbage": True}, {"answer_station": 8}, {"answer_master": 4}, {"truncate": 5}, {"mangle": {"flip": [[4, 1]]}}],
    ids=lambda action: next(iter(action)),
)
def test_what_is_no_answer_to_the_request_is_never_data(main: Bench, action: dict[str, Any]) -> None:
    main.device("poke", params={"station": 5, "inputs": "0b0c"})
    main.device.fault({"service": "rd_inp", "times": 1, "action": action})
    mark = main.device.mark()
    identifier = main.adapter.start("read_inputs", {"slave_address": 5})
    main.device.wait(mark, service="rd_inp")
    main.adapter.pass_time()
    assert main.adapter.reply("read_inputs", identifier).error["code"] in ("protocol_error", "timeout")
    assert main.adapter.call("read_inputs", slave_address=5).data["bytes"] == [0x0B, 0x0C]


def test_inputs_of_another_length_are_no_inputs(main: Bench) -> None:
    main.device.fault({"service": "rd_inp", "action": {"answer_data": "010203"}})
    assert main.adapter.call("read_inputs", slave_address=5).error["code"] == "protocol_error"


def test_a_late_answer_is_not_the_answer_to_the_next_request(main: Bench) -> None:
    main.device("poke", params={"station": 5, "inputs": "0101"})
    main.device.fault({"service": "rd_inp", "times": 1, "action": {"drop": True}})
    mark = main.device.mark()
    identifier = main.adapter.start("read_inputs", {"slave_address": 5})
    main.device.wait(mark, service="rd_inp")
    main.adapter.pass_time()
    assert main.adapter.reply("read_inputs", identifier).error["code"] == "timeout"
    # The answer that was late and the one to the question after it come together.
    main.device("poke", params={"station": 5, "inputs": "0202"})
    mark = main.device.mark()
    reply = main.adapter.call("read_inputs", slave_address=5)
    assert reply.data["bytes"] == [2, 2]
    # The station is asked something first whose answer cannot be mistaken, and starts to count anew.
    assert main.services(mark) == ["fdl_status", "rd_inp"]
    assert reply.meta["attempts"] == 2
    assert not any("repeated" in request for request in main.requests(mark))


def test_an_answer_that_comes_twice_is_not_the_next_one(main: Bench) -> None:
    main.device("poke", params={"station": 5, "inputs": "0101"})
    main.device.fault({"service": "rd_inp", "times": 1, "action": {"duplicate": True}})
    assert main.adapter.call("read_inputs", slave_address=5).data["bytes"] == [1, 1]
    main.device("poke", params={"station": 5, "inputs": "0202"})
    assert main.adapter.call("read_inputs", slave_address=5).data["bytes"] == [2, 2]


def test_a_write_whose_answer_does_not_come_is_neither_repeated_nor_taken_back(bench: Any) -> None:
    own = bench()
    own.drive(1, 2)
    own.device.fault({"service": "data_exchange", "changes": True, "action": {"drop": True}})
    mark = own.device.mark()
    identifier = own.adapter.start("write_outputs", {"slave_address": 5, "data": [3, 4]})
    own.device.wait(mark, service="data_exchange")
    own.adapter.pass_time()
    error = own.adapter.reply("write_outputs", identifier).error
    assert (error["code"], error["outcome"]) == ("timeout", "unknown")
    assert own.adapter.call("get_master_status").data["slaves"][0]["state"] == "lost"
    assert own.device.within(0.3, mark, service="data_exchange")[1:] == []
    assert own.held(5) == [3, 4]


def test_outputs_that_the_slave_does_not_take_over_are_found_out(main: Bench) -> None:
    main.drive(5, 6)
    main.device.fault({"service": "data_exchange", "changes": True, "action": {"ack_only": True}})
    error = main.drive(7, 8).error
    assert (error["code"], error["outcome"]) == ("verify_failed", "applied")


def test_a_slave_that_was_restarted_gets_no_outputs_unasked(bench: Any) -> None:
    own = bench(PROFIBUS_WATCHDOG_S="1.0", PROFIBUS_CYCLE_S="0.02")
    own.drive(1, 2)
    with own.device.outage():
        identifier = own.adapter.start("read_inputs", {"slave_address": 5})
        own.adapter.pass_time()
        assert own.adapter.reply("read_inputs", identifier).error["code"] == "timeout"
    assert own.adapter.call("read_inputs", slave_address=5).envelope["success"]
    assert own.device.within(0.3, 0, service="data_exchange") == []
    assert own.drive(3, 4).data["bytes"] == [3, 4]


def test_parallel_calls_get_their_own_answers(main: Bench) -> None:
    for station, content in ((5, "0102"), (8, "0304050607080910"), (9, "11")):
        main.device("poke", params={"station": station, "inputs": content})
    stations = [5, 8, 9] * 20
    ids = [main.adapter.start("read_inputs", {"slave_address": station}) for station in stations]
    for station, identifier in zip(stations, ids, strict=True):
        assert main.adapter.reply("read_inputs", identifier).data["bytes"][0] == {5: 1, 8: 3, 9: 0x11}[station]


# -- the line, files and settings ------------------------------------------------------------------------------------


def test_a_line_has_one_program(main: Bench, sessions: Any, adapter_command: Any) -> None:
    path = main.device.endpoints["profibus"]["path"]
    main.adapter.call("ping")
    second = sessions(adapter_command("profibus"), {"PROFIBUS_SERIAL": path})
    error = second.call("ping").error
    assert (error["code"], "another program" in error["message"]) == ("connect_failed", True)
    missing = sessions(adapter_command("profibus"), {"PROFIBUS_SERIAL": "/dev/no-such-line"})
    assert missing.call("ping").error["code"] == "connect_failed"


def test_a_line_can_be_opened_again() -> None:
    line = import_module("pytest_otmcp.reference_adapters.profibus.line")
    master, slave = os.openpty()
    try:
        for _ in range(3):
            os.close(line._opened(os.ttyname(slave), 19200))
        held = line._opened(os.ttyname(slave), 19200)
        with pytest.raises(BlockingIOError):
            line._opened(os.ttyname(slave), 19200)
        os.close(held)
    finally:
        os.close(slave)
        os.close(master)


def test_a_gsd_file_is_read_from_its_folder_only(main: Bench) -> None:
    reply = main.adapter.call("load_gsd_file", filepath="valve.gsd")
    told = reply.data
    assert (told["vendor"], told["model"], told["ident"]) == ("Kit; works", "Valve", "809C")
    assert (told["max_input_length"], told["baud_rates"]) == (2, ["19.2", "1.5M"])
    assert told["modules"] == [{"name": "2 bytes in", "cfg": "11"}, {"name": "2 bytes out", "cfg": "21 00"}]
    assert "/data/vendor" in reply.meta["untrusted"]
    for outside in ("../../../etc/passwd", "/etc/passwd", "nothing.gsd", ".", "a\0b"):
        assert main.adapter.call("load_gsd_file", filepath=outside).error["code"] == "illegal_address"
    assert main.adapter.call("load_gsd_file", filepath="slaves.json").error["code"] == "invalid_input"


@pytest.mark.parametrize(
    "text",
    [
        "",
        "Vendor_Name = 1",
        "#Profibus_DP\nnonsense",
        '#Profibus_DP\nModule = "x" 0x1FF\nEndModule',
        "#Profibus_DP\nEndModule",
        '#Profibus_DP\nModule = "x" 1',
        "#Profibus_DP\nPrmText = 1",
        "#Profibus_DP\nA =",
    ],
)
def test_what_is_no_gsd_file_is_refused(text: str) -> None:
    with pytest.raises(BadGsd):
        parse(text)


@pytest.mark.parametrize(
    ("cfg", "inputs", "outputs"),
    [("11 21", 2, 2), ("57 67", 16, 16), ("33", 4, 4), ("C1 01 02 00", 3, 2), ("40 41", 4, 0), ("00 10", 1, 0)],
)
def test_lengths_follow_from_the_configuration(cfg: str, inputs: int, outputs: int) -> None:
    maps = import_module("pytest_otmcp.reference_adapters.profibus.maps")
    slave = maps.Slave(ident=1, cfg=cfg)
    assert (slave.input_length, slave.output_length) == (inputs, outputs)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("PROFIBUS_SLAVE_MAP", {"126": {"ident": "1", "cfg": "11"}}),
        ("PROFIBUS_SLAVE_MAP", {"05": {"ident": "1", "cfg": "11"}}),
        ("PROFIBUS_SLAVE_MAP", {"5": {"ident": "1", "cfg": "c0"}}),
        ("PROFIBUS_SLAVE_MAP", {"5": {"ident": "10000", "cfg": "11"}}),
        ("PROFIBUS_SLAVE_MAP", {"5": {"ident": "1", "cfg": "xx"}}),
        ("PROFIBUS_SLAVE_MAP", {"2": {"ident": "1", "cfg": "11"}}),
        ("PROFIBUS_ALIAS_MAP", {"a": {"slave_address": 77, "area": "inputs", "data_type": "INT8"}}),
        ("PROFIBUS_ALIAS_MAP", {"a": {"slave_address": 5, "area": "inputs", "data_type": "INT32"}}),
        ("PROFIBUS_ALIAS_MAP", {"a": {"slave_address": 5, "area": "inputs", "data_type": "INT8", "writable": True}}),
        ("PROFIBUS_SERIAL", None),
        ("PROFIBUS_BAUD", "19201"),
        ("PROFIBUS_MASTER_ADDRESS", "126"),
        ("PROFIBUS_WATCHDOG_S", "0.1"),
        ("PROFIBUS_TIMEOUT_S", "nan"),
        ("PROFIBUS_SLAVE_MAP", "/does/not/exist.json"),
    ],
)
def test_a_bad_setting_stops_the_start(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str, content: Any
) -> None:
    for setting, value in {**files(tmp_path), "PROFIBUS_SERIAL": "/dev/ttyUSB0"}.items():
        monkeypatch.setenv(setting, value)
    if content is None:
        monkeypatch.delenv(name)
    elif isinstance(content, str):
        monkeypatch.setenv(name, content)
    else:
        (tmp_path / "bad.json").write_text(json.dumps(content))
        monkeypatch.setenv(name, str(tmp_path / "bad.json"))
        if name == "PROFIBUS_SLAVE_MAP":
            monkeypatch.delenv("PROFIBUS_ALIAS_MAP")
    with pytest.raises(ConfigError, match=name if "2" not in str(content)[:4] else "PROFIBUS"):
        import_module("pytest_otmcp.reference_adapters.profibus.adapter").build()


# -- telegrams -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("telegram", "raw"),
    [
        (Telegram(destination=5, source=2, control=0x49), "10 05 02 49 50 16"),
        (
            Telegram(destination=5, source=2, control=0x7D, data=b"\x12\x34"),
            "68 05 05 68 05 02 7d 12 34 ca 16",
        ),
        (
            Telegram(destination=5, source=2, control=0x5D, dsap=61, ssap=62, data=bytes.fromhex("881e0100809c01")),
            "68 0c 0c 68 85 82 5d 3d 3e 88 1e 01 00 80 9c 01 a3 16",
        ),
    ],
)
def test_telegrams_are_those_of_the_manuals(telegram: Telegram, raw: str) -> None:
    assert telegram.encoded() == bytes.fromhex(raw)
    buffer = bytearray(b"\xdc\x02\x02" + telegram.encoded() + b"\xe5")
    assert take(buffer) == telegram
    assert take(buffer) == Telegram(destination=None, source=None, control=0)
    assert take(buffer) is None


def test_every_damaged_telegram_is_refused() -> None:
    whole = Telegram(destination=5, source=2, control=0x5D, dsap=61, ssap=62, data=b"\x01\x02").encoded()
    for position in range(len(whole)):
        for bit in range(8):
            damaged = bytearray(whole)
            damaged[position] ^= 1 << bit
            try:
                found = take(damaged)
            except BadTelegram:
                continue
            # Another start byte may begin a telegram that is not complete yet, or a shorter one.
            assert found is None or position == 0
    for length in range(len(whole)):
        assert take(bytearray(whole[:length])) is None
