"""A computation on an enemy's files in a process of its own, with bounded memory and time.

A record has regular expressions, images and counts that its author has chosen. Whatever they make the kit do, it ends: with the
result, or with the sentence that the bounds were not enough. ``python -m pytest_otmcp.cli.confined`` is that process: it gets a
JSON value on stdin and answers with one on stdout.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
from dataclasses import dataclass
from typing import Any

from ..core.errors import KitError, UsageError
from ..core.exhaustion import exhausted
from . import Refusal, place_of

__all__ = ["Bounds", "confined"]

_MEGABYTE = 1 << 20
_PATIENCE = 20
"""Seconds of the clock for each second of the processor: a machine may be busy, but not for ever."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """What a computation may use.

    Attributes:
        memory_mb: megabytes of address space.
        processor_s: seconds of the processor.
    """

    memory_mb: int = 1024
    processor_s: int = 60

    def __str__(self) -> str:
        return f"{self.memory_mb} MB of memory and {self.processor_s} s of the processor"


def confined(asked: dict[str, Any], bounds: Bounds, what: str) -> dict[str, Any]:
    """Examine files as :func:`~pytest_otmcp.cli.examination.examine_again` does, within these bounds.

    Args:
        asked: what is to be examined.
        bounds: of the process.
        what: the file that is to blame when they do not suffice.

    Raises:
        UsageError, Refusal: those of the examination, and a refusal when it did not end within its bounds.
        KitError: the examination failed by a fault of the kit.
    """
    command = [sys.executable, "-P", "-m", __name__, str(bounds.memory_mb), str(bounds.processor_s)]
    # Threads of a numerical library would reserve address space that this process does not have.
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    beyond = f"refused: {what} cannot be examined within {bounds}, which is plenty for any record of its size"
    try:
        done = subprocess.run(
            command,
            input=json.dumps(asked).encode(),
            capture_output=True,
            timeout=bounds.processor_s * _PATIENCE,
            env=environment,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise Refusal(beyond) from None
    if done.returncode != 0:
        # The kernel ended it: out of time, out of memory, or out of stack.
        raise Refusal(beyond)
    answer: dict[str, Any] = json.loads(done.stdout)
    if "refused" in answer:
        raise Refusal(beyond if answer["refused"] is None else answer["refused"])
    if "wrong" in answer:
        raise UsageError(answer["wrong"])
    if "broken" in answer:
        raise KitError(answer["broken"])
    return answer


def _answer(asked: dict[str, Any]) -> dict[str, Any]:
    from .examination import examine_again

    try:
        return examine_again(asked)
    except Refusal as reason:
        return {"refused": str(reason)}
    except UsageError as error:
        return {"wrong": str(error)}
    except MemoryError:
        return {"refused": None}
    except OSError as error:
        return {"wrong": f"{error.filename or asked['record']}: {exhausted(error) or error.strerror or error}"}
    except Exception as error:
        return {"broken": f"{place_of(error)}: {error!r}"}


def main() -> None:
    """Answer the question on stdin within the bounds of the command line."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    memory, seconds = int(sys.argv[1]) * _MEGABYTE, int(sys.argv[2])
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    asked, answering = json.load(sys.stdin), sys.stdout
    # A package of somebody else that judges a protocol may print.
    sys.stdout = sys.stderr
    answering.write(json.dumps(_answer(asked)))


if __name__ == "__main__":
    main()
