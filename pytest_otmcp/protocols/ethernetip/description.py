"""The description of EtherNet/IP."""

from __future__ import annotations

import re

from ...wire.ethernetip.frames import frame_length
from ..protocol import Colour, Framing, OtProtocol
from ..session_oracle import Exchanges, StateChanges
from .decoder import EthernetIpConversation
from .entries import carried_out, changes, describe, title, writes_in
from .exercise import EXERCISE
from .operations import OPERATIONS
from .oracle import no_state_changing_request
from .proof import PROOF
from .trace import facts

__all__ = ["PROTOCOL"]

PROTOCOL = OtProtocol(
    key="ethernetip",
    name="EtherNet/IP",
    package=__package__,
    scheme="eip",
    operations=OPERATIONS,
    probes={"missing_tag": "NoSuchTag"},
    framing=Framing(frame_length=frame_length, conversation=EthernetIpConversation),
    unsolicited=lambda entries, declared: no_state_changing_request(entries),
    parts=writes_in,
    changes=changes,
    carried_out=carried_out,
    describe=describe,
    facts=facts,
    title=title,
    mock="ethernetip",
    clients="a client for the tags of a Logix controller in slot 0",
    tasks="pytest_otmcp.conformance.tasks.ethernetip",
    onboarding="pytest_otmcp.onboarding.packs.ethernetip",
    recognise=re.compile(
        r"ether-?net[-_/ ]?ip|(?<![a-z0-9])(?:eip|enip|cip|logix|allen[-_ ]?bradley|rockwell)(?![a-z0-9])|pylogix|pycomm3",
        re.IGNORECASE,
    ),
    envelope_names=("ethernet-ip",),
    packages=("pylogix",),
    colour=Colour(light="#a83f39", dark="#e08a80"),
    session_oracles=(StateChanges, Exchanges),
    proof=PROOF,
    exercise=EXERCISE,
    secure=True,
)
