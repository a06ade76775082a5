"""The declaration of an honest adapter, and what several of them need. Reaching into private members is fine here, as in ``defective``."""

from __future__ import annotations

import asyncio
import copy
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from pytest_otmcp.reference_adapters.core import AdapterError, AdapterServer, Call
from pytest_otmcp.reference_adapters.defects.defect import Change, Handler, wrap

if TYPE_CHECKING:
    from pytest_otmcp.subject import Adapter

__all__ = [
    "Change",
    "Choice",
    "again_after_silence",
    "backed_off",
    "background_call",
    "choices",
    "deaf_to_cancellation",
    "every_tool",
    "in_background",
    "narrowed",
    "one_call_at_a_time",
    "one_connection_per_call",
    "said_to_ask",
    "twice_where_missing",
]

Declare = Callable[[Change], Change]


def _as_it_is(adapter: Adapter) -> Adapter:
    return adapter


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """A legal choice of an adapter's author.

    Attributes:
        protocol: the reference adapter that is bent.
        sentence: what is different.
        rule: why it is legal.
        change: makes the adapter so.
        warnings: the SHOULD findings that are due: requirement and code.
        checked_warnings: those that are due in the requirement suite alone.
        described: what the subject file has to say of it, as a change of the adapter's description.
    """

    protocol: str
    sentence: str
    rule: str
    change: Change
    warnings: frozenset[tuple[str, str]]
    described: Callable[[Adapter], Adapter]
    checked_warnings: frozenset[tuple[str, str]] = frozenset()


def choices(protocol: str) -> tuple[dict[str, Choice], Callable[..., Declare]]:
    """Return an empty collection, and the decorator that declares an adapter of this protocol in it, called like its function."""
    declared: dict[str, Choice] = {}

    def choice(
        sentence: str,
        rule: str,
        *,
        warnings: tuple[tuple[str, str], ...] = (),
        checked_warnings: tuple[tuple[str, str], ...] = (),
        described: Callable[[Adapter], Adapter] = _as_it_is,
    ) -> Declare:
        def declare(change: Change) -> Change:
            declared[change.__name__.replace("_", "-")] = Choice(
                protocol=protocol,
                sentence=sentence,
                rule=rule,
                change=change,
                warnings=frozenset(warnings),
                checked_warnings=frozenset(checked_warnings),
                described=described,
            )
            return change

        return declare

    return declared, choice


def every_tool(server: AdapterServer, handler: Callable[[Handler], Handler]) -> None:
    """Replace the handler of every tool by one that knows the original."""
    for name in [*server._tools]:
        wrap(server, name, handler)


def in_background(server: AdapterServer, work: Callable[[], Awaitable[None]]) -> None:
    """Do this again and again, from the first call to the end of the process; when it fails, only half a second later."""
    begun: list[asyncio.Task[None]] = []

    async def again_and_again() -> None:
        task = asyncio.current_task()
        assert task is not None
        # An exchange that is over at the very moment of the cancellation returns instead of being cancelled (asyncio.wait_for of
        # Python 3.11, which the Modbus library uses).
        while not task.cancelling():
            try:
                await work()
            except AdapterError:
                await asyncio.sleep(0.5)

    def beginning(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            if not begun:
                begun.append(asyncio.create_task(again_and_again()))
            return await genuine(call, arguments)

        return handler

    every_tool(server, beginning)


def background_call(server: AdapterServer) -> Call:
    """Return a call that is nobody's, for what the adapter asks by itself or before it writes."""
    return Call(protocol=server._protocol, operation="background", endpoint=server.endpoint, writes=False)


def one_call_at_a_time(server: AdapterServer) -> None:
    """Let every call wait until the one before it is over."""
    alone = asyncio.Lock()

    def in_turn(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            async with alone:
                return await genuine(call, arguments)

        return handler

    every_tool(server, in_turn)


def deaf_to_cancellation(server: AdapterServer) -> None:
    """Let every call wait until the one before it is over, and be carried out to its end, whether or not it has been cancelled."""
    one_call_at_a_time(server)

    def to_its_end(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            return await asyncio.shield(asyncio.ensure_future(genuine(call, arguments)))

        return handler

    every_tool(server, to_its_end)


def one_connection_per_call(server: AdapterServer, end: Callable[[], Awaitable[None]]) -> None:
    """Let every call wait until the one before it is over, and end the connection after each."""

    def alone(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            try:
                return await genuine(call, arguments)
            finally:
                await end()

        return handler

    every_tool(server, alone)
    one_call_at_a_time(server)


def again_after_silence(server: AdapterServer, *names: str, times: int = 1) -> None:
    """Let these tools, which read, ask once more, or so often, when the device did not answer in time."""

    def again(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            for _ in range(times):
                try:
                    return await genuine(call, arguments)
                except AdapterError as error:
                    if error.code != "timeout":
                        raise
            return await genuine(call, arguments)

        return handler

    for name in names:
        wrap(server, name, again)


def said_to_ask(attempts: int | None) -> Callable[[Adapter], Adapter]:
    """Return the description of an adapter that asks a silent device so often; None for one that says nothing of it."""

    def described(adapter: Adapter) -> Adapter:
        assert adapter.times is not None
        return replace(adapter, times=replace(adapter.times, attempts=attempts))

    return described


POLLING_BESIDE_CALLS = said_to_ask(None)
"""What is said of an adapter whose polls share the connection with its calls: a poll that meets silence ends the connection, and a call
that waits there is repeated over the next one, which the envelope says."""


def backed_off(connect: Callable[..., Awaitable[Any]], seconds: float) -> Callable[..., Awaitable[Any]]:
    """Return a way to connect that is not tried again for some seconds after it has failed."""
    until = 0.0

    async def patiently(*arguments: Any) -> Any:
        nonlocal until
        now = asyncio.get_running_loop().time
        if now() < until:
            message = "no connection; the next attempt comes in a moment"
            raise AdapterError(
                "connect_failed", message, outcome="not_sent", retry_after_ms=int(1000 * (until - now()))
            )
        try:
            return await connect(*arguments)
        except AdapterError:
            until = now() + seconds
            raise

    return patiently


_SIZED = ("maxItems", "maxLength")


def narrowed(server: AdapterServer, tool: str, argument: str, bound: str, most: int) -> None:
    """Let the schema of a tool say that an argument has this ``maximum``, ``maxItems`` or ``maxLength``, and refuse what is beyond."""
    listing = server._tools[tool].listing
    schema = copy.deepcopy(listing.input_schema)
    schema["properties"][argument][bound] = most

    def bounded(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            value = getattr(arguments, argument)
            if (len(value) if bound in _SIZED else value) > most:
                message = f"{argument} is beyond its {bound} of {most}"
                raise AdapterError("limit_exceeded", message, outcome="not_sent", field=f"/{argument}")
            return await genuine(call, arguments)

        return handler

    wrap(server, tool, bounded, listing=listing.model_copy(update={"input_schema": schema}))


def twice_where_missing(genuine: Handler) -> Handler:
    """Return a handler that asks again when the device says that there is no such thing."""

    async def handler(call: Call, arguments: Any) -> Any:
        try:
            return await genuine(call, arguments)
        except AdapterError as error:
            if error.code != "illegal_address":
                raise
        return await genuine(call, arguments)

    return handler
