"""What the kit can make the edge node do, by a poke ``{"edge_node": {…}}`` with one of these members.

================  ======================================================================================================
``aliases``       true: births with an alias for every metric of a device, and data by alias alone; false: by name
``metrics``       ``[{"device", "name", "datatype", "value", "writable": false}]``: sets metrics, and announces new ones, or
                  new datatypes, by a rebirth; others by DDATA. Values as in ``sparkplug_values``
``rebirth``       true: the births again
``death``         name of a device: its DDEATH
``cut``           true: the connection is cut, so that the broker publishes NDEATH; the node connects and is born again
``offline``       true: NDEATH, and the node stays away until false (or a reset)
``skip_seq``      so many sequence numbers are left out before the next message
================  ======================================================================================================
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ..fault_rules import FLAG, TEXT, Field, integer
from .plant import Plant, Tag
from .sparkplug_values import value_of

__all__ = ["Births", "EdgeNodePoke", "read_poke"]

_A_LIST = Field(accepts=lambda value: isinstance(value, list), expected="a list of metrics")
_FIELDS = {
    "aliases": FLAG,
    "metrics": _A_LIST,
    "rebirth": FLAG,
    "death": TEXT,
    "cut": FLAG,
    "offline": FLAG,
    "skip_seq": integer(1, 255),
}
_METRIC = frozenset({"device", "name", "datatype", "value", "writable"})


@dataclass(slots=True, kw_only=True)
class Births:
    """What births have besides names and values.

    Attributes:
        aliases: whether metrics of devices have aliases.
    """

    aliases: bool = False
    _numbers: dict[tuple[str, str], int] = field(default_factory=dict)

    def alias(self, device: str, name: str) -> int:
        """Return the alias of a metric, from 1; none is used twice by the node."""
        return self._numbers.setdefault((device, name), len(self._numbers) + 1)

    def name(self, device: str, alias: int | None) -> str | None:
        """Return the name of the metric of a device with this alias, None if there is none."""
        for (owner, name), number in self._numbers.items():
            if owner == device and number == alias:
                return name
        return None


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeNodePoke:
    """What a poke asks for.

    Attributes:
        births: what births have from now on.
        metrics: device, name and tag of each metric.
        new: whether there is one that the last birth has not announced.
        death: device that dies.
    """

    births: Births | None = None
    metrics: tuple[tuple[str, str, Tag], ...] = ()
    new: bool = False
    death: str | None = None
    cut: bool = False
    offline: bool | None = None
    skip_seq: int = 0


def read_poke(source: Any, plant: Plant) -> EdgeNodePoke:
    """Return what a poke asks for.

    Raises:
        ValueError: it is not understood.
    """
    if not isinstance(source, Mapping) or len(source) != 1:
        raise ValueError(f"edge_node: expected an object with one of {', '.join(_FIELDS)}, found {source!r}")
    [(member, value)] = source.items()
    if member not in _FIELDS:
        raise ValueError(f"edge_node: unknown member {member!r}; known are {', '.join(_FIELDS)}")
    if not _FIELDS[member].accepts(value):
        raise ValueError(f"edge_node: {member} cannot be {value!r}: expected {_FIELDS[member].expected}")
    if member == "aliases":
        return EdgeNodePoke(births=Births(aliases=value))
    if member == "rebirth":
        return EdgeNodePoke(new=value)
    if member == "metrics":
        return _metrics(value, plant)
    if member == "death" and value not in plant.devices:
        raise ValueError(f"edge_node: there is no device {value!r}; there are {', '.join(plant.devices)}")
    return EdgeNodePoke(**{member: value})


def _metrics(sources: list[Any], plant: Plant) -> EdgeNodePoke:
    metrics = []
    for source in sources:
        if (
            not isinstance(source, Mapping)
            or source.keys() - _METRIC
            or not _METRIC - {"writable"} <= source.keys()
            or not all(isinstance(source[name], str) for name in ("device", "name"))
        ):
            raise ValueError(
                f"edge_node: a metric is {{'device', 'name', 'datatype', 'value', 'writable'}}, found {source!r}"
            )
        tag = Tag(datatype=source["datatype"], value=value_of(source), writable=bool(source.get("writable", False)))
        metrics.append((source["device"], source["name"], tag))
    known = {(device, name): tag.datatype for device, tags in plant.devices.items() for name, tag in tags.items()}
    new = any(known.get((device, name)) != tag.datatype for device, name, tag in metrics)
    return EdgeNodePoke(metrics=tuple(metrics), new=new)
