"""A named command or a named reading: a tool with a vocabulary of its own, and what it asks of the device as the subject file states it.
Pure.

A command's effect is one operation of the protocol that writes, a reading's source one that reads, with the values that the tool's
arguments stand for. It is read in both directions: from arguments to what the device gets, and from what is asked of the device to the
arguments that ask for it.
"""

from __future__ import annotations

import itertools
import json
import math
import random
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from ..core.strict_json import same_json
from ..protocols.exercise import READING, THEN

__all__ = [
    "LARGEST",
    "SAYS",
    "Command",
    "Draw",
    "Effect",
    "computed",
    "is_computation",
    "is_computed",
    "is_number",
    "names_in",
    "nearest_on",
    "pattern",
]

_NUMBER = r"\d{1,15}(?:\.\d{1,9})?"
_WHOLE = re.compile(rf"\$(?P<name>\w+)(?: ?\* ?(?P<scale>-?{_NUMBER}))?(?: ?(?P<sign>[+-]) ?(?P<offset>{_NUMBER}))?")
"""A text that is one argument's value, or a number made from it, such as ``$percent * 10 + 5``."""
_WITHIN = re.compile(r"\$([A-Za-z_]\w*)")
"""An argument's value in the middle of a text."""
_SMALLEST = 1e-9
_DIGITS = 9
"""Decimal places of a number that is drawn or scaled: 0.1 * 3 is 0.3."""
_MOST_EXAMPLES = 64
_NEAR = 20
"""Steps from zero that are near to it."""
SAYS = "says."
"""Beginning of the names of outputs that a command's answer has in the words of its arguments, so that none is an output of its operation."""
LARGEST = 2.0**53
"""Whole numbers beyond it are not the same number to every reader of JSON (RFC 8259, section 6)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Draw:
    """The values that the kit may give an argument, or that a device may hold.

    Attributes:
        values: each of them; empty for a range.
        means: the device's value for each of ``values``, in their order; empty where a value is the device's own.
        lowest, highest, step: of a range.
    """

    values: tuple[Any, ...] = ()
    means: tuple[Any, ...] = ()
    lowest: float = 0
    highest: float = 0
    step: float = 1

    @property
    def is_possible(self) -> bool:
        """Whether there is such a list, or such a range."""
        if self.values:
            return len(self.means) in (0, len(self.values))
        return self.step >= _SMALLEST and -LARGEST <= self.lowest <= self.highest <= LARGEST

    @property
    def count(self) -> int:
        """The number of values."""
        return len(self.values) or int((self.highest - self.lowest) / self.step + 1e-9) + 1

    def value(self, index: int) -> Any:
        """Return the value with this number, from 0."""
        return self.values[index] if self.values else _plain(self.lowest + index * self.step)

    def meaning(self, index: int) -> Any:
        """Return what the value with this number is at the device."""
        return self.means[index] if self.means else self.value(index)

    def ends(self) -> list[int]:
        """Return the numbers of all values of a list, and of the first two and the last of a range."""
        return [*range(self.count)] if self.values else sorted({0, min(1, self.count - 1), self.count - 1})

    def nearest(self, number: float) -> list[int]:
        """Return the numbers of the values that may mean this number at the device."""
        if self.values:
            return [*range(self.count)]
        place = (number - self.lowest) / self.step
        index = round(place) if math.isfinite(place) else -1
        return [index] if 0 <= index < self.count else []


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """A further request of a command; its members are as those of :class:`Command`."""

    operation: str
    effect: Mapping[str, Any]
    documents: tuple[str, ...] = field(default=())


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """What a tool asks of the device.

    Attributes:
        name: in the subject file.
        draws: argument to the values that it may be given.
        effect: template of the operation's inputs: ``$name`` is what an argument means at the device, also within a text, and with a
            factor and a number to be added.
        documents: inputs of the operation that are texts, and that the file states as a JSON document.
        then: what the device gets after that, in this order.
        holds: of a named reading, whose effect is its source: what the device may hold there; None for a command.
    """

    name: str
    draws: Mapping[str, Draw]
    effect: Mapping[str, Any]
    documents: tuple[str, ...] = field(default=())
    then: tuple[Effect, ...] = field(default=())
    holds: Draw | None = None

    @property
    def table(self) -> str:
        """The table of an adapter in the subject file that has it."""
        return "commands" if self.holds is None else "readings"

    @property
    def names(self) -> set[str]:
        """The arguments that the effect refers to."""
        return names_in(self.effect)

    @property
    def count(self) -> int:
        """The number of calls that differ in their arguments."""
        return math.prod(draw.count for draw in self.draws.values())

    def drawn(self, rng: random.Random) -> dict[str, Any]:
        """Return the operation's inputs for arguments that are drawn at random."""
        return self._inputs({name: rng.randrange(draw.count) for name, draw in self.draws.items()})

    def held(self, rng: random.Random) -> Any:
        """Return a value that the device may hold where a reading looks, drawn at random."""
        assert self.holds is not None
        return self.holds.value(rng.randrange(self.holds.count))

    def held_anywhere(self, rng: random.Random) -> Any:
        """Return such a value that may also be near zero, or of any magnitude: of those that are drawn at random nearly all are large."""
        assert self.holds is not None
        holds, way = self.holds, rng.randrange(3)
        zero = -1 if holds.values else round(-holds.lowest / holds.step)
        if not way or not 0 <= zero < holds.count or holds.count <= _NEAR:
            return self.held(rng)
        distance = rng.randrange(_NEAR) if way == 1 else int(holds.count ** rng.random())
        sides = [index for index in (zero - distance, zero + distance) if 0 <= index < holds.count]
        return holds.value(rng.choice(sides)) if sides else self.held(rng)

    @property
    def values_held(self) -> int:
        """The number of values that the device may hold where a reading looks."""
        assert self.holds is not None
        return self.holds.count

    def held_at_most(self) -> tuple[Any, Any]:
        """Return the first and the last value that the device may hold where a reading looks."""
        assert self.holds is not None
        return self.holds.value(0), self.holds.value(self.holds.count - 1)

    def words(self) -> list[str]:
        """Return the arguments that take a few words."""
        return [
            name
            for name, draw in self.draws.items()
            if draw.values and all(isinstance(one, str) for one in draw.values)
        ]

    def examples(self) -> list[dict[str, Any]]:
        """Return the operation's inputs for every value of a list, and for the first two and the last of a range, each with the first values
        of the other arguments."""
        return [self._inputs(indices) for indices in self._examples()]

    def _examples(self) -> Iterator[dict[str, int]]:
        first = dict.fromkeys(self.draws, 0)
        others = ({**first, name: index} for name, draw in self.draws.items() for index in draw.ends() if index)
        return itertools.islice(itertools.chain((first,), others), _MOST_EXAMPLES)

    def inputs_of(self, argument: str, operation: str) -> list[tuple[str, str]]:
        """Return the inputs that an argument has a part in, each behind its operation; that of the command's first effect is given."""
        effects = ((operation, self.effect), *((one.operation, one.effect) for one in self.then))
        return [
            (performed, name)
            for performed, effect in effects
            for name, template in effect.items()
            if argument in names_in(template)
        ]

    @property
    def is_ambiguous(self) -> bool:
        """Whether the arguments cannot be told from their effect."""
        return any(
            not same_json(self.arguments(self._inputs(indices)), self._values(indices)) for indices in self._examples()
        )

    def _values(self, indices: Mapping[str, int]) -> dict[str, Any]:
        return {name: draw.value(indices[name]) for name, draw in self.draws.items()}

    def arguments(self, inputs: Mapping[str, object]) -> dict[str, Any] | None:
        """Return the values of the tool's arguments that ask for these inputs of the operation; None where none do."""
        if inputs.get(READING) != (None if self.holds is None else self.name):
            return None
        further: Any = inputs.get(THEN, [])
        if [one["operation"] for one in further] != [one.operation for one in self.then]:
            return None
        found: dict[str, int] = {}
        asked = [
            {name: value for name, value in inputs.items() if name not in (THEN, READING)},
            *(one["inputs"] for one in further),
        ]
        parts: list[Command | Effect] = [self, *self.then]
        for stated, wanted in zip(parts, asked, strict=True):
            if wanted.keys() != stated.effect.keys():
                return None
            for name, template in stated.effect.items():
                value = _document(wanted[name]) if name in stated.documents else wanted[name]
                if not self._match(template, value, found):
                    return None
        return self._values(found) if found.keys() >= self.draws.keys() else None

    def asked_for(self, inputs: Mapping[str, object]) -> dict[str, Any]:
        """Return what an answer may say: the inputs of the command's first effect, and the values of its arguments, which come first."""
        return {**inputs, **(self.arguments(inputs) or {})}

    def effect_of(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """Return the operation's inputs for these values of the arguments.

        Raises:
            LookupError: with the name of an argument whose value is none of those that are drawn.
        """
        indices = {}
        for name, draw in self.draws.items():
            value = arguments[name]
            near = draw.nearest(value if is_number(value) and abs(value) < LARGEST else math.inf)
            index = next((index for index in near if same_json(draw.value(index), value)), None)
            if index is None:
                raise LookupError(name)
            indices[name] = index
        return self._inputs(indices)

    @classmethod
    def of_record(cls, stored: Mapping[str, Any]) -> Command:
        """Return the command that a run record has.

        Raises:
            ValueError: no subject file has such a range.
        """
        draws = {name: Draw(**draw) for name, draw in stored["draws"].items()}
        if not all(draw.is_possible for draw in draws.values()):
            raise ValueError("a command draws from a range that there is not")
        then = tuple(Effect(**effect) for effect in stored.get(THEN, ()))
        holds = Draw(**stored["holds"]) if "holds" in stored else None
        if holds is not None and not holds.is_possible:
            raise ValueError("a reading is of values that there are not")
        return cls(**{**stored, "draws": draws, "then": then, "holds": holds})

    def _inputs(self, indices: Mapping[str, int]) -> dict[str, Any]:
        then = [{"operation": one.operation, "inputs": self._inputs_of(one, indices)} for one in self.then]
        named = {} if self.holds is None else {READING: self.name}
        return self._inputs_of(self, indices) | ({THEN: then} if then else {}) | named

    def _inputs_of(self, stated: Command | Effect, indices: Mapping[str, int]) -> dict[str, Any]:
        filled = {name: self._filled(template, indices) for name, template in stated.effect.items()}
        return {name: json.dumps(value) if name in stated.documents else value for name, value in filled.items()}

    def _filled(self, template: Any, indices: Mapping[str, int]) -> Any:
        if isinstance(template, Mapping):
            return {name: self._filled(member, indices) for name, member in template.items()}
        if isinstance(template, list | tuple):
            return [self._filled(member, indices) for member in template]
        if not isinstance(template, str):
            return template
        meanings = {name: draw.meaning(indices[name]) for name, draw in self.draws.items()}
        whole = _WHOLE.fullmatch(template)
        if whole is not None:
            return _computed(whole, meanings[whole["name"]])
        return _WITHIN.sub(lambda found: _text(meanings[found[1]]), template)

    def _match(self, template: Any, value: Any, found: dict[str, int]) -> bool:
        """Note the numbers of the values that make the template this value; return whether there are such."""
        if isinstance(template, Mapping):
            return (
                isinstance(value, Mapping)
                and template.keys() == value.keys()
                and all(self._match(member, value[name], found) for name, member in template.items())
            )
        if isinstance(template, list | tuple):
            return (
                isinstance(value, list | tuple)
                and len(template) == len(value)
                and all(self._match(one, other, found) for one, other in zip(template, value, strict=True))
            )
        if not isinstance(template, str) or not names_in(template):
            return same_json(template, value)
        whole = _WHOLE.fullmatch(template)
        if whole is not None:
            return self._take(whole["name"], _candidates(whole, self.draws[whole["name"]], value), found)
        return isinstance(value, str) and self._match_text(template, value, found)

    def _match_text(self, template: str, text: str, found: dict[str, int]) -> bool:
        parts = _WITHIN.split(template)
        expression = "".join("(.+?)" if index % 2 else re.escape(part) for index, part in enumerate(parts))
        match = re.fullmatch(expression, text, re.DOTALL)
        return match is not None and all(
            self._take(name, _said(self.draws[name], said), found)
            for name, said in zip(parts[1::2], match.groups(), strict=True)
        )

    def _take(self, name: str, candidates: Iterable[int], found: dict[str, int]) -> bool:
        index = next(iter(candidates), None)
        if index is None:
            return False
        return found.setdefault(name, index) == index


def names_in(template: object) -> set[str]:
    """Return the names of the arguments that an effect refers to."""
    if isinstance(template, str):
        return set(_WITHIN.findall(template))
    if isinstance(template, Mapping):
        return set().union(*map(names_in, template.values()))
    return set().union(*map(names_in, template)) if isinstance(template, list | tuple) else set()


def pattern(text: str, wildcard: str) -> str:
    """Return a text of an effect with a wildcard in the place of each level, between slashes, that an argument has a part in."""
    return "/".join(wildcard if _WITHIN.search(level) else level for level in text.split("/"))


def is_computed(template: object, name: str) -> bool:
    """Tell whether an effect makes a number from this argument, anywhere."""
    if isinstance(template, Mapping | list | tuple):
        members = template.values() if isinstance(template, Mapping) else template
        return any(is_computed(member, name) for member in members)
    whole = _WHOLE.fullmatch(template) if isinstance(template, str) else None
    return whole is not None and whole["name"] == name and (whole["scale"] or whole["sign"]) is not None


def is_computation(text: str) -> bool:
    """Tell whether a text makes a number from ``$value``, such as ``$value * 10 + 5``."""
    whole = _WHOLE.fullmatch(text)
    return whole is not None and whole["name"] == "value"


def computed(text: str, value: float) -> Any:
    """Return the number that such a text makes from a value."""
    whole = _WHOLE.fullmatch(text)
    assert whole is not None, text
    return _computed(whole, value)


def nearest_on(grid: tuple[float, float], number: float) -> Any:
    """Return the number nearest to this one among those that lie any number of steps from the first of a grid.

    Args:
        grid: its first number, and the width of a step.
    """
    first, step = grid
    return _plain(first + round((number - first) / step) * step)


def is_number(value: object) -> bool:
    """Tell whether a value is a number in JSON."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def _factors(whole: re.Match[str]) -> tuple[float, float]:
    offset = float(whole["offset"] or 0)
    return float(whole["scale"] or 1), -offset if whole["sign"] == "-" else offset


def _computed(whole: re.Match[str], meaning: Any) -> Any:
    if whole["scale"] is None and whole["sign"] is None:
        return meaning
    scale, offset = _factors(whole)
    return _plain(meaning * scale + offset)


def _candidates(whole: re.Match[str], draw: Draw, value: Any) -> Iterator[int]:
    scale, offset = _factors(whole)
    # Beyond what a floating-point number holds nothing is drawn.
    asked = (value - offset) / scale if scale and is_number(value) and abs(value) < LARGEST else math.inf
    return (index for index in draw.nearest(asked) if same_json(_computed(whole, draw.meaning(index)), value))


def _said(draw: Draw, said: str) -> Iterator[int]:
    try:
        number = float(said)
    except ValueError:
        number = 0.0
    return (index for index in draw.nearest(number) if _text(draw.meaning(index)) == said)


def _plain(number: float) -> float:
    """Return a number without the last digits that only its calculation has made; a whole one as such."""
    rounded = round(number, _DIGITS)
    return int(rounded) if rounded == int(rounded) else rounded


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def _document(text: object) -> Any:
    try:
        return json.loads(text) if isinstance(text, str) else None
    except ValueError:
        return None
