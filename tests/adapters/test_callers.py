"""Who calls: roles of the environment and of tokens, and the SDK's own clients where a person is asked."""

from __future__ import annotations

import asyncio
import contextlib
import io
import json
import os
import sys
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import httpx2
import jwt
import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from mcp import StdioServerParameters
from mcp.client import Client as SdkClient
from mcp.client.context import ClientRequestContext
from mcp.client.streamable_http import streamable_http_client
from mcp.types import ElicitRequestParams, ElicitResult
from pytest_otmcp.reference_adapters import modbus
from pytest_otmcp.reference_adapters.core.run import serve

from .cases import MODBUS
from .conftest import LEGACY, MODERN, PATIENCE_S, Mock, OverHttp, Rig

pytestmark = pytest.mark.usefixtures("clean")
CASE = MODBUS
ISSUER, RESOURCE = "https://issuer.example/", "https://plant.example/mcp"
COMMAND = [sys.executable, "-m", "pytest_otmcp.reference_adapters", "modbus"]
POLICY = """
[rule.free]
targets = ["1/holding_registers/20"]
[rule.asked]
targets = ["1/holding_registers/50"]
approve = "client"
[rule.maintenance]
targets = ["1/holding_registers/70"]
roles = ["engineer"]
"""


class Issuer:
    """An issuer of tokens with one key."""

    def __init__(self, folder: Path) -> None:
        self._key = ec.generate_private_key(ec.SECP256R1())
        self.keys = folder / "keys.json"
        public = jwt.algorithms.ECAlgorithm.to_jwk(self._key.public_key(), as_dict=True)
        self.keys.write_text(json.dumps({"keys": [{**public, "kid": "one", "alg": "ES256", "use": "sig"}]}))

    def token(self, scope: str = "ot:read", *, without: str = "", **other: Any) -> str:
        now = int(time.time())
        claims = {"iss": ISSUER, "aud": RESOURCE, "sub": "alice", "iat": now, "exp": now + 600, "scope": scope} | other
        claims.pop(without, None)
        return jwt.encode(claims, self._key, algorithm="ES256", headers={"kid": "one"})


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("callers")


@pytest.fixture(scope="module")
def issuer(folder: Path) -> Issuer:
    return Issuer(folder)


@pytest.fixture(scope="module")
def settings(rig: Rig, folder: Path) -> dict[str, str]:
    (folder / "policy.toml").write_text(POLICY)
    return rig.settings("called", writes="true", OT_POLICY=str(folder / "policy.toml"))


@pytest.fixture(scope="module")
def log(folder: Path) -> Path:
    return folder / "audit.jsonl"


@pytest.fixture(scope="module")
def url(issuer: Issuer, settings: dict[str, str], log: Path, over_http: OverHttp) -> Iterator[str]:
    """The adapter over HTTP; OT_ROLE says what it must not be taken for."""
    with over_http(COMMAND, settings | authorised(issuer) | {"OT_AUDIT_LOG": str(log)}) as found:
        yield found


def authorised(issuer: Issuer) -> dict[str, str]:
    return {
        "MCP_AUTH_ISSUER": ISSUER,
        "MCP_AUTH_RESOURCE": RESOURCE,
        "MCP_AUTH_KEYS": str(issuer.keys),
        "OT_ROLE": "engineer",
    }


def post(url: str, token: str | None, address: int = 20, **arguments: Any) -> httpx2.Response:
    meta = {
        "io.modelcontextprotocol/protocolVersion": MODERN,
        "io.modelcontextprotocol/clientCapabilities": {},
        "io.modelcontextprotocol/clientInfo": {"name": "tests", "version": "1"},
    }
    members = {"address": address, "value": 1, **arguments}
    params = {"name": "write_register", "arguments": members, "_meta": meta}
    headers = {
        "Accept": "application/json, text/event-stream",
        "MCP-Protocol-Version": MODERN,
        "Mcp-Method": "tools/call",
        "Mcp-Name": "write_register",
    }
    if token is not None:
        headers["Authorization"] = f"Bearer {token}"
    call = {"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": params}
    return httpx2.post(url, json=call, headers=headers, timeout=PATIENCE_S)


def envelope(response: httpx2.Response) -> dict[str, Any]:
    text = response.text
    payload = json.loads(text if text.startswith("{") else text.partition("data: ")[2].splitlines()[0])
    found: dict[str, Any] = payload["result"]["structuredContent"]
    return found


def test_a_role_is_that_of_the_token(url: str, issuer: Issuer, device: Mock, log: Path) -> None:
    before = len(log.read_bytes().splitlines())
    mark = device.mark()
    viewer, operator, engineer = (issuer.token(f"ot:read{more}") for more in ("", " ot:operate", " ot:engineer"))
    for token, address in ((viewer, 20), (operator, 70)):
        answer = envelope(post(url, token, address))
        assert answer["error"]["code"] == "access_denied"
        assert answer["meta"]["policy"]["principal"] == f"{ISSUER}#alice"
    assert device.since(mark, state_changing=True) == []
    for token, address in ((operator, 20), (engineer, 70)):
        assert envelope(post(url, token, address))["success"]
    records = [json.loads(line) for line in log.read_bytes().splitlines()[before:]]
    assert [record["role"] for record in records] == ["viewer", "operator", *["operator"] * 2, *["engineer"] * 2]


