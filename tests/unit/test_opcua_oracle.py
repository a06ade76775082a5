"""The oracles of OPC UA, on entries written by hand."""

from __future__ import annotations

import struct
from typing import Any

from pytest_otmcp.protocols.opcua import oracle

from .journals import Entry, journal

VALVE = "ns=2;s=ValvePosition"
SERVER_STATE = "i=2259"


def asked(kind: str, *nodes: Any, **fields: Any) -> Entry:
    request = kind not in ("CreateSession", "ActivateSession", "CONNECTED")
    changing = kind in ("Write", "Call")
    fixed = {"direction": "in", "kind": kind, "request": request, "state_changing": changing}
    return journal({**fixed, "nodes": list(nodes), **fields})[0]


def read(*nodes: str) -> Entry:
    return asked("Read", *({"node_id": node, "attribute": "Value"} for node in nodes))


def write(value: Any = 25.0, node: str = VALVE, **fields: Any) -> Entry:
    return asked("Write", {"node_id": node, "attribute": "Value", "value": value, **fields})


def answer(kind: str, *results: Any, **fields: Any) -> Entry:
    return journal({"direction": "out", "kind": kind, "results": list(results), **fields})[0]


def words(findings: list[Any]) -> str:
    (finding,) = findings
    return f"{finding.message} [{finding.requirement}] {finding.evidence or ''}"


def test_a_read_is_fresh_by_whatever_service_the_value_came() -> None:
    journal = [asked("CreateSession"), read(SERVER_STATE), read(VALVE, "ns=2;s=Temperature")]
    item = {"node_id": VALVE, "attribute": "Value"}
    assert oracle.read_from_device(journal, VALVE) == []
    assert oracle.read_from_device([asked("CreateMonitoredItems", item)], VALVE) == []
    assert oracle.read_from_device([{**answer("Publish"), "nodes": [item]}], VALVE) == []
    missing = words(oracle.read_from_device(journal, "ns=2;s=X"))
    assert "should have seen a read of ns=2;s=X during the call [RD-004] Read i=2259" in missing
    assert oracle.read_from_device([asked("Read", {**item, "attribute": "DataType"})], VALVE) != []
    assert oracle.read_from_device([write()], VALVE) != []


def test_keeping_a_session_is_no_service_to_the_plant() -> None:
    keeping = [asked("CreateSession"), asked("ActivateSession"), asked("CONNECTED")]
    assert "should have seen a service request [RD-004] no request" in words(oracle.some_service(keeping))
    assert oracle.some_service([*keeping, read(VALVE)]) == []


def test_browsing_is_of_the_node_that_was_asked_for() -> None:
    assert oracle.browsed([asked("Browse", "ns=2;i=5")], "ns=2;i=5") == []
    assert "a Browse of ns=2;i=6" in words(oracle.browsed([asked("Browse", "ns=2;i=5")], "ns=2;i=6"))


def test_a_refusal_is_found_in_items_and_in_faults_of_the_requests_that_name_the_node() -> None:
    def refused(request: Entry, reply: Entry, symbol: str) -> list[Any]:
        entries = journal(request, {**reply, "seq": 1, "answers": 0})
        assert oracle.reached(entries, VALVE) == (request["kind"] != "CreateSession")
        return oracle.refused_with(entries, VALVE, symbol)

    unknown = answer("Read", {"status": "BadNodeIdUnknown", "value": None})
    assert refused(read(VALVE), unknown, "BadNodeIdUnknown") == []
    assert refused(asked("Browse", VALVE), answer("Browse", "BadNodeIdUnknown"), "BadNodeIdUnknown") == []
    fault = answer("Read", service_result="BadSessionIdInvalid")
    assert refused(read(VALVE), fault, "BadSessionIdInvalid") == []
    assert "BadNotWritable for ns=2;s=ValvePosition, its answers had BadNodeIdUnknown" in words(
        refused(read(VALVE), unknown, "BadNotWritable")
    )
    assert "its answers had none" in words(refused(asked("CreateSession"), unknown, "BadNodeIdUnknown"))


def test_a_write_counts_once_with_its_value_and_nothing_else() -> None:
    assert oracle.exactly_one_write([read(VALVE), write(), answer("Write", {"status": "Good"})], VALVE, 25.0) == []
    assert oracle.exactly_one_write([write(25)], VALVE, 25.0) == []
    for entries, problem in (
        ([write(), write()], "it saw 2 [WR-003]"),
        ([read(VALVE)], "it saw 0 [WR-001]"),
        ([asked("Call")], "it saw Call []"),
        ([write(26.0)], "it saw Write [['ns=2;s=ValvePosition', 'Value', 26.0]]"),
        ([write(True)], "it saw Write [['ns=2;s=ValvePosition', 'Value', True]]"),
        ([write(has_status=True)], "a status was written with it [OUA-005]"),
        ([write(), answer("Write", "BadNotWritable")], "the server refused it with BadNotWritable [WR-001]"),
        (
            [write(25, variant_type="Int64"), answer("Write", "BadTypeMismatch")],
            "the adapter sent 25 as Int64, which is not the node's data type [OUA-001]",
        ),
    ):
        assert problem in words(oracle.exactly_one_write(entries, VALVE, 25.0))
    assert "it saw" in words(oracle.exactly_one_write([write(1)], VALVE, True))


