"""Reading of an adapter's answer by the rules of its subject file: document, outcome, error code, outputs. Pure.

Public adapters answer in many shapes: prose, JSON inside a text, JSON inside JSON, ``isError`` false with a text that begins
with "Failed". The vendor's rules are applied here in the order of the file, and the first match wins; nothing is guessed
from the names of keys.
"""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import jmespath

from ..core.error_registry import registry
from ..protocols.registry import protocols
from .command import LARGEST, computed, is_number, nearest_on
from .model import Answering, OutputRule

__all__ = [
    "UNCLASSIFIED",
    "Answer",
    "extract",
    "interpret",
    "literal",
    "read_answer",
    "synthesised",
    "synthesised_from_outputs",
]

UNCLASSIFIED = "unclassified"
"""Error code of a failure that no rule of the subject file names."""

_MAX_TEXT = 2000

# Words by which an answer admits that it does not come from the device. Keys admit it only when their value is true.
_ADMISSION = re.compile(
    r"\b(demo(nstration)? mode|simulation mode|simulated (value|response|write|read|mode)|dry[- ]?run|mock mode"
    r"|from (the )?cache|cached (value|result|response))\b",
    re.IGNORECASE,
)
_ADMITTING_KEYS = ("demo", "demo_mode", "simulated", "simulation", "dry_run", "dryRun", "cached", "from_cache")


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """The content of an answer, as the rules read it.

    Attributes:
        success: the answer claims success.
        document: the value that output rules search; None when the answer has none.
        text: all text blocks, a line each; for a JSON-RPC error its message.
        code: error code of a failure.
        admission: words by which the answer admits that it does not come from the device, so that it is no success; or None.
    """

    success: bool
    document: object
    text: str
    code: str | None = None
    admission: str | None = None


def read_answer(message: Mapping[str, object], form: str) -> tuple[Any, str, bool]:
    """Return document, text and ``isError`` of a JSON-RPC response."""
    result = message.get("result")
    if not isinstance(result, dict):
        error = message.get("error")
        return None, str(error.get("message", error) if isinstance(error, dict) else error), True
    # A tool's result has ``content``, a resource's ``contents``.
    content = result.get("content") or result.get("contents")
    blocks = [
        block["text"]
        for block in (content if isinstance(content, list) else [])
        if isinstance(block, dict) and isinstance(block.get("text"), str)
    ]
    text = "\n".join(blocks)
    is_error = result.get("isError") is True
    if form == "structured":
        return result.get("structuredContent"), text, is_error
    if form == "json":
        return _json_or(text, None), text, is_error
    if form == "texts":
        return [_json_or(block, block) for block in blocks], text, is_error
    return text, text, is_error


def _json_or(text: str, otherwise: object) -> Any:
    try:
        return _from_json(text)
    except ValueError:
        return otherwise


def _from_json(text: str) -> Any:
    """Parse a JSON text; refuse NaN, which only Python takes for JSON, and nesting that is too deep for Python.

    Raises:
        ValueError: the text is not JSON.
    """
    try:
        return _plain(json.loads(text))
    except RecursionError:
        raise ValueError("nested too deeply") from None


def _plain(value: object) -> Any:
    """Return the value as JSON has it, a tuple as a list; records hold only such values.

    Raises:
        ValueError, TypeError: JSON cannot express it: NaN, infinity, or a literal of Python such as a set.
    """
    return json.loads(json.dumps(value, allow_nan=False))


def interpret(message: Mapping[str, object], answering: Answering) -> Answer:
    """Read the answer in a JSON-RPC response ``message``."""
    document, text, is_error = read_answer(message, answering.form)
    success = not is_error
    for rule in answering.outcome:
        if (
            (rule.is_error is None or rule.is_error == is_error)
            and (rule.text is None or re.search(rule.text, text))
            and (rule.path is None or _is_true(_search(rule.path, document)))
        ):
            success = rule.success
            break
    else:
        success = success and not _admits_failure(document)
    if "error" in message:
        # A JSON-RPC error has no result that could be a success, so no rule can make it one.
        success = False
    if success:
        return Answer(success=True, document=document, text=text, admission=_admission(document, text))
    failure = text or json.dumps(document, ensure_ascii=False, default=str)
    code = next((rule.code for rule in answering.errors if re.search(rule.text, failure)), UNCLASSIFIED)
    return Answer(success=False, document=document, text=failure, code=code)


def _admits_failure(document: object) -> bool:
    """Tell whether a structured answer says of itself that it is a failure; rules of the subject file come first."""
    if isinstance(document, Mapping) and list(document) == ["result"]:
        # The SDKs wrap some results in this way.
        document = document["result"]
    if not isinstance(document, Mapping):
        return False
    for name in ("success", "ok"):
        if isinstance(document.get(name), bool):
            return document[name] is False
    error = document.get("error")
    return isinstance(error, str | Mapping) and bool(error)


def _is_true(value: object) -> bool:
    # Truth as JMESPath defines it: zero is true; an empty string, list or object is not.
    return not (value is None or value is False or value == "" or value == [] or value == {})


def _search(path: str, document: object) -> Any:
    try:
        return jmespath.search(path, document)
    except jmespath.exceptions.JMESPathError:
        # A function got a value of another type, such as length() of a number: the rule is not about this answer.
        return None


def _admission(document: object, text: str) -> str | None:
    if match := _ADMISSION.search(_without_payload(document, text)):
        return match[0]
    return next((f"{name} is {value!r}" for name, value in _members(document) if _admits(name, value)), None)


