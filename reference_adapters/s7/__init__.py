"""The S7comm adapter: 20 tools over one connection to a controller.

Environment: ``S7_HOST``, ``S7_PORT`` (102), ``S7_RACK`` (0), ``S7_SLOT`` (1), ``S7_TIMEOUT_S`` (1, per exchange), ``S7_DEADLINE_S`` (3,
per call), ``S7_WRITES_ENABLED`` (no), ``S7_CONTROL_ENABLED`` (no; starting and stopping the CPU needs both), ``S7_TAG_MAP`` (a JSON
file, see ``tags``).
"""

from __future__ import annotations

from .adapter import build

__all__ = ["build"]
