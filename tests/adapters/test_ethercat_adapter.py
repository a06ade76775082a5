"""The EtherCAT reference adapter: values, maps and files without a cable; its replies and the journal of the mock segment with one."""

# In the checkout mypy does not find the installed name of the adapters' folder.
# mypy: disable-error-code="import-not-found"

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from pytest_otmcp.reference_adapters.core import AdapterError, Call, ConfigError
from pytest_otmcp.reference_adapters.ethercat.codec import decode, encode
from pytest_otmcp.reference_adapters.ethercat.esi import BadEsi, parse
from pytest_otmcp.reference_adapters.ethercat.refusals import refusal, state_refused

from pytest_otmcp.protocols.ethercat.points import content_of
from pytest_otmcp.session.cable import cable_refused

TOOLS = (
    "ping scan_network get_slave_info list_slaves test_slave_communication load_esi_file read_pdo read_sdo read_slave_by_alias "
    "get_master_status write_sdo write_pdo write_slave_by_alias set_slave_state"
).split()
ALIASES = {
    "acceleration": {"slave_position": 1, "index": "0x2000", "subindex": 1, "data_type": "UINT16", "writable": True},
    "speed": {"slave_position": 1, "area": "outputs", "data_type": "INT16", "unit": "%", "writable": True},
    "limit": {"slave_position": 1, "area": "outputs", "offset": 4, "data_type": "FLOAT32", "writable": True},
    "pieces": {"slave_position": 1, "area": "inputs", "data_type": "UINT32"},
}
ESI = b"""<EtherCATInfo><Vendor><Id>#x0ABC</Id><Name>Kit</Name></Vendor><Descriptions><Devices><Device>
<Type ProductCode="#x00000012" RevisionNo="#x00000001">Drive</Type></Device></Devices></Descriptions></EtherCATInfo>"""


@dataclass(frozen=True, slots=True)
class Bench:
    """A segment and the only master of its line."""

    device: Any
    adapter: Any

    def held(self, slave: int) -> list[int]:
        points = self.device("image")["points"]
        return [value for name, value in points.items() if name.startswith(f"{slave}.output.")]

    def state(self, slave: int) -> str:
        found: str = self.device("image")["slaves"][slave]["state"]
        return found

    def error(self, tool: str, **arguments: Any) -> tuple[str, str]:
        error = self.adapter.call(tool, **arguments).error
        return error["code"], error["outcome"]


def files(folder: Path) -> dict[str, str]:
    (folder / "aliases.json").write_text(json.dumps(ALIASES))
    (folder / "drive.xml").write_bytes(ESI)
    return {"ETHERCAT_ALIAS_MAP": str(folder / "aliases.json"), "ETHERCAT_ESI_FOLDER": str(folder)}


@pytest.fixture(scope="module")
def bench(sessions: Any, mocks: Any, adapter_command: Any, tmp_path_factory: Any) -> Callable[..., Bench]:
    """Function that starts a segment, and an adapter on its cable."""
    pytest.importorskip("pysoem")
    if (refused := cable_refused()) is not None:
        pytest.skip(f"no cable here: {refused}")
    settings = files(tmp_path_factory.mktemp("ethercat"))

    def start(writes: str = "true", **more: str) -> Bench:
        device = mocks("ethercat")
        cable = device.endpoints["ethercat"]
        join = ["nsenter", "-t", str(cable["join"]), "-U", "-n", "--preserve-credentials"]
        line = {"ETHERCAT_INTERFACE": cable["path"], "ETHERCAT_WRITES_ENABLED": writes, "ETHERCAT_WATCHDOG_S": "1"}
        command = [*join, *adapter_command("ethercat")]
        return Bench(device, sessions(command, {**settings, **line, **more}, forked=False))

    return start


@pytest.fixture(scope="module")
def shared(bench: Any) -> Bench:
    found: Bench = bench(ETHERCAT_TIMEOUT_S="3")
    return found


