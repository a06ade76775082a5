"""The description of Modbus TCP."""

from __future__ import annotations

import re

from ...wire.modbus import mbap_length
from ..protocol import Colour, Composite, Framing, OtProtocol
from ..session_oracle import Exchanges, StateChanges
from .decoder import ModbusConversation
from .entries import carried_out, describe, title
from .exercise import EXERCISE
from .external import EXTERNAL
from .field import FIELD
from .operations import OPERATIONS
from .oracle import no_state_changing_request
from .places import PLACES
from .proof import PROOF
from .trace import facts

__all__ = ["PROTOCOL"]

PROTOCOL = OtProtocol(
    key="modbus",
    name="Modbus",
    package=__package__,
    scheme="modbus+tcp",
    operations=OPERATIONS,
    composites={
        "read_cells": Composite(one_of=("read_input", "read_holding", "read_discrete_inputs", "read_coils")),
    },
    probes={"missing_address": 9999},
    framing=Framing(frame_length=mbap_length, conversation=ModbusConversation),
    unsolicited=lambda entries, declared: no_state_changing_request(entries),
    carried_out=carried_out,
    describe=describe,
    facts=facts,
    title=title,
    mock="modbus",
    clients="a Modbus TCP client with unit identifier 1",
    tasks="pytest_otmcp.conformance.tasks.modbus",
    onboarding="pytest_otmcp.onboarding.packs.modbus",
    recognise=re.compile(r"modbus", re.IGNORECASE),
    envelope_names=("modbus-tcp", "modbus-tls"),
    packages=("pymodbus",),
    colour=Colour(light="#0072b2", dark="#56b4e9"),
    external=EXTERNAL,
    real=FIELD,
    session_oracles=(StateChanges, Exchanges),
    proof=PROOF,
    exercise=EXERCISE,
    places=PLACES,
    always=True,
    secure=True,
)
