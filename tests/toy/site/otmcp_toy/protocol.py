"""The descriptions that the entry points name: the same registers over TCP and over UDP."""

from __future__ import annotations

import re
from dataclasses import replace

from otmcp_toy.device import line_length, parsed
from pytest_otmcp.protocols.conversation import InOrder
from pytest_otmcp.protocols.oracle import Witness
from pytest_otmcp.protocols.point import INT32, Point, restoring
from pytest_otmcp.protocols.proof import Call, Proof
from pytest_otmcp.protocols.protocol import Colour, Framing, Operation, OtProtocol
from pytest_otmcp.protocols.session_oracle import StateChanges

__all__ = ["TOY", "TOY_UDP", "WITNESS", "register"]

WITNESS = Witness(noun="the toy", describe=lambda entry: f"{entry['kind']} {entry.get('address')}")


def register(address: int) -> Point:
    """Return the register with this address."""
    place = {"address": address}
    return Point(
        kind=INT32,
        reading=Call("read", place),
        writing=Call("write", place),
        pokes=lambda value: ({"address": address, "value": value},),
        held=lambda value: {str(address): value},
        found=lambda image: image["points"][str(address)],
    )


PROVING = register(3)

TOY = OtProtocol(
    key="toy",
    name="Toy",
    package="otmcp_toy",
    scheme="toy",
    operations={
        "read": Operation(meaning="read a register", inputs=("address",), outputs=("value",), needed=("value",)),
        "write": Operation(meaning="write a register", inputs=("address", "value"), outputs=("value",), writes=True),
    },
    framing=Framing(frame_length=line_length, conversation=lambda: InOrder(parsed)),
    unsolicited=lambda entries, declared: WITNESS.nothing_changed(entries),
    describe=WITNESS.describe,
    mock="otmcp_toy.device",
    clients="any client that sends lines",
    tasks="otmcp_toy.tasks",
    recognise=re.compile(r"\btoy\b"),
    colour=Colour(light="#888888", dark="#aaaaaa"),
    session_oracles=(StateChanges,),
    proof=Proof(
        ways=(PROVING.way(PROVING.kind.any, bits=32),),
        restore=restoring(PROVING),
        unreachable=(Call("read", {"address": 3}),),
    ),
)

TOY_UDP = replace(TOY, key="toyudp", name="Toy (UDP)", scheme="toy+udp", recognise=re.compile(r"\btoyudp\b"))
