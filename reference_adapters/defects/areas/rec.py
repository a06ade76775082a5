"""Defects that the checks of the area REC notice."""

from __future__ import annotations

import sys
from typing import Any

from ...core import AdapterServer, Call
from ...modbus import link as modbus_link
from ...mqtt import link as mqtt_link
from ...opcua import link as opcua_link
from ...opcua.link import Link, Session
from ..any_protocol import answers_from_memory_when_gone, never_reconnects
from ..defect import Defect, defect, failing, tools_of
from ..mqtt import forgets_subscriptions
from ..refusals import _end

__all__ = ["DEFECTS"]


def sessions_left_behind(server: AdapterServer) -> None:
    link: Link = tools_of(server, "read_opcua_node")._link
    left: list[Session] = []

    def forget(session: Session) -> None:
        if link._connection is session:
            link._connection = None
            left.append(session)

    link._drop = forget


def stays_in_a_closed_session(server: AdapterServer) -> None:
    """A session that the server has closed is taken for a good one until its connection ends."""
    opcua_link._GONE -= {"BadSessionIdInvalid", "BadSessionClosed", "BadSessionNotActivated"}


def stays_on_a_dead_connection(server: AdapterServer) -> None:
    """A call that ran out of time leaves its connection as it is."""
    genuine = modbus_link.Link._explained

    def explained(
        link: modbus_link.Link, call: Call, connection: modbus_link._Connection, error: Exception
    ) -> Exception:
        if not connection.lost and isinstance(error, TimeoutError | modbus_link.ModbusException):
            link._connection = connection
            # The library would end it after three calls.
            connection.client.ctx.count_until_disconnect = sys.maxsize
        return genuine(link, call, connection, error)

    close = modbus_link.Link._drop

    def drop(link: modbus_link.Link, connection: modbus_link._Connection | None) -> None:
        if connection is not None and connection.lost:
            close(link, connection)

    modbus_link.Link._explained = explained
    modbus_link.Link._drop = drop


def subscribes_with_less(server: AdapterServer) -> None:
    """Make subscriptions again after an outage, with QoS 0."""
    genuine = mqtt_link.Link._restore

    async def restore(link: mqtt_link.Link, made: Any) -> None:
        wanted = {text: subscription.qos for text, subscription in link.subscriptions.items()}
        for subscription in link.subscriptions.values():
            subscription.qos = 0
        try:
            await genuine(link, made)
        finally:
            for text, qos in wanted.items():
                link.subscriptions[text].qos = qos

    mqtt_link.Link._restore = restore


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


DEFECTS: tuple[Defect, ...] = (
    defect(
        "MU-88", "opcua", "Every reconnect leaves a session behind.", sessions_left_behind, "REC-006", "CON-006 REC-006"
    ),
    defect(
        "MU-88c",
        "opcua",
        "A session that the server has closed goes on being used.",
        stays_in_a_closed_session,
        "REC-006",
    ),
    defect(
        "MU-30c",
        "modbus",
        "After a call without an answer its connection goes on being used.",
        stays_on_a_dead_connection,
        "REC-003",
    ),
    defect(
        "MU-35c",
        "modbus",
        "While the device is gone, a read of one register succeeds with what was read before.",
        answers_from_memory_when_gone("read_multiple_holding_registers"),
        "REC-002",
    ),
    defect(
        "MU-35d",
        "mqtt",
        "While the broker is gone, its last status is told, as if it was still there.",
        answers_from_memory_when_gone("get_broker_info"),
        "REC-002",
        "REC-002",
    ),
    defect(
        "MU-65b",
        "mqtt",
        "Subscriptions that died with the connection are never made again.",
        forgets_subscriptions,
        "REC-004",
    ),
    defect(
        "MU-65n",
        "mqtt",
        "Of the subscriptions that died with the connection only the oldest is made again.",
        remembers_one_subscription,
        "REC-004",
    ),
    defect(
        "MU-65q",
        "mqtt",
        "Subscriptions that died with the connection are made again with QoS 0, whatever they were.",
        subscribes_with_less,
        "REC-004",
    ),
    defect(
        "MU-126k",
        "s7",
        "After a failed connection no call works any more.",
        never_reconnects(),
        "REC-001 REC-002 REC-005",
        "REC-001 REC-005",
    ),
    defect(
        "MU-93b", "modbus", "An answer that is no frame ends the adapter.", failing(change=_end), "REC-005", "MCP-007"
    ),
    defect(
        "MU-126c",
        "opcua",
        "After a failed connection no call works any more.",
        never_reconnects(),
        "REC-001 REC-002 REC-005",
        "REC-001 REC-005",
    ),
)
