"""Journal entries for the tests of decoders and oracles: decoded from frames as the kit does it, or written by hand."""

from __future__ import annotations

import copy
from typing import Any

from pytest_otmcp.plant.journal import DeviceJournal
from pytest_otmcp.protocols.conversation import Conversation, Direction
from pytest_otmcp.protocols.evidence import JournalReader, evidence

Entry = Any
"""An entry of any protocol; a narrower type would make every test name the protocol."""


def decoded(conversation: Conversation, *frames: tuple[Direction, bytes], connection: int = 1) -> list[Entry]:
    """Return the journal of a connection on which these frames passed; a record must give it back as it is."""
    journal, again = DeviceJournal(lambda: conversation), copy.deepcopy(conversation)
    for direction, frame in frames:
        journal.frame(connection, direction, frame, None)
    reader = JournalReader(lambda: again)
    assert [reader.read(evidence(one)) for one in journal.since(0)] == journal.since(0)
    return journal.since(0)


def entry(kind: str, direction: Direction = "in", **fields: Any) -> Entry:
    """Return an entry of connection 1 that is no request, unless ``fields`` say otherwise."""
    contract = {"seq": 0, "t_ns": 0, "connection": 1, "request": False, "state_changing": False, "answers": None}
    return {**contract, "direction": direction, "kind": kind, "origin": "client", **fields}


def numbered(*entries: Entry) -> list[Entry]:
    """Return the entries as one journal, numbered from 0."""
    return [{**one, "seq": seq} for seq, one in enumerate(entries)]


def journal(*entries: Entry, **common: Any) -> list[Entry]:
    """Return partial entries as one journal: each gets the contract's fields that it does not have."""
    contract = entry("", **common)
    return [{**contract, "t_ns": seq, **one, "seq": seq} for seq, one in enumerate(entries)]
