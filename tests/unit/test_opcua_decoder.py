"""The OPC UA witness: messages written by the library as independent peer, bytes by hand, and the oracle."""

from __future__ import annotations

import random
import struct
import uuid
from datetime import UTC, datetime
from typing import Any

import pytest
from asyncua import ua as untyped_ua
from asyncua.ua.ua_binary import struct_to_binary, to_binary

from pytest_otmcp.protocols.framing import Framer, MalformedError
from pytest_otmcp.protocols.opcua import oracle as oracle
from pytest_otmcp.protocols.opcua.binary import BinaryReader, symbol
from pytest_otmcp.protocols.opcua.decoder import OpcUaConversation, chunk_length

Entry = dict[str, Any]
ua: Any = untyped_ua
TEMPERATURE = ua.NodeId("Temperature", 2)


def chunk(kind: str, body: bytes, *, request: int = 1, final: str = "F") -> bytes:
    head = struct.pack("<II", 1, 1) if kind != "OPN" else struct.pack("<I", 1) + OPN_HEADER
    content = head + struct.pack("<II", 1, request) + body
    return f"{kind}{final}".encode() + struct.pack("<I", 8 + len(content)) + content


OPN_HEADER = b"".join(
    struct.pack("<i", len(text)) + text for text in (b"http://opcfoundation.org/UA/SecurityPolicy#None",)
) + struct.pack("<ii", -1, -1)


def message(value: Any, *, request: int = 1) -> bytes:
    return chunk("MSG", struct_to_binary(value), request=request)


def decode(*messages: tuple[str, bytes], conversation: OpcUaConversation | None = None) -> list[Entry]:
    conversation = conversation or OpcUaConversation()
    return [entry for direction, data in messages for entry in conversation.decode(direction, data)]


def read_request(*nodes: ua.NodeId) -> ua.ReadRequest:
    request = ua.ReadRequest()
    request.RequestHeader.RequestHandle = 77
    request.Parameters.NodesToRead = [ua.ReadValueId(node, ua.AttributeIds.Value) for node in nodes]
    return request


# -- messages ---------------------------------------------------------------------------------------------


def test_a_read_and_its_answer_are_described() -> None:
    answer = ua.ReadResponse()
    bad = ua.StatusCode(ua.StatusCodes.BadNodeIdUnknown)
    answer.Results = [ua.DataValue(ua.Variant(21.5, ua.VariantType.Double)), ua.DataValue(StatusCode=bad)]
    asked, answered = decode(
        ("in", message(read_request(TEMPERATURE, ua.NodeId(99999, 2)), request=5)),
        ("out", message(answer, request=5)),
    )
    assert asked == {
        **{"direction": "in", "kind": "Read", "request_id": 5, "request_handle": 77, "state_changing": False},
        "nodes": [
            {"node_id": "ns=2;s=Temperature", "attribute": "Value"},
            {"node_id": "ns=2;i=99999", "attribute": "Value"},
        ],
    }
    assert (answered["kind"], answered["direction"], answered["service_result"]) == ("Read", "out", "Good")
    assert answered["results"] == [
        {"status": "Good", "value": 21.5},
        {"status": "BadNodeIdUnknown", "value": None},
    ]


def test_a_write_shows_the_type_and_what_else_was_written() -> None:
    request = ua.WriteRequest()
    plain = ua.DataValue(ua.Variant(25.0, ua.VariantType.Double))
    stamped = ua.DataValue(ua.Variant(True), ua.StatusCode(0x40900000), SourceTimestamp=datetime.now(UTC))
    request.Parameters.NodesToWrite = [
        ua.WriteValue(ua.NodeId("ValvePosition", 2), ua.AttributeIds.Value, Value=plain),
        ua.WriteValue(ua.NodeId("PumpEnabled", 2), ua.AttributeIds.Value, Value=stamped),
    ]
    answer = ua.WriteResponse()
    answer.Results = [ua.StatusCode(0), ua.StatusCode(ua.StatusCodes.BadTypeMismatch)]
    asked, answered = decode(("in", message(request)), ("out", message(answer)))
    assert asked["state_changing"]
    first, second = asked["nodes"]
    assert (first["node_id"], first["attribute"]) == ("ns=2;s=ValvePosition", "Value")
    assert (first["value"], first["variant_type"], first["has_status"], first["has_timestamp"]) == (
        25.0,
        "Double",
        False,
        False,
    )
    assert (second["value"], second["variant_type"], second["has_status"], second["has_timestamp"]) == (
        True,
        "Boolean",
        True,
        True,
    )
    assert answered["results"] == ["Good", "BadTypeMismatch"]


