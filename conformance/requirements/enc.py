"""ENC: values in registers, nodes and payloads."""

from __future__ import annotations

from pytest_otmcp.trial.check import Checks

__all__ = ["TASKS"]

TASKS = Checks()
