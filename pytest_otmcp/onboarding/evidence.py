"""The search for a known value in an answer of unknown shape; its place becomes a rule of the subject file. Pure."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ..core.instants import same_instant
from ..subject.answers import extract, interpret, literal, read_answer
from ..subject.bindings import output_rule
from ..subject.model import Answering, OutcomeRule, OutputRule

__all__ = [
    "CONNECTION_LOST",
    "CONNECT_FAILED",
    "FORMS",
    "TIMEOUT",
    "Found",
    "Sample",
    "beyond",
    "claims_success",
    "failure_rules",
    "find",
    "known_errors",
    "lists_in",
    "no_result",
    "numbers_in",
    "places",
    "prose_rule",
    "same_value",
    "tells_failure",
    "turned_false",
]

_LOST = r"connection (was )?(lost|closed|reset|aborted)|broken pipe"
_NOT_MADE = (
    r"connection refused(?!: [a-z])|\bECONNREFUSED\b|connect call failed|unreachable|(failed to|unable to|could not|cannot) (connect|reach)"
    r"|connection (could not|cannot|can't) be (established|made)"
)
"""What a connection that broke, and one that could not be made, is called. "Refused: not authorised" is a broker's answer on a connection
that was made; "offline" and "not connected" are said of both."""

CONNECT_FAILED = (rf"(?is)^(?!.*({_LOST})).*({_NOT_MADE})",)
CONNECTION_LOST = (rf"(?is)^(?!.*({_NOT_MADE})).*({_LOST})",)
TIMEOUT = (
    rf"(?is)^(?!.*({_NOT_MADE}|{_LOST}|keep.?alive|selection)).*(\btime[ds]?[ -]?out|no (response|answer|reply)\b)",
)
"""Patterns of the texts in which adapters of any protocol say that their device cannot be reached, that the connection with it broke, and
that it did not answer in time. A text that says two of these has no code; what a device says that it has itself waited for is none."""

_BESIDE = {"connect_failed": ("connection_lost",)}
"""Codes of failures that may come in the place of another one: an adapter whose device has gone may say that it has just lost it."""

FORMS = ("structured", "json", "text", "texts")
"""Forms of answers, the one that says most first."""


_PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_DATE = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d")
_NUMBERS = 8
"""Numbers of a text that are looked at."""
_EXACT = 2**53
"""Integers beyond it are not the same number to every reader of JSON (RFC 8259, section 6)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """One answer, and the value that the device is known to have given for it.

    Attributes:
        message: the answer.
        expected: a value or a list of values.
        told: the inputs of the operation, as the tool was told them.
    """

    message: Mapping[str, object]
    expected: object
    told: Mapping[str, object] = field(default_factory=dict)

    def read(self, form: str, rule: Mapping[str, object]) -> object:
        """Return what a rule finds in the answer."""
        return extract({"x": output_rule(rule).about(self.told)}, read_answer(self.message, form)[0])["x"]

    def fits(self, form: str, rule: Mapping[str, object]) -> bool:
        """Tell whether a rule finds the value."""
        return same_value(self.read(form, rule), self.expected)


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """The place of a value in an answer.

    Attributes:
        form: ``structured``, ``json``, ``text`` or ``texts``.
        rule: table as a subject file has it below ``result``.
        missed: the samples whose values are not there.
    """

    form: str
    rule: Mapping[str, object]
    missed: tuple[Sample, ...] = ()

    @property
    def takes_everything(self) -> bool:
        """The rule leaves nothing out, so that what it finds is what the adapter says, whatever that is."""
        regex = self.rule.get("regex")
        return self.rule.get("as") in (None, "literal", "json") and (regex is None or str(regex).endswith("(.*)$"))


def find(samples: Sequence[Sample], forms: Sequence[str] = FORMS) -> Found | None:
    """Find the place where the first sample's value is, and most of the others; each rule has been tried on every answer.

    It is no place where it has the value of one call alone: an answer may always say the same. A member that is called like what was
    asked for is found by that name, never by the one that happened to be asked for.
    """
    first, others = samples[0], samples[1:]
    elsewhere = [sample for sample in others if sample.told != first.told]
    for form in forms:
        document = read_answer(first.message, form)[0]
        if document is None:
            continue
        best: Found | None = None
        for rule in _rules(document, first.expected, first.told):
            if not first.fits(form, rule):
                continue
            missed = tuple(sample for sample in others if not sample.fits(form, rule))
            holds = not elsewhere or any(sample not in missed for sample in elsewhere)
            if holds and (best is None or len(missed) < len(best.missed)):
                best = Found(form=form, rule=rule, missed=missed)
        if best is not None:
            return best
    return None


