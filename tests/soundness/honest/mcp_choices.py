"""Honest adapters whose answers or whose process are other ones than those of the reference: the side of MCP."""

from __future__ import annotations

import asyncio
import dataclasses
import json
import math
import sys
import threading
import time
from collections import deque
from collections.abc import Awaitable, Callable
from datetime import UTC, datetime
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from mcp import MCPError
from mcp.types import METHOD_NOT_FOUND, PARSE_ERROR, Tool, ToolAnnotations
from pytest_otmcp.reference_adapters.core import AdapterError, AdapterServer, Call, stdio
from pytest_otmcp.reference_adapters.core import call as core_call
from pytest_otmcp.reference_adapters.core import server as core_server
from pytest_otmcp.reference_adapters.defects.defect import Handler
from pytest_otmcp.reference_adapters.modbus.shapes import Unit

from .choice import choices, every_tool

if TYPE_CHECKING:
    from pytest_otmcp.subject import Adapter

__all__ = ["CHOICES"]

CHOICES, choice = choices("modbus")

Envelope = dict[str, Any]
Result = dict[str, Any]

TEXT_IS_A_SHOULD = (
    "MCP, server/tools, Structured Content: a tool SHOULD also return the serialised JSON in a text block"
)
NO_TEXT = ("MCP-006", "no_text")
PROSE = ("MCP-006", "prose_text")
TICK_S = 0.015625


def other_envelopes(change: Callable[[Envelope], Envelope]) -> None:
    genuine = core_server._result
    core_server._result = lambda envelope: genuine(change(envelope))


def other_results(change: Callable[[Result], Result]) -> None:
    genuine = core_server._result
    core_server._result = lambda envelope: change(genuine(envelope))


@choice("writes UTC as an offset of zero, not as Z", "RFC 3339, section 4.2: both are UTC")
def utc_as_an_offset(server: AdapterServer) -> None:
    def with_offset(envelope: Envelope) -> Envelope:
        meta = envelope["meta"]
        return {**envelope, "meta": {**meta, "started_at": meta["started_at"].removesuffix("Z") + "+00:00"}}

    other_envelopes(with_offset)


@choice(
    "describes its tools in Persian and with pictures, which need joiners, and takes the address of a unit",
    "Unicode, section 23.2: U+200C and U+200D belong to the writing of words, and to pictures",
)
def describes_in_other_scripts(server: AdapterServer) -> None:
    for tool in server._tools.values():
        tool.listing.description = (
            f"\u0645\u06cc\u200c\u062e\u0648\u0627\u0646\u062f \U0001f468\u200d\U0001f527\n\t{tool.listing.description}"
        )


@choice(
    "has thirty tools and more, whose list is not long",
    "The kit, MCP-013: forty tools and 25 kB are easy to choose from",
)
def has_many_short_tools(server: AdapterServer) -> None:
    tool = server._tools["ping"]
    for number in range(20):
        name = f"ping_{number}"
        server._tools[name] = dataclasses.replace(tool, listing=tool.listing.model_copy(update={"name": name}))


LEVELS_READ = 150


def deeper_than_it_reads(server: AdapterServer, answer: Callable[[], Awaitable[Result]]) -> None:
    """Let what is nested more than 150 deep be answered in this way, as by a parser that has given up on the message."""
    genuine = server._answer

    async def answered(tool: Any, arguments: Any, context: Any) -> Result:
        value, levels = [arguments], 0
        while value and levels <= LEVELS_READ:
            inner = (one.values() if isinstance(one, dict) else one for one in value)
            value, levels = [one for part in inner for one in part if isinstance(one, dict | list)], levels + 1
        return await (answer() if value else genuine(tool, arguments, context))

    server._answer = answered


READS_NO_DEEPER = "the parsers of official SDKs give up on what is nested some 200 deep; it should be refused"
TOO_DEEP = ("ADR-009", "too_deep_to_read")


@choice("never answers a message that is nested 150 deep", READS_NO_DEEPER, checked_warnings=(TOO_DEEP,))
def no_answer_to_what_is_too_deep(server: AdapterServer) -> None:
    async def never() -> Result:
        await asyncio.Event().wait()
        raise AssertionError

    deeper_than_it_reads(server, never)


