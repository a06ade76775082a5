"""Honest OPC UA adapters."""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any

from asyncua import ua
from pytest_otmcp.reference_adapters.core import AdapterError, AdapterServer, Call
from pytest_otmcp.reference_adapters.defects.defect import Handler, wrap
from pytest_otmcp.reference_adapters.opcua.link import Link, Session
from pytest_otmcp.reference_adapters.opcua.services import Services

from .choice import (
    POLLING_BESIDE_CALLS,
    backed_off,
    choices,
    deaf_to_cancellation,
    in_background,
    one_call_at_a_time,
    twice_where_missing,
)

__all__ = ["CHOICES"]

CHOICES, choice = choices("opcua")

SENSORS = [ua.NodeId(name, 2) for name in ("Temperature", "Pressure", "FlowRate", "TankLevel")]
STATE = ua.NodeId(ua.ObjectIds.Server_ServerStatus_State)
NODES_OF_THE_PLANT = "ns=2;s="
TIMESTAMP = ("OUA-005", "timestamp_written")


def link_of(server: AdapterServer) -> Link:
    link: Link = server._tools["read_opcua_node"].handler.__self__._link
    return link


def background_call(server: AdapterServer) -> Call:
    return Call(protocol="opcua", operation="opcua.watch", endpoint=server.endpoint, writes=False)


def other_reads(read: Callable[..., Any]) -> None:
    """Replace the reading of values; other attributes, and the server's own nodes, are read as before."""
    genuine = Services.read

    async def chosen(services: Services, nodes: Sequence[ua.NodeId], *attributes: Any, request: str = "read") -> Any:
        if attributes or any(node.NamespaceIndex == 0 for node in nodes):
            return await genuine(services, nodes, *attributes, request=request)
        return await read(services, nodes, genuine)

    Services.read = chosen


# -- reading ----------------------------------------------------------------------------------------------------------


@choice(
    "reads every value by a monitored item made for it", "the server's notification is its answer to this very call"
)
def reads_by_monitored_items(server: AdapterServer) -> None:
    async def monitored(services: Services, nodes: Sequence[ua.NodeId], genuine: Any) -> list[ua.DataValue]:
        call, session = services._call, services._session
        arrived: asyncio.Queue[tuple[int, ua.DataValue]] = asyncio.Queue()

        async def notified(result: ua.PublishResult) -> None:
            for data in result.NotificationMessage.NotificationData or []:
                for item in getattr(data, "MonitoredItems", None) or []:
                    arrived.put_nowait((item.ClientHandle, item.Value))

        async def subscribe(client: Any) -> list[Any]:
            parameters = ua.CreateSubscriptionParameters(
                RequestedPublishingInterval=10.0,
                RequestedLifetimeCount=1000,
                RequestedMaxKeepAliveCount=100,
                PublishingEnabled=True,
            )
            return [await client.create_subscription(parameters, notified)]

        (subscription,) = await session.request(call, subscribe, items=1)
        items = [
            ua.MonitoredItemCreateRequest(
                ItemToMonitor=ua.ReadValueId(NodeId=node, AttributeId=ua.AttributeIds.Value),
                MonitoringMode=ua.MonitoringMode.Reporting,
                RequestedParameters=ua.MonitoringParameters(ClientHandle=index, SamplingInterval=0.0, QueueSize=1),
            )
            for index, node in enumerate(nodes)
        ]
        parameters = ua.CreateMonitoredItemsParameters(
            SubscriptionId=subscription.SubscriptionId,
            TimestampsToReturn=ua.TimestampsToReturn.Both,
            ItemsToCreate=items,
        )
        created = await session.request(
            call, lambda client: client.create_monitored_items(parameters), items=len(nodes)
        )
        found = {
            index: ua.DataValue(StatusCode=result.StatusCode)
            for index, result in enumerate(created)
            if not result.StatusCode.is_good()
        }
        while len(found) < len(nodes):
            index, value = await asyncio.wait_for(arrived.get(), 3.0)
            found.setdefault(index, value)
        ids = ua.DeleteSubscriptionsParameters(SubscriptionIds=[subscription.SubscriptionId])
        await session.request(call, lambda client: client.delete_subscriptions(ids.SubscriptionIds), items=1)
        call.answered(service="CreateMonitoredItems")
        return [found[index] for index in range(len(nodes))]

    other_reads(monitored)


