"""The serial line: one telegram and its answer at a time, and never a telegram twice.

A telegram says neither a number nor, as a short acknowledgement, who sent it. So what was received before a request is discarded, an
answer of another station or service is not taken for the one that is waited for, and a station that did not answer in time is asked for
its FDL status before it is asked for anything else: what comes before that answer was late.
"""

from __future__ import annotations

import asyncio
import errno
import fcntl
import os
import termios
import tty
from dataclasses import replace

from ..core import AdapterError, Call
from .telegram import FDL_STATUS, BadTelegram, Telegram, is_short_acknowledgement, service_of, take

__all__ = ["BAUD_RATES", "Line"]

BAUD_RATES = {
    9600: termios.B9600,
    19200: termios.B19200,
    500_000: termios.B500000,
    1_500_000: termios.B1500000,
    3_000_000: termios.B3000000,
}
"""Bits per second that PROFIBUS and a serial line of the system both have."""

_CONTROL, _IN_SPEED, _OUT_SPEED = 2, 4, 5
"""Members of the settings of a terminal."""
_PSEUDO_TERMINALS = "/dev/pts/"
_READ_SIZE = 4096
_MOST_DRAINED = 16
_FROM_MASTER = 0x40
"""The bit of a control byte that tells a request from an answer."""
_COUNT, _COUNT_VALID = 0x20, 0x10


class _Lost(Exception):
    """The line is not there any more."""


