"""The control channel of a device: newline-delimited JSON on a Unix socket (see ``control_socket``).

A request is ``{"id": 1, "op": "image"}``; its answer ``{"id": 1, "ok": true, "result": {…}}`` or
``{"id": 1, "ok": false, "error": "one sentence"}``. Any number of clients may be connected; requests may be pipelined and
are executed one after the other; only a ``wait`` does not delay the requests after it.

======================================================  ========================================================
``ready``                                               ``{"protocol", "port", "pid"}``
``image``                                               the values that the device really holds
``poke {params}``                                       set a value out of band
``fault {rules}``                                       replace the fault plan; ``{"hits": […]}`` of the old one
``reset``                                               start-up values, no faults
``alone``                                               accept no further client, end the others; ``{"others"}``: who has connected
``pause`` / ``resume``                                  stop or start the free-running 1 Hz simulation
``tick {steps}``                                        advance the simulation by hand, seconds of plant time
``journal {since}``                                     ``{"records", "first", "next", "dropped", "peers"}``, see :mod:`.journal`
``wait {since, timeout_s}``                             the same, as soon as there are any, or after ``timeout_s``
``forget {before}``                                     release the records before this one; ``{"first", "next"}``
======================================================  ========================================================
"""

from __future__ import annotations

import asyncio
import json
import os
import socket
import traceback
from collections import deque
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import asdict
from typing import Any, TypeVar

from .device import Device, Simulation
from .peer import Process, client

__all__ = ["ControlServer"]

_LINE_LIMIT = 16 * 1024 * 1024
_WAIT_LIMIT_S = 600.0
_TURNS = 16
_MET = 20

Request = Mapping[str, Any]
T = TypeVar("T")


