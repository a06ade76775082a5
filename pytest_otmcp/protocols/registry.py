"""The registry of protocols: the kit's own in an explicit list, then those that installed packages register.

A package registers a protocol by an entry point of the group ``pytest_otmcp.protocols``: the entry point's name is the
protocol's key, its value an :class:`~pytest_otmcp.protocols.protocol.OtProtocol`. The oracles of such a protocol judge, so
records and certificates name it with its version and digest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from importlib import import_module, metadata
from types import MappingProxyType

from ..core.digest import files_digest
from ..core.errors import UsageError
from .own import OWN
from .protocol import Origin, OtProtocol

__all__ = ["GROUP", "OWN", "envelope_names", "protocol_keys", "protocols"]

GROUP = "pytest_otmcp.protocols"
"""The entry-point group by which a package registers a protocol."""


def protocol_keys() -> tuple[str, ...]:
    """Return the keys of all protocols, without loading any."""
    return (*OWN, *sorted(point.name for point in metadata.entry_points(group=GROUP)))


@cache
def protocols() -> Mapping[str, OtProtocol]:
    """Load every protocol, by key, in the order of tables and figures.

    Raises:
        UsageError: a registered protocol cannot be loaded, is not a protocol, or has the key of another one.
    """
    found: dict[str, OtProtocol] = {}
    for key in OWN:
        found[key] = import_module(f"{__package__}.{key}.description").PROTOCOL
    for point in sorted(metadata.entry_points(group=GROUP), key=lambda point: point.name):
        if point.name in found:
            raise UsageError(f"{_source(point)}: there is a protocol {point.name!r} already")
        found[point.name] = _registered(point)
    return MappingProxyType(found)


@cache
def envelope_names() -> tuple[str, ...]:
    """Return the values that ``meta.protocol`` of an envelope may have."""
    return tuple(name for protocol in protocols().values() for name in protocol.envelope_names or (protocol.key,))


def _registered(point: metadata.EntryPoint) -> OtProtocol:
    try:
        protocol = point.load()
    except Exception as error:
        raise UsageError(f"{_source(point)}: cannot be loaded ({type(error).__name__}: {error})") from error
    if not isinstance(protocol, OtProtocol) or protocol.key != point.name:
        raise UsageError(f"{_source(point)}: expected an OtProtocol with the key {point.name!r}, found {protocol!r}")
    distribution = point.dist
    origin = Origin(
        distribution=None if distribution is None else distribution.name,
        version=None if distribution is None else distribution.version,
        digest=files_digest(protocol.package),
    )
    return replace(protocol, origin=origin)


def _source(point: metadata.EntryPoint) -> str:
    package = "an unknown package" if point.dist is None else f"{point.dist.name} {point.dist.version}"
    return f"the protocol {point.name!r} that {package} registers ({GROUP})"