class Line:
    """One serial line, opened when it is first used.

    Args:
        path: of its device file.
        baud: bits per second, of :data:`BAUD_RATES`.
        address: of this master, 0 to 125.
        timeout_s: seconds for which an answer is waited for.
    """

    def __init__(self, path: str, baud: int, address: int, timeout_s: float) -> None:
        self.address = address
        self.timeout_s = timeout_s
        self.lock = asyncio.Lock()
        self._path, self._baud = path, baud
        self._file: int | None = None
        self._generation = 0
        self._buffer = bytearray()
        self._news = asyncio.Event()
        self._gone = False
        self._counts: dict[int, bool] = {}
        """Frame count bit of each station's last request; a station that is not there gets a first one."""
        self._unsure: set[int] = set()

    async def exchange(
        self,
        call: Call | None,
        telegram: Telegram,
        *,
        timeout_s: float,
        changes_state: bool = False,
        acknowledged: bool = False,
    ) -> Telegram:
        """Send a request and return its answer, after checking that it can be the answer to this request.

        Args:
            call: that sends it; None for the cycle.
            telegram: the request; its control byte has no frame count bits yet.
            timeout_s: seconds for which the answer is waited for.
            changes_state: the request may change the plant.
            acknowledged: the answer may be a short acknowledgement.

        Raises:
            AdapterError: no line, no answer, or another one than the request's.
        """
        async with self.lock:
            self._open(call)
            station = telegram.destination
            assert station is not None
            if station in self._unsure:
                await self._ask(call, self._status_request(station), timeout_s, changes_state=False, acknowledged=False)
                self._unsure.discard(station)
            counted = replace(telegram, control=self._counted(station, telegram.control))
            return await self._ask(call, counted, timeout_s, changes_state=changes_state, acknowledged=acknowledged)

    async def ask_status(self, call: Call, station: int, wait_s: float, *, after_another: bool) -> list[Telegram]:
        """Ask a station for its FDL status and wait so many seconds; return the answers that came, late ones of other stations included.

        Args:
            after_another: another station was asked just before, whose answer may have come meanwhile.

        Raises:
            AdapterError: no line, or what came is no telegram.
        """
        found: list[Telegram] = []
        async with self.lock:
            self._open(call)
            try:
                self._send(call, self._status_request(station), changes_state=False, keeps_received=after_another)
                async with asyncio.timeout(wait_s):
                    while not found or found[-1].source != station:
                        telegram = await self._next()
                        if telegram.source is not None and (telegram.control & _FROM_MASTER, telegram.data) == (0, b""):
                            call.answered()
                            found.append(telegram)
            except TimeoutError:
                pass
            except (BadTelegram, _Lost, OSError) as error:
                raise self._explained(call, error) from None
        return found

    def send(self, telegram: Telegram) -> None:
        """Send a telegram that nobody answers, if the line is open."""
        if self._file is not None:
            self._write(telegram)

    def _status_request(self, station: int) -> Telegram:
        return Telegram(destination=station, source=self.address, control=FDL_STATUS)

    def _counted(self, station: int, control: int) -> int:
        """Return a control byte with the bits by which a station tells a new request from a repeated one."""
        if station not in self._counts:
            self._counts[station] = True
            return control | _COUNT
        self._counts[station] = not self._counts[station]
        return control | _COUNT_VALID | (_COUNT if self._counts[station] else 0)

    async def _ask(
        self, call: Call | None, telegram: Telegram, timeout_s: float, *, changes_state: bool, acknowledged: bool
    ) -> Telegram:
        station = telegram.destination
        assert station is not None
        others = False
        try:
            self._send(call, telegram, changes_state=changes_state)
            async with asyncio.timeout(timeout_s):
                while True:
                    found = await self._next()
                    if self._is_answer(telegram, found, acknowledged):
                        break
                    others = others or found.source != self.address
        except AdapterError:
            # It was refused before the wire: the station has not counted it.
            self._counts.pop(station, None)
            raise
        except (BadTelegram, _Lost, OSError, TimeoutError, asyncio.CancelledError) as error:
            # The station may have counted this request, and may still answer it.
            self._counts.pop(station, None)
            self._unsure.add(station)
            if isinstance(error, asyncio.CancelledError):
                raise
            if isinstance(error, TimeoutError) and others:
                raise AdapterError("protocol_error", "only other answers came than the one to the request") from None
            raise self._explained(call, error) from None
        if call is not None:
            call.answered()
        return found

    def _is_answer(self, request: Telegram, found: Telegram, acknowledged: bool) -> bool:
        if is_short_acknowledgement(found):
            return acknowledged
        if (found.source, found.destination) != (request.destination, self.address) or found.control & _FROM_MASTER:
            return False
        # A refusal has no data and no access points.
        plain = (found.dsap, found.ssap, found.data) == (None, None, b"")
        return (plain and bool(found.function or request.control == FDL_STATUS)) or (
            (found.dsap, found.ssap) == (request.ssap, request.dsap) and not plain and request.control != FDL_STATUS
        )

    def _explained(self, call: Call | None, error: Exception) -> AdapterError:
        if isinstance(error, TimeoutError):
            return AdapterError("timeout", "the station did not answer in time")
        if isinstance(error, BadTelegram):
            return AdapterError("protocol_error", f"what was received is no telegram: {error}")
        self.close()
        if call is not None:
            call.disconnected()
        return AdapterError("connection_lost", "the serial line broke during the call")

    # -- the device file --------------------------------------------------------------------------------------

    def _open(self, call: Call | None) -> None:
        if self._gone:
            self.close()
        fresh = self._file is None
        if self._file is None:
            try:
                self._file = _opened(self._path, self._baud)
            except (OSError, termios.error) as error:
                if call is not None:
                    call.disconnected()
                raise AdapterError("connect_failed", self._why(error), outcome="not_sent") from None
            self._generation += 1
            asyncio.get_running_loop().add_reader(self._file, self._readable)
        if call is not None:
            call.connection(generation=self._generation, fresh=fresh)

    def _why(self, error: Exception) -> str:
        number = error.args[0] if error.args else None
        if number in (errno.EWOULDBLOCK, errno.EAGAIN, errno.EBUSY):
            return f"another program uses the line {self._path}; a line has one master"
        return f"the line {self._path} cannot be opened; is the path right, and may this user open it?"

    def _readable(self) -> None:
        assert self._file is not None
        try:
            received = os.read(self._file, _READ_SIZE)
        except BlockingIOError:
            return
        except OSError:
            received = b""
        if not received:
            self._gone = True
            asyncio.get_running_loop().remove_reader(self._file)
        # Nobody has to read what a station sends that does not stop; a request discards it.
        if len(self._buffer) < _READ_SIZE:
            self._buffer += received
        self._news.set()

    async def _next(self) -> Telegram:
        while True:
            telegram = take(self._buffer)
            if telegram is not None:
                return telegram
            if self._gone:
                raise _Lost
            self._news.clear()
            await self._news.wait()

    def _send(
        self, call: Call | None, telegram: Telegram, *, changes_state: bool, keeps_received: bool = False
    ) -> None:
        if not keeps_received:
            self._drain()
        if call is not None:
            call.sending(changes_state=changes_state)
            call.trace |= {
                "station": telegram.destination,
                "service": service_of(telegram),
                "dsap": telegram.dsap,
                "telegrams": call.attempts,
            }
        self._write(telegram)

    def _drain(self) -> None:
        # The bound keeps a station that never stops sending from delaying the request for ever.
        for _ in range(_MOST_DRAINED):
            self._buffer.clear()
            if self._gone:
                return
            self._readable()
            if not self._buffer:
                return

    def _write(self, telegram: Telegram) -> None:
        if self._gone or self._file is None:
            raise _Lost
        content = telegram.encoded()
        try:
            sent = os.write(self._file, content)
        except BlockingIOError:
            sent = 0
        if sent != len(content):
            # Nobody takes what is sent: the rest of a telegram would be the beginning of the next.
            termios.tcflush(self._file, termios.TCOFLUSH)
            raise TimeoutError

    def close(self) -> None:
        """Close the line."""
        file, self._file, self._gone = self._file, None, False
        self._buffer.clear()
        self._counts.clear()
        self._unsure.clear()
        if file is not None:
            asyncio.get_running_loop().remove_reader(file)
            os.close(file)


def _opened(path: str, baud: int) -> int:
    """Open a line with eight data bits, even parity and one stop bit, for this process alone.

    Raises:
        OSError, termios.error: it cannot be opened, or is in use.
    """
    file = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        tty.setraw(file, termios.TCSANOW)
        settings = termios.tcgetattr(file)
        settings[_CONTROL] &= ~(termios.CSIZE | termios.PARODD | termios.CSTOPB)
        settings[_CONTROL] |= termios.CS8 | termios.CLOCAL | termios.CREAD
        # A pseudo terminal has no parity, and refuses settings that change nothing else.
        if not os.path.realpath(path).startswith(_PSEUDO_TERMINALS):
            settings[_CONTROL] |= termios.PARENB
        settings[_IN_SPEED] = settings[_OUT_SPEED] = BAUD_RATES[baud]
        termios.tcsetattr(file, termios.TCSANOW, settings)
    except BaseException:
        os.close(file)
        raise
    return file
