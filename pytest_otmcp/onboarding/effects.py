"""What a tool with a vocabulary of its own does at the device, found in calls whose arguments differ. Pure."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ..core.strict_json import parse_strict, same_json
from ..subject.command import Command, Draw, is_number, names_in

__all__ = ["Call", "Effect", "effect_of"]

Place = tuple[str | int, ...]
"""Where a value is within the inputs of an operation: names of members, and numbers of elements."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Call:
    """A call that the device was told one thing by.

    Attributes:
        arguments: of the tool.
        operation, inputs: what the device was told, as an operation of the protocol that writes.
        answer: of the tool.
    """

    arguments: Mapping[str, Any]
    operation: str
    inputs: Mapping[str, Any]
    answer: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """A named command as a subject file states it.

    Attributes:
        operation: what it performs.
        arguments: template of the tool's arguments.
        command: the values that may be drawn, and the template of the operation's inputs.
        calls: how many calls show it.
        good: the answer to one of them.
        says: argument to where the answers say its value, and what that means.
        form: where the document of the answers is that ``says`` looks into.
    """

    operation: str
    arguments: Mapping[str, Any]
    command: Command
    calls: int
    good: Mapping[str, object]
    says: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    form: str = ""


def effect_of(
    tool: str, calls: Sequence[Call], ranges: Mapping[str, tuple[float, float, float]], documents: Sequence[str]
) -> Effect | None:
    """Return the command that explains every call; None where the arguments do not explain what the device was told.

    Args:
        calls: the first one, then the same again, then others that differ from it in one argument each.
        ranges: lowest and highest value of arguments that are numbers, and the step from one value to the next.
        documents: inputs of the operation that are texts, and may be JSON documents.
    """
    first, _, *others = calls
    if any(call.operation != first.operation for call in calls):
        return None
    told = [_read(call.inputs, documents) for call in calls]
    base, again = (dict(_leaves(inputs)) for inputs in told[:2])
    # A member that differs between two equal calls, such as the time, is the adapter's own.
    templates = {place: value for place, value in base.items() if same_json(value, again.get(place))}
    if any(place not in templates and not _in_document(place) for place in base):
        return None
    draws: dict[str, Draw] = {}
    for name, value in first.arguments.items():
        differing = [
            (call.arguments[name], dict(_leaves(inputs)))
            for call, inputs in zip(others, told[2:], strict=True)
            if not same_json(call.arguments[name], value)
        ]
        if any(leaves.keys() != base.keys() for _, leaves in differing):
            # Another value does something of another kind: the argument always has this one.
            continue
        moved = {
            place: [base[place], *(leaves[place] for _, leaves in differing)]
            for place in templates
            if any(not same_json(base[place], leaves[place]) for _, leaves in differing)
        }
        if not moved:
            continue
        explained = _explained(name, [value, *(other for other, _ in differing)], moved)
        if explained is None or any(names_in(templates[place]) for place in moved):
            return None
        draw, made = explained
        if name in ranges and not draw.means and len(draw.values) > 2:
            lowest, highest, step = ranges[name]
            draw = Draw(lowest=lowest, highest=highest, step=step)
        draws[name] = draw
        templates = {place: left for place, left in templates.items() if place not in moved} | made
    effect = _built(told[0], templates)
    inside = [name for name in documents if isinstance(effect.get(name), dict)]
    command = Command(name=tool, draws=draws, effect=effect, documents=tuple(inside))
    if (first.arguments and not draws) or command.is_ambiguous:
        return None
    fixed = first.arguments.keys() - draws.keys()
    like_first = [call for call in calls if all(same_json(call.arguments[one], first.arguments[one]) for one in fixed)]
    if not all(_explains(command, call, documents) for call in like_first):
        return None
    arguments = {name: f"${name}" if name in draws else value for name, value in first.arguments.items()}
    return Effect(
        operation=first.operation, arguments=arguments, command=command, calls=len(like_first), good=first.answer
    )


def _in_document(place: Place) -> bool:
    return len(place) > 1 and isinstance(place[1], str)


