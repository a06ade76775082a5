"""The catalogue's defects that the requirement suite notices, by the area whose checks notice them."""

from __future__ import annotations

from ..defect import Defect
from . import (
    adr,
    adr_mqtt,
    bacnet,
    bounds,
    commands,
    con,
    dnp3,
    enc,
    env,
    err,
    ethernetip,
    inj,
    key,
    mcp,
    mqt,
    oua,
    profibus,
    rd,
    rec,
    res,
    s7,
    spb,
    tmo,
    wr,
)

__all__ = ["DEFECTS"]

# In the order of the suite's areas; the further protocols have a module each.
_AREAS = (
    mcp,
    env,
    err,
    rd,
    wr,
    commands,
    bounds,
    adr,
    enc,
    con,
    tmo,
    rec,
    mqt,
    spb,
    oua,
    res,
    inj,
    key,
    adr_mqtt,
    s7,
    bacnet,
    ethernetip,
    dnp3,
    profibus,
)

DEFECTS: tuple[Defect, ...] = tuple(defect for area in _AREAS for defect in area.DEFECTS)
