"""The kit's decoder of PROFIBUS on telegrams of public manuals, and the oracles on what it makes of them."""

from __future__ import annotations

from typing import Any

import pytest

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.conversation import Direction
from pytest_otmcp.protocols.profibus import oracle
from pytest_otmcp.protocols.profibus.decoder import ProfibusConversation
from pytest_otmcp.protocols.profibus.entries import carried_out, describe, points, title

SET_PRM = "680c0c68 85825d3d3e 881e0100809c01 a316"
CHK_CFG = "68070768 85827d3e3e 1121 3216"
EXCHANGE = "68050568 05027d 1234 ca16"
EXCHANGED = "68050568 020508 02d5 e616"
INPUTS = "68050568 85824d383e ca16"
INPUTS_READ = "68070768 8285083e38 02d5 5c16"
REFUSED = "10020503 0a16"
CLEAR = "68070768 ff82463a3e 0200 4116"


def entry(seq: int, direction: Direction, telegram: str, answers: int | None = None, **more: Any) -> Any:
    (message,) = ProfibusConversation().decode(direction, bytes.fromhex(telegram))
    contract = {"seq": seq, "t_ns": seq, "connection": 1, "direction": direction, "origin": "client"}
    said = {"kind": message.kind, "request": message.request, "state_changing": message.state_changing}
    return {**contract, **said, "answers": answers, **message.fields, **more}


def requirements(found: list[Finding]) -> list[str]:
    return [finding.requirement for finding in found]


def test_a_read_and_its_answer_are_one_exchange() -> None:
    conversation = ProfibusConversation()
    (asked,) = conversation.decode("in", bytes.fromhex(INPUTS))
    (answer,) = conversation.decode("out", bytes.fromhex(INPUTS_READ))
    assert (asked.kind, asked.request, asked.state_changing) == ("request", True, False)
    assert answer.answers is asked
    assert (answer.fields["service"], answer.fields["station"], answer.fields["data"]) == ("rd_inp", 5, "02d5")
    assert title(entry(0, "in", INPUTS)) == "request: RD_Inp"
    assert describe(entry(0, "in", EXCHANGE)) == "Data_Exchange to 5 1234"


def test_a_short_acknowledgement_belongs_to_the_request_before_it() -> None:
    conversation = ProfibusConversation()
    (asked,) = conversation.decode("in", bytes.fromhex(SET_PRM))
    (answer,) = conversation.decode("out", b"\xe5")
    assert asked.fields["ident"] == "809c"
    assert answer.answers is asked
    assert (answer.fields["service"], answer.fields["status"]) == ("set_prm", None)


def test_outputs_that_are_repeated_change_nothing_until_the_slave_is_configured_again() -> None:
    conversation = ProfibusConversation()
    telegrams = (EXCHANGE, EXCHANGE, EXCHANGE.replace("1234 ca", "1235 cb"), CHK_CFG, EXCHANGE)
    found = [conversation.decode("in", bytes.fromhex(telegram))[0] for telegram in telegrams]
    assert [(one.kind, one.state_changing) for one in found] == [
        ("request", True),
        ("cycle", False),
        ("request", True),
        ("request", False),
        ("request", True),
    ]


@pytest.mark.parametrize(
    "telegram",
    [
        "",
        "55",
        "6805",
        EXCHANGE.replace("ca16", "cb16"),
        EXCHANGE.replace("ca16", "ca17"),
        EXCHANGE[:-2],
        "68040468 850249d4 a416",
    ],
)
def test_what_is_no_telegram_is_malformed(telegram: str) -> None:
    assert entry(0, "in", telegram)["kind"] == "malformed"


@pytest.mark.parametrize(("telegram", "kind"), [("dc0302", "token"), ("e5", "message"), (EXCHANGED, "message")])
def test_what_asks_for_nothing_is_no_request(telegram: str, kind: str) -> None:
    found = entry(0, "in", telegram)
    assert (found["kind"], found["request"]) == (kind, False)


