"""A page of the kit as HTML: one file that needs only a browser, and no network. Pure.

Texts of an adapter are shown, never interpreted: jinja2 escapes every value, letters that do not print are replaced by
their escapes, and the page's Content-Security-Policy allows one style sheet, known by its hash, and nothing else: no
script, no request.
"""

from __future__ import annotations

import base64
import hashlib
import re
from importlib import resources
from typing import Any

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup, escape

from .families import style_sheet
from .text import clipped, printable

__all__ = ["filled"]

_CODE = re.compile(r"`([^`]+)`")
_LONGEST = 4_000
"""Letters of one value on the page at most."""


def filled(name: str, **values: Any) -> str:
    """Return the page that the template ``name`` of this package makes of these values.

    The template gets ``style`` and ``style_hash`` besides.
    """
    style = _resource("report.css") + style_sheet()
    # The template is the kit's, the values come from outside: every value is escaped.
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, finalize=_shown, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["worded"] = _worded
    html: str = environment.from_string(_resource(name)).render(
        style=Markup(style),  # noqa: S704  (our own file, and the colours of the protocols)
        style_hash=base64.b64encode(hashlib.sha256(style.encode()).digest()).decode(),
        **values,
    )
    return html


def _resource(name: str) -> str:
    return (resources.files(__package__) / name).read_text(encoding="utf-8")


def _worded(text: str) -> Markup:
    """Return a sentence of the kit's own, escaped, with what stands between backticks as code."""
    return Markup(_CODE.sub(r"<code>\1</code>", str(escape(text))))  # noqa: S704


def _shown(value: object) -> Any:
    if not isinstance(value, str) or isinstance(value, Markup):
        return value
    return printable(clipped(value, _LONGEST), keep="\n\t")