@pytest.fixture
def main(shared: Bench) -> Bench:
    """The segment and the adapter of most tests, the segment as it is at its start."""
    shared.device("reset")
    return shared


# -- process data -----------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_outputs_are_kept_up_and_joined_to_those_that_are_there(main: Bench) -> None:
    assert sorted(main.adapter.tools) == sorted(TOOLS)
    reply = main.adapter.call("write_pdo", slave_position=1, data=[1, 2, 3, 4, 5, 6, 7, 8])
    assert (reply.data["bytes"], reply.data["watchdog_s"]) == ([1, 2, 3, 4, 5, 6, 7, 8], 1.0)
    main.adapter.call("write_slave_by_alias", alias="speed", value=-2)
    # The watchdog has no occasion to expire while the master cycles.
    assert main.device.within(1.5, 0, kind="watchdog") == []
    assert (main.held(1), main.state(1)) == ([0xFE, 0xFF, 3, 4, 5, 6, 7, 8], "OP")
    assert (main.held(0), main.state(0)) == ([0, 0], "SAFEOP")
    assert main.adapter.call("get_slave_info", slave_position=1).data["driven"] is True
    status = main.adapter.call("get_master_status").data["slaves"][1]
    assert (status["driven"], status["outputs"]) == (True, [0xFE, 0xFF, 3, 4, 5, 6, 7, 8])
    main.device("poke", params={"slave": 1, "inputs": "d20400000000f87f"})
    assert main.adapter.call("read_pdo", slave_position=1, offset=4).data["bytes"] == [0, 0, 0xF8, 0x7F]
    assert main.adapter.call("read_slave_by_alias", alias="pieces").data["value"] == 1234
    for arguments in ({"data": [1]}, {"data": [1, 2], "offset": 7}):
        assert main.error("write_pdo", slave_position=1, **arguments) == ("limit_exceeded", "not_sent")
    assert main.adapter.call("set_slave_state", slave_position=1, state="SAFEOP").data["state"] == "SAFEOP"
    assert (main.held(1), main.state(1)) == ([0] * 8, "SAFEOP")


@pytest.mark.long
def test_outputs_fall_at_the_watchdog_when_the_adapter_is_killed(bench: Any) -> None:
    own = bench()
    own.adapter.call("write_pdo", slave_position=0, data=[1, 2])
    assert own.held(0) == [1, 2]
    own.adapter.process.send_signal(signal.SIGKILL)
    (expired,) = own.device.wait(0, kind="watchdog")
    assert (expired["slave"], expired["outputs"]) == (0, "0102")
    assert (own.held(0), own.state(0)) == ([0, 0], "SAFEOP")


@pytest.mark.long
def test_a_slave_that_has_left_op_gets_no_outputs_unasked(main: Bench) -> None:
    main.adapter.call("write_pdo", slave_position=0, data=[1, 2])
    main.device("poke", params={"slave": 0, "falls": 0x1B})
    reply = main.adapter.call("get_slave_info", slave_position=0)
    assert (reply.data["state"], reply.data["al_status"]) == ("SAFEOP", 0x1B)
    mark = main.device.mark()
    assert main.device.within(0.3, mark, state_changing=True) == []
    main.device("poke", params={"slave": 0, "refuses": 0x1D})
    error = main.adapter.call("write_pdo", slave_position=0, data=[3, 4]).error
    assert (error["code"], error["outcome"], error["details"]["al_status"]) == ("config_error", "not_sent", "001D")
    assert error["message"].endswith("it is in SAFEOP")
    main.device("poke", params={"slave": 0, "refuses": None})
    assert main.adapter.call("write_pdo", slave_position=0, data=[3, 4]).data["bytes"] == [3, 4]
    assert main.held(0) == [3, 4]


