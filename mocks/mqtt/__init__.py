"""An MQTT broker with a Sparkplug B edge node: the default broker of the kit, so that nothing has to be installed."""

from __future__ import annotations

from ..endpoint import Endpoint
from .device import MqttDevice

__all__ = ["ENDPOINTS", "create", "warm"]

ENDPOINTS = (Endpoint(name="mqtt", kind="tcp"),)


def warm() -> None:
    """Do nothing: the imports above are what is slow."""


def create() -> MqttDevice:
    """Return a fresh broker and edge node."""
    return MqttDevice()
