"""Re-export of :mod:`pytest_otmcp.plugin.fixtures.session_handles`, the documented import path."""

from .plugin.fixtures.session_handles import *  # noqa: F403
from .plugin.fixtures.session_handles import __all__ as __all__
