"""A function that ``pyprofibus-linuxcnc-hal`` 1.13 forgets to import, and that it needs for ``--watchdog off``."""

from __future__ import annotations

import builtins


def str2bool(word: str) -> bool:
    """Tell whether an option is on."""
    return word == "on"


builtins.str2bool = str2bool  # type: ignore[attr-defined]
