"""Defects that the checks of the area REC notice."""

from __future__ import annotations

import sys
from typing import Any

from ...core import AdapterServer
from ...modbus import link as modbus_link
from ...mqtt import link as mqtt_link
from ...opcua import link as opcua_link
from ...opcua.link import Link, Session
from ..any_protocol import answers_from_memory_when_gone, never_reconnects
from ..mqtt import forgets_subscriptions
from ..mutant import Mutant, failing
from ..refusals import _end

__all__ = ["MUTANTS"]


def sessions_left_behind(server: AdapterServer) -> None:
    link: Link = server._tools["read_opcua_node"].handler.__self__._link
    left: list[Session] = []

    def forget(session: Session) -> None:
        if link._session is session:
            link._session = None
            left.append(session)

    link._drop = forget


def stays_in_a_closed_session(server: AdapterServer) -> None:
    """A session that the server has closed is taken for a good one until its connection ends."""
    opcua_link._GONE -= {"BadSessionIdInvalid", "BadSessionClosed", "BadSessionNotActivated"}


def stays_on_a_dead_connection(server: AdapterServer) -> None:
    """A call that ran out of time leaves its connection as it is."""
    genuine = modbus_link.Link._explained

    def explained(link: modbus_link.Link, connection: modbus_link._Connection, error: Exception) -> Exception:
        if not connection.lost and isinstance(error, TimeoutError | modbus_link.ModbusException):
            link._connection = connection
            # The library would end it after three calls.
            connection.client.ctx.count_until_disconnect = sys.maxsize
        return genuine(link, connection, error)

    close = modbus_link.Link._drop

    def drop(link: modbus_link.Link) -> None:
        if link._connection is not None and link._connection.lost:
            close(link)

    modbus_link.Link._explained = explained
    modbus_link.Link._drop = drop


def remembers_one_subscription(server: AdapterServer) -> None:
    """Make the oldest subscription again after an outage, and tell that all are active."""
    genuine = mqtt_link.Link._restore

    async def restore(link: mqtt_link.Link, made: Any) -> None:
        kept = link.subscriptions
        link.subscriptions = dict(list(kept.items())[:1])
        try:
            await genuine(link, made)
        finally:
            link.subscriptions = kept

    mqtt_link.Link._restore = restore


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
    Mutant(
        id="MU-88c",
        protocol="opcua",
        sentence="A session that the server has closed goes on being used.",
        bend=stays_in_a_closed_session,
        items="REC-006.opcua",
        requirements="REC-006",
        areas="rec",
    ),
    Mutant(
        id="MU-30c",
        protocol="modbus",
        sentence="After a call without an answer its connection goes on being used.",
        bend=stays_on_a_dead_connection,
        items="REC-003.modbus",
        requirements="REC-003",
        areas="rec",
    ),
    Mutant(
        id="MU-35c",
        protocol="modbus",
        sentence="While the device is gone, a read of one register succeeds with what was read before.",
        bend=answers_from_memory_when_gone("read_multiple_holding_registers"),
        items="REC-002.modbus",
        requirements="REC-002",
        areas="rec",
    ),
    Mutant(
        id="MU-35d",
        protocol="mqtt",
        sentence="While the broker is gone, its last status is told, as if it was still there.",
        bend=answers_from_memory_when_gone("get_broker_info"),
        items="REC-002.mqtt",
        requirements="REC-002 not_proven",
        areas="rec",
    ),
    Mutant(
        id="MU-65b",
        protocol="mqtt",
        sentence="Subscriptions that died with the connection are never made again.",
        bend=forgets_subscriptions,
        items="REC-004.mqtt",
        requirements="REC-004",
        areas="rec",
    ),
    Mutant(
        id="MU-65n",
        protocol="mqtt",
        sentence="Of the subscriptions that died with the connection only the oldest is made again.",
        bend=remembers_one_subscription,
        items="REC-004.mqtt",
        requirements="REC-004",
        areas="rec",
    ),
    Mutant(
        id="MU-126k",
        protocol="s7",
        sentence="After a failed connection no call works any more.",
        bend=never_reconnects(),
        items="REC-001.s7 REC-002.s7 REC-005.s7",
        requirements="REC-001 REC-005",
        areas="rec",
    ),
    Mutant(
        id="MU-93b",
        protocol="modbus",
        sentence="An answer that is no frame ends the adapter.",
        bend=failing(change=_end),
        items="REC-005.modbus",
        requirements="MCP-007",
        areas="rec",
    ),
    Mutant(
        id="MU-126c",
        protocol="opcua",
        sentence="After a failed connection no call works any more.",
        bend=never_reconnects(),
        items="REC-001.opcua REC-002.opcua REC-005.opcua",
        requirements="REC-001 REC-005",
        areas="rec",
    ),
)
