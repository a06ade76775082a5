"""A JSON-RPC client on two pipes and nothing else, so that the server is measured and not a client library."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pytest_otmcp.session.process import subject_environment

__all__ = ["PipeClient"]

_ROOT = Path(__file__).resolve().parent.parent
_PATIENCE_S = 300.0
_META = {
    "io.modelcontextprotocol/protocolVersion": "2026-07-28",
    "io.modelcontextprotocol/clientCapabilities": {},
    "io.modelcontextprotocol/clientInfo": {"name": "benchmarks", "version": "0"},
}


class PipeClient:
    """A server process, run as ``python -m MODULE …``, and the pipes to it.

    Args:
        arguments: module and its arguments.
        env: variables of the server's environment besides those of the allow-list.
        join: number of a process whose network the server is in; 0 for this one's.
    """

    def __init__(self, *arguments: str, env: Mapping[str, str] | None = None, join: int = 0) -> None:
        self._name = " ".join(arguments)
        joining = ["nsenter", "-t", str(join), "-U", "-n", "--preserve-credentials"] if join else []
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115  # lives as long as the server
        self._process = subprocess.Popen(
            [*joining, sys.executable, "-m", *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._stderr,
            bufsize=0,
            cwd=_ROOT,
            env=subject_environment(env or {}),
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._in, self._out = self._process.stdin, self._process.stdout
        self._id = 0

    def discover(self) -> None:
        """Make the handshake: wait until the server answers."""
        self._request("server/discover", {})

    def call(self, tool: str, arguments: Mapping[str, Any]) -> int:
        """Call a tool; return the nanoseconds from the writing of the request until its response line has been read.

        Raises:
            RuntimeError: the call did not succeed; a failure must not be measured as a fast success.
        """
        result, took_ns = self._request("tools/call", {"name": tool, "arguments": arguments})
        self._envelope(tool, result)
        return took_ns

    def ask(self, tool: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """Call a tool and return its envelope.

        Raises:
            RuntimeError: as :meth:`call`.
        """
        result, _ = self._request("tools/call", {"name": tool, "arguments": arguments})
        return self._envelope(tool, result)

    def call_together(self, tool: str, arguments: Mapping[str, Any], count: int) -> int:
        """Make so many equal calls at once; return the nanoseconds until the last answer has been read.

        Raises:
            RuntimeError: as :meth:`call`.
        """
        requests = [("tools/call", {"name": tool, "arguments": arguments})] * count
        results, took_ns = self._exchange(requests)
        for result in results:
            self._envelope(tool, result)
        return took_ns

    def _envelope(self, tool: str, result: Mapping[str, Any]) -> dict[str, Any]:
        if result.get("isError"):
            raise RuntimeError(f"{self._name}: {tool} failed: {result}")
        envelope: dict[str, Any] = result["structuredContent"]
        return envelope

    def exchange(self) -> int:
        """Have a raw client make its exchange; return the nanoseconds as :meth:`call` does."""
        return self._request("exchange", {})[1]

    @property
    def resident_kib(self) -> int:
        """The memory of the server that is resident now."""
        status = Path(f"/proc/{self._process.pid}/status").read_text()
        return int(next(line.split()[1] for line in status.splitlines() if line.startswith("VmRSS:")))

    def _request(self, method: str, params: Mapping[str, Any]) -> tuple[dict[str, Any], int]:
        (result,), took_ns = self._exchange([(method, params)])
        return result, took_ns

    def _exchange(self, requests: Sequence[tuple[str, Mapping[str, Any]]]) -> tuple[list[dict[str, Any]], int]:
        frames = []
        for method, params in requests:
            self._id += 1
            request = {"jsonrpc": "2.0", "id": self._id, "method": method, "params": {**params, "_meta": _META}}
            frames.append(json.dumps(request).encode() + b"\n")
        source = self._out.fileno()
        # An answer may have millions of bytes: bytes would be copied with each piece.
        data, lines = bytearray(), 0
        started = time.perf_counter_ns()
        self._in.write(b"".join(frames))
        while lines < len(frames):
            # select costs two microseconds; because of it, a server that hangs cannot hang the run.
            if not select.select([source], [], [], _PATIENCE_S)[0]:
                raise RuntimeError(f"{self._name}: no answer to {method} within {_PATIENCE_S:g} s{self._said()}")
            piece = os.read(source, 1 << 16)
            if not piece:
                raise RuntimeError(f"{self._name}: ended during {method}{self._said()}")
            data += piece
            lines += piece.count(b"\n")
        took_ns = time.perf_counter_ns() - started
        answers = {answer.get("id"): answer for answer in map(json.loads, data.splitlines())}
        asked = range(self._id - len(frames) + 1, self._id + 1)
        for identifier in asked:
            if "result" not in answers.get(identifier, {}):
                raise RuntimeError(f"{self._name}: {method} was answered with {answers}")
        return [answers[identifier]["result"] for identifier in asked], took_ns

    def _said(self) -> str:
        self._stderr.seek(0)
        return "; stderr: " + self._stderr.read()[-2000:].decode("utf-8", "replace")

    def close(self) -> None:
        """End the server by closing its standard input."""
        self._in.close()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._out.close()
        self._stderr.close()
