"""Page and interface of the console on a port of the loopback interface.

The page names adapters and records by number: what is started is what the subject files say that were given on the command line.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import secrets
import socket
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from ..core.errors import KitError, NoBindingError, SubjectError, UsageError
from ..core.text import one_line
from ..session.isolation import Isolation
from ..session.loopback import HOST, serving
from ..subject.model import Subject
from .bench import Bench
from .feed import Feed
from .gate import Gate
from .prompt import Assistant, Endpoint
from .records import POLICY, Records, Render
from .runs import Runs

__all__ = ["HOST", "listening", "serve"]

_TOKEN_BYTES = 24
_LARGEST = 4 << 20
"""Bytes of a request: those of the longest message that the kit reads."""

_FILES = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/console.js": ("console.js", "text/javascript; charset=utf-8"),
    "/console.css": ("console.css", "text/css; charset=utf-8"),
}

Asked = Mapping[str, Any]


def listening(port: int) -> socket.socket:
    """Return a socket that listens on the loopback interface.

    Args:
        port: 0 for a free one.

    Raises:
        UsageError: the port is taken, or may not be had.
    """
    found = socket.socket()
    try:
        found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        found.bind((HOST, port))
        found.listen()
    except OSError as error:
        found.close()
        raise UsageError(f"--port {port}: {HOST}:{port} cannot be had: {error.strerror}") from None
    return found


async def serve(
    subjects: Sequence[Subject],
    records: Sequence[Path],
    isolation: Isolation,
    at: socket.socket,
    *,
    walls: str,
    render: Render,
    endpoint: Endpoint | None,
    ready: Callable[[str], None],
) -> None:
    """Serve the console until this is cancelled; then end every adapter and every device.

    Args:
        walls: the mode of the isolation, for runs of the suite.
        render: writes reports of records.
        endpoint: of an assistant that prompts are put to; None for none.
        ready: is given the address of the page.
    """
    origin = f"http://{HOST}:{at.getsockname()[1]}"
    token = secrets.token_urlsafe(_TOKEN_BYTES)
    feed = Feed()
    adapters = [(subject, adapter) for subject in subjects for adapter in subject.adapters.values()]
    benches = [Bench(number, *pair, isolation, feed.tell) for number, pair in enumerate(adapters)]
    with tempfile.TemporaryDirectory(prefix="otmcp-console-", ignore_cleanup_errors=True) as directory:
        kept = Records(records, Path(directory, "reports"), render)

        def ended(record: Path) -> None:
            kept.add(record)
            feed.tell(kept.listed())

        runs = Runs(subjects, walls, Path(directory), feed.tell, ended)
        console = _Console(benches, kept, runs, Assistant(endpoint, feed.tell), feed)
        try:
            async with serving(Gate(console.application(), origin, token), at, name="otmcp-console") as ended_by_itself:
                try:
                    ready(f"{origin}/#{token}")
                    await asyncio.shield(ended_by_itself)
                finally:
                    # Whoever follows the events goes.
                    feed.tell(None)
        finally:
            stops = (runs.stop(), *(bench.stop() for bench in benches))
            # All have ended before the first failure is told.
            failures = await asyncio.gather(*stops, return_exceptions=True)
            for failure in filter(None, failures):
                raise failure


class _Console:
    """The console's routes."""

    def __init__(
        self, benches: Sequence[Bench], records: Records, runs: Runs, assistant: Assistant, feed: Feed
    ) -> None:
        self._benches = benches
        self._records = records
        self._runs = runs
        self._assistant = assistant
        self._feed = feed
        self._began_ms = time.monotonic_ns() / 1e6

    def application(self) -> Starlette:
        """Return the application that stands behind the gate."""
        posts: dict[str, Callable[[Asked], Awaitable[Mapping[str, object]]]] = {
            "adapter": self._adapter,
            "call": self._call,
            "decide": self._decide,
            "device": self._device,
            "image": self._image,
            "copy": self._copy,
            "report": self._report,
            "run": self._run,
            "ask": self._ask,
        }
        return Starlette(
            routes=[
                *(Route(path, _file(*file)) for path, file in _FILES.items()),
                *(Route(f"/api/{name}", _answering(answer), methods=["POST"]) for name, answer in posts.items()),
                Route("/api/events", self._events),
                Route("/report/{secret}/{name}", self._page),
            ]
        )

    async def _events(self, request: Request) -> Response:
        async def lines() -> AsyncIterator[str]:
            # The page is on the list before it is told what there is: nothing falls between the two.
            with self._feed.page() as events:
                yield _line({"kind": "console", "began_ms": self._began_ms})
                yield _line(self._records.listed())
                yield _line(self._runs.state())
                yield _line(self._assistant.state())
                for bench in self._benches:
                    for event in bench.story():
                        yield _line(event)
                yield _line({"kind": "ready"})
                async for event in events:
                    yield _line(event)

        return StreamingResponse(lines(), media_type="application/x-ndjson")

    def _bench(self, asked: Asked) -> Bench:
        number = asked.get("bench")
        if type(number) is not int or number not in range(len(self._benches)):
            raise UsageError("there is no such adapter")
        return self._benches[number]

    async def _adapter(self, asked: Asked) -> Mapping[str, object]:
        bench = self._bench(asked)
        await (bench.start(str(asked.get("variant"))) if asked.get("do") == "start" else bench.stop())
        return {}

    async def _call(self, asked: Asked) -> Mapping[str, object]:
        await self._bench(asked).call(str(asked.get("tool")), str(asked.get("arguments")))
        return {}

    async def _decide(self, asked: Asked) -> Mapping[str, object]:
        return {"said": await self._bench(asked).decide(asked.get("number"), asked.get("do"), asked.get("content"))}

    async def _device(self, asked: Asked) -> Mapping[str, object]:
        await self._bench(asked).to_device(str(asked.get("do")), asked.get("value"))
        return {}

    async def _ask(self, asked: Asked) -> Mapping[str, object]:
        await self._assistant.ask(self._bench(asked), str(asked.get("prompt")))
        return {}

    async def _image(self, asked: Asked) -> Mapping[str, object]:
        return {"text": await self._bench(asked).image()}

    async def _copy(self, asked: Asked) -> Mapping[str, object]:
        calls = asked.get("calls")
        return {"text": self._bench(asked).copied(str(asked.get("form")), calls if isinstance(calls, int) else 0)}

    async def _report(self, asked: Asked) -> Mapping[str, object]:
        numbers = asked.get("records")
        return await self._records.open([n for n in numbers if type(n) is int] if isinstance(numbers, list) else [])

    async def _run(self, asked: Asked) -> Mapping[str, object]:
        if asked.get("do") != "start":
            await self._runs.stop()
            return {}
        number, suites, reps = asked.get("subject"), asked.get("suites"), asked.get("reps")
        if type(number) is not int or type(reps) is not int or not isinstance(suites, list):
            raise UsageError("a run has a subject, suites and a number of repetitions")
        await self._runs.start(number, list(map(str, suites)), reps)
        return {}

    async def _page(self, request: Request) -> Response:
        path = self._records.page(request.path_params["secret"], request.path_params["name"])
        if path is None:
            return Response(status_code=404)
        headers = {"content-security-policy": POLICY}
        return Response(path.read_bytes(), media_type="text/html; charset=utf-8", headers=headers)


