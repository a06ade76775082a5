"""The golden records by name: which adapter performs which items, and what must be found."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

from pytest_otmcp.reference_adapters.defects.listing import listing

from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.soundness.defect import DEFECTS, Defect, read
from pytest_otmcp.soundness.judging import tasks_of
from pytest_otmcp.subject import Adapter, Subject, named_subject, reference_subject
from pytest_otmcp.suite.catalogue import all_tasks
from tests.soundness.conftest import foreign_subject, lying
from tests.soundness.honest.zoo import ZOO

__all__ = ["Recipe", "recipes"]

TOGETHER = "together"
"""Name of the record of those items that need the adapters of several protocols."""

_HONEST_ADAPTER = Path(__file__).parents[1] / "soundness" / "honest" / "adapter.py"

_HONEST = {
    "mcp/no-text-block": "M1 M2 M3 M4 MCP-006.modbus",
    "mcp/prose-before-json": "M1 M3 MCP-006.modbus",
    "mcp/parse-error-for-what-is-too-deep": "ADR-009.modbus",
    "mcp/notifications": "M1 M3 FM1 MCP-001.modbus",
    "mcp/streamable-http": "M1 M3 FM1 MCP-007.modbus",
    "texts/json-in-ascii": "M2 M3 RD-001.modbus INJ-001.modbus",
    "mcp/limits-its-calls": "S4 CON-004.modbus",
    "modbus/split-reads": "M2 FM1 RD-001.modbus RD-007.modbus",
    "modbus/reads-back-after-writing": "M3 M4 FM2 WR-001.modbus WR-003.modbus",
    "mqtt/retained-online": "Q1 Q3 Q4 WR-004.mqtt",
    "mqtt/delivers-again-with-dup": "Q2 Q3 MQT-001.mqtt MQT-004.mqtt",
    "mqtt/values-from-a-store": "Q4 SPB-003.mqtt SPB-004.mqtt",
    "opcua/browses-before-reading": "O1 O3 FO1 OUA-006.opcua",
    "opcua/writes-a-timestamp": "O3 OUA-005.opcua WR-001.opcua",
    "s7/bytes-in-parts": "K2 K3 RD-001.s7 ENC-003.s7",
    "dnp3/events-beside-a-read": "D2 D5 D7 RD-001.dnp3",
    "bacnet/reads-with-status-flags": "B2 B3 FB1 RD-001.bacnet",
    "ethernetip/symbol-instances": "E2 E3 FE1 ADR-003.ethernetip",
    "profibus/inputs-by-data-exchange": "P2 P3 FP1 RD-001.profibus",
    "ethercat/inputs-by-process-data": "C2 C4 C5 FC1 RD-001.ethercat",
    "profinet/inputs-of-the-next-frame": "N2 N3 FN1 RD-001.profinet",
}
"""Honest neighbours and the items that their choice shows in."""

_DEFECTS = """
    MU-02bac MU-02n MU-04e MU-05 MU-05w MU-06q MU-07 MU-07dnp MU-08ei MU-10p MU-11bac MU-11dnp MU-12 MU-13 MU-14bac
    MU-14dnp MU-14p MU-15a MU-15n MU-16 MU-17 MU-17pn MU-17ec MU-19 MU-20bac MU-21c MU-22bac MU-24 MU-24r MU-26c
    MU-27 MU-28k MU-29q MU-30d MU-33o MU-33w MU-34 MU-35 MU-35pb MU-37eca MU-37p MU-38 MU-41 MU-42 MU-43 MU-46d
    MU-46e MU-46s MU-46t MU-47b MU-48 MU-50 MU-51 MU-52g MU-52p MU-52r MU-53e MU-53ec MU-53h MU-53p MU-53pn MU-54e
    MU-55e MU-58ei MU-59b MU-60 MU-60t MU-61ei MU-62q MU-63 MU-63dnp MU-64u MU-65b MU-66 MU-66p MU-68 MU-72 MU-74
    MU-74v MU-76b MU-76d MU-77l MU-78n MU-79s MU-80 MU-81d MU-81dnp MU-82 MU-84b MU-86 MU-87b MU-88 MU-89b MU-90ei
    MU-90p MU-91 MU-92k MU-99e MU-99f MU-107d MU-108e MU-108k MU-109m MU-112n MU-117 MU-117b MU-118 MU-120b MU-122p
    MU-123b MU-124p MU-126k
