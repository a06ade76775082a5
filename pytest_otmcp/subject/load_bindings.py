"""Reads what a subject file says about an adapter's tools and the answers they give."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from ..core.error_registry import registry
from ..protocols.protocol import Operation
from ..protocols.registry import protocols
from .answers import UNCLASSIFIED
from .model import Answering, Binding, ErrorRule, OutcomeRule, OutputRule
from .reading import Reader, kind

__all__ = ["BindingReader"]

_FORMS = ("envelope", "structured", "json", "text", "texts")
_INPUT_TYPES = ("string", "int", "float", "bool", "hex", "json", "list")
_OUTPUT_TYPES = ("string", "int", "float", "bool", "hex", "json", "python")
_BINDING_KEYS = (
    "tool",
    "arguments",
    "result",
    "when",
    "offset",
    "names",
    "as",
    "answer",
    "outcome",
    "errors",
    "resource",
    "blocking",
)


class BindingReader:
    """Reads the tables of one adapter."""

    def __init__(self, reader: Reader, protocol: str) -> None:
        self._reader = reader
        self._operations = protocols()[protocol].operations

    def answering(self, table: Mapping[str, Any], key: str, default: Answering | None = None) -> Answering:
        """How answers are read, from the keys ``answer``, ``outcome`` and ``errors``."""
        default = default or Answering()
        form = self._reader.choice(table.get("answer", default.form), f"{key}.answer", _FORMS)
        for name in ("outcome", "errors"):
            if name in table and form == "envelope":
                raise self._reader.refuse(
                    f"{key}.{name}", "an adapter that answers in envelopes needs no such rules; else say 'answer'"
                )
        return Answering(
            form=form,
            outcome=self._outcome(table["outcome"], f"{key}.outcome") if "outcome" in table else default.outcome,
            errors=self._errors(table["errors"], f"{key}.errors") if "errors" in table else default.errors,
        )

    def _entries(self, value: Any, key: str) -> list[Any]:
        if not isinstance(value, list):
            raise self._reader.refuse(key, f"expected a list of rules, found {kind(value)}")
        return value

    def _outcome(self, value: Any, key: str) -> tuple[OutcomeRule, ...]:
        rules = []
        for index, entry in enumerate(self._entries(value, key)):
            where = f"{key}[{index}]"
            table = self._reader.table(entry, where, ("is_error", "text", "path", "then"))
            if len(table) < 2:
                raise self._reader.refuse(where, "expected a condition (is_error, text or path) and 'then'")
            then = self._reader.choice(table.get("then"), f"{where}.then", ("success", "failure"))
            rules.append(
                OutcomeRule(
                    success=then == "success",
                    is_error=self._reader.flag(table, "is_error", where),
                    text=self._reader.regex(table["text"], f"{where}.text") if "text" in table else None,
                    path=self._reader.path_expression(table["path"], f"{where}.path") if "path" in table else None,
                )
            )
        return tuple(rules)

    def _errors(self, value: Any, key: str) -> tuple[ErrorRule, ...]:
        rules = []
        for index, entry in enumerate(self._entries(value, key)):
            where = f"{key}[{index}]"
            table = self._reader.table(entry, where, ("text", "code"))
            code = self._reader.choice(table.get("code"), f"{where}.code", (*registry(), UNCLASSIFIED))
            rules.append(ErrorRule(text=self._reader.regex(table.get("text"), f"{where}.text"), code=code))
        return tuple(rules)

    def operations(self, value: Any, key: str, answering: Answering) -> dict[str, tuple[Binding, ...]]:
        """The ``bind`` tables: operation to its bindings."""
        bound = {}
        for name, entry in self._reader.table(value, key, self._operations).items():
            where = f"{key}.{name}"
            cases = entry if isinstance(entry, list) else [entry]
            if not cases:
                raise self._reader.refuse(where, "expected a table")
            bound[name] = tuple(
                self._binding(self._operations[name], case, where if case is entry else f"{where}[{index}]", answering)
                for index, case in enumerate(cases)
            )
            for index, binding in enumerate(bound[name][:-1]):
                if not binding.when:
                    raise self._reader.refuse(f"{where}[{index}]", "without 'when' it hides the tables after it")
        return bound

    def _binding(self, operation: Operation, value: Any, key: str, answering: Answering) -> Binding:
        reader = self._reader
        table = reader.table(value, key, _BINDING_KEYS)
        arguments = reader.table(table.get("arguments", {}), f"{key}.arguments")
        self._check_template(arguments, operation.inputs, f"{key}.arguments")
        result = reader.table(table.get("result", {}), f"{key}.result", operation.outputs)
        if lacking := [name for name in operation.needed if name not in result]:
            raise reader.refuse(f"{key}.result", f"lacks {lacking[0]!r}, without which the operation cannot be judged")
        resource = "resource" in table
        if resource and ("tool" in table or arguments):
            raise reader.refuse(f"{key}.resource", "a resource is read without tool and arguments")
        return Binding(
            tool=reader.text(table, "resource" if resource else "tool", key),
            resource=resource,
            blocking=self._blocking(operation, table, key),
            arguments=arguments,
            outputs={name: self._output(rule, f"{key}.result.{name}") for name, rule in result.items()},
            answering=self.answering(table, key, answering),
            when=self._by_input(table, "when", operation, key),
            offset={
                name: self._number(entry, f"{key}.offset.{name}")
                for name, entry in self._by_input(table, "offset", operation, key).items()
            },
            names={
                name: reader.table(entry, f"{key}.names.{name}")
                for name, entry in self._by_input(table, "names", operation, key).items()
            },
            convert={
                name: reader.choice(entry, f"{key}.as.{name}", _INPUT_TYPES)
                for name, entry in self._by_input(table, "as", operation, key).items()
            },
        )

    def _blocking(self, operation: Operation, table: Mapping[str, Any], key: str) -> bool:
        blocking = bool(self._reader.flag(table, "blocking", key))
        if blocking and operation.waits is None:
            raise self._reader.refuse(f"{key}.blocking", "only a call for messages may wait for them")
        return blocking

    def _by_input(self, table: Mapping[str, Any], name: str, operation: Operation, key: str) -> dict[str, Any]:
        return self._reader.table(table.get(name, {}), f"{key}.{name}", operation.inputs)

    def _number(self, value: Any, key: str) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise self._reader.refuse(key, f"expected a number, found {kind(value)}")
        return value

    def _output(self, value: Any, key: str) -> OutputRule:
        reader = self._reader
        if isinstance(value, str):
            return OutputRule(path=reader.path_expression(value, key))
        table = reader.table(value, key, ("path", "regex", "split", "strip", "as", "then", "wrap"))
        return OutputRule(
            path=reader.path_expression(table["path"], f"{key}.path") if "path" in table else None,
            regex=reader.regex(table["regex"], f"{key}.regex") if "regex" in table else None,
            split=reader.text(table, "split", key) if "split" in table else None,
            strip=reader.text(table, "strip", key) if "strip" in table else None,
            convert=reader.choice(table["as"], f"{key}.as", _OUTPUT_TYPES) if "as" in table else None,
            then=reader.path_expression(table["then"], f"{key}.then") if "then" in table else None,
            wrap=bool(reader.flag(table, "wrap", key)),
        )

    def _check_template(self, template: Any, inputs: tuple[str, ...], key: str) -> None:
        if isinstance(template, str) and template.startswith("$") and template[1:] not in inputs:
            known = ", ".join(f"${name}" for name in inputs) or "none"
            raise self._reader.refuse(key, f"{template} is no input of this operation; its inputs are: {known}")
        if isinstance(template, dict):
            for name, value in template.items():
                self._check_template(value, inputs, f"{key}.{name}")
        elif isinstance(template, list):
            for value in template:
                self._check_template(value, inputs, key)
