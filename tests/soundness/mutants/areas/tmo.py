"""Defects that the checks of the area TMO notice."""

from __future__ import annotations

from ..mutant import Mutant

__all__ = ["MUTANTS"]

MUTANTS: tuple[Mutant, ...] = ()
