"""What the kit adds to an entry of ``tools/list``."""

from __future__ import annotations

__all__ = ["TWICE"]

TWICE = "otmcp:twice"
"""Member of an entry if another one has the same name: ``alike`` if it says the same, else ``other``."""
