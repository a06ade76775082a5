"""The OPC UA reference adapter against the mock plant: its replies and the server's journal."""

# In the checkout mypy does not find the installed name of the adapters' folder.
# mypy: disable-error-code="import-not-found"

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Iterable, Iterator
from typing import Any

import pytest
from pytest_otmcp.reference_adapters.core import AdapterError
from pytest_otmcp.reference_adapters.opcua.nodes import parse_node

from pytest_otmcp.core.error_registry import wire_codes

from .cases import OPCUA
from .conftest import DEADLINE_S

pytestmark = pytest.mark.usefixtures("clean")
CASE = OPCUA
LATE_S = 60.0
"""Seconds after which a late answer would come. The tests do not wait so long: they move the adapter's clock on."""
FAREWELL = {"CloseSession", "CloseSecureChannel", "DISCONNECTED"}
FAN, TEMPERATURE = "ns=2;s=FanSpeed", "ns=2;s=Temperature"
METHODS, SET_RATE = "ns=2;s=Methods", "ns=2;s=SetProductionRate"
READS, WRITES = OPCUA.reads, OPCUA.writes


@pytest.fixture(scope="module")
def plant(rig: Any) -> Any:
    return rig.device


@pytest.fixture
def fresh(adapter: Any, plant: Any) -> Any:
    """The adapter in a new session, in which it has read no facts about the server yet."""
    plant.fault(
        {"times": 1, "service": "Read", "node": TEMPERATURE, "action": {"service_fault": "BadSessionIdInvalid"}}
    )
    assert adapter.call("read_opcua_node", node_id=TEMPERATURE).envelope["success"]
    plant.fault()
    return adapter


def create(plant: Any, *wishes: dict[str, Any]) -> None:
    plant("poke", params={"create": list(wishes)})


def variable(plant: Any, name: str, kind: str, value: Any, **more: Any) -> str:
    create(plant, {"variable": name, "type": kind, "value": value, **more})
    return f"ns=2;s={name}"


def held(plant: Any, node: str) -> Any:
    return plant("image")["variables"][node]["value"]


def asked(plant: Any, mark: int, **fields: Any) -> list[str]:
    """Return the services that reached the server since the mark.

    Those that close a session are left out: a session that an earlier test lost is closed in the background at any
    time. The Read with which the library checks once a minute that the server is alive is left out, too.
    """
    entries = [entry for entry in plant.since(mark, direction="in", **fields) if entry["kind"] not in FAREWELL]
    return [entry["kind"] for entry in entries if entry.get("nodes") != [{"node_id": "i=2259", "attribute": "Value"}]]


# -- what is read and written ------------------------------------------------------------------------------------


def test_there_are_the_seven_tools_of_the_paper(adapter: Any) -> None:
    assert len(adapter.tools) == 7


def test_a_value_is_the_servers_with_type_status_and_times(adapter: Any, plant: Any) -> None:
    plant("poke", params={"node": "Temperature", "value": 21.75})
    adapter.call("read_opcua_node", node_id=TEMPERATURE)
    mark = plant.mark()
    reply = adapter.call("read_opcua_node", node_id=TEMPERATURE)
    data = reply.data
    assert (data["value"], data["data_type"], data["status"], data["quality"]) == (21.75, "Double", "Good", "good")
    assert data["source_timestamp"].endswith("Z")
    assert data["server_timestamp"].endswith("Z")
    assert asked(plant, mark) == ["Read"]
    trace = reply.meta["trace"]
    assert (trace["service"], trace["node_ids"]) == ("Read", [TEMPERATURE])
    assert trace["status_code"] == {"value": 0, "symbol": "Good"}
    assert len(trace["request_handles"]) == reply.meta["attempts"] == 1


@pytest.mark.parametrize("tool", WRITES)
def test_every_write_is_one_request_and_does_what_it_says(adapter: Any, plant: Any, tool: str) -> None:
    mark = plant.mark()
    assert adapter.call(tool, WRITES[tool]).envelope["success"]
    assert len(asked(plant, mark, state_changing=True)) == 1
    before = {"ns=2;s=FanSpeed": 40.0, "ns=2;s=AlarmActive": False, "ns=2;s=ProductionRate": 100.0}
    changes: dict[str, dict[str, Any]] = {
        "write_opcua_node": {"ns=2;s=FanSpeed": 12.5},
        "write_multiple_opcua_nodes": {"ns=2;s=FanSpeed": 12.5, "ns=2;s=AlarmActive": True},
        "call_opcua_method": {"ns=2;s=ProductionRate": 120.0},
    }
    assert {node: held(plant, node) for node in before} == {**before, **changes[tool]}
    # The second write needs no questions before it.
    mark = plant.mark()
    reply = adapter.call(tool, WRITES[tool])
    assert len(asked(plant, mark)) == reply.meta["attempts"] == 1


