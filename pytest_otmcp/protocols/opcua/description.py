"""The description of OPC UA (binary encoding, opc.tcp)."""

from __future__ import annotations

import re

from ...wire.opcua import chunk_length
from ..protocol import Colour, Framing, OtProtocol
from ..session_oracle import StateChanges
from .decoder import OpcUaConversation
from .entries import carried_out, describe, node_ids
from .exercise import EXERCISE, PLACES
from .external import EXTERNAL
from .field import FIELD
from .operations import OPERATIONS
from .oracle import no_state_changing_service
from .proof import PROOF
from .trace import facts

__all__ = ["PROTOCOL"]

PROTOCOL = OtProtocol(
    key="opcua",
    name="OPC UA",
    package=__package__,
    scheme="opc.tcp",
    operations=OPERATIONS,
    probes={"missing_node": "ns=2;i=99999"},
    framing=Framing(frame_length=chunk_length, conversation=OpcUaConversation),
    unsolicited=lambda entries, declared: no_state_changing_service(entries),
    parts=lambda entry: len(node_ids(entry)) if entry["kind"] == "Write" else 1,
    carried_out=carried_out,
    describe=describe,
    facts=facts,
    mock="opcua",
    clients="an OPC UA client with security None",
    tasks="pytest_otmcp.conformance.tasks.opcua",
    onboarding="pytest_otmcp.onboarding.packs.opcua",
    recognise=re.compile(r"opc[-_ ]?ua", re.IGNORECASE),
    packages=("asyncua",),
    colour=Colour(light="#e69f00", dark="#e69f00"),
    external=EXTERNAL,
    real=FIELD,
    session_oracles=(StateChanges,),
    proof=PROOF,
    exercise=EXERCISE,
    places=PLACES,
    always=True,
    secure=True,
    accounts=True,
    application="urn:otmcp:mock",
    policies=("Basic256Sha256", "Aes128_Sha256_RsaOaep", "Aes256_Sha256_RsaPss"),
    discovery=("OpenSecureChannel", "CloseSecureChannel", "FindServers", "GetEndpoints"),
    introduction=("CreateSession", "CloseSession"),
)
