"""The search for named readings: tools that read under names of their own, such as ``read_temperature``.

Everything that such a tool reads is set at random, several times; a value of the answers that follows what one place held is a reading.
"""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from typing import Any

from ..core.strict_json import same_json
from ..protocols.oracle import state_changing
from ..protocols.point import BOOL, Point
from ..protocols.registry import protocols
from ..subject.answers import extract, read_answer
from ..subject.bindings import output_rule
from ..subject.command import is_number
from .evidence import FORMS, numbers_in, places, tells_failure
from .experimenter import Experimenter
from .guess import Guess
from .input_schema import properties, required, resolved
from .matching import reading_tools
from .pack import Pack
from .proposal import Proposal

__all__ = ["Reading", "as_proposals", "look_for_readings", "said_in"]

_TOOLS, _VALUES, _FOUND = 12, 6, 8
"""At most so many tools are tried, so many values of an argument, and so many readings are proposed for one tool."""
_SAMPLES = 7
"""So often all that a tool reads is set at random."""
_USUAL = 3000
"""Whole numbers below it are what sensors have."""
_STATES, _CELLS = 8, 4
"""So many small numbers may each be a state, in at most so many cells that a call reads."""
_ENOUGH = 4
"""Samples that have to agree."""
_STEPS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
"""What answers may be rounded to, in the device's own terms."""
_APART = 20
"""Steps that the values of a line are apart at least."""
_WELL = 0.8
"""Part of half a step within which a line has to be."""
_EXACT = 1e-6
"""What a calculation alone may be off."""