@pytest.fixture
def overheard(plant: Any) -> Iterator[tuple[int, bytearray]]:
    """A port that leads to the server, and the bytes that one client sends there."""
    heard = bytearray()
    listener = socket.create_server(("127.0.0.1", 0))

    def carry(source: socket.socket, sink: socket.socket, copy: bytearray) -> None:
        while data := source.recv(1 << 16):
            copy += data
            sink.sendall(data)
        sink.shutdown(socket.SHUT_WR)

    def serve() -> None:
        client, _ = listener.accept()
        server = socket.create_connection(("127.0.0.1", plant.port))
        back = threading.Thread(target=carry, args=(server, client, bytearray()))
        back.start()
        carry(client, server, heard)
        back.join()
        client.close()
        server.close()

    # The thread is a daemon, so that the tests can end even if no client ever connects.
    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    yield listener.getsockname()[1], heard
    thread.join(timeout=40.0)
    listener.close()


def test_nothing_but_the_value_is_written(rig: Any, overheard: tuple[int, bytearray]) -> None:
    port, heard = overheard
    subject = rig.start("overheard", writes="true", OPCUA_URL=f"opc.tcp://127.0.0.1:{port}")
    assert subject.call("write_opcua_node", node_id=FAN, value=2.5).envelope["success"]
    subject.close()
    # A DataValue (OPC 10000-6, 5.2.2.17): the mask that says what it holds, then type and value; 1 is the value alone.
    assert heard[heard.index(struct.pack("<Bd", 11, 2.5)) - 1] == 1


def test_a_written_value_stays_while_the_plant_runs(adapter: Any, plant: Any) -> None:
    adapter.call("write_opcua_node", node_id="ns=2;s=ValvePosition", value=25)
    plant("tick", steps=3)
    assert adapter.call("read_opcua_node", node_id="ns=2;s=ValvePosition").data["value"] == 25.0


# -- types -------------------------------------------------------------------------------------------------------

WHOLE = {
    "SByte": (-128, 127),
    "Byte": (0, 255),
    "Int16": (-(2**15), 2**15 - 1),
    "UInt16": (0, 2**16 - 1),
    "Int32": (-(2**31), 2**31 - 1),
    "UInt32": (0, 2**32 - 1),
    "Int64": (-(2**63), 2**63 - 1),
    "UInt64": (0, 2**64 - 1),
}
GUID = "6b29fc40-ca47-1067-b31d-00dd010662da"
LEGAL: dict[str, list[Any]] = {
    "Boolean": [True, False],
    **{kind: [low, 1, high] for kind, (low, high) in WHOLE.items()},
    "Float": [0.5, -3, 3.4028234663852886e38, 1.401298464324817e-45],
    "Double": [0.1, -7, 1.7976931348623157e308, 5e-324, 2**53],
    "String": ["", "grün \U0001f33f"],
    "LocalizedText": ["open"],
    "DateTime": ["2026-02-28T12:00:00.250Z", "1601-01-02T00:00:00.000Z"],
    "Guid": [GUID],
    "ByteString": ["AAH/", ""],
}
START: dict[str, Any] = {
    **dict.fromkeys((*WHOLE, "Float", "Double"), 2),
    "Boolean": False,
    "String": "x",
    "LocalizedText": "x",
    "DateTime": "2020-01-01T00:00:00Z",
    "Guid": "00000000-0000-0000-0000-000000000001",
    "ByteString": "AA==",
}


@pytest.mark.parametrize("kind", LEGAL)
def test_every_built_in_type_is_written_exactly_and_read_back(fresh: Any, plant: Any, kind: str) -> None:
    node = variable(plant, f"A{kind}", kind, START[kind])
    for value in LEGAL[kind]:
        mark = plant.mark()
        written = fresh.call("write_opcua_node", node_id=node, value=value).data
        assert (written["value"], written["data_type"]) == (value, kind)
        (request,) = plant.since(mark, kind="Write", direction="in")
        assert (request["nodes"][0]["variant_type"], request["nodes"][0]["has_timestamp"]) == (kind, False)
        read = fresh.call("read_opcua_node", node_id=node).data
        beyond_doubles = isinstance(value, int) and not isinstance(value, bool) and abs(value) > 2**53 - 1
        expected = str(value) if beyond_doubles and kind in WHOLE else value
        assert (read["value"], read["data_type"]) == (expected, kind)


def unfit() -> Iterable[tuple[str, Any, str]]:
    def each(kind: str, code: str, *values: Any) -> Iterable[tuple[str, Any, str]]:
        return ((kind, value, code) for value in values)

    for kind, (low, high) in WHOLE.items():
        yield from each(kind, "range_overflow", low - 1, high + 1)
        yield from each(kind, "type_mismatch", "1", True, 1.5, None, {}, [1])
    yield from each("Boolean", "type_mismatch", 1, 0, "true", "false", None, [True])
    for kind, beyond in (("Float", 3.41e38), ("Double", 10**400)):
        yield from each(kind, "range_overflow", beyond, -beyond)
        yield from each(kind, "type_mismatch", "1.5", True, None, [1.5], {})
    yield from each("Double", "type_mismatch", 2**53 + 1)
    for kind in ("String", "LocalizedText", "DateTime", "Guid", "ByteString"):
        yield from each(kind, "type_mismatch", 1, False, None, ["x"])
    yield from each("DateTime", "type_mismatch", "yesterday", "2026-01-01T00:00:00")
    yield from each("DateTime", "range_overflow", "1600-12-31T00:00:00Z")
    yield from each("Guid", "type_mismatch", "12", GUID.replace("-", ""), f"{{{GUID}}}")
    yield from each("ByteString", "type_mismatch", "not base64")


