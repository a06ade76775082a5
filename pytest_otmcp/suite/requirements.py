"""The rows of the requirement catalogue that the suite cites (``requirements.toml`` beside the suite) as frozen data. Pure."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Literal

from ..core.capability import Capability
from .catalogue import SUITE

__all__ = ["Requirement", "requirements"]

_FILE = "requirements.toml"


@dataclass(frozen=True, slots=True, kw_only=True)
class Requirement:
    """One row of the catalogue.

    Attributes:
        id: as findings cite it, such as ``WR-003``.
        strength: ``MUST`` or ``SHOULD``; only a MUST that is not met turns an item red.
        statement: what an adapter has to do.
        judged: what the kit looks at, in the answer and at the device.
        source: where the rule comes from, with its section.
        checked: the authors of the row had the text of the source before them.
        stricter: the kit asks for more than the source, which recommends it or gives the principle only.
        capabilities: what a plant must not rely on after a finding about the row, whichever item the finding was in.
    """

    id: str
    strength: Literal["MUST", "SHOULD"]
    statement: str
    judged: str
    source: str
    checked: bool
    stricter: bool = False
    capabilities: tuple[Capability, ...] = ()


@cache
def requirements() -> Mapping[str, Requirement]:
    """Return the rows, id to row, in the order of the file."""
    rows = tomllib.loads((resources.files(SUITE) / _FILE).read_text(encoding="utf-8"))
    return {
        identifier: Requirement(
            id=identifier,
            strength=row["strength"],
            statement=row["statement"],
            judged=row["judged"],
            source=row["source"],
            checked=row["checked"],
            stricter=row.get("stricter", False),
            capabilities=tuple(map(Capability, row.get("capabilities", ()))),
        )
        for identifier, row in rows.items()
    }
