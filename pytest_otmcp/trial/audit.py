"""Audit records and answers as a subject file describes them. Pure."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta

from ..core.strict_json import parse_strict
from ..subject.answers import extract, read_answer
from ..subject.model import OutputRule
from .reply import Reply

__all__ = ["Record", "records_of", "told_in"]


@dataclass(frozen=True, slots=True)
class Record:
    """One audit record.

    Attributes:
        line: as it is in the log.
        fields: what it says, by the names of the subject file; None for what is not there. Empty for a line that is no JSON object.
    """

    line: str
    fields: Mapping[str, object]

    @property
    def in_utc(self) -> bool:
        """Whether its time is one of RFC 3339 in UTC."""
        try:
            return datetime.fromisoformat(str(self.fields.get("time"))).utcoffset() == timedelta(0)
        except ValueError:
            return False


def records_of(lines: Iterable[str], fields: Mapping[str, str]) -> list[Record]:
    """Return the records on these lines.

    Args:
        fields: JMESPath by the name of what is found there.
    """
    rules = {name: OutputRule(path=path) for name, path in fields.items()}
    found = []
    for line in lines:
        try:
            document = json.loads(line)
        except (ValueError, RecursionError):
            document = None
        found.append(Record(line, extract(rules, document) if isinstance(document, dict) else {}))
    return found


def told_in(reply: Reply, path: str) -> object:
    """Return what an answer has at a JMESPath, in its structured content or, without that, in its text as JSON or as it is; None for nothing."""
    try:
        message = parse_strict(reply.exchange.response or b"null")
    except ValueError:
        return None
    if not isinstance(message, dict):
        return None
    structured, text, _ = read_answer(message, "structured")
    document = structured or read_answer(message, "json")[0] or text
    return extract({"told": OutputRule(path=path)}, document).get("told")