def test_browse_and_call_are_described() -> None:
    browse = ua.BrowseRequest()
    browse.Parameters.NodesToBrowse = [ua.BrowseDescription(NodeId=ua.NodeId("Actuators", 2))]
    browsed = ua.BrowseResponse()
    reference = ua.ReferenceDescription()
    reference.NodeId = ua.ExpandedNodeId("ValvePosition", 2)
    reference.BrowseName, reference.DisplayName = ua.QualifiedName("ValvePosition", 2), ua.LocalizedText("Valve")
    browsed.Results = [ua.BrowseResult(References=[reference, reference])]
    call = ua.CallRequest()
    arguments = [ua.Variant(7, ua.VariantType.Int32), ua.Variant("x")]
    call.Parameters.MethodsToCall = [ua.CallMethodRequest(ua.NodeId(1, 2), ua.NodeId(2, 2), arguments)]
    called = ua.CallResponse()
    called.Results = [ua.CallMethodResult(OutputArguments=[ua.Variant(8, ua.VariantType.Int32)])]
    entries = decode(
        *(("in", message(browse)), ("out", message(browsed)), ("in", message(call)), ("out", message(called)))
    )
    assert entries[0]["nodes"] == ["ns=2;s=Actuators"]
    assert (entries[1]["counts"], entries[1]["results"]) == ([2], ["Good"])
    assert entries[2]["methods"] == [
        {"object_id": "ns=2;i=1", "method_id": "ns=2;i=2", "arguments": [7, "x"], "types": ["Int32", "String"]}
    ]
    assert entries[2]["state_changing"]
    assert entries[3]["results"] == [{"status": "Good", "outputs": [8]}]


def test_a_service_fault_is_the_answer_of_the_service_that_was_asked_for() -> None:
    fault = ua.ServiceFault()
    fault.ResponseHeader.ServiceResult = ua.StatusCode(ua.StatusCodes.BadSessionIdInvalid)
    _, answered = decode(("in", message(read_request(TEMPERATURE), request=9)), ("out", message(fault, request=9)))
    assert (answered["kind"], answered["service_result"]) == ("Read", "BadSessionIdInvalid")


def test_every_service_of_the_library_has_its_name_or_its_type_id() -> None:
    named = {}
    for name in dir(ua):
        if not name.endswith("Request") or not hasattr(getattr(ua, name), "__dataclass_fields__"):
            continue
        request = getattr(ua, name)()
        if "RequestHeader" in getattr(ua, name).__dataclass_fields__:
            (entry,) = decode(("in", message(request)))
            named[name.removesuffix("Request")] = entry["kind"]
    assert named["TranslateBrowsePathsToNodeIds"] == "TranslateBrowsePaths"
    common = {"Read", "Write", "Browse", "BrowseNext", "Call", "CreateSession", "ActivateSession", "CloseSession"}
    common |= {"GetEndpoints", "FindServers", "CreateSubscription", "Publish", "AddNodes", "HistoryUpdate"}
    assert all(named[name] == name for name in common)
    assert all(kind == name or kind.startswith(("i=", "Translate")) for name, kind in named.items())


