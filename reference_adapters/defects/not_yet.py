"""Defects of the catalogue that nobody notices yet, by what it takes to notice them."""

from __future__ import annotations

from collections.abc import Mapping

__all__ = ["GROUPS", "NOT_YET", "TOTAL"]

TOTAL = 132
"""Defects in the catalogue: MU-01 to MU-132."""

GROUPS: Mapping[str, str] = {
    "A": "what shows it happens today, and nobody looks",
    "B": "arguments that must be refused, and those at a bound",
    "C": "faults that the mock devices can already make",
    "D": "a device that is silent",
    "E": "operations that no task performs",
    "F": "special values and shapes",
    "G": "start and end of adapter and device",
    "H": "long runs",
    "I": "means of security that neither kit nor subject file have",
    "J": "a second unit or endpoint",
    "K": "a watch of more than a few seconds",
}

NOT_YET: Mapping[str, Mapping[str, str]] = {
    "A": {},
    "B": {},
    "C": {},
    "D": {},
    "E": {},
    "F": {},
    "G": {},
    "H": {},
    "I": {
        "MU-110": "The switch against all writes is read once.",
    },
    "J": {},
    "K": {"MU-29c": "A publish that failed is made up for 20 seconds later."},
}
"""Group to id to what such an adapter does. Other variants of the same defect may be noticed."""