def test_what_a_type_cannot_hold_is_refused_before_it_is_sent(fresh: Any, plant: Any) -> None:
    nodes = {kind: variable(plant, f"A{kind}", kind, start) for kind, start in START.items()}
    before, mark = plant("image"), plant.mark()
    for kind, value, code in unfit():
        error = fresh.call("write_opcua_node", node_id=nodes[kind], value=value).error
        assert (error["code"], error["outcome"]) == (code, "not_sent"), (kind, value)
        assert error["field"].startswith("/value"), (kind, value)
    assert "Write" not in asked(plant, mark)
    assert plant("image") == before


@pytest.mark.parametrize("number", [b"NaN", b"Infinity", b"-Infinity", b"1e999"])
def test_what_is_no_number_is_not_sent(adapter: Any, plant: Any, number: bytes) -> None:
    mark = plant.mark()
    identifier = adapter.start("write_opcua_node", {"node_id": FAN, "value": 1.0})
    assert adapter.reply("write_opcua_node", identifier).envelope["success"]
    meta = b'{"io.modelcontextprotocol/protocolVersion":"2026-07-28","io.modelcontextprotocol/clientCapabilities":{},'
    meta += b'"io.modelcontextprotocol/clientInfo":{"name":"t","version":"1"}}'
    adapter.write(
        b'{"jsonrpc":"2.0","id":"odd","method":"tools/call","params":{"name":"write_opcua_node","_meta":'
        + meta
        + b',"arguments":{"node_id":"ns=2;s=FanSpeed","value":'
        + number
        + b"}}}"
    )
    assert adapter.reply("write_opcua_node", "odd").error["outcome"] == "not_sent"
    assert len(plant.since(mark, kind="Write", direction="in")) == 1


def test_arrays_are_written_in_the_shape_that_the_node_has(fresh: Any, plant: Any) -> None:
    row = variable(plant, "Row", "Int32", [1, 2, 3])
    fixed = variable(plant, "Fixed", "Int32", [1, 2, 3], dimensions=[3])
    grid = variable(plant, "Grid", "Double", [[1, 2], [3, 4]])
    either = variable(plant, "Either", "Int32", 1, rank=-3)
    scalar = variable(plant, "Scalar", "Int32", 1)
    good = [(row, [4]), (row, [1, 2, 3, 4]), (row, []), (fixed, [7, 8, 9]), (grid, [[1.5, 2], [3, 4], [5, 6]])]
    good += [(either, 5), (either, [5, 6]), (scalar, 5)]
    for node, value in good:
        assert fresh.call("write_opcua_node", node_id=node, value=value).envelope["success"], (node, value)
        assert fresh.call("read_opcua_node", node_id=node).data["value"] == value
        assert held(plant, node) == value
    bad: list[tuple[str, Any]] = [
        (row, 1),
        (row, [[1]]),
        (row, ["1"]),
        (row, [1, None]),
        (fixed, [1, 2]),
        (scalar, [1]),
    ]
    bad += [(grid, [1, 2]), (grid, [[1, 2], [3]]), (grid, 1), (either, [[1]]), (row, [1, 2**31])]
    before, mark = plant("image"), plant.mark()
    for node, value in bad:
        error = fresh.call("write_opcua_node", node_id=node, value=value).error
        assert error["code"] == ("range_overflow" if value == [1, 2**31] else "type_mismatch"), (node, value)
        assert error["outcome"] == "not_sent"
    assert "Write" not in asked(plant, mark)
    assert plant("image") == before


def test_derived_and_abstract_data_types_travel_as_their_base(fresh: Any, plant: Any) -> None:
    state = variable(plant, "State", "Int32", 0, data_type="i=852")  # ServerState, an enumeration
    duration = variable(plant, "Duration", "Double", 1.0, data_type="i=290")
    number = variable(plant, "Number", "UInt16", 1, data_type="i=26")
    for node, value, kind in ((state, 3, "Int32"), (duration, 2.5, "Double"), (number, 7, "UInt16")):
        assert fresh.call("write_opcua_node", node_id=node, value=value).data["data_type"] == kind
        assert held(plant, node) == value
    assert fresh.call("write_opcua_node", node_id=number, value=-1).error["code"] == "range_overflow"


