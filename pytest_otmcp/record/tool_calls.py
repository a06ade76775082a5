"""How often each tool that an adapter lists was called in a run, and which ones never were. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from .schema import AdapterFacts

__all__ = ["added", "judged", "never_called"]


def added(parts: Iterable[AdapterFacts]) -> dict[str, int]:
    """Return the calls of several parts of a run together, such as two variants of an adapter: each lists tools of its own."""
    calls = Counter[str]()
    for facts in parts:
        calls.update(facts.get("calls", {}))
    return dict(sorted(calls.items()))


def judged(facts: AdapterFacts) -> list[str]:
    """Return the tools of an adapter that the run has called."""
    return [tool for tool, times in facts.get("calls", {}).items() if times]


def never_called(facts: AdapterFacts) -> list[str]:
    """Return the tools that an adapter lists and that the run has never called: it says nothing about them."""
    return [tool for tool, times in facts.get("calls", {}).items() if not times]