class Unheard:
    """Takes the notifications of a subscription, and does nothing with them."""

    def datachange_notification(self, node: Any, value: Any, data: Any) -> None:
        pass


@choice(
    "has a subscription open in every session",
    "OPC 10000-4, section 6.7: the server keeps such a session when it has ended the connection; the client cannot close it then",
)
def subscription_in_every_session(server: AdapterServer) -> None:
    link = link_of(server)
    genuine = link._connect

    async def connect(call: Call) -> Session:
        session = await genuine(call)
        with suppress(Exception):
            subscription = await session.client.create_subscription(500.0, Unheard())
            await subscription.subscribe_data_change(session.client.get_node("ns=2;s=Temperature"))
        return session

    link._connect = connect


@choice("browses a node before it reads it", "reading changes nothing; meta.attempts says so")
def browses_before_reading(server: AdapterServer) -> None:
    async def browsed(services: Services, nodes: Sequence[ua.NodeId], genuine: Any) -> Any:
        for node in nodes:
            await services.browse([node], fields=["/node_id"])
        return await genuine(services, nodes)

    other_reads(browsed)


@choice(
    "reads the class of a node before it browses it",
    "reading changes nothing, and a node that is not there is told by it",
)
def reads_before_browsing(server: AdapterServer) -> None:
    genuine = Services.browse

    async def browse(services: Services, nodes: Sequence[ua.NodeId], **options: Any) -> Any:
        await services.read(nodes, ua.AttributeIds.NodeClass)
        return await genuine(services, nodes, **options)

    Services.browse = browse


@choice(
    "looks whether all nodes may be written before it writes one",
    "of several writes none is sent where one would be refused",
)
def looks_before_writing(server: AdapterServer) -> None:
    genuine = Services.write

    async def write(services: Services, nodes: Sequence[ua.NodeId], values: Sequence[ua.Variant]) -> Any:
        for attribute, code in (
            (ua.AttributeIds.AccessLevel, "not_writable"),
            (ua.AttributeIds.UserAccessLevel, "access_denied"),
        ):
            levels = await services.read(nodes, attribute)
            if not all(level.Value.Value & ua.AccessLevel.CurrentWrite.mask for level in levels):
                raise AdapterError(code, "one of the nodes may not be written", outcome="not_sent")
        return await genuine(services, nodes, values)

    Services.write = write


@choice("reads every value twice and answers the second", "a read may be repeated; meta.attempts says so")
def repeated_reads(server: AdapterServer) -> None:
    async def twice(services: Services, nodes: Sequence[ua.NodeId], genuine: Any) -> Any:
        await genuine(services, nodes)
        return await genuine(services, nodes)

    other_reads(twice)


@choice("reads several nodes by one request each", "how values are gathered is the adapter's own affair")
def reads_one_by_one(server: AdapterServer) -> None:
    async def singly(services: Services, nodes: Sequence[ua.NodeId], genuine: Any) -> Any:
        return [found for node in nodes for found in await genuine(services, [node])]

    other_reads(singly)


@choice(
    "writes several nodes by one request each",
    "one Write for each of the nodes that the call names is what was asked for",
)
def writes_one_by_one(server: AdapterServer) -> None:
    genuine = Services.write

    async def singly(services: Services, nodes: Sequence[ua.NodeId], values: Sequence[ua.Variant]) -> Any:
        # Whether it may write them all is asked before the first.
        services._call.changes(*((node.to_string(), value.Value) for node, value in zip(nodes, values, strict=True)))
        return [
            status
            for node, value in zip(nodes, values, strict=True)
            for status in await genuine(services, [node], [value])
        ]

    Services.write = singly


