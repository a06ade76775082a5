"""All defective adapters by id."""

from __future__ import annotations

from . import any_protocol, areas, claims, life, modbus, mqtt, opcua, refusals, sparkplug
from .mutant import Mutant, number

__all__ = ["MUTANTS"]

_ALL = (
    *modbus.MUTANTS,
    *mqtt.MUTANTS,
    *sparkplug.MUTANTS,
    *opcua.MUTANTS,
    *any_protocol.MUTANTS,
    *claims.MUTANTS,
    *life.MUTANTS,
    *refusals.MUTANTS,
    *areas.MUTANTS,
)

MUTANTS: dict[str, Mutant] = {mutant.id: mutant for mutant in sorted(_ALL, key=lambda one: number(one.id))}
"""In the order of the catalogue."""

assert len(MUTANTS) == len(_ALL), "an id is there twice"
