"""The alias map: names for tags of the controller.

A JSON object of aliases, for instance::

    {"valve": {"tag": "ValvePosition", "unit": "%", "writable": true}}

The type is the controller's. An alias can be written where it says so.
"""

from __future__ import annotations

from ..core import Named
from .shapes import TagName

__all__ = ["Alias"]


class Alias(Named):
    """One named tag."""

    tag: TagName
