"""Comparison of a subject file with what a run record says of its subject. Pure."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from ..core.strict_json import same_json
from ..core.text import recorded_name
from ..record.redaction import REDACTED
from ..record.schema import AdapterFacts
from ..record.schema import Subject as RecordedSubject
from .model import Adapter, Binding, Function, Subject

__all__ = ["differences", "stored_bindings"]

_TOLD_BY_THE_SERVER = ("server_name", "server_version", "protocol_version", "tools", "unmet", "listing", "bindings")


def differences(subject: Subject, recorded: RecordedSubject) -> Iterator[str]:
    """Say where a record differs from the subject file that it names, a sentence each.

    Args:
        subject: as :func:`~pytest_otmcp.subject.load.load_subject` reads the file.
        recorded: the subject of a record.
    """
    if recorded["digest"] != subject.digest:
        yield f"the digest of the subject is {recorded['digest']}, that of the file is {subject.digest}"
    for name, stated in (("name", subject.name), ("version", subject.version)):
        if dict(recorded)[name] != recorded_name(stated):
            yield f"the {name} of the subject is {dict(recorded)[name]!r}, the file says {stated!r}"
    declared = [{"item": one.item, "reason": one.reason, "expires": str(one.expires)} for one in subject.deviations]
    yield from _difference("the subject's deviations", recorded["deviations"], declared)
    # An adapter that no item had is in the file alone.
    for protocol, facts in recorded["adapters"].items():
        if protocol not in subject.adapters:
            yield f"the file has no adapter {protocol!r}"
            continue
        yield from _of_adapter(protocol, subject.adapters[protocol], facts)


def _of_adapter(protocol: str, adapter: Adapter, facts: AdapterFacts) -> Iterator[str]:
    recorded: Mapping[str, Any] = dict(facts)
    for name, stated in adapter.facts().items():
        if name == "lists":
            # A kit that does not know a list has no empty one of it.
            yield from _difference(f"{protocol}.lists", _said(facts["lists"]), _said(adapter.lists))
        elif name not in _TOLD_BY_THE_SERVER:
            yield from _difference(f"{protocol}.{name}", recorded.get(name), stated)
    for operation, stored in facts["bindings"].items():
        if operation not in adapter.operations:
            yield f"{protocol}: the file has no binding of {operation}"
        else:
            yield from _difference(f"{protocol}.bind.{operation}", stored, stored_bindings(adapter, operation))


def _said(lists: Mapping[str, Sequence[str]]) -> dict[str, list[str]]:
    return {key: [*values] for key, values in lists.items() if values}


def stored_bindings(adapter: Adapter, operation: str) -> list[dict[str, Any]] | None:
    """Return the bindings of an operation as a record has them; None for one that a Python function performs."""
    bound = adapter.operations.get(operation)
    return None if bound is None or isinstance(bound, Function) else [_stored(case) for case in bound]


def _stored(binding: Binding) -> dict[str, Any]:
    stored = asdict(binding)
    for name in ("then", "holds"):
        if binding.command is not None and not stored["command"][name]:
            del stored["command"][name]
    for rule in (*stored["outputs"].values(), *stored["keep"].values()):
        for name in ("means", "grid"):
            if not rule[name]:
                del rule[name]
    for name in ("command", "keep", "topicless"):
        if not stored[name]:
            del stored[name]
    return stored


def _difference(what: str, recorded: object, stated: object) -> Iterator[str]:
    # A secret is not in the record; the digest covers it.
    if not same_json(recorded, stated) and REDACTED not in json.dumps(recorded):
        yield f"{what} is {_short(recorded)}, the file says {_short(stated)}"


def _short(value: object) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 120 else f"{text[:120]}…"
