"""A mock that ends at once, after a hundred megabytes on standard error."""

from __future__ import annotations

import os
import sys

from pytest_otmcp.mocks.endpoint import Endpoint

__all__ = ["ENDPOINTS", "create", "warm"]

ENDPOINTS = (Endpoint(name="port", kind="tcp"),)


def warm() -> None:
    """Talk, and end."""
    for _ in range(100):
        os.write(2, b"all is well\n" * 90_000)
    sys.exit("the spindle has stopped")


def create() -> None:
    """It never comes to this."""