@choice("reads other nodes with every node", "nobody forbids to read more")
def reads_more_than_asked(server: AdapterServer) -> None:
    async def more(services: Services, nodes: Sequence[ua.NodeId], genuine: Any) -> Any:
        return (await genuine(services, [*nodes, *SENSORS]))[: len(nodes)]

    other_reads(more)


@choice("registers nodes before it reads them", "OPC 10000-4, section 5.9.5")
def registers_nodes(server: AdapterServer) -> None:
    async def registered(services: Services, nodes: Sequence[ua.NodeId], genuine: Any) -> Any:
        call = services._call
        known = await services._session.request(
            call, lambda client: client.register_nodes(list(nodes)), items=len(nodes)
        )
        return await genuine(services, known)

    other_reads(registered)


@choice("asks again when the server does not know a node", "a read may be repeated; meta.attempts says so")
def asks_twice_for_a_missing_node(server: AdapterServer) -> None:
    wrap(server, "read_opcua_node", twice_where_missing)


# -- in the background ------------------------------------------------------------------------------------------------


def polling(nodes: list[ua.NodeId], seconds: float) -> Callable[[AdapterServer], None]:
    def apply(server: AdapterServer) -> None:
        link = link_of(server)

        async def poll() -> None:
            await asyncio.sleep(seconds)
            call = background_call(server)
            await link.perform(call, lambda session: Services(session, call).read(nodes))

        in_background(server, poll)

    return apply


@choice(
    "polls the sensors that the tasks read, fifty times a second",
    "nobody forbids polling",
    described=POLLING_BESIDE_CALLS,
)
def polls_the_same_nodes(server: AdapterServer) -> None:
    polling(SENSORS, 0.02)(server)


@choice("watches the server's state", "reading changes nothing")
def watches_the_server(server: AdapterServer) -> None:
    polling([STATE], 0.1)(server)


# -- refusing ---------------------------------------------------------------------------------------------------------


