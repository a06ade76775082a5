"""The master: services of class 1 and class 2, and the cycle that keeps outputs alive.

What was written once falls at the slave's watchdog. So outputs are repeated until the adapter ends or the slave is lost: silent for as
long as its watchdog, refusing, or another master's. A lost slave is not taken back by itself, because its outputs would move when nobody
has asked for it; and a write whose answer did not come is not repeated, because only the slave knows whether it was carried out.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from ..core import AdapterError, Call
from .diagnosis import NO_MASTER, Diagnosis, diagnosis_of
from .line import Line
from .maps import Slave
from .refusals import refusal
from .telegram import SERVICES, Telegram, is_short_acknowledgement

__all__ = ["Exchange", "Master"]

_OWN_ACCESS_POINT = 62
_SEND_AND_REQUEST, _SEND = 0x4D, 0x46
"""Control bytes of requests with an answer and without one, of high priority."""
_DATA_LOW, _DATA_HIGH = 0x8, 0xA
_LOCK_AND_WATCHDOG = 0x88
_MIN_STATION_DELAY = 11
"""Bit times after which a slave answers at the earliest."""
_CLEAR_DATA = 0x02
_ASKED, _PAUSE_S = 20, 0.02
"""How often a slave that has been configured is asked whether it is ready, and the seconds in between."""

State = Literal["passive", "data_exchange", "lost"]


@dataclass(slots=True)
class Exchange:
    """Whether the outputs of a slave are kept alive.

    Attributes:
        state: ``passive``, nothing is written; ``data_exchange``, the outputs are repeated; ``lost``, they were.
        outputs: that the slave has taken.
        reason: why the slave was lost.
        answered: time of the event loop at which it has answered last.
        doubted: the last repetition had no answer.
    """

    state: State = "passive"
    outputs: bytes = b""
    reason: str | None = None
    answered: float = 0.0
    doubted: bool = False
    lock: asyncio.Lock = field(default_factory=asyncio.Lock)

    def lose(self, reason: str) -> None:
        """Repeat the outputs no more."""
        self.state, self.reason = "lost", reason


class Master:
    """A master on a line.

    Args:
        line: the line.
        slaves: the slave map.
        cycle_s: seconds between two repetitions of outputs.
        watchdog_s: seconds after which a slave gives up its outputs.
    """

    def __init__(self, line: Line, slaves: Mapping[int, Slave], *, cycle_s: float, watchdog_s: float) -> None:
        self.line = line
        self.slaves = slaves
        self.cycle_s, self.watchdog_s = cycle_s, watchdog_s
        self.exchanges = {address: Exchange() for address in slaves}
        self._factors = _watchdog_factors(watchdog_s)
        self._cycling: asyncio.Task[None] | None = None

    # -- class 2: nothing is driven ---------------------------------------------------------------------------

    async def inputs(self, call: Call, station: int) -> bytes:
        """Return the inputs of a slave, whoever is its master.

        Raises:
            AdapterError: no answer, a refusal, or other inputs than the slave map says.
        """
        content = await self._read(call, station, "RD_Inp")
        return self._of_length(station, content, "input")

    async def outputs(self, call: Call, station: int) -> bytes:
        """Return the outputs that a slave has now, whoever is its master.

        Raises:
            AdapterError: as for :meth:`inputs`.
        """
        content = await self._read(call, station, "RD_Outp")
        return self._of_length(station, content, "output")

    async def diagnosis(self, call: Call, station: int) -> Diagnosis:
        """Return what a slave says of itself."""
        return diagnosis_of(await self._read(call, station, "Slave_Diag"))

    async def configuration(self, call: Call, station: int) -> bytes:
        """Return the configuration identifiers of a slave."""
        return await self._read(call, station, "Get_Cfg")

    def _of_length(self, station: int, content: bytes, direction: Literal["input", "output"]) -> bytes:
        slave = self.slaves.get(station)
        if slave is not None:
            expected = slave.input_length if direction == "input" else slave.output_length
            if len(content) != expected:
                message = f"the slave has {len(content)} bytes of {direction}s, the slave map says {expected}"
                raise AdapterError("protocol_error", message)
        return content

    # -- class 1: the slave is driven -------------------------------------------------------------------------

    async def write(self, call: Call, station: int, change: Callable[[bytes], bytes]) -> bytes:
        """Give a slave outputs, keep them alive from now on, and return those that it has.

        Args:
            station: a slave of the slave map.
            change: makes the outputs from those that this master gives the slave now.

        Raises:
            AdapterError: ``access_denied``, another master has it; ``config_error``, it is another slave than the slave map says;
                ``verify_failed``, it has taken the outputs and has others; and what every exchange may fail by.
        """
        exchange = self.exchanges[station]
        async with exchange.lock:
            await self._take(call, station, exchange)
            driven = exchange.state == "data_exchange"
            outputs = change(exchange.outputs if driven else bytes(self.slaves[station].output_length))
            try:
                await self._exchange_data(call, station, outputs)
            except (AdapterError, asyncio.CancelledError):
                # To repeat the old outputs could take back what was written, to repeat the new ones could write it twice.
                exchange.lose("the answer to a write did not come, or was a refusal")
                raise
            exchange.state, exchange.outputs, exchange.reason = "data_exchange", outputs, None
            exchange.answered, exchange.doubted = asyncio.get_running_loop().time(), False
            if self._cycling is None:
                self._cycling = asyncio.create_task(self._cycle(), name="cycle")
            return await self._verified(call, station, outputs)

    async def _take(self, call: Call, station: int, exchange: Exchange) -> None:
        """Parameterise and configure a slave, if it is not ours already."""
        slave = self.slaves[station]
        found = await self.diagnosis(call, station)
        if found.master not in (NO_MASTER, self.line.address) or found.has("master_lock"):
            exchange.lose("another master has the slave")
            message = "another master has the slave (master_lock); a slave has one master"
            raise AdapterError("access_denied", message, outcome="not_sent", details={"master": found.master})
        if found.ident != slave.ident:
            exchange.lose("there is another slave than the slave map says")
            message = f"the slave has the ident number {found.ident:04X}, the slave map says {slave.ident:04X}"
            raise AdapterError("config_error", message, outcome="not_sent")
        if exchange.state == "data_exchange":
            if found.master == self.line.address and not found.has("prm_req", "station_not_ready"):
                return
            exchange.lose("the slave wants to be parameterised again")
        parameters = bytes([_LOCK_AND_WATCHDOG, *self._factors, _MIN_STATION_DELAY])
        await self._command(
            call, station, "Set_Prm", parameters + slave.ident.to_bytes(2, "big") + b"\0" + slave.user_prm
        )
        await self._command(call, station, "Chk_Cfg", slave.cfg)
        for _ in range(_ASKED):
            found = await self.diagnosis(call, station)
            _accept(found, self.line.address)
            if not found.has("prm_req", "station_not_ready"):
                return
            await asyncio.sleep(_PAUSE_S)
        raise AdapterError("device_busy", "the slave does not become ready for data exchange", outcome="rejected")

    async def _verified(self, call: Call, station: int, outputs: bytes) -> bytes:
        """Return the outputs that a slave has after it has taken some."""
        trace = dict(call.trace)
        try:
            held = await self.outputs(call, station)
        except AdapterError as error:
            message = f"the slave has taken the outputs, but those that it has could not be read: {error.message}"
            raise AdapterError(error.code, message, outcome="unknown") from None
        call.trace |= {**trace, "telegrams": call.attempts}
        if held != outputs:
            message = "the slave has taken the outputs, and has others"
            raise AdapterError("verify_failed", message, outcome="applied", details={"outputs": list(held)})
        return held

    async def _exchange_data(self, call: Call | None, station: int, outputs: bytes) -> None:
        expected = self.slaves[station].input_length
        answer = await self._request(
            call, station, "Data_Exchange", outputs, changes_state=True, acknowledged=not expected
        )
        if len(answer.data) != expected:
            raise AdapterError("protocol_error", f"the slave sent {len(answer.data)} bytes of inputs, not {expected}")

    # -- the cycle --------------------------------------------------------------------------------------------

    async def _cycle(self) -> None:
        while True:
            await asyncio.sleep(self.cycle_s)
            for station, exchange in self.exchanges.items():
                # A write has the slave now, and its outputs are as good as a repetition.
                if exchange.state == "data_exchange" and not exchange.lock.locked():
                    async with exchange.lock:
                        await self._repeat(station, exchange)

    async def _repeat(self, station: int, exchange: Exchange) -> None:
        loop = asyncio.get_running_loop()
        try:
            if exchange.doubted or loop.time() - exchange.answered > self.watchdog_s:
                # Who has been silent may have been restarted, and would get outputs that nobody has asked for since.
                found = diagnosis_of((await self._request(None, station, "Slave_Diag", b"")).data)
                if found.master != self.line.address or found.has("prm_req", "station_not_ready"):
                    exchange.lose("the slave wants to be parameterised again, or has another master")
                    return
            await self._exchange_data(None, station, exchange.outputs)
        except AdapterError as error:
            exchange.doubted = True
            if error.code != "timeout" or loop.time() - exchange.answered > self.watchdog_s:
                exchange.lose(error.message)
        else:
            exchange.doubted, exchange.answered = False, loop.time()

    async def close(self) -> None:
        """End the cycle, let the slaves that were driven clear their outputs, and close the line."""
        if self._cycling is not None:
            self._cycling.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._cycling
        for station, exchange in self.exchanges.items():
            if exchange.state == "data_exchange":
                # The watchdog would clear them as well, later.
                clear = self._telegram(station, "Global_Control", bytes([_CLEAR_DATA, 0]), control=_SEND)
                with contextlib.suppress(Exception):
                    self.line.send(clear)
        self.line.close()

    # -- requests ---------------------------------------------------------------------------------------------

    async def _read(self, call: Call, station: int, service: str) -> bytes:
        return (await self._request(call, station, service, b"")).data

    async def _command(self, call: Call, station: int, service: str, data: bytes) -> None:
        await self._request(call, station, service, data, changes_state=True, acknowledged=True)

    async def _request(
        self,
        call: Call | None,
        station: int,
        service: str,
        data: bytes,
        *,
        changes_state: bool = False,
        acknowledged: bool = False,
    ) -> Telegram:
        telegram = self._telegram(station, service, data, control=_SEND_AND_REQUEST)
        # While the cycle waits for one slave, the watchdogs of the others run.
        timeout_s = self.line.timeout_s if call is not None else min(self.line.timeout_s, self.watchdog_s / 4)
        answer = await self.line.exchange(
            call, telegram, timeout_s=timeout_s, changes_state=changes_state, acknowledged=acknowledged
        )
        if is_short_acknowledgement(answer) or answer.function in (_DATA_LOW, _DATA_HIGH):
            return answer
        if call is None:
            raise AdapterError("session_error", "the slave has refused to exchange data")
        raise refusal(call, answer.function)

    def _telegram(self, station: int, service: str, data: bytes, *, control: int) -> Telegram:
        dsap = SERVICES[service]
        return Telegram(
            destination=station,
            source=self.line.address,
            control=control,
            dsap=dsap,
            ssap=None if dsap is None else _OWN_ACCESS_POINT,
            data=data,
        )


def _accept(found: Diagnosis, own: int) -> None:
    """Check that a slave has accepted its parameters and its configuration.

    Raises:
        AdapterError: it has not.
    """
    if found.has("prm_fault", "cfg_fault"):
        which = "parameters (prm_fault)" if found.has("prm_fault") else "configuration (cfg_fault)"
        message = f"the slave does not accept its {which}; set the slave map to what its GSD file says"
        # It was given parameters, and no outputs.
        raise AdapterError("config_error", message, outcome="not_sent")
    if found.has("not_supported"):
        message = "the slave does not support what its parameters ask for (not_supported)"
        raise AdapterError("unsupported_operation", message, outcome="rejected")
    if found.master not in (NO_MASTER, own):
        message = "another master has taken the slave (master_lock)"
        raise AdapterError("access_denied", message, outcome="rejected", details={"master": found.master})


def _watchdog_factors(seconds: float) -> tuple[int, int]:
    """Return the two factors whose product is the time in steps of 10 ms, rounded up to the next that they can make."""
    steps = max(1, round(seconds * 100))
    second = -(-steps // 255)
    return -(-steps // second), second