def test_a_token_that_is_not_to_be_believed_is_refused(
    url: str, issuer: Issuer, device: Mock, tmp_path_factory: pytest.TempPathFactory
) -> None:
    mark, all_scopes = device.mark(), "ot:read ot:operate ot:engineer"
    stranger = Issuer(tmp_path_factory.mktemp("stranger"))
    now = int(time.time())
    tokens = {
        "none": None,
        "other audience": issuer.token(all_scopes, aud="https://other.example/mcp"),
        "no audience": issuer.token(all_scopes, without="aud"),
        "other issuer": issuer.token(all_scopes, iss="https://other.example/"),
        "expired": issuer.token(all_scopes, iat=now - 700, exp=now - 100),
        "no expiry": issuer.token(all_scopes, without="exp"),
        "no subject": issuer.token(all_scopes, without="sub"),
        "other key": stranger.token(all_scopes),
        "no signature": jwt.encode(
            jwt.decode(issuer.token(all_scopes), options={"verify_signature": False}), None, "none"
        ),
        "garbage": "garbage",
    }
    for name, token in tokens.items():
        response = post(url, token)
        assert response.status_code == 401, name
        assert "resource_metadata" in response.headers["WWW-Authenticate"]
    assert post(url, issuer.token("ot:operate")).status_code == 403
    assert device.since(mark, state_changing=True) == []
    assert envelope(post(url, issuer.token(all_scopes)))["success"]


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"MCP_AUTH_ISSUER": ""}, "MCP_AUTH_ISSUER"),
        ({"MCP_AUTH_KEYS": "/does/not/exist"}, "MCP_AUTH_KEYS"),
        ({"MCP_AUTH_RESOURCE": "plant"}, "MCP_AUTH_RESOURCE"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_gates_over_http_need_to_know_who_calls(
    settings: dict[str, str], issuer: Issuer, monkeypatch: pytest.MonkeyPatch, change: dict[str, str], named: str
) -> None:
    for name, value in {**settings, **authorised(issuer), "MCP_TRANSPORT": "streamable-http", **change}.items():
        monkeypatch.setenv(name, value)
    said = io.StringIO()
    with contextlib.redirect_stderr(said):
        assert serve(modbus.build()) == 2
    assert named in said.getvalue()
    assert len(said.getvalue().splitlines()) == 1


# -- the SDK's clients -------------------------------------------------------------------------------------------


def approving(client: Any, device: Mock) -> None:
    """Have writes approved and declined by a client of the SDK; see what the device got."""
    asked: list[str] = []
    answers = [ElicitResult(action="accept", content={"approve": True}), ElicitResult(action="decline")]

    async def answer(context: ClientRequestContext, params: ElicitRequestParams) -> ElicitResult:
        asked.append(params.message)
        return answers[len(asked) - 1]

    async def calls() -> list[dict[str, Any]]:
        async with client(answer) as session:
            results = [await session.call_tool("write_register", {"address": 50, "value": 9}) for _ in answers]
            return [result.structured_content for result in results]

    mark = device.mark()
    first, second = asyncio.run(calls())
    assert first["success"], first
    assert second["error"]["code"] == "approval_denied"
    assert len(asked) == 2
    assert len(device.since(mark, kind="request", state_changing=True)) == 1


MODES: list[Any] = ["legacy", "auto"]


@pytest.mark.long
@pytest.mark.parametrize("mode", MODES)
def test_a_client_of_the_sdk_asks_over_stdio(settings: dict[str, str], device: Mock, mode: Any) -> None:
    program = StdioServerParameters(
        command=COMMAND[0], args=COMMAND[1:], env={**os.environ, **settings, "OT_ROLE": "operator"}
    )
    approving(lambda answer: SdkClient(program, mode=mode, elicitation_callback=answer), device)


@pytest.mark.parametrize("mode", MODES)
def test_a_client_of_the_sdk_asks_over_http(url: str, issuer: Issuer, device: Mock, mode: Any) -> None:
    headers = {"Authorization": f"Bearer {issuer.token('ot:read ot:operate')}"}

    @contextlib.asynccontextmanager
    async def client(answer: Any) -> AsyncIterator[SdkClient]:
        async with httpx2.AsyncClient(headers=headers, timeout=PATIENCE_S) as http:
            transport = streamable_http_client(url, http_client=http)
            async with SdkClient(transport, mode=mode, elicitation_callback=answer) as session:
                yield session

    approving(client, device)


def test_in_a_session_the_role_is_that_of_the_present_token(url: str, issuer: Issuer, device: Mock) -> None:
    mark = device.mark()

    def send(http: httpx2.Client, scope: str, method: str, **params: Any) -> httpx2.Response:
        headers = {"Accept": "application/json, text/event-stream", "Authorization": f"Bearer {issuer.token(scope)}"}
        request = {"jsonrpc": "2.0", "id": 1, "method": method, "params": params}
        return http.post(url, json=request, headers=headers | session, timeout=PATIENCE_S)

    session: dict[str, str] = {}
    write = {"name": "write_register", "arguments": {"address": 20, "value": 1}}
    with httpx2.Client() as http:
        information = {"protocolVersion": LEGACY, "capabilities": {}, "clientInfo": {"name": "t", "version": "1"}}
        opened = send(http, "ot:read ot:operate", "initialize", **information)
        session["Mcp-Session-Id"] = opened.headers["mcp-session-id"]
        session["MCP-Protocol-Version"] = LEGACY
        lesser = send(http, "ot:read", "tools/call", **write)
        assert envelope(lesser)["error"]["code"] == "access_denied"
        assert device.since(mark, state_changing=True) == []
        assert envelope(send(http, "ot:read ot:operate", "tools/call", **write))["success"]