def same_value(found: object, expected: object) -> bool:
    """Tell whether what was found says a value: also as OPC 10000-6 has it in JSON, an integer of 64 bits as a text, a time in any form
    of ISO 8601."""
    if isinstance(expected, list):
        return isinstance(found, list) and len(found) == len(expected) and all(map(same_value, found, expected))
    if isinstance(expected, bool) or isinstance(found, bool):
        return found is expected
    if isinstance(expected, float) and isinstance(found, int | float):
        return abs(found - expected) < 1e-9
    if isinstance(expected, int) and abs(expected) > _EXACT and found == str(expected):
        return True
    if isinstance(expected, str) and _DATE.match(expected) is not None:
        return found == expected or same_instant(found, expected)
    return bool(found == expected)


def _rules(document: object, expected: object, told: Mapping[str, object]) -> Iterator[dict[str, Any]]:
    if isinstance(document, str):
        yield from _in_text(document, expected)
        if (inner := _held(document)) is not None:
            yield from ({**_IN_BRACKETS, "then": place} for place, _ in places(inner, "", told) if place)
        return
    for path, value in places(document, "", told):
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
                # Of a text that is JSON a pattern would find the right place by chance alone.
                yield from (
                    {"path": path, "as": "json", "then": place} for place, _ in places(inner, "", told) if place
                )
                continue
            yield from ({"path": path, **rule} for rule in _in_text(value, expected))


_IN_BRACKETS = {"regex": r"(?s)^[^\[{]*([\[{].*[\]}])\W*$", "as": "literal"}
"""Rule for a list or an object, in JSON or in Python, behind some words."""


def _held(text: str) -> object | None:
    """Return the list or object that a text has behind its first words; None where it has none."""
    found = re.match(_IN_BRACKETS["regex"], text)
    value = None if found is None else literal(found[1])
    return value if isinstance(value, dict | list) else None


def places(value: object, path: str, told: Mapping[str, object] | None = None) -> Iterator[tuple[str, object]]:
    """Yield the JMESPath of every value, also through all elements of a list of objects.

    Args:
        told: inputs as the tool was told them: a member that is called like one of them is named as such.
    """
    if path:
        yield path, value
    asked = _asked(told or {})
    if isinstance(value, Mapping):
        for name, listed in (told or {}).items():
            if isinstance(listed, list) and listed and all(str(each) in value for each in listed):
                step = f'{path}."${name}"' if path else f'"${name}"'
                yield step, [value[str(each)] for each in listed]
                yield from ((f"{step}[].{place}", None) for place, _ in places(value[str(listed[0])], ""))
        for name, member in value.items():
            step = f'"${asked[name]}"' if name in asked else name if _PLAIN.fullmatch(name) else json.dumps(name)
            yield from places(member, f"{path}.{step}" if path else step, told)
    elif isinstance(value, list) and value:
        inner = value[0]
        if isinstance(inner, Mapping):
            for place, _ in places(inner, "", told):
                yield f"{path}[].{place}", None
            for place, member in places(inner, "", told):
                yield f"{path}[0].{place}", member
        elif path == "":
            yield "[0]", inner


def _asked(told: Mapping[str, object]) -> dict[str, str]:
    """Return the names that members may have because of what was asked for, each with its input."""
    return {str(value): name for name, value in told.items() if isinstance(value, int | str) and value != ""}


def numbers_in(text: str) -> Iterator[Mapping[str, object]]:
    """Yield rules for the numbers in a text."""
    found = [json.loads(number) for number in re.findall(r"(?<![\w.])-?(?:0|[1-9]\d*)(?:\.\d+)?", text)[:_NUMBERS]]
    seen: list[Mapping[str, object]] = []
    for rule in (rule for number in found for rule in _in_text(text, number)):
        if rule not in seen:
            seen.append(rule)
            yield rule


