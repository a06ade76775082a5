"""Honest PROFINET adapters."""

from __future__ import annotations

import asyncio
from typing import Any

from pytest_otmcp.reference_adapters.core import AdapterServer, Call
from pytest_otmcp.reference_adapters.defects.defect import wrap
from pytest_otmcp.reference_adapters.profinet.controller import Controller, Exchange
from pytest_otmcp.reference_adapters.profinet.network import Station
from pytest_otmcp.reference_adapters.profinet.wire import (
    CONNECT,
    IDENTIFY,
    MULTICAST,
    READ,
    RELEASE,
    control,
    record_header,
    relation,
)

from .choice import again_after_silence, background_call, choices, in_background, one_call_at_a_time

__all__ = ["CHOICES"]

CHOICES, choice = choices("profinet")

DEVICE = "kit-device"
READS = ("read_io_data", "read_device_by_alias", "read_record")


def controller_of(server: AdapterServer) -> Controller:
    controller: Controller = server._tools["ping"].handler.__self__._controller
    return controller


# -- stations ---------------------------------------------------------------------------------------------------------


@choice("looks for the station before every call of it", "an Identify changes nothing; meta.attempts says so")
def identifies_before_every_call(server: AdapterServer) -> None:
    controller = controller_of(server)
    genuine = controller.station

    async def station(call: Call, name: str, *, fresh: bool = False) -> Station:
        return await genuine(call, name, fresh=True)

    controller.station = station


@choice("looks for all stations once a second", "a supervisor shows which stations there are")
def looks_for_stations(server: AdapterServer) -> None:
    controller = controller_of(server)

    async def look() -> None:
        await asyncio.sleep(1.0)
        await controller.network.discover(background_call(server), ((0xFF, 0xFF), b""), IDENTIFY, MULTICAST, 0.1)

    in_background(server, look)


choice("performs one call after the other", "the order of calls made at the same time is the adapter's own affair")(
    one_call_at_a_time
)


# -- reading ----------------------------------------------------------------------------------------------------------


@choice(
    "reads records over a relation of a supervisor, which it makes and gives up for each",
    "a Connect without cyclic data owns nothing",
)
def reads_as_a_supervisor(server: AdapterServer) -> None:
    controller = controller_of(server)

    async def read(call: Call, name: str, place: tuple[int, int], index: int) -> bytes:
        identifier = b"supervisor-of-it"
        await controller._called(call, name, CONNECT, relation(6, identifier, controller.network.mac))
        try:
            asked = record_header(0x0009, identifier, *place, index, 4096)
            answer = await controller._called(call, name, READ, asked)
            return controller._of_record(answer, 0x8009, place, index)
        finally:
            await controller._called(call, name, RELEASE, control(0x0114, identifier, 4))

    controller.read = read
    one_call_at_a_time(server)


@choice("reads inputs twice and answers the second result", "a read may be repeated; meta.attempts says so")
def repeated_reads(server: AdapterServer) -> None:
    controller = controller_of(server)
    genuine = controller.inputs

    async def inputs(call: Call, name: str, place: tuple[int, int]) -> bytes:
        await genuine(call, name, place)
        return await genuine(call, name, place)

    controller.inputs = inputs


@choice(
    "waits for the next cyclic frame and answers its inputs, where it is the device's controller",
    "a controller gets inputs in every cycle; one that comes during the call is no older than the call",
)
def inputs_of_the_next_frame(server: AdapterServer) -> None:
    controller = controller_of(server)
    genuine, heard = controller.inputs, controller._heard
    latest: dict[bytes, bytes] = {}

    def keep(source: bytes, payload: bytes) -> None:
        latest[source] = payload
        heard(source, payload)

    async def inputs(call: Call, name: str, place: tuple[int, int]) -> bytes:
        exchange = controller.exchanges.get(name)
        held = controller.devices[name].subslots.get(place) if exchange is not None else None
        if exchange is None or held is None or not held.inputs or exchange.state != "data_exchange":
            return await genuine(call, name, place)
        # Its own frames ask for the next inputs. The frame that is on its way may have left before the call: the next but one has not.
        call.connection(generation=controller.network._generation, fresh=False)
        call.sending(changes_state=False)
        call.trace = {"service": "Inputs", "slot": place[0], "subslot": place[1]}
        for _ in range(2):
            if not await controller._is_there(exchange):
                return await genuine(call, name, place)
        assert exchange.station is not None
        assert exchange.inputs is not None
        begin = 2 + exchange.inputs.data[place]
        call.answered()
        return latest[exchange.station.mac][begin : begin + held.inputs]

    controller.inputs, controller.network.cyclic = inputs, keep


@choice(
    "waits half as long and reads a second time when the device was silent",
    "requirement TMO-002: a read may be repeated; meta.attempts says so",
)
def reads_again_after_silence(server: AdapterServer) -> None:
    controller_of(server).network.timeout_s /= 2
    again_after_silence(server, *READS)


@choice("reads the inputs of a slot ten times a second", "a supervisor may read at any time")
def polls_the_same_inputs(server: AdapterServer) -> None:
    controller = controller_of(server)

    async def poll() -> None:
        await asyncio.sleep(0.1)
        await controller.inputs(background_call(server), DEVICE, (3, 1))

    in_background(server, poll)


@choice("reads I&M0 as a ping", "any answer of the device is one")
def ping_by_identification(server: AdapterServer) -> None:
    controller = controller_of(server)

    async def ping(call: Call, arguments: Any) -> dict[str, Any]:
        await controller.identification(call, DEVICE)
        return {"reachable": True, "device_name": DEVICE}

    wrap(server, "ping", lambda genuine: ping)


# -- writing ----------------------------------------------------------------------------------------------------------


@choice("sends outputs every 256 ms", "the cycle is the controller's to say")
def slow_cycle(server: AdapterServer) -> None:
    controller = controller_of(server)
    controller.cycle_s, controller._factor = 0.256, 7
    controller.watchdog_s = 0.256 * 7


@choice(
    "believes that outputs were taken when the device goes on sending inputs, and does not read them back",
    "the consumer status in the inputs is the device's word that it has taken the outputs",
)
def believes_the_inputs(server: AdapterServer) -> None:
    controller = controller_of(server)

    async def verified(call: Call, name: str, place: tuple[int, int], outputs: bytes) -> bytes:
        for _ in range(2):
            await controller._is_there(controller.exchanges[name])
        call.answered()
        return outputs

    controller._verified = verified


@choice(
    "leaves it to the watchdog to clear the outputs when it ends",
    "outputs fall with their controller, one way or another",
)
def ends_without_release(server: AdapterServer) -> None:
    controller = controller_of(server)

    def nothing(exchange: Exchange) -> None:
        return

    controller._release = nothing


@choice("reads a record before it writes it", "reading changes nothing; meta.attempts says so")
def reads_before_writing(server: AdapterServer) -> None:
    controller = controller_of(server)
    genuine = controller.write

    async def write(call: Call, name: str, place: tuple[int, int], index: int, content: bytes) -> None:
        question = background_call(server)
        try:
            await controller.read(question, name, place, index)
        finally:
            call.attempts += question.attempts
        await genuine(call, name, place, index, content)

    controller.write = write
