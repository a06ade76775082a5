"""The file in which a person allows writes to a real device.

::

    device = "modbus=tcp://10.0.0.5:502"
    identity = "Vendor Product 1.0"      # what the device says of itself; left out where it says nothing
    name = "Ada Lovelace"
    date = 2026-11-26
    expires = 2026-11-27                 # the last day

    [[writable]]
    target = "1/holding_registers/100..103"
    lowest = 0
    highest = 500

    # Instead of that, or beside it: how the device is cut off, and how it comes back.
    stop = ["docker", "stop", "plc"]
    start = ["docker", "start", "plc"]
"""

from __future__ import annotations

import datetime
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..core.errors import UsageError
from ..protocols.field import Consent, Writable

__all__ = ["read_consent"]

_KEYS: Mapping[str, tuple[type, str]] = {
    "device": (str, "a text"),
    "identity": (str, "a text"),
    "name": (str, "a text"),
    "date": (datetime.date, "a day"),
    "expires": (datetime.date, "a day"),
    "writable": (list, "tables [[writable]]"),
    "stop": (list, "the words of a command"),
    "start": (list, "the words of a command"),
}
_MAY_LACK = {"identity", "stop", "start"}
_WRITABLE = {"target", "lowest", "highest"}


def read_consent(path: Path, today: datetime.date) -> Consent:
    """Read a consent that holds today.

    Raises:
        UsageError: the file is none, or it does not hold; one sentence.
    """
    try:
        told = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(f"--otmcp-consent: {path}: {error}") from None
    if problem := _problem(told, today):
        raise UsageError(f"--otmcp-consent: {path}: {problem}")
    return Consent(
        device=told["device"],
        identity=told.get("identity"),
        name=told["name"],
        date=told["date"],
        expires=told["expires"],
        writable=tuple(Writable(**one) for one in told.get("writable", ())),
        stop=tuple(told.get("stop", ())),
        start=tuple(told.get("start", ())),
    )


def _problem(told: Mapping[str, Any], today: datetime.date) -> str | None:
    for key in told:
        if key not in _KEYS:
            return f"the key {key!r} is unknown; known are {', '.join(_KEYS)}"
    for key, (kind, expected) in _KEYS.items():
        if key not in told:
            if key not in _MAY_LACK and not (key == "writable" and "stop" in told):
                return f"the key {key!r} is missing"
        # A moment is a day as well.
        elif not isinstance(told[key], kind) or isinstance(told[key], datetime.datetime) or not told[key]:
            return f"{key}: expected {expected}, found {told[key]!r}"
    if not told["date"] <= today <= told["expires"]:
        return f"it holds from {told['date']} to {told['expires']}, and today is {today}"
    if ("stop" in told) != ("start" in told):
        return "stop and start: a device that is cut off has to come back, so both commands are named or none"
    for key in ("stop", "start"):
        if not all(isinstance(word, str) and word and "\0" not in word for word in told.get(key, ())):
            return f"{key}: expected the words of a command, found {told[key]!r}"
    return next(filter(None, map(_problem_of_writable, told.get("writable", ()))), None)


def _problem_of_writable(one: Any) -> str | None:
    if not isinstance(one, dict) or one.keys() != _WRITABLE:
        return f"writable: expected tables with {', '.join(sorted(_WRITABLE))}"
    numbers = one["lowest"], one["highest"]
    if not all(type(number) in (int, float) and abs(number) <= sys.float_info.max for number in numbers):
        return f"writable: expected numbers as lowest and highest, found {numbers}"
    if not numbers[0] <= numbers[1]:
        return f"writable: {one['target']} has the lowest value {numbers[0]}, the highest {numbers[1]}"
    try:
        Writable(**one).points  # noqa: B018  (it says what is wrong)
    except (TypeError, ValueError) as error:
        return f"writable: {error}"
    return None