@pytest.mark.parametrize(("value", "special"), [(float("nan"), "NaN"), (float("-inf"), "-Infinity")])
def test_what_json_has_no_number_for_is_named(adapter: Any, plant: Any, value: float, special: str) -> None:
    plant("poke", params={"node": "Temperature", "value": value})
    data = adapter.call("read_opcua_node", node_id=TEMPERATURE).data
    assert (data["value"], data["special"]) == (None, special)
    row = variable(plant, "Row", "Double", [1.0, value])
    data = adapter.call("read_opcua_node", node_id=row).data
    assert (data["value"], data["special"]) == ([1.0, None], [None, special])


def test_structures_are_objects_and_bytes_say_so(adapter: Any, plant: Any) -> None:
    status = adapter.call("read_opcua_node", node_id="i=2256").data  # Server_ServerStatus
    assert status["value"]["State"] == "Running"
    assert status["value"]["BuildInfo"]["ProductUri"]
    data = adapter.call("read_opcua_node", node_id=variable(plant, "Blob", "ByteString", "AAH/")).data
    assert (data["value"], data["encoding"]) == ("AAH/", "base64")


# -- status ------------------------------------------------------------------------------------------------------

# These codes end a session or prevent one, and are not the status of an item; tests below are about them.
ENDS_THE_SESSION = {"BadShutdown", "BadConnectionClosed", "BadServerHalted", "BadNoContinuationPoints"}
CODES = {
    symbol: entry
    for symbol, entry in wire_codes("pytest_otmcp.protocols.opcua").items()
    if entry.codes
    and entry.outcome != "not_sent"
    and "session_error" not in entry.codes
    and symbol not in ENDS_THE_SESSION
}


def test_status_codes_of_items_and_of_services_have_their_codes(adapter: Any, plant: Any) -> None:
    adapter.call("write_opcua_node", node_id=FAN, value=1.0)
    assert len(CODES) > 30
    for symbol, entry in CODES.items():
        for action in ({"status": symbol}, {"service_fault": symbol}):
            plant.fault({"action": action})
            read = adapter.call("read_opcua_node", node_id=TEMPERATURE)
            assert read.error["code"] in entry.codes, (symbol, action)
            assert read.error["outcome"] == "not_applicable", (symbol, action)
            assert read.meta["trace"]["status_code"]["symbol"] == symbol
            assert symbol in read.error["message"]
            browse = adapter.call("browse_opcua_node_children", node_id="ns=2;s=Sensors")
            assert browse.error["code"] in entry.codes, (symbol, action)
            if entry.outcome is not None:
                mark = plant.mark()
                write = adapter.call("write_opcua_node", node_id=FAN, value=2.0)
                assert write.error["code"] in entry.codes, (symbol, action)
                assert write.error["outcome"] == entry.outcome, (symbol, action)
                assert asked(plant, mark) == ["Write"]
    plant.fault()
    assert held(plant, FAN) == 1.0


def test_a_bad_value_is_none_and_an_uncertain_one_is_marked(adapter: Any, plant: Any) -> None:
    plant("poke", params={"node": "Temperature", "value": 3.5, "status": "UncertainLastUsableValue"})
    plant("poke", params={"node": "Pressure", "value": 3.5, "status": "BadSensorFailure"})
    data = adapter.call("read_opcua_node", node_id=TEMPERATURE).data
    assert (data["value"], data["quality"], data["status"]) == (3.5, "uncertain", "UncertainLastUsableValue")
    assert adapter.call("read_opcua_node", node_id="ns=2;s=Pressure").error["code"] == "bad_quality"
    listed = {each["browse_name"]: each for each in adapter.call("get_all_variables").data["variables"]}
    assert (listed["Pressure"]["value"], listed["Pressure"]["quality"]) == (None, "bad")


def test_a_clamped_and_an_unfinished_write_say_so(adapter: Any, plant: Any) -> None:
    plant.fault({"service": "Write", "action": {"clamp": 80.0}})
    data = adapter.call("write_opcua_node", node_id=FAN, value=120).data
    assert (data["value"], data["clamped"], data["status"]) == (80.0, True, "GoodClamped")
    plant.fault({"service": "Write", "action": {"status": "GoodCompletesAsynchronously"}})
    reply = adapter.call("write_opcua_node", node_id=FAN, value=60)
    assert reply.data["verified"] is reply.meta["verified"] is False


def test_what_must_not_be_written_is_told_apart(adapter: Any, plant: Any) -> None:
    denied = variable(plant, "Denied", "Double", 1.0, access="denied")
    cases = [
        (TEMPERATURE, "not_writable", "rejected"),
        (denied, "access_denied", "rejected"),
        ("ns=2;s=Nobody", "illegal_address", "not_sent"),
        ("ns=2;s=Sensors", "illegal_address", "not_sent"),
        ("ns=2;s=ResetAlarms", "illegal_address", "not_sent"),
    ]
    before = plant("image")
    for node, code, outcome in cases:
        error = adapter.call("write_opcua_node", node_id=node, value=1.0).error
        assert (error["code"], error["outcome"], error["field"]) == (code, outcome, "/node_id")
    assert plant("image") == before


# -- batches -----------------------------------------------------------------------------------------------------


