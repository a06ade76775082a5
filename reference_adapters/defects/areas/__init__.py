"""The catalogue's defects that the requirement suite notices, by the area whose checks notice them."""

from __future__ import annotations

from ..defect import Defect
from . import (
    adr,
    adr_mqtt,
    bacnet,
    bounds,
    callers,
    commands,
    con,
    dnp3,
    enc,
    env,
    err,
    ethercat,
    ethernetip,
    inj,
    key,
    mcp,
    mqt,
    oua,
    process_data,
    rd,
    readings,
    rec,
    res,
    s7,
    security,
    spb,
    tls,
    tmo,
    wr,
)

__all__ = ["DEFECTS"]

# In the order of the suite's areas; the further protocols have a module each.
_AREAS = (
    mcp,
    callers,
    env,
    err,
    rd,
    readings,
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
    security,
    tls,
    inj,
    key,
    adr_mqtt,
    s7,
    bacnet,
    ethernetip,
    dnp3,
    process_data,
    ethercat,
)

DEFECTS: tuple[Defect, ...] = tuple(defect for area in _AREAS for defect in area.DEFECTS)
