"""An adapter's place in the journal of its device: every entry reaches the oracles of its session once, in order."""

from __future__ import annotations

from typing import Any, cast

import pytest

from pytest_otmcp.protocols.journal import JournalEntry
from pytest_otmcp.protocols.modbus import oracle
from pytest_otmcp.protocols.mqtt.oracle import Publications
from pytest_otmcp.protocols.session_oracle import StateChanges
from pytest_otmcp.trial.cursor import JournalCursor

from ..feeding import fed


def entries(begin: int, end: int) -> list[JournalEntry]:
    """Return writes with the sequence numbers from ``begin`` to before ``end``."""
    common: dict[str, Any] = {"t_ns": 0, "connection": 1, "direction": "in", "kind": "request", "origin": "client"}
    asks = {"request": True, "state_changing": True, "answers": None, "function": 6}
    return [cast(JournalEntry, {**common, **asks, "seq": seq}) for seq in range(begin, end)]


def opened(seq: int = 0) -> JournalCursor:
    cursor = JournalCursor("modbus")
    cursor.open_session(seq)
    return cursor


def test_an_entry_that_was_looked_at_before_its_slice_is_taken_counts_once() -> None:
    cursor = opened()
    cursor.feed(entries(0, 3), 3)
    assert (cursor.fed, cursor.next) == (3, 0)
    cursor.feed(entries(0, 5), 5)
    cursor.take(entries(0, 6), 6)
    assert (cursor.fed, cursor.next) == (6, 6)
    assert cursor.oracle(StateChanges).count == 6


def test_what_came_before_the_session_is_none_of_its_doing() -> None:
    cursor = opened(4)
    cursor.take(entries(0, 6), 6)
    assert cursor.oracle(StateChanges).count == 2


def test_a_new_session_is_judged_anew_and_an_ended_one_still_answers() -> None:
    cursor = opened()
    cursor.take(entries(0, 3), 3)
    cursor.close_session()
    assert cursor.oracle(StateChanges).count == 3
    cursor.open_session(3)
    assert cursor.oracle(StateChanges).count == 0
    assert cursor.session == (2, 3)


def test_a_device_that_was_started_again_counts_from_0() -> None:
    cursor = opened(2)
    cursor.take(entries(0, 6), 6)
    cursor.restart()
    assert (cursor.next, cursor.fed, cursor.starts, cursor.session) == (0, 0, 1, (1, 0))
    cursor.take(entries(0, 2), 2)
    assert cursor.oracle(StateChanges).count == 2


def test_an_adapter_is_left_alone_between_a_look_and_its_next_call_while_its_session_is_open() -> None:
    cursor = opened()
    assert not cursor.quiet
    cursor.looked_through = True
    assert cursor.quiet
    cursor.close_session()
    assert not cursor.quiet


def test_an_oracle_that_the_protocol_does_not_name_is_none_of_the_sessions() -> None:
    with pytest.raises(LookupError):
        opened().oracle(Publications)


def test_writes_in_a_session_are_counted_and_the_first_ones_are_kept() -> None:
    changes = fed(StateChanges(), entries(0, 1000))
    assert (changes.count, len(changes.first)) == (1000, 10)
    (finding,) = oracle.nothing_changed_by(changes)
    assert "it saw 1000" in finding.message
    assert oracle.nothing_changed_by(StateChanges()) == []