class ControlServer:
    """The server of the control channel of one device."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._simulation = Simulation(device)
        self._server: asyncio.Server | None = None
        self._clients: set[asyncio.StreamWriter] = set()
        # Also those that have gone: what they have asked for was done.
        self._met: deque[tuple[asyncio.StreamWriter, Process | None]] = deque(maxlen=_MET)
        self._closed = False
        self._ops: dict[str, Callable[[Request], Awaitable[dict[str, Any]]]] = {
            "ready": self._ready,
            "image": self._image,
            "poke": self._poke,
            "fault": self._fault,
            "reset": self._reset,
            "pause": self._pause,
            "resume": self._resume,
            "tick": self._tick,
            "journal": self._journal,
            "forget": self._forget,
            "wait": self._wait,
        }

    async def start(self, listener: socket.socket) -> None:
        """Accept connections on a listening socket and begin the simulation."""
        self._server = await asyncio.start_server(self._serve, sock=listener, limit=_LINE_LIMIT)
        self._simulation.resume()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self._closed:
            # It was accepted before the channel was closed, and is begun with afterwards.
            writer.close()
            return
        waits: set[asyncio.Task[None]] = set()
        self._clients.add(writer)
        self._met.append((writer, client(writer.get_extra_info("socket"))))
        try:
            while line := await reader.readline():
                request = _parsed(line)
                if request.get("op") == "wait":
                    task = asyncio.create_task(self._answer(request, writer))
                    waits.add(task)
                    task.add_done_callback(waits.discard)
                else:
                    await self._answer(request, writer)
        except (ConnectionError, ValueError):
            # The client is gone, or sent a line longer than the limit.
            pass
        except asyncio.CancelledError:
            # The process ends. Python 3.11's streams report a handler that ends as cancelled as an error.
            pass
        finally:
            for task in waits:
                task.cancel()
            self._clients.discard(writer)
            writer.close()

    async def _answer(self, request: Request, writer: asyncio.StreamWriter) -> None:
        answer: dict[str, Any] = {"id": request.get("id"), "ok": False}
        try:
            if request.get("op") == "alone":
                result = self._alone(writer)
            else:
                operation = self._operation(request)
                await self._device.caught_up()
                result = await operation(request)
            line = json.dumps({**answer, "ok": True, "result": result}, separators=(",", ":"))
        except ValueError as error:
            line = json.dumps({**answer, "error": str(error)})
        except Exception as error:
            # This is a bug of the device. The client has to be told; the channel goes on.
            traceback.print_exc()
            line = json.dumps({**answer, "error": f"the device failed: {type(error).__name__}: {error}"})
        writer.write(line.encode() + b"\n")

    def _alone(self, writer: asyncio.StreamWriter) -> dict[str, Any]:
        """Close the channel to everybody but this client: who else reaches it could change what the device reports."""
        assert self._server is not None
        self._server.close()
        self._closed = True
        for other in self._clients - {writer}:
            other.close()
        return {"others": [None if it is None else asdict(it) for other, it in self._met if other is not writer]}

    def _operation(self, request: Request) -> Callable[[Request], Awaitable[dict[str, Any]]]:
        op = request.get("op")
        if not isinstance(op, str) or op not in self._ops:
            raise ValueError(f"unknown op {op!r}; known are {', '.join(self._ops)}")
        return self._ops[op]

    async def _ready(self, request: Request) -> dict[str, Any]:
        return {"protocol": self._device.protocol, "port": self._device.port, "pid": os.getpid()}

    async def _image(self, request: Request) -> dict[str, Any]:
        return self._device.image()

    async def _poke(self, request: Request) -> dict[str, Any]:
        params = _member(request, "params", dict)
        try:
            await self._device.poke(params)
        except KeyError as error:
            raise ValueError(f"the poke lacks {error}") from None
        return {}

    async def _fault(self, request: Request) -> dict[str, Any]:
        rules = _member(request, "rules", list)
        if not all(isinstance(rule, dict) for rule in rules):
            raise ValueError("rules: every fault rule is an object")
        return {"hits": self._device.fault(rules)}

    async def _reset(self, request: Request) -> dict[str, Any]:
        await self._simulation.reset()
        return {"dead_connections": self._device.dead_connections}

    async def _pause(self, request: Request) -> dict[str, Any]:
        await self._simulation.pause()
        return {}

    async def _resume(self, request: Request) -> dict[str, Any]:
        self._simulation.resume()
        return {}

    async def _tick(self, request: Request) -> dict[str, Any]:
        await self._simulation.tick(_member(request, "steps", int, 1))
        return {}

    async def _journal(self, request: Request) -> dict[str, Any]:
        # A message that reached this machine before this request must be in the journal before the answer, also when
        # the process had to wait for the processor and found both at once: a connection takes some turns of the loop
        # from its acceptance to its first request.
        for _ in range(_TURNS):
            await asyncio.sleep(0)
        self._device.journal.reads += 1
        return self._records(request)

    async def _forget(self, request: Request) -> dict[str, Any]:
        journal = self._device.journal
        journal.forget(_member(request, "before", int))
        return {"first": journal.first, "next": journal.next}

    async def _wait(self, request: Request) -> dict[str, Any]:
        timeout_s = min(_member(request, "timeout_s", float), _WAIT_LIMIT_S)
        await self._device.journal.wait(_member(request, "since", int), timeout_s)
        return self._records(request)

    def _records(self, request: Request) -> dict[str, Any]:
        journal = self._device.journal
        records = journal.since(_member(request, "since", int))
        return {
            "records": [record.told() for record in records],
            "first": journal.first,
            "next": journal.next,
            "dropped": journal.dropped,
            "peers": journal.peers(records),
        }


def _parsed(line: bytes) -> Request:
    # A line that is no request is answered as a request without op, so its sender is told.
    try:
        request = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return request if isinstance(request, dict) else {}


def _member(request: Request, name: str, kind: type[T], default: T | None = None) -> T:
    value = request.get(name, default)
    if kind is float and type(value) is int:
        value = float(value)
    if type(value) is not kind:
        raise ValueError(f"{name}: expected {kind.__name__}, found {value!r}")
    return value