def test_a_timestamp_that_is_written_with_a_value_is_a_warning() -> None:
    (finding,) = oracle.exactly_one_write([write(has_timestamp=True)], VALVE, 25.0)
    assert (finding.code, finding.requirement, finding.strength) == ("timestamp_written", "OUA-005", "SHOULD")


def test_nothing_that_changes_the_plant_may_arrive() -> None:
    assert oracle.no_state_changing_service([read(VALVE), asked("Browse", "i=85")]) == []
    assert "no state-changing request, it saw 1 [WR-004] Write" in words(oracle.no_state_changing_service([write()]))


def image(**values: Any) -> dict[str, Any]:
    held = {"ValvePosition": 10.0, "PumpEnabled": False, "Ratio": 0.5, **values}
    variables = {
        f"ns=2;s={name}": {
            "browse_name": name,
            "parent": "ns=2;s=Actuators",
            "value": value,
            "data_type": "Float" if name == "Ratio" else "Double",
        }
        for name, value in held.items()
        if value is not ...
    }
    points = {node: variable["value"] for node, variable in variables.items()}
    return {
        "points": points,
        "variables": variables,
        "folders": {"Actuators": "ns=2;s=Actuators", "Sensors": "ns=2;s=Sensors"},
    }


def test_images_are_compared_node_by_node_with_their_types() -> None:
    assert oracle.only_changed(image(), image(ValvePosition=25.0), {VALVE: 25.0}) == []
    assert (
        oracle.only_changed(image(), image(Ratio=struct.unpack("f", struct.pack("f", 0.1))[0]), {"ns=2;s=Ratio": 0.1})
        == []
    )
    neighbour = oracle.only_changed(image(), image(ValvePosition=25.0, PumpEnabled=True), {VALVE: 25.0})
    assert "ns=2;s=PumpEnabled should hold False, the server holds True [WR-002]" in words(neighbour)
    assert "should hold False, the server holds 0" in words(oracle.only_changed(image(), image(PumpEnabled=0), {}))
    assert "ns=2;s=PumpEnabled should hold False, the server has no such point" in words(
        oracle.only_changed(image(), image(PumpEnabled=...), {})
    )
    unwritten = oracle.only_changed(image(), image(), {VALVE: 25.0})
    assert "should hold 25.0, the server holds 10.0 [WR-001]" in words(unwritten)


def test_an_image_is_asked_for_one_value() -> None:
    assert oracle.image_holds(image(), VALVE, 10) == []
    assert oracle.image_holds(image(PumpEnabled=True), "ns=2;s=PumpEnabled", True) == []
    assert "should hold 1, the server holds True" in words(
        oracle.image_holds(image(PumpEnabled=True), "ns=2;s=PumpEnabled", 1)
    )
    assert "the server has no such point" in words(oracle.image_holds(image(), "ns=2;s=X", 1))


def test_browsing_has_to_give_every_name_with_its_own_id() -> None:
    children = oracle.children_of(image(), "Actuators")
    assert children == {name: f"ns=2;s={name}" for name in ("ValvePosition", "PumpEnabled", "Ratio")}
    assert oracle.children_of(image(), "Sensors") == {}
    ids, names = list(children.values()), [f"2:{name}" for name in children]
    assert oracle.names_and_ids_agree(ids, names, children) == []
    assert oracle.names_and_ids_agree([*ids, "ns=2;s=More"], [*names, "More"], children) == []
    crossed = oracle.names_and_ids_agree(ids[::-1], names, children)
    assert (
        "2 of 3 nodes are missing or wrong; ValvePosition should be ns=2;s=ValvePosition, it is ns=2;s=Ratio"
        in words(crossed)
    )
    for wrong_ids, wrong_names in ((None, None), (ids, names[:2]), ([], [])):
        assert "3 of 3 nodes are missing or wrong" in words(
            oracle.names_and_ids_agree(wrong_ids, wrong_names, children)
        )


def test_an_enumeration_is_complete_and_without_repeats() -> None:
    nodes = list(image()["variables"])
    assert oracle.complete_enumeration([*nodes, "i=2259"], image()) == []
    assert "all 3 variables should be listed once: 1 missing, for instance ns=2;s=Ratio" in words(
        oracle.complete_enumeration(nodes[:2], image())
    )
    assert "ns=2;s=Ratio is listed twice" in words(oracle.complete_enumeration([*nodes, "ns=2;s=Ratio"], image()))
    assert "3 missing" in words(oracle.complete_enumeration("text", image()))


SET_RATE, METHODS = "ns=2;s=SetProductionRate", "ns=2;s=Methods"


def call(*arguments: Any, owner: str = METHODS, method: str = SET_RATE) -> Entry:
    return asked("Call", method, methods=[{"object_id": owner, "method_id": method, "arguments": list(arguments)}])


