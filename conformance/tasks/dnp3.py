"""The tasks on DNP3."""

from __future__ import annotations

from pytest_otmcp.trial.task import Tasks

__all__ = ["TASKS"]

TASKS = Tasks()
