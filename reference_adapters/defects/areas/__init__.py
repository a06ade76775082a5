"""The catalogue's defects that the requirement suite notices, by the area whose checks notice them."""

from __future__ import annotations

from ..mutant import Mutant
from . import adr, adr_mqtt, con, enc, env, err, further, mcp, mqt, oua, rd, rec, res, spb, tmo, wr

__all__ = ["MUTANTS"]

# In the order of the suite's areas.
_AREAS = (mcp, env, err, rd, wr, adr, enc, con, tmo, rec, mqt, spb, oua, res, adr_mqtt, further)

MUTANTS: tuple[Mutant, ...] = tuple(mutant for area in _AREAS for mutant in area.MUTANTS)