@choice(
    "has a list of the plant's nodes and refuses what is not in it by itself",
    "a refusal that reaches no server is as good as the server's",
)
def node_list(server: AdapterServer) -> None:
    def known(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            if not arguments.node_id.startswith(NODES_OF_THE_PLANT):
                raise AdapterError("illegal_address", "the list has no such node", outcome="not_sent", field="/node_id")
            return await genuine(call, arguments)

        return handler

    wrap(server, "read_opcua_node", known)


# -- writing ----------------------------------------------------------------------------------------------------------


@choice(
    "writes a SourceTimestamp with the value",
    "OPC 10000-4, section 5.11.4: a client may; servers may refuse it",
    warnings=(TIMESTAMP,),
)
def writes_a_timestamp(server: AdapterServer) -> None:
    async def write(services: Services, nodes: Sequence[ua.NodeId], values: Sequence[ua.Variant]) -> Any:
        now = datetime.now(UTC).replace(tzinfo=None)
        services._call.changes(*((node.to_string(), value.Value) for node, value in zip(nodes, values, strict=True)))
        parameters = ua.WriteParameters(
            NodesToWrite=[
                ua.WriteValue(
                    NodeId=node,
                    AttributeId=ua.AttributeIds.Value,
                    Value=ua.DataValue(value, StatusCode=None, SourceTimestamp=now),
                )
                for node, value in zip(nodes, values, strict=True)
            ]
        )
        statuses = await services._request(lambda client: client.write(parameters), len(nodes), changes=True)
        services._call.answered(service="Write")
        return statuses

    Services.write = write


@choice("reads every value back after it was written", "reading changes nothing; meta.attempts says so")
def reads_back_after_writing(server: AdapterServer) -> None:
    genuine = Services.write

    async def write(services: Services, nodes: Sequence[ua.NodeId], values: Sequence[ua.Variant]) -> Any:
        statuses = await genuine(services, nodes, values)
        await services.read(nodes)
        return statuses

    Services.write = write


@choice("asks for the type before every write", "reading changes nothing; meta.attempts says so")
def asks_for_the_type_every_time(server: AdapterServer) -> None:
    genuine = Services.facts

    async def facts(services: Services, nodes: Sequence[ua.NodeId], fields: Sequence[str]) -> Any:
        services._session.facts.clear()
        return await genuine(services, nodes, fields)

    Services.facts = facts


# -- sessions ---------------------------------------------------------------------------------------------------------


@choice("makes a session for every call", "a session is the adapter's own affair")
def session_per_call(server: AdapterServer) -> None:
    link, alone = link_of(server), asyncio.Lock()
    genuine = link.perform

    async def perform(call: Call, work: Any) -> Any:
        async with alone:
            try:
                return await genuine(call, work)
            finally:
                link._drop(link._connection)

    link.perform = perform


@choice(
    "tries to connect again 1.5 s after it has failed", "requirement REC-001: back within recovery_s, by default 5 s"
)
def backs_off_for_1500_ms(server: AdapterServer) -> None:
    link = link_of(server)
    link._connect = backed_off(link._connect, 1.5)


choice("performs one call after the other", "the order of calls made at the same time is the adapter's own affair")(
    one_call_at_a_time
)


@choice("does not list its writing tools where writes are disabled", "what is not there cannot be used")
def guard_by_hiding(server: AdapterServer) -> None:
    if not server.writes_enabled:
        server._tools = {name: tool for name, tool in server._tools.items() if not tool.writes}


@choice("says more about the values that it reads", "data is open")
def further_members(server: AdapterServer) -> None:
    def extended(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            data = await genuine(call, arguments)
            return {**data, "engineering_unit": None, "historised": False}

        return handler

    tool = server._tools["read_opcua_node"]
    listing = tool.listing.model_copy(update={"output_schema": None})
    server._tools["read_opcua_node"] = dataclasses.replace(tool, handler=extended(tool.handler), listing=listing)


@choice("gives every integer of 64 bits as its digits, also a small one", "OPC 10000-6, section 5.4.2.3")
def long_integers_as_texts(server: AdapterServer) -> None:
    def spelt(value: Any) -> Any:
        return list(map(spelt, value)) if isinstance(value, list) else str(value)

    def extended(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            data = await genuine(call, arguments)
            for one in data.get("items", [data]):
                if one.get("data_type") in ("Int64", "UInt64"):
                    one["value"] = spelt(one["value"])
            return data

        return handler

    for name in ("read_opcua_node", "read_multiple_opcua_nodes"):
        tool = server._tools[name]
        listing = tool.listing.model_copy(update={"output_schema": None})
        server._tools[name] = dataclasses.replace(tool, handler=extended(tool.handler), listing=listing)


@choice("gives a localized text as an object with text and locale", "OPC 10000-6, section 5.4.2.11")
def localized_texts_as_objects(server: AdapterServer) -> None:
    def extended(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            data = await genuine(call, arguments)
            if data["data_type"] != "LocalizedText":
                return data
            return {**data, "value": {"Locale": None, "Text": data["value"]}}

        return handler

    tool = server._tools["read_opcua_node"]
    listing = tool.listing.model_copy(update={"output_schema": None})
    server._tools["read_opcua_node"] = dataclasses.replace(tool, handler=extended(tool.handler), listing=listing)


choice(
    "performs one call after the other, and does not hear of cancellations",
    "MCP, Cancellation: a receiver may ignore them; a write that waits for its turn should not be carried out any more",
    checked_warnings=(("TMO-003", "cancelled_write"),),
)(deaf_to_cancellation)