""".split()
"""Defects of every protocol. Together they show most requirements and codes of findings that any defect shows."""

_MOST_ITEMS = 4
"""Items of a defect that fails more of them: all fail for the same reason."""

_NAMED = "M2 RD-008.modbus WR-001.modbus WR-003.modbus WR-004.modbus WR-014.modbus WR-003.mqtt WR-004.mqtt WR-014.mqtt"
"""Items of the reference adapters that have a vocabulary of their own."""

_FOREIGN = {
    ("modbus-prose", ""): "M2 M3 M4 FM1 FM2",
    ("modbus-http", ""): "M2 M3 FM1",
    ("mqtt-handle", ""): "Q1 Q2 Q3 FQ1",
    ("mqtt-connect", ""): "Q1 Q2 Q3 FQ1",
    ("opcua-items", ""): "O1 O3 O4 FO1",
    ("modbus-prose", "demo-mode"): "M2 M3 M4 FM1 FM2",
    ("mqtt-handle", "empty-poll"): "Q2",
    ("opcua-items", "echoes-write"): "O3",
}
"""Subjects of ``tests/soundness/subjects``, which answer without the kit's envelope, each with a lie or none, and items that do not fail
or, with a lie, all fail."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """How a golden record is made.

    Attributes:
        name: of the record.
        protocol: whose adapter is judged.
        subject: gives the subject.
        program: words after ``python`` that replace the program of its adapter; None for the adapter as it is.
        items: ids of the items that are performed, in the suite's order.
        failing: those of them that must fail.
        cited: requirements that findings must cite; None where that is not declared.
        cold: the adapter is started as users start adapters, not forked from a process that is warm.
        waits: deadlines are shortened, because the suite waits for what never comes.
        described: what the subject file has to say of the adapter, as a change of its description.
    """

    name: str
    protocol: str
    subject: Callable[[], Subject] = reference_subject
    program: tuple[str, ...] | None = None
    items: tuple[str, ...]
    failing: tuple[str, ...] = ()
    cited: frozenset[str] | None = None
    cold: bool = False
    waits: bool = False
    described: Callable[[Adapter], Adapter] = lambda adapter: adapter


@cache
def recipes() -> dict[str, Recipe]:
    """Return every golden record's recipe by its name."""
    return {recipe.name: recipe for recipe in (*_references(), *_honest(), *_foreign(), *_defects())}


def _references() -> Iterator[Recipe]:
    tasks = all_tasks().values()
    for key in protocols():
        items = tuple(task.id for task in tasks if task.protocols == (key,))
        yield Recipe(name=f"reference-{key}", protocol=key, items=items, cited=frozenset())
    items = tuple(task.id for task in tasks if len(task.protocols) > 1)
    yield Recipe(name=f"reference-{TOGETHER}", protocol="modbus", items=items, cited=frozenset())
    named = tuple(_NAMED.split())
    yield Recipe(name="reference-named", protocol="modbus", subject=named_subject, items=named, cited=frozenset())


def _honest() -> Iterator[Recipe]:
    for name, items in _HONEST.items():
        choice = ZOO[name]
        yield Recipe(
            name=f"honest-{name.replace('/', '-')}",
            protocol=choice.protocol,
            program=(str(_HONEST_ADAPTER), name),
            items=tuple(items.split()),
            cited=frozenset(requirement for requirement, _ in choice.warnings | choice.checked_warnings),
            described=choice.described,
        )


def _foreign() -> Iterator[Recipe]:
    for (name, lie), words in _FOREIGN.items():
        items = tuple(words.split())
        yield Recipe(
            name=f"foreign-{name}{lie and '-'}{lie}",
            protocol=name.partition("-")[0],
            subject=partial(_foreign_subject, name, lie),
            items=items,
            failing=items if lie else (),
        )


def _foreign_subject(name: str, lie: str) -> Subject:
    subject = foreign_subject(name)
    return lying(subject, lie) if lie else subject


def _defects() -> Iterator[Recipe]:
    defects = {defect.id: defect for defect in read(listing()).defects}
    for name in _DEFECTS:
        defect = defects[name]
        yield Recipe(
            name=f"defect-{name}",
            protocol=defect.protocol,
            program=("-P", "-m", DEFECTS, name),
            items=defect.items[:_MOST_ITEMS] or tuple(_warned(defect)),
            failing=defect.items[:_MOST_ITEMS],
            cited=None if defect.items[_MOST_ITEMS:] else frozenset(defect.requirements),
            cold=defect.cold,
            waits=defect.waits,
            subject=named_subject if defect.named else reference_subject,
        )


def _warned(defect: Defect) -> Iterator[str]:
    """Return the items of a defect that breaks no MUST: they do not fail, but warn."""
    for task in tasks_of(defect):
        if not set(defect.requirements).isdisjoint(task.requirements):
            yield task.id
