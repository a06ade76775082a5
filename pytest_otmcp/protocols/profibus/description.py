"""The description of PROFIBUS DP."""

from __future__ import annotations

import re

from ..protocol import Colour, Framing, OtProtocol
from ..session_oracle import Exchanges, StateChanges
from .decoder import ProfibusConversation
from .entries import carried_out, describe, title
from .exercise import EXERCISE
from .operations import OPERATIONS
from .oracle import Drives, no_state_changing_request
from .proof import PROOF
from .trace import facts

__all__ = ["PROTOCOL"]

PROTOCOL = OtProtocol(
    key="profibus",
    name="PROFIBUS",
    package=__package__,
    scheme="profibus",
    operations=OPERATIONS,
    probes={"missing_station": 77},
    # Telegrams are frames already: a line has no connection, and while its slaves are away it is silent.
    events=("watchdog",),
    framing=Framing(conversation=ProfibusConversation),
    unsolicited=lambda entries, declared: no_state_changing_request(entries),
    carried_out=carried_out,
    describe=describe,
    facts=facts,
    title=title,
    mock="profibus",
    clients="a PROFIBUS DP master on the pseudo terminal",
    tasks="pytest_otmcp.conformance.tasks.profibus",
    onboarding="pytest_otmcp.onboarding.packs.profibus",
    recognise=re.compile(r"profibus", re.IGNORECASE),
    envelope_names=("profibus-dp",),
    colour=Colour(light="#00737a", dark="#3fb8bf"),
    session_oracles=(StateChanges, Exchanges, Drives),
    proof=PROOF,
    exercise=EXERCISE,
)
