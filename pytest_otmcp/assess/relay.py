"""The relay between an assistant and an adapter: it passes the tools on as they are, and keeps every call.

A call with its arguments is kept whatever becomes of it: of one that the adapter refuses, the device knows nothing. The relay speaks the
part of MCP that tools need, by handshake (revision 2025-06-18), with whichever host the assistant has; what an adapter asks its client for is
answered by the kit, as the assignment has it.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from typing import Any

from .. import __version__
from ..core.errors import NoBindingError, SubjectError
from ..core.tool_entry import TWICE
from ..subject.tools import only_reads
from ..trial.adapter_under_test import AdapterUnderTest
from .fitting import succeeded
from .scoring import Call

__all__ = ["Relay"]

_REVISIONS = ("2024-11-05", "2025-03-26", "2025-06-18")
_UNKNOWN_METHOD, _NO_ANSWER = -32601, -32000


class Relay:
    """The relay in front of one adapter, whose session is open and proven.

    Attributes:
        calls: what was called, each when it has ended.
    """

    def __init__(self, under_test: AdapterUnderTest) -> None:
        self._under_test = under_test
        self.calls: list[Call] = []

    @property
    def protocol(self) -> str:
        """Key of the adapter's protocol."""
        return self._under_test.adapter.protocol

    @property
    def tools(self) -> list[dict[str, object]]:
        """The entries of ``tools/list``."""
        listed = self._under_test.tools or {}
        return [{name: value for name, value in entry.items() if name != TWICE} for entry in listed.values()]

    async def answer(self, message: Mapping[str, Any]) -> dict[str, object] | None:
        """Return the answer to a JSON-RPC message; None for one that has none."""
        if "id" not in message or "method" not in message:
            return None
        params = message.get("params")
        answer = await self._answered(str(message["method"]), params if isinstance(params, Mapping) else {})
        return {"jsonrpc": "2.0", "id": message["id"], **answer}

    async def _answered(self, method: str, params: Mapping[str, Any]) -> Mapping[str, object]:
        match method:
            case "initialize":
                asked = params.get("protocolVersion")
                return {
                    "result": {
                        "protocolVersion": asked if asked in _REVISIONS else _REVISIONS[-1],
                        "capabilities": {"tools": {}},
                        "serverInfo": {"name": self.protocol, "version": __version__},
                    }
                }
            case "ping":
                return {"result": {}}
            case "tools/list":
                return {"result": {"tools": self.tools}}
            case "tools/call":
                arguments = params.get("arguments")
                return await self.call(str(params.get("name")), arguments if isinstance(arguments, Mapping) else {})
        return {"error": {"code": _UNKNOWN_METHOD, "message": f"this relay knows no method {method}"}}

    async def call(self, tool: str, arguments: Mapping[str, object]) -> Mapping[str, object]:
        """Call a tool of the adapter; return ``result`` or ``error`` as the adapter gave it, or why there is none."""
        sent_ns, received_ns = time.monotonic_ns(), None
        success: bool | None = None
        try:
            answer, received_ns = await self._called(tool, arguments)
            success = succeeded(self._under_test.adapter, tool, answer)
        except (NoBindingError, SubjectError) as problem:
            answer = _problem(str(problem))
        self.calls.append(
            Call(
                protocol=self.protocol,
                tool=tool,
                arguments=dict(arguments),
                text=json.dumps(answer, ensure_ascii=False),
                success=success,
                sent_ns=sent_ns,
                received_ns=received_ns,
            )
        )
        return answer

    async def _called(self, tool: str, arguments: Mapping[str, object]) -> tuple[dict[str, object], int | None]:
        under_test = self._under_test
        if under_test.session is None or under_test.session.died:
            return _problem("the adapter has ended"), None
        exchange = await under_test.call_tool(
            tool, arguments, writes=not only_reads(under_test.adapter, tool), timeout_s=1.2 * under_test.deadline_s
        )
        if exchange.response is None:
            return _problem(f"no answer ({(exchange.failure or 'unknown').replace('_', ' ')})"), None
        try:
            message = json.loads(exchange.response)
            kept = {name: message[name] for name in ("result", "error") if name in message}
        except (ValueError, TypeError, RecursionError):
            kept = {}
        return kept or _problem("an answer that is no JSON-RPC response"), exchange.received_ns


def _problem(sentence: str) -> dict[str, object]:
    return {"error": {"code": _NO_ANSWER, "message": sentence}}
