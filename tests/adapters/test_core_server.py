"""The adapter skeleton alone: a server with toy tools (this file, run as a program) behind real pipes."""

# In the checkout mypy does not find the installed name of the adapters' folder.
# mypy: disable-error-code="import-not-found,misc,untyped-decorator,no-any-return"

from __future__ import annotations

import asyncio
import contextlib
import http.client
import json
import os
import signal
import subprocess
import sys
import time
from typing import Annotated, Any, Literal
from urllib.parse import urlsplit

import pytest
from jsonschema import Draft202012Validator
from pydantic import Field
from pytest_otmcp.reference_adapters.core import (
    LEFT_OUT,
    AdapterError,
    AdapterServer,
    Arguments,
    BoundsCode,
    Call,
    tool,
)
from pytest_otmcp.reference_adapters.core.run import serve

LEGACY, MODERN = "2025-11-25", "2026-07-28"
ENVELOPE = {
    "io.modelcontextprotocol/protocolVersion": MODERN,
    "io.modelcontextprotocol/clientCapabilities": {},
    "io.modelcontextprotocol/clientInfo": {"name": "tests", "version": "1"},
}


class Nothing(Arguments):
    pass


class Inner(Arguments):
    name: str
    value: Any


class Everything(Arguments):
    word: Annotated[int, Field(ge=0, le=65535), BoundsCode("range_overflow")]
    count: Annotated[int, Field(ge=1, le=125), BoundsCode("limit_exceeded")] = 1
    number: float = 0.0
    flag: bool = False
    text: Annotated[str, Field(max_length=1000)] = ""
    mode: Literal["a", "b"] = "a"
    unit: int = Field(default=LEFT_OUT, ge=0, le=247)
    either: int | str = 0
    items: list[Inner] = Field(default_factory=list)


class Tools:
    """One tool for each thing that a tool can do."""

    @tool("toy.take")
    async def take(self, call: Call, arguments: Everything) -> dict[str, Any]:
        """Take anything."""
        return arguments.model_dump()

    @tool("toy.null")
    async def null(self, call: Call, arguments: Nothing) -> dict[str, Any]:
        """Do nothing."""
        return {}

    @tool("toy.write", writes=True, idempotent=False)
    async def write(self, call: Call, arguments: Everything) -> dict[str, Any]:
        """Pretend to write."""
        call.sending()
        call.answered(word=arguments.word)
        return {}

    @tool("toy.hang", writes=True)
    async def hang(self, call: Call, arguments: Everything) -> dict[str, Any]:
        """Never return; the request has left when ``flag`` is set. Says on stderr when it begins and ends."""
        if arguments.flag:
            call.sending()
        print(f"{arguments.text} hangs", file=sys.stderr, flush=True)
        try:
            await asyncio.Event().wait()
        finally:
            print(f"{arguments.text} is let go", file=sys.stderr, flush=True)
        return {}

    @tool("toy.deaf")
    async def deaf(self, call: Call, arguments: Nothing) -> dict[str, Any]:
        """Never return, and do not hear the first two cancellations, as a library may lose one."""
        for _ in range(2):
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.Event().wait()
        await asyncio.Event().wait()
        return {}

    @tool("toy.crash")
    async def crash(self, call: Call, arguments: Nothing) -> dict[str, Any]:
        """Have a bug."""
        raise RuntimeError("secret path /opt/adapter/main.py")

    @tool("toy.infinite")
    async def infinite(self, call: Call, arguments: Nothing) -> dict[str, Any]:
        """Return what JSON cannot say."""
        return {"value": float("inf")}

    @tool("toy.noisy")
    async def noisy(self, call: Call, arguments: Nothing) -> dict[str, Any]:
        """Print where no print belongs."""
        print("a stray line", flush=True)
        os.write(1, b"another one\n")
        return {}

    @tool("toy.refuse")
    async def refuse(self, call: Call, arguments: Nothing) -> dict[str, Any]:
        """Refuse, having tried once."""
        call.sending()
        call.answered()
        raise AdapterError("device_busy", "x" * 600, details={"a": 1}, retry_after_ms=5, partial={"done": 1})