def test_a_batch_read_has_a_result_for_every_item(adapter: Any, plant: Any) -> None:
    adapter.call("read_opcua_node", node_id=TEMPERATURE)
    mark = plant.mark()
    nodes = [TEMPERATURE, "ns=2;s=Nobody", "ns=2;s=Mode", TEMPERATURE]
    reply = adapter.call("read_multiple_opcua_nodes", node_ids=nodes)
    assert (reply.error["code"], reply.error["outcome"]) == ("partial_failure", "not_applicable")
    items = reply.envelope["data"]["partial"]["items"]
    assert [(item["node_id"], item["success"]) for item in items] == list(zip(nodes, (1, 0, 1, 1), strict=True))
    assert items[1]["error"]["code"] == "illegal_address"
    assert "value" not in items[1]
    assert asked(plant, mark) == ["Read"]
    assert reply.meta["untrusted"] == ["/data/partial/items"]


def test_a_batch_write_tells_of_every_item_what_became_of_it(adapter: Any, plant: Any) -> None:
    items = [
        {"node_id": FAN, "value": 1},
        {"node_id": TEMPERATURE, "value": 2},
        {"node_id": "ns=2;s=HeaterPower", "value": 3},
    ]
    mark = plant.mark()
    reply = adapter.call("write_multiple_opcua_nodes", items=items)
    assert (reply.error["code"], reply.error["outcome"]) == ("partial_failure", "partial")
    results = reply.envelope["data"]["partial"]["items"]
    assert [result["success"] for result in results] == [True, False, True]
    assert results[1]["error"] | {"message": ""} == {
        "code": "not_writable",
        "class": "device",
        "message": "",
        "retryable": False,
        "outcome": "rejected",
    }
    assert asked(plant, mark).count("Write") == 1
    (answer,) = plant.since(mark, kind="Write", direction="out")
    assert [result["status"] for result in answer["results"]] == ["Good", "BadNotWritable", "Good"]
    assert (held(plant, FAN), held(plant, "ns=2;s=HeaterPower")) == (1.0, 3.0)
    all_bad = adapter.call("write_multiple_opcua_nodes", items=[items[1]] * 2)
    assert (all_bad.error["code"], all_bad.error["outcome"]) == ("partial_failure", "rejected")


@pytest.mark.parametrize(
    ("item", "code", "field"),
    [
        ({"node_id": FAN, "value": "fast"}, "type_mismatch", "/items/1/value"),
        ({"node_id": "ns=2;s=Nobody", "value": 1}, "illegal_address", "/items/1/node_id"),
        ({"node_id": "nobody", "value": 1}, "invalid_input", "/items/1/node_id"),
        ({"node_id": FAN}, "invalid_input", "/items/1/value"),
    ],
)
def test_a_batch_with_an_item_that_cannot_be_written_writes_nothing(
    adapter: Any, plant: Any, item: dict[str, Any], code: str, field: str
) -> None:
    mark = plant.mark()
    error = adapter.call("write_multiple_opcua_nodes", items=[{"node_id": FAN, "value": 1}, item]).error
    assert (error["code"], error["outcome"], error["field"]) == (code, "not_sent", field)
    assert asked(plant, mark, state_changing=True) == []


# -- methods -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "code", "field"),
    [
        (["x", "x"], "type_mismatch", "/arguments/0"),
        ([7, 7], "type_mismatch", "/arguments/1"),
        ([2**31, "x"], "range_overflow", "/arguments/0"),
        ([[7], "x"], "type_mismatch", "/arguments/0"),
        ([7], "invalid_input", "/arguments"),
        ([7, "x", 1], "invalid_input", "/arguments"),
    ],
)
def test_a_methods_arguments_are_those_that_it_declares(
    adapter: Any, plant: Any, arguments: list[Any], code: str, field: str
) -> None:
    create(plant, {"method": "Echo", "inputs": ["Int32", "String"]})
    echo = {"object_id": METHODS, "method_id": "ns=2;s=Echo"}
    data = adapter.call("call_opcua_method", {**echo, "arguments": [7, "7"]}).data
    assert [(output["value"], output["data_type"]) for output in data["outputs"]] == [(7, "Int32"), ("7", "String")]
    mark = plant.mark()
    error = adapter.call("call_opcua_method", {**echo, "arguments": arguments}).error
    assert (error["code"], error["outcome"], error["field"]) == (code, "not_sent", field)
    assert "Call" not in asked(plant, mark)


def test_a_method_that_is_refused_says_why(adapter: Any) -> None:
    call = {"object_id": METHODS, "method_id": SET_RATE, "arguments": [-1]}
    error = adapter.call("call_opcua_method", call).error
    assert (error["code"], error["outcome"]) == ("invalid_input", "rejected")
    assert error["details"] == {"arguments": ["BadOutOfRange"]}
    unknown = adapter.call("call_opcua_method", object_id=METHODS, method_id="ns=2;s=Nobody").error
    assert (unknown["code"], unknown["outcome"]) == ("illegal_address", "not_sent")
    elsewhere = adapter.call("call_opcua_method", object_id="ns=2;s=Plant", method_id="ns=2;s=ResetAlarms").error
    assert (elsewhere["code"], elsewhere["outcome"]) == ("illegal_address", "rejected")


