"""What can be changed at the device past the protocol: values, slots of priority arrays, reliability, the number of objects.

===============  =======================================================================================================
``value``        ``{"object": "analog-input,1", "value": 70.5}``: the present value of an object without a priority array; of one with
                 a priority array the relinquish default. A REAL or DOUBLE may be ``"nan"``, ``"inf"`` or ``"-inf"``
``priority``     ``{"object": "analog-output,1", "priority": 5, "value": 30.0}``: a slot of the priority array; null empties it
``reliability``  ``{"object": "analog-input,1", "reliability": 1}`` (BACnetReliability): 0 for no fault; else the status flag *fault* is set
``name``         ``{"object": "analog-input,1", "name": "Zone"}``: the object name; of ``device,12345`` that of the device
``objects``      ``{"objects": 400}``: the plant has so many further analog values, from instance 1000 on
``types``        ``{"types": true}``: the plant has characterstring-value,1, integer-value,1, large-analog-value,1 and
                 positive-integer-value,1 as well
===============  =======================================================================================================
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pytest_otmcp.wire.bacnet.services import PRIORITIES
from pytest_otmcp.wire.bacnet.values import Value

from ..fault_rules import FLAG, TEXT, integer
from .faults import identifier_of
from .names import Refusal
from .objects import BacnetObject
from .plant import DEVICE, Plant, single

__all__ = ["poke"]

_NO_NUMBERS = ("nan", "inf", "-inf")
"""What JSON has no numbers for, as journal and image say it."""
_WANTED: Mapping[str, tuple[type, ...]] = {"real": (int, float), "double": (int, float), "character-string": (str,)}
_PRIORITY, _RELIABILITY, _COUNT = integer(1, PRIORITIES), integer(0, 63), integer(0, 1000)


def poke(plant: Plant, params: Mapping[str, Any]) -> None:
    """Change the plant.

    Raises:
        ValueError: no such object, value or number.
        KeyError: a parameter is missing.
    """
    if "objects" in params:
        if not _COUNT.accepts(params["objects"]):
            raise ValueError(f"objects: expected {_COUNT.expected}, found {params['objects']!r}")
        plant.enlarge(params["objects"])
        return
    if "types" in params:
        if not FLAG.accepts(params["types"]):
            raise ValueError(f"types: expected {FLAG.expected}, found {params['types']!r}")
        plant.diversify()
        return
    if "name" in params:
        if not TEXT.accepts(params["name"]):
            raise ValueError(f"name: expected {TEXT.expected}, found {params['name']!r}")
        if params["object"] == f"device,{DEVICE}":
            plant.name = params["name"]
        else:
            _object(plant, params["object"]).name = params["name"]
        return
    target = _object(plant, params["object"])
    if "reliability" in params:
        if not _RELIABILITY.accepts(params["reliability"]):
            raise ValueError(f"reliability: expected {_RELIABILITY.expected}, found {params['reliability']!r}")
        target.reliability = params["reliability"]
        return
    value, priority = params["value"], params.get("priority")
    if priority is None:
        target.held = _checked(target, value)
        return
    if not target.commandable or not _PRIORITY.accepts(priority):
        raise ValueError(f"{target.label} has no priority {priority!r}")
    target.slots[priority - 1] = None if value is None else _checked(target, value)


def _object(plant: Plant, text: Any) -> BacnetObject:
    identifier = identifier_of(text)
    if identifier is None or identifier not in plant.objects:
        known = ", ".join(one.label for one in plant.objects.values())
        raise ValueError(f"there is no object {text!r}; there are {known}")
    return plant.objects[identifier]


def _checked(target: BacnetObject, value: Any) -> Any:
    if target.kind in ("real", "double") and value in _NO_NUMBERS:
        return value
    wanted = _WANTED.get(target.kind, (int,))
    if type(value) not in wanted:
        raise ValueError(f"{target.label} holds {target.kind} values, not {value!r}")
    try:
        held = single(value) if target.kind == "real" else value
        return target.checked([Value(kind=target.kind, value=held)])
    except (Refusal, OverflowError):
        raise ValueError(f"{target.label} cannot hold {value!r}") from None
