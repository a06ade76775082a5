"""Finds placeholders that are misspelt: a text such as ``{hots}`` would reach the adapter as it is. Pure."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator, Mapping

from .kinds import Refusal

__all__ = ["check_placeholders"]

_KNOWN = (
    *("host", "port", "url", "serial", "interface", "device_mac", "device_ip"),
    *("python", "kit_version", "dir", "work", "http_port", "local_port", "audience"),
)
_BRACED = re.compile(r"\{(\w+)(?::int)?\}")
_NEAR = 0.7
"""Braces may mean something to the adapter: only what is almost a placeholder is taken for one."""


def check_placeholders(value: object, key: str, inputs: tuple[str, ...] = ()) -> None:
    """Refuse texts with misspelt placeholders, anywhere in a template.

    Args:
        key: dotted path of the value.
        inputs: names of an operation's inputs, which are written with a dollar sign.

    Raises:
        Refusal: a placeholder is almost one of those that the kit replaces.
    """
    for path, text in _texts(value, key):
        for name in _BRACED.findall(text):
            if name in _KNOWN or name.endswith("_port"):
                continue
            if name in inputs:
                raise Refusal(path, f'{{{name}}} is not replaced; the input is written "${name}"')
            if near := difflib.get_close_matches(name.lower(), _KNOWN, 1, _NEAR):
                raise Refusal(path, f"{{{name}}} is not replaced; did you mean {{{near[0]}}}?")


def _texts(value: object, key: str) -> Iterator[tuple[str, str]]:
    if isinstance(value, str):
        yield key, value
    elif isinstance(value, Mapping):
        for name, member in value.items():
            yield from _texts(member, f"{key}.{name}")
    elif isinstance(value, list | tuple):
        for index, member in enumerate(value):
            yield from _texts(member, f"{key}[{index}]")
