"""The parts of the PROFINET adapter that need no cable: what it sends is read by the kit's codec, which is another one; GSDML; names and maps."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from pytest_otmcp.reference_adapters.core import AdapterError, BadReply, Call, ConfigError, Environment
from pytest_otmcp.reference_adapters.profinet import wire
from pytest_otmcp.reference_adapters.profinet.controller import _expected, _process_data
from pytest_otmcp.reference_adapters.profinet.gsdml import BadGsdml, parse
from pytest_otmcp.reference_adapters.profinet.maps import load_aliases, load_devices
from pytest_otmcp.reference_adapters.profinet.refusals import dcp_refusal, refusal
from pytest_otmcp.reference_adapters.profinet.tools import _NAME, _NO_NAME

from pytest_otmcp.wire.profinet import blocks
from pytest_otmcp.wire.profinet.dcp import Dcp, is_station_name
from pytest_otmcp.wire.profinet.rpc import DEVICE_INTERFACE, Rpc
from pytest_otmcp.wire.profinet.rt import RtFrame
from pytest_otmcp.wire.profinet.services import subslots_of

DEVICES = {
    "press-4": {
        "vendor_id": "0ABC",
        "device_id": "0001",
        "modules": [
            {"slot": 0, "module": "00000001", "submodule": "00000001"},
            {"slot": 1, "module": "00000010", "submodule": "00000001", "inputs": 8},
            {"slot": 2, "module": "00000020", "submodule": "00000001", "outputs": 2},
        ],
    }
}
GSDML = b"""<?xml version="1.0"?><ISO15745Profile xmlns="http://www.profibus.com/GSDML/2003/11/DeviceProfile"><ProfileBody>
<DeviceIdentity VendorID="0x0ABC" DeviceID="0x0001"><VendorName Value="Kit"/></DeviceIdentity>
<ModuleItem ID="M1" ModuleIdentNumber="0x00000010"><ModuleInfo><Name TextId="T1"/></ModuleInfo><VirtualSubmoduleList>
<VirtualSubmoduleItem SubmoduleIdentNumber="0x01"><IOData><Input><DataItem DataType="Unsigned32"/><DataItem DataType="OctetString" Length="4"/></Input>
</IOData></VirtualSubmoduleItem></VirtualSubmoduleList></ModuleItem>
<Text TextId="T1" Value="8 bytes in"/></ProfileBody></ISO15745Profile>"""


def environment(folder: Path, **files: object) -> Environment:
    for name, content in files.items():
        (folder / name).write_text(json.dumps(content), encoding="utf-8")
    return Environment({name: str(folder / name) for name in files})


def test_what_the_adapter_sends_is_what_the_kit_reads(tmp_path: Path) -> None:
    device = load_devices(environment(tmp_path, PROFINET_DEVICE_MAP=DEVICES))["press-4"]
    lengths = {place: (one.inputs, one.outputs) for place, one in device.subslots.items()}
    inputs, outputs = wire.layout(1, lengths), wire.layout(2, lengths)
    asked = wire.relation(1, bytes(16), bytes(6)) + inputs.block(0xC001, 32, 60) + outputs.block(0xFFFF, 32, 60)
    call = Rpc.parse(wire.Request(0, asked + b"".join(map(_expected, device.modules)), 0xABC, 1).encoded())
    assert (call.called, call.object[-6:]) == (DEVICE_INTERFACE, bytes.fromhex("000100010abc"))
    relation, *cyclic, first, second, third = blocks.blocks_of(call.blocks)[0]
    assert blocks.Relation.parse(relation.body).type == blocks.CONTROLLER
    agreed = {one.type: one for one in map(blocks.CyclicData.parse, (one.body for one in cyclic))}
    assert [agreed[kind].data for kind in (1, 2)] == [{(0, 1): 0, (1, 1): 1}, {(2, 1): 0}]
    assert agreed[1].cycle_s == 0.032
    expected = {
        (module.slot, 1): module.submodules[1]
        for one in (first, second, third)
        for module in blocks.Module.parse_all(one.body)
    }
    frame = RtFrame.parse(wire.cyclic_frame(0xC101, outputs, {(2, 1): b"\x12\x34"}, 7))
    assert subslots_of(frame, agreed[2], expected) == {(2, 1): b"\x12\x34"}


def test_a_question_of_dcp_and_a_header_of_a_record_are_what_the_kit_reads() -> None:
    told = Dcp.parse(wire.dcp(wire.IDENTIFY, 9, (wire.NAME, b"press-4")))
    assert (told.frame_id, told.xid, told.content((2, 2))) == (0xFEFE, 9, b"press-4")
    header = wire.record_header(0x0008, bytes(16), 1, 2, 3, 4)
    ((block, *_), _) = blocks.blocks_of(header)
    found = blocks.Record.parse(block)
    assert (found.writes, found.slot, found.subslot, found.index, found.length) == (True, 1, 2, 3, 4)
    assert _process_data(blocks.input_data(b"\1\2"), 0x0015, 6) == b"\1\2"
    assert _process_data(blocks.output_data(b"\1\2", active=True), 0x0016, 7) == b"\1\2"
    with pytest.raises(AdapterError, match="are bad"):
        _process_data(blocks.input_data(b"\1\2", good=False), 0x0015, 6)


@pytest.mark.parametrize("data", [b"", bytes(79), b"\4\2" + bytes(90), b"\4\7" + bytes(120)])
def test_what_is_no_answer_is_said_to_be_none(data: bytes) -> None:
    with pytest.raises(BadReply):
        wire.rpc_answer(data)


@pytest.mark.parametrize(
    "name", ["a", "press-4", "plc.line-1", "Kit", "a_b", "-a", "a-", "a..b", "x" * 64, "10.0.0.1", "port-001"]
)
def test_the_adapter_takes_the_names_that_the_standard_does(name: str) -> None:
    assert bool(_NAME.fullmatch(name) and not _NO_NAME.fullmatch(name)) == is_station_name(name)


def test_a_gsdml_file_says_modules_with_their_lengths() -> None:
    file = parse(GSDML)
    (module,) = file.modules
    assert (file.vendor, file.vendor_id, file.device_id) == ("Kit", 0xABC, 1)
    assert (module.name, module.module, module.submodule, module.inputs, module.outputs) == (
        "8 bytes in",
        0x10,
        1,
        8,
        0,
    )


@pytest.mark.parametrize(
    "content",
    [b"", b"<a>", b"<a/>", b'<!DOCTYPE a [<!ENTITY b "c">]><a/>', GSDML.replace(b"0x0ABC", b"vendor")],
)
def test_what_is_no_gsdml_file_is_refused(content: bytes) -> None:
    with pytest.raises(BadGsdml):
        parse(content)


def test_an_alias_of_a_place_that_its_device_does_not_have_stops_the_start(tmp_path: Path) -> None:
    alias = {"device_name": "press-4", "slot": 2, "area": "outputs", "offset": 1, "data_type": "UINT16"}
    known = environment(tmp_path, PROFINET_DEVICE_MAP=DEVICES, PROFINET_ALIAS_MAP={"valve": alias})
    with pytest.raises(ConfigError, match=re.escape("it ends after the outputs of its subslot")):
        load_aliases(known, load_devices(known))


@pytest.mark.parametrize(
    ("status", "code", "name"),
    [
        (0xDE80B200, "illegal_address", "B2"),
        (0xDF80B700, "illegal_value", "B7"),
        (0xDB814004, "access_denied", "CMRPC-04"),
        (0xDF814005, "session_error", "CMRPC-05"),
        (0xDB810209, "protocol_error", "CM-02"),
    ],
)
def test_a_status_becomes_a_code(status: int, code: str, name: str) -> None:
    call = Call(protocol="profinet-io", operation="x", endpoint="profinet:///x", writes=True)
    assert (refusal(call, status).code, call.trace["pnio_error"]) == (code, name)
    assert dcp_refusal(3).code == "illegal_value"
