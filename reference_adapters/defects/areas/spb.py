"""Defects that the checks of the area SPB notice."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Annotated, Any

from pydantic import Field

from ...core import AdapterError, AdapterServer, Call
from ...mqtt import edge_node, nodes, payload, sparkplug_tools
from ...mqtt import link as mqtt_link
from ...mqtt.connection import Message
from ...mqtt.edge_node import EdgeNode
from ...mqtt.link import Link
from ...mqtt.payload import Metric
from ...mqtt.topics import NAMESPACE
from ..defect import Data, Defect, Handler, around, defect, tools_of, wrap
from ..host_application import beside
from ..mqtt import link_of
from ..sparkplug import (
    birth_without_metrics,
    births,
    constant_count,
    never_born,
    no_will,
    sequence_per_device,
    swapped_field_numbers,
)

__all__ = ["DEFECTS"]

_DATA = "publish_device_data"
_LEVELS = Annotated[str, Field(min_length=1, pattern="^[^+#]+$")]
_LEVEL_OR_NOTHING = Annotated[str | None, Field(pattern="^[^/+#]*$")]
_EVERY = " ".join(f"SPB-{number:03}" for number in (1, 2, 3, 4, 5, 6, 8, 9, 12))
"""The checks in which the adapter publishes as an edge node."""
_EVERY_SPARKPLUG = f"{_EVERY} SPB-010 SPB-011 SPB-013"


def encoding(change: Callable[[Metric], Metric]) -> Callable[[AdapterServer], None]:
    """Return the defect that metrics of the edge node are encoded as others."""

    def apply(server: AdapterServer) -> None:
        genuine = edge_node.encode
        edge_node.encode = lambda metrics, seq: genuine([change(metric) for metric in metrics], seq)

    return apply


def _unsigned(metric: Metric) -> Metric:
    negative = metric.datatype.startswith("Int") and isinstance(metric.value, int) and metric.value < 0
    return replace(metric, value=-metric.value) if negative else metric


def _zero_for_null(metric: Metric) -> Metric:
    return replace(metric, value=0) if metric.value is None and metric.datatype == "Double" else metric


def number_255_left_out(server: AdapterServer) -> None:
    genuine = EdgeNode.numbered

    def numbered(node: EdgeNode, kind: str, device: str | None, metrics: Any) -> Message:
        # Births begin at 255, so that NBIRTH has 0.
        if node.seq == 254 and kind != "NBIRTH":
            node.seq = 255
        return genuine(node, kind, device, metrics)

    EdgeNode.numbered = numbered


async def later_number_told(genuine: Handler, call: Call, arguments: Any) -> Data:
    data = await genuine(call, arguments)
    return {**data, "seq": (data["seq"] + 4) % 256}


@around(_DATA)
async def failures_use_up_numbers(genuine: Any, call: Call, arguments: Any) -> Data:
    try:
        data: Data = await genuine(call, arguments)
    except AdapterError:
        node = genuine.__self__._node
        node.seq = (node.seq + 1) % 256
        raise
    return data


def unborn_devices_report(server: AdapterServer) -> None:
    genuine = EdgeNode.new_values

    def new_values(node: EdgeNode, device: str | None, values: Sequence[tuple[str, Any]]) -> list[Metric]:
        if node.life is not None and device not in node.life.devices:
            node.life = node.life.with_device(str(device), _doubles(values))
        return genuine(node, device, values)

    EdgeNode.new_values = new_values


def _doubles(values: Sequence[tuple[str, Any]]) -> dict[str, Metric]:
    return {name: Metric(name=name, datatype="Double", value=value) for name, value in values}


def undeclared_metrics_reported(server: AdapterServer) -> None:
    genuine = EdgeNode.new_values

    def new_values(node: EdgeNode, device: str | None, values: Sequence[tuple[str, Any]]) -> list[Metric]:
        told = node.living().metrics_of(device)
        unknown = [(name, value) for name, value in values if name not in told and isinstance(value, float)]
        known = [one for one in values if one not in unknown]
        return [*genuine(node, device, known), *_doubles(unknown).values()]

    EdgeNode.new_values = new_values


def names_of_several_levels(server: AdapterServer) -> None:
    tool = server._tools["publish_device_birth"]
    anything = type("Anything", (tool.model,), {"__annotations__": {"device_id": _LEVELS}, "__module__": __name__})
    wrap(server, "publish_device_birth", lambda genuine: genuine, model=anything)


def rebirths_ignored(server: AdapterServer) -> None:
    mqtt_link.is_rebirth_command = lambda data: False


def commands_not_subscribed(server: AdapterServer) -> None:
    tools_of(server, _DATA)._commands.clear()


def dies_before_it_is_born_again(server: AdapterServer) -> None:
    genuine = Link._be_born_again

    async def be_born_again(link: Link) -> None:
        link._connection.send(link.edge_node.death())
        await genuine(link)

    Link._be_born_again = be_born_again


def reborn_without_devices(server: AdapterServer) -> None:
    genuine = Link._be_born_again

    async def be_born_again(link: Link) -> None:
        life = link.edge_node.life
        link.edge_node.life = replace(life, devices={})
        try:
            await genuine(link)
        finally:
            link.edge_node.life = life

    Link._be_born_again = be_born_again


def commands_unguarded(server: AdapterServer) -> None:
    wrap(server, "publish_device_command", lambda genuine: genuine, writes=False)


def commands_numbered(server: AdapterServer) -> None:
    genuine = sparkplug_tools.encode
    sparkplug_tools.encode = lambda metrics, seq: genuine(metrics, 7 if seq is None else seq)


async def commands_itself(genuine: Handler, call: Call, arguments: Any) -> Data:
    own = link_name(genuine)
    data = await genuine(call, arguments.model_copy(update={"edge_node_id": own}))
    return data


def link_name(genuine: Handler) -> str:
    name: str = genuine.__self__._link.edge_node.name
    return name


def commands_kept(server: AdapterServer) -> None:
    kept: list[Message] = []
    genuine_restore = Link._restore

    async def restore(link: Link, made: Any) -> None:
        await genuine_restore(link, made)
        while kept:
            made.send(kept.pop(0))

    @around("publish_device_command")
    async def keeping(genuine: Handler, call: Call, arguments: Any) -> Data:
        try:
            data = await genuine(call, arguments)
        except AdapterError as error:
            if error.code in ("connect_failed", "connection_lost"):
                group = arguments.group_id or genuine.__self__._node.group
                topic = f"{NAMESPACE}/{group}/DCMD/{arguments.edge_node_id}/{arguments.device_id}"
                metrics = sparkplug_tools._checked(arguments.metrics)
                kept.append(Message(topic=topic, payload=payload.encode(metrics, None)))
            raise
        return data

    Link._restore = restore
    keeping(server)


def groups_left_empty(server: AdapterServer) -> None:
    async def in_its_own(genuine: Handler, call: Call, arguments: Any) -> Data:
        return await genuine(call, arguments.model_copy(update={"group_id": arguments.group_id or None}))

    for name in ("publish_node_command", "publish_device_command"):
        model = server._tools[name].model
        members = {"__annotations__": {"group_id": _LEVEL_OR_NOTHING}, "group_id": None, "__module__": __name__}
        around(name, model=type("AnyGroup", (model,), members))(in_its_own)(server)


def commands_unchecked(server: AdapterServer) -> None:
    nodes.NodeTracker.check_command = lambda tracker, *target: False


def no_death_before_the_end(server: AdapterServer) -> None:
    genuine, node = server._close, link_of(server).edge_node

    async def close() -> None:
        node.life = None
        await genuine()

    server._close = close


def deaths_ignored(server: AdapterServer) -> None:
    nodes._die = lambda node, payload: None


def every_death_believed(server: AdapterServer) -> None:
    def die(node: Any, payload: Any) -> None:
        node.status, node.seq = "offline", None

    nodes._die = die


def aliases_unresolved(server: AdapterServer) -> None:
    genuine = nodes._by_key
    nodes._by_key = lambda payload: {key: metric for key, metric in genuine(payload).items() if isinstance(key, str)}


def gaps_untold(server: AdapterServer) -> None:
    genuine = nodes.NodeTracker.listing
    nodes.NodeTracker.listing = lambda tracker: [{**node, "sequence_gap": False} for node in genuine(tracker)]


def _telling(change: Callable[[int], int]) -> Callable[[AdapterServer], None]:
    """Return the defect that the clock of payloads and metrics tells another time in nanoseconds."""

    def apply(server: AdapterServer) -> None:
        payload.time = SimpleNamespace(time_ns=lambda: change(time.time_ns()))

    return apply


def dead_devices_are_reborn(server: AdapterServer) -> None:
    """The node's next births have every device that was ever born."""
    genuine, known = EdgeNode.births, dict[str, Any]()

    def births(node: EdgeNode, life: Any = None) -> list[Message]:
        known.update((life or node.living()).devices)
        return genuine(node, replace(life or node.living(), devices=dict(known)))

    EdgeNode.births = births


