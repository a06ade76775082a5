"""All honest adapters, by name."""

from __future__ import annotations

from collections.abc import Mapping

from . import (
    bacnet_choices,
    bounds_choices,
    commands_choices,
    dnp3_choices,
    ethernetip_choices,
    mcp_choices,
    modbus_choices,
    mqtt_choices,
    opcua_choices,
    profibus_choices,
    s7_choices,
    text_choices,
)
from .choice import Choice

__all__ = ["ZOO"]

ZOO: Mapping[str, Choice] = {
    f"{group}/{name}": choice
    for group, declared in (
        ("mcp", mcp_choices.CHOICES),
        ("modbus", modbus_choices.CHOICES),
        ("mqtt", mqtt_choices.CHOICES),
        ("opcua", opcua_choices.CHOICES),
        ("s7", s7_choices.CHOICES),
        ("dnp3", dnp3_choices.CHOICES),
        ("bacnet", bacnet_choices.CHOICES),
        ("ethernetip", ethernetip_choices.CHOICES),
        ("profibus", profibus_choices.CHOICES),
        ("texts", text_choices.CHOICES),
        ("bounds", bounds_choices.MODBUS),
        ("bounds", bounds_choices.MQTT),
        ("bounds", bounds_choices.OPCUA),
        ("commands", commands_choices.MODBUS),
        ("commands", commands_choices.MQTT),
    )
    for name, choice in declared.items()
}
