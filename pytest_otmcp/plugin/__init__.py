"""The pytest plugin: hooks, options, fixtures, workers and controller of a run."""

from __future__ import annotations

from .hooks import *  # noqa: F403  (pytest looks for hooks and fixtures in the module that the entry point names)
