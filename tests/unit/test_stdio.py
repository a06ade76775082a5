"""The transport over standard input and output: whatever ends a session, nothing of it goes on."""

from __future__ import annotations

import asyncio
import os
import sys
from typing import Any

import anyio
import pytest

from pytest_otmcp.session.frames import FrameRecorder
from pytest_otmcp.session.stdio import StdioTransport

pytestmark = pytest.mark.asyncio
PATIENCE_S = 20.0


async def test_a_session_that_is_cancelled_while_its_process_is_ended_leaves_no_task_and_no_open_stream() -> None:
    stays = (sys.executable, "-c", "import time; time.sleep(600)")
    transport = StdioTransport(stays, dict(os.environ), None, FrameRecorder(), exit_grace_s=0.5)
    opened: asyncio.Future[Any] = asyncio.get_running_loop().create_future()

    async def hold() -> None:
        async with transport.streams() as streams:
            opened.set_result(streams)
            await asyncio.Event().wait()

    session = asyncio.create_task(hold())
    async with asyncio.timeout(PATIENCE_S):
        reader, writer = await opened
        session.cancel()
        # It begins to wait for the end of the process, which does not come.
        await asyncio.sleep(0)
        assert not session.done()
        session.cancel()
        with pytest.raises(asyncio.CancelledError):
            await session
        names = {task.get_name() for task in asyncio.all_tasks()}
        assert not names & {"otmcp-pump-in", "otmcp-pump-out", "otmcp-watch"}
        with pytest.raises(anyio.ClosedResourceError):
            await reader.receive()
        with pytest.raises(anyio.ClosedResourceError):
            await writer.send(None)
        await transport.stop()
