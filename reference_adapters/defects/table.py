"""All defective adapters by id."""

from __future__ import annotations

from . import (
    any_protocol,
    areas,
    bacnet,
    claims,
    dnp3,
    ethernetip,
    life,
    modbus,
    mqtt,
    opcua,
    profibus,
    refusals,
    s7,
    sparkplug,
)
from .mutant import Mutant, number

__all__ = ["MUTANTS", "PROTOCOLS", "REPRESENTATIVE", "SAMPLE"]

_ALL = (
    *modbus.MUTANTS,
    *mqtt.MUTANTS,
    *sparkplug.MUTANTS,
    *opcua.MUTANTS,
    *bacnet.MUTANTS,
    *any_protocol.MUTANTS,
    *claims.MUTANTS,
    *life.MUTANTS,
    *refusals.MUTANTS,
    *areas.MUTANTS,
    *s7.MUTANTS,
    *ethernetip.MUTANTS,
    *dnp3.MUTANTS,
    *profibus.MUTANTS,
)

MUTANTS: dict[str, Mutant] = {mutant.id: mutant for mutant in sorted(_ALL, key=lambda one: number(one.id))}
"""In the order of the catalogue."""

assert len(MUTANTS) == len(_ALL), "an id is there twice"

PROTOCOLS = frozenset(mutant.protocol for mutant in _ALL)


_FURTHER = {
    mutant.protocol for mutant in (*s7.MUTANTS, *bacnet.MUTANTS, *ethernetip.MUTANTS, *dnp3.MUTANTS, *profibus.MUTANTS)
}
"""Protocols whose adapters need a library that is an extra; their defects stand for a row only where no other does."""

_BY_PREFERENCE = sorted(MUTANTS.values(), key=lambda one: one.protocol in _FURTHER)


def _first_of_their_kind() -> frozenset[str]:
    """Return the ids of the first defects of each protocol in the benchmark, and of each row of the requirement suite and each
    requirement that findings cite."""
    seen: set[object] = set()
    found = []
    for mutant in _BY_PREFERENCE:
        kinds: set[object] = {*mutant.requirements.split()}
        kinds |= {name.partition(".")[0] for name in mutant.items.split()} if mutant.areas else {mutant.protocol}
        if not kinds <= seen:
            found.append(mutant.id)
        seen |= kinds
    return frozenset(found)


REPRESENTATIVE = _first_of_their_kind()
"""Defects that are run with the long tests: for each row and each requirement one at least."""


def _one_for_each_area() -> frozenset[str]:
    """Return the ids of the quick defects, and of the first defect of each area of which none is quick."""
    quick = [mutant for mutant in MUTANTS.values() if mutant.quick]
    seen = {mutant.areas for mutant in quick}
    found = {mutant.id for mutant in quick}
    for mutant in _BY_PREFERENCE:
        if mutant.areas not in seen:
            seen.add(mutant.areas)
            found.add(mutant.id)
    return frozenset(found)


SAMPLE = _one_for_each_area()
"""What ``otmcp self-check`` runs unless it is asked for more: some defects of the benchmark and one at least of each area."""
