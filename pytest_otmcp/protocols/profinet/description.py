"""The description of PROFINET IO."""

from __future__ import annotations

import re

from ..protocol import Colour, Framing, OtProtocol
from ..session_oracle import Exchanges, StateChanges
from .decoder import ProfinetConversation
from .entries import carried_out, describe, title
from .exercise import EXERCISE
from .operations import OPERATIONS
from .oracle import Drives, no_state_changing_request
from .proof import PROOF
from .trace import facts

__all__ = ["PROTOCOL"]

PROTOCOL = OtProtocol(
    key="profinet",
    name="PROFINET",
    package=__package__,
    scheme="profinet",
    operations=OPERATIONS,
    probes={"missing_slot": 9},
    # Frames are frames already: a cable has no connection, and while its device is away it is silent.
    events=("watchdog",),
    framing=Framing(conversation=ProfinetConversation),
    unsolicited=lambda entries, declared: no_state_changing_request(entries),
    carried_out=carried_out,
    describe=describe,
    facts=facts,
    title=title,
    mock="profinet",
    clients="a PROFINET controller or supervisor on the cable",
    tasks="pytest_otmcp.conformance.tasks.profinet",
    onboarding="pytest_otmcp.onboarding.packs.profinet",
    recognise=re.compile(r"profinet", re.IGNORECASE),
    envelope_names=("profinet-io",),
    colour=Colour(light="#7a4a00", dark="#d19a4a"),
    cable=True,
    session_oracles=(StateChanges, Exchanges, Drives),
    proof=PROOF,
    exercise=EXERCISE,
)
