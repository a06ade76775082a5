"""Sessions over streamable HTTP: a real server in a process of its own, recorded frame by frame."""

from __future__ import annotations

import asyncio
import json
import socket
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from pytest_otmcp.errors import SubjectError
from pytest_otmcp.session.exchange import REFUSALS
from pytest_otmcp.session.free_port import free_port
from pytest_otmcp.session.session import McpSession, SessionOptions

ADAPTER = [sys.executable, "-m", "pytest_otmcp.reference_adapters", "modbus"]


@asynccontextmanager
async def session(command: list[str] | None = None, *, era: str = "auto") -> AsyncIterator[McpSession]:
    port = free_port(socket.socket)
    env = {
        "MCP_TRANSPORT": "streamable-http",
        "MCP_HTTP_PORT": str(port),
        "MODBUS_HOST": "127.0.0.1",
        "MODBUS_PORT": "1",
    }
    options = SessionOptions(url=f"http://127.0.0.1:{port}/mcp", start_timeout_s=60.0, exit_grace_s=30.0, era=era)
    opened = McpSession(command or ADAPTER, env, None, options)
    try:
        await opened.open()
        yield opened
    finally:
        await opened.close()


@pytest.mark.asyncio
@pytest.mark.parametrize("era", ["auto", "legacy"])
async def test_frames_and_their_times_are_recorded(era: str) -> None:
    async with session(era=era) as http:
        assert "read_input_registers" in http.tools
        assert http.by_handshake is (era == "legacy")
        exchange = await http.call("read_input_registers", {"address": 0, "count": 1}, timeout_s=60.0)
    assert exchange.response is not None
    assert exchange.latency_ms is not None
    assert 0 < exchange.latency_ms < 60_000
    asked, answered = json.loads(exchange.request), json.loads(exchange.response)
    assert asked["method"] == "tools/call"
    assert asked["id"] == answered["id"]
    assert answered["result"]["structuredContent"]["error"]["code"] == "connect_failed"


@pytest.mark.asyncio
async def test_a_request_that_the_server_refuses_for_its_size_does_not_end_the_session() -> None:
    async with session() as http:
        exchange = await http.call("read_input_registers", {"address": "9" * 5_000_000, "count": 1}, timeout_s=60.0)
        assert (exchange.response, exchange.failure) == (None, REFUSALS[413])
        assert exchange.latency_ms is not None
        assert (
            await http.call("read_input_registers", {"address": 0, "count": 1}, timeout_s=60.0)
        ).response is not None


@pytest.mark.asyncio
async def test_concurrent_calls_keep_their_own_frames() -> None:
    async with session() as http:
        exchanges = await asyncio.gather(
            *(http.call("read_input_registers", {"address": n, "count": 1}, timeout_s=60.0) for n in range(8))
        )
    for address, exchange in enumerate(exchanges):
        assert json.loads(exchange.request)["params"]["arguments"]["address"] == address
        assert exchange.response is not None
        assert json.loads(exchange.request)["id"] == json.loads(exchange.response)["id"]


@pytest.mark.asyncio
async def test_as_many_calls_as_there_are_are_made_at_the_same_time() -> None:
    # The client's library would have 100 connections, and let further calls wait in the kit.
    calls = 256
    async with session([sys.executable, str(SERVER), "application/json", str(calls)], era="legacy") as http:
        exchanges = await asyncio.gather(*(http.call("ping", {}, timeout_s=60.0) for _ in range(calls)))
    assert all(exchange.response is not None for exchange in exchanges)


@pytest.mark.asyncio
async def test_a_server_is_ended_by_sigterm_and_leaves_at_once() -> None:
    async with session() as http:
        pass
    assert http.stop_report is not None
    assert http.stop_report.how == "signalled"


@pytest.mark.asyncio
async def test_a_server_that_ends_before_it_listens_says_why() -> None:
    command = [sys.executable, "-c", "import sys; sys.exit('no licence for this plant')"]
    with pytest.raises(SubjectError, match=r"exited with code 1 .*(?s:.*)no licence for this plant"):
        async with session(command):
            pass


SERVER = Path(__file__).with_name("http_server.py")


@pytest.mark.asyncio
async def test_a_content_type_is_taken_as_the_client_takes_it() -> None:
    # RFC 9110, section 8.3.1: the type is case-insensitive.
    async with session([sys.executable, str(SERVER), "Application/JSON"], era="legacy") as http:
        exchange = await http.call("ping", {}, timeout_s=60.0)
    assert exchange.response is not None


@pytest.mark.asyncio
async def test_a_connection_is_not_used_again_when_a_server_may_be_closing_it() -> None:
    """Servers close idle ones, most of them after five seconds; a call that is sent in that moment is lost."""
    async with session([sys.executable, str(SERVER), "application/json", "kept"], era="legacy") as http:

        async def port() -> bytes | None:
            return (await http.call("ping", {}, timeout_s=60.0)).response

        before = await port()
        await asyncio.sleep(1.2)
        after = await port()

    def text(response: bytes | None) -> str:
        assert response is not None
        said: str = json.loads(response)["result"]["content"][0]["text"]
        return said

    assert text(before) != text(after)


@pytest.mark.asyncio
async def test_the_id_in_the_body_of_an_http_error_is_held_against_nobody() -> None:
    async with session([sys.executable, str(SERVER), "application/json"]) as http:
        assert http.by_handshake
        assert (await http.call("ping", {}, timeout_s=60.0)).response is not None
        assert http.unknown_responses() == []


@pytest.mark.asyncio
@pytest.mark.parametrize("kind", ["application/json", "Application/JSON", "application/json-seq"])
async def test_an_answer_that_does_not_end_is_not_read_to_its_end(kind: str) -> None:
    async with session([sys.executable, str(SERVER), kind, "endless"], era="legacy") as http:
        exchange = await http.call("ping", {}, timeout_s=60.0)
        assert exchange.response is None
        assert http.overflow


def test_the_port_of_a_server_is_none_that_the_system_hands_out_itself() -> None:
    lowest, highest = map(int, Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split())
    assert free_port(socket.socket) not in range(lowest, highest + 1)
