"""The subject file of the reference adapters that every run has, for tests that change it."""

from __future__ import annotations

from importlib import resources

from pytest_otmcp.protocols.registry import protocols

__all__ = ["reference_text"]


def reference_text() -> str:
    """Return the tables of the protocols that are always part of a run; in the shipped file those of further protocols come after them."""
    text = (resources.files("pytest_otmcp.subject") / "reference.toml").read_text(encoding="utf-8")
    return text[: min(text.index(f"[adapter.{key}]") for key, one in protocols().items() if not one.always)]
