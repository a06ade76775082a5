"""Where a subject file tells an adapter which device it is to talk to. Pure."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence

from ..protocols.registry import protocols
from .kinds import Refusal
from .model import Adapter, Binding, Connect, Function

__all__ = ["addressed_by", "carries_address", "check_addresses", "mentions_address"]

_PLACEHOLDER = re.compile(r"\{(host|port|url|serial|interface|device_mac|device_ip|\w+_port)(:int)?\}")
_NO_DEVICE = re.compile(r"\{(http|local)_port\}")
"""The adapter's own ports."""

_LITERAL = re.compile(r"[a-z][a-z0-9+.-]*://\S+|(\d{1,3}\.){3}\d{1,3}(:\d+)?|localhost(:\d+)?", re.IGNORECASE)
_NAMES_A_DEVICE = re.compile(
    r"(^|_)(host|hostname|ip|address|url|uri|endpoint|broker|server|conn|connection|connection_string|target)$",
    re.IGNORECASE,
)


def mentions_address(value: object) -> bool:
    """Tell whether a text, or any text in a template, has a placeholder for the device's address."""
    if isinstance(value, str):
        return _PLACEHOLDER.search(_NO_DEVICE.sub("", value)) is not None
    if isinstance(value, Mapping):
        return any(map(mentions_address, value.values()))
    return isinstance(value, list) and any(map(mentions_address, value))


def carries_address(arguments: object, endpoint: Mapping[str, str]) -> bool:
    """Tell whether the arguments of a call say where the device is.

    Args:
        endpoint: what the placeholders stand for, by name.
    """
    if isinstance(arguments, Mapping):
        return any(carries_address(value, endpoint) for value in arguments.values())
    if isinstance(arguments, list):
        return any(carries_address(value, endpoint) for value in arguments)
    if not isinstance(arguments, str):
        return False
    # Port 502 is not port 5020.
    address = re.escape(f"{endpoint.get('host')}:{endpoint.get('port')}")
    return arguments in endpoint.values() or re.search(rf"(?<![\w.]){address}(?!\d)", arguments) is not None


def addressed_by(adapter: Adapter) -> list[str]:
    """Return the keys below ``[adapter.KEY]`` that have placeholders for the device's address."""
    found: dict[str, None] = {}
    for variant in adapter.variants.values():
        if any(map(mentions_address, variant.command)):
            found["command"] = None
        found |= {f"env.{name}": None for name, text in variant.env.items() if mentions_address(text)}
        found |= {f"files.{name}": None for name, text in variant.files.items() if mentions_address(text)}
    if adapter.connect is not None and mentions_address(adapter.connect.arguments):
        found["connect.arguments"] = None
    for operation, binding in _bindings(adapter.operations):
        if mentions_address(binding.arguments):
            found[f"bind.{operation}.arguments"] = None
    return list(found)


def _bindings(operations: Mapping[str, tuple[Binding, ...] | Function]) -> Iterator[tuple[str, Binding]]:
    for name, bound in operations.items():
        if not isinstance(bound, Function):
            yield from ((name, binding) for binding in bound)


def check_addresses(
    protocol: str, operations: Mapping[str, tuple[Binding, ...] | Function], connect: Connect | None, key: str
) -> None:
    """Refuse writes that would go to another device than the reads that prove the session.

    Args:
        connect: where it gets the address, calls need not.
        key: of the adapter's ``bind`` table.

    Raises:
        Refusal: a tool that writes is given the address of a device literally, or no address although tools that read are.
    """
    known = protocols()[protocol].operations
    bindings = list(_bindings(operations))
    connected = connect is not None and mentions_address(connect.arguments)
    reading = next((name for name, it in bindings if not known[name].writes and mentions_address(it.arguments)), None)
    for name, binding in bindings:
        if not known[name].writes:
            continue
        for argument in _literal_addresses(binding.arguments):
            raise Refusal(
                f"{key}.{name}.arguments.{argument}",
                "names a device by itself; a write goes to the mock device and nowhere else: say {host}, {port} or {url}",
            )
        if reading is not None and not connected and not mentions_address(binding.arguments):
            raise Refusal(
                f"{key}.{name}.arguments",
                f"lacks {{host}}, {{port}} or {{url}}, which {reading} is given with each call: it would write to another device",
            )


def _literal_addresses(arguments: Mapping[str, object]) -> Sequence[str]:
    return [
        name
        for name, value in arguments.items()
        if isinstance(value, str)
        and not mentions_address(value)
        and _NAMES_A_DEVICE.search(name)
        and _LITERAL.fullmatch(value)
    ]