def test_what_was_done_is_told_by_the_answer() -> None:
    asked = entry(0, "in", EXCHANGE)
    assert carried_out(asked, None) is None
    assert carried_out(asked, entry(1, "out", EXCHANGED)) is True
    assert carried_out(asked, entry(1, "out", REFUSED)) is False
    assert carried_out(entry(0, "in", CLEAR), None) is True


@pytest.mark.parametrize(
    ("station", "outputs", "found"),
    [(5, "1234", []), (8, "1234", ["ADR-001"]), (5, "3412", ["ENC-001"]), (5, "1235", ["WR-001"])],
)
def test_another_write_than_was_asked_for_is_found(station: int, outputs: str, found: list[str]) -> None:
    entries = [entry(0, "in", SET_PRM), entry(1, "in", CHK_CFG), entry(2, "in", EXCHANGE)]
    seen = oracle.exactly_one_write(entries, station=station, outputs=bytes.fromhex(outputs))
    assert requirements(seen) == found


def test_no_write_and_two_writes_are_found() -> None:
    wanted = {"station": 5, "outputs": b"\x12\x34"}
    assert requirements(oracle.exactly_one_write([entry(0, "in", SET_PRM)], **wanted)) == ["WR-001"]
    twice = [entry(0, "in", EXCHANGE), entry(1, "in", EXCHANGE)]
    assert requirements(oracle.exactly_one_write(twice, **wanted)) == ["WR-003"]
    assert len(oracle.outputs_sent([twice[0], {**twice[1], "repeated": True}])) == 1


@pytest.mark.parametrize("telegram", [SET_PRM, CHK_CFG, EXCHANGE, CLEAR])
def test_what_only_a_slaves_master_sends_is_no_read(telegram: str) -> None:
    driving = entry(0, "in", telegram)
    session = oracle.Drives()
    session.feed(driving)
    for found in (oracle.nothing_driven([driving]), oracle.nothing_driven_by(session)):
        assert [(finding.code, finding.requirement) for finding in found] == [("driven", "WR-004")]
    assert oracle.nothing_driven([entry(0, "in", INPUTS)]) == []


def test_inputs_must_be_sent_to_have_been_read() -> None:
    asked, answer = entry(0, "in", INPUTS), entry(1, "out", INPUTS_READ, answers=0)
    assert oracle.inputs_were_read([asked, answer], station=5) == []
    assert requirements(oracle.inputs_were_read([asked], station=5)) == ["RD-004"]
    assert requirements(oracle.inputs_were_read([asked, answer], station=8)) == ["RD-004"]
    assert oracle.reached([asked], 5)
    assert not oracle.reached([asked], 8)
    assert oracle.answered_by([asked, answer], 5) == []
    assert oracle.answered_by([asked], 5)


def test_outputs_for_a_slave_are_found() -> None:
    asked, older = b"\x12\x34", b"\x56\x78"
    repeated = entry(0, "in", EXCHANGE, state_changing=False)
    assert oracle.no_outputs_sent([entry(0, "in", SET_PRM)], 5, asked) == []
    assert requirements(oracle.no_outputs_sent([entry(0, "in", EXCHANGE)], 5, older)) == ["ERR-006"]
    assert requirements(oracle.no_outputs_sent([repeated], 5, asked)) == ["ERR-006"]
    assert oracle.no_outputs_sent([repeated], 5, older) == []
    assert oracle.no_outputs_sent([entry(0, "in", EXCHANGE)], 8, asked) == []


def test_a_slave_without_watchdog_and_outputs_that_stay_are_found() -> None:
    image = {
        "stations": {"5": {"watchdog_s": None, "state": "data_exchange"}},
        "points": points(5, "output", b"\0\1"),
    }
    assert oracle.watchdog_s(image, 5) is None
    assert [finding.code for finding in oracle.has_watchdog(image, 5)] == ["no_watchdog"]
    assert requirements(oracle.cleared(image, 5, requirement="MCP-009")) == ["MCP-009"]
    better = {"stations": {"5": {"watchdog_s": 2.0}}, "points": points(5, "output", b"\0\0")}
    assert oracle.has_watchdog(better, 5) == []
    assert oracle.cleared(better, 5, requirement="MCP-009") == []
