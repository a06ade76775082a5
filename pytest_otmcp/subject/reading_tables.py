"""Named readings, made from the ``readings`` tables of a subject file; ``grammar`` has checked their shape."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from ..protocols.point import BOOL, TEXT, Kind
from ..protocols.protocol import OtProtocol
from .bindings import output_rule, read_answering
from .command import Command, Draw, is_number
from .command_tables import Operations, check_names, read_draw, read_draws
from .kinds import Refusal
from .model import Answering, Binding, Function, placeholders
from .placeholder_check import check_placeholders

__all__ = ["with_readings"]

_FLOATS = Draw(lowest=0, highest=100, step=0.5)
"""What a place for floating-point numbers holds where the file says nothing else; each is exact in 32 bits."""
_TEXTS = Draw(values=("otmcp-one", "otmcp-two", "otmcp-three"))


def with_readings(
    operations: Operations, tables: Mapping[str, Any], key: str, answering: Answering, protocol: OtProtocol
) -> Operations:
    """Return the operations with the named readings that perform them. A request names its reading, so that no other request is one.

    Args:
        operations: what ``bind`` tables, a bindings file and named commands say.
        tables: name to table.
        key: of these tables.

    Raises:
        Refusal: a table contradicts itself, or the mock device has no such place.
    """
    found = dict(operations)
    for name, table in tables.items():
        operation, binding = _reading(name, table, f"{key}.{name}", answering, protocol)
        bound = found.get(operation, ())
        if isinstance(bound, Function):
            raise Refusal(
                f"{key}.{name}.source.{operation}", "the bindings file has a function for this operation as well"
            )
        found[operation] = (binding, *bound)
    return found


def _reading(
    name: str, table: Mapping[str, Any], key: str, answering: Answering, protocol: OtProtocol
) -> tuple[str, Binding]:
    ((operation, source),) = table["source"].items()
    within, arguments, draws = f"{key}.source.{operation}", table["arguments"], read_draws(table, key)
    check_names(draws, placeholders(arguments), f"{key}.arguments", "is given to no argument of the tool")
    check_placeholders(arguments, f"{key}.arguments", tuple(draws))
    reading = Command(name=name, draws=draws, effect=source, holds=_FLOATS)
    check_names(draws, reading.names, within, "has no part in it, so that nothing says what is read")
    if reading.is_ambiguous:
        raise Refusal(
            within,
            "two values of an argument read the same place, so that the kit could not tell which of them to give",
        )
    places = [protocol.places[operation](inputs) for inputs in reading.examples()]
    point = next((place for place in places if place is not None), None)
    if point is None or None in places:
        raise Refusal(
            within,
            "the mock device has no such place, or it holds more than one value; docs/mock-devices.md lists its places",
        )
    holds = _holds(table, key, point.kind)
    rule = output_rule(table["value"])
    means = rule.means
    words = means.values() if isinstance(means, Mapping) else ()
    missing = next(([value] for value in _all(holds) if value not in words), []) if words else []
    if missing:
        raise Refusal(
            f"{key}.holds",
            f"{missing[0]!r} is what none of the words in 'value.means' means, so that no answer could say it",
        )
    return operation, Binding(
        tool=table.get("tool", name),
        arguments=arguments,
        outputs={
            point.output: replace(
                rule, wrap=rule.wrap or point.listed, grid=_grid(holds, point.kind) if isinstance(means, str) else None
            )
        },
        answering=read_answering(table, key, answering),
        when={},
        offset={},
        names={},
        convert={},
        command=replace(reading, holds=holds),
    )


def _holds(table: Mapping[str, Any], key: str, kind: Kind) -> Draw:
    if "holds" not in table:
        means = table["value"].get("means") if isinstance(table["value"], dict) else None
        return Draw(values=tuple(dict.fromkeys(means.values()))) if isinstance(means, dict) else _any(kind)
    holds = read_draw(table["holds"], f"{key}.holds")
    if holds.count < 2:
        raise Refusal(f"{key}.holds", "expected two values or more: what is always the same shows no reading")
    for value in (holds.value(index) for index in holds.ends()):
        if not _fits(kind, value):
            raise Refusal(f"{key}.holds", f"{value!r} is no value that the place in 'source' can hold")
    return holds


def _grid(holds: Draw, kind: Kind) -> tuple[float, float] | None:
    if holds.values:
        return (0, 1) if kind.is_whole else None
    return holds.lowest, holds.step


def _any(kind: Kind) -> Draw:
    if kind in (BOOL, TEXT):
        return _TEXTS if kind is TEXT else Draw(values=(False, True))
    # Beyond 48 bits whole numbers are not the same number to every reader of JSON.
    return Draw(lowest=max(kind.lowest, -(2**48)), highest=min(kind.highest, 2**48)) if kind.is_whole else _FLOATS


def _fits(kind: Kind, value: object) -> bool:
    if kind in (BOOL, TEXT):
        return isinstance(value, str if kind is TEXT else bool)
    if not kind.is_whole:
        return is_number(value)
    return isinstance(value, int) and not isinstance(value, bool) and kind.lowest <= value <= kind.highest


def _all(holds: Draw) -> Iterator[Any]:
    return (holds.value(index) for index in range(holds.count))
