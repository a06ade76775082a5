"""The oracles that need only the contract of journal entries and images."""

from __future__ import annotations

from typing import Any

from pytest_otmcp.protocols.oracle import Witness, requests

from .journals import Entry, journal

WITNESS = Witness(noun="the device", describe=lambda entry: f"{entry['kind']} {entry.get('address')}")


def asked(address: int, **fields: Any) -> Entry:
    return {"direction": "in", "kind": "read", "address": address, "request": True, **fields}


def written(address: int, **fields: Any) -> Entry:
    return asked(address, **{"kind": "write", "state_changing": True, **fields})


def answer(to: int) -> Entry:
    return {"direction": "out", "kind": "answer", "answers": to}


def words(findings: list[Any]) -> str:
    (finding,) = findings
    return f"{finding.code}: {finding.message} [{finding.requirement}] {finding.evidence or ''}"


def test_a_field_must_be_there_to_match() -> None:
    entries = journal(asked(1, unit=None), asked(2))
    assert [entry["seq"] for entry in requests(entries, unit=None)] == [0]


def test_an_answer_counts_with_the_request_that_it_answers() -> None:
    assert WITNESS.answered(journal(asked(1), answer(0))) == []
    assert WITNESS.answered(journal(asked(1), answer(0), asked(2), answer(2)), at_least=2) == []
    assert "it answered 0 of 1 [RD-004] read 1" in words(WITNESS.answered(journal(asked(1))))
    # The request came before the slice begins, so it was not made during the call.
    later = journal({}, answer(0))[1:]
    assert "it saw none [RD-004] no request" in words(WITNESS.answered(later))


def test_session_keeping_is_no_exchange() -> None:
    keeping = {"direction": "in", "kind": "ping"}
    assert "it saw none" in words(WITNESS.answered(journal(keeping, answer(0))))


def test_what_was_asked_for_counts_when_it_was_answered_by_however_many_requests() -> None:
    def reads(requests: Any) -> bool:
        return {1, 2} <= {request["address"] for request in requests}

    whole = journal(asked(1), answer(0), asked(2), answer(2), asked(7), answer(4))
    assert WITNESS.was_asked(whole, "1 and 2", reads) == []
    assert words(WITNESS.was_asked(whole[:3], "1 and 2", reads)) == (
        "no_exchange: the device should have been asked for 1 and 2 during the call, it was not [RD-004] read 1; read 2"
    )


def test_what_the_kit_and_the_plant_do_is_no_request() -> None:
    poke = written(1, origin="kit", request=False, state_changing=False)
    assert WITNESS.nothing_changed(journal(poke)) == []
    assert "it saw 1 [WR-004] write 1" in words(WITNESS.nothing_changed(journal(written(1))))


def test_of_what_changes_state_a_protocol_says_what_commands() -> None:
    entries = journal(written(1), written(7))
    found = WITNESS.nothing_changed(entries, requirement="WR-010", commands=lambda entry: entry["address"] == 7)
    assert "it saw 1 [WR-010] write 7" in words(found)


def test_a_write_that_comes_twice_is_a_duplicate() -> None:
    def identity(entry: Any) -> Any:
        return entry["address"]

    assert WITNESS.no_duplicates(journal(written(1), written(2), asked(1), asked(1)), identity=identity) == []
    assert "written_twice" in words(WITNESS.no_duplicates(journal(written(1), written(1)), identity=identity))


def test_points_that_changed_are_told_from_those_that_should_have() -> None:
    before = {"points": {"a": 1, "b": 2}}
    assert WITNESS.only_changed(before, {"points": {"a": 5, "b": 2}}, {"a": 5}) == []
    assert "b should hold 2, the device holds 3 [WR-002]" in words(
        WITNESS.only_changed(before, {"points": {"a": 1, "b": 3}}, {})
    )
    assert "a should hold 5, the device holds 1 [WR-001]" in words(WITNESS.only_changed(before, before, {"a": 5}))
    assert "b should hold 2, the device has no such point [WR-002]" in words(
        WITNESS.only_changed(before, {"points": {"a": 1}}, {})
    )
    # Point c is one that nobody had asked for.
    assert "c should hold None, the device holds 9 [WR-002]" in words(
        WITNESS.only_changed(before, {"points": {"a": 1, "b": 2, "c": 9}}, {})
    )
    assert "a should hold True, the device holds 1" in words(WITNESS.holds(before, {"a": True}))