def build() -> AdapterServer:
    async def close() -> None:
        if "CLOSED_MARK" in os.environ:
            print("session closed", file=sys.stderr, flush=True)

    server = AdapterServer(
        name="toy",
        version="1.0",
        protocol="modbus-tcp",
        endpoint="modbus+tcp://127.0.0.1:502",
        writes_enabled=os.environ.get("WRITES") == "1",
        switch="WRITES",
        # This is longer than every wait, so that only the test of the deadline depends on it.
        deadline_s=float(os.environ.get("DEADLINE_S", "60")),
        close=close,
    )

    server.add(Tools())
    return server


@pytest.fixture(scope="module")
def toy(sessions: Any) -> Any:
    return sessions([sys.executable, __file__])


@pytest.fixture(scope="module")
def writable(sessions: Any) -> Any:
    return sessions([sys.executable, __file__], {"WRITES": "1"})


GOOD = {"word": 70}


def hear(client: Any, words: bytes) -> None:
    """Wait until the server has written these words to stderr."""
    while words not in client.stderr:
        assert client._read(60.0), client.stderr


def test_tools_are_listed_with_strict_schemas_and_truthful_annotations(toy: Any) -> None:
    tool = toy.tools["take"]
    schema = tool["inputSchema"]
    Draft202012Validator.check_schema(schema)
    Draft202012Validator.check_schema(tool["outputSchema"])
    assert schema["additionalProperties"] is False
    assert schema["$defs"]["Inner"]["additionalProperties"] is False
    assert schema["required"] == ["word"]
    assert schema["properties"]["word"] == {"maximum": 65535, "minimum": 0, "type": "integer"}
    assert schema["properties"]["mode"]["enum"] == ["a", "b"]
    assert schema["properties"]["unit"] == {"maximum": 247, "minimum": 0, "type": "integer"}
    reads, writes = toy.tools["null"]["annotations"], toy.tools["write"]["annotations"]
    assert (reads["readOnlyHint"], reads["openWorldHint"]) == (True, False)
    assert (writes["readOnlyHint"], writes["destructiveHint"], writes["idempotentHint"]) == (False, True, False)


def test_listing_twice_gives_the_same(toy: Any) -> None:
    assert toy.request("tools/list", {})["result"] == toy.request("tools/list", {})["result"]


@pytest.mark.parametrize(
    ("arguments", "code", "field"),
    [
        ({}, "invalid_input", "/word"),
        ({"word": "5"}, "invalid_input", "/word"),
        ({"word": 5.0}, "invalid_input", "/word"),
        ({"word": 5.5}, "invalid_input", "/word"),
        ({"word": True}, "invalid_input", "/word"),
        ({"word": None}, "invalid_input", "/word"),
        ({"word": []}, "invalid_input", "/word"),
        ({"word": {}}, "invalid_input", "/word"),
        ({"word": -1}, "range_overflow", "/word"),
        ({"word": 65536}, "range_overflow", "/word"),
        ({"word": 10**30}, "range_overflow", "/word"),
        ({"word": 1, "count": 126}, "limit_exceeded", "/count"),
        ({"word": 1, "count": 0}, "invalid_input", "/count"),
        ({"word": 1, "number": "1.5"}, "invalid_input", "/number"),
        ({"word": 1, "number": True}, "invalid_input", "/number"),
        ({"word": 1, "flag": 1}, "invalid_input", "/flag"),
        ({"word": 1, "flag": "true"}, "invalid_input", "/flag"),
        ({"word": 1, "text": 5}, "invalid_input", "/text"),
        ({"word": 1, "text": "x" * 1001}, "limit_exceeded", "/text"),
        ({"word": 1, "mode": "c"}, "invalid_input", "/mode"),
        ({"word": 1, "unit": None}, "invalid_input", "/unit"),
        ({"word": 1, "either": True}, "invalid_input", "/either"),
        ({"word": 1, "wrod": 2}, "invalid_input", "/wrod"),
        ({"word": 1, "a/b~c": 2}, "invalid_input", "/a~1b~0c"),
        ({"word": 1, "items": [{"name": "n", "value": 1, "x": 2}]}, "invalid_input", "/items/0/x"),
        ({"word": 1, "items": [{"name": "n"}]}, "invalid_input", "/items/0/value"),
        ({"word": 1, "items": {"name": "n"}}, "invalid_input", "/items"),
        (None, "invalid_input", "/word"),
        ([1], "invalid_input", ""),
        ("word", "invalid_input", ""),
        (5, "invalid_input", ""),
    ],
)
@pytest.mark.parametrize("tool", ["take", "write"])
def test_wrong_arguments_are_refused_in_the_envelope(
    toy: Any, tool: str, arguments: Any, code: str, field: str
) -> None:
    identifier = toy.start(tool, arguments)
    reply = toy.reply(tool, identifier)
    assert (reply.error["code"], reply.error["field"], reply.error["outcome"]) == (code, field, "not_sent")
    assert reply.error["class"] == "validation"
    assert not reply.error["retryable"]
    assert (reply.meta["attempts"], reply.meta["source"], reply.meta["trace"]) == (0, "none", {})


