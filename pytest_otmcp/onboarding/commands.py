"""The search for named commands: tools with a vocabulary of their own that tell the device one thing with each call."""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import replace
from typing import Any

from ..core.strict_json import same_json
from ..protocols.oracle import state_changing
from ..protocols.registry import protocols
from ..subject.command import Draw
from .effects import Call, Effect, effect_of
from .evidence import tells_failure
from .experimenter import Experimenter, NotProvenError
from .guess import Guess
from .input_schema import kinds, properties, required, resolved
from .matching import commanding_tools, snake, words_in
from .pack import Pack, Told
from .readings import said_in

__all__ = ["look_for_commands"]

_TOOLS, _OPTIONS, _VALUES = 12, 3, 8
"""At most so many tools are tried, so many arguments that a tool does not require, and so many values of an argument."""

_STEP = 0.5
"""From one value to the next, of a number whose schema does not say it."""

_RANGE = re.compile(r"(-?\d+(?:\.\d+)?)\s*(?:-|\u2013|to|\.\.\.?|\u2026)\s*(-?\d+(?:\.\d+)?)")
"""A range in the description of an argument."""

_NOT_INVENTED = frozenset(
    """host hostname url uri address addr ip port endpoint path file filename folder user username password token key secret topic command
    code script sql query""".split()
)
"""Words in the names of arguments that no invented text is given."""


async def look_for_commands(
    experimenter: Experimenter,
    pack: Pack,
    tools: Mapping[str, Mapping[str, Any]],
    taken: Set[str],
    names: Mapping[str, str],
    say: Callable[[str], None],
) -> dict[str, Effect]:
    """Call each tool whose name says that it changes something, and that no operation needs, with several values.

    Args:
        taken: names of tools that are not called.
        names: arguments, in snake case, that name a device which was registered, each with the name.
    """
    found: dict[str, Effect] = {}
    told = pack.told
    if told is None:
        return found
    for name in commanding_tools(pack, tools, taken)[:_TOOLS]:
        try:
            effect = await _effect(experimenter, told, name, tools[name], names)
        except NotProvenError as problem:
            say(f"  {name:<15} (not tried as a command, nothing was written: {problem})")
            return found
        if effect is not None and not any(_alike(effect, other) for other in found.values()):
            found[name] = effect
            say(
                f"  {name:<15} (a command, proven: with each of {effect.calls} calls the device saw one {effect.operation})"
            )
    return found


def _alike(one: Effect, other: Effect) -> bool:
    """Tell whether the kit could not choose between two commands, because they do the same."""
    return one.operation == other.operation and any(
        other.command.arguments(inputs) is not None for inputs in one.command.examples()
    )


async def _effect(
    experimenter: Experimenter, told: Told, name: str, tool: Mapping[str, Any], names: Mapping[str, str]
) -> Effect | None:
    """Return what a tool does with its required arguments, or with one more; None where the device was not told one thing."""
    schema = resolved(tool, None)
    arguments = properties(schema)
    numbers = [argument for argument, one in arguments.items() if kinds(one) & {"integer", "number"}]
    if len(numbers) == 1 and not arguments[numbers[0]].get("description"):
        # What the tool says of a range is about its only number.
        arguments = {**arguments, numbers[0]: {**arguments[numbers[0]], "description": tool.get("description")}}
    known = {
        argument: [names[snake(argument)]]
        if snake(argument) in names
        else [*_values(argument, one), *_anywhere(experimenter.random, one)]
        for argument, one in arguments.items()
    }
    needed = required(schema)
    if any(not known.get(argument) for argument in needed):
        return None
    more = [argument for argument in known if argument not in needed and known[argument]][:_OPTIONS]
    for added in ([], *([argument] for argument in more)):
        values = {argument: known[argument] for argument in (*needed, *added)}
        calls = await _calls(experimenter, told, name, values)
        if calls:
            ranges = {one: bounds for one in values if (bounds := _range(arguments[one])) is not None}
            operations = protocols()[experimenter.adapter.adapter.protocol].operations
            effect = effect_of(name, calls, ranges, operations[calls[0].operation].documents)
            return None if effect is None else _saying(effect, calls)
        if calls is None:
            return None
    return None