def test_hello_acknowledge_error_and_an_opened_channel_are_entries() -> None:
    url = b"opc.tcp://127.0.0.1:4840"
    hello = struct.pack("<5Ii", 0, 65535, 65535, 0, 0, len(url)) + url
    error = struct.pack("<Ii", 0x80820000, 3) + b"bad"
    entries = decode(
        ("in", b"HELF" + struct.pack("<I", 8 + len(hello)) + hello),
        ("out", b"ACKF" + struct.pack("<I", 28) + bytes(20)),
        ("in", chunk("OPN", struct_to_binary(ua.OpenSecureChannelRequest()))),
        ("out", b"ERRF" + struct.pack("<I", 8 + len(error)) + error),
    )
    assert [entry["kind"] for entry in entries] == ["Hello", "Acknowledge", "OpenSecureChannel", "Error"]
    assert entries[0]["endpoint_url"] == url.decode()
    assert (entries[3]["status"], entries[3]["reason"]) == ("0x80820000", "bad")


def test_a_message_in_several_chunks_is_one_entry_and_an_aborted_one_is_none() -> None:
    body = struct_to_binary(read_request(*[TEMPERATURE] * 50))
    pieces = [body[at : at + 100] for at in range(0, len(body), 100)]
    chunks = [chunk("MSG", piece, final="C") for piece in pieces[:-1]] + [chunk("MSG", pieces[-1])]
    (entry,) = decode(*(("in", piece) for piece in chunks))
    assert len(entry["nodes"]) == 50
    aborted = [chunk("MSG", pieces[0], final="C"), chunk("MSG", b"", final="A"), message(read_request(TEMPERATURE))]
    assert [entry["kind"] for entry in decode(*(("in", piece) for piece in aborted))] == ["Abort", "Read"]


def test_a_signed_channel_is_said_to_be_sealed() -> None:
    policy = b"http://opcfoundation.org/UA/SecurityPolicy#Basic256Sha256"
    body = struct.pack("<Ii", 1, len(policy)) + policy + bytes(64)
    opened = b"OPNF" + struct.pack("<I", 8 + len(body)) + body
    entries = decode(("in", opened), ("in", message(read_request(TEMPERATURE))))
    assert [entry["kind"] for entry in entries] == ["Sealed", "Sealed"]


@pytest.mark.parametrize(
    ("variant", "expected"),
    [
        (ua.Variant(-5, ua.VariantType.SByte), ("SByte", -5)),
        (ua.Variant(2**64 - 1, ua.VariantType.UInt64), ("UInt64", 2**64 - 1)),
        (ua.Variant(float("nan"), ua.VariantType.Float), ("Float", "NaN")),
        (ua.Variant([1, -2, 3], ua.VariantType.Int16), ("Int16", [1, -2, 3])),
        (ua.Variant([[1, 2], [3, 4]], ua.VariantType.Int32), ("Int32", [1, 2, 3, 4])),
        (ua.Variant(None), ("Null", None)),
        (ua.Variant("grün"), ("String", "grün")),
        (ua.Variant(b"\x00\xff", ua.VariantType.ByteString), ("ByteString", "AP8=")),
        (ua.Variant(datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)), ("DateTime", "2026-01-02T03:04:05+00:00")),
        (ua.Variant(uuid.UUID(int=5)), ("Guid", str(uuid.UUID(int=5)))),
        (ua.Variant(ua.NodeId(uuid.UUID(int=6), 3)), ("NodeId", f"ns=3;g={uuid.UUID(int=6)}")),
        (ua.Variant(ua.NodeId(b"ab", 3)), ("NodeId", "ns=3;b=YWI=")),
        (ua.Variant(ua.QualifiedName("n", 4)), ("QualifiedName", "4:n")),
        (ua.Variant(ua.LocalizedText("t", "en")), ("LocalizedText", "t")),
        (ua.Variant(ua.StatusCode(0x80340000), ua.VariantType.StatusCode), ("StatusCode", "BadNodeIdUnknown")),
    ],
)
def test_values_of_every_kind_are_read(variant: ua.Variant, expected: tuple[str, Any]) -> None:
    reader = BinaryReader(to_binary(ua.Variant, variant))
    assert reader.variant() == expected
    assert reader.left == 0


