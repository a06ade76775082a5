"""The descriptions that the entry points name: the same registers over TCP and over UDP."""

from __future__ import annotations

import random
import re
from collections.abc import Mapping
from dataclasses import replace

from otmcp_toy.wire import ToyConversation, line_length
from pytest_otmcp.protocols.journal import Entries, Image, JournalEntry
from pytest_otmcp.protocols.oracle import Witness
from pytest_otmcp.protocols.proof import Call, Proof, Question, Way
from pytest_otmcp.protocols.protocol import Colour, Framing, Operation, OtProtocol
from pytest_otmcp.protocols.session_oracle import StateChanges

__all__ = ["TOY", "TOY_UDP", "WITNESS"]


def describe(entry: JournalEntry) -> str:
    """Describe an entry in a few words."""
    return f"{entry['kind']} {entry.get('address')}"


WITNESS = Witness(noun="the toy", describe=describe)

PROVING = 3
"""The register whose value proves that a session reads this device."""


def ask(rng: random.Random) -> Question:
    """Ask for a random value that is set first."""
    value = rng.getrandbits(40)

    def bits(outputs: Mapping[str, object], entries: Entries) -> int:
        return 40 if outputs.get("value") == value else 0

    return Question(inputs={"address": PROVING}, pokes=({"address": PROVING, "value": value},), bits=bits)


def restore(image: Image) -> tuple[Mapping[str, object], ...]:
    """Bring the register back to its value."""
    return ({"address": PROVING, "value": image["points"][str(PROVING)]},)


TOY = OtProtocol(
    key="toy",
    name="Toy",
    package="otmcp_toy",
    scheme="toy",
    operations={
        "read": Operation(meaning="read a register", inputs=("address",), outputs=("value",), needed=("value",)),
        "write": Operation(meaning="write a register", inputs=("address", "value"), outputs=("value",), writes=True),
    },
    probes={"missing_address": 99},
    framing=Framing(frame_length=line_length, conversation=ToyConversation),
    unsolicited=lambda entries, declared: WITNESS.nothing_changed(entries),
    describe=describe,
    mock="otmcp_toy.mock_tcp",
    clients="any client that sends lines",
    tasks="otmcp_toy.tasks",
    recognise=re.compile(r"\btoy\b"),
    colour=Colour(light="#888888", dark="#aaaaaa"),
    session_oracles=(StateChanges,),
    proof=Proof(
        ways=(Way(operation="read", ask=ask),), restore=restore, unreachable=(Call("read", {"address": PROVING}),)
    ),
)

TOY_UDP = replace(
    TOY,
    key="toyudp",
    name="Toy (UDP)",
    scheme="toy+udp",
    mock="otmcp_toy.mock_udp",
    tasks="otmcp_toy.tasks_udp",
    recognise=re.compile(r"\btoyudp\b"),
)
