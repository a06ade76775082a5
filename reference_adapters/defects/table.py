"""All defective adapters by id."""

from __future__ import annotations

from . import (
    any_protocol,
    areas,
    bacnet,
    claims,
    dnp3,
    ethercat,
    ethernetip,
    life,
    modbus,
    mqtt,
    opcua,
    profibus,
    profinet,
    refusals,
    s7,
    sparkplug,
)
from .defect import Defect, number

__all__ = ["DEFECTS", "PROTOCOLS", "REPRESENTATIVE", "SAMPLE"]

_ALL = (
    *modbus.DEFECTS,
    *mqtt.DEFECTS,
    *sparkplug.DEFECTS,
    *opcua.DEFECTS,
    *bacnet.DEFECTS,
    *any_protocol.DEFECTS,
    *claims.DEFECTS,
    *life.DEFECTS,
    *refusals.DEFECTS,
    *areas.DEFECTS,
    *s7.DEFECTS,
    *ethernetip.DEFECTS,
    *dnp3.DEFECTS,
    *profibus.DEFECTS,
    *ethercat.DEFECTS,
    *profinet.DEFECTS,
)

DEFECTS: dict[str, Defect] = {defect.id: defect for defect in sorted(_ALL, key=lambda one: number(one.id))}
"""In the order of the catalogue."""

assert len(DEFECTS) == len(_ALL), "an id is there twice"

PROTOCOLS = frozenset(defect.protocol for defect in _ALL)


_FURTHER = {
    defect.protocol for one in (s7, bacnet, ethernetip, dnp3, profibus, ethercat, profinet) for defect in one.DEFECTS
}
"""Protocols whose adapters need a library that is an extra; their defects stand for a row only where no other does."""

_BY_PREFERENCE = sorted(DEFECTS.values(), key=lambda one: one.protocol in _FURTHER)


def _first_of_their_kind() -> frozenset[str]:
    """Return the ids of the first defects of each protocol in the benchmark, and of each row of the requirement suite and each
    requirement that findings cite."""
    seen: set[object] = set()
    found = []
    for defect in _BY_PREFERENCE:
        kinds: set[object] = {*defect.requirements.split()}
        kinds |= {name.partition(".")[0] for name in defect.items.split()} if defect.areas else {defect.protocol}
        if not kinds <= seen:
            found.append(defect.id)
        seen |= kinds
    return frozenset(found)


REPRESENTATIVE = _first_of_their_kind()
"""Defects that are run with the long tests: for each row and each requirement one at least."""


def _one_for_each_area() -> frozenset[str]:
    """Return the ids of the quick defects, and of the first defect of each area of which none is quick."""
    quick = [defect for defect in DEFECTS.values() if defect.quick]
    seen = {defect.areas for defect in quick}
    found = {defect.id for defect in quick}
    for defect in _BY_PREFERENCE:
        if defect.areas not in seen:
            seen.add(defect.areas)
            found.add(defect.id)
    return frozenset(found)


SAMPLE = _one_for_each_area()
"""What ``otmcp self-check`` runs unless it is asked for more: some defects of the benchmark and one at least of each area."""
