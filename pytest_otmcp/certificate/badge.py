"""The badge of a certificate: the JSON from which shields.io draws it, and a small picture that the kit draws. Pure.

Schema of the JSON: https://shields.io/badges/endpoint-badge.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from xml.sax.saxutils import escape, quoteattr

from ..protocols.registry import protocols

__all__ = ["badge", "badge_svg"]

_LABEL = "OT-MCP conformance"
_COLOUR = "#1a7f37"
_LETTER = 6.6
"""Pixels of an average letter of an 11 pixel sans serif font; ``textLength`` makes any font fit."""
_PADDING = 7


def badge(certificate: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of ``badge.json``: the protocols, each with its level where one is awarded, how many items passed, of how many that
    there are about them, how many of these do not apply, and the version of the catalogue of requirements."""
    told = certificate["predicate"]["otmcp"]
    passed, of = (sum(count[name] for count in told["items"].values()) for name in ("passed", "of"))
    awarded = told["level"]["awarded"] or {}
    named = [
        protocols()[protocol].name + (f" {level.capitalize()}" if (level := awarded.get(protocol)) else "")
        for protocol in told["adapters"]
    ]
    message = "conformant: " + ", ".join(named)
    others = of - passed
    inapplicable = f", {others} {'does' if others == 1 else 'do'} not apply" if others else ""
    message += f" ({passed} of {of} items{inapplicable}, catalogue {told['catalogue']})"
    return {"schemaVersion": 1, "label": _LABEL, "message": message, "color": _COLOUR.removeprefix("#")}


def badge_svg(certificate: Mapping[str, Any]) -> str:
    """Draw the badge, with a title that a screen reader reads."""
    shown = badge(certificate)
    adapters = certificate["predicate"]["otmcp"]["adapters"]
    deadlines = ", ".join(f"{protocol} {facts['deadline_s']:g} s" for protocol, facts in adapters.items())
    title = (
        f"{shown['label']}: {shown['message']} ({certificate['subject'][0]['name']}; deadlines of a call: {deadlines})"
    )
    title = "".join(letter if letter.isprintable() else " " for letter in title)
    left, right = (_width(shown[side]) for side in ("label", "message"))
    width = left + right
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="20" viewBox="0 0 {width} 20" '
        f'role="img" aria-label={quoteattr(title)}>\n'
        f"<title>{escape(title)}</title>\n"
        f'<clipPath id="r"><rect width="{width}" height="20" rx="3"/></clipPath>\n'
        f'<g clip-path="url(#r)"><rect width="{left}" height="20" fill="#444"/>'
        f'<rect x="{left}" width="{right}" height="20" fill="{_COLOUR}"/></g>\n'
        '<g fill="#fff" font-family="Verdana,DejaVu Sans,Geneva,sans-serif" font-size="11">\n'
        f"{_text(shown['label'], 0, left)}{_text(shown['message'], left, right)}</g>\n"
        "</svg>\n"
    )


def _width(text: str) -> int:
    return round(len(text) * _LETTER) + 2 * _PADDING


def _text(text: str, x: int, width: int) -> str:
    return f'<text x="{x + _PADDING}" y="14" textLength="{width - 2 * _PADDING}">{escape(text)}</text>\n'
