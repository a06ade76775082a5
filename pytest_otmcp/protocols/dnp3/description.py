"""The description of DNP3."""

from __future__ import annotations

import re

from ...wire.dnp3.link import link_length
from ..protocol import Colour, Framing, OtProtocol
from ..session_oracle import Exchanges, StateChanges
from .decoder import Dnp3Conversation
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
    key="dnp3",
    name="DNP3",
    package=__package__,
    scheme="dnp3",
    operations=OPERATIONS,
    probes={"missing_output": 99},
    framing=Framing(frame_length=link_length, conversation=Dnp3Conversation),
    unsolicited=lambda entries, declared: no_state_changing_request(entries),
    changes=changes,
    carried_out=carried_out,
    describe=describe,
    facts=facts,
    title=title,
    mock="dnp3",
    clients="a DNP3 master for the outstation 10",
    tasks="pytest_otmcp.conformance.tasks.dnp3",
    onboarding="pytest_otmcp.onboarding.packs.dnp3",
    recognise=re.compile(r"dnp3", re.IGNORECASE),
    packages=("dnp3py",),
    colour=Colour(light="#b0407f", dark="#e08bb8"),
    session_oracles=(StateChanges, Exchanges),
    proof=PROOF,
    exercise=EXERCISE,
    external=EXTERNAL,
    real=FIELD,
    secure=True,
)
