"""Devices of the user in the place of a protocol's mock, and the command line options that ask for them.

A protocol that allows this keeps its :class:`ExternalDevice` in a module ``external`` of its package: every pytest run in
whose environment the plugin is installed declares the options, so they must be known without loading the protocols.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from .own import OWN

__all__ = ["BROKER", "DEVICE", "ExternalDevice", "external_devices", "in_url", "is_number", "used"]

BROKER = "broker"
"""The option for a broker: it is the plant's notice board, so tasks publish on it and take it away as they do with the mock."""

DEVICE = "device"
"""The option for a real device, which is only read unless a person consents; its value has the protocol's key before the URL."""


def is_number(text: str) -> bool:
    """Tell whether a text is a number of 16 bits."""
    return text.isdecimal() and int(text) <= 0xFFFF


def in_url(host: str) -> str:
    """Return a host as a URL has it: an address of IPv6 in brackets."""
    return f"[{host}]" if ":" in host else host


@dataclass(frozen=True, slots=True, kw_only=True)
class ExternalDevice:
    """A device of the user that can take the mock's place, behind the kit's tap.

    Attributes:
        option: name of the command line option, without ``--otmcp-``: :data:`BROKER` or :data:`DEVICE`.
        scheme: of the URL that it takes.
        default_port: the port where the URL names none.
        noun: name of such a device in sentences, such as "MQTT broker".
        implementation: ``module:class`` of the device; the class takes the URL, and that of a real device the consent, or None.
        is_place: tells whether a text may follow behind the port of a real device, to say where it is read.
    """

    option: str
    scheme: str
    default_port: int
    noun: str
    implementation: str
    is_place: Callable[[str], bool] = is_number


@cache
def external_devices() -> Mapping[str, ExternalDevice]:
    """Return the external devices of the kit's own protocols whose mock can be replaced, by the protocol's key."""
    modules = {key: f"{__package__}.{key}.external" for key in OWN}
    return {key: import_module(name).EXTERNAL for key, name in modules.items() if find_spec(name) is not None}


def used(settings: Mapping[str, Any]) -> Iterator[tuple[str, ExternalDevice, str]]:
    """Yield key, kind and URL of each device of the user's own that a run had, from the settings of its record."""
    devices = settings.get("devices", {})
    for key, device in external_devices().items():
        if device.option == DEVICE and key in devices:
            yield key, device, devices[key]["url"]
        elif device.option != DEVICE and (url := settings.get(device.option, "embedded")) != "embedded":
            yield key, device, url
