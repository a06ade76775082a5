"""The search for the tool that says when an adapter is ready that connects in the background, after its start."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from ..core.strict_json import parse_strict
from ..subject.answers import read_answer
from ..subject.model import Answering, OutcomeRule, Ready
from ..trial.adapter_under_test import AdapterUnderTest
from .evidence import tells_failure

__all__ = ["Readiness", "look_for_readiness"]

_PATIENCE_S, _PAUSE_S = 5.0, 0.05
"""Time for which an adapter may go on to say that it connects, and between two questions. One that is merely not connected may wait
for its first call, so it is asked for a tenth of that time."""

_COMING = re.compile(r"\b(re)?connecting\b|\binitiali[sz]ing\b|\bstarting\b|\bpending\b", re.IGNORECASE)
_AWAY = re.compile(
    r"\bnot (yet )?(connected|ready)\b|\bdisconnected\b|\boffline\b|\"\w*(connected|ready|online)\": false",
    re.IGNORECASE,
)
_THERE = re.compile(r"connected|ready|online|up|ok|running|active|healthy", re.IGNORECASE)


@dataclass(frozen=True, slots=True, kw_only=True)
class Readiness:
    """A tool that said that the adapter was not ready, and a moment later that it was.

    Attributes:
        table: the entry ``ready`` of the subject file.
        before: the words of its first answer.
    """

    table: Mapping[str, str]
    before: str

    @property
    def ready(self) -> Ready:
        """The entry as the kit reads it."""
        rule = OutcomeRule(success=True, text=self.table.get("text"), path=self.table.get("path"))
        answering = Answering(form=self.table["answer"], outcome=(rule, OutcomeRule(success=False)))
        return Ready(tool=self.table["tool"], arguments={}, answering=answering)


async def look_for_readiness(under_test: AdapterUnderTest, tools: Sequence[str]) -> Readiness | None:
    """Ask each of these tools, just after the start, whether the adapter is ready; wait for one that says "connecting".

    Args:
        under_test: the adapter; its session is opened if there is none.
        tools: names of tools without arguments that tell a status.

    Raises:
        SubjectError: the adapter cannot be started.
    """
    for tool in tools:
        await under_test.open()
        first = await _answer(under_test, tool)
        words = _words(first)
        if first is None or not (_COMING.search(words) or _AWAY.search(words)):
            continue
        patience_s = _PATIENCE_S if _COMING.search(words) else _PATIENCE_S / 10
        until = asyncio.get_running_loop().time() + patience_s
        while asyncio.get_running_loop().time() < until:
            await asyncio.sleep(_PAUSE_S)
            later = await _answer(under_test, tool)
            said = _words(later)
            if later is None or _COMING.search(said) or _AWAY.search(said) or tells_failure(later):
                continue
            rule = _rule(first, later)
            return None if rule is None else Readiness(table={"tool": tool, **rule}, before=words)
    return None


async def _answer(under_test: AdapterUnderTest, tool: str) -> Mapping[str, object] | None:
    assert under_test.session is not None
    exchange = await under_test.session.call(tool, {}, timeout_s=under_test.deadline_s)
    try:
        message = parse_strict(exchange.response or b"null")
    except ValueError:
        return None
    return message if isinstance(message, dict) else None


def _words(message: Mapping[str, object] | None) -> str:
    if message is None:
        return ""
    structured, text, _ = read_answer(message, "structured")
    return text if structured is None else json.dumps(structured, ensure_ascii=False)


def _rule(first: Mapping[str, object], later: Mapping[str, object]) -> dict[str, str] | None:
    """Return what tells the later answer from the first one: a member of the document, else a line of the text."""
    for form in ("structured", "json"):
        before, after = (dict(_leaves(read_answer(message, form)[0])) for message in (first, later))
        for path, value in after.items():
            if before.get(path) == value:
                continue
            if value is True:
                return {"answer": form, "path": path}
            if isinstance(value, str) and _THERE.fullmatch(value):
                return {"answer": form, "path": f"{path} == '{value}'"}
    before_lines = read_answer(first, "text")[1].splitlines()
    for line in read_answer(later, "text")[1].splitlines():
        if line.strip() and line not in before_lines and not re.search(r"\d", line):
            return {"answer": "text", "text": f"(?m)^{re.escape(line).replace(chr(92) + ' ', ' ')}$"}
    return None


def _leaves(document: object, path: str = "") -> Iterator[tuple[str, object]]:
    if isinstance(document, Mapping):
        for name, value in document.items():
            member = name if re.fullmatch(r"[A-Za-z_]\w*", str(name)) else json.dumps(name)
            yield from _leaves(value, f"{path}.{member}" if path else member)
    elif path:
        yield path, document