def _without_payload(document: object, text: str) -> str:
    # In a JSON document only the keys are the adapter's words: the name of a message or a node may be any text.
    if isinstance(document, Mapping) and list(document) == ["result"]:
        # The SDKs wrap a result that is no object, such as a sentence, in this way.
        document = document["result"]
        return document if isinstance(document, str) else ""
    return text if document is None or isinstance(document, str) else ""


def _admits(name: str, value: object) -> bool:
    return (name in _ADMITTING_KEYS and value is True) or (
        name == "source" and value in ("cache", "demo", "simulation")
    )


def _members(value: object) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        for name, member in value.items():
            yield name, member
            yield from _members(member)
    elif isinstance(value, list):
        for element in value:
            yield from _members(element)


def synthesised(answer: Answer, *, protocol: str, operation: str, writes: bool) -> dict[str, Any]:
    """Make an envelope for an answer that has none; ``meta.synthesised`` says so."""
    # Of an answer that has no document its text is all that it says.
    other = {"text": answer.text[:_MAX_TEXT]} if answer.document is None else {"document": answer.document}
    data = answer.document if isinstance(answer.document, dict) else other
    error = None
    if not answer.success:
        known = registry().get(answer.code or "")
        error = {
            "code": answer.code,
            "class": known.classes[0] if known is not None else "unknown",
            "message": answer.text[:_MAX_TEXT],
            "retryable": False,
            "outcome": "unknown" if writes else "not_applicable",
        }
    meta = {"schema": "otmcp/1.0", "protocol": protocol, "operation": operation, "synthesised": True}
    return {"success": answer.success, "data": data if answer.success else None, "error": error, "meta": meta}


def synthesised_from_outputs(
    outputs: Mapping[str, object], refused: tuple[str, str] | None, *, protocol: str, operation: str
) -> dict[str, Any]:
    """Make an envelope for the outputs of a binding function; ``refused`` has the code and the adapter's words."""
    code, text = refused or (None, "")
    answer = Answer(success=refused is None, document=dict(outputs), text=text, code=code)
    return synthesised(
        answer, protocol=protocol, operation=operation, writes=protocols()[protocol].operations[operation].writes
    )


def extract(rules: Mapping[str, OutputRule], document: object) -> dict[str, Any]:
    """Return the outputs of a document; an output that is not where its rule says is None."""
    return {name: _output(rule, document) for name, rule in rules.items()}


def _output(rule: OutputRule, document: object) -> Any:
    value = document if rule.path is None else _search(rule.path, document)
    if value is None:
        return None
    if rule.regex is not None:
        match = re.search(rule.regex, value if isinstance(value, str) else json.dumps(value))
        if match is None:
            return None
        value = match[1] if match.re.groups else match[0]
    if rule.split is not None and isinstance(value, str):
        value = [part.strip() for part in value.split(rule.split)]
    if rule.wrap and not isinstance(value, list):
        value = [value]
    try:
        value = [_converted(rule, part) for part in value] if isinstance(value, list) else _converted(rule, value)
        value = _plain(value)
    except (ValueError, TypeError, KeyError, SyntaxError, MemoryError, RecursionError):
        return None
    value = value if rule.then is None else _search(rule.then, value)
    if rule.means is None:
        return value
    return [_meant(rule, part) for part in value] if isinstance(value, list) else _meant(rule, value)


def _meant(rule: OutputRule, value: Any) -> Any:
    """Return what the device holds by what a named reading says; None where it says nothing of the kind."""
    if not isinstance(rule.means, str):
        return (rule.means or {}).get(value if isinstance(value, str) else json.dumps(value))
    number = computed(rule.means, value) if is_number(value) and abs(value) < LARGEST else None
    return number if number is None or rule.grid is None else nearest_on(rule.grid, number)


_EXACT = 2**53
_PYTHON_LITERAL = re.compile(r"[\[{'\"]|(True|False|None)$")
"""Beginnings of what Python alone writes in another way than JSON does; ``0x10``, ``1_000`` and ``1, 2`` are texts to everybody else."""


def _exact(value: Any) -> Any:
    """Return a value of a text with the integers as decimal strings that not every reader of JSON reads alike (RFC 8259, section 6): a text
    has all their digits."""
    if isinstance(value, list):
        return [_exact(member) for member in value]
    if isinstance(value, dict):
        return {name: _exact(member) for name, member in value.items()}
    large = isinstance(value, int) and not isinstance(value, bool) and abs(value) >= _EXACT
    return str(value) if large else value


def literal(text: str) -> Any:
    """Return the value that a text is a literal of, in JSON or in Python; what is none is the text itself."""
    bare = text.strip()
    try:
        return _exact(_from_json(bare))
    except ValueError:
        pass
    if _PYTHON_LITERAL.match(bare):
        try:
            return _exact(_plain(ast.literal_eval(bare)))
        except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError):
            pass
    return text


def _converted(rule: OutputRule, value: Any) -> Any:
    if rule.strip is not None and isinstance(value, str):
        value = value.removeprefix(rule.strip)
    match rule.convert:
        case "int":
            number = float(value)
            if not number.is_integer():
                raise ValueError
            return int(value) if isinstance(value, str) and value.strip().lstrip("+-").isdigit() else int(number)
        case "float":
            return float(value)
        case "bool":
            if isinstance(value, str):
                return {"true": True, "false": False, "1": True, "0": False}[value.strip().lower()]
            return bool(value)
        case "string":
            return value if isinstance(value, str) else json.dumps(value)
        case "json":
            return _from_json(value)
        case "python":
            return ast.literal_eval(value)
        case "literal":
            return literal(value) if isinstance(value, str) else value
        case "hex":
            return int(value, 16)
        case "bytes":
            return list(bytes.fromhex(value))
    return value
