"""The user's broker in the place of the mock."""

from __future__ import annotations

from ..external import BROKER, ExternalDevice

__all__ = ["EXTERNAL"]

EXTERNAL = ExternalDevice(
    option=BROKER,
    scheme="mqtt",
    default_port=1883,
    noun="MQTT broker",
    implementation="pytest_otmcp.plant.mqtt_broker:TappedBroker",
)
