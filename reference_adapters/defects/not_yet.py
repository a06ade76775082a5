"""Defects of the catalogue that nobody notices yet, by what it takes to notice them."""

from __future__ import annotations

from collections.abc import Mapping

__all__ = ["GROUPS", "NOT_YET", "TOTAL"]

TOTAL = 130
"""Defects in the catalogue: MU-01 to MU-129."""

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
    "A": {
        "MU-114": "Over HTTP any Origin is accepted, from any network.",
    },
    "B": {},
    "C": {},
    "D": {},
    "E": {},
    "F": {},
    "G": {},
    "H": {},
    "I": {
        "MU-94": "An argument names another host.",
        "MU-95": "An argument grants a role.",
        "MU-96": "A broker that is to be reached by TLS is reached without.",
        "MU-97": "Certificates are not verified.",
        "MU-98": "Where security cannot be agreed on, there is none.",
        "MU-100": "The audit log has successful writes alone.",
        "MU-101": "Records of the audit log can be cut off.",
        "MU-102": "A write is sent although the audit log is full.",
        "MU-103": "A line break in a topic makes a record of its own.",
        "MU-104": "An argument counts as an approval.",
        "MU-105": "An approval holds for other arguments.",
        "MU-106": "An approval holds twice.",
        "MU-110": "The switch against all writes is read once.",
    },
    "J": {},
    "K": {"MU-29c": "A publish that failed is made up for 20 seconds later."},
}
"""Group to id to what such an adapter does. Other variants of the same defect may be noticed."""
