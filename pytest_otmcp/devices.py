"""Re-export of :mod:`pytest_otmcp.plugin.fixtures.device_handles`, the documented import path."""

from .plugin.fixtures.device_handles import *  # noqa: F403
from .plugin.fixtures.device_handles import __all__ as __all__
