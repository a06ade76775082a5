"""Puts a try to an assistant that is a command: any program that reads a task and speaks MCP.

The command's standard input is the task. ``OTMCP_MCP_CONFIG`` is the path of an ``mcp.json`` with a server for each adapter, and
``OTMCP_MCP_URL`` and ``OTMCP_MCP_TOKEN`` are for programs that speak HTTP alone; where there are several adapters, ``OTMCP_MCP_URL`` has the
addresses with spaces between them. In the command ``{prompt}``, ``{config}`` and ``{url}`` are replaced. Its standard output is the answer.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import IO

from ..core.errors import UsageError
from ..session.keeping import Watcher
from ..session.process import subject_environment
from .campaign import Asked, Told
from .place import Try
from .served import Served, serve

__all__ = ["Command"]

_MOST_OUTPUT = 1 << 20
_KEPT_STDERR = 2000
_SETTLE_S = 1.0


class Command:
    """An assistant that is a command.

    Args:
        command: argument vector; no shell is involved.
        passed: names of variables of this process that the command gets; of the others it gets a short list.
        deadline_s: seconds after which it is ended.
    """

    def __init__(self, command: Sequence[str], passed: Sequence[str], deadline_s: float) -> None:
        self._command = command
        self._passed = {name: os.environ[name] for name in passed if name in os.environ}
        self._deadline_s = deadline_s

    async def __call__(self, asked: Asked, under_way: Try) -> Told:
        """Run the command for one try.

        Raises:
            UsageError: it cannot be started.
            KitError: no process can be started.
        """
        async with serve(under_way.relays) as served:
            with tempfile.TemporaryDirectory(prefix="otmcp-") as folder:
                config = _written(Path(folder, "mcp.json"), served)
                return await self._run(asked.prompt, config, " ".join(served.urls.values()), served.token)

    async def _run(self, prompt: str, config: Path, url: str, token: str) -> Told:
        values = {"{prompt}": prompt, "{config}": str(config), "{url}": url}
        words = [_replaced(word, values) for word in self._command]
        env = {"OTMCP_MCP_CONFIG": str(config), "OTMCP_MCP_URL": url, "OTMCP_MCP_TOKEN": token, **self._passed}
        said, errors = _Kept(), _Kept()
        with ExitStack() as theirs:
            task = theirs.enter_context(tempfile.TemporaryFile())
            task.write(prompt.encode())
            task.seek(0)
            output = [theirs.enter_context(await kept.opened()) for kept in (said, errors)]
            try:
                # Below a watcher: whatever a command starts may leave its session, and keep its output open.
                watcher = await Watcher.start(
                    words,
                    env=subject_environment(env),
                    cwd=None,
                    streams=[task.fileno(), *(file.fileno() for file in output)],
                )
            except OSError as error:
                raise UsageError(f"{words[0]!r} cannot be run: {error.strerror}") from None
        problem = ""
        try:
            async with asyncio.timeout(self._deadline_s):
                await watcher.exited.wait()
        except TimeoutError:
            problem = f"ended after {self._deadline_s:g} s"
        finally:
            await watcher.close()
        await said.closed()
        await errors.closed()
        if not problem and watcher.returncode:
            problem = f"exit code {watcher.returncode}: {errors.text[-_KEPT_STDERR:].strip()}"
        return Told(answer=said.text, problem=problem)


class _Kept(asyncio.Protocol):
    """What is printed by a process, as much of it as is kept."""

    def __init__(self) -> None:
        self._data = bytearray()
        self._end = asyncio.Event()
        self._transport: asyncio.BaseTransport | None = None

    async def opened(self) -> IO[bytes]:
        """Return the end of a pipe that the process is to write to."""
        read, write = os.pipe()
        file = os.fdopen(write, "wb", 0)
        self._transport, _ = await asyncio.get_running_loop().connect_read_pipe(lambda: self, os.fdopen(read, "rb", 0))
        return file

    def data_received(self, data: bytes) -> None:
        self._data += data[: max(0, _MOST_OUTPUT - len(self._data))]

    def connection_lost(self, exc: Exception | None) -> None:
        self._end.set()

    async def closed(self) -> None:
        """Read what is left; whoever else may have been handed the pipe is not waited for long."""
        with suppress(TimeoutError):
            await asyncio.wait_for(self._end.wait(), _SETTLE_S)
        if self._transport is not None:
            self._transport.close()

    @property
    def text(self) -> str:
        return self._data.decode("utf-8", "replace")


def _written(path: Path, served: Served) -> Path:
    servers = {
        key: {
            "type": "stdio",
            "command": sys.executable,
            "args": ["-P", "-m", f"{__package__}.shim"],
            "env": {"OTMCP_RELAY": url, "OTMCP_RELAY_TOKEN": served.token},
        }
        for key, url in served.urls.items()
    }
    path.write_text(json.dumps({"mcpServers": servers}), encoding="utf-8")
    return path


def _replaced(word: str, values: Mapping[str, str]) -> str:
    # One at a time and once: a prompt may itself have braces.
    name = next((name for name in values if name in word), None)
    return word if name is None else word.replace(name, values[name], 1)
