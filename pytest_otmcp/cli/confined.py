"""Work on an enemy's files in a process of its own, with bounded memory and time.

A record has regular expressions, images and counts that its author has chosen. Whatever they make the kit do, it ends: with the
result, or with the sentence that the bounds were not enough. ``python -m pytest_otmcp.cli.confined`` is that process: it gets a
JSON value on stdin and answers with one on stdout. The modules that it can do the work of are :mod:`pytest_otmcp.cli.examination`
and :mod:`pytest_otmcp.cli.rendering`; each has a function ``answer``, from a JSON value to a JSON value.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Literal

from ..core.errors import ExhaustedError, KitError, UsageError, place_of
from ..core.exhaustion import exhausted
from ..core.verdict import ExitCode
from . import Refusal

__all__ = ["CEILING_S", "Bounds", "confined"]

_MEGABYTE = 1 << 20
_PROCESSOR_S = 60
_PROCESSOR_S_PER_MB = 4
"""Seconds of the processor: six times what a record needs that the kit has written."""
CEILING_S = 300
"""Seconds of the processor at most, however large the files: a regular expression of a record uses up whatever there is."""
_PATIENCE = 20
_PATIENCE_S = 900
"""Seconds of the clock: so many for each second of the processor, and no more than these for the ceiling. A machine may be busy, but not
for ever."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """What the process may use.

    Attributes:
        memory_mb: megabytes of address space.
        processor_s: seconds of the processor.
    """

    memory_mb: int = 1024
    processor_s: int = _PROCESSOR_S

    @classmethod
    def of(cls, size: int, ceiling_s: int = CEILING_S) -> Bounds:
        """Return the bounds for records of this many bytes in all, which are not above this ceiling."""
        return cls(processor_s=min(ceiling_s, _PROCESSOR_S + _PROCESSOR_S_PER_MB * (size >> 20)))

    @property
    def clock_s(self) -> int:
        """Seconds of the clock after which the process is ended."""
        return min(self.processor_s * _PATIENCE, max(_PATIENCE_S, 3 * self.processor_s))

    def __str__(self) -> str:
        return f"{self.memory_mb} MB of memory and {self.processor_s} s of the processor"


def confined(
    work: Literal["examination", "rendering"], asked: dict[str, Any], bounds: Bounds, what: str
) -> dict[str, Any]:
    """Return what the module ``work`` answers to ``asked`` within these bounds.

    Args:
        work: a module of this package.
        asked: gets its function ``answer``.
        bounds: of the process.
        what: the files that are to blame when they do not suffice.

    Raises:
        UsageError, Refusal, ExhaustedError: those of the work, and a refusal when it did not end within its bounds.
        KitError: the work failed by a fault of the kit.
    """
    command = [sys.executable, "-P", "-m", __name__, str(bounds.memory_mb), str(bounds.processor_s)]
    # Threads of a numerical library would reserve address space that this process does not have.
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    beyond = f"refused: {what} cannot be examined within {bounds}, which is plenty for a record of the kit"
    try:
        done = subprocess.run(
            command,
            input=json.dumps({"work": work, "asked": asked, "what": what}).encode(),
            capture_output=True,
            timeout=bounds.clock_s,
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
        raise Refusal(answer["refused"], ExitCode(answer["code"]))
    for name, error in (("wrong", UsageError), ("exhausted", ExhaustedError), ("broken", KitError)):
        if name in answer:
            raise error(answer[name])
    if "beyond" in answer:
        raise Refusal(beyond)
    return answer


def _answer(work: str, asked: dict[str, Any], what: str) -> dict[str, Any]:
    try:
        answer: dict[str, Any] = import_module(f".{work}", __package__).answer(asked)
        return answer
    except Refusal as reason:
        return {"refused": str(reason), "code": reason.code}
    except UsageError as error:
        return {"wrong": str(error)}
    except ExhaustedError as error:
        return {"exhausted": str(error)}
    except MemoryError:
        return {"beyond": True}
    except OSError as error:
        where = error.filename or what
        if (cure := exhausted(error)) is not None:
            return {"exhausted": f"{where}: {cure}"}
        return {"wrong": f"{where}: {error.strerror or error}"}
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
    answering.write(json.dumps(_answer(**asked)))


if __name__ == "__main__":
    main()