@pytest.mark.long
def test_outputs_are_taken_although_another_slave_has_left_op(bench: Any) -> None:
    # A cycle so slow that the write is the first to notice.
    own = bench(ETHERCAT_CYCLE_S="0.5", ETHERCAT_WATCHDOG_S="5")
    for slave, data in ((0, [1, 2]), (1, [1] * 8)):
        own.adapter.call("write_pdo", slave_position=slave, data=data)
    own.device("poke", params={"slave": 1, "falls": 0x1B})
    assert own.adapter.call("write_pdo", slave_position=0, data=[3, 4]).data["bytes"] == [3, 4]
    assert (own.held(0), own.held(1)) == ([3, 4], [0] * 8)


# -- guards -----------------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_with_writes_disabled_everything_is_read_and_nothing_is_driven(bench: Any) -> None:
    own = bench(writes="false")
    for tool, arguments in (
        ("write_sdo", {"slave_position": 1, "index": "0x2000", "subindex": 1, "data_type": "UINT16", "value": 7}),
        ("write_pdo", {"slave_position": 0, "data": [1, 2]}),
        ("write_slave_by_alias", {"alias": "speed", "value": 1}),
        ("set_slave_state", {"slave_position": 0, "state": "OP"}),
    ):
        assert own.error(tool, **arguments) == ("writes_disabled", "not_sent"), tool
    assert [one["slave_position"] for one in own.adapter.call("scan_network").data["slaves"]] == [0, 1]
    assert own.adapter.call("test_slave_communication", slave_position=1).data["matches"] is True
    assert own.adapter.call("read_pdo", slave_position=0).data["bytes"] == [0xD5, 0x02]
    assert own.adapter.call("read_slave_by_alias", alias="acceleration").data["value"] == 100
    assert own.device.since(0, state_changing=True) == []
    assert own.device.since(0, service="state", state="OP") == []


# -- objects ----------------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_what_a_slave_refuses_is_said_with_its_abort_code(main: Bench) -> None:
    place = {"slave_position": 1, "subindex": 0, "data_type": "UINT16"}
    for index, expected in (("0x2222", "illegal_address"), ("0x2003", "not_readable")):
        assert main.error("read_sdo", **place, index=index) == (expected, "not_applicable")
    for index, subindex, value, expected, abort in (
        (0x2222, 0, 1, "illegal_address", "06020000"),
        (0x2000, 9, 1, "illegal_address", "06090011"),
        (0x1018, 1, 1, "not_writable", "06010002"),
        (0x2000, 1, 5000, "illegal_value", "06090031"),
        (0x2001, 6, 1, "type_mismatch", "06070013"),
    ):
        reply = main.adapter.call("write_sdo", place | {"index": index, "subindex": subindex, "value": value})
        assert (reply.error["code"], reply.error["outcome"]) == (expected, "rejected")
        assert reply.error["details"]["abort_code"] == abort
        assert abort in reply.error["message"]
    assert main.error("read_sdo", **{**place, "slave_position": 9}, index=0) == ("illegal_address", "not_applicable")


@pytest.mark.long
def test_a_download_whose_answer_is_lost_is_not_made_again(bench: Any) -> None:
    own = bench(ETHERCAT_TIMEOUT_S="0.2")
    own.adapter.call("ping")
    own.device.fault({"service": "sdo_download", "action": {"drop": True}})
    asked = {"slave_position": 1, "index": 0x2000, "subindex": 1, "data_type": "UINT16", "value": 7}
    assert own.error("write_sdo", **asked) == ("timeout", "unknown")
    assert len(own.device.since(0, service="sdo_download", kind="request")) == 1
    own.device.fault({"service": "sdo_download", "action": {"ack_only": True}})
    assert own.error("write_sdo", **{**asked, "value": 8}) == ("verify_failed", "applied")