def _explains(command: Command, call: Call, documents: Sequence[str]) -> bool:
    try:
        asked = command.effect_of(call.arguments)
    except LookupError:
        # This value of an argument means the same as another value, which is drawn.
        return True
    found = dict(_leaves(_read(call.inputs, documents)))
    return all(place in found and same_json(found[place], value) for place, value in _leaves(_read(asked, documents)))


def _explained(
    name: str, values: Sequence[Any], moved: Mapping[Place, Sequence[Any]]
) -> tuple[Draw, dict[Place, str]] | None:
    """Return the values to draw, and the template of each place; None where no meaning of the values explains what it must.

    A member of a document need not be explained; it is left out.
    """
    best: tuple[Sequence[Any], dict[Place, str]] = (values, {})
    for means in (values, *moved.values()):
        found = {place: _template(name, means, leaves) for place, leaves in moved.items()}
        made = {place: template for place, template in found.items() if template is not None}
        if len(made) > len(best[1]) and all(place in made or _in_document(place) for place in moved):
            best = (means, made)
    means, made = best
    if not made:
        return None
    keep = [index for index, mean in enumerate(means) if not any(same_json(mean, one) for one in means[:index])]
    meanings = () if means is values else tuple(means[index] for index in keep)
    return Draw(values=tuple(values[index] for index in keep), means=meanings), made


def _template(name: str, values: Sequence[Any], leaves: Sequence[Any]) -> str | None:
    """Return the template that makes every leaf from the value of its call, if there is one."""
    if all(map(same_json, values, leaves)):
        return f"${name}"
    if all(map(is_number, (*values, *leaves))):
        return _line(name, values, leaves)
    if all(isinstance(leaf, str) for leaf in leaves):
        said = str(values[0])
        if said and leaves[0] != said and leaves[0].count(said) == 1:
            before, after = leaves[0].split(said)
            within = not re.match(r"\w", after)
            if within and all(f"{before}{value}{after}" == leaf for value, leaf in zip(values, leaves, strict=True)):
                return f"{before}${name}{after}"
    return None


def _line(name: str, values: Sequence[float], leaves: Sequence[float]) -> str | None:
    """Return the factor and the number to be added that make every leaf, of three values at least."""
    if len({*values}) < 3:
        return None
    x, y = values[0], leaves[0]
    other = next(index for index, value in enumerate(values) if value != x)
    scale = round((leaves[other] - y) / (values[other] - x), 9)
    offset = round(y - scale * x, 9)
    if not scale or any(round(scale * value + offset, 9) != leaf for value, leaf in zip(values, leaves, strict=True)):
        return None
    text = f"${name}" if scale == 1 else f"${name} * {_plain(scale)}"
    return text if not offset else f"{text} {'+' if offset > 0 else '-'} {_plain(abs(offset))}"


def _plain(number: float) -> str:
    return f"{number:.9f}".rstrip("0").rstrip(".")


def _read(inputs: Mapping[str, Any], documents: Sequence[str]) -> dict[str, Any]:
    """Return the inputs with those as documents that are JSON objects."""
    read = dict(inputs)
    for name in documents:
        if isinstance(read.get(name), str):
            try:
                document = parse_strict(read[name])
            except ValueError:
                continue
            if isinstance(document, dict):
                read[name] = document
    return read


def _leaves(value: object, place: Place = ()) -> Iterator[tuple[Place, Any]]:
    members: Sequence[tuple[str | int, Any]] = ()
    if isinstance(value, dict):
        members = list(value.items())
    elif isinstance(value, list):
        members = list(enumerate(value))
    for name, member in members:
        yield from _leaves(member, (*place, name))
    if not members:
        yield place, value


def _built(value: Any, templates: Mapping[Place, Any], place: Place = ()) -> Any:
    """Return the inputs with the templates in their places; members that the calls do not explain are left out."""
    if isinstance(value, dict) and value:
        members = {name: _built(member, templates, (*place, name)) for name, member in value.items()}
        return {name: member for name, member in members.items() if member is not None}
    if isinstance(value, list) and value:
        return [_built(member, templates, (*place, index)) for index, member in enumerate(value)]
    return templates.get(place)
