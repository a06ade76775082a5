"""What an adapter has earned: for each protocol, what it may be trusted with, and which items say so. Pure.

A capability is earned when every item behind it passed. One that misses an item is undecided, not earned: a run that was
narrowed can only take away.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from ..core.verdict import Status
from ..protocols.protocol import GUARD
from ..protocols.registry import protocols
from . import Item, Run

__all__ = ["CAPABILITIES", "Capability", "Earned", "Grade", "earned", "families"]


class Grade(StrEnum):
    """What a run says about one capability of one protocol."""

    EARNED = "earned"
    NOT_EARNED = "not earned"
    UNDECIDED = "undecided"
    NOT_CLAIMED = "not claimed"
    NOT_TESTED = "not tested"


@dataclass(frozen=True, slots=True, kw_only=True)
class Capability:
    """Something that a plant may ask of an adapter.

    Attributes:
        name: a word or two.
        meaning: what it means when it is earned.
        items: family to the ids of the items behind it, separated by blanks.
        facet: what the subject has to claim for it, where the items also apply without.
    """

    name: str
    meaning: str
    items: Mapping[str, str]
    facet: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Earned:
    """One capability of one protocol.

    Attributes:
        because: ids of the items that decided it: those that failed, or are missing, or else all that passed.
        without: ids of items behind it that are about something the subject does not claim.
    """

    grade: Grade
    because: tuple[str, ...] = ()
    without: tuple[str, ...] = ()


CAPABILITIES = (
    Capability(
        name="Reading",
        meaning="values, messages and structure arrive as the device holds them",
        items={"Modbus": "M1 M2", "MQTT": "Q1 Q2", "OPC UA": "O1 O2 O4", "Cross-protocol": "X1"},
    ),
    Capability(
        name="Writing",
        meaning="what is reported as written reached the device, once and unchanged",
        items={"Modbus": "M3", "MQTT": "Q3 Q4", "OPC UA": "O3", "Cross-protocol": "X2"},
    ),
    Capability(
        name="Write protection",
        meaning="with writes disabled, no write reaches the device",
        items={"Modbus": "M4", "MQTT": "Q3 Q4", "OPC UA": "O3"},
        facet=GUARD,
    ),
    Capability(
        name="Refusing bad requests",
        meaning="what is wrong is refused with the right error, and changes nothing",
        items={"Modbus": "FM1 FM2", "MQTT": "FQ1 FQ2", "OPC UA": "FO1 FO2", "Cross-protocol": "FX1"},
    ),
    Capability(
        name="Load",
        meaning="parallel calls and long series get their own answers",
        items={"Modbus": "S1 S4 S7", "MQTT": "S2 S5 S8", "OPC UA": "S3 S6 S9", "Cross-protocol": "X1p X2p"},
    ),
    Capability(
        name="Surviving outages",
        meaning="an endpoint that goes away is reported, and used again when it is back",
        items={"Modbus": "S10 R-modbus", "MQTT": "S11 R-mqtt", "OPC UA": "S12 R-opcua"},
    ),
)

_OTHERS = "Further requirements"
_ORDER = ("Modbus", "MQTT", "OPC UA", "Cross-protocol")


def families(run: Run) -> list[str]:
    """The families of a run's items, the known ones first."""
    found = dict.fromkeys(item["family"] for item in run["items"])
    return [name for name in _ORDER if name in found] + [name for name in found if name not in _ORDER]


def earned(run: Run) -> list[tuple[Capability, dict[str, Earned]]]:
    """Each capability with what every family of the run has earned of it.

    Items that no capability knows are one of their own, so that none of their failures is overlooked.
    """
    known = {name for capability in CAPABILITIES for ids in capability.items.values() for name in ids.split()}
    others: dict[str, str] = {}
    for item in run["items"]:
        if item["id"] not in known:
            others[item["family"]] = f"{others.get(item['family'], '')} {item['id']}"
    asked = list(CAPABILITIES)
    if others:
        asked.append(Capability(name=_OTHERS, meaning="the other items of the suite passed", items=others))
    items = {item["id"]: item for item in run["items"]}
    return [
        (capability, {family: _of(capability, family, items, run) for family in families(run)}) for capability in asked
    ]


def _of(capability: Capability, family: str, items: Mapping[str, Item], run: Run) -> Earned:
    for protocol, facts in run["subject"]["adapters"].items():
        if (
            protocol in protocols()
            and protocols()[protocol].name == family
            and capability.facet in facts.get("unclaimed", {})
        ):
            return Earned(grade=Grade.NOT_CLAIMED)
    return _grade(capability.items.get(family, "").split(), items)


def _grade(wanted: Sequence[str], items: Mapping[str, Item]) -> Earned:
    statuses = {name: items[name]["status"] if name in items else None for name in wanted}

    def those(*found: Status | None) -> tuple[str, ...]:
        return tuple(name for name, status in statuses.items() if status in found)

    unclaimed = those(Status.NOT_APPLICABLE)
    if not wanted:
        return Earned(grade=Grade.NOT_TESTED)
    if failed := those(Status.FAIL, Status.NOT_TESTABLE):
        return Earned(grade=Grade.NOT_EARNED, because=failed, without=unclaimed)
    if open_ones := those(Status.KIT_ERROR, Status.INTERRUPTED, None):
        return Earned(grade=Grade.UNDECIDED, because=open_ones, without=unclaimed)
    if passed := those(Status.PASS):
        return Earned(grade=Grade.EARNED, because=passed, without=unclaimed)
    return Earned(grade=Grade.NOT_CLAIMED, without=unclaimed)
