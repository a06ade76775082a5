"""Who answers what an adapter asks its client (MCP: elicitation), as a check wants it answered. Both eras of MCP."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, cast

from mcp.client.context import ClientRequestContext
from mcp.types import INVALID_REQUEST, ElicitRequestParams, ElicitResult, ErrorData

from ..record.schema import Question
from .exchange import Answer

__all__ = ["Person"]


class Person:
    """Answers the questions of one adapter.

    Args:
        yes: what is filled into a form for a yes, beside what follows from its schema.

    Attributes:
        answer: what is answered from now on.
        questions: what was asked.
    """

    def __init__(self, yes: Mapping[str, Any] = MappingProxyType({})) -> None:
        self.answer: Answer = "accept"
        self._yes = yes
        self.questions: list[Question] = []
        self._open: dict[str, Any] | None = None
        self._redeems = False

    def filled(self, form: dict[str, Any]) -> dict[str, Any]:
        """Return a form filled in for a yes."""
        return {**_filled(form, True), **self._yes}

    def redeem(self) -> None:
        """Let the next call bring an acceptance of the newest question that had no answer."""
        self._redeems = True

    def brought(self) -> dict[str, Any]:
        """Return what the next call brings beside its arguments."""
        redeems, self._redeems = self._redeems, False
        return self._open or {} if redeems else {}

    def left_open(self, response: bytes | None) -> None:
        """Keep what a call would have to bring that answers the question in this response."""
        result = (json.loads(response or b"null") or {}).get("result")
        if isinstance(result, dict) and result.get("resultType") == "input_required":
            asked = result.get("inputRequests") or {}
            forms = {key: one.get("params", {}).get("requestedSchema", {}) for key, one in asked.items()}
            answers = {key: ElicitResult(action="accept", content=self.filled(form)) for key, form in forms.items()}
            self._open = {"input_responses": answers, "request_state": result.get("requestState")}

    async def __call__(self, context: ClientRequestContext, params: ElicitRequestParams) -> ElicitResult | ErrorData:
        form = cast(dict[str, Any], getattr(params, "requested_schema", None) or {})
        self.questions.append({"text": params.message, "form": form})
        match self.answer:
            case "silence":
                await asyncio.Event().wait()
            case "none":
                return ErrorData(code=INVALID_REQUEST, message="nobody answers")
            case "decline" | "cancel":
                return ElicitResult(action=self.answer)
        if self.answer == "accept":
            return ElicitResult(action="accept", content=self.filled(form))
        return ElicitResult(action="accept", content=_filled(form, False if self.answer == "no" else "not yet"))


def _filled(form: dict[str, Any], approved: object) -> dict[str, Any]:
    """Return a form filled in: truth values as is said, of a choice the first, any text elsewhere."""
    filled: dict[str, Any] = {}
    for name, about in form.get("properties", {}).items():
        if about.get("type") == "boolean":
            filled[name] = approved
        elif about.get("type") in ("integer", "number"):
            filled[name] = about.get("minimum", 0)
        else:
            filled[name] = (about.get("enum") or ["yes"])[0]
    return filled
