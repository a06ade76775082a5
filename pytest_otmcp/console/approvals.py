"""What waits for a person at the console: questions that the adapter asks its client, and requests that lie outside of MCP."""

from __future__ import annotations

import asyncio
import itertools
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, cast

from mcp.client.context import ClientRequestContext
from mcp.types import ElicitRequestParams, ElicitResult

from ..core.errors import UsageError
from ..session.person import Person
from .feed import Event

__all__ = ["Approvals", "Request"]


@dataclass(frozen=True, slots=True)
class Request:
    """One that waits.

    Attributes:
        text: for the person: the adapter's own words, or the call that was refused until somebody approves it.
        content: what a yes fills into the form, as JSON; None for a request outside of MCP.
        outside: the name of such a request; empty for a question to the client.
        answered: is given the answer to a question.
    """

    text: str
    content: str | None = None
    outside: str = ""
    answered: asyncio.Future[ElicitResult] = field(default_factory=lambda: asyncio.get_running_loop().create_future())


class Approvals(Person):
    """The client of one adapter, whose questions a person answers.

    Args:
        yes: what a form has for a yes beside what follows from its schema.
        changed: is called when something begins or ends to wait.
    """

    def __init__(self, yes: Mapping[str, Any], changed: Callable[[], None]) -> None:
        super().__init__(yes)
        self._changed = changed
        self._numbers = itertools.count(1)
        self._waiting: dict[int, Request] = {}

    def story(self) -> list[Event]:
        """Return what waits, for the page."""
        return [
            {"number": number, "text": one.text, "content": one.content, "outside": one.outside}
            for number, one in self._waiting.items()
        ]

    def lies_outside(self, request: str, call: str) -> None:
        """Let a request outside of MCP wait, of which an adapter has told in the refusal of a call."""
        if all(one.outside != request for one in self._waiting.values()):
            self._waiting[next(self._numbers)] = Request(call, outside=request)
            self._changed()

    def end(self) -> None:
        """Let nothing wait any more: a person who has gone has not said yes."""
        for one in self._waiting.values():
            one.answered.set_result(ElicitResult(action="cancel"))
        self._waiting.clear()

    def take(self, number: object) -> Request:
        """Return a request that waits, and let it wait no more.

        Raises:
            UsageError: there is none.
        """
        one = self._waiting.pop(number, None) if isinstance(number, int) else None
        if one is None:
            raise UsageError("this does not wait any more")
        self._changed()
        return one

    def answer_client(self, number: object, answer: Literal["accept", "decline"], content: object) -> None:
        """Answer a question to the client, if the number is that of one.

        Args:
            content: JSON of the filled form, for a yes.

        Raises:
            UsageError: there is no such question, or the form is no JSON object.
        """
        filled = None
        if answer == "accept":
            try:
                filled = json.loads(str(content))
            except (ValueError, RecursionError):
                filled = None
            if not isinstance(filled, dict):
                raise UsageError("the answer must be a JSON object")
        self.take(number).answered.set_result(ElicitResult(action=answer, content=filled))

    async def __call__(self, context: ClientRequestContext, params: ElicitRequestParams) -> ElicitResult:
        form = cast(dict[str, Any], getattr(params, "requested_schema", None) or {})
        number, one = next(self._numbers), Request(params.message, json.dumps(self.filled(form)))
        self._waiting[number] = one
        self._changed()
        try:
            return await one.answered
        finally:
            if self._waiting.pop(number, None) is not None:
                self._changed()

    def is_outside(self, number: object) -> bool:
        """Tell whether what waits is a request outside of MCP."""
        one = self._waiting.get(number) if isinstance(number, int) else None
        return one is not None and one.outside != ""
