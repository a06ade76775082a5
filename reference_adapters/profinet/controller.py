"""The controller: stations by their names, records, and the relations that keep outputs alive.

What was sent once falls at the device's watchdog. So outputs are repeated until the adapter ends or the device is lost: silent for as long as
its watchdog, refusing, or another controller's. A lost device is not taken back by itself, because its outputs would move when nobody has
asked for it; and a write that was not confirmed is not repeated, because only the device knows whether it was carried out.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from ..core import AdapterError, Call
from .maps import DeviceEntry, ModuleEntry
from .network import Network, Station
from .refusals import dcp_refusal
from .wire import (
    CONNECT,
    CONTROL,
    IDENTIFY,
    IDS,
    IP,
    MULTICAST,
    NAME,
    READ_IMPLICIT,
    RELEASE,
    RESULT,
    SET,
    VENDOR,
    WRITE,
    Answer,
    Discovered,
    Layout,
    Request,
    block,
    blocks_in,
    control,
    cyclic_frame,
    layout,
    record_header,
    relation,
)

__all__ = ["Controller", "Place"]

Place = tuple[int, int]
"""Slot and subslot."""

_CONTROLLER, _SUPERVISOR = 1, 6
_INPUTS, _OUTPUTS, _IDENTIFICATION = 0x8028, 0x8029, 0xAFF0
_MOST = 4096
_HEADER = 64
_PARAMETERS_END, _READY, _RELEASED = 0x0110, 0x0112, 0x0114
_MODULE_DIFFERENCE, _FRAME_ANSWER = 0x8104, 0x8102
_INPUT_FRAME = 0xC001
_RELEASE_S = 0.3
"""Seconds for which a device that answers has to give a relation up."""
_LATE = 3
"""Cycles without inputs after which a device is not believed to be there."""
_CLOCKS_PER_S = 32_000


@dataclass(slots=True)
class Exchange:
    """Whether the outputs of a device are kept alive.

    Attributes:
        state: ``passive``, nothing is written; ``data_exchange``, the outputs are repeated; ``lost``, they were.
        values: outputs by subslot.
        reason: why the device was lost.
        heard: time of the event loop at which inputs came last.
        news: is set by inputs.
    """

    state: Literal["passive", "data_exchange", "lost"] = "passive"
    values: dict[Place, bytes] = field(default_factory=dict)
    reason: str | None = None
    heard: float = 0.0
    news: asyncio.Event = field(default_factory=asyncio.Event)
    station: Station | None = None
    relation: bytes = b""
    frame_id: int = 0
    inputs: Layout | None = None
    outputs: Layout | None = None
    counter: int = 0
    ready: asyncio.Future[None] | None = None
    cycling: asyncio.Task[None] | None = None
    lock: asyncio.Lock = field(default_factory=asyncio.Lock)

    def lose(self, reason: str) -> None:
        """Repeat the outputs no more."""
        self.state, self.reason = "lost", reason
        if self.cycling is not None:
            self.cycling.cancel()
            self.cycling = None


class Controller:
    """All that is done with the stations of one network.

    Args:
        network: the network.
        devices: the device map.
        cycle_s: seconds between two frames with outputs.
        watchdog_s: seconds after which a device gives up its outputs.
    """

    def __init__(
        self, network: Network, devices: Mapping[str, DeviceEntry], *, cycle_s: float, watchdog_s: float
    ) -> None:
        self.network = network
        self.devices = devices
        self.cycle_s = cycle_s
        self.exchanges = {name: Exchange() for name in devices}
        self._factor = max(_LATE, int(watchdog_s / cycle_s))
        self.watchdog_s = self._factor * cycle_s
        self._known: dict[str, Station] = {}
        network.cyclic = self._heard
        network.ready = self._is_ready

    # -- stations ---------------------------------------------------------------------------------------------

    async def discover(self, call: Call, wait_s: float) -> list[Station]:
        """Return the stations that identify themselves within this time."""
        found = await self.network.discover(call, ((0xFF, 0xFF), b""), IDENTIFY, MULTICAST, wait_s)
        return [_station(one) for one in found]

    async def station(self, call: Call, name: str, *, fresh: bool = False) -> Station:
        """Return the station with a name.

        Args:
            fresh: also one that is known is asked.

        Raises:
            AdapterError: none answers.
        """
        if fresh or name not in self._known:
            found = await self.network.ask(call, MULTICAST, IDENTIFY, (NAME, name.encode("latin-1", "replace")))
            station = _station(found)
            if station.name != name.encode("latin-1", "replace"):
                raise AdapterError("protocol_error", "a station with another name answered")
            self._known[name] = station
        return self._known[name]

    async def any_station(self, call: Call) -> Station:
        """Return the station that answers first."""
        return _station(await self.network.ask(call, MULTICAST, IDENTIFY, ((0xFF, 0xFF), b"")))

    async def set(self, call: Call, mac: bytes, option: tuple[int, int], content: bytes, *, changes: bool) -> None:
        """Set an option of a station.

        Raises:
            AdapterError: silence, or a refusal.
        """
        answer = await self.network.ask(call, mac, SET, (option, content), changes_state=changes)
        if answer.mac != mac or len(result := answer.options.get(RESULT, b"")) < 3:
            raise AdapterError("protocol_error", "the answer to a Set says no result")
        if result[2]:
            raise dcp_refusal(result[2])
        # Its name or address may be another one now.
        self._known = {name: one for name, one in self._known.items() if one.mac != mac}

    # -- records ----------------------------------------------------------------------------------------------

    async def inputs(self, call: Call, name: str, place: Place) -> bytes:
        """Return the inputs of a subslot, whoever is its controller."""
        content = _process_data(await self.read(call, name, place, _INPUTS), 0x0015, 6)
        return self._of_length(name, place, content, "inputs")

    async def outputs(self, call: Call, name: str, place: Place) -> bytes:
        """Return the outputs that a subslot has now, whoever is its controller."""
        content = _process_data(await self.read(call, name, place, _OUTPUTS), 0x0016, 7)
        return self._of_length(name, place, content, "outputs")

    async def identification(self, call: Call, name: str) -> bytes:
        """Return the record I&M0 of a device."""
        (kind, body), *_ = list(blocks_in(await self.read(call, name, (0, 1), _IDENTIFICATION))) or [(0, b"")]
        if kind != 0x0020 or len(body) < 54:
            raise AdapterError("protocol_error", "the device answered something else than I&M0")
        return body

    async def read(self, call: Call, name: str, place: Place, index: int) -> bytes:
        """Return a record."""
        asked = record_header(0x0009, bytes(16), *place, index, _MOST)
        answer = await self._called(call, name, READ_IMPLICIT, asked)
        return self._of_record(answer, 0x8009, place, index)

    async def write(self, call: Call, name: str, place: Place, index: int, content: bytes) -> None:
        """Write a record, over a relation of its own."""
        station = await self.station(call, name)
        identifier = os.urandom(16)
        await self._called(call, name, CONNECT, relation(_SUPERVISOR, identifier, self.network.mac))
        release, answers = control(_RELEASED, identifier, 4), False
        try:
            call.trace |= {"service": "Write", "slot": place[0], "subslot": place[1], "index": index}
            asked = record_header(0x0008, identifier, *place, index, len(content)) + content
            trace = dict(call.trace)
            answer = await self.network.call(call, station, WRITE, asked, changes_state=True)
            call.trace |= trace
            answers = True
            self._of_record(answer, 0x8008, place, index)
        finally:
            # Whether the device hears it does not matter: a supervisor's relation ends by itself as well.
            with contextlib.suppress(AdapterError, TimeoutError):
                if answers:
                    async with asyncio.timeout(_RELEASE_S):
                        await self.network.call(call, station, RELEASE, release)
                else:
                    call.sending(changes_state=False)
                    self.network.send_call(Request(RELEASE, release, station.vendor, station.device), station)

    def _of_record(self, answer: bytes, kind: int, place: Place, index: int) -> bytes:
        found = int.from_bytes(answer[:2])
        where = int.from_bytes(answer[28:30]), int.from_bytes(answer[30:32]), int.from_bytes(answer[34:36])
        if len(answer) < _HEADER or found != kind or where != (*place, index):
            raise AdapterError("protocol_error", "the answer is about another record than the request")
        return answer[_HEADER:]

    async def _called(self, call: Call, name: str, operation: int, blocks: bytes) -> bytes:
        station = await self.station(call, name)
        if station.ip == "0.0.0.0":  # noqa: S104  (it has none)
            raise AdapterError(
                "config_error", "the station has no address yet; set_device_ip gives it one", outcome="not_sent"
            )
        try:
            return await self.network.call(call, station, operation, blocks)
        except AdapterError as error:
            if error.code == "timeout":
                # It may have another address: the next call asks again where it is.
                self._known.pop(name, None)
            raise

    def _of_length(self, name: str, place: Place, content: bytes, area: Literal["inputs", "outputs"]) -> bytes:
        device = self.devices.get(name)
        held = None if device is None else device.subslots.get(place)
        expected = None if held is None else held.inputs if area == "inputs" else held.outputs
        if expected is not None and len(content) != expected:
            message = f"the subslot has {len(content)} bytes of {area}, the device map says {expected}"
            raise AdapterError("protocol_error", message)
        return content

    # -- outputs ----------------------------------------------------------------------------------------------

    async def drive(self, call: Call, name: str, place: Place, change: Callable[[bytes], bytes]) -> bytes:
        """Give a subslot outputs, keep them alive from now on, and return those that it has.

        Args:
            name: a device of the device map.
            change: makes the outputs from those that this controller gives the subslot now.

        Raises:
            AdapterError: ``access_denied``, another controller has the device; ``config_error``, it has other modules than the device map
                says; ``verify_failed``, it has other outputs; and what every request may fail by.
        """
        exchange = self.exchanges[name]
        async with exchange.lock:
            if exchange.state == "data_exchange" and not await self._is_there(exchange):
                exchange.lose("no inputs came")
            if exchange.state != "data_exchange":
                await self._take(call, name, exchange)
            try:
                outputs = change(exchange.values[place])
                call.sending()
                self._send(exchange, {**exchange.values, place: outputs})
                trace = {**call.trace, "service": "Outputs", "slot": place[0], "subslot": place[1]}
                held = await self._verified(call, name, place, outputs)
            except (AdapterError, asyncio.CancelledError):
                # To repeat the old outputs could take back what was written, to repeat the new ones could write it twice.
                exchange.lose("a write was not confirmed")
                raise
            call.trace = trace
            return held

    async def _is_there(self, exchange: Exchange) -> bool:
        """Tell whether a device still sends inputs: one that was restarted, or has ended the relation, takes no outputs and does not say so."""
        exchange.news.clear()
        try:
            async with asyncio.timeout(_LATE * self.cycle_s):
                await exchange.news.wait()
        except TimeoutError:
            return False
        return True

    async def _verified(self, call: Call, name: str, place: Place, outputs: bytes) -> bytes:
        try:
            held = await self.outputs(call, name, place)
        except AdapterError as error:
            message = f"the outputs were sent, and those that the device has could not be read: {error.message}"
            raise AdapterError(error.code, message, outcome="unknown") from None
        if held != outputs:
            message = "the outputs were sent, and the device has others"
            raise AdapterError("verify_failed", message, outcome="unknown", details={"outputs": list(held)})
        return held

    async def _take(self, call: Call, name: str, exchange: Exchange) -> None:
        """Make a relation with cyclic data."""
        device = self.devices[name]
        self.network.listen()
        exchange.station = station = await self.station(call, name, fresh=True)
        if (station.vendor, station.device) != (device.vendor_id, device.device_id):
            message = f"the station is {station.vendor:04X}:{station.device:04X}, the device map says {device.vendor_id:04X}:{device.device_id:04X}"
            raise AdapterError("config_error", message, outcome="not_sent")
        exchange.relation = os.urandom(16)
        lengths = {place: (one.inputs, one.outputs) for place, one in device.subslots.items()}
        exchange.inputs, exchange.outputs = layout(1, lengths), layout(2, lengths)
        ratio = round(self.cycle_s * 1000)
        asked = relation(_CONTROLLER, exchange.relation, self.network.mac)
        asked += exchange.inputs.block(_INPUT_FRAME, ratio, self._factor) + exchange.outputs.block(
            0xFFFF, ratio, self._factor
        )
        asked += _alarms() + b"".join(map(_expected, device.modules))
        answer = list(blocks_in(await self._called(call, name, CONNECT, asked)))
        frames = [int.from_bytes(body[4:6]) for kind, body in answer if kind == _FRAME_ANSWER and body[:2] == b"\0\2"]
        if len(frames) != 1:
            raise AdapterError("protocol_error", "the device says no identifier of frames with outputs")
        exchange.frame_id = frames[0]
        exchange.values = {place: bytes(one.outputs) for place, one in device.subslots.items() if one.outputs}
        if any(kind == _MODULE_DIFFERENCE for kind, _ in answer):
            self._release(exchange)
            message = "the device has other modules than the device map says (ModuleDiffBlock)"
            raise AdapterError("config_error", message, outcome="not_sent")
        loop = asyncio.get_running_loop()
        exchange.state, exchange.reason, exchange.heard = "data_exchange", None, loop.time()
        exchange.ready = loop.create_future()
        exchange.cycling = asyncio.create_task(self._cycle(exchange), name="cycle")
        try:
            await self._called(call, name, CONTROL, control(_PARAMETERS_END, exchange.relation, 1))
            async with asyncio.timeout(self.network.timeout_s):
                await exchange.ready
        except TimeoutError:
            exchange.lose("the application did not become ready")
            raise AdapterError("timeout", "the device does not become ready", outcome="not_sent") from None
        except (AdapterError, asyncio.CancelledError):
            exchange.lose("the relation was not made")
            raise

    # -- the cycle --------------------------------------------------------------------------------------------

    def _send(self, exchange: Exchange, values: Mapping[Place, bytes]) -> None:
        assert exchange.station is not None
        assert exchange.outputs is not None
        exchange.values = dict(values)
        exchange.counter += round(self.cycle_s * _CLOCKS_PER_S)
        frame = cyclic_frame(exchange.frame_id, exchange.outputs, exchange.values, exchange.counter)
        self.network.send(exchange.station.mac, frame)

    async def _cycle(self, exchange: Exchange) -> None:
        loop = asyncio.get_running_loop()
        while True:
            if loop.time() - exchange.heard > self.watchdog_s:
                exchange.cycling = None
                exchange.lose("no inputs came for as long as the watchdog")
                return
            with contextlib.suppress(AdapterError):
                self._send(exchange, exchange.values)
            await asyncio.sleep(self.cycle_s)

    def _heard(self, source: bytes, payload: bytes) -> None:
        for exchange in self.exchanges.values():
            if exchange.station is not None and exchange.station.mac == source:
                exchange.heard = asyncio.get_running_loop().time()
                exchange.news.set()

    def _is_ready(self, asked: Answer) -> bytes | None:
        """Take the word of a device that its application is ready."""
        for kind, body in blocks_in(asked.blocks):
            for exchange in self.exchanges.values():
                if kind == _READY and body[2:18] == exchange.relation and exchange.ready is not None:
                    if not exchange.ready.done():
                        exchange.ready.set_result(None)
                    return control(_READY | 0x8000, exchange.relation, 8)
        return None

    def _release(self, exchange: Exchange) -> None:
        assert exchange.station is not None
        released = control(_RELEASED, exchange.relation, 4)
        with contextlib.suppress(AdapterError):
            self.network.send_call(
                Request(RELEASE, released, exchange.station.vendor, exchange.station.device), exchange.station
            )

    async def close(self) -> None:
        """Give the relations up, so that the outputs fall, and close the sockets."""
        for exchange in self.exchanges.values():
            if exchange.state == "data_exchange":
                exchange.lose("the adapter has ended")
                # The watchdog would clear them as well, later.
                self._release(exchange)
        self.network.close()


def _station(found: Discovered) -> Station:
    ids, ip = found.options.get(IDS, b""), found.options.get(IP, b"")
    if len(ids) < 6 or len(ip) < 6:
        raise AdapterError("protocol_error", "a station identifies itself without identifiers or address")
    return Station(
        mac=found.mac,
        name=found.options.get(NAME, b"")[2:],
        ip=socket.inet_ntoa(ip[2:6]),
        vendor=int.from_bytes(ids[2:4]),
        device=int.from_bytes(ids[4:6]),
        maker=found.options.get(VENDOR, b"")[2:],
    )


def _process_data(record: bytes, kind: int, begin: int) -> bytes:
    """Return the data in a record 8028 or 8029.

    Args:
        begin: where they begin in the block.
    """
    found, body = next(blocks_in(record), (0, b""))
    inputs = kind == 0x0015
    length = int.from_bytes(body[4:6])
    content = body[begin : begin + length]
    if found != kind or len(content) < length or len(body) < begin + length + (not inputs):
        raise AdapterError("protocol_error", "the record is no process data")
    status = body[3] if inputs else 0x80
    if not status & 0x80:
        raise AdapterError("bad_quality", "the device says that its inputs are bad (IOPS)")
    return content


def _alarms() -> bytes:
    body = (1).to_bytes(2) + (0x8892).to_bytes(2) + bytes(4)
    return block(0x0103, body + b"".join(one.to_bytes(2) for one in (1, 3, 1, 200, 0xC000, 0xA000)))


def _expected(one: ModuleEntry) -> bytes:
    body = (1).to_bytes(2) + bytes(4) + one.slot.to_bytes(2) + one.module.to_bytes(4) + bytes(2) + (1).to_bytes(2)
    kinds = [(kind, size) for kind, size in ((1, one.inputs), (2, one.outputs)) if size] or [(1, 0)]
    body += (
        one.subslot.to_bytes(2) + one.submodule.to_bytes(4) + (bool(one.inputs) | bool(one.outputs) << 1).to_bytes(2)
    )
    return block(0x0104, body + b"".join(kind.to_bytes(2) + size.to_bytes(2) + b"\1\1" for kind, size in kinds))
