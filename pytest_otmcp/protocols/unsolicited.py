"""Unsolicited commands: a device must not receive any while the adapter is asked for nothing. Pure.

An adapter that keeps a command which it has reported as failed, and delivers it when it can, may do so at any time. So the
journal is read between the items as well.
"""

from __future__ import annotations

from ..core.finding import Finding
from .journal import Entries, judged
from .protocol import Declared
from .registry import protocols

__all__ = ["nothing_commanded"]


def nothing_commanded(protocol: str, entries: Entries, declared: Declared) -> list[Finding]:
    """Expect that the adapter sent the device of ``protocol`` nothing that commands the plant."""
    return protocols()[protocol].unsolicited(judged(entries), declared)
