"""The checks of the requirement suite: one module for each area of the catalogue.

A check is one row of ``requirements.toml``, one function here, and the defects in ``reference_adapters/defects`` that it has to notice.
"""

from __future__ import annotations

from importlib import import_module

from pytest_otmcp.trial.task import Task

__all__ = ["AREAS", "MODULES", "checks", "modules"]

AREAS = (
    *("mcp", "env", "err", "rd", "wr", "adr", "enc", "con", "tmo", "rec", "mqt", "spb", "oua", "res"),
    *("sec", "aud", "tls", "apr", "inj", "key"),
)
"""The areas in the order of the catalogue; each is a module here."""


MODULES = (*AREAS, "mcp_callers", "rd_readings", "wr_commands", "adr_mqtt")
"""The modules of the areas; four areas have two."""


def modules() -> tuple[str, ...]:
    """Return the dotted names of the modules that declare checks."""
    return tuple(f"{__name__}.{module}" for module in MODULES)


def checks() -> list[Task]:
    """Return the checks of every area, in the order of the catalogue: by row, and for each row by protocol."""
    declared = [check for module in modules() for check in import_module(module).TASKS]
    # The sort is stable: the checks of a row stay in the order of the protocols.
    rows = {row: place for place, row in enumerate(sorted({check.requirements[0] for check in declared}, key=_place))}
    return sorted(declared, key=lambda check: rows[check.requirements[0]])


def _place(row: str) -> tuple[int, str]:
    area = row.partition("-")[0].lower()
    return AREAS.index(area), row