# -- browsing and enumeration ------------------------------------------------------------------------------------


def test_children_are_listed_with_names_and_classes(adapter: Any, plant: Any) -> None:
    reply = adapter.call("browse_opcua_node_children", node_id="ns=2;s=Actuators")
    image = plant("image")["variables"]
    expected = {node: each["browse_name"] for node, each in image.items() if each["parent"] == "ns=2;s=Actuators"}
    assert {child["node_id"]: child["browse_name"] for child in reply.data["children"]} == expected
    assert {child["node_class"] for child in reply.data["children"]} == {"Variable"}
    assert reply.meta["untrusted"] == ["/data/children"]
    assert adapter.call("browse_opcua_node_children", node_id="ns=2;s=Nobody").error["code"] == "illegal_address"


@pytest.mark.parametrize("limits", [{"references_per_node": 3}, {"references_per_node": 1, "continuation_points": 1}])
def test_pages_are_turned_to_the_end_and_none_is_left_open(adapter: Any, plant: Any, limits: dict[str, int]) -> None:
    plant("poke", params={"limits": limits})
    mark = plant.mark()
    children = adapter.call("browse_opcua_node_children", node_id="ns=2;s=Sensors").data["children"]
    assert len({child["node_id"] for child in children}) == len(children) == 8
    assert "BrowseNext" in asked(plant, mark)
    listed = [each["node_id"] for each in adapter.call("get_all_variables").data["variables"]]
    image = plant("image")
    assert sorted(listed) == sorted(image["variables"])
    assert image["clients"]["continuation_points"] == 0


def test_an_enumeration_takes_few_calls_however_many_nodes_there_are(fresh: Any, plant: Any) -> None:
    create(plant, {"folder": "Crowd"})
    for start in range(0, 120, 20):
        numbers = range(start, start + 20)
        create(plant, *({"variable": f"V{i}", "in": "Crowd", "type": "Int32", "value": i} for i in numbers))
    for most in (6, 2):
        mark = plant.mark()
        reply = fresh.call("get_all_variables")
        assert len(asked(plant, mark)) == reply.meta["attempts"] <= most
        listed = {each["node_id"]: each["value"] for each in reply.data["variables"]}
        assert reply.data["count"] == len(listed) == 140
        assert listed == {node: each["value"] for node, each in plant("image")["variables"].items()}


def test_an_enumeration_finds_everything_once_and_ends(fresh: Any, plant: Any) -> None:
    create(
        plant,
        {"folder": "Cell"},
        {"folder": "Inner", "in": "Cell"},
        {"variable": "Part", "in": "Inner", "type": "Double", "value": 1.0},
        {"variable": "SubPart", "in": "Part", "type": "Double", "value": 2.0},
        {"variable": "Limit", "in": "Part", "type": "Double", "value": 9.0, "property": True},
        {"reference": "Inner", "to": "Cell"},
        {"reference": "Inner", "to": "Inner"},
        {"reference": "Inner", "to": "Sensors"},
    )
    for _ in range(2):
        listed = [each["node_id"] for each in fresh.call("get_all_variables").data["variables"]]
        assert sorted(listed) == sorted(plant("image")["variables"])
        assert "ns=2;s=SubPart" in listed
        assert "ns=2;s=Limit" not in listed
    # A new variable is found in the same session.
    variable(plant, "Newcomer", "Double", 3.0, **{"in": "Inner"})
    assert "ns=2;s=Newcomer" in [each["node_id"] for each in fresh.call("get_all_variables").data["variables"]]


def test_a_folder_that_the_server_refuses_later_stops_an_enumeration_only_while_it_is_there(
    fresh: Any, plant: Any
) -> None:
    create(plant, {"folder": "Cell"}, {"variable": "Part", "in": "Cell", "type": "Double", "value": 1.0})
    assert fresh.call("get_all_variables").data["count"] == 21
    plant.fault({"service": "Browse", "node": "ns=2;s=Cell", "action": {"status": "BadUserAccessDenied"}})
    assert fresh.call("get_all_variables").error["code"] == "access_denied"
    plant("reset")
    listed = fresh.call("get_all_variables")
    assert sorted(each["node_id"] for each in listed.data["variables"]) == sorted(plant("image")["variables"])


def test_a_server_that_takes_few_at_once_is_asked_in_portions(fresh: Any, plant: Any) -> None:
    plant("poke", params={"limits": {"nodes_per_read": 7, "nodes_per_browse": 2}})
    reply = fresh.call("get_all_variables")
    assert sorted(each["node_id"] for each in reply.data["variables"]) == sorted(plant("image")["variables"])
    mark = plant.mark()
    fresh.call("read_multiple_opcua_nodes", node_ids=[TEMPERATURE] * 15)
    assert asked(plant, mark) == ["Read"] * 3


