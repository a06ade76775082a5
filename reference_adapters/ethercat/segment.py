"""The line of slaves as the tools use it: requests to the process in which the library blocks, one at a time.

A read that found its slave lost is made once more after the line was set up anew; a write is not: only the slave knows whether it was
carried out.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
from pathlib import Path
from typing import Any

from ..core import AdapterError, Call, Lost, repeat_once
from .refusals import refusal, state_refused

__all__ = ["Segment"]

_WORKER = Path(__file__).with_name("worker.py")
_END_S = 1.0
_MEANINGS = {
    "interface": "the network interface cannot be opened; is its name right, and may this program open packet sockets (CAP_NET_RAW)?",
    "slaves": "no slave answers; is the line on, and is the interface the right one?",
}


class Segment:
    """One line.

    Args:
        interface: name of the network interface.
        timeout_s: seconds for which an answer of a slave is waited for.
        cycle_s: seconds between two exchanges of process data.
        watchdog_s: seconds after which a slave gives its outputs up.
    """

    def __init__(self, interface: str, *, timeout_s: float, cycle_s: float, watchdog_s: float) -> None:
        self.timeout_s, self.cycle_s, self.watchdog_s = timeout_s, cycle_s, watchdog_s
        self._words = [interface, str(timeout_s), str(cycle_s), str(watchdog_s)]
        self._turn = asyncio.Lock()
        self._process: asyncio.subprocess.Process | None = None
        self._under_way: asyncio.Task[dict[str, Any]] | None = None
        self._before = 0
        """Generations of workers that have ended."""
        self._generation = 0

    async def ask(self, call: Call, op: str, *, changes: bool = False, **members: Any) -> Any:
        """Have the worker do something on the line.

        Args:
            call: that asks.
            op: name of a method of the worker's line.
            changes: it may change the plant.
            members: arguments of the method.

        Raises:
            AdapterError: the line cannot be opened, a slave refuses or does not answer.
        """
        async with self._turn:
            return await repeat_once(call, lambda: self._attempt(call, op, changes, members))

    async def local(self, op: str) -> Any:
        """Have the worker say something that asks the line nothing."""
        async with self._turn:
            return (await self._request(op, {}))["ok"]

    async def _attempt(self, call: Call, op: str, changes: bool, members: dict[str, Any]) -> Any:
        position = members.get("position")
        self._accepted(call, answer := await self._request("open", {"position": position}))
        opened = answer["ok"]
        self._generation = self._before + opened["generation"]
        call.connection(generation=self._generation, fresh=opened["fresh"])
        if position is not None and position >= opened["slaves"]:
            message = f"the line has {opened['slaves']} slaves, whose positions count from 0"
            outcome = "not_sent" if call.writes else None
            raise AdapterError("illegal_address", message, field="/slave_position", outcome=outcome)
        call.sending(changes_state=changes)
        call.trace |= {name: members[name] for name in ("index", "subindex") if name in members}
        if position is not None:
            call.trace["slave"] = position
        answer = await self._request(op, members)
        self._accepted(call, answer)
        call.answered()
        return answer["ok"]

    def _accepted(self, call: Call, answer: dict[str, Any]) -> None:
        """Raise what an answer of the worker says went wrong."""
        kind = answer.get("error")
        if kind is None:
            return
        if kind in ("abort", "state", "protocol"):
            call.answered()
        if kind == "abort":
            raise refusal(call, answer["code"])
        if kind == "state":
            raise state_refused(call, answer["code"], answer["state"])
        if kind == "timeout":
            raise AdapterError("timeout", f"the slave did not answer within {self.timeout_s:g} s")
        if kind == "protocol":
            raise AdapterError("protocol_error", "the answer is not the one to the request")
        call.disconnected()
        if kind == "connect":
            raise AdapterError("connect_failed", _MEANINGS[answer["why"]], outcome="not_sent")
        message = "the slave does not answer any more, or has to be set up anew"
        if kind == "short":
            message = "the slaves did not all take the frame (working counter)"
        raise Lost(AdapterError("connection_lost", message))

    async def _request(self, op: str, members: dict[str, Any]) -> dict[str, Any]:
        if self._under_way is not None:
            # A call that nobody waits for any more has asked for it; the library cannot be interrupted.
            await asyncio.wait({self._under_way})
        self._under_way = asyncio.create_task(self._exchange(json.dumps({"op": op, **members})))
        return await asyncio.shield(self._under_way)

    async def _exchange(self, request: str) -> dict[str, Any]:
        process = await self._started()
        assert process.stdin is not None
        assert process.stdout is not None
        with contextlib.suppress(ConnectionError):
            process.stdin.write(request.encode() + b"\n")
            await process.stdin.drain()
        answer = await process.stdout.readline()
        if not answer:
            self._before, self._process = self._generation, None
            return {"error": "lost"}
        found: dict[str, Any] = json.loads(answer)
        return found

    async def _started(self) -> asyncio.subprocess.Process:
        if self._process is None or self._process.returncode is not None:
            self._process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-P", str(_WORKER), *self._words),
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
            )
        return self._process

    async def close(self) -> None:
        """End the worker; the watchdogs of the slaves do the rest."""
        process, self._process = self._process, None
        if process is None or process.returncode is not None:
            return
        assert process.stdin is not None
        process.stdin.close()
        try:
            async with asyncio.timeout(_END_S):
                await process.wait()
        except TimeoutError:
            process.kill()
            await process.wait()
