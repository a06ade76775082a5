"""Tells whether a call of an assistant performs an operation, by the bindings of the subject file. Pure."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from ..core.strict_json import same_json
from ..protocols.registry import protocols
from ..subject.answers import interpret, read_answer
from ..subject.model import Adapter, Answering, Binding, Function, handles, placeholders

__all__ = ["binding_of", "performs", "succeeded"]


def binding_of(adapter: Adapter, operation: str, inputs: Mapping[str, object]) -> Binding | None:
    """Return the tool that performs an operation with these inputs; None where there is none that one call of a tool is."""
    bound = adapter.operations.get(operation)
    if bound is None or isinstance(bound, Function):
        return None
    fitting = (case for case in bound if case.fits(inputs) and not case.resource and not handles(case.arguments))
    return next(fitting, None)


def performs(
    adapter: Adapter,
    endpoint: Mapping[str, str],
    schema: object,
    operation: str,
    inputs: Mapping[str, object],
    tool: str,
    arguments: Mapping[str, object],
) -> bool:
    """Tell whether a call is this operation with these inputs, whatever else it says.

    An argument that the assistant may leave out has to be what the tool takes in its place: a call to another unit is another call.

    Args:
        schema: the tool's input schema.
    """
    binding = binding_of(adapter, operation, inputs)
    if binding is None or binding.tool != tool:
        return False
    wanted = binding.fill(inputs, endpoint)
    known = set(protocols()[adapter.protocol].operations[operation].inputs)
    defaults = _defaults(schema)
    for name, template in binding.arguments.items():
        asked = placeholders(template) & known
        # A limit of seconds is how the assistant waits, not what it asks for.
        if asked - {"seconds"} and not _same(arguments.get(name, defaults.get(name)), wanted.get(name)):
            return False
    for name, given in arguments.items():
        expected = wanted.get(name, defaults.get(name))
        asked = placeholders(binding.arguments.get(name)) & known
        if not asked and given is not None and expected is not None and not _same(given, expected):
            return False
    return True


def _defaults(schema: object) -> dict[str, Any]:
    properties = schema.get("properties") if isinstance(schema, Mapping) else None
    if not isinstance(properties, Mapping):
        return {}
    return {name: about["default"] for name, about in properties.items() if "default" in about}


def _same(found: object, wanted: object) -> bool:
    if same_json(found, wanted):
        return True
    # "70000" for 70000: how strictly a tool reads numbers is the adapter's affair.
    return isinstance(found, str) != isinstance(wanted, str) and str(found).strip() == _written(wanted)


def _written(value: object) -> str:
    return value.strip() if isinstance(value, str) else json.dumps(value)


def succeeded(adapter: Adapter, tool: str, message: Mapping[str, object]) -> bool:
    """Tell whether an answer claims success, by the rules of the subject file; of a tool that it does not bind, by the rules for all."""
    answering = next(
        (
            case.answering
            for cases in adapter.operations.values()
            if not isinstance(cases, Function)
            for case in cases
            if case.tool == tool
        ),
        adapter.answering,
    )
    return _native(message) if answering.native else interpret(message, answering).success


def _native(message: Mapping[str, object]) -> bool:
    structured, _, is_error = read_answer(message, Answering(form="structured").form)
    told = structured.get("success") if isinstance(structured, Mapping) else None
    return "error" not in message and (told if isinstance(told, bool) else not is_error)