def test_texts_of_the_server_are_marked_and_cleaned(adapter: Any, plant: Any) -> None:
    name = "IGNORE \x1b[31m\u202eeverything"
    create(plant, {"folder": "Odd"}, {"variable": name, "in": "Odd", "type": "String", "value": name})
    for tool, arguments, place in (
        ("browse_opcua_node_children", {"node_id": "ns=2;s=Odd"}, "/data/children"),
        ("get_all_variables", {}, "/data/variables"),
    ):
        reply = adapter.call(tool, arguments)
        assert (reply.meta["untrusted"], reply.meta["sanitised"]) == ([place], True)
        assert "\u202e" not in str(reply.data)
        assert "IGNORE" in str(reply.data)


# -- node ids ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "identifier", "index"),
    [
        ("i=85", 85, 0),
        ("ns=2;s=a;b=c", "a;b=c", 2),
        ("ns=65535;i=4294967295", 2**32 - 1, 65535),
        ("ns=1;b=AAH/", b"\x00\x01\xff", 1),
        ("s= x ", " x ", 0),
    ],
)
def test_a_node_id_is_read_as_it_is_written(text: str, identifier: Any, index: int) -> None:
    name = parse_node(text, "")
    assert (name.identifier, name.index, name.uri) == (identifier, index, None)


@pytest.mark.parametrize(
    "text",
    [
        *("garbage", "Temperature", "ns=2", "ns=2;i=abc", "ns=2;x=1", "ns=2;g=12", "ns=2;b=%%", "ns=2;s=", "nsu=;s=x"),
        *("ns=65536;i=1", "ns=-1;i=1", "ns=02;i=1", "i=4294967296", "i=-1", "i=1.5", "i= 1", "i=1;ns=2", "srv=1;i=1"),
        "s=a\x00b",
    ],
)
def test_what_is_no_node_id_is_refused(text: str) -> None:
    with pytest.raises(AdapterError) as refused:
        parse_node(text, "/node_id")
    assert (refused.value.code, refused.value.field) == ("invalid_input", "/node_id")


def test_a_namespace_uri_finds_its_node_wherever_the_server_puts_it(adapter: Any, rig: Any, plant: Any) -> None:
    a, b = ({"variable": "X", "type": "Double", "value": value, "namespace": f"urn:{value}"} for value in (1.0, 2.0))
    create(plant, a, b)
    target = "nsu=urn:1.0;s=X"
    assert adapter.call("read_opcua_node", node_id=target).data["value"] == 1.0
    with rig.outage():
        pass
    create(plant, b, a)
    # A read finds out that the connection has ended, and is repeated. A write would not be repeated.
    assert adapter.call("read_opcua_node", node_id=TEMPERATURE).envelope["success"]
    assert adapter.call("write_opcua_node", node_id=target, value=7).envelope["success"]
    values = {node: each["value"] for node, each in plant("image")["variables"].items() if node.endswith("s=X")}
    assert values == {"ns=3;s=X": 2.0, "ns=4;s=X": 7.0}
    error = adapter.call("write_opcua_node", node_id="nsu=urn:nobody;s=X", value=7).error
    assert (error["code"], error["outcome"]) == ("illegal_address", "not_sent")


# -- time and connections ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("symbol", ["BadSessionIdInvalid", "BadSessionClosed", "BadSecureChannelIdInvalid"])
def test_a_lost_session_is_replaced_and_a_write_in_it_was_not_done(adapter: Any, plant: Any, symbol: str) -> None:
    adapter.call("write_opcua_node", node_id=FAN, value=1)
    plant.fault({"service": "Read", "node": TEMPERATURE, "times": 1, "action": {"service_fault": symbol}})
    reply = adapter.call("read_opcua_node", node_id=TEMPERATURE)
    assert (reply.envelope["success"], reply.meta["attempts"]) == (True, 2)
    adapter.call("write_opcua_node", node_id=FAN, value=1)
    plant.fault({"service": "Write", "times": 1, "action": {"service_fault": symbol}})
    reply = adapter.call("write_opcua_node", node_id=FAN, value=2)
    assert (reply.error["code"], reply.error["outcome"]) == ("session_error", "rejected")
    assert adapter.call("write_opcua_node", node_id=FAN, value=3).envelope["success"]
    assert held(plant, FAN) == 3.0


@pytest.mark.parametrize(
    ("symbol", "code", "outcome"),
    [("BadSessionIdInvalid", "connection_lost", "unknown"), ("BadUserAccessDenied", "verify_failed", "applied")],
)
def test_a_write_is_not_sent_again_when_the_question_after_it_is_refused(
    adapter: Any, plant: Any, symbol: str, code: str, outcome: str
) -> None:
    adapter.call("write_opcua_node", node_id=FAN, value=1)
    plant.fault(
        {"service": "Write", "action": {"clamp": 80.0}},
        {"service": "Read", "node": FAN, "times": 1, "action": {"service_fault": symbol}},
    )
    mark = plant.mark()
    reply = adapter.call("write_opcua_node", node_id=FAN, value=120)
    assert (reply.error["code"], reply.error["outcome"]) == (code, outcome)
    assert asked(plant, mark) == ["Write", "Read"]


