"""SELECT and OPERATE: control relay output blocks (g12v1) and analog output commands (g41), point by point (IEEE 1815, clause 4.4)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from pytest_otmcp.wire.dnp3.objects import INDEX8, INDEX16, Header

from .faults import Rule
from .plant import HIGHEST, LIMITED, LOCAL, PULSED, TRIP_CLOSE, Plant
from .points import fits

__all__ = ["operate", "select"]

SUCCESS, FORMAT_ERROR, NOT_SUPPORTED, LOCALLY, TOO_MANY, OUT_OF_RANGE = 0, 3, 4, 7, 8, 12
"""Status of a point (clause 11.9.2, table of control status codes)."""
_PULSE_ON, _PULSE_OFF, _LATCH_ON, _LATCH_OFF, _CLOSE, _TRIP = 0x01, 0x02, 0x03, 0x04, 0x41, 0x81
"""Control codes: operation type, and trip and close with the pulse that they are given as."""
_MOST = 8
"""Points that a request may operate."""
_WHOLE = (1, 2)
"""Variations of g41 that are whole numbers."""

_OBJECT_UNKNOWN, _PARAMETER_ERROR = 0x0200, 0x0400


def select(plant: Plant, headers: Sequence[Header], rule: Rule | None) -> tuple[bytes, int, bool]:
    """Check the points of a SELECT; return the objects of the answer, its error indications, and whether every point is selected."""
    wrong = _wrong(headers)
    if wrong:
        return b"", wrong, False
    statuses = _statuses(plant, headers, rule, 0)
    return _echo(headers, statuses), 0, not any(status for run in statuses for status in run)


def operate(plant: Plant, headers: Sequence[Header], rule: Rule | None, missing: int) -> tuple[bytes, int]:
    """Operate points; return the objects of the answer and its error indications.

    Args:
        missing: status of every point because no SELECT prepares this; 0 where one does, or none is needed.
    """
    wrong = _wrong(headers)
    if wrong:
        return b"", wrong
    statuses = _statuses(plant, headers, rule, missing)
    for header, run in zip(headers, statuses, strict=True):
        for point, status in zip(header.points, run, strict=True):
            if status == SUCCESS and (rule is None or not rule.ack_only):
                _move(plant, header, point)
    return _echo(headers, statuses), 0


def _wrong(headers: Sequence[Header]) -> int:
    if any(header.group not in (12, 41) for header in headers):
        return _OBJECT_UNKNOWN
    if not headers or any(header.qualifier not in (INDEX8, INDEX16) or not header.points for header in headers):
        return _PARAMETER_ERROR
    return 0


def _statuses(plant: Plant, headers: Sequence[Header], rule: Rule | None, missing: int) -> list[list[int]]:
    forced = missing if rule is None or rule.status is None else rule.status
    found, count = [], 0
    for header in headers:
        run = []
        for point in header.points:
            count += 1
            run.append(forced or (TOO_MANY if count > _MOST else _status(plant, header, point)))
        found.append(run)
    return found


def _status(plant: Plant, header: Header, point: dict[str, Any]) -> int:
    """Return whether, and why not, a point can be operated."""
    binary, index = header.group == 12, point["index"]
    target = plant.points.get(f"{'binary' if binary else 'analog'}_output/{index}")
    if target is None:
        return NOT_SUPPORTED
    if point["status"]:
        return FORMAT_ERROR
    if plant.local or (binary and index == LOCAL):
        return LOCALLY
    if binary:
        codes = {PULSED: (_PULSE_ON, _PULSE_OFF), TRIP_CLOSE: (_CLOSE, _TRIP)}.get(index, (_LATCH_ON, _LATCH_OFF))
        return SUCCESS if point["code"] in codes else NOT_SUPPORTED
    value = point["value"]
    if target.kind == "int32":
        return SUCCESS if header.variation in _WHOLE else NOT_SUPPORTED
    # A float that is no number is within no limits.
    if not fits(target.kind, value) or (index == LIMITED and not 0 <= value <= HIGHEST):
        return OUT_OF_RANGE
    return SUCCESS if math.isfinite(value) else OUT_OF_RANGE


def _move(plant: Plant, header: Header, point: dict[str, Any]) -> None:
    index = point["index"]
    if header.group == 41:
        plant.hold(plant.points[f"analog_output/{index}"], point["value"], 0)
    elif point["count"] == 0:
        # Nothing is to be done, which is a success (clause 11.9.2).
        return
    elif index == PULSED:
        plant.pulses += point["count"]
    else:
        plant.hold(plant.points[f"binary_output/{index}"], point["code"] in (_LATCH_ON, _CLOSE), 0)


def _echo(headers: Sequence[Header], statuses: Sequence[Sequence[int]]) -> bytes:
    """Return the objects of a request with the status of each point."""
    found = b""
    for header, run in zip(headers, statuses, strict=True):
        size = 1 if header.qualifier == INDEX8 else 2
        found += bytes([header.group, header.variation, header.qualifier]) + len(run).to_bytes(size, "little")
        for point, content, status in zip(header.points, header.raw, run, strict=True):
            found += point["index"].to_bytes(size, "little") + content[:-1] + bytes([status])
    return found
