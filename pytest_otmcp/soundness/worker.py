"""``python -m …soundness.worker ISOLATION``: judge defects one after another, over one plant, behind the walls that were asked for.

Each line of standard input is a defect as it is listed, each line of standard output what was seen. When standard input ends,
what is under way is broken off, and devices and adapters are ended: so nothing is left, however the process ends that asked.
"""

from __future__ import annotations

import json
import os
import queue
import signal
import sys
import tempfile
import threading
import time
from typing import Any

from ..core.errors import ExhaustedError, KitError
from ..plant.devices import Plant
from ..session.isolation import Isolation
from ..session.loop import LoopThread
from .defect import defect
from .judging import judge
from .warm_start import WarmStart

__all__ = ["main"]

_MOST_CHARACTERS = 400


def main() -> None:
    """Judge until standard input ends."""
    # A shell may have it ignored, and this process inherits that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    # What else is printed must not be taken for an answer.
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    jobs = _Jobs()
    try:
        with tempfile.TemporaryDirectory(prefix="otmcp-") as directory:
            # What an adapter writes into the folder in which it works must not be seen by the items of another worker.
            os.chdir(directory)
            _serve(jobs, answers, sys.argv[1])
    except (KeyboardInterrupt, BrokenPipeError):
        # Nobody waits for the answer any more.
        sys.exit(1)


def _serve(jobs: _Jobs, answers: Any, mode: str) -> None:
    loop, isolation, warm = LoopThread(), Isolation(mode), WarmStart()
    plant = Plant(isolation=isolation)
    try:
        while (job := jobs.next()) is not None:
            answer = _answer(loop, plant, warm, job)
            jobs.finished()
            print(json.dumps(answer), file=answers, flush=True)
    finally:
        loop.run(plant.close())
        isolation.close()
        loop.close()
        warm.close()


def _answer(loop: LoopThread, plant: Plant, warm: WarmStart, job: dict[str, Any]) -> dict[str, Any]:
    begun = time.monotonic()
    try:
        seen = loop.run(judge(plant, warm, defect(job)))
        loop.check()
    except KitError as error:
        return {"error": str(error), "exhausted": isinstance(error, ExhaustedError)}
    return {
        "items": sorted(seen.items),
        "requirements": sorted(seen.requirements),
        "faults": seen.faults,
        "words": [text[:_MOST_CHARACTERS] for text in seen.words],
        "seconds": time.monotonic() - begun,
    }


class _Jobs:
    """The lines of standard input. Their end interrupts a job that is under way."""

    def __init__(self) -> None:
        self._lines: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._at_work = False
        self._ended = False
        threading.Thread(target=self._read, daemon=True).start()

    def next(self) -> dict[str, Any] | None:
        """Wait for the next job; None when there is none any more."""
        line = self._lines.get()
        with self._lock:
            if line is None or self._ended:
                return None
            self._at_work = True
        job: dict[str, Any] = json.loads(line)
        return job

    def finished(self) -> None:
        """Say that the job is done: the end of the input interrupts nothing until the next one."""
        with self._lock:
            self._at_work = False

    def _read(self) -> None:
        # Without a buffer, because the thread may be in the middle of a read when the interpreter ends.
        with open(0, "rb", buffering=0, closefd=False) as lines:
            for line in lines:
                self._lines.put(line)
        with self._lock:
            self._ended = True
            if self._at_work and (main_thread := threading.main_thread().ident) is not None:
                signal.pthread_kill(main_thread, signal.SIGINT)
        self._lines.put(None)


if __name__ == "__main__":
    main()
