"""The registry of the codes of findings (``findings.toml``, here and in each protocol's package) as frozen data. Pure."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources

__all__ = ["FindingCode", "finding_codes"]

_FILE = "findings.toml"


@dataclass(frozen=True, slots=True, kw_only=True)
class FindingCode:
    """One code of the registry.

    Attributes:
        meaning: what a finding with this code says.
        change: where the cause usually is, and what to do about it.
        keys: keys of the adapter's table in the subject file that may be the cause.
        beside: it is about the session, beside what the steps of an item have asked: one such fault is in every item of the adapter.
        contradicts: what the adapter said is not what its device saw, or holds.
    """

    code: str
    meaning: str
    change: str
    keys: tuple[str, ...] = ()
    beside: bool = False
    contradicts: bool = False


@cache
def finding_codes(package: str = __package__) -> Mapping[str, FindingCode]:
    """Return the codes that a package declares, code to entry; none where it declares none.

    Args:
        package: that of a protocol; without it the codes that do not depend on a protocol.
    """
    file = resources.files(package) / _FILE
    if not file.is_file():
        return {}
    declared = tomllib.loads(file.read_text(encoding="utf-8"))["codes"]
    return {
        code: FindingCode(
            code=code,
            meaning=entry["meaning"],
            change=entry["change"],
            keys=tuple(entry.get("keys", ())),
            beside=entry.get("beside", False),
            contradicts=entry.get("contradicts", False),
        )
        for code, entry in declared.items()
    }