def _in_text(text: str, expected: object) -> Iterator[dict[str, object]]:
    """Yield rules for a value in a text: first those that take everything, whatever its type, and at last those for its own type."""
    if isinstance(expected, list):
        kind = _kind(expected[0]) if expected else "string"
        yield {"as": "literal"}
        if "[" in text:
            for before in _before(text[: text.index("[")]):
                yield {"regex": f"(?s){before}(.*)$", "as": "literal"}
        yield {"split": ",", "as": kind}
        yield {"regex": r"\[([^\]]*)\]", "split": ",", "as": kind}
        # Of one element a tool may give the value itself in the place of a list.
        yield {"regex": r"[\[:=]\s*([^\[\]:=]*?)\]?\s*$", "split": ",", "as": kind}
        yield {"as": "bytes"}
        return
    kind = _kind(expected)
    yield {"as": "literal"}
    if kind == "string":
        yield {"as": "string"}
    shown = json.dumps(expected) if not isinstance(expected, str) else expected
    for written in dict.fromkeys((shown, str(expected))):
        position = text.find(written)
        if position < 0:
            continue
        for before in _before(text[max(0, position - 200) : position]):
            yield {"regex": f"(?s){before}(.*)$", "as": "literal"}
            yield {"regex": f"{before}(.*)", "as": "literal"}
            after = re.match(r"\s*[^\w\s]", text[position + len(written) :])
            if after is not None:
                yield {"regex": f"(?s){before}(.*?){_escaped(after[0])}", "as": "literal"}
            yield {"regex": rf"{before}([^\s,;]+)", "as": "literal"}
            if kind != "string":
                yield {"regex": before + _NARROW[kind], "as": kind}


_NARROW = {"int": r"(-?\d+)", "float": r"(-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)", "bool": r"(\w+)"}
"""Patterns of one type alone: what they find of another one is not what the adapter said."""


def _before(text: str) -> Iterator[str]:
    """Yield patterns of what stands before a value: the last word and what follows it, or only the last sign.

    The blanks are as many as there are, because a text may begin with some, and at last as many as there may be.
    """
    word = re.search(r"[^\W\d]+\W*$", text)
    sign = re.search(r"[^\w\s]\s*$", text)
    exact = ["" if word is None else _escaped(word[0]), *([] if sign is None else [f"^.*{_escaped(sign[0])}"])]
    yield from exact
    yield from (re.sub(" +", r"\\s*", before) for before in exact if " " in before)


def _escaped(text: str) -> str:
    return re.escape(text).replace(r"\ ", " ")


def _kind(value: object) -> str:
    if isinstance(value, bool):
        return "bool"
    return {int: "int", float: "float"}.get(type(value), "string")


def lists_in(
    message: Mapping[str, object], told: Mapping[str, object] | None = None
) -> Iterator[tuple[str, dict[str, Any], list[Any]]]:
    """Yield every list of texts in an answer with its form and its rule: as it is, and without the first.

    Args:
        told: the inputs as the tool was told them.
    """
    for form in ("structured", "json", "texts", "text"):
        document = read_answer(message, form)[0]
        within, at = (_IN_BRACKETS, "then") if isinstance(document, str) else (dict[str, Any](), "path")
        searched = _held(document) if isinstance(document, str) else document
        if searched is None:
            continue
        for path in ("@", *(place for place, _ in places(searched, "", told))):
            # A list of nodes may begin with the node that was asked for.
            rest = [path.replace("[]", "[1:]", 1)] if "[]" in path else []
            for rule in ({**within, at: place} for place in (path, *rest)):
                value = Sample(message=message, expected=None, told=told or {}).read(form, rule)
                if isinstance(value, list) and value and all(isinstance(entry, str) for entry in value):
                    yield form, rule, value


_UP = re.compile(r"(connected|reachable|online|up|ok|healthy)", re.IGNORECASE)
_FAILING_WORDS = re.compile(
    r"^\W*(error|failed|failure|cannot|could not|unable|exception|invalid|not connected)\b", re.IGNORECASE
)
_FAILING_PART = r"(?i)[:,(\[]\s*[\"'](error|failed|failure|exception)\b(?![\w ]*[\"']\s*:)"
"""How a sentence tells of one failure among several results: a text in quotation marks, which is no name of another."""
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
        rules += [{"path": path, "then": "failure"} for path in (*_FAILING_PATHS, *_failing_members(document))]
    first = _FAILING_WORDS.match(text)
    if first is not None:
        rules.append({"text": f"(?i)^\\W*{first[1].lower()}", "then": "failure"})
    if not isinstance(read_answer(failure, "json")[0], dict | list):
        rules.append({"text": _FAILING_PART, "then": "failure"})
    for rule in rules:
        answering = Answering(
            form=form, outcome=(OutcomeRule(success=False, text=rule.get("text"), path=rule.get("path")),)
        )
        if not interpret(failure, answering).success and all(interpret(good, answering).success for good in successes):
            return [rule]
    return []


