"""Re-export of :mod:`pytest_otmcp.core.errors`, the documented import path."""

from .core.errors import KitError, SubjectError, UsageError

__all__ = ["KitError", "SubjectError", "UsageError"]
