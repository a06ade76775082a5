"""The catalogue's defects that the requirement suite notices, by the area whose checks notice them."""

from __future__ import annotations

from importlib import import_module

from pytest_otmcp.conformance.requirements import MODULES

from ..mutant import Mutant

__all__ = ["MUTANTS"]

MUTANTS: tuple[Mutant, ...] = tuple(
    mutant for area in MODULES for mutant in import_module(f"{__name__}.{area}").MUTANTS
)