def _file(name: str, media_type: str) -> Callable[[Request], Awaitable[Response]]:
    content = (resources.files(__package__) / "page" / name).read_bytes()

    async def file(request: Request) -> Response:
        return Response(content, media_type=media_type)

    return file


def _answering(
    answer: Callable[[Asked], Awaitable[Mapping[str, object]]],
) -> Callable[[Request], Awaitable[Response]]:
    """Return a route that answers a JSON object by one, and everything that goes wrong by one sentence."""

    async def route(request: Request) -> Response:
        try:
            return JSONResponse(await answer(await _asked(request)))
        except (UsageError, SubjectError, NoBindingError) as error:
            # The page asked well; a browser would take another status for a fault of the page.
            return JSONResponse({"problem": str(error)})
        except KitError as error:
            return JSONResponse({"problem": f"{one_line(str(error))} (a fault of the kit)"}, status_code=500)

    return route


async def _asked(request: Request) -> Asked:
    body = bytearray()
    async for part in request.stream():
        body += part
        if len(body) > _LARGEST:
            raise UsageError(f"a request has at most {_LARGEST} bytes")
    with contextlib.suppress(ValueError, RecursionError):
        asked = json.loads(body)
        if isinstance(asked, dict):
            return asked
    raise UsageError("a request is a JSON object")


def _line(event: Mapping[str, object]) -> str:
    return f"{json.dumps(event, default=str)}\n"
