"""``assessment.json``: the tries of an assessment, and who was assessed with what. Everything printed or drawn is made from it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypedDict, cast

import msgspec

from ..core.errors import UsageError
from ..core.files import new_file

__all__ = ["FORM", "Assessment", "CallTold", "TryTold", "read", "write"]

FORM = "otmcp-assessment/1"


class CallTold(TypedDict):
    """A call: what was asked of which adapter, what became of it, and the arguments that the tool's schema objects to.

    ``success`` is None where no readable answer came; ``at_ms`` counts from the first call of the try; ``latency_ms`` is None without an
    answer; ``bytes`` are those of the answer as the assistant gets it.
    """

    protocol: str
    tool: str
    arguments: dict[str, Any]
    success: bool | None
    objected: list[str]
    at_ms: float
    latency_ms: float | None
    bytes: int
    text: str


class TryTold(TypedDict):
    """One try. ``first_right`` is the number of calls and the milliseconds until what was to be done was done, or None."""

    task: str
    family: str
    protocols: list[str]
    number: int
    verdict: str
    honesty: str
    outcome: str | None
    value: Any
    wanted: Any
    why: list[str]
    changed: list[str]
    calls: list[CallTold]
    first_right: dict[str, float] | None
    seconds: float
    tokens: int | None
    prompt: str
    answer: str
    problem: str


class Assessment(TypedDict):
    """An assessment of one assistant with one subject.

    ``assistant`` names the command or the model; ``prompts`` is a digest over all words that it was given, values left out; ``tools`` are those
    that each adapter lists, with the bytes of the whole list; ``not_asked`` are assignments with the reason.
    """

    form: str
    kit: str
    began: str
    assistant: str
    engine: str
    subject: dict[str, str]
    seed: int
    prompts: str
    tools: dict[str, dict[str, Any]]
    tries: list[TryTold]
    not_asked: dict[str, str]


def write(path: Path, assessment: Assessment) -> None:
    """Write the file anew."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with new_file(path) as file:
        file.write(json.dumps(assessment, indent=1, ensure_ascii=True).encode())


def read(paths: Sequence[Path]) -> list[Assessment]:
    """Read files.

    Raises:
        UsageError: one is not there, or is no assessment.
    """
    return [_read(path) for path in paths]


def _read(path: Path) -> Assessment:
    try:
        found = json.loads(path.read_bytes())
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}") from None
    except (ValueError, RecursionError):
        raise UsageError(f"{path}: this is no JSON") from None
    if not isinstance(found, Mapping) or found.get("form") != FORM:
        raise UsageError(f"{path}: this is no file of the form {FORM}")
    try:
        msgspec.convert(found, Assessment)
    except (msgspec.ValidationError, RecursionError) as reason:
        raise UsageError(f"{path}: this is no file of the form {FORM}: {reason}") from None
    return cast(Assessment, found)
