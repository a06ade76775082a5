"""What can be changed at the outstation past the protocol.

====================  ==================================================================================================
``point``             ``{"point": "analog_input/1", "value": 5}`` sets a value; ``"flags": ["ONLINE", "LOCAL_FORCED"]`` its quality
                      flags beside it or alone. A point with a class gets an event of it
``restarted``         ``{"restarted": true}``: the restart bit (IIN1.7)
``needs_time``        the outstation wants its clock set (IIN1.4)
``local``             somebody has switched to local control: every operation gets status 7 (IIN1.5)
``trouble``           device trouble (IIN1.6)
``select_timeout_s``  for how long a selection holds
``unsolicited``       ``{"unsolicited": [1]}``: sends an unsolicited response with the events of these classes on every connection,
                      also where nobody enabled that
====================  ==================================================================================================
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..fault_rules import FLAG, Field, number
from .plant import Plant, checked
from .points import FLAGS, Point

__all__ = ["CLASSES", "poke"]

_SETTINGS = {
    "restarted": FLAG,
    "needs_time": FLAG,
    "local": FLAG,
    "trouble": FLAG,
    "select_timeout_s": number(0, 3600),
}
_NAMES = Field(
    accepts=lambda value: isinstance(value, list) and all(isinstance(name, str) and name in FLAGS for name in value),
    expected=f"a list of {', '.join(FLAGS)}",
)
CLASSES = Field(
    accepts=lambda value: (
        isinstance(value, list) and bool(value) and all(type(one) is int and one in (1, 2, 3) for one in value)
    ),
    expected="a list of classes from 1 to 3",
)


def poke(plant: Plant, params: Mapping[str, Any], time_ms: int) -> None:
    """Change a point or settings.

    Args:
        time_ms: of the change, in milliseconds since 1970.

    Raises:
        ValueError: no such point or value.
        KeyError: a parameter is missing.
    """
    settings = {name: params[name] for name in params if name in _SETTINGS}
    if settings:
        for name, value in settings.items():
            if not _SETTINGS[name].accepts(value):
                raise ValueError(f"{name}: expected {_SETTINGS[name].expected}, found {value!r}")
        for name, value in settings.items():
            setattr(plant, name, value)
        return
    point = _point(plant, params["point"])
    flags = point.flags
    if "flags" in params:
        if not _NAMES.accepts(params["flags"]):
            raise ValueError(f"flags: expected {_NAMES.expected}, found {params['flags']!r}")
        flags = sum(FLAGS[name] for name in set(params["flags"]))
    value = checked(point, params["value"]) if "value" in params or "flags" not in params else point.value
    point.flags = flags
    plant.hold(point, value, time_ms)


def _point(plant: Plant, name: Any) -> Point:
    found = plant.points.get(name) if isinstance(name, str) else None
    if found is None:
        raise ValueError(f"there is no point {name!r}; there are, for instance, analog_input/1 and binary_output/2")
    return found
