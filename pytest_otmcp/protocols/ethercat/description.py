"""The description of EtherCAT."""

from __future__ import annotations

import re

from ..protocol import Colour, Framing, OtProtocol
from ..session_oracle import Exchanges, StateChanges
from .decoder import EthercatConversation
from .entries import carried_out, describe, facts, title
from .exercise import EXERCISE
from .operations import OPERATIONS
from .oracle import Drives, no_state_changing_request
from .proof import PROOF

__all__ = ["PROTOCOL"]

PROTOCOL = OtProtocol(
    key="ethercat",
    name="EtherCAT",
    package=__package__,
    scheme="ethercat",
    operations=OPERATIONS,
    probes={"missing_index": 0x2222, "missing_slave": 9},
    events=("watchdog",),
    # A cable has no connection, and while its slaves are away it is silent.
    framing=Framing(conversation=EthercatConversation),
    unsolicited=lambda entries, declared: no_state_changing_request(entries),
    carried_out=carried_out,
    describe=describe,
    facts=facts,
    title=title,
    mock="ethercat",
    clients="an EtherCAT master on the interface, in the network namespace of the process `join`",
    tasks="pytest_otmcp.conformance.tasks.ethercat",
    onboarding="pytest_otmcp.onboarding.packs.ethercat",
    packages=("pysoem",),
    cable=True,
    # A frame passes a line in microseconds, and a master takes one that is milliseconds late for lost: what takes time is the answer of a mailbox.
    delayed=({"service": "sdo_upload"}, {"service": "sdo_download"}),
    # Objects and process data of a slave are called so: CANopen's, too, which the kit does not know.
    recognise=re.compile(r"ethercat|pysoem|(?<![a-z0-9])[sp]do(?![a-z0-9])", re.IGNORECASE),
    envelope_names=("ethercat",),
    colour=Colour(light="#a3390a", dark="#ef8a5a"),
    session_oracles=(StateChanges, Exchanges, Drives),
    proof=PROOF,
    exercise=EXERCISE,
)
