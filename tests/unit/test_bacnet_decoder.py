"""The kit's decoder of BACnet/IP on datagrams of the standard's shape, and the oracles on what it makes of them."""

from __future__ import annotations

from typing import Any

import pytest

from pytest_otmcp.protocols.bacnet import oracle
from pytest_otmcp.protocols.bacnet.decoder import BacnetConversation
from pytest_otmcp.protocols.bacnet.entries import changes, describe, title
from pytest_otmcp.protocols.bacnet.trace import facts
from pytest_otmcp.protocols.conversation import Direction

READ = "810a0011 0104 0004 010c 0c00000001 1955"
READ_ACK = "810a0017 0100 30010c 0c00000001 1955 3e 4442910000 3f"
WRITE = "810a001a 0104 0004 020f 0c00400001 1955 3e 4441cc0000 3f 4908"
WRITE_ACK = "810a0009 0100 20020f"


def entry(seq: int, direction: Direction, datagram: str, connection: int = 1, answers: int | None = None) -> Any:
    (message,) = BacnetConversation().decode(direction, bytes.fromhex(datagram))
    contract = {"seq": seq, "t_ns": seq, "connection": connection, "direction": direction, "origin": "client"}
    said = {"kind": message.kind, "request": message.request, "state_changing": message.state_changing}
    return {**contract, **said, "answers": answers, **message.fields}


def test_a_read_and_its_answer_are_one_exchange() -> None:
    conversation = BacnetConversation()
    (asked,) = conversation.decode("in", bytes.fromhex(READ))
    (answer,) = conversation.decode("out", bytes.fromhex(READ_ACK))
    assert (asked.kind, asked.request, asked.state_changing) == ("request", True, False)
    assert asked.fields["reads"] == [{"object": [0, 1], "property": 85}]
    assert answer.answers is asked
    assert answer.fields["results"] == [{"object": [0, 1], "property": 85, "values": [{"type": "real", "value": 72.5}]}]
    assert title(entry(0, "in", READ)) == "request: read property"
    assert describe(entry(0, "in", READ)) == "read property analog-input,1 present-value"


@pytest.mark.parametrize(
    ("datagram", "fields"),
    [
        ("810b000c 0120ffff00ff 1008", {"service": 8}),
        ("810b0012 0120ffff00ff 1008 0a3039 1a3039", {"service": 8, "low": 12345, "high": 12345}),
        (
            WRITE,
            {
                "writes": [
                    {"object": [1, 1], "property": 85, "priority": 8, "values": [{"type": "real", "value": 25.5}]}
                ]
            },
        ),
    ],
)
def test_requests_are_read(datagram: str, fields: dict[str, Any]) -> None:
    found = entry(0, "in", datagram)
    assert {name: found[name] for name in fields} == fields


@pytest.mark.parametrize("datagram", ["", "00", "810a0005 01", "820a0011 0104", "810a0006 0104", "810a0008 01040004"])
def test_what_is_no_message_is_malformed(datagram: str) -> None:
    assert entry(0, "in", datagram)["kind"] == "malformed"


def test_a_request_that_is_sent_again_with_its_invoke_id_is_one_write() -> None:
    first, again = entry(0, "in", WRITE), entry(1, "in", WRITE)
    assert changes([first, again]) == [first]
    assert oracle.exactly_one_write([first, again], ("analog-output", 1), "real", 25.5, priority=8) == []
    other = entry(2, "in", WRITE.replace("0004 020f", "0004 030f"))
    (finding,) = oracle.exactly_one_write([first, other], ("analog-output", 1), "real", 25.5, priority=8)
    assert finding.requirement == "WR-003"
    assert changes([first, entry(1, "in", WRITE, connection=2)]) != [first]


@pytest.mark.parametrize(
    ("target", "kind", "value", "priority", "requirement"),
    [
        (("analog-output", 2), "real", 25.5, 8, "ADR-001"),
        (("analog-output", 1), "unsigned", 25.5, 8, "ENC-001"),
        (("analog-output", 1), "real", 25.0, 8, "WR-001"),
        (("analog-output", 1), "real", 25.5, 9, "WR-001"),
    ],
)
def test_another_write_than_was_asked_for_is_found(
    target: tuple[str, int], kind: str, value: float, priority: int, requirement: str
) -> None:
    (finding,) = oracle.exactly_one_write([entry(0, "in", WRITE)], target, kind, value, priority=priority)
    assert finding.requirement == requirement


def test_a_read_must_be_answered_to_prove_something() -> None:
    asked = entry(0, "in", READ)
    assert oracle.read_from_device([asked, entry(1, "out", READ_ACK, answers=0)], ("analog-input", 1)) == []
    assert oracle.read_from_device([asked], ("analog-input", 1))
    assert oracle.read_from_device([asked, entry(1, "out", READ_ACK, answers=0)], ("analog-input", 2))


def test_an_error_is_told_by_class_and_code() -> None:
    refused = entry(1, "out", "810a000d 0100 50010c 9101 911f", answers=0)
    assert oracle.refused_with([refused], 1, 31) == []
    [finding] = oracle.refused_with([refused], 2, 37)
    assert (finding.code, "error 2,37, its answers had 1,31" in finding.message) == ("no_refusal", True)
    assert oracle.refused_with([entry(1, "out", WRITE_ACK, answers=0)], 1, 31)


def test_an_error_among_the_results_of_a_read_of_several_properties_is_a_refusal() -> None:
    multiple = entry(1, "out", "810a0018 0100 30010e 0c0000004d 1e 2955 5e 9101911f 5f 1f", answers=0)
    assert oracle.refused_with([multiple], 1, 31) == []
    assert oracle.refused_with([multiple], 2, 32)
    said = facts(multiple)
    assert (said["error_class"], said["error_code"]) == ([1], [31])


def test_an_answer_to_a_request_for_all_properties_tells_which_they_were() -> None:
    assert "property" not in facts(entry(0, "in", "810a0013 0104 0004 010e 0c00000001 1e 0908 1f"))
    multiple = entry(1, "out", "810a0019 0100 30010e 0c00000001 1e 2955 4e 4442910000 4f 1f", answers=0)
    said = facts(multiple)
    assert (said["object"], said["property"]) == (["analog-input,1"], ["present-value"])
    assert (said["error_class"], said["error_code"]) == ([None], [None])


def test_what_was_found_must_be_there() -> None:
    assert oracle.invented([12345], 12345) == []
    assert oracle.invented([], 12345)
    assert oracle.invented([12345, 1], 12345)
