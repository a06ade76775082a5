"""The OPC UA witness: messages written by the library as independent peer, bytes by hand."""

from __future__ import annotations

import random
import struct
import uuid
from datetime import UTC, datetime
from typing import Any

import pytest
from asyncua import ua as untyped_ua
from asyncua.ua.ua_binary import struct_to_binary, to_binary

from pytest_otmcp.protocols.conversation import Direction
from pytest_otmcp.protocols.opcua.binary import BinaryReader, symbol
from pytest_otmcp.protocols.opcua.decoder import OpcUaConversation
from pytest_otmcp.wire.framing import Framer, MalformedError
from pytest_otmcp.wire.opcua import chunk_length

from .journals import Entry, decoded, entry

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


def decode(*messages: tuple[Direction, bytes]) -> list[Entry]:
    return decoded(OpcUaConversation(), *messages)


def read_request(*nodes: ua.NodeId) -> ua.ReadRequest:
    request = ua.ReadRequest()
    request.RequestHeader.RequestHandle = 77
    request.Parameters.NodesToRead = [ua.ReadValueId(node, ua.AttributeIds.Value) for node in nodes]
    return request


# -- messages ---------------------------------------------------------------------------------------------


def test_a_node_that_is_named_by_its_namespace_uri_is_read_as_servers_read_it() -> None:
    """The library writes an ExpandedNodeId, which OPC 10000-6 does not have there, and its server answers."""
    request = message(read_request(ua.NodeId.from_string("nsu=urn:plant;s=Temperature"), TEMPERATURE))
    (asked,) = decode(("in", request))
    assert [node["node_id"] for node in asked["nodes"]] == ["nsu=urn:plant;s=Temperature", "ns=2;s=Temperature"]


def test_a_read_and_its_answer_are_described() -> None:
    answer = ua.ReadResponse()
    bad = ua.StatusCode(ua.StatusCodes.BadNodeIdUnknown)
    answer.Results = [ua.DataValue(ua.Variant(21.5, ua.VariantType.Double)), ua.DataValue(StatusCode=bad)]
    sent = message(read_request(TEMPERATURE, ua.NodeId(99999, 2)), request=5)
    asked, answered = decode(
        ("in", sent),
        ("out", message(answer, request=5)),
    )
    assert asked == {
        **entry("Read", request=True, t_ns=asked["t_ns"], request_id=5, request_handle=77),
        "nodes": [
            {"node_id": "ns=2;s=Temperature", "attribute": "Value"},
            {"node_id": "ns=2;i=99999", "attribute": "Value"},
        ],
        "frame": sent.hex(),
    }
    assert (answered["kind"], answered["direction"], answered["service_result"]) == ("Read", "out", "Good")
    assert (answered["request"], answered["state_changing"], answered["answers"]) == (False, False, asked["seq"])
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
    assert answered["results"] == [{"status": "Good"}, {"status": "BadTypeMismatch"}]


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
    assert (entries[1]["counts"], entries[1]["results"]) == ([2], [{"status": "Good"}])
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
            (found,) = decode(("in", message(request)))
            named[name.removesuffix("Request")] = found["kind"]
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
    assert [one["kind"] for one in entries] == ["Hello", "Acknowledge", "OpenSecureChannel", "Error"]
    assert entries[0]["endpoint_url"] == url.decode()
    assert (entries[3]["status"], entries[3]["reason"]) == ("BadTcpInternalError", "bad")


def test_a_message_in_several_chunks_is_one_entry_and_an_aborted_one_is_none() -> None:
    body = struct_to_binary(read_request(*[TEMPERATURE] * 50))
    pieces = [body[at : at + 100] for at in range(0, len(body), 100)]
    chunks = [chunk("MSG", piece, final="C") for piece in pieces[:-1]] + [chunk("MSG", pieces[-1])]
    (found,) = decode(*(("in", piece) for piece in chunks))
    assert len(found["nodes"]) == 50
    aborted = [chunk("MSG", pieces[0], final="C"), chunk("MSG", b"", final="A"), message(read_request(TEMPERATURE))]
    assert [one["kind"] for one in decode(*(("in", piece) for piece in aborted))] == ["Abort", "Read"]


def test_a_signed_channel_is_said_to_be_sealed() -> None:
    policy = b"http://opcfoundation.org/UA/SecurityPolicy#Basic256Sha256"
    body = struct.pack("<Ii", 1, len(policy)) + policy + bytes(64)
    opened = b"OPNF" + struct.pack("<I", 8 + len(body)) + body
    entries = decode(("in", opened), ("in", message(read_request(TEMPERATURE))))
    assert [one["kind"] for one in entries] == ["Sealed", "Sealed"]
    # The request of a sealed message cannot be known, so the message counts as a request that changes state.
    assert [(one["request"], one["state_changing"]) for one in entries] == [(False, False), (True, True)]


@pytest.mark.parametrize(
    ("variant", "expected"),
    [
        (ua.Variant(-5, ua.VariantType.SByte), ("SByte", -5)),
        (ua.Variant(2**64 - 1, ua.VariantType.UInt64), ("UInt64", 2**64 - 1)),
        (ua.Variant(float("nan"), ua.VariantType.Float), ("Float", "NaN")),
        (ua.Variant([1, -2, 3], ua.VariantType.Int16), ("Int16", [1, -2, 3])),
        (ua.Variant([[1, 2], [3, 4]], ua.VariantType.Int32), ("Int32", [[1, 2], [3, 4]])),
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
    directions: tuple[Direction, Direction] = ("in", "out")
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
        for direction in directions:
            entries = decode((direction, chunk("MSG", bytes(mutated))))
            assert len(entries) == 1


def test_a_lie_about_a_length_costs_no_memory() -> None:
    with pytest.raises(MalformedError, match="an array of 2147483647 elements does not fit the message"):
        BinaryReader(struct.pack("<i", 2**31 - 1)).array(lambda: 1)
    nested = bytes([24]) * 1000
    with pytest.raises(MalformedError, match="nested too deeply"):
        BinaryReader(nested).variant()


def test_of_a_request_that_may_hold_a_password_the_header_is_kept() -> None:
    token = ua.UserNameIdentityToken(Password=b"secret")
    request = ua.ActivateSessionRequest()
    request.Parameters.UserIdentityToken = token
    asked, answered = decode(("in", message(request)), ("out", message(ua.ActivateSessionResponse())))
    assert (asked["kind"], answered["kind"]) == ("ActivateSession", "ActivateSession")
    assert b"secret".hex() not in repr([asked, answered])
    assert "frame" in {*asked} & {*answered}