def test_a_method_is_called_once_with_the_arguments_that_were_asked_for() -> None:
    def judged(*entries: Entry) -> list[Any]:
        return oracle.exactly_one_call(journal(*entries), METHODS, SET_RATE, [12.5])

    good = answer("Call", {"status": "Good", "outputs": [100.0]})
    assert judged(call(12.5), good) == []
    assert "it saw 2 [WR-003]" in words(judged(call(12.5), good, call(12.5), good))
    assert "it saw 0 [WR-001]" in words(judged(read(VALVE)))
    assert "it saw Call [[" in words(judged(call(13.5), good))
    assert judged(call(12.5, owner="i=85"), good) != []
    assert "it saw Write" in words(judged(write()))
    refused = answer("Call", {"status": "BadInvalidState", "outputs": []})
    assert "the server refused it with BadInvalidState" in words(judged(call(12.5), refused))


def test_the_image_counts_how_often_a_method_was_performed() -> None:
    assert oracle.performed({"points": {}, "methods": {SET_RATE: {"calls": 3}}}, SET_RATE) == 3


def test_several_values_are_written_together() -> None:
    def item(node: str, value: Any, **fields: Any) -> Entry:
        return {"node_id": node, "attribute": "Value", "value": value, **fields}

    def judged(*entries: Entry) -> list[Any]:
        return oracle.written_together(journal(*entries), {VALVE: 25.0, "ns=2;s=FanSpeed": 1.5})

    both, good = asked("Write", item("ns=2;s=FanSpeed", 1.5), item(VALVE, 25.0)), answer("Write", "Good", "Good")
    assert judged(both, good) == []
    assert "it saw 2 [WR-003]" in words(judged(write(25.0), write(1.5, "ns=2;s=FanSpeed")))
    assert "it saw Write" in words(judged(asked("Write", item(VALVE, 25.0)), good))
    assert judged(asked("Write", item("ns=2;s=FanSpeed", 1.5), item(VALVE, 26.0)), good) != []
    assert judged(asked("Write", item("ns=2;s=FanSpeed", 1.5), item(VALVE, 25.0), item(VALVE, 25.0)), good) != []
    assert "refused a part of it with BadNotWritable" in words(judged(both, answer("Write", "Good", "BadNotWritable")))
    timed = asked("Write", item("ns=2;s=FanSpeed", 1.5, has_timestamp=True), item(VALVE, 25.0))
    assert "[OUA-005]" in words(judged(timed, good))


def test_a_value_is_written_with_the_type_that_its_node_has() -> None:
    def judged(*entries: Entry) -> list[Any]:
        return oracle.written_as(list(entries), VALVE, "UInt16", 5, same=lambda held, value: held == value)

    assert judged(write(5, variant_type="UInt16")) == []
    assert "5 to ns=2;s=ValvePosition as UInt16, it saw 5 as Double [OUA-001]" in words(
        judged(write(5, variant_type="Double"))
    )
    assert "it saw 6 as UInt16" in words(judged(write(6, variant_type="UInt16")))
    assert "it saw none" in words(judged(write(5, node="ns=2;s=X", variant_type="UInt16")))


def test_a_status_that_is_written_is_a_fault_and_a_timestamp_a_warning() -> None:
    assert oracle.written_with([write()]) == []
    (status,) = oracle.written_with([write(has_status=True)])
    (timestamp,) = oracle.written_with([write(has_timestamp=True)])
    assert (status.code, status.is_must) == ("status_written", True)
    assert (timestamp.code, timestamp.is_must) == ("timestamp_written", False)


def test_a_continuation_point_must_not_be_left_open() -> None:
    pages = [answer("Browse", open_points=1), answer("BrowseNext", open_points=1), answer("BrowseNext")]
    assert oracle.points_left(pages) == []
    assert oracle.points_left([read(VALVE)]) == []
    assert "1 were left open [OUA-006]" in words(oracle.points_left(pages[:2]))


def test_the_arguments_of_a_method_have_the_types_that_it_declares() -> None:
    call = asked("Call", methods=[{"types": ["Int32", "String"]}])
    assert oracle.called_with([call], ["Int32", "String"]) == []
    assert "Double, String, it got Int32, String [OUA-008]" in words(oracle.called_with([call], ["Double", "String"]))


def test_every_node_is_listed_once_or_the_list_is_said_to_be_a_part() -> None:
    wanted = {"ns=2;s=A", "ns=2;s=B"}
    assert oracle.listed_once(["ns=2;s=B", "ns=2;s=A", "i=85"], wanted, part=False) == []
    assert oracle.listed_once(["ns=2;s=A"], wanted, part=True) == []
    assert "1 are missing, for instance ns=2;s=B" in words(oracle.listed_once(["ns=2;s=A"], wanted, part=False))
    assert "1 are listed again" in words(oracle.listed_once(["ns=2;s=A"] * 2, wanted, part=True))
    assert "2 are missing" in words(oracle.listed_once(None, wanted, part=False))
