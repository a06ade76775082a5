"""The walls around an adapter, and what it means that each of them stood. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

__all__ = ["AUTO", "MODES", "NETWORK", "OFF", "REQUIRE", "WALLS", "Account", "Wall", "missing", "stood"]

AUTO, REQUIRE, OFF = MODES = ("auto", "require", "off")
"""As far as the machine allows; else no run; none."""

NETWORK: Literal["network"] = "network"
Wall = Literal["network", "processes", "files"]
Account = Mapping[Wall, str | None]
"""Wall to None, where it stood around every adapter, or to the reason why it did not."""

WALLS: Mapping[Wall, str] = {
    NETWORK: "no address outside this run could be reached",
    "processes": "no process outside could be seen or signalled, and none that an adapter started is left",
    "files": "no file outside could be changed, and no device or Unix socket that existed at its start could be reached, except those that "
    "the subject file names",
}
"""Each wall, and what a run shows around whose adapters it stood."""


def stood(account: Account) -> list[str]:
    """Return what a run with these walls shows, a sentence for each that stood."""
    return [f"{says[0].upper()}{says[1:]}." for wall, says in WALLS.items() if account.get(wall, "") is None]


def missing(account: Account) -> list[str]:
    """Return which walls did not stand, a sentence for each reason."""
    walls: dict[str, list[str]] = {}
    for wall in WALLS:
        if why := account.get(wall):
            walls.setdefault(why, []).append(wall)
    return [f"No wall around {_listed(names)}: {why}." for why, names in walls.items()]


def _listed(words: Sequence[str]) -> str:
    return " and ".join(filter(None, (", ".join(words[:-1]), words[-1])))