@choice(
    "answers a message that is nested 150 deep by an error of JSON-RPC", READS_NO_DEEPER, checked_warnings=(TOO_DEEP,)
)
def parse_error_for_what_is_too_deep(server: AdapterServer) -> None:
    async def refuse() -> Result:
        raise MCPError(PARSE_ERROR, "the message is nested too deeply")

    deeper_than_it_reads(server, refuse)


def prose(result: Result) -> dict[str, str]:
    said = "The device did as asked." if result["structuredContent"]["success"] else "That did not work."
    return {"type": "text", "text": said}


# -- renderings -------------------------------------------------------------------------------------------------------


@choice("answers without a text block", TEXT_IS_A_SHOULD, warnings=(NO_TEXT,))
def no_text_block(server: AdapterServer) -> None:
    other_results(lambda result: {**result, "content": []})


@choice("answers in prose and structuredContent, without JSON in the text", TEXT_IS_A_SHOULD, warnings=(PROSE,))
def prose_instead_of_json(server: AdapterServer) -> None:
    other_results(lambda result: {**result, "content": [prose(result)]})


@choice("has a block of prose before the block of JSON", TEXT_IS_A_SHOULD, warnings=(PROSE,))
def prose_before_json(server: AdapterServer) -> None:
    other_results(lambda result: {**result, "content": [prose(result), *result["content"]]})


@choice("has a block of prose after the block of JSON", TEXT_IS_A_SHOULD, warnings=(PROSE,))
def prose_after_json(server: AdapterServer) -> None:
    other_results(lambda result: {**result, "content": [*result["content"], prose(result)]})


@choice("has an image and a link beside the text", "MCP, server/tools: content may have blocks of several types")
def image_and_link(server: AdapterServer) -> None:
    pixel = "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
    image = {"type": "image", "data": pixel, "mimeType": "image/png"}
    link = {"type": "resource_link", "uri": "file:///trend", "name": "trend"}
    other_results(lambda result: {**result, "content": [image, *result["content"], link]})


@choice("writes its JSON in another order, with blanks, line breaks and escapes", "RFC 8259: the same value")
def other_json_style(server: AdapterServer) -> None:
    def styled(result: Result) -> Result:
        text = json.dumps(result["structuredContent"], sort_keys=True, indent=2, ensure_ascii=True)
        return {**result, "content": [{"type": "text", "text": text.replace("/", "\\/")}]}

    other_results(styled)


# -- envelopes --------------------------------------------------------------------------------------------------------


@choice("rounds its latency up to whole milliseconds", "requirement ENV-004 says nothing of a clock's resolution")
def latency_in_whole_milliseconds(server: AdapterServer) -> None:
    def rounded(envelope: Envelope) -> Envelope:
        meta = envelope["meta"]
        return {**envelope, "meta": {**meta, "latency_ms": math.ceil(meta["latency_ms"])}}

    other_envelopes(rounded)


@choice("has a clock that ticks every 15.6 ms", "Windows before Python 3.13")
def coarse_clock(server: AdapterServer) -> None:
    def ticked(seconds: float) -> float:
        return math.floor(seconds / TICK_S) * TICK_S

    core_call.time = SimpleNamespace(monotonic=lambda: ticked(time.monotonic()))
    core_call.datetime = SimpleNamespace(now=lambda zone: datetime.fromtimestamp(ticked(time.time()), UTC))


@choice("has members of its own in data and meta", "the envelope leaves data, meta and error.details open")
def further_members(server: AdapterServer) -> None:
    def extended(envelope: Envelope) -> Envelope:
        data = envelope["data"] and {**envelope["data"], "unit_of_measure": "V", "asset": None}
        return {**envelope, "data": data, "meta": {**envelope["meta"], "site": "hall 3", "ticket": "7"}}

    other_envelopes(extended)