@pytest.mark.parametrize("literal", ["NaN", "Infinity", "-Infinity", "1e999", "-1e999"])
@pytest.mark.parametrize("place", ['"number": %s', '"word": %s', '"items": [{"name": "n", "value": %s}]'])
def test_numbers_that_are_not_finite_are_refused_wherever_they_are(toy: Any, place: str, literal: str) -> None:
    request = {"jsonrpc": "2.0", "id": "inf", "method": "tools/call"}
    params = {"name": "take", "arguments": {"MARK": 0}, "_meta": ENVELOPE}
    text = json.dumps({**request, "params": params}).replace('"MARK": 0', place % literal)
    toy.write(text.encode())
    assert toy.reply("take", "inf").error["code"] == "invalid_input"


def test_a_lone_surrogate_is_refused_in_words(toy: Any) -> None:
    toy.write(
        json.dumps(
            {
                "jsonrpc": "2.0",
                "id": "half",
                "method": "tools/call",
                "params": {"name": "take", "arguments": {"word": 1, "text": "\ud800"}, "_meta": ENVELOPE},
            }
        ).encode()
    )
    error = toy.reply("take", "half").error
    assert (error["code"], error["field"]) == ("invalid_input", "/text")


def test_a_long_list_is_a_limit_before_its_elements_are_looked_at(toy: Any) -> None:
    error = toy.call("take", word=1, items=[0] * 100_001).error
    assert (error["code"], error["field"]) == ("limit_exceeded", "/items")


def test_deep_nesting_is_a_limit(toy: Any) -> None:
    deep: Any = 1
    for _ in range(900):
        deep = [deep]
    error = toy.call("take", word=1, items=[{"name": "n", "value": deep}]).error
    assert error["code"] == "limit_exceeded"


def test_ten_megabytes_of_text_are_a_limit_and_the_session_goes_on(toy: Any) -> None:
    assert toy.call("take", word=1, text="x" * 10_000_000).error["code"] == "limit_exceeded"
    assert toy.call("take", word=1).data["word"] == 1


@pytest.mark.parametrize(
    ("form", "answered"),
    [
        (b'{"jsonrpc":"2.0","id":4711,"method":"tools/call","params":{"name":"take","arguments":{"text":"%s"}}}', True),
        (b'{"method":"tools/call","params":{"name":"take","arguments":{"text":"%s","id":1}}, "id" : 4711 }', True),
        # An id that is not the message's own, and a notification.
        (b'{"method":"tools/call","params":{"id":4711,"arguments":{"text":"%s,\\"id\\":4711}","id":4711}}}', False),
        (b'{"jsonrpc":"2.0","method":"notifications/progress","params":{"id":4711,"message":"%s"}}', False),
    ],
    ids=["id first", "id last", "id of its own nowhere", "notification"],
)
def test_a_request_that_is_too_long_is_answered_and_the_session_goes_on(toy: Any, form: bytes, answered: bool) -> None:
    toy.write(form % (b"x" * 33 * 1024 * 1024))
    if answered:
        answer = toy.answer(4711)
        assert answer["error"]["code"] == -32600
        assert "longer than 33554432 bytes" in answer["error"]["message"]
    assert toy.call("null").data == {}


def test_good_arguments_are_taken_as_they_are(toy: Any) -> None:
    given = {"word": 65535, "count": 125, "number": 1, "flag": True, "text": "ü", "mode": "b", "unit": 247}
    data = toy.call("take", given).data
    assert {name: data[name] for name in given} == given


