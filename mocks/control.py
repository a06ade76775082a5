"""The control channel of a device: newline-delimited JSON on a loopback port.

A request is ``{"id": 1, "op": "image"}``; its answer ``{"id": 1, "ok": true, "result": {…}}`` or
``{"id": 1, "ok": false, "error": "one sentence"}``. Requests may be pipelined; answers may overtake a ``wait``.

======================================================  ========================================================
``ready``                                               ``{"protocol", "pid"}``
``image``                                               what the device really holds
``poke {params}``                                       set a value out of band
``fault {rules}``                                       replace the fault plan; ``{"hits": […]}`` of the old one
``reset``                                               start-up values, no faults
``pause`` / ``resume``                                  stop or start the free-running 1 Hz simulation
``tick {steps}``                                        advance the simulation by hand
``journal {since}``                                     ``{"entries", "next", "dropped"}``
``journal_reset``                                       forget the entries; ``{"next"}``
``wait {since, match, count, timeout_s}``               matching entries, as soon as there are ``count``
======================================================  ========================================================
"""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from .device import Device, Simulation

__all__ = ["ControlServer"]

_LINE_LIMIT = 16 * 1024 * 1024
_WAIT_LIMIT_S = 600.0

Request = Mapping[str, Any]


class ControlServer:
    """Serves the control channel of one device."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._simulation = Simulation(device)
        self._server: asyncio.Server | None = None
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
            "journal_reset": self._journal_reset,
            "wait": self._wait,
        }

    async def start(self) -> int:
        """Listen on an ephemeral loopback port and begin the simulation; return the port."""
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0, limit=_LINE_LIMIT)
        self._simulation.resume()
        port: int = self._server.sockets[0].getsockname()[1]
        return port

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        pending: set[asyncio.Task[None]] = set()
        try:
            while line := await reader.readline():
                # Only a wait takes time; everything else is answered in order, before the next line is read.
                task = asyncio.create_task(self._answer(line, writer))
                pending.add(task)
                task.add_done_callback(pending.discard)
                if b'"wait"' not in line:
                    await task
        except (ConnectionError, ValueError):
            pass
        finally:
            for task in pending:
                task.cancel()
            writer.close()

    async def _answer(self, line: bytes, writer: asyncio.StreamWriter) -> None:
        identifier: Any = None
        try:
            request = json.loads(line)
            identifier = request["id"]
            result = await self._ops[request["op"]](request)
            answer = {"id": identifier, "ok": True, "result": result}
        except KeyError as error:
            answer = {"id": identifier, "ok": False, "error": f"the request lacks or does not know {error}"}
        except (ValueError, TypeError) as error:
            answer = {"id": identifier, "ok": False, "error": str(error)}
        writer.write(json.dumps(answer, separators=(",", ":")).encode() + b"\n")

    async def _ready(self, request: Request) -> dict[str, Any]:
        return {"protocol": self._device.protocol, "pid": os.getpid()}

    async def _image(self, request: Request) -> dict[str, Any]:
        return self._device.image()

    async def _poke(self, request: Request) -> dict[str, Any]:
        await self._device.poke(request["params"])
        return {}

    async def _fault(self, request: Request) -> dict[str, Any]:
        return {"hits": self._device.fault(list(request["rules"]))}

    async def _reset(self, request: Request) -> dict[str, Any]:
        await self._device.reset()
        return {}

    async def _pause(self, request: Request) -> dict[str, Any]:
        await self._simulation.pause()
        return {}

    async def _resume(self, request: Request) -> dict[str, Any]:
        self._simulation.resume()
        return {}

    async def _tick(self, request: Request) -> dict[str, Any]:
        for _ in range(int(request.get("steps", 1))):
            await self._device.tick()
        return {}

    async def _journal(self, request: Request) -> dict[str, Any]:
        journal = self._device.journal
        return {"entries": journal.since(int(request["since"])), "next": journal.next, "dropped": journal.dropped}

    async def _journal_reset(self, request: Request) -> dict[str, Any]:
        self._device.journal.clear()
        return {"next": self._device.journal.next}

    async def _wait(self, request: Request) -> dict[str, Any]:
        timeout_s = min(float(request.get("timeout_s", 1.0)), _WAIT_LIMIT_S)
        entries = await self._device.journal.wait(
            int(request["since"]), request["match"], int(request.get("count", 1)), timeout_s
        )
        return {"entries": entries, "next": self._device.journal.next}
