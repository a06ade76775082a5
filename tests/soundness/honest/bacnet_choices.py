"""Honest BACnet adapters."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import Any

from bacpypes3.apdu import (
    ConfirmedRequestPDU,
    IAmRequest,
    ReadPropertyMultipleRequest,
    SubscribeCOVRequest,
    WhoIsRequest,
    WritePropertyMultipleError,
    WritePropertyMultipleRequest,
)
from bacpypes3.appservice import ABORTED, ClientSSM
from bacpypes3.basetypes import PropertyReference, PropertyValue, ReadAccessSpecification, WriteAccessSpecification
from bacpypes3.pdu import Address
from bacpypes3.primitivedata import ObjectIdentifier
from pytest_otmcp.reference_adapters.bacnet import link as bacnet_link
from pytest_otmcp.reference_adapters.bacnet import tools as bacnet_tools
from pytest_otmcp.reference_adapters.bacnet.refusals import refusal
from pytest_otmcp.reference_adapters.bacnet.shapes import PropertyOf
from pytest_otmcp.reference_adapters.bacnet.tools import Tools, _shown, _trace
from pytest_otmcp.reference_adapters.bacnet.values import Read, known_property, object_type, primitives
from pytest_otmcp.reference_adapters.core import AdapterError, AdapterServer, Call, Lost
from pytest_otmcp.reference_adapters.defects.defect import Handler, wrap

from .choice import (
    background_call,
    choices,
    in_background,
    one_call_at_a_time,
    one_connection_per_call,
    twice_where_missing,
)

__all__ = ["CHOICES"]

CHOICES, choice = choices("bacnet")

DEVICE = 12345
"""Instance of the device that an adapter has been told of."""
READS = ("read_property", "read_object_by_alias")


def tools_of(server: AdapterServer) -> Tools:
    tools: Tools = server._tools["ping"].handler.__self__
    return tools


def when_opened(server: AdapterServer, change: Callable[[Any], None]) -> None:
    """Change the application of the library as soon as there is one."""
    link = tools_of(server)._link
    genuine = link._opened

    async def opened() -> Any:
        is_new = link._client is None
        client, target = await genuine()
        if is_new:
            change(client)
        return client, target

    link._opened = opened


# -- reading ----------------------------------------------------------------------------------------------------------


def by_read_property_multiple(server: AdapterServer, references: Callable[[str], Sequence[str]]) -> None:
    """Let the adapter read by ReadPropertyMultiple, and ask for these properties where one is wanted."""
    tools = tools_of(server)

    async def read(call: Call, device: int | None, asked: PropertyOf) -> list[Read]:
        number = known_property(asked.property_id)
        identifier = ObjectIdentifier((object_type(asked.object_type), asked.object_instance))
        named = [asked.property_id] if asked.array_index is not None else references(asked.property_id)
        wanted = [PropertyReference(propertyIdentifier=known_property(name)) for name in named]
        if asked.array_index is not None:
            wanted[0].propertyArrayIndex = asked.array_index

        def request(address: Address) -> ReadPropertyMultipleRequest:
            one = ReadAccessSpecification(objectIdentifier=identifier, listOfPropertyReferences=wanted)
            return ReadPropertyMultipleRequest(listOfReadAccessSpecs=[one], destination=address)

        _trace(call, asked)
        answer = await tools._link.ask(call, device, request)
        results = list(getattr(answer, "listOfReadAccessResults", None) or ())
        if len(results) != 1 or (results[0].objectIdentifier != identifier and device is not None):
            raise AdapterError("protocol_error", "the device answered about another object than it was asked for")
        (found,) = results
        errors = []
        for one in found.listOfResults:
            if one.readResult.propertyAccessError is not None:
                errors.append(one.readResult.propertyAccessError)
            elif (one.propertyIdentifier, one.propertyArrayIndex) == (number, asked.array_index):
                return primitives(one.readResult.propertyValue)
        if errors:
            raise refusal(call, errors[0])
        raise AdapterError("protocol_error", "the device answered about another property than it was asked for")

    tools._read = read


@choice("reads by ReadPropertyMultiple", "ASHRAE 135, clause 15.7: a read of one property, too")
def reads_by_multiple(server: AdapterServer) -> None:
    by_read_property_multiple(server, lambda name: [name])


@choice(
    "reads the status flags and the name with every present value", "reading more than was asked for changes nothing"
)
def reads_with_status_flags(server: AdapterServer) -> None:
    by_read_property_multiple(
        server, lambda name: [name, "status-flags", "object-name"] if name == "present-value" else [name]
    )


@choice(
    "reads all properties of an object and answers one",
    "ASHRAE 135, clause 15.7: the property 'all' stands for every property",
)
def reads_all_properties(server: AdapterServer) -> None:
    by_read_property_multiple(server, lambda name: ["all"] if name == "present-value" else [name])


@choice("reads everything twice and answers the second result", "a read may be repeated; meta.attempts says so")
def repeated_reads(server: AdapterServer) -> None:
    tools = tools_of(server)
    genuine = tools._read

    async def read(call: Call, device: int | None, asked: PropertyOf) -> list[Read]:
        await genuine(call, device, asked)
        return await genuine(call, device, asked)

    tools._read = read


@choice("asks again when the device has no such object", "a read may be repeated; meta.attempts says so")
def asks_twice_for_a_missing_object(server: AdapterServer) -> None:
    for name in READS:
        wrap(server, name, twice_where_missing)


@choice(
    "reads the device's list of objects before it reads or writes one, and refuses by itself what is not in it",
    "a refusal that reaches no device is as good as the device's",
)
def lists_before_reading(server: AdapterServer) -> None:
    tools = tools_of(server)

    def looked(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            wanted = {"object_type": arguments.object_type, "object_instance": arguments.object_instance}
            question = background_call(server)
            try:
                listed = await tools.list_objects(question, arguments)
            finally:
                call.attempts += question.attempts
                call._used, call.trace = question._used, question.trace
            if wanted not in listed["objects"]:
                raise AdapterError("illegal_address", "the device lists no such object", outcome="not_sent")
            return await genuine(call, arguments)

        return handler

    for name in ("read_property", "write_property"):
        wrap(server, name, looked)


@choice(
    "takes answers of up to 206 bytes, and lists objects one by one", "the size of an answer is the client's to say"
)
def small_answers(server: AdapterServer) -> None:
    def small(client: Any) -> None:
        client.asap.device_object.maxApduLengthAccepted = 206

    when_opened(server, small)


@choice("polls the objects that the tasks read, fifty times a second", "nobody forbids polling")
def polls_the_same_objects(server: AdapterServer) -> None:
    tools = tools_of(server)

    async def poll() -> None:
        await asyncio.sleep(0.02)
        for kind in ("analog-input", "analog-output"):
            asked = PropertyOf(device_id=DEVICE, object_type=kind, object_instance=1, property_id="present-value")
            await tools._read(background_call(server), DEVICE, asked)

    in_background(server, poll)


@choice(
    "subscribes to changes of value in the background, again and again, whatever the device says to it",
    "a subscription changes a list that is the client's own",
)
def subscribes_to_changes(server: AdapterServer) -> None:
    link = tools_of(server)._link

    def request(address: Address) -> ConfirmedRequestPDU:
        return SubscribeCOVRequest(
            subscriberProcessIdentifier=1,
            monitoredObjectIdentifier=ObjectIdentifier((object_type("analog-input"), 1)),
            issueConfirmedNotifications=False,
            lifetime=60,
            destination=address,
        )

    async def subscribe() -> None:
        await asyncio.sleep(0.1)
        await link.ask(background_call(server), DEVICE, request)

    in_background(server, subscribe)


# -- finding ----------------------------------------------------------------------------------------------------------


@choice("asks Who-Is as a ping", "any answer of the device is one")
def ping_by_who_is(server: AdapterServer) -> None:
    link = tools_of(server)._link

    async def ping(call: Call, arguments: Any) -> dict[str, Any]:
        link._addresses.clear()
        await link._address_of(call, DEVICE)
        return {"reachable": True, "device_id": DEVICE}

    wrap(server, "ping", lambda genuine: ping)


@choice("asks Who-Is before every request", "finding a device changes nothing; meta.attempts says so")
def who_is_before_each_request(server: AdapterServer) -> None:
    link = tools_of(server)._link
    genuine = link._exchange

    async def exchange(call: Call, device: int | None, *arguments: Any, **more: Any) -> Any:
        link._addresses.clear()
        return await genuine(call, device, *arguments, **more)

    link._exchange = exchange


@choice("finds a device by asking all of them who they are", "ASHRAE 135, clause 16.10: the bounds are optional")
def who_is_without_bounds(server: AdapterServer) -> None:
    link = tools_of(server)._link
    genuine = link._who_is

    async def who_is(call: Call, heard: Callable[[IAmRequest], None], wait: Any, device: int | None = None) -> None:
        await genuine(call, heard, wait)

    link._who_is = who_is


@choice(
    "knows the address of its device by its configuration, and of no other device",
    "a refusal that reaches no device is as good as the device's",
)
def static_addresses(server: AdapterServer) -> None:
    link = tools_of(server)._link

    async def address_of(call: Call, device: int) -> Address:
        if device != DEVICE:
            message = "the configuration has no such device"
            raise AdapterError("illegal_address", message, field="/device_id", outcome="not_sent")
        _, target = await link._opened()
        return target

    link._address_of = address_of


@choice("asks every half second who is there", "finding devices changes nothing")
def discovers_in_background(server: AdapterServer) -> None:
    link = tools_of(server)._link

    async def discover() -> None:
        await asyncio.sleep(0.5)
        client, target = await link._opened()
        client.request(WhoIsRequest(destination=target))

    in_background(server, discover)


# -- requests ---------------------------------------------------------------------------------------------------------


@choice(
    "sends a request again with the invoke id that it had, a write too, until its call ends",
    "ASHRAE 135, clause 5.4: a client repeats a request whose answer did not come, and the device knows it by its invoke id",
)
def repeats_with_its_invoke_id(server: AdapterServer) -> None:
    link = tools_of(server)._link
    genuine, again = link._exchange, ClientSSM.await_confirmation_timeout
    calls: list[Call] = []

    def repeating(client: Any) -> None:
        client.asap.device_object.numberOfApduRetries = 1
        client.asap.device_object.apduTimeout = int(link._timeout_s * 500)

    async def counted(transaction: Any) -> None:
        if transaction.retryCount < transaction.numberOfApduRetries:
            for call in calls:
                call.attempts += transaction.invokeID in call.trace.get("invoke_ids", ())
        await again(transaction)

    async def exchange(call: Call, *arguments: Any, **more: Any) -> Any:
        calls.append(call)
        try:
            return await genuine(call, *arguments, **more)
        finally:
            calls.remove(call)
            # Nothing is repeated for a call that has ended.
            client, _ = await link._opened()
            for transaction in list(client.asap.clientTransactions):
                if transaction.invokeID in call.trace.get("invoke_ids", ()):
                    transaction.set_state(ABORTED)

    async def only_one(call: Call, attempt: Any) -> Any:
        try:
            return await attempt()
        except Lost as lost:
            raise lost.error from None

    link._exchange = exchange
    ClientSSM.await_confirmation_timeout = counted
    bacnet_link.repeat_once, bacnet_link._TRANSMISSIONS = only_one, 1
    when_opened(server, repeating)


@choice("begins to count its requests at 250", "an invoke id is the client's, and comes back to 0 after 255")
def invoke_ids_that_wrap(server: AdapterServer) -> None:
    def begun(client: Any) -> None:
        client.next_invoke_id = 250

    when_opened(server, begun)


@choice("uses a socket of its own for every call", "a port is the client's own affair")
def socket_per_call(server: AdapterServer) -> None:
    link = tools_of(server)._link

    async def end() -> None:
        client, link._client = link._client, None
        if client is not None:
            client.link.close()

    one_connection_per_call(server, end)


choice("performs one call after the other", "the order of calls made at the same time is the adapter's own affair")(
    one_call_at_a_time
)


# -- writing ----------------------------------------------------------------------------------------------------------


@choice(
    "reads the present value alone after a write, and tells it with success, whichever priority it comes from",
    "who tells which value is in effect has not said that it is the one that was written",
)
def tells_what_is_in_effect(server: AdapterServer) -> None:
    tools = tools_of(server)

    async def verified(call: Call, asked: Any, value: Any, priority: int) -> Any:
        trace = {name: call.trace[name] for name in call.trace if name != "invoke_ids"}
        try:
            found = await tools._read(call, asked.device_id, asked)
        except AdapterError as error:
            raise AdapterError(error.code, error.message, outcome="unknown") from None
        call.trace |= trace
        return {
            "device_id": asked.device_id,
            "object_type": asked.object_type,
            "object_instance": asked.object_instance,
            "property_id": asked.property_id,
            "value": asked.value,
            "present_value": _shown(call, "/data/present_value", asked, found)["value"],
            "priority": None,
            "winning_priority": None,
        }

    tools._verified = verified


@choice("reads every object before it is written", "reading changes nothing; meta.attempts says so")
def reads_before_writing(server: AdapterServer) -> None:
    tools = tools_of(server)
    genuine = tools._write

    async def write(call: Call, asked: Any) -> Any:
        await tools._read(call, asked.device_id, asked)
        return await genuine(call, asked)

    tools._write = write


def as_several_writes(
    *, objectIdentifier: Any, propertyIdentifier: Any, propertyValue: Any, priority: int, destination: Address
) -> WritePropertyMultipleRequest:
    """Return a WritePropertyMultiple with the one write that a WriteProperty of these members has."""
    value = PropertyValue(propertyIdentifier=propertyIdentifier, value=propertyValue, priority=priority)
    specification = WriteAccessSpecification(objectIdentifier=objectIdentifier, listOfProperties=[value])
    return WritePropertyMultipleRequest(listOfWriteAccessSpecs=[specification], destination=destination)


@choice("writes by WritePropertyMultiple", "ASHRAE 135, clause 15.10: a write of one property, too")
def writes_by_multiple(server: AdapterServer) -> None:
    genuine = refusal

    def explained(call: Call, error: Any) -> AdapterError:
        if isinstance(error, WritePropertyMultipleError):
            error.errorClass, error.errorCode = error.errorType.errorClass, error.errorType.errorCode
        return genuine(call, error)

    bacnet_tools.WritePropertyRequest = as_several_writes
    bacnet_link.refusal = explained
