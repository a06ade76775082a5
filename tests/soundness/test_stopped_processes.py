"""A process that is stopped for a while, as a busy machine does it, is held against no adapter."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from pathlib import Path

import pytest

from pytest_otmcp.session.session import McpSession

from .conftest import Judge, failing, words

STOPPED_S = 1.2
"""Seconds for which a process is stopped: more than any check allows for what is not a call."""


def reference(protocol: str) -> tuple[str, ...]:
    return (sys.executable, "-P", "-m", "pytest_otmcp.reference_adapters", protocol)


def stop(pid: int) -> None:
    """Stop a process, and let it go on after a while."""
    os.kill(pid, signal.SIGSTOP)
    asyncio.get_running_loop().call_later(STOPPED_S, os.kill, pid, signal.SIGCONT)


def adapter_of(session: McpSession) -> int:
    """Return the process that a session's watcher has started."""
    (adapter,) = Path(f"/proc/{session.pid}/task/{session.pid}/children").read_text(encoding="ascii").split()
    return int(adapter)


@pytest.mark.long
def test_a_list_of_tools_that_is_late_for_another_reason_is_not_held_up(
    judge: Judge, monkeypatch: pytest.MonkeyPatch
) -> None:
    genuine = McpSession.list_anew
    stopped = []

    async def stopping(session: McpSession, *, timeout_s: float) -> str:
        stopped.append(adapter_of(session))
        stop(stopped[-1])
        return await genuine(session, timeout_s=timeout_s)

    monkeypatch.setattr(McpSession, "list_anew", stopping)
    results = judge("modbus", command=reference("modbus"), tasks="CON-005.modbus")
    assert stopped
    assert failing(results) == set(), words(results)
