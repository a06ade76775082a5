"""Journal entries that contradict themselves or the entries before them, where no bytes of the wire say so."""

from __future__ import annotations

from typing import Any

import pytest

from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.replay.connections import Connections

from .journals import Entry, entry, numbered

ASKS: dict[str, Any] = {"request": True}
COMMANDS: dict[str, Any] = {"request": True, "state_changing": True}
MESSAGE: dict[str, Any] = {"topic": "plant/valve", "payload": "MQ==", "qos": 0, "retain": False, "dup": False}
NODE: dict[str, Any] = {"node_id": "ns=2;i=7", "attribute": "Value"}
WRITTEN: dict[str, Any] = {**NODE, "value": 7, "variant_type": "Int16", "has_status": False, "has_timestamp": False}

HONEST: dict[str, tuple[str, Entry]] = {
    "a publication": ("mqtt", entry("PUBLISH", **COMMANDS, **MESSAGE)),
    "a publication of the plant's": ("mqtt", entry("PUBLISH", origin="plant", **MESSAGE)),
    "a delivery": ("mqtt", entry("PUBLISH", "out", **MESSAGE)),
    "a subscription": ("mqtt", entry("SUBSCRIBE", **ASKS, filters=[{"filter": "#", "qos": 0}], packet_id=1)),
    "a will": ("mqtt", entry("WILL", topic="gone", payload="", qos=0, retain=False)),
    "a burst": ("mqtt", entry("BURST", "out", topic="flood", count=7)),
    "what is no packet": ("mqtt", entry("malformed", bytes="00", reason="packet type 0 is reserved", packet=None)),
    "a read": ("opcua", entry("Read", **ASKS, nodes=[NODE])),
    "a write": ("opcua", entry("Write", **COMMANDS, nodes=[WRITTEN])),
    "a write that was refused before anybody read it": ("opcua", entry("Write", **COMMANDS)),
    "a notification": ("opcua", entry("Publish", "out", nodes=[NODE])),
    "a service of a vendor": ("opcua", entry("ns=3;i=5001", **ASKS)),
    "a service that is sealed": ("opcua", entry("Sealed", **COMMANDS, message="MSG")),
    "a channel that is sealed": ("opcua", entry("Sealed", message="OPN")),
    "the end of a connection": ("opcua", entry("DISCONNECTED")),
}


@pytest.mark.parametrize("name", HONEST)
def test_an_entry_that_a_witness_writes_contradicts_nothing(name: str) -> None:
    protocol, honest = HONEST[name]
    assert protocols()[protocol].contradiction(honest) is None


FORGED: dict[str, tuple[str, Entry, str]] = {
    "a publication that is called an acknowledgement": (
        "mqtt",
        entry("PUBACK", **MESSAGE),
        "has 'topic', which a 'PUBACK' does not have",
    ),
    "a will of a publication": ("mqtt", entry("PUBLISH", **COMMANDS, **MESSAGE, will=None), "has 'will', which"),
    "a write that is called a read": (
        "opcua",
        entry("Read", **ASKS, nodes=[WRITTEN]),
        "is called 'Read', and has a value of 'ns=2;i=7'",
    ),
    "a read that is called a write": (
        "opcua",
        entry("Write", **COMMANDS, nodes=[NODE]),
        "is called 'Write', and has no value of 'ns=2;i=7'",
    ),
    "a write that is called the browsing of a node": (
        "opcua",
        entry("Browse", **ASKS, nodes=[WRITTEN]),
        "is called 'Browse', and names more than the node",
    ),
    "a read of no attribute": (
        "opcua",
        entry("Read", **ASKS, nodes=["ns=2;i=7"]),
        "names the node 'ns=2;i=7' without its attribute",
    ),
    "a method that is called a read": (
        "opcua",
        entry("Read", **ASKS, methods=[]),
        "has 'methods', which a 'Read' that was received does not have",
    ),
    "a write that keeps the session": (
        "opcua",
        entry("CloseSession", nodes=[WRITTEN]),
        "has 'nodes', which a 'CloseSession' that was received does not have",
    ),
    "a write that is called an end": ("opcua", entry("DISCONNECTED", nodes=[WRITTEN]), "has 'nodes', which"),
    "a sealed service that only asks": (
        "opcua",
        entry("Sealed", **ASKS),
        "says state_changing False, its kind 'Sealed' says True",
    ),
    "a service that nobody knows": ("opcua", entry("Peruse", **ASKS), "is of the kind 'Peruse', which is no service"),
}


@pytest.mark.parametrize("name", FORGED)
def test_an_entry_that_is_not_what_its_kind_says_is_found(name: str) -> None:
    protocol, forged, clause = FORGED[name]
    assert clause in (protocols()[protocol].contradiction(forged) or "")


# -- the entries of one journal --------------------------------------------------------------------------------------------


def contradictions(*entries: Entry, first: int = 0) -> list[str | None]:
    connections = Connections(protocols()["modbus"], first)
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
        ({"kind": "lost"}, {}, "is called 'response' and answers the entry 0, which is called 'lost'"),
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


@pytest.mark.parametrize("protocol", ["modbus", "s7", "bacnet", "ethernetip", "dnp3", "profibus"])
def test_what_a_client_sends_is_of_a_kind_that_clients_send(protocol: str) -> None:
    connections = Connections(protocols()[protocol], 0)
    sent = numbered(entry("request", **ASKS), entry("requestx"), entry("garbage", "out"), entry("malformed"))
    assert [connections.contradiction(one) for one in sent] == [
        None,
        "is of the kind 'requestx', which nothing is that a client sends",
        None,
        None,
    ]


@pytest.mark.parametrize(("protocol", "asked"), [("dnp3", "link_request"), ("profibus", "token")])
def test_an_answer_is_of_a_kind_that_answers_what_was_asked(protocol: str, asked: str) -> None:
    connections = Connections(protocols()[protocol], 0)
    exchanged = numbered(entry(asked), entry("response", "out", answers=0))
    clause = f"is called 'response' and answers the entry 0, which is called {asked!r}"
    assert [connections.contradiction(one) for one in exchanged] == [None, clause]


def test_the_number_of_a_connection_comes_again() -> None:
    ended = numbered(entry("request", **ASKS), entry("DISCONNECTED"), entry("request", origin="stranger", **ASKS))
    assert contradictions(*ended) == [None, None, None]
    connections = Connections(protocols()["modbus"], 0)
    [asked, *_] = ended
    assert connections.contradiction(asked) is None
    connections.restart()
    assert connections.contradiction({**asked, "origin": "stranger"}) is None
    told = {**entry("response", "out", answers=0, origin="stranger"), "seq": 1}
    assert connections.contradiction(told) is None