Source = tuple[str, Mapping[str, Any]]
"""An operation that reads one value, with its inputs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """A named reading as a subject file states it.

    Attributes:
        tool: name of the tool.
        arguments: of the tool, fixed but for the one that names the place.
        draws: argument to its values, each with the input of the source that it means; none where no argument names the place.
        source: operation and inputs; the input that an argument names is ``$argument``.
        form: where the answer's document is.
        rule: where the value is in it.
        means: what the value means; None where it is what the device holds.
        step: answers are rounded to so much of what the device holds; 0 where they are not.
        samples: so many answers show it.
        otherwise: a value of the device at which the answer did not follow; None where there was none.
        bounds: the lowest and the highest number that the place can hold, of floating-point ones 0 and 100; None where it holds a truth value.
        good: an answer.
    """

    tool: str
    arguments: Mapping[str, Any]
    draws: Mapping[str, Mapping[str, Any]]
    source: Source
    form: str
    rule: Mapping[str, Any]
    means: object
    step: float
    samples: int
    otherwise: object
    bounds: tuple[int, int] | None
    good: Mapping[str, object]

    @property
    def example(self) -> dict[str, Any]:
        """The arguments of a call."""
        return {name: next(iter(self.draws.get(name, [value]))) for name, value in self.arguments.items()}

    @property
    def tells_numbers(self) -> bool:
        """Whether so many values can be told apart that nobody guesses them."""
        return self.bounds is not None and (self.means is None or isinstance(self.means, str))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sample:
    message: Mapping[str, object]
    held: Mapping[int, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Fit:
    means: object
    otherwise: object
    step: float = 0
    error: float = 0


async def look_for_readings(
    experimenter: Experimenter,
    pack: Pack,
    tools: Mapping[str, Mapping[str, Any]],
    taken: Set[str],
    say: Callable[[str], None],
) -> dict[str, Reading]:
    """Call each tool whose name says that it reads, and that no operation needs, with each value of the argument that may name a place.

    Args:
        taken: names of tools that are not called.
    """
    found: dict[str, Reading] = {}
    if pack.sources is None:
        return found

    def again(one: Reading) -> Callable[[], Awaitable[str | None]]:
        async def proves() -> str | None:
            found = await _at(experimenter, pack, one.tool, one.example)
            return next((reading.source[0] for reading in found if reading.tells_numbers), None)

        return proves

    for tool in reading_tools(pack, tools, taken)[:_TOOLS]:
        readings = await _of_tool(experimenter, pack, tool, resolved(tools[tool], None))
        for place, one in enumerate(readings[:_FOUND], start=1):
            fixed = "" if one.draws else " ".join(map(str, one.arguments.values()))
            name = tool if len(readings) == 1 else f"{tool} {fixed or one.rule.get('path', place)}"
            name = f"{name} {place}" if name in found else name
            found[name] = one
            if one.tells_numbers:
                experimenter.proofs.append(again(one))
            say(f"  {name:<15} (a reading, proven: {one.samples} answers followed what the device held)")
    return found


def as_proposals(readings: Mapping[str, Reading]) -> dict[str, Proposal]:
    """Return the first reading of each operation as a proposal for it, as far as it is a call that the device has to answer."""
    found: dict[str, Proposal] = {}
    for one in readings.values():
        guess = replace(Guess.of_tool(one.tool, ()), operation=one.source[0], arguments=one.example)
        found.setdefault(one.source[0], Proposal(guess=guess, proven=True, evidence=[], form=one.form, good=one.good))
    return found


async def _of_tool(experimenter: Experimenter, pack: Pack, tool: str, schema: Mapping[str, Any]) -> list[Reading]:
    arguments, needed = properties(schema), required(schema)
    listed = {name: [*(arguments.get(name, {}).get("enum") or ())][:_VALUES] for name in needed}
    if not all(listed.values()):
        return []
    first = {name: values[0] for name, values in listed.items()}
    found = await _at(experimenter, pack, tool, first)
    for name in needed if found else ():
        by_value = {listed[name][0]: found}
        for value in listed[name][1:]:
            by_value[value] = await _at(experimenter, pack, tool, {**first, name: value})
        joined = _joined(name, by_value)
        if any(one.draws for one in joined):
            return joined
    return found


def _joined(name: str, by_value: Mapping[Any, Sequence[Reading]]) -> list[Reading]:
    """Return the readings of a tool, those as one that are the same but for an argument and the input of the source which it names."""
    alike: dict[str, dict[Any, Reading]] = {}
    for value, readings in by_value.items():
        for one in readings:
            key = repr((one.source[0], sorted(one.source[1]), one.form, one.rule, one.means))
            alike.setdefault(key, {}).setdefault(value, one)
    return [one for group in alike.values() for one in _as_one(name, group)]


def _as_one(name: str, group: Mapping[Any, Reading]) -> list[Reading]:
    several = [*group.values()]
    operation, inputs = several[0].source
    moved = [key for key in inputs if any(other.source[1][key] != inputs[key] for other in several)]
    draws = {value: one.source[1][moved[0]] for value, one in group.items()} if len(moved) == 1 else {}
    if len({*draws.values()}) < len(several) or not all(isinstance(value, str) for value in draws):
        return several
    return [
        replace(
            several[0],
            arguments={**several[0].arguments, name: f"${name}"},
            draws={name: draws},
            source=(operation, {**inputs, moved[0]: f"${name}"}),
            step=max(one.step for one in several),
            samples=sum(one.samples for one in several),
            otherwise=next((one.otherwise for one in several if one.otherwise is not None), None),
        )
    ]


async def _at(experimenter: Experimenter, pack: Pack, tool: str, arguments: Mapping[str, Any]) -> list[Reading]:
    """Return what a tool reads with these arguments."""
    sources = await _asked_for(experimenter, pack, tool, arguments)
    known = protocols()[pack.protocol].places
    points = [(source, place) for source in sources if (place := known[source[0]](source[1])) is not None]
    found = await _following(experimenter, tool, arguments, points) if points else []
    for group in _alike_and_apart(points):
        # Registers at random are no floating-point numbers that anybody measures.
        further = await _following(experimenter, tool, arguments, group)
        found += [one for one in further if not any(one.rule == other.rule for other in found)]
    seen = {str(one.source) for one in found}
    cells = [(source, point) for source, point in _apart(points) if point.kind.is_whole and str(source) not in seen]
    for source, point in cells if len(cells) <= _CELLS else ():
        found += await _by_number(experimenter, tool, arguments, source, point)
    return found


async def _following(
    experimenter: Experimenter, tool: str, arguments: Mapping[str, Any], points: Sequence[tuple[Source, Point]]
) -> list[Reading]:
    """Return the values of the answers that follow what one of these places holds, all of which are set at random."""
    samples: list[_Sample] = []
    for turn in range(_SAMPLES):
        for _, point in _apart(points):
            for poke in point.pokes(_any(experimenter, point, turn)):
                await experimenter.device.poke(**poke)
        image = await experimenter.device.image()
        shown = await experimenter.read(Guess.of_tool(tool, arguments), arguments)
        if state_changing(shown.entries):
            return []
        if shown.message is None or tells_failure(shown.message):
            continue
        held = {place: point.found(image) for place, (_, point) in enumerate(points) if point.found is not None}
        samples.append(_Sample(message=shown.message, held=held))
    if len(samples) < _ENOUGH:
        return []
    found: list[Reading] = []
    for form, rule, said in said_in([sample.message for sample in samples]):
        tried = ((source, _fit(point, place, samples, said)) for place, (source, point) in enumerate(points))
        fits = [(source, fit) for source, fit in tried if fit is not None]
        if not fits:
            continue
        source, fit = min(fits, key=lambda one: (one[1].otherwise is not None, one[1].step, one[1].error > _EXACT))
        if not any(one.source == source for one in found):
            given: dict[str, Any] = {"form": form, "rule": rule, "samples": len(samples), "good": samples[0].message}
            point = next(point for known, point in points if known == source)
            found.append(
                Reading(
                    tool=tool,
                    arguments=arguments,
                    draws={},
                    source=source,
                    bounds=_bounds(point),
                    **_of(fit),
                    **given,
                )
            )
    return found


async def _by_number(
    experimenter: Experimenter, tool: str, arguments: Mapping[str, Any], source: Source, point: Point
) -> list[Reading]:
    """Return the word of the answers that is another one for small numbers that a place holds, each of which may be a state."""
    messages: dict[int, Mapping[str, object]] = {}
    for number in range(_STATES):
        for poke in point.pokes(number):
            await experimenter.device.poke(**poke)
        shown = await experimenter.read(Guess.of_tool(tool, arguments), arguments)
        if state_changing(shown.entries):
            return []
        if shown.message is not None and not tells_failure(shown.message):
            messages[number] = shown.message
    for form, rule, said in said_in([*messages.values()]) if messages else ():
        words = {
            word: number
            for number, word in zip(messages, said, strict=True)
            if isinstance(word, str) and said.count(word) == 1
        }
        if len(words) > 1 and not any(any(map(str.isdigit, word)) for word in words):
            given: dict[str, Any] = {
                "form": form,
                "rule": rule,
                "samples": len(words),
                "good": next(iter(messages.values())),
            }
            return [
                Reading(
                    tool=tool,
                    arguments=arguments,
                    draws={},
                    source=source,
                    bounds=_bounds(point),
                    **_of(_Fit(means=words, otherwise=None)),
                    **given,
                )
            ]
    return []


def _bounds(point: Point) -> tuple[int, int] | None:
    kind = point.kind
    return (kind.lowest, kind.highest) if kind.is_whole else None if kind == BOOL else (0, 100)


def _of(fit: _Fit) -> dict[str, Any]:
    return {"means": fit.means, "step": fit.step, "otherwise": fit.otherwise}


async def _asked_for(experimenter: Experimenter, pack: Pack, tool: str, arguments: Mapping[str, Any]) -> list[Source]:
    assert pack.sources is not None
    shown = await experimenter.read(Guess.of_tool(tool, arguments), arguments)
    if shown.message is None or state_changing(shown.entries):
        return []
    every = [source for entry in shown.entries for source in pack.sources(entry)]
    return [source for place, source in enumerate(every) if source not in every[:place]]


def _alike_and_apart(points: Sequence[tuple[Source, Point]]) -> list[list[tuple[Source, Point]]]:
    """Return the places of floating-point numbers in several cells, in groups: of one type and order, and none shares a cell with another."""
    left = [(source, point) for source, point in points if not point.kind.is_whole and len(point.held(1)) > 1]
    groups: list[list[tuple[Source, Point]]] = []
    while left:
        form = _form(left[0][0])
        group = [*_apart(one for one in left if _form(one[0]) == form)]
        groups.append(group)
        left = [one for one in left if one not in group]
    return groups


def _form(source: Source) -> str:
    return repr([(name, value) for name, value in source[1].items() if not isinstance(value, int)])


def _apart(points: Iterable[tuple[Source, Point]]) -> Iterator[tuple[Source, Point]]:
    """Yield the points that do not share a cell of the device with one before them."""
    seen: set[str] = set()
    for source, point in points:
        cells = {*point.held(False if point.kind == BOOL else 1)}
        if seen.isdisjoint(cells):
            seen |= cells
            yield source, point


def _any(experimenter: Experimenter, point: Point, turn: int) -> Any:
    """Return a value for a point: whole numbers as sensors have them, and at last one of the lower and one of the upper half of all."""
    rng, kind = experimenter.random, point.kind
    if kind == BOOL:
        return bool(rng.getrandbits(1))
    if not kind.is_whole:
        return rng.randrange(2, 200) / 2
    middle = (kind.lowest + kind.highest + 1) // 2
    if turn == _SAMPLES - 1:
        return rng.randrange(middle, kind.highest + 1)
    return rng.randrange(kind.lowest, middle) if turn == _SAMPLES - 2 else rng.randrange(1, min(_USUAL, kind.highest))


def said_in(messages: Sequence[Mapping[str, object]]) -> Iterator[tuple[str, Mapping[str, Any], list[Any]]]:
    """Yield each place of the answers that may be a value, with what stands there."""
    for form in FORMS:
        documents = [read_answer(message, form)[0] for message in messages]
        if any(document is None for document in documents):
            continue
        first = documents[0]
        for rule in _rules(first):
            said = [extract({"value": output_rule(rule)}, document)["value"] for document in documents]
            if all(one is None or is_number(one) or isinstance(one, str | bool) for one in said):
                yield form, rule, said
        return


def _rules(document: Any) -> Iterator[Mapping[str, Any]]:
    if isinstance(document, str):
        yield from numbers_in(document)
        return
    for path, value in places(document, ""):
        yield {"path": path}
        if isinstance(value, str):
            yield from ({"path": path, **rule} for rule in numbers_in(value))


def _fit(point: Point, place: int, samples: Sequence[_Sample], said: Sequence[Any]) -> _Fit | None:
    """Return what the values mean, if they follow what a place of the device held."""
    held = [sample.held[place] for sample in samples]
    if point.kind == BOOL:
        return _by_words(held, said)
    pairs = [(one, value) for one, value in zip(held, said, strict=True) if is_number(one) and is_number(value)]
    usual = [(one, value) for one, value in pairs if abs(one) <= _USUAL]
    for fitting in (pairs, usual):
        if (
            len({value for _, value in fitting}) >= _ENOUGH
            and (line := _line(fitting, point.kind.is_whole)) is not None
        ):
            follows = [
                is_number(value) and line.error(one, value) < line.step / 2
                for one, value in zip(held, said, strict=True)
            ]
            return _Fit(
                means=line.text,
                step=line.step if line.step > 1 else 0,
                error=max(line.error(*pair) for pair in fitting),
                otherwise=next((one for one, right in zip(held, follows, strict=True) if not right), None),
            )
    return None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Line:
    """What makes what was held from what was said: a factor, a number to be added, and what the result is rounded to."""

    scale: float
    offset: float
    step: float

    def error(self, held: float, said: float) -> float:
        return abs(self.scale * said + self.offset - held)

    @property
    def text(self) -> str | None:
        if (self.scale, self.offset) == (1, 0):
            return None
        text = "$value" if self.scale == 1 else f"$value * {_plain(self.scale)}"
        return text if not self.offset else f"{text} {'+' if self.offset > 0 else '-'} {_plain(abs(self.offset))}"


def _decimals(number: float) -> int:
    return len(f"{number:.9f}".rstrip("0").partition(".")[2])


def _line(pairs: Sequence[tuple[float, float]], is_whole: bool) -> _Line | None:
    """Return the plainest line that is about as near as the nearest."""
    (low, said_low), (high, said_high) = min(pairs), max(pairs)
    if said_low == said_high or not math.isfinite(high - low):
        return None
    scale = (high - low) / (said_high - said_low)
    # An answer may be half of its last decimal off. Values that are all nearly the same lie on any line.
    rounded = abs(scale) * 10.0 ** -max(_decimals(said) for _, said in pairs)
    least = 2 * rounded if rounded > 1 + _EXACT and is_whole else 0
    for step in (one for one in (_STEPS if is_whole else (0.5,)) if least <= one <= (high - low) / _APART):
        lines = [
            _Line(scale=round(scale, digits), offset=offset, step=step)
            for digits in range(10)
            for offset in (0.0, round(low - scale * said_low, digits))
        ]
        near = {line: max(line.error(*pair) for pair in pairs) for line in lines if line.scale}
        well = _WELL * step / 2
        good = [
            line for line, error in near.items() if error < well and error <= max(1.1 * min(near.values()), 0.8 * well)
        ]
        if good:
            return good[0]
    return None


def _by_words(held: Sequence[bool], said: Sequence[Any]) -> _Fit | None:
    words: dict[bool, Any] = {}
    for one, value in zip(held, said, strict=True):
        if value is None or not same_json(words.setdefault(one, value), value):
            return None
    if len(words) < 2 or same_json(words[True], words[False]):
        return None
    plain = words[True] is True and words[False] is False
    shown = {str(words[one]).lower() if isinstance(words[one], bool) else str(words[one]): one for one in (True, False)}
    return _Fit(means=None if plain else shown, otherwise=None)


def _plain(number: float) -> str:
    return f"{number:.9f}".rstrip("0").rstrip(".")
