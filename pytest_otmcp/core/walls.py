"""The walls around an adapter, and what it means that each of them stood. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

__all__ = ["AUTO", "MODES", "NETWORK", "OFF", "REQUIRE", "WALLS"]

AUTO, REQUIRE, OFF = MODES = ("auto", "require", "off")
"""As far as the machine allows; else no run; none."""

NETWORK: Literal["network"] = "network"

WALLS: Mapping[Literal["network", "processes", "files"], str] = {
    NETWORK: "no address outside this run could be reached",
    "processes": "no process outside could be seen or signalled, and none that an adapter started is left",
    "files": "no file outside could be changed, and no device and no Unix socket of the machine be reached, but those that the subject file names",
}
"""Each wall, and what a run shows around whose adapters it stood."""