def test_a_handshake_that_is_not_answered_leaves_the_next_call_the_rest_of_its_time(adapter: Any, plant: Any) -> None:
    assert adapter.call("write_opcua_node", node_id=FAN, value=1).envelope["success"]
    plant.fault({"action": {"drop": True}})
    mark = plant.mark()
    lost = adapter.start("write_opcua_node", {"node_id": FAN, "value": 2})
    plant.wait(mark, kind="Write", direction="in")
    adapter.pass_time()
    assert adapter.reply("write_opcua_node", lost).error["code"] == "timeout"
    # The calls try to connect one after the other; a later one has only the rest of its time.
    mark = plant.mark()
    identifiers = adapter.start_together(*[("read_opcua_node", {"node_id": TEMPERATURE})] * 3)
    for count in (1, 2):
        plant.wait(mark, count, kind="OpenSecureChannel", direction="in")
        adapter.pass_time()
    errors = [adapter.reply("read_opcua_node", identifier).error for identifier in identifiers]
    assert {error["code"] for error in errors} <= {"timeout", "connect_failed"}
    assert any(f"within {DEADLINE_S:g} s" in error["message"] for error in errors)
    plant.fault()
    assert adapter.call("read_opcua_node", node_id=TEMPERATURE).envelope["success"]


def test_a_late_answer_is_not_the_next_calls(adapter: Any, plant: Any) -> None:
    plant("poke", params={"node": "Temperature", "value": 1111.0})
    plant("poke", params={"node": "Pressure", "value": 2222.0})
    assert adapter.call("read_opcua_node", node_id=TEMPERATURE).envelope["success"]
    mark = plant.mark()
    plant.fault({"service": "Read", "node": TEMPERATURE, "times": 1, "action": {"delay_s": LATE_S}})
    slow = adapter.start("read_opcua_node", {"node_id": TEMPERATURE})
    [late, *_] = plant.wait(mark, kind="Read", direction="in")
    adapter.pass_time()
    assert adapter.reply("read_opcua_node", slow).error["code"] == "timeout"
    assert adapter.call("read_opcua_node", node_id="ns=2;s=Pressure").data["value"] == 2222.0
    # No late answer can come over a connection that has ended.
    plant.wait(mark, kind="DISCONNECTED", connection=late["connection"])
    for _ in range(2):
        assert adapter.call("read_opcua_node", node_id="ns=2;s=Pressure").data["value"] == 2222.0


def test_answers_out_of_order_find_their_calls(adapter: Any, plant: Any) -> None:
    names = ["Temperature", "Pressure", "FlowRate", "TankLevel"]
    for value, name in enumerate(names):
        plant("poke", params={"node": name, "value": 1000.0 + value})
    adapter.call("read_opcua_node", node_id=TEMPERATURE)
    plant.fault(
        *({"node": f"ns=2;s={name}", "action": {"delay_s": 0.08 * (4 - i)}} for i, name in enumerate(names)),
    )
    # The calls are sent with one write: the first answer must not come before the last request.
    identifiers = adapter.start_together(*(("read_opcua_node", {"node_id": f"ns=2;s={name}"}) for name in names))
    replies = [adapter.reply("read_opcua_node", identifier) for identifier in identifiers]
    assert [reply.data["value"] for reply in replies] == [1000.0, 1001.0, 1002.0, 1003.0]


def test_one_session_serves_all_calls(adapter: Any, plant: Any) -> None:
    adapter.call("read_opcua_node", node_id=TEMPERATURE)
    mark = plant.mark()
    identifiers = adapter.start_together(*[("read_opcua_node", {"node_id": TEMPERATURE})] * 64)
    assert all(adapter.reply("read_opcua_node", identifier).envelope["success"] for identifier in identifiers)
    for tool, arguments in {**READS, **WRITES}.items():
        adapter.call(tool, arguments)
    assert not {"CONNECTED", "CreateSession"} & set(asked(plant, mark))


def test_sessions_do_not_pile_up(rig: Any, plant: Any) -> None:
    fresh = rig.start("piling")
    mark = plant.mark()
    assert fresh.call("read_opcua_node", node_id=TEMPERATURE).envelope["success"]
    for _ in range(5):
        plant.fault(
            {"service": "Read", "node": TEMPERATURE, "times": 1, "action": {"service_fault": "BadSessionIdInvalid"}}
        )
        assert fresh.call("read_opcua_node", node_id=TEMPERATURE).envelope["success"]
    *lost, current = (entry["connection"] for entry in plant.since(mark, kind="CONNECTED"))
    assert len(lost) == 5
    for connection in lost:
        plant.wait(mark, kind="DISCONNECTED", connection=connection)
        assert plant.since(mark, kind="CloseSession", direction="in", connection=connection)
    assert plant.since(mark, kind="DISCONNECTED", connection=current) == []
    fresh.close()
