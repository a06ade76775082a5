"""An MQTT broker with a Sparkplug B edge node: the default broker of the kit, so that nothing has to be installed."""

from __future__ import annotations

from .device import MqttDevice

__all__ = ["create", "warm"]


def warm() -> None:
    """The imports above are what is slow."""


def create() -> MqttDevice:
    """A fresh broker and edge node."""
    return MqttDevice()
