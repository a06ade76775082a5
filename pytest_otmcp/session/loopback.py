"""A server of the kit's own over HTTP, for this machine alone."""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import uvicorn
from starlette.types import ASGIApp

__all__ = ["HOST", "serving"]

HOST = "127.0.0.1"


@asynccontextmanager
async def serving(application: ASGIApp, at: socket.socket, *, name: str) -> AsyncIterator[asyncio.Task[None]]:
    """Serve an application as long as the block lasts, and yield the task that does.

    Args:
        at: bound to the loopback interface.
        name: of the task.
    """
    config = uvicorn.Config(
        application,
        lifespan="off",
        ws="none",
        http="h11",
        log_config=None,
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=1,
    )
    server = uvicorn.Server(config)
    task = asyncio.create_task(server.serve(sockets=[at]), name=name)
    try:
        yield task
    finally:
        # What is still asked for at the end is broken off, which uvicorn would tell as an error with a traceback.
        logging.getLogger("uvicorn.error").disabled = True
        server.should_exit = True
        await asyncio.wait({task})
