"""The description of classic S7 communication."""

from __future__ import annotations

import re

from ...wire.s7 import tpkt_length
from ..protocol import Colour, Framing, OtProtocol
from ..session_oracle import Exchanges, StateChanges
from .decoder import S7Conversation
from .entries import carried_out, describe, title
from .exercise import EXERCISE
from .external import EXTERNAL
from .field import FIELD
from .operations import OPERATIONS
from .oracle import no_state_changing_request
from .proof import PROOF
from .trace import facts

__all__ = ["PROTOCOL"]

PROTOCOL = OtProtocol(
    key="s7",
    name="S7comm",
    package=__package__,
    scheme="s7",
    operations=OPERATIONS,
    probes={"missing_db": 99},
    framing=Framing(frame_length=tpkt_length, conversation=S7Conversation),
    unsolicited=lambda entries, declared: no_state_changing_request(entries),
    carried_out=carried_out,
    describe=describe,
    facts=facts,
    title=title,
    mock="s7",
    clients="an S7 client for rack 0, slot 1",
    tasks="pytest_otmcp.conformance.tasks.s7",
    onboarding="pytest_otmcp.onboarding.packs.s7",
    recognise=re.compile(r"(?<![a-z0-9])s7(?:comm)?(?![a-z0-9])|snap7", re.IGNORECASE),
    envelope_names=("s7comm",),
    packages=("python-snap7",),
    colour=Colour(light="#7a5195", dark="#b59ad1"),
    external=EXTERNAL,
    real=FIELD,
    session_oracles=(StateChanges, Exchanges),
    proof=PROOF,
    exercise=EXERCISE,
)
