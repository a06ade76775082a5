"""The warm start of adapters, which saves the second of processor time that the imports of each adapter take.

Nine tenths of an adapter's start are the import of the SDK and of its protocol's library (docs/performance.md), and a self-check
and the kit's tests start the same adapters by the hundred in order to look at something else. Here one process imports everything once and forks a
process for each start (``server``); the program that a command names (``start``) hands it arguments, environment, working
directory and its three standard streams, and lives and ends as the forked process does.

Tests of processes themselves, such as exit codes, signals and children, use processes that are started as usual.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from ...core.errors import KitError
from ...plant.owners import TOKEN_VARIABLE, new_token
from ...protocols.registry import protocols
from ...subject import Adapter, Subject
from ...subject.selection import select
from ..defect import ADAPTERS, DEFECTS

__all__ = ["WarmStart"]

_HERE = Path(__file__).parent


def _imported() -> list[str]:
    """Return the names of the modules that are imported before the first fork."""
    protocols = (f"{ADAPTERS}.{protocol}" for protocol in select(None).subject.adapters)
    return [f"{ADAPTERS}.core.run", *protocols, f"{DEFECTS}.table"]


class WarmStart:
    """A server that forks adapters, and the commands that request this.

    Attributes:
        python: the words that replace ``python`` in a command: ``(*python, "adapter.py", "--option")``.

    Raises:
        KitError: the server did not start.
    """

    def __init__(self) -> None:
        self._directory = tempfile.TemporaryDirectory(prefix="otmcp-warm-")
        path = Path(self._directory.name, "socket")
        # It has its own session, so that a Ctrl-C in the terminal does not reach the adapters, as without warm start.
        self._server = subprocess.Popen(
            [sys.executable, str(_HERE / "server.py"), str(path), *_imported()],
            # Room for the token of a session, by which a device knows whose process it is.
            env={**os.environ, TOKEN_VARIABLE: "0" * len(new_token())},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
        )
        assert self._server.stdout is not None
        if self._server.stdout.readline() != b"listening\n":
            raise KitError("the process that starts adapters has ended at its own start")
        # Python runs isolated and without the site module: the hand-over needs nothing of what they would do.
        self.python = (sys.executable, "-I", "-S", str(_HERE / "start.py"), str(path))

    def close(self) -> None:
        """End the server and every adapter that still runs."""
        with self._server:
            assert self._server.stdin is not None
            self._server.stdin.close()
        self._directory.cleanup()

    def words(self, protocol: str) -> tuple[str, ...]:
        """Return the words that replace ``python`` in the command of an adapter for a protocol: those of a warm start, unless it speaks on a
        cable. Who has been forked from a process outside is not in the network of the cable."""
        return (sys.executable,) if protocols()[protocol].cable else self.python

    def command(self, command: tuple[str, ...], protocol: str) -> tuple[str, ...]:
        """Return the command for a warm start, if it starts Python and is not one already."""
        return (*self.words(protocol), *command[1:]) if command[0] in ("{python}", sys.executable) else command

    def subject(self, subject: Subject) -> Subject:
        """Return the subject with warm starts of all its adapters."""

        def warm(adapter: Adapter) -> Adapter:
            variants = {
                name: replace(variant, command=self.command(variant.command, adapter.protocol))
                for name, variant in adapter.variants.items()
            }
            return replace(adapter, variants=variants)

        return replace(subject, adapters={protocol: warm(adapter) for protocol, adapter in subject.adapters.items()})
