"""What checks ask of any adapter, no more than the schemas of its own tools allow. Pure.

An exercise makes calls within the bounds of a protocol. Where the schema of a tool has narrower ones, another random call is made
that keeps them, and what cannot keep them is not asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

from pytest_otmcp.protocols.exercise import Asked, Contended, Exercise
from pytest_otmcp.trial.rig import Rig

__all__ = ["allowed", "within"]

T = TypeVar("T")

_DRAWS = 5000
"""Calls that are made at random to find one within the bounds: of 65536 values a hundred may be allowed."""
_DRAWS_OF_MANY = 500


def allowed(at: Rig, asked: Asked) -> bool:
    """Tell whether the schema of the tool allows a call."""
    return at.excess(asked.operation, **asked.inputs) is None


def within(at: Rig, exercise: Exercise) -> Exercise:
    """Return the exercise as far as the schemas of the adapter's tools allow it."""
    return replace(
        exercise,
        read=_one(exercise.read, lambda asked: allowed(at, asked)),
        write=_one(exercise.write, lambda asked: allowed(at, asked)),
        contended=exercise.contended and _one(exercise.contended, lambda one: _all_allowed(at, one)),
        every_read=exercise.every_read and _each(at, exercise.every_read),
        every_write=exercise.every_write and _each(at, exercise.every_write),
        tells=exercise.tells and _each(at, exercise.tells),
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