def deaths_do_not_outlive_a_connection(server: AdapterServer) -> None:
    """A device that was reported dead is born again with each new connection."""
    genuine, known = Link._connect, dict[str, Any]()
    dying = EdgeNode.numbered

    def numbered(node: EdgeNode, kind: str, device: str | None, metrics: Any) -> Message:
        if kind == "DDEATH":
            known[str(device)] = node.living().devices[str(device)]
        return dying(node, kind, device, metrics)

    async def connect(link: Link, *arguments: Any) -> Any:
        node = link.edge_node
        if node.life is not None:
            node.life = replace(node.life, devices={**known, **node.life.devices})
        return await genuine(link, *arguments)

    EdgeNode.numbered, Link._connect = numbered, connect


DEFECTS: tuple[Defect, ...] = (
    defect(
        "MU-70s",
        "mqtt",
        "Every device counts the sequence of its own messages.",
        sequence_per_device,
        _EVERY,
        "SPB-004",
    ),
    defect("MU-71", "mqtt", "Sequence number 255 is left out.", number_255_left_out, "SPB-004"),
    defect(
        "MU-72",
        "mqtt",
        "A publish that failed uses up a sequence number.",
        failures_use_up_numbers,
        "SPB-003 SPB-005 SPB-009",
        "SPB-004 SPB-005",
    ),
    defect(
        "MU-71t",
        "mqtt",
        "The sequence number that is told is that of a later message.",
        around(_DATA)(later_number_told),
        "SPB-004",
    ),
    defect(
        "MU-73s",
        "mqtt",
        "A device's data are published, its birth never.",
        never_born,
        _EVERY,
        "SPB-001 SPB-003 SPB-004 SPB-006 SPB-008 SPB-012",
    ),
    defect("MU-73b", "mqtt", "Data of a device that was never born are published.", unborn_devices_report, "SPB-003"),
    defect("MU-73d", "mqtt", "A device that died is born again with the node.", dead_devices_are_reborn, "SPB-003"),
    defect(
        "MU-73r",
        "mqtt",
        "A device that died is born again with the next connection.",
        deaths_do_not_outlive_a_connection,
        "SPB-003",
    ),
    defect(
        "MU-74u",
        "mqtt",
        "Times are seconds since 1970.",
        _telling(lambda ns: ns // 1000),
        f"{_EVERY} SPB-010",
        "SPB-001",
    ),
    defect(
        "MU-74v",
        "mqtt",
        "Times are those of a time zone, not of UTC.",
        _telling(lambda ns: ns + 7_200 * 10**9),
        f"{_EVERY} SPB-010",
        "SPB-001",
    ),
    defect(
        "MU-74s",
        "mqtt",
        "The field numbers of Float and Double values are swapped.",
        swapped_field_numbers,
        f"{_EVERY} SPB-010",
        "SPB-001 SPB-010",
    ),
    defect("MU-75", "mqtt", "Negative numbers lose their sign.", encoding(_unsigned), "SPB-001"),
    defect("MU-75n", "mqtt", "Null is encoded as 0.", encoding(_zero_for_null), "SPB-001"),
    defect("MU-76w", "mqtt", "CONNECT carries no will.", no_will, _EVERY, "SPB-006"),
    defect(
        "MU-76s",
        "mqtt",
        "bdSeq is the same with every connection.",
        constant_count,
        "SPB-003 SPB-005 SPB-006 SPB-010",
        "SPB-006",
    ),
    defect(
        "MU-76d", "mqtt", "The session ends with DISCONNECT and without NDEATH.", no_death_before_the_end, "", "SPB-012"
    ),
    defect(
        "MU-77s",
        "mqtt",
        "NBIRTH is published with QoS 1.",
        births(lambda birth: replace(birth, qos=1)),
        _EVERY,
        "SPB-002",
    ),
    defect(
        "MU-77l",
        "mqtt",
        "A device may have a name of several levels.",
        names_of_several_levels,
        "SPB-002",
        "SPB-001 SPB-002 SPB-004",
    ),
    defect("MU-78", "mqtt", "The command to be born again has no effect.", rebirths_ignored, "SPB-008"),
    defect("MU-78d", "mqtt", "The node dies before it is born again.", dies_before_it_is_born_again, "SPB-008"),
    defect(
        "MU-78n",
        "mqtt",
        "Born again is the node, without its devices.",
        reborn_without_devices,
        "SPB-008",
        "SPB-003 SPB-008",
    ),
    defect("MU-78s", "mqtt", "The node does not subscribe to its commands.", commands_not_subscribed, "SPB-008"),
    defect("MU-79", "mqtt", "Commands to devices pass the write guard.", commands_unguarded, "SPB-010", "WR-004"),
    defect("MU-79s", "mqtt", "Commands carry a sequence number.", commands_numbered, "SPB-010"),
    defect(
        "MU-79t",
        "mqtt",
        "Commands go to the adapter's own edge node.",
        around("publish_device_command")(commands_itself),
        "SPB-010",
    ),
    defect("MU-79u", "mqtt", "Commands are not compared with the birth.", commands_unchecked, "SPB-010"),
    defect(
        "MU-79x",
        "mqtt",
        "A command that has failed is sent with the next connection.",
        commands_kept,
        "SPB-010",
        "WR-010",
    ),
    defect("MU-79y", "mqtt", "An empty group is taken for the adapter's own.", groups_left_empty, "SPB-010", "SPB-002"),
    defect(
        "MU-127s",
        "mqtt",
        "The birth of a device declares none of its metrics.",
        birth_without_metrics,
        _EVERY.replace("SPB-006 ", ""),
        "SPB-001 SPB-009",
    ),
    defect(
        "MU-127b",
        "mqtt",
        "Data with a metric that the birth did not declare are published.",
        undeclared_metrics_reported,
        "SPB-005 SPB-009",
        "SPB-009",
    ),
    defect("MU-128", "mqtt", "The metrics of a node that died stay good.", deaths_ignored, "SPB-011"),
    defect("MU-128a", "mqtt", "Aliases are not resolved.", aliases_unresolved, "SPB-011"),
    defect("MU-128b", "mqtt", "The death of an earlier life counts.", every_death_believed, "SPB-011"),
    defect(
        "MU-130",
        "mqtt",
        "A host tells its STATE on its first connection alone.",
        beside(once=True, corrects=False),
        "SPB-013",
    ),
    defect("MU-130b", "mqtt", "A host believes that it is away.", beside(corrects=False), "SPB-013"),
    defect(
        "MU-130r", "mqtt", "The STATE of a host is not retained.", beside(retained=False), _EVERY_SPARKPLUG, "SPB-013"
    ),
    defect(
        "MU-130t",
        "mqtt",
        "The STATE of a host has another time than its will.",
        beside(later_ms=1),
        _EVERY_SPARKPLUG,
        "SPB-013",
    ),
    defect("MU-128g", "mqtt", "A gap in the sequence is not told.", gaps_untold, "SPB-011"),
)
