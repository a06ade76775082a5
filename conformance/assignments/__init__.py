"""The tasks in words by which assistants are measured with an adapter: a module for each protocol, one for several at once.

Each value is a new one in every try, so that an answer from memory is wrong; each task asks for a trace that doing nothing does not leave.
"""

from __future__ import annotations

from importlib import import_module

from pytest_otmcp.trial.assignment import Assignment

__all__ = ["assignments"]

_MODULES = ("modbus", "mqtt", "opcua", "cross")


def assignments() -> list[Assignment]:
    """Return every assignment, in the order of reports."""
    return [one for name in _MODULES for one in import_module(f"{__name__}.{name}").ASSIGNMENTS]
