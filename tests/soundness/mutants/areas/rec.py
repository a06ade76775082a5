"""Defects that the checks of the area REC notice."""

from __future__ import annotations

from pytest_otmcp.reference_adapters.core import AdapterServer
from pytest_otmcp.reference_adapters.opcua.link import Link, Session

from ..mutant import Mutant

__all__ = ["MUTANTS"]


def sessions_left_behind(server: AdapterServer) -> None:
    link: Link = server._tools["read_opcua_node"].handler.__self__._link
    left: list[Session] = []

    def forget(session: Session) -> None:
        if link._session is session:
            link._session = None
            left.append(session)

    link._drop = forget


MUTANTS: tuple[Mutant, ...] = (
    Mutant(
        id="MU-88",
        protocol="opcua",
        sentence="Every reconnect leaves a session behind.",
        bend=sessions_left_behind,
        items="REC-006.opcua",
        requirements="CON-006 REC-006",
        areas="rec",
    ),
)