def test_a_denied_write_is_refused_after_validation_and_before_everything_else(toy: Any, writable: Any) -> None:
    reply = toy.call("write", GOOD)
    assert (reply.error["code"], reply.error["class"]) == ("writes_disabled", "policy")
    assert (reply.error["outcome"], reply.meta["attempts"]) == ("not_sent", 0)
    assert "WRITES=true" in reply.error["message"]
    assert toy.call("write", word="x").error["code"] == "invalid_input"
    assert writable.call("write", GOOD).meta["trace"] == {"word": 70}


def test_an_unknown_tool_is_a_protocol_error(toy: Any) -> None:
    response = toy.request("tools/call", {"name": "reboot", "arguments": {}})
    assert response["error"]["code"] == -32602


@pytest.mark.parametrize(("sent", "outcome"), [(True, "unknown"), (False, "not_sent")])
def test_the_deadline_ends_a_call_and_says_what_may_have_happened(sessions: Any, sent: bool, outcome: str) -> None:
    hasty = sessions([sys.executable, __file__], {"WRITES": "1", "DEADLINE_S": "0.3"})
    reply = hasty.call("hang", word=1, flag=sent)
    assert (reply.error["code"], reply.error["outcome"]) == ("timeout", outcome)
    assert reply.error["retryable"] is not sent
    assert reply.meta["attempts"] == int(sent)
    assert reply.meta["latency_ms"] >= 300
    hasty.close()


def test_a_call_that_does_not_hear_its_deadline_ends_soon_after_it(sessions: Any) -> None:
    hasty = sessions([sys.executable, __file__], {"DEADLINE_S": "0.3"})
    error = hasty.call("deaf").error
    assert (error["code"], error["message"]) == ("timeout", "the device did not answer within 0.3 s")
    # Neither the connection nor the next call has suffered.
    assert hasty.call("null").data == {}
    hasty.close()


def test_a_cancelled_call_is_never_answered(writable: Any) -> None:
    identifier = writable.start("hang", {**GOOD, "text": "the cancelled call"})
    hear(writable, b"the cancelled call hangs")
    writable.write({"jsonrpc": "2.0", "method": "notifications/cancelled", "params": {"requestId": identifier}})
    # This is long before the call's deadline, so only the cancellation can have ended it.
    hear(writable, b"the cancelled call is let go")
    # An answer to the cancelled call would come before the answer to a later call.
    assert writable.call("null").data == {}
    with pytest.raises(TimeoutError):
        writable.answer(identifier, timeout_s=0.0)


def test_a_bug_is_an_internal_error_without_internals(toy: Any) -> None:
    for name in ("crash", "infinite"):
        error = toy.call(name).error
        assert error["code"] == "internal_error"
        assert "secret" not in json.dumps(error)
    assert b"secret path" in toy.stderr


def test_an_error_carries_what_it_was_given(toy: Any) -> None:
    reply = toy.call("refuse")
    assert reply.error["code"] == "device_busy"
    assert len(reply.error["message"]) == 500
    assert (reply.error["details"], reply.error["retry_after_ms"]) == ({"a": 1}, 5)
    assert reply.envelope["data"] == {"partial": {"done": 1}}
    assert (reply.meta["attempts"], reply.meta["source"]) == (1, "device")


def test_meta_is_complete_and_request_ids_are_unique(toy: Any) -> None:
    metas = [toy.call("null").meta, toy.call("take", word="x").meta, toy.call("write", GOOD).meta]
    assert len({meta["request_id"] for meta in metas}) == 3
    assert {meta["operation"] for meta in metas} == {"toy.null", "toy.take", "toy.write"}
    assert all(meta.keys() == metas[0].keys() for meta in metas)


def test_stray_prints_do_not_reach_the_wire(toy: Any) -> None:
    assert toy.call("noisy").data == {}
    assert toy.call("null").data == {}
    assert b"a stray line" in toy.stderr
    assert b"another one" in toy.stderr


