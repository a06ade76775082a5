"""Only the console's own page gets in, over real sockets."""

from __future__ import annotations

import http.client
import json
import threading
from collections.abc import Iterator
from concurrent.futures import Future
from pathlib import Path

import pytest

from pytest_otmcp.console.server import HOST, listening, serve
from pytest_otmcp.core.errors import UsageError
from pytest_otmcp.session.isolation import Isolation
from pytest_otmcp.session.loop import LoopThread

JSON = {"Content-Type": "application/json"}


class Console:
    """A console without adapters and records, at a port of this machine."""

    def __init__(self, address: str) -> None:
        origin, _, self.token = address.partition("/#")
        self.origin = origin
        self.host = origin.removeprefix("http://")
        self.bearer = {"Authorization": f"Bearer {self.token}"}

    def ask(self, method: str, path: str, headers: dict[str, str], body: str | None = None) -> tuple[int, str, str]:
        """Return status, body and Content-Security-Policy of the answer to a request."""
        connection = http.client.HTTPConnection(self.host, timeout=30)
        try:
            connection.request(method, path, body, headers)
            answer = connection.getresponse()
            return answer.status, answer.read().decode(), answer.headers["content-security-policy"]
        finally:
            connection.close()

    def status(self, headers: dict[str, str], path: str = "/api/report", body: str = "{}") -> int:
        """Return the status of the answer to a POST."""
        return self.ask("POST", path, headers, body)[0]


@pytest.fixture(scope="module")
def console() -> Iterator[Console]:
    """A console that is served by this process."""
    ready: Future[str] = Future()
    loop, isolation, at = LoopThread(), Isolation("off"), listening(0)
    serving = serve(
        [], [], isolation, at, walls="off", render=lambda records, directory: [], endpoint=None, ready=ready.set_result
    )
    ended = threading.Event()

    async def until_ended() -> None:
        import asyncio

        task = asyncio.create_task(serving)
        await asyncio.to_thread(ended.wait)
        task.cancel()
        await asyncio.wait({task})

    thread = threading.Thread(target=loop.run, args=(until_ended(),))
    thread.start()
    yield Console(ready.result(timeout=30))
    ended.set()
    thread.join()
    loop.close()
    isolation.close()
    at.close()


def test_the_page_asks_with_its_key_and_gets_an_answer(console: Console) -> None:
    status, body, _ = console.ask("POST", "/api/report", {**JSON, **console.bearer}, '{"records": []}')
    assert (status, json.loads(body)["problem"]) == (200, "choose a record for its report, or several to compare them")


@pytest.mark.parametrize("path", ["/", "/console.js", "/console.css"])
def test_the_page_itself_holds_no_secret_and_may_run_and_load_nothing_but_its_own(console: Console, path: str) -> None:
    status, body, policy = console.ask("GET", path, {})
    assert (status, console.token in body) == (200, False)
    assert policy.startswith("default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'")
    assert "unsafe" not in policy


@pytest.mark.parametrize("given", ["", "Bearer x", "Bearer ", "Basic x"])
def test_a_wrong_key_is_refused(console: Console, given: str) -> None:
    assert console.status({**JSON, "Authorization": given}) == 401
    assert console.ask("GET", "/api/events", {"Authorization": given})[0] == 401


@pytest.mark.parametrize("host", ["evil.example", "localhost", "127.0.0.1", "127.0.0.1:1"])
def test_a_name_that_was_made_to_lead_here_is_refused(console: Console, host: str) -> None:
    assert console.status({**JSON, **console.bearer, "Host": host}) == 421
    assert console.ask("GET", "/", {"Host": host})[0] == 421


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://127.0.0.1:1", "https://{host}", "http://{host}.evil.example"]
)
def test_another_origin_is_refused_even_with_the_key(console: Console, origin: str) -> None:
    headers = {**JSON, **console.bearer, "Origin": origin.format(host=console.host)}
    assert console.status(headers) == 403


def test_the_own_origin_is_let_in(console: Console) -> None:
    assert console.status({**JSON, **console.bearer, "Origin": console.origin, "Sec-Fetch-Site": "same-origin"}) == 200


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_a_request_of_another_page_is_refused_even_with_the_key(console: Console, site: str) -> None:
    assert console.status({**JSON, **console.bearer, "Sec-Fetch-Site": site}) == 403


@pytest.mark.parametrize("kind", ["application/x-www-form-urlencoded", "text/plain", "application/json; charset=utf-8"])
def test_a_form_is_refused_even_with_the_key(console: Console, kind: str) -> None:
    assert console.status({**console.bearer, "Content-Type": kind}) == 415


@pytest.mark.parametrize("body", ["", "[]", "{", '"x"', "[" * 100_000])
def test_what_is_no_json_object_is_refused_in_a_sentence(console: Console, body: str) -> None:
    status, answer, _ = console.ask("POST", "/api/call", {**JSON, **console.bearer}, body)
    assert (status, json.loads(answer)) == (200, {"problem": "a request is a JSON object"})


@pytest.mark.parametrize("bench", ["0", "-1", "true", '"otmcp.toml"', "null", "1e3"])
def test_nothing_is_started_but_what_was_given_on_the_command_line(console: Console, bench: str) -> None:
    body = f'{{"bench": {bench}, "do": "start", "variant": "rw", "command": ["sh"]}}'
    status, answer, _ = console.ask("POST", "/api/adapter", {**JSON, **console.bearer}, body)
    assert (status, json.loads(answer)) == (200, {"problem": "there is no such adapter"})


@pytest.mark.parametrize(
    "path", ["/report/x/report.html", "/report/../report.html", "/report/%2e%2e/report.html", "/report//run.json"]
)
def test_a_report_is_behind_an_address_that_nobody_guesses(console: Console, path: str) -> None:
    assert console.ask("GET", path, {})[0] == 404


def test_a_port_that_is_taken_is_said_in_a_sentence(console: Console) -> None:
    port = int(console.host.rpartition(":")[2])
    with pytest.raises(UsageError, match=rf"--port {port}: {HOST}:{port} cannot be had: Address already in use"):
        listening(port)


def test_nothing_listens_beyond_the_loopback_interface(console: Console) -> None:
    lines = Path("/proc/net/tcp").read_text().splitlines()[1:]
    port = f"{int(console.host.rpartition(':')[2]):04X}"
    listens = [line.split()[1] for line in lines if line.split()[3] == "0A" and line.split()[1].endswith(f":{port}")]
    assert listens == [f"0100007F:{port}"]
