"""The defects of the reference adapters as data. The kit imports nothing of them: they are subjects like any other."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..core.errors import KitError, UsageError
from ..core.matrix import REQUIREMENTS
from ..trial.task import Task

__all__ = ["ADAPTERS", "BENCHMARK", "DEFECTS", "Declared", "Defect", "Unnoticed", "chosen", "declared", "read"]

ADAPTERS = f"{__package__.partition('.')[0]}.reference_adapters"
"""The package of the reference adapters; the kit starts it as a program."""

DEFECTS = f"{ADAPTERS}.defects"
"""The package of the defects: ``python -m`` starts the adapter with the defect whose id follows."""

BENCHMARK = "benchmark"
"""Name of the defects that the benchmark notices, in the place of an area."""

_MOST_S = 120.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Defect:
    """A reference adapter with one defect, and how the suites must notice it.

    Attributes:
        id: the catalogue's number, such as ``MU-13``; a letter behind it tells several ways to have the defect apart.
        protocol: key of the adapter's protocol.
        sentence: what it does.
        items: ids of the items that fail, no more and no fewer.
        requirements: ids of the requirements that the findings cite, and codes of findings that cite none, no more and no fewer.
        areas: areas of the requirement suite whose checks are run, such as ``wr``; empty for a defect that the benchmark notices.
        recovers: the recovery trials are run as well.
        waits: deadlines are shortened, because the suite waits for what never comes.
        cold: it is started as users start adapters, not forked from a process that is warm.
        sample: it is run where no defects are named.
        named: the adapter is the reference adapter with a vocabulary of its own.
    """

    id: str
    protocol: str
    sentence: str
    items: tuple[str, ...]
    requirements: tuple[str, ...]
    areas: tuple[str, ...]
    recovers: bool
    waits: bool
    cold: bool
    sample: bool
    named: bool = False

    @property
    def catalogue_id(self) -> str:
        """The id without the letter of the variant."""
        return _without_letter(self.id)

    def is_run(self, task: Task) -> bool:
        """Tell whether a run over this defect has the task, if it is about the protocol."""
        if task.suite == REQUIREMENTS:
            return task.id.partition("-")[0].lower() in self.areas
        return not self.areas and (self.recovers or task.suite != "recovery")


@dataclass(frozen=True, slots=True, kw_only=True)
class Unnoticed:
    """A defect of the catalogue, or one way to have it, that no adapter has yet.

    Attributes:
        reason: what it takes to notice it.
    """

    id: str
    sentence: str
    reason: str

    @property
    def catalogue_id(self) -> str:
        """The id without the letter of the variant."""
        return _without_letter(self.id)


@dataclass(frozen=True, slots=True, kw_only=True)
class Declared:
    """Everything that the package of the defects declares.

    Attributes:
        total: number of defects in the catalogue; several adapters may have the same defect.
        defects: in the order of the catalogue.
        unnoticed: those that nothing notices yet.
    """

    total: int
    defects: tuple[Defect, ...]
    unnoticed: tuple[Unnoticed, ...]


def declared() -> Declared:
    """Ask the package of the defects what it declares.

    Raises:
        KitError: it does not say.
    """
    command = [sys.executable, "-P", "-m", DEFECTS, "--list"]
    try:
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=True, timeout=_MOST_S)
    except subprocess.TimeoutExpired:
        raise KitError(f"the defects were not listed within {_MOST_S:g} s") from None
    except subprocess.CalledProcessError as error:
        raise KitError(f"the defects could not be listed: {error.stderr.decode(errors='replace')[-400:]}") from None
    return read(json.loads(done.stdout))


def read(listing: Mapping[str, Any]) -> Declared:
    """Return what a listing of the package of the defects says; see its module ``listing``."""
    return Declared(
        total=listing["total"],
        defects=tuple(defect(entry) for entry in listing["defects"]),
        unnoticed=tuple(Unnoticed(**entry) for entry in listing["not_yet"]),
    )


def defect(entry: Mapping[str, Any]) -> Defect:
    """Return the defect of one entry of a listing."""
    members: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in entry.items()
    }
    return Defect(**members)


def chosen(defects: Sequence[Defect], names: Sequence[str]) -> list[Defect]:
    """Return the defects with these names, in the order of the catalogue.

    Args:
        names: ids with or without the letter of a variant, areas of the requirement suite, or :data:`BENCHMARK`; in any case.

    Raises:
        UsageError: a name is none of these.
    """
    found: set[str] = set()
    for name in names:
        matching = {one.id for one in defects if name.lower() in _names(one)}
        if not matching:
            areas = sorted({area for one in defects for area in one.areas})
            raise UsageError(
                f"there is no defect and no area {name!r}: expected an id such as {defects[0].id} (otmcp docs defects "
                f"lists them) or one of {' '.join([BENCHMARK, *areas])}"
            )
        found |= matching
    return [one for one in defects if one.id in found]


def _names(one: Defect) -> set[str]:
    return {one.id.lower(), one.catalogue_id.lower(), *(one.areas or (BENCHMARK,))}


def _without_letter(identifier: str) -> str:
    return re.sub("[a-z]+$", "", identifier)