@pytest.mark.parametrize(
    "line",
    [
        b"{",
        b"not json at all",
        b"[]",
        b"null",
        b"\xff\xfe",
        b'{"jsonrpc":"2.0","id":null,"method":"tools/list"}',
        b'{"jsonrpc":"2.0","id":77,"result":{}}',
        b'{"jsonrpc":"2.0","method":"notifications/cancelled","params":{"requestId":4711}}',
        b'{"jsonrpc":"2.0","method":"notifications/unheard-of"}',
        b"",
        b"   ",
        b"[" * 100_000,
    ],
)
def test_a_line_that_is_no_request_does_not_end_the_session(toy: Any, line: bytes) -> None:
    toy.write(line)
    assert toy.call("null").data == {}


def test_a_request_in_pieces_and_several_in_one_write_are_all_answered(toy: Any) -> None:
    request = {
        "jsonrpc": "2.0",
        "id": "pieces",
        "method": "tools/call",
        "params": {"name": "null", "arguments": {}, "_meta": ENVELOPE},
    }
    data = json.dumps(request).encode() + b"\n"
    for piece in (data[:10], data[10:50], data[50:]):
        os.write(toy.stdin.fileno(), piece)
    assert toy.reply("null", "pieces").data == {}
    toy.write(b"\n".join(json.dumps({**request, "id": f"p{i}"}).encode() for i in range(50)))
    assert all(toy.reply("null", f"p{i}").data == {} for i in range(50))


def test_both_eras_give_the_same_results(sessions: Any, toy: Any) -> None:
    legacy = sessions([sys.executable, __file__], era=LEGACY)
    assert legacy.server["protocolVersion"] == LEGACY
    assert MODERN in toy.server["supportedVersions"]
    assert legacy.tools == toy.tools
    one, other = legacy.call("take", word=5), toy.call("take", word=5)
    assert one.data == other.data
    assert legacy.call("take", [1]).error == toy.call("take", [1]).error
    assert "resultType" not in one.result
    assert other.result["resultType"] == "complete"
    # The SDK adds these members to its own answers; the adapter answers calls without the SDK.
    assert other.result["_meta"] == toy.request("tools/list", {})["result"]["_meta"]


@pytest.mark.parametrize("era", [LEGACY, MODERN])
def test_a_notification_calls_no_tool(sessions: Any, era: str) -> None:
    client = sessions([sys.executable, __file__], era=era)
    client.write({"jsonrpc": "2.0", "method": "tools/call", "params": {"name": "noisy", "arguments": {}}})
    assert client.call("null").data == {}
    client.close()
    assert b"a stray line" not in client.stderr


