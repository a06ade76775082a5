"""The name of the package of the shipped suite. The suite imports the kit, so the kit finds the suite by its name."""

from __future__ import annotations

__all__ = ["SUITE"]

SUITE = f"{__package__.partition('.')[0]}.conformance"
"""The package of the shipped suite."""
