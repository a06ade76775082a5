"""Several workers that judge defects at the same time, each with devices and adapters of its own."""

from __future__ import annotations

import asyncio
import json
import signal
import sys
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

from ..core.errors import ExhaustedError, KitError
from .defect import Defect
from .kill_matrix import Outcome
from .seen import Seen

__all__ = ["run"]

_WORKER = f"{__package__}.worker"
_LONGEST_LINE = 1 << 20
_GRACE_S = 90.0
"""Seconds for a worker that was told to end: it closes sessions and devices, each with its own deadlines."""


async def run(
    defects: Sequence[Defect],
    workers: int,
    isolation: str,
    *,
    begun: Callable[[Defect], None],
    done: Callable[[Outcome], None],
) -> None:
    """Judge all defects, those that are listed first first. SIGINT, SIGTERM and SIGHUP end it, with nothing left running.

    Args:
        defects: what is judged.
        workers: number of processes.
        isolation: the walls around the adapters, one of :data:`~pytest_otmcp.core.walls.MODES`.
        begun: is told of a defect when its adapter is about to be started.
        done: is told what was seen.

    Raises:
        KeyboardInterrupt: a signal has ended it.
        KitError: a worker could not judge.
    """
    waiting = deque(defects)
    loop = asyncio.get_running_loop()
    working = asyncio.gather(*(_work(waiting, isolation, begun, done) for _ in range(min(workers, len(defects)))))
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    for number in numbers:
        loop.add_signal_handler(number, working.cancel)
    try:
        await working
    except asyncio.CancelledError:
        raise KeyboardInterrupt from None
    finally:
        for number in numbers:
            loop.remove_signal_handler(number)


async def _work(
    waiting: deque[Defect], isolation: str, begun: Callable[[Defect], None], done: Callable[[Outcome], None]
) -> None:
    # The worker has a session of its own: Ctrl-C in a terminal must reach it once, by the end of its input.
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-P",
        "-m",
        _WORKER,
        isolation,
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        limit=_LONGEST_LINE,
        start_new_session=True,
    )
    try:
        while waiting:
            defect = waiting.popleft()
            begun(defect)
            done(_outcome(defect, await _ask(process, defect)))
    finally:
        await _end(process)


async def _ask(process: asyncio.subprocess.Process, defect: Defect) -> dict[str, Any]:
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(json.dumps(asdict(defect)).encode() + b"\n")
    line = await process.stdout.readline()
    if not line.endswith(b"\n"):
        raise KitError(f"{defect.id}: the process that judged it ended with exit code {await process.wait()}")
    answer: dict[str, Any] = json.loads(line)
    if "error" in answer:
        fault = ExhaustedError if answer["exhausted"] else KitError
        raise fault(f"{defect.id}: {answer['error']}")
    return answer


def _outcome(defect: Defect, answer: dict[str, Any]) -> Outcome:
    seen = Seen(
        items=frozenset(answer["items"]),
        requirements=frozenset(answer["requirements"]),
        faults=tuple(answer["faults"]),
        words=tuple(answer["words"]),
    )
    return Outcome(defect=defect, seen=seen, seconds=answer["seconds"])


async def _end(process: asyncio.subprocess.Process) -> None:
    assert process.stdin is not None
    process.stdin.close()
    try:
        await asyncio.wait_for(process.wait(), _GRACE_S)
    except (TimeoutError, asyncio.CancelledError):
        # Its keeper and its devices see its end and end themselves.
        process.kill()
        await process.wait()
        raise
