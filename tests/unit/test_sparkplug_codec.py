"""The Sparkplug witness: payloads written byte by byte from the field table, and the rules of an edge node."""

from __future__ import annotations

import base64
import struct
from typing import Any

import pytest

from pytest_otmcp.protocols.mqtt import oracle as oracle
from pytest_otmcp.wire.mqtt.sparkplug import DATA_TYPES, decode_message, decode_payload, parse_topic

from ..feeding import fed
from .journals import Entry, entry, numbered

# -- protobuf by hand: https://protobuf.dev/programming-guides/encoding/ ------------------------------------


def varint(value: int) -> bytes:
    encoded = bytearray()
    while value > 127:
        encoded.append(value & 127 | 128)
        value >>= 7
    return bytes([*encoded, value])


def number(field: int, value: int) -> bytes:
    return varint(field << 3) + varint(value)


def block(field: int, data: bytes) -> bytes:
    return varint(field << 3 | 2) + varint(len(data)) + data


def single(field: int, value: float) -> bytes:
    return varint(field << 3 | 5) + struct.pack("<f", value)


def double(field: int, value: float) -> bytes:
    return varint(field << 3 | 1) + struct.pack("<d", value)


def metric(name: str | None, value: bytes, *, datatype: str | None = None, alias: int | None = None) -> bytes:
    data = b"" if name is None else block(1, name.encode())
    data += b"" if alias is None else number(2, alias)
    data += b"" if datatype is None else number(4, DATA_TYPES.index(datatype))
    return block(2, data + value)


def payload(*metrics: bytes, seq: int | None = None, timestamp: int | None = 1) -> bytes:
    data = b"" if timestamp is None else number(1, timestamp)
    return data + b"".join(metrics) + (b"" if seq is None else number(3, seq))


# -- decoding ---------------------------------------------------------------------------------------------


def test_bytes_written_from_the_specification_are_read() -> None:
    data = bytes.fromhex(
        "08 80 80 ba bb c8 2e"  # 1: timestamp 1600000000000
        "12 13"  # 2: metric of 19 bytes
        "0a 04 74 65 6d 70"  # 1: name "temp"
        "10 05"  # 2: alias
        "20 0a"  # 4: datatype Double
        "69 00 00 00 00 00 00 34 40"  # 13: double_value 20.0
        "18 07"  # 3: seq
    )
    assert decode_payload(data) == {
        "seq": 7,
        "timestamp": 1600000000000,
        "metrics": [{"name": "temp", "alias": 5, "datatype": 10, "value": 20.0, "is_null": False}],
    }