def _failing_members(value: object, path: str = "") -> Iterator[str]:
    """Yield paths to members that are called an error, below names and numbers that other answers do not have."""
    members: Iterable[tuple[str, object]] = ()
    if isinstance(value, Mapping):
        members = ((name if _PLAIN.fullmatch(name) else "*", member) for name, member in value.items())
    elif isinstance(value, list):
        members = (("[]", member) for member in value)
    for name, member in members:
        place = name if not path else f"{path}{name}" if name == "[]" else f"{path}.{name}"
        if name in ("error", "errors", "exception") and member:
            yield f"{place} | [0]" if re.search(r"\*|\[\]", place) else place
        yield from _failing_members(member, place)


_SAYS_SO = r"(?i)^\W*([\w ]{0,40}\b)?(error|failed|failure|exception|unable to|cannot|could not)\b|^\W*(invalid|not connected)\b"
"""How a sentence begins that tells of a failure."""


def prose_rule(success: Mapping[str, object]) -> dict[str, str] | None:
    """Return the outcome rule for failures of a tool whose successful answer is a sentence; None for one that answers otherwise.

    A tool that answers in sentences is likely to tell of its failures so, even of those that nobody could bring about here.
    """
    _, text, _ = read_answer(success, "text")
    if (
        not re.search(r"[^\W\d_]{2,}\W+[^\W\d_]{2,}", text)
        or text.lstrip()[:1] in ("{", "[")
        or re.search(_SAYS_SO, text)
    ):
        return None
    return {"text": _SAYS_SO, "then": "failure"}


def claims_success(message: Mapping[str, object]) -> bool:
    """Tell whether an answer says of itself, without any rules, that it is a success."""
    return all(interpret(message, Answering(form=form)).success for form in FORMS)


def tells_failure(message: Mapping[str, object]) -> bool:
    """Tell whether an answer says that the call failed, if only in the first word of its text."""
    return not claims_success(message) or _FAILING_WORDS.match(read_answer(message, "text")[1]) is not None


_BLOCKS = ("text", "image", "audio", "resource", "resource_link")
"""Types of content blocks (MCP 2025-11-25, server/tools, "Tool Result")."""


def no_result(message: Mapping[str, object]) -> str | None:
    """Say why an answer is no valid result of a tool call; None for one that is."""
    result = message.get("result")
    if not isinstance(result, Mapping):
        error = message.get("error")
        told = error if isinstance(error, Mapping) else {"message": error}
        return f"error {told.get('code')} instead of a result: {' '.join(str(told.get('message')).split())!r}"
    content = result.get("content")
    if not isinstance(content, list):
        return "a result whose content is no list"
    for block in content:
        kind = block.get("type") if isinstance(block, Mapping) else None
        if kind not in _BLOCKS:
            return f"a content block of the type {kind!r}, which MCP does not know"
        if kind == "text" and not isinstance(block.get("text"), str):
            return "a text block without a text"
    return None


def turned_false(before: Mapping[str, object], after: Mapping[str, object]) -> Found | None:
    """Find the place in two answers that says yes in the first and no in the second, as a rule for a truth value."""
    for form in ("structured", "json"):
        document = read_answer(after, form)[0]
        found = list(places(read_answer(before, form)[0], ""))
        flags = [place for place, value in found if value is True]
        words = [f"{place} == '{value}'" for place, value in found if isinstance(value, str) and _UP.fullmatch(value)]
        for path in (*flags, *words):
            if extract({"is": OutputRule(path=path)}, document) == {"is": False}:
                return Found(form=form, rule={"path": path})
    return None


def beyond(*phrases: str) -> str:
    """Return a pattern of texts that say by one of these phrases that a value is beyond its bounds, and not that an address is."""
    said = "|".join((r"out of range", r"must be between", *phrases))
    place = r"address|register|offset|start|index|count|quantity|size|db|block|tag|element"
    return rf"(?is)^(?!.*\b({place})s?\b[^\n]{{0,40}}(out of range|must be between)).*({said})"


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
