"""Named commands, made from the ``commands`` tables of a subject file; ``grammar`` has checked their shape."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from ..protocols.protocol import OtProtocol
from .bindings import output_rule, read_answering
from .command import SAYS, Command, Draw, Effect, is_computed, is_number, names_in, pattern
from .kinds import Refusal, nearest
from .model import Answering, Binding, Function, OutputRule, placeholders
from .placeholder_check import check_placeholders

__all__ = ["Operations", "check_names", "declared_by", "read_draw", "read_draws", "with_commands"]

Operations = dict[str, tuple[Binding, ...] | Function]


def with_commands(
    operations: Operations, tables: Mapping[str, Any], key: str, answering: Answering, protocol: OtProtocol
) -> Operations:
    """Return the operations with the named commands that perform them, which are tried first.

    Args:
        operations: what ``bind`` tables and a bindings file say.
        tables: name to table.
        key: of these tables.

    Raises:
        Refusal: a table contradicts itself, or another one.
    """
    found: dict[str, list[Binding]] = {}
    for name, table in tables.items():
        at = f"{key}.{name}"
        operation, binding = _command(name, table, at, answering, protocol)
        if isinstance(operations.get(operation), Function):
            raise Refusal(f"{at}.effect.{operation}", "the bindings file has a function for this operation as well")
        _check_alone(binding, found.setdefault(operation, []), at)
        found[operation].append(binding)
    bound = {name: case for name, case in operations.items() if not isinstance(case, Function)}
    return {**operations, **{name: (*cases, *bound.get(name, ())) for name, cases in found.items()}}


def declared_by(operations: Mapping[str, tuple[Binding, ...] | Function], protocol: OtProtocol) -> dict[str, list[str]]:
    """Return what the named commands add to the lists of the protocol's own keys."""
    added: dict[str, list[str]] = {}
    for name, bound in operations.items():
        cases = () if isinstance(bound, Function) else bound
        for command in (case.command for case in cases if case.command is not None):
            for operation, effect in ((name, command.effect), *((one.operation, one.effect) for one in command.then)):
                texts = {key: pattern(value, "+") for key, value in effect.items() if isinstance(value, str)}
                for key, values in protocol.declares(operation, texts).items():
                    added.setdefault(key, []).extend(values)
    return {key: list(dict.fromkeys(values)) for key, values in added.items()}


def _command(
    name: str, table: Mapping[str, Any], key: str, answering: Answering, protocol: OtProtocol
) -> tuple[str, Binding]:
    stated = table["effect"] if isinstance(table["effect"], list) else [table["effect"]]
    (first, *then) = (_effect(operation, inputs, protocol) for one in stated for operation, inputs in one.items())
    effect = [first.effect, *(one.effect for one in then)]
    draws = read_draws(table, key)
    arguments, within = table["arguments"], f"{key}.effect" if then else f"{key}.effect.{first.operation}"
    check_names(draws, placeholders(arguments), f"{key}.arguments", "is given to no argument of the tool")
    check_names(draws, names_in(effect), within, "has no part in it, so that nothing says what it does at the device")
    for argument, draw in draws.items():
        if is_computed(effect, argument) and not all(map(is_number, draw.means or draw.values)):
            raise Refusal(within, f"makes a number from ${argument}, which is no number for each of its values")
    check_placeholders(arguments, f"{key}.arguments", tuple(draws))
    command = Command(name=name, draws=draws, effect=first.effect, documents=first.documents, then=tuple(then))
    if command.is_ambiguous:
        raise Refusal(within, "two values of an argument are the same at the device, or run into one another in a text")
    for named in table["says"]:
        if named not in draws and named not in first.effect:
            known = nearest(named, [*draws, *first.effect])
            raise Refusal(f"{key}.says.{named}", f"is no argument that is drawn, and no input of the effect; {known}")
    binding = Binding(
        tool=table.get("tool", name),
        arguments=arguments,
        outputs={f"{SAYS}{named}": _said(rule, draws.get(named)) for named, rule in table["says"].items()},
        answering=read_answering(table, key, answering),
        when={},
        offset={},
        names={},
        convert={},
        command=command,
    )
    return first.operation, binding


def _said(rule: str | Mapping[str, Any], draw: Draw | None) -> OutputRule:
    """Return where an answer says a value; one of a range may be told with digits that only its calculation has made."""
    found = output_rule(rule)
    if draw is None or draw.values or isinstance(found.means, Mapping):
        return found
    return replace(found, means=found.means or "$value", grid=(draw.lowest, draw.step))


def _effect(operation: str, inputs: Mapping[str, Any], protocol: OtProtocol) -> Effect:
    documents = (one for one in protocol.operations[operation].documents if isinstance(inputs.get(one), dict | list))
    return Effect(operation=operation, effect=inputs, documents=tuple(documents))


def read_draws(table: Mapping[str, Any], key: str) -> dict[str, Draw]:
    """Return the values that each argument may be given, from the keys ``draws`` and ``means``."""
    draws = {name: read_draw(draw, f"{key}.draws.{name}") for name, draw in table["draws"].items()}
    for name, meanings in table["means"].items():
        if isinstance(meanings, list):
            drawn = draws.get(name, Draw())
            if len(drawn.values) != len(meanings):
                raise Refusal(
                    f"{key}.means.{name}", "expected as many values as the list of this argument in 'draws' has"
                )
            draws[name] = replace(drawn, means=tuple(meanings))
            continue
        if name in draws:
            raise Refusal(f"{key}.means.{name}", "'draws' has values for this argument as well")
        if not meanings:
            raise Refusal(f"{key}.means.{name}", "expected a value and what it is at the device, found an empty table")
        draws[name] = Draw(values=tuple(meanings), means=tuple(meanings.values()))
    return draws


def read_draw(draw: Sequence[Any] | Mapping[str, Any], key: str) -> Draw:
    """Return the values of a list, or of a range."""
    if isinstance(draw, list):
        return Draw(values=tuple(draw))
    assert isinstance(draw, Mapping)
    found = Draw(lowest=draw["lowest"], highest=draw["highest"], step=draw["step"])
    if draw["step"] <= 0 or draw["highest"] < draw["lowest"]:
        raise Refusal(key, "expected a 'highest' that is not below 'lowest', and a 'step' above 0")
    if not found.is_possible:
        raise Refusal(key, "expected numbers that every reader of JSON reads alike, up to 2 to the power of 53")
    return found


def check_names(draws: Mapping[str, Draw], used: set[str], key: str, objection: str) -> None:
    """Refuse a name that nothing draws, and a value that nothing uses."""
    for name in sorted(used - draws.keys()):
        known = nearest(name, draws) if draws else "it draws none"
        raise Refusal(key, f"${name} is no value that is drawn; {known}")
    for name in sorted(draws.keys() - used):
        raise Refusal(key, f"${name} {objection}")


def _check_alone(binding: Binding, others: Sequence[Binding], key: str) -> None:
    assert binding.command is not None
    for inputs in binding.command.examples():
        for other in others:
            if other.fits(inputs):
                assert other.command is not None
                raise Refusal(
                    f"{key}.effect",
                    f"the command {other.command.name!r} has this effect as well, so that the kit could not tell which of them to call",
                )
