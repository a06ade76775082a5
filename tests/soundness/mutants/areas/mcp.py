"""Defects that the checks of the area MCP notice."""

from __future__ import annotations

from pytest_otmcp.reference_adapters.core import AdapterServer

from ..mutant import Mutant

__all__ = ["MUTANTS"]


def unknown_arguments_ignored(server: AdapterServer) -> None:
    for tool in server._tools.values():
        tool.model.model_config["extra"] = "ignore"
        tool.model.model_rebuild(force=True)


MUTANTS: tuple[Mutant, ...] = (
    Mutant(
        id="MU-13",
        protocol="modbus",
        sentence="An argument with an unknown name is ignored.",
        bend=unknown_arguments_ignored,
        items="MCP-004.modbus",
        requirements="MCP-004",
        areas="mcp",
        quick=True,
    ),
)
