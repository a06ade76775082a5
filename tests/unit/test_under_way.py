"""A person who watches a run is told which call is made, and for what an item has been waiting longest."""

from __future__ import annotations

import time

import pytest

from pytest_otmcp.trial.under_way import UnderWay


def test_calls_are_counted_and_the_longest_wait_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    under_way = UnderWay()
    with under_way.call("read_holding"):
        assert under_way.words() == "call 1"
        now += 3.0
        with under_way.call("write_holding"):
            assert under_way.words() == "call 2, 3 s for the reply to read_holding"
    assert under_way.words() == "call 2"
    assert under_way.seconds == 3.0


def test_a_new_item_begins_with_no_calls() -> None:
    under_way = UnderWay()
    with under_way.call("read_holding"):
        pass
    under_way.begin()
    assert under_way.words() == "call 0"
