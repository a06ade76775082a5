"""A mock whose only endpoint is a pseudo terminal."""

from __future__ import annotations

from pytest_otmcp.mocks.endpoint import Endpoint

from .latches import create, warm

__all__ = ["ENDPOINTS", "create", "warm"]

ENDPOINTS = (Endpoint(name="line", kind="pty"),)
