"""A function that feeds session oracles in tests."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, TypeVar, cast

from pytest_otmcp.protocols.journal import JournalEntry
from pytest_otmcp.protocols.session_oracle import SessionOracle

__all__ = ["fed"]

Oracle = TypeVar("Oracle", bound=SessionOracle)


def fed(oracle: Oracle, entries: Iterable[Any]) -> Oracle:
    """Feed these entries to the oracle, and return it."""
    for entry in entries:
        oracle.feed(cast(JournalEntry, entry))
    return oracle
