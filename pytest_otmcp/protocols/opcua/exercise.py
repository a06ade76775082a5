"""What checks for every protocol do on OPC UA: a variable that is read, and one that is written."""

from __future__ import annotations

import random

from ..exercise import Asked, Exercise, every_change

__all__ = ["EXERCISE"]

_READ, _WRITTEN = "Temperature", "ValvePosition"


def _read(rng: random.Random) -> Asked:
    value = round(rng.uniform(-50.0, 150.0), 6)
    return Asked(
        operation="read",
        inputs={"node": f"ns=2;s={_READ}"},
        outputs={"value": value},
        pokes=({"node": _READ, "value": value},),
    )


def _write(rng: random.Random) -> Asked:
    value = round(rng.uniform(1.0, 99.0), 3)
    node = f"ns=2;s={_WRITTEN}"
    return Asked(
        operation="write", inputs={"node": node, "value": value}, outputs={"value": value}, points={node: value}
    )


EXERCISE = Exercise(
    reading="read",
    read=_read,
    writing="write",
    write=_write,
    number="value",
    bounded=(),
    done=every_change,
    reads=({"service": "Read"}, {"service": "CreateMonitoredItems"}),
    writes=({"service": "Write"},),
    silent=tuple({"service": service, "action": {"drop": True}} for service in ("Read", "Write")),
    reset=tuple({"service": service, "action": {"reset": True}} for service in ("Read", "Write")),
    refused=({"service": "Read", "action": {"status": "BadDeviceFailure"}},),
)