@pytest.mark.parametrize(
    ("datatype", "value", "expected"),
    [
        ("Int8", number(10, 0xFB), -5),
        ("Int8", number(10, 0xFFFFFFFB), -5),
        ("Int16", number(10, 0x8000), -32768),
        ("Int32", number(10, 0xFFFFFFFB), -5),
        ("Int32", number(10, 0x7FFFFFFF), 2147483647),
        ("Int64", number(11, 0xFFFFFFFFFFFFFFFB), -5),
        ("UInt8", number(10, 255), 255),
        ("UInt32", number(10, 0xFFFFFFFF), 4294967295),
        ("UInt32", number(11, 0xFFFFFFFF), 4294967295),
        ("UInt64", number(11, 2**63), 2**63),
        ("Float", single(12, 1.5), 1.5),
        ("Double", double(13, 20.1), 20.1),
        ("Double", double(13, float("nan")), "NaN"),
        ("Float", single(12, float("-inf")), "-Infinity"),
        ("Boolean", number(14, 1), True),
        ("Boolean", number(14, 0), False),
        ("String", block(15, "grün".encode()), "grün"),
        ("DateTime", number(11, 1600000000000), 1600000000000),
        ("Bytes", block(16, b"\x00\xff"), "AP8="),
        ("Int8Array", block(16, b"\xef\x7b"), [-17, 123]),
        ("Int32Array", block(16, bytes.fromhex("ffffffff 83000000")), [-1, 131]),
        ("BooleanArray", block(16, bytes.fromhex("0C000000 34D0")), [bool(int(bit)) for bit in "001101001101"]),
        ("StringArray", block(16, b"ABC\0hello\0"), ["ABC", "hello"]),
        ("FloatArray", block(16, struct.pack("<2f", 1.25, -8.5)), [1.25, -8.5]),
        ("Int32", number(7, 1), None),
        (None, number(10, 0xFFFFFFFB), 0xFFFFFFFB),
    ],
)
def test_every_data_type_is_read_from_its_field(datatype: str | None, value: bytes, expected: Any) -> None:
    (read,) = decode_payload(payload(metric("m", value, datatype=datatype)))["metrics"]
    assert read["value"] == expected
    assert type(read["value"]) is type(expected)
    assert read["is_null"] is (expected is None)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"\xff\xff", "the payload is not the protobuf message of Sparkplug B"),
        (payload(metric("m", number(10, 1), datatype="Double")), "metric m: Double must not be carried by the field int_value"),
        (payload(metric("m", number(10, 256), datatype="UInt8")), "metric m: 256 does not fit UInt8"),
        (payload(metric("m", number(10, 40000), datatype="Int8")), "metric m: 40000 does not fit Int8"),
        (payload(metric("m", block(16, b"abc"), datatype="Int16Array")), "metric m: 3 bytes are no array of Int16"),
        (payload(metric("m", block(16, bytes(7)), datatype="BooleanArray")), "metric m: the array's length does not match"),
        (payload(metric("m", block(16, b"ab"), datatype="StringArray")), "metric m: the last string of the array"),
    ],
)  # fmt: skip
def test_a_payload_that_must_not_be_says_why(data: bytes, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        decode_payload(data)


def test_invented_field_numbers_do_not_pass_for_values() -> None:
    # The paper's own adapter puts the timestamp into alias (2) and an integer into is_historical (5).
    invented = block(2, block(1, b"temperature") + number(2, 1600000000000) + number(5, 21))
    (read,) = decode_payload(invented)["metrics"]
    assert (read["value"], read["is_null"]) == (None, False)


def test_a_data_set_is_read_as_columns_and_rows() -> None:
    row = block(1, number(1, 7)) + block(1, block(6, b"on"))
    data_set = number(1, 2) + block(2, b"id") + block(2, b"state") + number(3, 7) + number(3, 12) + block(4, row)
    (read,) = decode_payload(payload(metric("m", block(17, data_set), datatype="DataSet")))["metrics"]
    assert read["value"] == {"columns": ["id", "state"], "rows": [[7, "on"]]}


@pytest.mark.parametrize(
    "topic",
    ["spBv1.0/g/NBIRTH", "spBv1.0/g/NBIRTH/e/d", "spBv1.0/g/DDATA/e", "spBv1.0//NBIRTH/e", "spAv1.0/g/NBIRTH/e",
     "spBv1.0/STATE/host", "spBv1.0/g/XBIRTH/e", "sensors/t"],
)  # fmt: skip
def test_a_topic_that_is_no_sparkplug_topic_has_no_parts(topic: str) -> None:
    assert parse_topic(topic) is None
    assert decode_message(topic, b"") is None


def test_a_message_carries_the_parts_of_its_topic() -> None:
    message = decode_message("spBv1.0/factory/DDATA/edge/pump", payload(seq=3))
    assert message == {
        **{"group": "factory", "type": "DDATA", "edge_node": "edge", "device": "pump"},
        **{"seq": 3, "timestamp": 1, "metrics": []},
    }
    assert decode_message("spBv1.0/g/NDATA/e", b"\xff") == {
        "error": "the payload is not the protobuf message of Sparkplug B"
    }


# -- an edge node's session -------------------------------------------------------------------------------

BD_SEQ = metric("bdSeq", number(11, 4), datatype="Int64")
REBIRTH = metric("Node Control/Rebirth", number(14, 0), datatype="Boolean")
TEMPERATURE = metric("temperature", double(13, 20.0), datatype="Double", alias=1)


def connect(connection: int = 1, *, bd_seq: int = 4, will: Any = ..., clean: bool = True) -> Entry:
    death = payload(metric("bdSeq", number(11, bd_seq), datatype="Int64"), timestamp=None)
    default = {"topic": "spBv1.0/g/NDEATH/e", "qos": 1, "retain": False, "payload": base64.b64encode(death).decode()}
    session = {"connection": connection, "clean_start": clean, "client_id": "adapter"}
    return entry("CONNECT", **session, will=default if will is ... else will)


def says(kind: str, data: bytes, *, device: str = "d", connection: int = 1, **fields: Any) -> Entry:
    topic = f"spBv1.0/g/{kind}/e" + (f"/{device}" if kind.startswith("D") else "")
    message = {"client_id": "adapter", "qos": 0, "retain": False, "topic": topic, "connection": connection}
    return {**entry("PUBLISH"), **message, "payload": base64.b64encode(data).decode(), **fields}


def nbirth(seq: int = 0, *metrics: bytes, **fields: Any) -> Entry:
    return says("NBIRTH", payload(*(metrics or (BD_SEQ, REBIRTH)), seq=seq), **fields)


def dbirth(seq: int = 1, **fields: Any) -> Entry:
    return says("DBIRTH", payload(TEMPERATURE, seq=seq), **fields)


def ddata(seq: int = 2, value: float = 21.0, **fields: Any) -> Entry:
    return says("DDATA", payload(metric("temperature", double(13, value)), seq=seq), **fields)


def broken(*entries: Entry) -> list[tuple[str | None, str]]:
    return [
        (finding.requirement, finding.message)
        for finding in fed(oracle.SparkplugSequence(), numbered(*entries)).findings
    ]


def test_a_proper_session_has_no_findings() -> None:
    assert broken() == []
    assert broken(connect(), nbirth(), dbirth(), ddata(), ddata(3)) == []


def test_the_sequence_wraps_after_255_and_is_shared_by_all_devices() -> None:
    entries = [connect(), nbirth(254), dbirth(255), dbirth(0, device="other")]
    entries += [ddata(seq % 256, device=("d", "other")[seq % 2]) for seq in range(1, 600)]
    assert broken(*entries) == []


def test_a_rebirth_starts_anew_and_keeps_the_number_of_the_connection() -> None:
    assert broken(connect(), nbirth(), dbirth(), ddata(), nbirth(), dbirth(), ddata()) == []
    assert broken(connect(), nbirth(), dbirth(), nbirth(), ddata(1)) == [
        ("SPB-003", "spBv1.0/g/DDATA/e/d: DDATA of 'd' before its DBIRTH")
    ]


def test_connections_count_their_deaths() -> None:
    second = nbirth(0, metric("bdSeq", number(11, 5), datatype="Int64"), REBIRTH, connection=2)
    assert broken(connect(), nbirth(), connect(2, bd_seq=5), second) == []
    assert broken(connect(), nbirth(), connect(2, bd_seq=4), nbirth(connection=2)) == [
        ("SPB-006", "spBv1.0/g/NDEATH/e: bdSeq of the will must be 5 after 4, it is 4")
    ]
    assert broken(connect(bd_seq=255), connect(2, bd_seq=0)) == []


def test_a_connect_that_the_broker_may_never_have_read_counts_or_not() -> None:
    later = connect(3, bd_seq=6)
    lost = {"kind": "lost", "direction": "in", "origin": "client", "connection": 2}
    made, ended = ({**lost, "kind": kind} for kind in ("CONNECTED", "DISCONNECTED"))
    assert len(broken(connect(), later)) == 1
    assert broken(connect(), made, lost, later) == []
    # A reset discards what was not read.
    assert broken(connect(), made, ended, later) == []
    assert broken(connect(), made, later) == []
    assert broken(connect(), made, ended, connect(3, bd_seq=5)) == []
    assert broken(connect(), made, ended, connect(3, bd_seq=4)) != []
    assert len(broken(connect(), made, connect(2, bd_seq=5), connect(3, bd_seq=7))) == 1


WRONG_SESSIONS: list[tuple[list[Entry], str, str]] = [
    ([connect(), dbirth(), ddata()], "SPB-003", "DBIRTH before NBIRTH"),
    ([connect(), nbirth(), ddata(1)], "SPB-003", "DDATA of 'd' before its DBIRTH"),
    ([connect(), nbirth(), dbirth(), ddata(4)], "SPB-004", "DDATA must have seq 2, it has 4"),
    ([connect(), nbirth(), dbirth(), ddata(2), ddata(2)], "SPB-004", "DDATA must have seq 3, it has 2"),
    ([connect(), nbirth(300)], "SPB-004", "NBIRTH must have a seq from 0 to 255, it has 300"),
    ([connect(), nbirth(qos=1)], "SPB-002", "NBIRTH must have QoS 0 and not be retained"),
    ([connect(), nbirth(), dbirth(retain=True)], "SPB-002", "DBIRTH must have QoS 0 and not be retained"),
    ([connect(will=None), nbirth()], "SPB-006", "CONNECT must carry the NDEATH as its will, it carries none"),
    ([connect(bd_seq=7), nbirth()], "SPB-006", "bdSeq of NBIRTH must be the will's 7, it is 4"),
    ([connect(clean=False), nbirth()], "SPB-006", "the connection must begin with a clean session"),
    ([connect(), nbirth(0, REBIRTH)], "SPB-006", "NBIRTH must hold the metric bdSeq"),
    ([connect(), nbirth(0, BD_SEQ)], "SPB-006", "NBIRTH must declare Node Control/Rebirth as Boolean false"),
    ([connect(), nbirth(), says("DBIRTH", b"\xff")], "SPB-001", "the payload does not decode: the payload is not the"),
    (
        [connect(), nbirth(), says("DBIRTH", payload(metric("t", double(13, 1.0)), seq=1))],
        "SPB-001",
        "DBIRTH: t must have a name and a data type",
    ),
    (
        [connect(), nbirth(), says("DBIRTH", payload(metric("t", b"", datatype="Double"), seq=1))],
        "SPB-001",
        "DBIRTH: t has neither a value nor is_null",
    ),
    ([connect(), nbirth(), says("DBIRTH", payload(TEMPERATURE, seq=1, timestamp=None))], "SPB-001", "DBIRTH must carry a timestamp"),
    (
        [connect(), nbirth(), dbirth(), says("DDATA", payload(metric("Temperature", double(13, 1.0)), seq=2))],
        "SPB-009",
        "DDATA with the undeclared metric 'Temperature'",
    ),
    (
        [connect(), nbirth(), dbirth(), says("DDATA", payload(metric("temperature", single(12, 1), datatype="Float"), seq=2))],
        "SPB-009",
        "DDATA: 'temperature' was born as Double and is sent as Float",
    ),
    ([connect(), nbirth(), dbirth(), says("DDEATH", payload(seq=2)), ddata(3)], "SPB-003", "DDATA of 'd' before its DBIRTH"),
    ([connect(), says("DCMD", payload(seq=0))], "SPB-010", "DCMD must carry no seq, it carries 0"),
]  # fmt: skip


@pytest.mark.parametrize(("entries", "requirement", "words"), WRONG_SESSIONS)
def test_a_session_that_breaks_a_rule_is_found_in_its_words(entries: list[Entry], requirement: str, words: str) -> None:
    ((found, message),) = broken(*entries)
    assert found == requirement
    assert words in message


def test_a_will_that_says_more_than_the_death_is_found() -> None:
    more = {**connect()["will"], "payload": base64.b64encode(payload(BD_SEQ, TEMPERATURE, seq=0)).decode()}
    assert broken(connect(will=more), nbirth()) == [
        ("SPB-006", "spBv1.0/g/NBIRTH/e: the will must hold bdSeq alone and no seq, it holds ['bdSeq', 'temperature']")
    ]
    elsewhere = {**connect()["will"], "topic": "spBv1.0/g/NDEATH/other", "qos": 0}
    ((_, message),) = broken(connect(will=elsewhere), nbirth())
    assert "the will must go to spBv1.0/g/NDEATH/e with QoS 1" in message


def test_the_simulator_and_the_will_that_a_broker_sends_are_not_the_adapters_doing() -> None:
    simulator = {"client_id": "otmcp-mock-edge-node-1", "connection": 7, "origin": "plant"}
    assert broken(connect(), nbirth(), dbirth(), {**ddata(9), **simulator}) == []
    assert broken(connect(), nbirth(), says("NDEATH", payload(BD_SEQ), qos=1, will_sent=True)) == []


def test_who_publishes_as_a_node_it_is_not_is_found() -> None:
    impersonated = ddata(3)
    impersonated["topic"] = "spBv1.0/factory/DDATA/edge-node-1/device-1"
    messages = [message for _, message in broken(connect(will=None), impersonated)]
    assert any("DDATA before NBIRTH" in message for message in messages)


def test_only_the_chosen_edge_node_is_judged() -> None:
    entries = numbered(connect(), ddata())
    assert fed(oracle.SparkplugSequence("g", "e"), entries).findings != []
    assert fed(oracle.SparkplugSequence("g", "another"), entries).findings == []


# -- one value --------------------------------------------------------------------------------------------


def wrong(*entries: Entry, **arguments: Any) -> str:
    findings = oracle.ddata_metric(list(entries), **{"device": "d", "name": "temperature", "value": 20.1, **arguments})
    return findings[0].message if findings else ""


def test_a_value_is_right_as_double_and_as_the_nearest_float() -> None:
    assert wrong(ddata(value=20.1)) == ""
    assert wrong(says("DDATA", payload(metric("temperature", single(12, 20.1), datatype="Float"), seq=2))) == ""
    as_double = says("DDATA", payload(metric("temperature", double(13, 20.100000381469727), datatype="Double"), seq=2))
    assert "its value is 20.100000381469727" in wrong(as_double)


def test_an_alias_is_resolved_from_the_birth_before_it_however_long_ago_that_was() -> None:
    aliased = says("DDATA", payload(metric(None, double(13, 20.1), alias=1), seq=2))
    other = says("DBIRTH", payload(metric("pressure", double(13, 1.0), datatype="Double", alias=1), seq=3))
    birth, data, later = numbered(dbirth(), aliased, other)
    assert wrong(data, births=fed(oracle.Births(), [birth, data, later])) == ""
    assert wrong(birth, data) == wrong(birth, data, later) == ""
    assert "its metric is None" in wrong(data)
    assert "its metric is None" in wrong(data, births=fed(oracle.Births(), [data, later]))
    first, second, last = numbered(dbirth(), other, aliased)
    assert "its metric is 'pressure'" in wrong(last, births=fed(oracle.Births(), [first, second, last]))


def test_metrics_by_alias_are_those_that_were_asked_for() -> None:
    aliased = says("DDATA", payload(metric(None, double(13, 20.1), alias=1), seq=2))
    birth, data = numbered(dbirth(), aliased)
    asked = {"kind": "DDATA", "device": "d", "metrics": [{"name": "temperature", "datatype": "Double", "value": 20.1}]}
    assert oracle.reported([data], births=fed(oracle.Births(), [birth, data]), **asked) == []
    (finding,) = oracle.reported([data], births=oracle.Births(), **asked)
    assert "it has no temperature" in finding.message


def test_births_before_a_restart_of_the_broker_are_forgotten() -> None:
    assert fed(oracle.Births(), [dbirth()]).restarted().declared("d", 99) == {}


@pytest.mark.parametrize(
    ("entries", "problem"),
    [
        ([], "it received 0 with no metric"),
        ([ddata(device="another", value=20.1)], "it received 0 with no metric"),
        ([ddata(value=20.1), ddata(value=20.1)], "it received 2 with temperature=20.1, temperature=20.1"),
        ([ddata(value=20.2)], "its value is 20.2"),
        ([says("DDATA", payload(metric("Temperature", double(13, 20.1))))], "its metric is 'Temperature'"),
        ([says("DDATA", payload(metric("temperature", block(15, b"20.1"), datatype="String")))], "its datatype is String"),
        ([says("DDATA", payload(metric("temperature", number(7, 1))))], "its metric is null"),
        ([says("DDATA", payload(metric("temperature", number(5, 20))))], "its metric has no value"),
        ([says("DDATA", b"\xff")], "a payload does not decode"),
    ],
)  # fmt: skip
def test_a_value_that_did_not_arrive_as_asked_is_found(entries: list[Entry], problem: str) -> None:
    message = wrong(*entries)
    assert "the broker should have received one DDATA of d with temperature = 20.1, " in message
    assert problem in message


SETPOINT = {"name": "setpoint", "datatype": "Double", "value": 42}
SPEED = {"name": "speed", "datatype": "Int32", "value": -10}


def command(*metrics: bytes, topic: str = "spBv1.0/g/DCMD/n/d", seq: int | None = None, **fields: Any) -> Entry:
    data = base64.b64encode(payload(*metrics, seq=seq)).decode()
    return entry("PUBLISH", topic=topic, qos=0, retain=False, payload=data, request=True, state_changing=True) | fields


def commanded(*entries: Entry, device: str | None = "d", metrics: Any = (SETPOINT,)) -> str:
    found = oracle.commanded_once(
        numbered(*entries), group="g", node="n", device=device, metrics=metrics, aliases={7: "setpoint"}
    )
    return "" if not found else f"{found[0].message} [{found[0].requirement}]"


DOUBLE = metric("setpoint", double(13, 42.0), datatype="Double")


def test_a_command_is_the_one_that_was_asked_for() -> None:
    assert commanded(command(DOUBLE)) == ""
    assert commanded(command(DOUBLE, topic="spBv1.0/g/NCMD/n"), device=None) == ""
    assert commanded(command(DOUBLE), ddata()) == ""


def test_a_command_may_leave_out_types_and_names_and_choose_the_order() -> None:
    untyped = metric("setpoint", double(13, 42.0))
    slow = metric("speed", number(10, 2**32 - 10))
    assert commanded(command(untyped)) == commanded(command(metric(None, double(13, 42.0), alias=7))) == ""
    assert commanded(command(slow, untyped), metrics=(SETPOINT, SPEED)) == ""
    assert commanded(command(metric("speed", number(10, 2**32 - 10), datatype="Int32")), metrics=(SPEED,)) == ""


@pytest.mark.parametrize(
    ("entries", "problem"),
    [
        ([], "it received 0 [SPB-010]"),
        ([command(DOUBLE), command(DOUBLE)], "it received 2 [WR-003]"),
        ([command(DOUBLE, topic="spBv1.0/g/DCMD/n/e")], "it came on spBv1.0/g/DCMD/n/e [SPB-010]"),
        ([command(DOUBLE, topic="spBv1.0/g/NCMD/n")], "it came on spBv1.0/g/NCMD/n"),
        ([command(DOUBLE, seq=3)], "it has the sequence number 3"),
        ([command(DOUBLE, qos=1)], "it came with QoS 1"),
        ([command(DOUBLE, retain=True)], "and retained"),
        ([command()], "its metrics are []"),
        ([command(metric(None, double(13, 42.0), alias=8))], "its metrics are [None]"),
        ([command(metric("setpoint", double(13, 43.0)))], "setpoint is 43.0"),
        ([command(metric("setpoint", single(12, 42.0), datatype="Float"))], "setpoint has the datatype Float"),
        ([command(block(2, b"\xff"))], "a payload does not decode"),
    ],
)
def test_a_command_that_is_another_is_found(entries: list[Entry], problem: str) -> None:
    assert problem in commanded(*entries)
