"""Journal entries that contradict the entries before them."""

from __future__ import annotations

from typing import Any

import pytest

from pytest_otmcp.replay.connections import Connections

from .journals import Entry, entry, numbered

ASKS: dict[str, Any] = {"request": True}


def contradictions(*entries: Entry, first: int = 0) -> list[str | None]:
    connections = Connections(first)
    return [connections.contradiction(one) for one in entries]


def exchange(*changes: dict[str, Any]) -> list[Entry]:
    """Return the journal of a request and its answer, each changed by one of ``changes``."""
    asked, told = entry("request", **ASKS), entry("response", "out", answers=0)
    return numbered(*({**one, **change} for one, change in zip((asked, told), changes, strict=True)))


@pytest.mark.parametrize(
    ("asked", "told", "clause"),
    [
        ({}, {}, None),
        ({"connection": 2}, {}, "answers the entry 0 of another connection"),
        ({"kind": "lost"}, {}, "answers the entry 0, which is a 'lost'"),
        ({"direction": "out"}, {}, "answers the entry 0, which asked nothing"),
        ({}, {"answers": 1}, "answers the entry 1, which asked nothing"),
        ({}, {"answers": 10**30}, f"answers the entry {10**30}, which asked nothing"),
        ({}, {"answers": -1}, "answers the entry -1, which asked nothing"),
        ({}, {"direction": "in", "kind": "request"}, "answers the entry 0, which asked nothing"),
        ({}, {"origin": "stranger"}, "is called the stranger's, its connection was the client's"),
        ({"origin": "stranger"}, {}, "is called the client's, its connection was the stranger's"),
        ({"origin": "plant"}, {}, "is called the client's, its connection was the plant's"),
        ({"origin": "former"}, {}, "is called the client's, its connection was the former's"),
        ({"origin": "unknown"}, {}, None),
        ({}, {"origin": "former"}, None),
    ],
)
def test_an_answer_belongs_to_a_request_of_its_connection(
    asked: dict[str, Any], told: dict[str, Any], clause: str | None
) -> None:
    assert contradictions(*exchange(asked, told)) == [None, clause]


def test_only_the_kit_and_the_device_itself_have_no_connection() -> None:
    assert contradictions(
        *numbered(
            entry("network", "out", connection=0, origin="kit"),
            entry("watchdog", "out", connection=0, origin="plant"),
            entry("request", connection=0, origin="plant"),
            entry("request", connection=0),
        )
    ) == [
        None,
        None,
        "has no connection, and is called the plant's",
        "has no connection, and is called the client's",
    ]


def test_what_was_asked_before_the_journal_is_known_is_believed() -> None:
    answer = {**entry("response", "out", answers=5), "seq": 8}
    assert contradictions(answer, first=8) == [None]
    assert contradictions({**entry("request", **ASKS), "seq": 3}, answer) == [None, None]


def test_a_connection_begins_once() -> None:
    begun = numbered(entry("CONNECTED"), entry("CONNECTED", connection=2), entry("CONNECTED"))
    assert contradictions(*begun) == [None, None, "begins the connection 1, which was there already"]


def test_a_connection_that_is_used_has_begun() -> None:
    used = numbered(entry("CONNECTED"), entry("request", **ASKS), entry("request", connection=2, **ASKS))
    assert contradictions(*used) == [None, None, "is of the connection 2, which did not begin"]
    # Of datagrams, and of a journal whose first entries are not known, nobody knows the beginnings.
    assert contradictions(*used[1:], first=1) == [None, None]
    assert contradictions(*({**one, "seq": one["seq"] + 1} for one in used)) == [None, None, None]


def test_an_event_is_asked_nothing_and_can_have_no_answer() -> None:
    for event, clause in (("lost", "answers the entry 0, which is a 'lost'"), ("malformed", None)):
        assert contradictions(*exchange({"kind": event, "request": False}, {})) == [None, clause]


def test_the_number_of_a_connection_comes_again() -> None:
    ended = numbered(entry("request", **ASKS), entry("DISCONNECTED"), entry("request", origin="stranger", **ASKS))
    assert contradictions(*ended) == [None, None, None]
    connections = Connections(0)
    [asked, *_] = ended
    assert connections.contradiction(asked) is None
    connections.restart()
    assert connections.contradiction({**asked, "origin": "stranger"}) is None
    told = {**entry("response", "out", answers=0, origin="stranger"), "seq": 1}
    assert connections.contradiction(told) is None