@pytest.mark.long
def test_an_esi_file_is_read_from_its_folder_only(main: Bench) -> None:
    told = main.adapter.call("load_esi_file", filepath="drive.xml").data
    assert (told["vendor"], told["devices"][0]["product_code"]) == ("Kit", 0x12)
    for outside in ("../../../etc/passwd", "/etc/passwd", "nothing.xml", ".", "a\0b"):
        assert main.error("load_esi_file", filepath=outside)[0] == "illegal_address"
    assert main.error("load_esi_file", filepath="aliases.json")[0] == "invalid_input"


# -- without a cable --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "value"),
    [("BOOL", True), ("UINT8", 200), ("INT16", -2), ("UINT32", 2**32 - 1), ("INT64", -(2**40)), ("FLOAT32", 0.5)],
)
def test_values_are_what_the_kit_reads(kind: Any, value: Any) -> None:
    content = encode(value, kind)
    assert content == content_of(kind, value)
    assert decode(content, kind)["value"] == (str(value) if kind == "INT64" and abs(value) > 2**53 else value)
    with pytest.raises(AdapterError, match="bytes"):
        decode(content + b"\0", kind)


@pytest.mark.parametrize(
    ("kind", "value", "code"),
    [
        ("BOOL", 1, "type_mismatch"),
        ("STRING", 1, "type_mismatch"),
        ("STRING", "€", "type_mismatch"),
        ("INT16", "1", "type_mismatch"),
        ("INT16", 1.5, "type_mismatch"),
        ("INT16", 2**15, "range_overflow"),
        ("FLOAT32", 1e39, "range_overflow"),
    ],
)
def test_what_a_type_does_not_have_is_refused(kind: Any, value: Any, code: str) -> None:
    with pytest.raises(AdapterError) as caught:
        encode(value, kind)
    assert (caught.value.code, caught.value.outcome) == (code, "not_sent")


def test_codes_that_nobody_knows_are_failures_of_the_slave() -> None:
    call = Call(protocol="ethercat", operation="x", endpoint="ethercat:///x", writes=True)
    assert (refusal(call, 0x06040047).code, call.trace["abort_code"]) == ("device_failure", "06040047")
    assert (state_refused(call, 0x8001, "PREOP").code, call.trace["al_status"]) == ("device_failure", 0x8001)


@pytest.mark.parametrize(
    "content", [b"", b"<a>", b"<a/>", b'<!DOCTYPE a [<!ENTITY b "c">]><EtherCATInfo/>', b"<EtherCATInfo"]
)
def test_what_is_no_esi_file_is_refused(content: bytes) -> None:
    with pytest.raises(BadEsi):
        parse(content)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("ETHERCAT_INTERFACE", None),
        ("ETHERCAT_WATCHDOG_S", "0.015"),
        ("ETHERCAT_WATCHDOG_S", "7"),
        ("ETHERCAT_CYCLE_S", "nan"),
        ("ETHERCAT_ALIAS_MAP", {"a": {"slave_position": 0, "data_type": "INT16"}}),
        ("ETHERCAT_ALIAS_MAP", {"a": {"slave_position": 0, "data_type": "STRING", "area": "inputs"}}),
        (
            "ETHERCAT_ALIAS_MAP",
            {"a": {"slave_position": 0, "data_type": "INT16", "area": "inputs", "writable": True}},
        ),
        ("ETHERCAT_ALIAS_MAP", "/does/not/exist.json"),
    ],
)
def test_a_bad_setting_stops_the_start(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str, content: Any
) -> None:
    monkeypatch.setenv("ETHERCAT_INTERFACE", "kit0")
    if content is None:
        monkeypatch.delenv(name)
    elif isinstance(content, str):
        monkeypatch.setenv(name, content)
    else:
        (tmp_path / "bad.json").write_text(json.dumps(content))
        monkeypatch.setenv(name, str(tmp_path / "bad.json"))
    with pytest.raises(ConfigError, match=name):
        import_module("pytest_otmcp.reference_adapters.ethercat").build()