def other_errors(change: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    def changed(envelope: Envelope) -> Envelope:
        return {**envelope, "error": envelope["error"] and change(envelope["error"])}

    other_envelopes(changed)


@choice("explains its errors in German", "codes are for programs, messages for people")
def errors_in_german(server: AdapterServer) -> None:
    other_errors(
        lambda error: {**error, "message": "Das Gerät hat den Auftrag nicht ausgeführt; bitte prüfen Sie die Angaben."}
    )


@choice("explains its errors at length", "the envelope has room for field, allowed, details and retry_after_ms")
def errors_at_length(server: AdapterServer) -> None:
    more = {"details": {"vendor_code": "E-1047", "see": ["manual", 12]}, "retry_after_ms": 250}
    other_errors(lambda error: {**error, "message": error["message"].ljust(400, "."), **more})


# -- tools ------------------------------------------------------------------------------------------------------------


@choice("declares no output schema", "MCP, server/tools: outputSchema is optional")
def no_output_schema(server: AdapterServer) -> None:
    for name, tool in [*server._tools.items()]:
        listing = Tool(**{**tool.listing.model_dump(by_alias=True, exclude_none=True), "outputSchema": None})
        server._tools[name] = dataclasses.replace(tool, listing=listing)


@choice("has no annotations, or idempotentHint alone", "ToolAnnotations: what is left out has the cautious value")
def few_annotations(server: AdapterServer) -> None:
    for name, tool in server._tools.items():
        only = ToolAnnotations(idempotent_hint=True) if name.startswith("write_") else None
        tool.listing.annotations = only


@choice("has further tools", "nobody forbids tools that the kit does not know")
def further_tools(server: AdapterServer) -> None:
    ping = server._tools["ping"]

    async def about(call: Call, arguments: Unit) -> dict[str, Any]:
        return {"vendor": "Acme"}

    listing = ping.listing.model_copy(update={"name": "about_this_adapter", "output_schema": None})
    server._tools["about_this_adapter"] = dataclasses.replace(ping, listing=listing, handler=about)


@choice(
    "has two tools whose names differ in upper and lower case alone",
    "MCP, server/tools, Tool Names: they are case-sensitive",
)
def names_in_upper_case(server: AdapterServer) -> None:
    ping = server._tools["ping"]
    server._tools["PING"] = dataclasses.replace(ping, listing=ping.listing.model_copy(update={"name": "PING"}))


@choice(
    "lists a tool twice, with the same words",
    "MCP, server/tools, Tool Names: they SHOULD be unique",
    warnings=(("MCP-003", "tool_twice"),),
)
def the_same_tool_twice(server: AdapterServer) -> None:
    server._tools["ping again"] = server._tools["ping"]


@choice("does not list its writing tools where writes are disabled", "what is not there cannot be used")
def guard_by_hiding(server: AdapterServer) -> None:
    if not server.writes_enabled:
        server._tools = {name: tool for name, tool in server._tools.items() if not tool.writes}


# -- process and transport --------------------------------------------------------------------------------------------


@choice("takes a second to start", "start_timeout_s is 30 s")
def slow_start(server: AdapterServer) -> None:
    time.sleep(1.0)


@choice("answers every call 60 ms later", "deadline_s is 5 s")
def slow_answers(server: AdapterServer) -> None:
    def later(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            data = await genuine(call, arguments)
            await asyncio.sleep(0.06)
            return data

        return handler

    every_tool(server, later)


def limited(adapter: Adapter) -> Adapter:
    # At run time only: the adapter's own process bends the server and has no need of the kit.
    from pytest_otmcp.subject.model import CallLimit

    return dataclasses.replace(adapter, call_limit=CallLimit(calls=30, per_s=0.5))


@choice("refuses more than 30 calls in half a second", "call_limit in the subject file says so", described=limited)
def limits_its_calls(server: AdapterServer) -> None:
    received: list[float] = []

    def limited(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            now = time.monotonic()
            received[:] = [before for before in received if now - before < 0.5]
            if len(received) == 30:
                raise AdapterError("device_busy", "more than 30 calls in half a second", outcome="not_sent")
            received.append(now)
            return await genuine(call, arguments)

        return handler

    every_tool(server, limited)


@choice("writes 100 kB to stderr at the start and with every call", "MCP, stdio: stderr is the server's own")
def talkative_on_stderr(server: AdapterServer) -> None:
    def talking(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            print("DEBUG " * 17_000, file=sys.stderr)
            return await genuine(call, arguments)

        return handler

    print("DEBUG " * 17_000, file=sys.stderr)
    every_tool(server, talking)


@choice("keeps its last 300 answers, 20 kB each, and starts a pool of 16 threads one by one", "both have a bound")
def fills_a_cache_and_a_pool(server: AdapterServer) -> None:
    kept: deque[bytearray] = deque(maxlen=300)
    pool: list[threading.Thread] = []

    def keeping(envelope: Envelope) -> Envelope:
        kept.append(bytearray(b"\1" * 20_000))
        if len(pool) < 16:
            pool.append(threading.Thread(target=threading.Event().wait, daemon=True))
            pool[-1].start()
        return envelope

    other_envelopes(keeping)


@choice("lets go of what it has answered only with every 120th call", "a collector may come late")
def collects_late(server: AdapterServer) -> None:
    kept: list[bytearray] = []

    def collecting(envelope: Envelope) -> Envelope:
        if len(kept) == 120:
            kept.clear()
        kept.append(bytearray(b"\1" * 20_000))
        return envelope

    other_envelopes(collecting)


def before_each_message(line: Callable[[], bytes]) -> None:
    genuine = stdio._Output.send

    async def send(output: Any, item: Any, /) -> None:
        output._pipe.write(line() + b"\n")
        await genuine(output, item)

    stdio._Output.send = send


def spoken_to_by_handshake(adapter: Adapter) -> Adapter:
    return dataclasses.replace(adapter, era="legacy")


@choice(
    "speaks MCP of 2025-11-25 only to those who ask so",
    'era = "legacy" in the subject file',
    described=spoken_to_by_handshake,
)
def addressed_by_handshake(server: AdapterServer) -> None:
    """Nothing is bent: the subject file decides."""


@choice("speaks no MCP older than 2026-07-28", "MCP 2026-07-28, Versioning: a server supports one revision or several")
def newest_era_only(server: AdapterServer) -> None:
    answer = server._answer_calls

    async def refusing(ctx: Any, call_next: Any) -> Any:
        if ctx.method == "initialize":
            raise MCPError(METHOD_NOT_FOUND, "Method not found")
        return await answer(ctx, call_next)

    server.mcp.middleware[:] = [refusing]


@choice("sends a notification before every answer", "MCP, server/utilities/logging", described=spoken_to_by_handshake)
def notifications(server: AdapterServer) -> None:
    told = {"jsonrpc": "2.0", "method": "notifications/message", "params": {"level": "info", "data": "working"}}
    before_each_message(lambda: json.dumps(told).encode())


def spoken_to_over_pipes(adapter: Adapter) -> Adapter:
    """Return a description of an adapter that is spoken to by handshake, and never over HTTP."""
    variants = {name: one for name, one in adapter.variants.items() if name != "tokens"}
    return dataclasses.replace(spoken_to_by_handshake(adapter), variants=variants, tokens=None)


@choice(
    "describes its tools anew after the first call, and announces it",
    "MCP 2025-11-25, server/tools, List Changed Notification",
    warnings=(("MCP-010", "tools_changed"),),
    described=spoken_to_over_pipes,
)
def announces_new_descriptions(server: AdapterServer) -> None:
    told = b'{"jsonrpc":"2.0","method":"notifications/tools/list_changed"}\n'
    genuine = stdio._Output.send
    pending: list[bytes] = []

    def describing(envelope: Envelope) -> Envelope:
        for tool in server._tools.values():
            if not (tool.listing.description or "").endswith("(connected)"):
                tool.listing.description = f"{tool.listing.description} (connected)"
                pending[:] = [told]
        return envelope

    async def send(output: Any, item: Any, /) -> None:
        while pending:
            output._pipe.write(pending.pop())
        await genuine(output, item)

    stdio._Output.send = send
    other_envelopes(describing)


@choice("ends its lines with CR LF", "JSON allows white space after a value")
def lines_of_windows(server: AdapterServer) -> None:
    async def send(output: Any, item: Any, /) -> None:
        output._pipe.write(item.message.model_dump_json(by_alias=True, exclude_unset=True).encode() + b"\r\n")
        await output._writable.wait()

    stdio._Output.send = send


def reached_by_http(adapter: Adapter) -> Adapter:
    over = {"MCP_TRANSPORT": "streamable-http", "MCP_HTTP_PORT": "{http_port}"}
    variants = {name: dataclasses.replace(one, env={**one.env, **over}) for name, one in adapter.variants.items()}
    # Over HTTP a policy needs to know who calls.
    del variants["governed"]
    return dataclasses.replace(
        adapter, transport="http", url="http://127.0.0.1:{http_port}/mcp", variants=variants, governed=None
    )


@choice("is spoken to over streamable HTTP", "MCP, basic/transports", described=reached_by_http)
def streamable_http(server: AdapterServer) -> None:
    """Nothing is bent: the subject file decides."""
