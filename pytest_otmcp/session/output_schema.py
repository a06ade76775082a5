"""Check of results against the ``outputSchema`` of their tools, in a process of its own that is ended when it takes too long.

A schema comes from the adapter under test. A regular expression in it can take for ever, and so can a ``$ref`` to itself under
``anyOf``; Python's ``re`` cannot be interrupted while it searches. The MCP client would check on the kit's event loop, where
this would stop everything, deadlines and Ctrl-C included. So the client is told not to check, and the same check is made here.

``python -m pytest_otmcp.session.output_schema`` is that process: it reads a line with two lengths, then the schema and the
response of so many bytes, and answers with a line: the objection as a JSON text, or ``null``.
"""

from __future__ import annotations

import asyncio
import json
import resource
import signal
import sys
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, BinaryIO, ClassVar
from weakref import WeakKeyDictionary

from ..core.errors import ExhaustedError, KitError
from ..core.exhaustion import exhausted
from .process import subject_environment

__all__ = ["OutputCheck"]

_LIMIT_S = 5.0
"""Seconds of processor time that one check may take: a busy machine accuses nobody. Results of adapters take less than a millisecond."""

_PATIENCE_S = 120.0
"""Seconds within which a check must be over; a machine that is slower than this cannot judge."""

_MEMORY = 1 << 30
"""Bytes of address space that the process may have."""

_LONGEST = 300


class OutputCheck:
    """The process that checks, for all sessions of one event loop. It is started with the first check and ends with the loop."""

    _of_loop: ClassVar[WeakKeyDictionary[asyncio.AbstractEventLoop, OutputCheck]] = WeakKeyDictionary()

    def __init__(self) -> None:
        self._process: asyncio.subprocess.Process | None = None
        self._holder: asyncio.Task[None] | None = None
        self._lock = asyncio.Lock()
        self._hopeless: dict[bytes, str] = {}

    @classmethod
    def of_running_loop(cls) -> OutputCheck:
        """Return the one of the running event loop."""
        return cls._of_loop.setdefault(asyncio.get_running_loop(), cls())

    async def objection(self, tool: str, schema: bytes, response: bytes) -> str | None:
        """Say what the schema objects to in the result of a response; None for nothing.

        Args:
            tool: its name.
            schema: the tool's ``outputSchema``.
            response: a JSON-RPC response with a result that is no error.

        Raises:
            KitError: the process cannot be started, or ended by itself.
        """
        async with self._lock:
            found = self._hopeless.get(schema) or await self._checked(schema, response)
        return None if found is None else found.replace("{tool}", tool, 1)

    async def _checked(self, schema: bytes, response: bytes) -> str | None:
        process = await self._started()
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            async with asyncio.timeout(_PATIENCE_S):
                process.stdin.write(b"%d %d\n" % (len(schema), len(response)))
                process.stdin.write(schema)
                process.stdin.write(response)
                with suppress(ConnectionError):
                    await process.stdin.drain()
                answer = await process.stdout.readline()
        except TimeoutError:
            await self._end()
            raise KitError(f"no result could be checked against its outputSchema within {_PATIENCE_S:g} s") from None
        except asyncio.CancelledError:
            await self._end()
            raise
        if not answer:
            ended_by = await process.wait()
            await self._end()
            if ended_by == -signal.SIGPROF:
                self._hopeless[schema] = (
                    f"The outputSchema of tool {{tool}} cannot be checked within {_LIMIT_S:g} s of processor time"
                )
                return self._hopeless[schema]
            raise KitError(
                "the process that checks results against the outputSchema of their tools has ended by itself"
            )
        found: str | None = json.loads(answer)
        return found

    async def _started(self) -> asyncio.subprocess.Process:
        if self._process is not None:
            return self._process
        try:
            self._process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-P", "-m", __name__),
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.DEVNULL,
                env=subject_environment({}),
                start_new_session=True,
            )
            ready = await self._process.stdout.readline()  # type: ignore[union-attr]
        except (OSError, RuntimeError) as error:
            if (cure := exhausted(error)) is not None:
                raise ExhaustedError(
                    f"results cannot be checked against the outputSchema of their tools: {cure}"
                ) from error
            raise
        if not ready:
            await self._end()
            raise KitError("the process that checks results against the outputSchema of their tools does not start")
        self._holder = asyncio.create_task(self._hold(), name="otmcp-output-check")
        return self._process

    async def _hold(self) -> None:
        """Live as long as the loop, which cancels its tasks before it is closed."""
        try:
            await asyncio.Event().wait()
        finally:
            await self._end()

    async def _end(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            with suppress(ProcessLookupError):
                process.kill()
            await process.wait()
        holder, self._holder = self._holder, None
        if holder is not None and holder is not asyncio.current_task():
            holder.cancel()


def main() -> None:
    """Answer until standard input closes."""
    from .keeper import die_with_parent, hide_memory

    die_with_parent()
    hide_memory()
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    from jsonschema import validators  # noqa: F401  (takes a tenth of a second, which is not the first check's)

    _say(True)
    read = sys.stdin.buffer
    schemas: dict[bytes, Any] = {}
    while line := read.readline():
        lengths = [int(length) for length in line.split()]
        schema, response = (_exactly(read, length) for length in lengths)
        # Nothing of Python's could interrupt a search; this signal ends the process.
        signal.setitimer(signal.ITIMER_PROF, _LIMIT_S)
        found = _objection(schemas, schema, response)
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        _say(found)


def _exactly(read: BinaryIO, length: int) -> bytes:
    content = read.read(length)
    if len(content) < length:
        sys.exit(0)
    return content


def _say(answer: object) -> None:
    sys.stdout.write(json.dumps(answer) + "\n")
    sys.stdout.flush()


def _objection(schemas: dict[bytes, Any], schema: bytes, response: bytes) -> str | None:
    try:
        return _first_error(schemas, schema, json.loads(response)["result"])
    except RecursionError:
        return "Result of tool {tool} cannot be checked against its outputSchema: one of them is nested too deeply"
    except MemoryError:
        return f"Result of tool {{tool}} cannot be checked against its outputSchema with {_MEMORY >> 20} MiB of memory"
    except Exception as error:
        # A pattern that is no regular expression, a number that no float can hold: whatever it is, the adapter has sent it.
        return f"Result of tool {{tool}} cannot be checked against its outputSchema: {str(error)[:_LONGEST]}"


def _first_error(schemas: dict[bytes, Any], schema: bytes, result: Mapping[str, Any]) -> str | None:
    from jsonschema import SchemaError
    from jsonschema.exceptions import best_match
    from jsonschema.validators import validator_for
    from referencing import Registry
    from referencing.exceptions import Unresolvable

    if "structuredContent" not in result:
        return "Tool {tool} has an output schema but did not return structured content"
    if schema not in schemas:
        document = json.loads(schema)
        kind = validator_for(document)
        try:
            kind.check_schema(document)
        except SchemaError as error:
            return f"Invalid schema for tool {{tool}}: {error.message[:_LONGEST]}"
        # With an empty registry nothing outside of the schema is fetched.
        schemas[schema] = kind(document, registry=Registry())
    try:
        found = best_match(schemas[schema].iter_errors(result["structuredContent"]))
    except Unresolvable as error:
        return f"Invalid schema for tool {{tool}}: {str(error)[:_LONGEST]}"
    return (
        None if found is None else f"Invalid structured content returned by tool {{tool}}: {found.message[:_LONGEST]}"
    )


if __name__ == "__main__":
    main()