def test_calls_of_a_client_that_has_not_introduced_itself_are_refused(toy: Any) -> None:
    request = {"jsonrpc": "2.0", "id": "nobody", "method": "tools/call", "params": {"name": "null", "arguments": {}}}
    toy.write(request)
    assert toy.answer("nobody")["error"]["code"] == -32602
    with subprocess.Popen(
        [sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0
    ) as legacy:
        source, sink = legacy.stdout, legacy.stdin
        assert source is not None
        assert sink is not None
        sink.write(json.dumps(request).encode() + b"\n")
        assert json.loads(source.readline())["error"]["code"] == -32602
        # Before 2026-07-28 this notification alone opens the session, and the SDK knows nothing about the client.
        sink.write(b'{"jsonrpc":"2.0","method":"notifications/initialized"}\n')
        sink.write(json.dumps(request).encode() + b"\n")
        assert json.loads(source.readline())["result"]["structuredContent"]["success"]


@pytest.mark.parametrize("era", [LEGACY, MODERN])
def test_closing_stdin_ends_the_process_and_closes_the_device_session(sessions: Any, era: str) -> None:
    client = sessions([sys.executable, __file__], {"CLOSED_MARK": "1", "WRITES": "1"}, era)
    client.start("hang", {**GOOD, "text": "the call"})
    hear(client, b"the call hangs")
    code, _ = client.close()
    assert code == 0
    assert b"session closed" in client.stderr
    assert b"Traceback" not in client.stderr


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_the_process_in_order(sessions: Any, number: signal.Signals) -> None:
    client = sessions([sys.executable, __file__], {"CLOSED_MARK": "1"})
    client.process.send_signal(number)
    assert client.process.wait(timeout=60.0) == 0
    client.close()
    assert b"session closed" in client.stderr


def test_files_instead_of_pipes_do_not_hang(tmp_path: Any) -> None:
    source = tmp_path / "requests.jsonl"
    parameters = {"protocolVersion": LEGACY, "capabilities": {}, "clientInfo": {"name": "t", "version": "1"}}
    source.write_text(json.dumps({"jsonrpc": "2.0", "id": 1, "method": "initialize", "params": parameters}) + "\n")
    with source.open() as requests, (tmp_path / "answers").open("w") as answers:
        done = subprocess.run([sys.executable, __file__], stdin=requests, stdout=answers, timeout=60, check=False)
    assert done.returncode == 0


ITSELF = [sys.executable, __file__]
HEADERS = {
    "Accept": "application/json, text/event-stream",
    "MCP-Protocol-Version": MODERN,
    "Mcp-Method": "tools/call",
    "Mcp-Name": "take",
}
CALL = {
    "jsonrpc": "2.0",
    "id": 1,
    "method": "tools/call",
    "params": {"name": "take", "arguments": {"word": "5"}, "_meta": ENVELOPE},
}


def test_streamable_http_serves_the_same_tools_from_the_moment_of_its_announcement(over_http: Any) -> None:
    import httpx2

    with over_http(ITSELF, {}) as url:
        text = httpx2.post(url, json=CALL, headers=HEADERS, timeout=60.0).text
        payload = json.loads(text if text.startswith("{") else text.partition("data: ")[2].splitlines()[0])
        error = payload["result"]["structuredContent"]["error"]
        assert (error["code"], error["field"]) == ("invalid_input", "/word")


def test_only_the_web_pages_that_are_named_may_call(over_http: Any) -> None:
    import httpx2

    named = "http://localhost:6274"
    others = ["http://evil.example", "http://localhost:6275", "http://localhost", "http://127.0.0.1:6274", "null"]
    with (
        over_http(ITSELF, {"MCP_HTTP_ORIGINS": f"{named}, https://plant.example"}) as url,
        httpx2.Client(timeout=60.0) as client,
    ):

        def status(origin: str) -> int:
            return client.post(url, json=CALL, headers={**HEADERS, "Origin": origin}).status_code

        assert [status(named), status("https://plant.example")] == [200, 200]
        assert [status(origin) for origin in others] == [403] * len(others)
    with over_http(ITSELF, {}) as url:
        own = url.removesuffix("/mcp")
        assert httpx2.post(url, json=CALL, headers={**HEADERS, "Origin": own}, timeout=60.0).status_code == 200
        assert httpx2.post(url, json=CALL, headers={**HEADERS, "Origin": f"{own}0"}, timeout=60.0).status_code == 403


def test_an_answer_over_http_is_not_held_back(over_http: Any) -> None:
    # Nagle's algorithm held each answer's body back until the client's delayed ACK: never less than 40 ms, after the first
    # answers of a connection, which Linux acknowledges at once. The fastest of hundreds is not a question of a busy machine.
    times: list[float] = []
    with over_http(ITSELF, {}) as url:
        connection = http.client.HTTPConnection(urlsplit(url).netloc, timeout=60.0)
        while len(times) < 40 or (times[-1] >= 0.03 and len(times) < 400):
            begun = time.perf_counter()
            connection.request("POST", "/mcp", json.dumps(CALL), {**HEADERS, "Content-Type": "application/json"})
            answer = connection.getresponse()
            assert (answer.status, b"invalid_input" in answer.read()) == (200, True)
            times.append(time.perf_counter() - begun)
        connection.close()
    assert times[-1] < 0.03


@pytest.mark.parametrize(
    "setting",
    [
        {"MCP_TRANSPORT": "pigeon"},
        # A host other than loopback.
        {"MCP_HTTP_HOST": "0.0.0.0", "MCP_TRANSPORT": "streamable-http"},  # noqa: S104
        # What let every page of the machine call.
        {"MCP_HTTP_ORIGINS": "http://localhost:*", "MCP_TRANSPORT": "streamable-http"},
    ],
    ids=lambda setting: next(iter(setting)),
)
def test_a_transport_that_is_not_offered_is_one_sentence_and_exit_code_2(setting: dict[str, str]) -> None:
    env = {**os.environ, **setting}
    done = subprocess.run([sys.executable, __file__], env=env, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert len(done.stderr.splitlines()) == 1
    assert next(iter(setting)) in done.stderr


if __name__ == "__main__":
    sys.exit(serve(build()))
