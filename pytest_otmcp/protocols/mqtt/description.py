"""The description of MQTT and Sparkplug B."""

from __future__ import annotations

import re

from ...wire.mqtt.primitives import packet_length
from ..protocol import Choice, Colour, Composite, Framing, OtProtocol, Simulator
from ..session_oracle import Exchanges
from .commands import COMMAND_TOPICS, declares
from .decoder import MqttConversation
from .entries import delivered_again, describe, messages
from .exercise import EXERCISE
from .external import EXTERNAL
from .filters import covers
from .host_state import HostState
from .operations import OPERATIONS
from .oracle import Publications, Refused, Subscriptions, no_command
from .proof import PROOF
from .retained import RETAINED, presets
from .sparkplug_oracle import Births, SparkplugSequence, kept_or_executed, stamps
from .trace import facts

__all__ = ["PROTOCOL"]

_AS_HOST = "speaks Sparkplug B as a host application, not as an edge node"
_HOST_ALONE = "is a Sparkplug B host application, and has no tool for it"
_NOT_AT_ALL = "does not speak Sparkplug B"

PROTOCOL = OtProtocol(
    key="mqtt",
    name="MQTT",
    package=__package__,
    scheme="mqtt",
    operations=OPERATIONS,
    composites={
        "command": Composite(one_of=("send_device_command", "send_node_command")),
        "host": Composite(one_of=("sparkplug_nodes", "sparkplug_metrics", "send_device_command", "send_node_command")),
        "heard": Composite(one_of=("sparkplug_nodes", "sparkplug_metrics")),
        "receive": Composite(facets=("subscribe", "messages"), if_waiting={"messages": ("messages",)}),
    },
    probes={"bad_qos": 5},
    choices=(
        Choice(
            key="sparkplug",
            default="edge",
            meaning="the role that the adapter has in Sparkplug B",
            unclaims={
                "edge": {},
                "host": {"device_birth": _AS_HOST, "device_data": _AS_HOST},
                "none": {"device_birth": _NOT_AT_ALL, "device_data": _NOT_AT_ALL},
            },
            unbound={"host": dict.fromkeys(("info", "subscribe", "messages", "publish"), _HOST_ALONE)},
        ),
    ),
    lists={
        COMMAND_TOPICS: "Topic filters, beside control/#, below which a publication commands the plant.",
        RETAINED: "Messages that other programs have retained on the broker before the adapter comes, each as TOPIC=PAYLOAD.",
    },
    declares=declares,
    presets=presets,
    covers=lambda name, kept, asked: name == "filter" and covers(str(kept), str(asked)),
    framing=Framing(frame_length=packet_length, conversation=MqttConversation),
    unsolicited=no_command,
    changes=messages,
    carried_out=kept_or_executed,
    again=delivered_again,
    describe=describe,
    facts=facts,
    stamps=stamps,
    mock="mqtt",
    clients="an MQTT client, version 3.1.1 or 5",
    simulators={
        "sparkplug": Simulator(
            clients="MQTT clients of the broker that it joins",
            options={"broker": ("URL", "mqtt://host:port that the edge node of sparkplug joins")},
        ),
    },
    tasks="pytest_otmcp.conformance.tasks.mqtt",
    onboarding="pytest_otmcp.onboarding.packs.mqtt",
    recognise=re.compile(r"mqtt|sparkplug", re.IGNORECASE),
    envelope_names=("mqtt", "sparkplug-b"),
    packages=("paho-mqtt", "protobuf"),
    colour=Colour(light="#009e73", dark="#2fc79a"),
    external=EXTERNAL,
    events=("BURST", "WILL"),
    session_oracles=(Publications, Refused, Subscriptions, SparkplugSequence, Births, HostState, Exchanges),
    proof=PROOF,
    exercise=EXERCISE,
    always=True,
    secure=True,
    accounts=True,
    delayed=tuple({"packet": kind} for kind in ("PUBLISH", "SUBSCRIBE", "UNSUBSCRIBE", "PINGREQ")),
)