def test_a_status_keeps_its_name_whatever_its_lower_bits_say() -> None:
    assert symbol(0) == "Good"
    assert symbol(0x80340000 | 0x0400) == "BadNodeIdUnknown"
    assert symbol(0x80FF0000) == "0x80FF0000"


def test_segments_of_any_size_give_the_same_chunks() -> None:
    rng = random.Random(19)
    chunks = [chunk("MSG", rng.randbytes(rng.choice((0, 1, 100, 9000)))) for _ in range(60)]
    stream = b"".join(chunks)
    for largest in (1, 13, 5000, len(stream)):
        framer, cut, at = Framer(chunk_length), [], 0
        while at < len(stream):
            size = rng.randint(1, largest)
            cut += framer.feed(stream[at : at + size])
            at += size
        assert cut == chunks


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"GET / HTTP/1.1\r\n", "b'GET ' begins no chunk"),
        (b"MSGX" + struct.pack("<I", 20), "b'MSGX' begins no chunk"),
        (b"MSGF" + struct.pack("<I", 7), "the chunk size is 7"),
        (b"MSGF" + struct.pack("<I", 2**31), "the chunk size is 2147483648"),
    ],
)
def test_a_stream_that_cannot_be_cut_says_why(data: bytes, reason: str) -> None:
    framer = Framer(chunk_length)
    assert framer.feed(data) == []
    assert framer.malformed == reason


def test_mutated_messages_never_make_the_decoder_fail() -> None:
    rng = random.Random(23)
    request = ua.WriteRequest()
    request.Parameters.NodesToWrite = [
        ua.WriteValue(TEMPERATURE, ua.AttributeIds.Value, Value=ua.DataValue(ua.Variant([1.5, 2.5])))
    ]
    body = struct_to_binary(request)
    for _ in range(3000):
        mutated = bytearray(body[: rng.randrange(len(body))] if rng.random() < 0.3 else body)
        for _ in range(rng.randrange(4)):
            if mutated:
                mutated[rng.randrange(len(mutated))] = rng.randrange(256)
        for direction in ("in", "out"):
            entries = decode((direction, chunk("MSG", bytes(mutated))))
            assert len(entries) == 1


def test_a_lie_about_a_length_costs_no_memory() -> None:
    with pytest.raises(MalformedError, match="an array of 2147483647 elements does not fit the message"):
        BinaryReader(struct.pack("<i", 2**31 - 1)).array(lambda: 1)
    nested = bytes([24]) * 1000
    with pytest.raises(MalformedError, match="nested too deeply"):
        BinaryReader(nested).variant()


# -- the oracle -------------------------------------------------------------------------------------------

VALVE = "ns=2;s=ValvePosition"
SERVER_STATE = "i=2259"


def asked(kind: str, *nodes: Any, **fields: Any) -> Entry:
    changing = kind in ("Write", "Call")
    return {
        "direction": "in",
        "kind": kind,
        "connection": 1,
        "nodes": list(nodes),
        "state_changing": changing,
        **fields,
    }


def read(*nodes: str) -> Entry:
    return asked("Read", *({"node_id": node, "attribute": "Value"} for node in nodes))


def write(value: Any = 25.0, node: str = VALVE, **fields: Any) -> Entry:
    return asked("Write", {"node_id": node, "attribute": "Value", "value": value, **fields})


def answer(kind: str, *results: Any, **fields: Any) -> Entry:
    return {"direction": "out", "kind": kind, "connection": 1, "results": list(results), **fields}


def words(findings: list[Any]) -> str:
    (finding,) = findings
    return f"{finding.message} [{finding.requirement}] {finding.evidence or ''}"


