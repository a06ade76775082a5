"""Devices of the user in the place of a protocol's mock, and the command line options that ask for them.

A protocol that allows this keeps its :class:`ExternalDevice` in a module ``external`` of its package: every pytest run in
whose environment the plugin is installed declares the options, so they must be known without loading the protocols.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.util import find_spec

from .own import OWN

__all__ = ["ExternalDevice", "external_devices"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ExternalDevice:
    """A device of the user that can take the mock's place, behind the kit's tap.

    Attributes:
        option: name of the command line option, without ``--otmcp-``.
        meaning: its help text.
        scheme: of the URL that it takes.
        default_port: the port where the URL names none.
        noun: name of such a device in sentences, such as "MQTT broker".
        implementation: ``module:class`` of the device; the class takes the URL.
    """

    option: str
    meaning: str
    scheme: str
    default_port: int
    noun: str
    implementation: str


@cache
def external_devices() -> Mapping[str, ExternalDevice]:
    """Return the external devices of the kit's own protocols whose mock can be replaced, by the protocol's key."""
    modules = {key: f"{__package__}.{key}.external" for key in OWN}
    return {key: import_module(name).EXTERNAL for key, name in modules.items() if find_spec(name) is not None}
