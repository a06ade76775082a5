"""Bindings and answer rules, made from what a subject file says about an adapter's tools; ``grammar`` has checked its shape."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .kinds import Refusal
from .model import Answering, Binding, ErrorRule, OutcomeRule, OutputRule

__all__ = ["output_rule", "read_answering", "read_bindings"]


def read_answering(table: Mapping[str, Any], key: str, default: Answering) -> Answering:
    """Return how answers are read, from the keys ``answer``, ``outcome`` and ``errors``; a missing key is as in ``default``."""
    form = table.get("answer", default.form)
    for name in ("outcome", "errors"):
        if name in table and form == "envelope":
            raise Refusal(
                f"{key}.{name}", "an adapter that answers in envelopes needs no such rules; else say 'answer'"
            )
    return Answering(
        form=form,
        outcome=tuple(map(_outcome_rule, table["outcome"])) if "outcome" in table else default.outcome,
        errors=tuple(ErrorRule(**rule) for rule in table["errors"]) if "errors" in table else default.errors,
    )


def read_bindings(bind: Mapping[str, Any], key: str, answering: Answering) -> dict[str, tuple[Binding, ...]]:
    """Return the ``bind`` tables, operation to its bindings."""
    return {name: _cases(entry, f"{key}.{name}", answering) for name, entry in bind.items()}


def _cases(entry: dict[str, object] | list[dict[str, object]], key: str, answering: Answering) -> tuple[Binding, ...]:
    if isinstance(entry, dict):
        return (_binding(entry, key, answering),)
    for index, case in enumerate(entry[:-1]):
        if not case["when"]:
            raise Refusal(f"{key}[{index}]", "without 'when' it hides the tables after it")
    return tuple(_binding(case, f"{key}[{index}]", answering) for index, case in enumerate(entry))


def _binding(table: Mapping[str, Any], key: str, answering: Answering) -> Binding:
    return Binding(
        tool=table["resource"] if "resource" in table else table["tool"],
        resource="resource" in table,
        blocking=table["blocking"],
        topicless=table["topic"] == "subscribed",
        arguments=table["arguments"],
        outputs={name: output_rule(rule) for name, rule in table["result"].items()},
        answering=read_answering(table, key, answering),
        when=table["when"],
        offset=table["offset"],
        names=table["names"],
        convert=table["as"],
        max_age_s=_max_age_s(table, key, answering),
        keep={name: output_rule(rule) for name, rule in table["keep"].items()},
    )


def _max_age_s(table: Mapping[str, Any], key: str, answering: Answering) -> float | None:
    if "max_age_s" not in table:
        return None
    if not read_answering(table, key, answering).native:
        raise Refusal(f"{key}.source", "only an answer in the kit's envelope says how old it is")
    return float(table["max_age_s"])


def _outcome_rule(table: Mapping[str, Any]) -> OutcomeRule:
    return OutcomeRule(
        success=table["then"] == "success",
        is_error=table.get("is_error"),
        text=table.get("text"),
        path=table.get("path"),
    )


def output_rule(rule: str | Mapping[str, Any]) -> OutputRule:
    """Return the rule that an entry of a ``result`` table is."""
    if isinstance(rule, str):
        return OutputRule(path=rule)
    return OutputRule(
        path=rule.get("path"),
        regex=rule.get("regex"),
        split=rule.get("split"),
        strip=rule.get("strip"),
        convert=rule.get("as"),
        then=rule.get("then"),
        wrap=rule.get("wrap", False),
        means=rule.get("means"),
    )