def test_reading_the_plant_is_not_watching_the_server() -> None:
    journal = [asked("CreateSession"), read(SERVER_STATE), read(VALVE, "ns=2;s=Temperature")]
    assert oracle.read_from_device(journal, VALVE) == []
    assert oracle.read_from_device(journal, None, at_least=2) == []
    assert "should have seen 3 read(s) of a value, there were 2 [RD-004]" in words(
        oracle.read_from_device(journal, None, at_least=3)
    )
    assert "1 read(s) of ns=2;s=X, there were 0" in words(oracle.read_from_device(journal, "ns=2;s=X"))
    assert "Read i=2259" in words(oracle.read_from_device(journal, "ns=2;s=X"))


def test_keeping_a_session_is_no_service_to_the_plant() -> None:
    keeping = [asked("CreateSession"), asked("ActivateSession"), asked("CONNECTED")]
    assert "should have seen a service request [RD-004] no service request" in words(oracle.some_service(keeping))
    assert oracle.some_service([*keeping, read(VALVE)]) == []
    assert oracle.service_count([*keeping, read(VALVE), read(VALVE), asked("Browse", "i=85")]) == {
        "Read": 2,
        "Browse": 1,
    }
    assert oracle.no_service([*keeping, read(VALVE)], "Browse", "Call") == []
    assert "no Browse and no Read, it saw 1" in words(oracle.no_service([read(VALVE)], "Browse", "Read"))


def test_one_service_means_one() -> None:
    assert oracle.exactly_one_service([read(VALVE), read("ns=2;s=Other")], "Read", node=VALVE) == []
    assert "one Read of ns=2;s=ValvePosition, it saw 2" in words(
        oracle.exactly_one_service([read(VALVE)] * 2, "Read", node=VALVE)
    )
    assert oracle.browsed([asked("Browse", "ns=2;i=5")], "ns=2;i=5") == []
    assert "a Browse of ns=2;i=6" in words(oracle.browsed([asked("Browse", "ns=2;i=5")], "ns=2;i=6"))


def test_a_status_is_found_in_items_and_in_faults() -> None:
    items = [answer("Read", {"status": "BadNodeIdUnknown", "value": None})]
    assert oracle.result_status(items, "Read", "BadNodeIdUnknown") == []
    assert oracle.result_status([answer("Write", "BadTypeMismatch")], "Write", "BadTypeMismatch") == []
    assert (
        oracle.result_status([answer("Read", service_result="BadSessionIdInvalid")], "Read", "BadSessionIdInvalid")
        == []
    )
    assert "with BadNotWritable, its answers were ['BadNodeIdUnknown']" in words(
        oracle.result_status(items, "Read", "BadNotWritable")
    )
    assert "its answers were none" in words(oracle.result_status([], "Read", "Good"))


def test_a_write_counts_once_with_its_value_and_nothing_else() -> None:
    assert oracle.exactly_one_write([read(VALVE), write(), answer("Write", {"status": "Good"})], VALVE, 25.0) == []
    assert oracle.exactly_one_write([write(25)], VALVE, 25.0) == []
    for journal, problem in (
        ([write(), write()], "it saw 2 state-changing request(s) [WR-003]"),
        ([read(VALVE)], "it saw 0 state-changing request(s) [WR-001]"),
        ([asked("Call", "ns=2;i=1")], "it saw 1 state-changing request(s)"),
        ([write(26.0)], "it saw [['ns=2;s=ValvePosition', 'Value', 26.0]]"),
        ([write(True)], "it saw [['ns=2;s=ValvePosition', 'Value', True]]"),
        ([write(has_timestamp=True)], "a timestamp was written with it [OUA-005]"),
        ([write(), answer("Write", "BadTypeMismatch")], "the server refused it with BadTypeMismatch"),
    ):
        assert problem in words(oracle.exactly_one_write(journal, VALVE, 25.0))
    assert "it saw" in words(oracle.exactly_one_write([write(1)], VALVE, True))


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
    return {"variables": variables, "folders": {"Actuators": "ns=2;s=Actuators", "Sensors": "ns=2;s=Sensors"}}


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
