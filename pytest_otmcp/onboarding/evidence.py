"""The search for a known value in an answer of unknown shape; its place becomes a rule of the subject file. Pure."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..subject.answers import extract, interpret, read_answer
from ..subject.model import Answering, OutcomeRule, OutputRule

__all__ = [
    "CONNECTION_LOST",
    "CONNECT_FAILED",
    "FORMS",
    "Found",
    "claims_success",
    "failure_rules",
    "find",
    "known_errors",
    "lists_in",
    "turned_false",
]

CONNECT_FAILED = (
    r"(?i)connection (refused|failed)|connect call failed|unreachable|offline|not connected"
    r"|(failed to|unable to|could not|cannot) (connect|reach)",
)
CONNECTION_LOST = (r"(?i)connection (was )?(lost|closed|reset|aborted)|broken pipe",)
"""Patterns of the texts in which adapters of any protocol say that their device cannot be reached, and that the connection with it broke."""

_BESIDE = {"connect_failed": ("connection_lost",)}
"""Codes of failures that may come in the place of another one: an adapter whose device has gone may say that it has just lost it."""

FORMS = ("structured", "json", "text", "texts")
"""Forms of answers, the one that says most first."""


_PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """The place of a value in an answer.

    Attributes:
        form: ``structured``, ``json``, ``text`` or ``texts``.
        rule: table as a subject file has it below ``result``.
    """

    form: str
    rule: Mapping[str, object]


def find(
    message: Mapping[str, object],
    expected: object,
    forms: Sequence[str] = FORMS,
    *,
    also: tuple[Mapping[str, object], object] | None = None,
) -> Found | None:
    """Find the place of ``expected`` (a value or a list of values); the rule has been tried on the answer.

    Args:
        also: another answer, and what has to be found at the same place there.
    """
    wanted = [(message, expected), *(() if also is None else (also,))]
    for form in forms:
        documents = [read_answer(answer, form)[0] for answer, _ in wanted]
        if None in documents:
            continue
        for rule in _rules(documents[0], expected):
            output = {"x": OutputRule(**{{"as": "convert"}.get(name, name): value for name, value in rule.items()})}
            found = [extract(output, document)["x"] for document in documents]
            if all(map(_same, found, (value for _, value in wanted))):
                return Found(form=form, rule=rule)
    return None


def _same(found: object, expected: object) -> bool:
    if isinstance(expected, list):
        return isinstance(found, list) and len(found) == len(expected) and all(map(_same, found, expected))
    if isinstance(expected, bool) or isinstance(found, bool):
        return found is expected
    if isinstance(expected, float) and isinstance(found, int | float):
        return abs(found - expected) < 1e-9
    return bool(found == expected)


def _rules(document: object, expected: object) -> Iterator[dict[str, Any]]:
    if isinstance(document, str):
        yield from _in_text(document, expected)
        return
    for path, value in _places(document, ""):
        yield {"path": path}
        if isinstance(expected, list):
            yield {"path": path, "wrap": True}
            if isinstance(value, str):
                yield {"path": path, "as": "bytes"}
        if isinstance(value, str):
            try:
                inner = json.loads(value)
            except ValueError:
                inner = None
            if isinstance(inner, dict | list):
                yield from ({"path": path, "as": "json", "then": place} for place, _ in _places(inner, "") if place)
            for rule in _in_text(value, expected):
                yield {"path": path, **rule}


def _places(value: object, path: str) -> Iterator[tuple[str, object]]:
    """Yield the JMESPath of every value, also through all elements of a list of objects."""
    if path:
        yield path, value
    if isinstance(value, Mapping):
        for name, member in value.items():
            step = name if _PLAIN.fullmatch(name) else json.dumps(name)
            yield from _places(member, f"{path}.{step}" if path else step)
    elif isinstance(value, list) and value:
        inner = value[0]
        if isinstance(inner, Mapping):
            for place, _ in _places(inner, ""):
                yield f"{path}[].{place}", None
            for place, member in _places(inner, ""):
                yield f"{path}[0].{place}", member
        elif path == "":
            yield "[0]", inner


def _in_text(text: str, expected: object) -> Iterator[dict[str, object]]:
    if isinstance(expected, list):
        kind = _kind(expected[0]) if expected else "string"
        yield {"split": ",", "as": kind}
        yield {"regex": r"\[([^\]]*)\]", "split": ",", "as": kind}
        yield {"regex": r":\s*([-\d.,\s]+)$", "split": ",", "as": kind}
        yield {"as": "bytes"}
        return
    kind = _kind(expected)
    yield {"as": kind}
    shown = json.dumps(expected) if not isinstance(expected, str) else expected
    for written in dict.fromkeys((shown, str(expected))):
        position = text.find(written)
        if position < 0:
            continue
        anchor = re.search(r"[A-Za-z_]+\W*$", text[max(0, position - 200) : position])
        before = "" if anchor is None else re.escape(anchor[0]).replace(r"\ ", r"\s*")
        pattern = {"int": r"(-?\d+)", "float": r"(-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)", "bool": r"(\w+)"}.get(
            kind, r"([^\s,;]+)"
        )
        yield {"regex": before + pattern, "as": kind}


def _kind(value: object) -> str:
    if isinstance(value, bool):
        return "bool"
    return {int: "int", float: "float"}.get(type(value), "string")


def lists_in(message: Mapping[str, object], prefix: str) -> Iterator[tuple[str, dict[str, Any], list[Any]]]:
    """Yield every list of texts in an answer with its form and its rule: as it is, without ``prefix``, without the first."""
    for form in ("structured", "json", "texts"):
        document = read_answer(message, form)[0]
        if document is None:
            continue
        for path, _ in _places(document, ""):
            whole = {"path": path}, {"path": path, "strip": prefix}
            # A list of nodes may begin with the node that was asked for.
            rest = [{**rule, "path": path.replace("[]", "[1:]", 1)} for rule in whole if "[]" in path]
            for rule in (*whole, *rest):
                output = OutputRule(path=rule["path"], strip=rule.get("strip"))
                value = extract({"x": output}, document)["x"]
                if isinstance(value, list) and value and all(isinstance(entry, str) for entry in value):
                    yield form, rule, value


_UP = re.compile(r"(connected|reachable|online|up|ok|healthy)", re.IGNORECASE)
_FAILING_WORDS = re.compile(
    r"^\W*(error|failed|failure|cannot|could not|unable|exception|invalid|not connected)\b", re.IGNORECASE
)
_FAILING_PATHS = (
    "success == `false`",
    "ok == `false`",
    "error",
    "errors",
    "status == 'error'",
    "result.error",
    "result[?status && status != 'Good']",
    "[?status && status != 'Good']",
    "[?error]",
    "status && !starts_with(status, 'Good') && status != 'ok' && status != 'success'",
)


def failure_rules(
    failure: Mapping[str, object], successes: Sequence[Mapping[str, object]], form: str
) -> list[dict[str, object]]:
    """Return outcome rules that tell this failed answer from the successful ones; none where it says so without rules."""
    document, text, _ = read_answer(failure, form)
    if not interpret(failure, Answering(form=form)).success:
        return []
    rules: list[dict[str, Any]] = []
    if document is not None and not isinstance(document, str):
        rules += [{"path": path, "then": "failure"} for path in _FAILING_PATHS]
    first = _FAILING_WORDS.match(text)
    if first is not None:
        rules.append({"text": f"(?i)^\\W*{first[1].lower()}", "then": "failure"})
    for rule in rules:
        answering = Answering(
            form=form, outcome=(OutcomeRule(success=False, text=rule.get("text"), path=rule.get("path")),)
        )
        if not interpret(failure, answering).success and all(interpret(good, answering).success for good in successes):
            return [rule]
    return []


def claims_success(message: Mapping[str, object]) -> bool:
    """Tell whether an answer says of itself, without any rules, that it is a success."""
    return all(interpret(message, Answering(form=form)).success for form in FORMS)


def turned_false(before: Mapping[str, object], after: Mapping[str, object]) -> Found | None:
    """Find the place in two answers that says yes in the first and no in the second, as a rule for a truth value."""
    for form in ("structured", "json"):
        document = read_answer(after, form)[0]
        places = list(_places(read_answer(before, form)[0], ""))
        flags = [place for place, value in places if value is True]
        words = [f"{place} == '{value}'" for place, value in places if isinstance(value, str) and _UP.fullmatch(value)]
        for path in (*flags, *words):
            if extract({"is": OutputRule(path=path)}, document) == {"is": False}:
                return Found(form=form, rule={"path": path})
    return None


def known_errors(patterns: Mapping[str, Sequence[str]], code: str, text: str) -> list[dict[str, str]]:
    """Return error rules that give this failure's text the code it should have.

    Args:
        patterns: error code to patterns of the texts in which libraries report it.
    """
    codes = (code, *_BESIDE.get(code, ()))
    return [
        {"text": pattern, "code": each}
        for each in codes
        for pattern in patterns.get(each, ())
        if re.search(pattern, text)
    ]
