"""The description of BACnet/IP."""

from __future__ import annotations

import re

from ..protocol import Colour, Framing, OtProtocol
from ..session_oracle import Exchanges, StateChanges
from .decoder import BacnetConversation
from .entries import carried_out, changes, describe, title
from .exercise import EXERCISE
from .external import EXTERNAL
from .field import FIELD
from .operations import OPERATIONS
from .oracle import no_state_changing_request
from .proof import PROOF
from .trace import facts

__all__ = ["PROTOCOL"]

PROTOCOL = OtProtocol(
    key="bacnet",
    name="BACnet",
    package=__package__,
    scheme="bacnet",
    operations=OPERATIONS,
    probes={"missing_instance": 77},
    framing=Framing(conversation=BacnetConversation),
    unsolicited=lambda entries, declared: no_state_changing_request(entries),
    changes=changes,
    carried_out=carried_out,
    describe=describe,
    facts=facts,
    title=title,
    mock="bacnet",
    clients="a BACnet/IP client that asks device 12345 by unicast",
    tasks="pytest_otmcp.conformance.tasks.bacnet",
    onboarding="pytest_otmcp.onboarding.packs.bacnet",
    recognise=re.compile(r"bacnet", re.IGNORECASE),
    envelope_names=("bacnet-ip",),
    packages=("bacpypes3",),
    colour=Colour(light="#8a6d00", dark="#d4b106"),
    session_oracles=(StateChanges, Exchanges),
    proof=PROOF,
    exercise=EXERCISE,
    delayed=({}, {"discovery": True}),
    external=EXTERNAL,
    real=FIELD,
)