def _saying(effect: Effect, calls: Sequence[Call]) -> Effect:
    """Return the command with the places where the answers say the values of its arguments: as they were given, or each by a word of its own."""
    # Beside its data an envelope has meta, which is about the call.
    told = said_in([call.answer for call in calls])
    places = [place for place in told if not str(place[1].get("path", "")).startswith("meta.")]
    says: dict[str, Mapping[str, Any]] = {}
    for name, draw in effect.command.draws.items():
        given = [call.arguments[name] for call in calls]
        for _, rule, said in places:
            if all(map(same_json, given, said)) and not all(same_json(given[0], value) for value in given):
                says[name] = rule
                break
            if draw.values and (words := _words(given, said)) is not None and len(words) == draw.count > 1:
                says[name] = {**rule, "means": words}
                break
    return replace(effect, says=says, form=places[0][0] if places else "")


def _words(given: Sequence[Any], said: Sequence[Any]) -> dict[str, Any] | None:
    """Return the value that each word stands for; None where a word stands for two, or something else than words is said."""
    if not all(isinstance(word, str) for word in said):
        return None
    words = dict(zip(said, given, strict=True))
    return words if all(same_json(words[word], value) for word, value in zip(said, given, strict=True)) else None


async def _calls(
    experimenter: Experimenter, told: Told, name: str, values: Mapping[str, list[Any]]
) -> list[Call] | None:
    """Call a tool twice with the first value of each argument, and once with each other one.

    Returns:
        The calls by which the device was told one thing; none where the first two were refused; None where they told it none, or
        several: then the tool does something else, and is not called again.
    """
    first = {argument: some[0] for argument, some in values.items()}
    others = ({**first, argument: value} for argument, some in values.items() for value in some[1:])
    guess = Guess.of_tool(name, first)
    calls: list[Call] = []
    for arguments in (first, first, *others):
        shown = await experimenter.write(guess, arguments)
        things = [told(entry) for entry in state_changing(shown.entries)]
        refused = shown.message is None or tells_failure(shown.message)
        if refused or len(things) != 1 or things[0] is None:
            if len(calls) < 2:
                return [] if refused and not things else None
            # It takes no such value.
            continue
        operation, inputs = things[0]
        calls.append(Call(arguments=arguments, operation=operation, inputs=inputs, answer=shown.message or {}))
    return calls


def _values(name: str, described: Mapping[str, Any]) -> list[Any]:
    """Return values that an argument may have; none where nobody can know any."""
    stated = described.get("enum") or ([described["const"]] if "const" in described else None)
    if stated:
        return list(stated)[:_VALUES]
    types = kinds(described)
    if "boolean" in types:
        return [True, False]
    if types & {"integer", "number"}:
        bounds = _bounds(described)
        if bounds is None:
            return [1, 2, 10, 100, 300] if "integer" in types else [0.25, 0.5, 1.0, 10.0, 100.0]
        low, high = bounds
        points = (low, low + (high - low) / 4, low + (high - low) / 2, high)
        return list(dict.fromkeys(map(int, points) if "integer" in types else (round(point, 6) for point in points)))
    if "string" in types and not words_in(name) & _NOT_INVENTED:
        examples = described.get("examples")
        return list(examples)[:_VALUES] if isinstance(examples, list) and examples else list(_texts(described))
    return []


def _anywhere(rng: random.Random, described: Mapping[str, Any]) -> list[Any]:
    """Return two more values of a number within its bounds: a tool may do something else between those that everybody tries."""
    if (found := _range(described)) is None or described.get("enum"):
        return []
    draw = Draw(lowest=found[0], highest=found[1], step=found[2])
    return [draw.value(rng.randrange(draw.count)) for _ in range(2)]


def _texts(described: Mapping[str, Any]) -> Iterator[str]:
    default = described.get("default")
    if isinstance(default, str) and default:
        yield default
    yield from ("otmcp-one", "otmcp-two")


def _bounds(described: Mapping[str, Any]) -> tuple[float, float] | None:
    """Return the lowest and the highest value of a number that its schema, or its description, names."""
    alternatives = (described, *(one for one in described.get("anyOf") or [] if isinstance(one, dict)))
    for one in alternatives:
        low, high = one.get("minimum"), one.get("maximum")
        if isinstance(low, int | float) and isinstance(high, int | float) and low < high:
            return low, high
    said = _RANGE.search(str(described.get("description") or ""))
    if said is not None and float(said[1]) < float(said[2]):
        return float(said[1]), float(said[2])
    return None


def _range(described: Mapping[str, Any]) -> tuple[float, float, float] | None:
    """Return the bounds of a number, and the step from one value to the next: the one that the schema states, else one that nearly every
    device can hold."""
    bounds = _bounds(described)
    if bounds is None:
        return None
    if "integer" in kinds(described):
        return int(bounds[0]), int(bounds[1]), 1
    stated = described.get("multipleOf")
    step = stated if isinstance(stated, int | float) and stated > 0 else _STEP
    return bounds[0], bounds[1], step
