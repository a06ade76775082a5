"""The MCP side of an adapter: tools with strict arguments, write guard, deadline, and one envelope for every outcome.

Built on the SDK's low-level server, because strictness begins where the high-level one already helps: it coerces
``"5"`` to 5, drops unknown arguments and turns exceptions into prose.
"""

from __future__ import annotations

import asyncio
import inspect
import json
import logging
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any, get_type_hints

from mcp import MCPError
from mcp.server import Server, ServerRequestContext
from mcp.types import (
    INVALID_PARAMS,
    CallToolRequestParams,
    CallToolResult,
    ListToolsResult,
    PaginatedRequestParams,
    TextContent,
    Tool,
    ToolAnnotations,
)

from .arguments import Arguments, parse_arguments
from .call import Call
from .errors import AdapterError
from .schema import output_schema

__all__ = ["AdapterServer"]

Handler = Callable[[Call, Any], Awaitable[dict[str, Any]]]

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Tool:
    listing: Tool
    model: type[Arguments]
    handler: Handler
    operation: str
    protocol: str
    writes: bool


class AdapterServer:
    """An MCP server whose tools answer in envelopes.

    Args:
        name, version: as the server introduces itself.
        protocol: the envelope's ``meta.protocol``.
        endpoint: URI of the device, without credentials.
        writes_enabled: the write guard is off.
        switch: name of the variable that switches writes on, for the refusal's text.
        deadline_s: seconds within which every call answers.
        close: called once when the server ends.
    """

    def __init__(
        self,
        *,
        name: str,
        version: str,
        protocol: str,
        endpoint: str,
        writes_enabled: bool,
        switch: str,
        deadline_s: float,
        close: Callable[[], Awaitable[None]],
    ) -> None:
        self.name = name
        self.writes_enabled = writes_enabled
        self.endpoint = endpoint
        self._protocol = protocol
        self._switch = switch
        self._deadline_s = deadline_s
        self._close = close
        self._tools: dict[str, _Tool] = {}
        self.mcp: Server[None] = Server(
            name,
            version=version,
            lifespan=self._lifespan,
            on_list_tools=self._list_tools,
            on_call_tool=self._call_tool,
        )

    @asynccontextmanager
    async def _lifespan(self, server: Server[None]) -> AsyncIterator[None]:
        try:
            yield None
        finally:
            await self._close()

    def tool(
        self, operation: str, *, writes: bool = False, idempotent: bool = True, protocol: str | None = None
    ) -> Callable[[Handler], Handler]:
        """Decorator: offer an async function ``(call, arguments) -> data`` as a tool.

        The function's name, docstring and argument model become the tool's name, description and input schema.

        Args:
            operation: abstract operation, the envelope's ``meta.operation``.
            writes: it changes the state of the plant, so the write guard covers it.
            idempotent: calling it again with the same arguments has no further effect.
            protocol: ``meta.protocol``, where it is not the server's.
        """

        def register(handler: Handler) -> Handler:
            model: type[Arguments] = get_type_hints(handler)["arguments"]
            name = handler.__name__
            schema = model.model_json_schema()
            schema.pop("title", None)
            self._tools[name] = _Tool(
                listing=Tool(
                    name=name,
                    description=inspect.cleandoc(handler.__doc__ or ""),
                    input_schema=schema,
                    output_schema=output_schema(),
                    annotations=ToolAnnotations(
                        read_only_hint=not writes,
                        destructive_hint=writes,
                        idempotent_hint=idempotent,
                        open_world_hint=False,
                    ),
                ),
                model=model,
                handler=handler,
                operation=operation,
                protocol=protocol or self._protocol,
                writes=writes,
            )
            return handler

        return register

    async def _list_tools(
        self, context: ServerRequestContext[None], params: PaginatedRequestParams | None
    ) -> ListToolsResult:
        return ListToolsResult(tools=[tool.listing for tool in self._tools.values()])

    async def _call_tool(self, context: ServerRequestContext[None], params: CallToolRequestParams) -> CallToolResult:
        tool = self._tools.get(params.name)
        if tool is None:
            raise MCPError(INVALID_PARAMS, f"Unknown tool: {params.name}")
        call = Call(protocol=tool.protocol, operation=tool.operation, endpoint=self.endpoint, writes=tool.writes)
        try:
            envelope = call.success(await self._perform(tool, call, params.arguments))
        except AdapterError as error:
            envelope = call.failure(error)
        except Exception:
            # A bug of ours: its traceback is for whoever reads the log, not for an assistant.
            log.exception("tool %s failed unexpectedly", params.name)
            envelope = call.failure(AdapterError("internal_error", "the adapter failed unexpectedly; see its log"))
        return _result(envelope)

    async def _perform(self, tool: _Tool, call: Call, arguments: dict[str, Any] | None) -> dict[str, Any]:
        parsed = parse_arguments(tool.model, arguments)
        if tool.writes and not self.writes_enabled:
            raise AdapterError("writes_disabled", f"writes are disabled; set {self._switch}=true to enable them")
        try:
            async with asyncio.timeout(self._deadline_s):
                return await tool.handler(call, parsed)
        except TimeoutError:
            call.disconnected()
            raise AdapterError("timeout", f"the device did not answer within {self._deadline_s:g} s") from None


def _result(envelope: dict[str, Any]) -> CallToolResult:
    text = json.dumps(envelope, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return CallToolResult(
        content=[TextContent(type="text", text=text)],
        structured_content=envelope,
        is_error=not envelope["success"],
    )
