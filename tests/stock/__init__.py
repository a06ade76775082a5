"""Adapters made with stock parts, in Python and in TypeScript."""

from __future__ import annotations

import os

import pytest

__all__ = ["EVERY_ADAPTER"]

EVERY_ADAPTER = pytest.mark.skipif(
    "OTMCP_EVERY_STOCK_ADAPTER" not in os.environ,
    reason="OTMCP_EVERY_STOCK_ADAPTER=1 runs every stock adapter in both forms, two to five minutes each",
)
