"""Honest PROFIBUS DP adapters."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from typing import Annotated, Any

from pydantic import Field
from pytest_otmcp.reference_adapters.core import AdapterError, AdapterServer, Call
from pytest_otmcp.reference_adapters.defects.defect import Handler, wrap
from pytest_otmcp.reference_adapters.profibus.master import Master, _watchdog_factors
from pytest_otmcp.reference_adapters.profibus.shapes import InputsOf, WriteOutputs
from pytest_otmcp.reference_adapters.profibus.telegram import Telegram
from pytest_otmcp.reference_adapters.profibus.tools import Tools

from .choice import (
    again_after_silence,
    background_call,
    choices,
    in_background,
    one_call_at_a_time,
    one_connection_per_call,
)

__all__ = ["CHOICES"]

CHOICES, choice = choices("profibus")

VALVES = 5
"""A slave that the slave map has."""
READS = ("read_inputs", "read_slave_by_alias", "read_diagnosis")
_TOKEN = 0xDC


def tools_of(server: AdapterServer) -> Tools:
    tools: Tools = server._tools["ping"].handler.__self__
    return tools


def master_of(server: AdapterServer) -> Master:
    return tools_of(server)._master


# -- the line ---------------------------------------------------------------------------------------------------------


@choice("opens the line for every call, unless it keeps outputs alive", "a line is opened and closed by its master")
def line_per_call(server: AdapterServer) -> None:
    master = master_of(server)

    async def close() -> None:
        if all(exchange.state != "data_exchange" for exchange in master.exchanges.values()):
            master.line.close()

    one_connection_per_call(server, close)


@choice("is the master with the address 30", "a master has any address that no other station has")
def another_address(server: AdapterServer) -> None:
    master_of(server).line.address = 30


@choice(
    "passes the token to itself fifty times a second", "a master that is alone in its ring passes the token to itself"
)
def passes_the_token(server: AdapterServer) -> None:
    line = master_of(server).line

    async def token() -> None:
        await asyncio.sleep(0.02)
        async with line.lock:
            if line._file is not None and not line._gone:
                os.write(line._file, bytes([_TOKEN, line.address, line.address]))

    in_background(server, token)


@choice(
    "asks one address after the other for its FDL status in the background, ten a second",
    "a master looks for new stations (GAP update)",
)
def looks_for_stations(server: AdapterServer) -> None:
    line = master_of(server).line
    addresses = [0]

    async def look() -> None:
        await asyncio.sleep(0.1)
        addresses[0] = (addresses[0] + 1) % 126
        if addresses[0] != line.address:
            await line.ask_status(background_call(server), addresses[0], 0.01, after_another=False)

    in_background(server, look)


@choice("waits 2 ms at each address of a scan", "the slot time follows from the baud rate")
def shorter_slot_time(server: AdapterServer) -> None:
    tools_of(server)._slot_s = 0.002


@choice("scans from the last address to the first", "the order of a scan is the master's own affair")
def scans_backwards(server: AdapterServer) -> None:
    tools = tools_of(server)

    async def scan(call: Call, arguments: Any) -> Any:
        found: dict[int, Any] = {}
        for address in range(arguments.last_address, arguments.first_address - 1, -1):
            found |= {one["address"]: one for one in await tools._ask(call, address, tools._slot_s)}
        return {"stations": [found[address] for address in sorted(found)]}

    wrap(server, "scan_bus", lambda genuine: scan)


@choice(
    "sends a telegram again with its frame count bit when half of its time is over, one that drives a slave, too",
    "IEC 61158-4-3: a station knows a repeated request by its frame count bit; meta.attempts says so",
)
def repeats_with_its_frame_count_bit(server: AdapterServer) -> None:
    line = master_of(server).line
    genuine = line._ask

    async def ask(call: Call | None, telegram: Telegram, timeout_s: float, **more: Any) -> Telegram:
        station = telegram.destination
        assert station is not None
        counts = line._counts.get(station)
        try:
            return await genuine(call, telegram, timeout_s / 2, **more)
        except AdapterError as error:
            if error.code != "timeout" or counts is None:
                raise
        line._unsure.discard(station)
        line._counts[station] = counts
        return await genuine(call, telegram, timeout_s / 2, **more)

    line._ask = ask


choice("performs one call after the other", "the order of calls made at the same time is the adapter's own affair")(
    one_call_at_a_time
)


# -- reading ----------------------------------------------------------------------------------------------------------


def before_reading(server: AdapterServer, look: Callable[[Call, int], Any]) -> None:
    master = master_of(server)
    genuine = master.inputs

    async def inputs(call: Call, station: int) -> bytes:
        await look(call, station)
        return await genuine(call, station)

    master.inputs = inputs


@choice("asks for the diagnosis before each read of inputs", "a diagnosis changes nothing; meta.attempts says so")
def diagnosis_before_reading(server: AdapterServer) -> None:
    before_reading(server, master_of(server).diagnosis)


@choice("reads inputs twice and answers the second result", "a read may be repeated; meta.attempts says so")
def repeated_reads(server: AdapterServer) -> None:
    before_reading(server, master_of(server).inputs)


@choice(
    "reads the inputs of a slave that it drives by a Data_Exchange with the outputs that it has",
    "a master of class 1 gets inputs with every exchange; the outputs stay what they are",
)
def inputs_by_data_exchange(server: AdapterServer) -> None:
    master = master_of(server)
    genuine = master.inputs

    async def inputs(call: Call, station: int) -> bytes:
        exchange = master.exchanges.get(station)
        if exchange is None or exchange.state != "data_exchange":
            return await genuine(call, station)
        async with exchange.lock:
            # Who has been silent may have been restarted; see the cycle.
            if exchange.state != "data_exchange" or exchange.doubted:
                return await genuine(call, station)
            telegram = master._telegram(station, "Data_Exchange", exchange.outputs, control=0x4D)
            answer = await master.line.exchange(call, telegram, timeout_s=master.line.timeout_s)
            if answer.function not in (0x8, 0xA):
                exchange.lose("the slave has refused to exchange data")
                return await genuine(call, station)
            return master._of_length(station, answer.data, "input")

    master.inputs = inputs


@choice(
    "waits half as long and reads a second time when the slave was silent",
    "requirement TMO-002: a read may be repeated; meta.attempts says so",
)
def reads_again_after_silence(server: AdapterServer) -> None:
    master_of(server).line.timeout_s /= 2
    again_after_silence(server, *READS)


@choice("reads the inputs of a slave three times a second", "a master of class 2 may read at any time")
def polls_the_same_inputs(server: AdapterServer) -> None:
    master = master_of(server)

    async def poll() -> None:
        # Nobody else can use the line while it waits for a slave that is not there, and a scan of all addresses takes 1.3 s of the 2.8 s
        # of a call; an answer that comes later would be the next one's.
        await asyncio.sleep(0.3)
        telegram = master._telegram(VALVES, "RD_Inp", b"", control=0x4D)
        await master.line.exchange(background_call(server), telegram, timeout_s=0.5)

    in_background(server, poll)


@choice("asks a slave for its diagnosis as a ping", "any answer of a slave is one")
def ping_by_a_diagnosis(server: AdapterServer) -> None:
    master = master_of(server)

    async def ping(call: Call, arguments: Any) -> dict[str, Any]:
        await master.diagnosis(call, VALVES)
        return {"reachable": True, "slave_address": VALVES}

    wrap(server, "ping", lambda genuine: ping)


# -- writing ----------------------------------------------------------------------------------------------------------


@choice("gives slaves a watchdog of one second, and repeats outputs every 20 ms", "both are the master's to say")
def short_watchdog(server: AdapterServer) -> None:
    master = master_of(server)
    master.watchdog_s, master.cycle_s = 1.0, 0.02
    master._factors = _watchdog_factors(1.0)


@choice(
    "leaves it to the watchdog to clear the outputs when it ends", "outputs fall with their master, one way or another"
)
def ends_without_clearing(server: AdapterServer) -> None:
    server._close = ended_quietly(master_of(server))


def ended_quietly(master: Master) -> Callable[[], Any]:
    async def close() -> None:
        for exchange in master.exchanges.values():
            exchange.lose("the adapter has ended")
        await Master.close(master)

    return close


@choice(
    "sends the parameters of a slave twice before it configures it",
    "a slave takes parameters again until it exchanges data",
)
def parameters_twice(server: AdapterServer) -> None:
    master = master_of(server)
    genuine = master._command

    async def command(call: Call, station: int, service: str, data: bytes) -> None:
        await genuine(call, station, service, data)
        if service == "Set_Prm":
            await genuine(call, station, service, data)

    master._command = command


@choice(
    "believes a slave's answer to a Data_Exchange, and does not read its outputs back",
    "an answer with inputs is the slave's word that it has taken the outputs",
)
def believes_the_exchange(server: AdapterServer) -> None:
    async def verified(call: Call, station: int, outputs: bytes) -> bytes:
        return outputs

    master_of(server)._verified = verified


@choice("reads the outputs that a slave has before it writes them", "reading changes nothing; meta.attempts says so")
def reads_before_writing(server: AdapterServer) -> None:
    master = master_of(server)
    genuine = master._take

    async def take(call: Call, station: int, exchange: Any) -> None:
        await genuine(call, station, exchange)
        question = background_call(server)
        try:
            await master.outputs(question, station)
        finally:
            call.attempts += question.attempts

    master._take = take


@choice(
    "reads the configuration of a slave before it parameterises it, and refuses one that the slave map does not have",
    "a refusal that drives nothing is as good as the slave's",
)
def checks_the_configuration(server: AdapterServer) -> None:
    master = master_of(server)

    def looked(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            station = getattr(arguments, "slave_address", None)
            slave = master.slaves.get(station) if station is not None else None
            if slave is not None and len(getattr(arguments, "data", b"")) == slave.output_length:
                question = background_call(server)
                try:
                    held = await master.configuration(question, station)
                except AdapterError as error:
                    raise AdapterError(error.code, error.message, outcome="not_sent") from None
                finally:
                    call.attempts += question.attempts
                    call._used, call.trace = question._used, question.trace
                if held != slave.cfg:
                    message = "the slave has another configuration than the slave map says"
                    raise AdapterError("config_error", message, outcome="not_sent")
            return await genuine(call, arguments)

        return handler

    wrap(server, "write_outputs", looked)


class AnyInputs(InputsOf):
    """The inputs of a station with any address that fits into a telegram."""

    slave_address: Annotated[int, Field(ge=0, le=127)]


class AnyOutputs(WriteOutputs):
    """The outputs of such a station."""

    slave_address: Annotated[int, Field(ge=0, le=127)]


@choice(
    "asks the line for stations 126 and 127 as well, and says that they do not answer",
    "EN 50170 volume 2: 126 is the address of a station that has none yet; what no station has is silent",
)
def asks_for_any_station(server: AdapterServer) -> None:
    master = master_of(server)

    def looked(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            if arguments.slave_address in (126, 127):
                await master.line.ask_status(call, arguments.slave_address, 0.1, after_another=False)
                message = "no station with this address answers"
                raise AdapterError("timeout", message, outcome="not_sent" if call.writes else None)
            return await genuine(call, arguments)

        return handler

    wrap(server, "read_inputs", looked, model=AnyInputs)
    wrap(server, "write_outputs", looked, model=AnyOutputs)
