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
_SHORT = 1_000
"""Letters of a finding on a card."""


def filled(name: str, /, *, folder: str = __package__, more_style: str = "", **values: Any) -> str:
    """Return the page that the template ``name`` makes of these values.

    The template gets ``style`` and ``style_hash`` besides.

    Args:
        folder: the package of the template.
        more_style: a style sheet of its own, beyond that of all pages.
        values: what the template names.
    """
    style = _resource("report.css") + style_sheet() + more_style
    # The template is the kit's, the values come from outside: every value is escaped.
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, finalize=_shown, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["worded"] = _worded
    environment.filters["short"] = lambda text: clipped(text, _SHORT)
    html: str = environment.from_string(_resource(name, folder)).render(
        style=Markup(style),  # noqa: S704  (our own file, and the colours of the protocols)
        style_hash=base64.b64encode(hashlib.sha256(style.encode()).digest()).decode(),
        **values,
    )
    return html


def _resource(name: str, folder: str = __package__) -> str:
    return (resources.files(folder) / name).read_text(encoding="utf-8")


def _worded(text: str) -> Markup:
    """Return a sentence of the kit's own, escaped, with what stands between backticks as code."""
    return Markup(_CODE.sub(r"<code>\1</code>", str(escape(text))))  # noqa: S704


def _shown(value: object) -> Any:
    if not isinstance(value, str) or isinstance(value, Markup):
        return value
    return printable(clipped(value, _LONGEST), keep="\n\t")
