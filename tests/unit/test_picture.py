"""The README's picture of a run needs nothing from a network and tells nothing of the machine that made it."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

PICTURE = Path(__file__).parents[2] / "docs" / "images" / "run.svg"


def test_the_picture_loads_nothing_and_shows_an_adapter_being_caught() -> None:
    source = PICTURE.read_text(encoding="utf-8")
    assert "@font-face" not in source
    assert not re.search(r"(?:href|src|url\()", source)
    assert re.findall(r"https?://[^\"]*", source) == ["http://www.w3.org/2000/svg"]
    texts = [text for text in ElementTree.fromstring(source).itertext() if text.strip()]
    assert any(text.startswith("VERDICT:\N{NO-BREAK SPACE}NOT") for text in texts)
    assert not re.search(r"/(?:home|root|work|tmp|usr)/", source)


def test_the_picture_is_a_screen_and_not_a_scroll() -> None:
    rows = set(re.findall(r' y="([\d.]+)"', PICTURE.read_text(encoding="utf-8")))
    assert 15 < len(rows) <= 30
