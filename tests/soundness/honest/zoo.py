"""All honest adapters, by name."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module

from .choice import Choice

__all__ = ["ZOO"]

_GROUPS = """
    mcp modbus mqtt opcua s7 dnp3 bacnet ethernetip profibus ethercat profinet texts bounds security callers commands
""".split()

ZOO: Mapping[str, Choice] = {
    f"{group}/{name}": choice
    for group in _GROUPS
    for name, choice in import_module(f".{group}_choices", __package__).CHOICES.items()
}
