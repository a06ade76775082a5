"""All honest adapters, by name."""

from __future__ import annotations

from collections.abc import Mapping

from . import (
    bacnet_choices,
    bounds_choices,
    callers_choices,
    commands_choices,
    dnp3_choices,
    ethercat_choices,
    ethernetip_choices,
    mcp_choices,
    modbus_choices,
    mqtt_choices,
    opcua_choices,
    profibus_choices,
    profinet_choices,
    s7_choices,
    security_choices,
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
        ("ethercat", ethercat_choices.CHOICES),
        ("profinet", profinet_choices.CHOICES),
        ("texts", text_choices.CHOICES),
        ("bounds", bounds_choices.MODBUS),
        ("bounds", bounds_choices.MQTT),
        ("bounds", bounds_choices.OPCUA),
        ("security", security_choices.MODBUS),
        ("security", security_choices.MQTT),
        ("security", security_choices.OPCUA),
        ("security", security_choices.S7),
        ("callers", callers_choices.MODBUS),
        ("callers", callers_choices.MQTT),
        ("callers", callers_choices.DNP3),
        ("commands", commands_choices.MODBUS),
        ("commands", commands_choices.MQTT),
    )
    for name, choice in declared.items()
}
