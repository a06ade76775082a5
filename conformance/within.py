"""What checks ask of any adapter, no more than the schemas of its own tools allow. Pure.

An exercise makes calls within the bounds of a protocol. Where the schema of a tool has narrower ones, another random call is made
that keeps them, and what cannot keep them is not asked for.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, TypeVar

from pytest_otmcp.protocols.exercise import THEN, Asked, Contended, DeviceText, Exercise
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.trial.named_readings import asked_of
from pytest_otmcp.trial.rig import Command, Rig

__all__ = ["allowed", "commanding", "exercise"]

T = TypeVar("T")

_DRAWS = 5000
"""Calls that are made at random to find one within the bounds: of 65536 values a hundred may be allowed."""
_DRAWS_OF_MANY = 500

_MANY = 100
"""Values that a reading has to tell apart, where there is one, to stand for reads in general."""
_WAITS_S = 1
"""Seconds that a call may wait for a message, which comes a tenth of a second after it has subscribed."""


def allowed(at: Rig, asked: Asked) -> bool:
    """Tell whether the schema of the tool allows a call, and a named command can express it where the adapter has nothing else for it."""
    return at.expresses(asked.operation, asked.inputs) and at.excess(asked.operation, **asked.inputs) is None


def exercise(at: Rig) -> Exercise:
    """Return what checks for every protocol do on this one: as far as the schemas of the adapter's tools allow it, by its named commands
    and readings where it has some, and by a call that waits or a status where it has no other read."""
    found = protocols()[at.protocol].exercise
    assert found is not None, f"{at.protocol} has no exercise, so it has no such checks"
    return _narrowed(at, _by_command(at, _otherwise(at, _answered(at, _by_reading(at, _waiting_for_texts(at, found))))))


def _waiting_s(at: Rig) -> int:
    return math.ceil(_WAITS_S * max(1.0, at.time_scale))


def _waiting_for_texts(at: Rig, exercise: Exercise) -> Exercise:
    """Return the exercise with the texts that calls wait for, in the place of those that calls of these operations would have."""
    texts, waiting = exercise.device_texts, exercise.waiting
    if texts is None:
        return exercise
    waited_for = waiting.device_texts if waiting is not None and at.subject.blocks(waiting.operation) else None

    def device_texts(name: str) -> tuple[DeviceText, ...]:
        prompt = (place for place in texts(name) if not at.subject.blocks(place.ask("").operation))
        return (*(waited_for(name, _waiting_s(at)) if waited_for else ()), *prompt)

    return replace(exercise, device_texts=device_texts)


def _answered(at: Rig, exercise: Exercise) -> Exercise:
    """Return the exercise with a call that waits, or else a status, in the place of the read, for an adapter that has no read."""
    if at.subject.claims(exercise.reading):
        return exercise
    waiting = exercise.waiting
    if waiting is not None and at.subject.blocks(waiting.operation):
        return replace(exercise, reading=waiting.operation, read=lambda rng: waiting.read(rng, _waiting_s(at)))
    calls = (call for call in at.proof.unreachable if at.subject.claims(call.operation))
    asked = next((call for call in calls if at.can_ask(call.operation, call.made(random.Random(0)))), None)
    if asked is None:
        return exercise
    return replace(
        exercise,
        reading=asked.operation,
        read=lambda rng: Asked(operation=asked.operation, inputs=asked.made(rng)),
    )


def _otherwise(at: Rig, exercise: Exercise) -> Exercise:
    """Return the exercise with the write that takes the place of its own, for an adapter that has no operation for that."""
    others = () if at.subject.claims(exercise.writing) else exercise.otherwise
    instead = next((one for one in others if at.subject.claims(one.operation)), None)
    if instead is None:
        return exercise
    return replace(
        exercise,
        writing=instead.operation,
        write=lambda rng: _taken(at, instead.write(rng)),
        number=None,
        bounded=(),
        outside=instead.outside,
    )


def _taken(at: Rig, asked: Asked) -> Asked:
    """Return a call without the inputs that only some tools take, and that of the adapter does not."""
    voluntary = protocols()[at.protocol].operations[asked.operation].voluntary_inputs
    left_out = [
        name for name in voluntary if name in asked.inputs and not at.subject.accepts_input(asked.operation, name)
    ]
    return replace(asked, inputs={name: value for name, value in asked.inputs.items() if name not in left_out})


def _by_command(at: Rig, exercise: Exercise) -> Exercise:
    """Return the exercise with writes by the named commands of the adapter; where it writes by nothing else, by them alone."""
    commands = at.commands()
    if not commands:
        return exercise

    def drawn(operation: str, command: Command, rng: random.Random) -> Asked:
        return commanding(at, exercise, operation, command.drawn(rng))

    def commanded(rng: random.Random) -> tuple[Asked, ...]:
        return tuple(drawn(*one, rng) for one in commands)

    every = exercise.every_write
    # What is asked of any write is asked of one request.
    single = [one for one in commands if not one[1].then]
    found = replace(
        exercise,
        commanded=commanded,
        every_write=every and (lambda rng: (*every(rng), *(drawn(*one, rng) for one in single))),
    )
    if not single or (at.subject.claims(exercise.writing) and not at.by_command_alone(exercise.writing)):
        return found
    # Of many values no two are likely to be the same.
    most = max(single, key=lambda one: one[1].count)
    return replace(
        found,
        writing=most[0],
        write=lambda rng: drawn(*most, rng),
        number=None,
        writes=exercise.changing or exercise.writes,
    )


def _by_reading(at: Rig, exercise: Exercise) -> Exercise:
    """Return the exercise with reads by the named readings of the adapter; where it reads by nothing else, by them alone."""
    readings = at.readings()
    if not readings:
        return exercise
    every = exercise.every_read
    found = replace(exercise, every_read=lambda rng: (*(every(rng) if every else ()), *_each_reading(at, rng)))
    if at.subject.claims(exercise.reading) and not at.by_command_alone(exercise.reading):
        return found
    # Of many values no two are likely to be the same.
    telling = [one for one in readings if one[1].values_held >= _MANY] or readings
    shown = [asked_of(at.protocol, name, one.examples()[0], one.held(random.Random(0))) for name, one in telling]
    conditions = [one.condition for one in shown if one.operation != exercise.reading]

    def read(rng: random.Random) -> Asked:
        operation, one = rng.choice(telling)
        return asked_of(at.protocol, operation, one.drawn(rng), one.held(rng))

    return replace(
        found,
        reading=telling[0][0],
        read=read,
        reads=(
            *(exercise.reads if len(conditions) < len(shown) else ()),
            *(rule for place, rule in enumerate(conditions) if rule not in conditions[:place]),
        ),
    )


def _each_reading(at: Rig, rng: random.Random) -> tuple[Asked, ...]:
    return tuple(asked_of(at.protocol, operation, one.drawn(rng), one.held(rng)) for operation, one in at.readings())


def commanding(at: Rig, exercise: Exercise, operation: str, inputs: Mapping[str, Any]) -> Asked:
    """Return the call of a named command that has these inputs of an operation as its effect, and what comes after that."""
    known = protocols()[at.protocol].operations[operation]
    further = (*known.optional, *known.voluntary_inputs)
    then = tuple(commanding(at, exercise, one["operation"], one["inputs"]) for one in inputs.get(THEN, ()))
    points = [exercise.points_of(operation, inputs), *(one.points for one in then)]
    return Asked(
        operation=operation,
        inputs=inputs,
        points={name: value for one in points for name, value in one.items()} if all(points) else {},
        sent={name: inputs[name] for name in further if name in inputs},
        then=then,
    )


def _narrowed(at: Rig, exercise: Exercise) -> Exercise:
    tells = exercise.tells
    return replace(
        exercise,
        read=_one(exercise.read, lambda asked: allowed(at, asked)),
        write=_one(exercise.write, lambda asked: allowed(at, asked)),
        contended=exercise.contended and _one(exercise.contended, lambda one: _all_allowed(at, one)),
        every_read=exercise.every_read and _each(at, exercise.every_read),
        every_write=exercise.every_write and _each(at, exercise.every_write),
        tells=tells and _each(at, lambda rng: tuple(_taken(at, asked) for asked in tells(rng))),
        commanded=exercise.commanded and _each(at, exercise.commanded),
        fenced=exercise.fenced and _each(at, exercise.fenced),
        large=exercise.large and _chosen(at, exercise.large, lambda asked: asked),
        floats={kind: read for kind, read in exercise.floats.items() if allowed(at, read(1.5))},
        bounds=exercise.bounds and _chosen(at, exercise.bounds, lambda pair: pair[0]),
    )


def _one(make: Callable[..., T], fits: Callable[[T], bool]) -> Callable[..., T]:
    def made(*given: Any) -> T:
        first = last = make(*given)
        for _ in range(_DRAWS):
            if fits(last):
                return last
            last = make(*given)
        return first

    return made


def _all_allowed(at: Rig, contended: Contended) -> bool:
    calls = [contended.read, *contended.writes, *([] if contended.first is None else [contended.first])]
    return all(allowed(at, asked) for asked in calls)


def _each(at: Rig, make: Callable[..., tuple[Asked, ...]]) -> Callable[..., tuple[Asked, ...]]:
    """Return a maker that makes each of its calls anew until it is within the bounds, and leaves out what never is."""

    def made(*given: Any) -> tuple[Asked, ...]:
        drawn = make(*given)
        found = {place: asked for place, asked in enumerate(drawn) if allowed(at, asked)}
        for _ in range(_DRAWS_OF_MANY):
            if len(found) == len(drawn):
                break
            again = make(*given)
            found |= {
                place: again[place] for place in range(len(drawn)) if place not in found and allowed(at, again[place])
            }
        return tuple(found[place] for place in sorted(found))

    return made


def _chosen(at: Rig, make: Callable[..., tuple[T, ...]], call: Callable[[T], Asked]) -> Callable[..., tuple[T, ...]]:
    return lambda *given: tuple(one for one in make(*given) if allowed(at, call(one)))
