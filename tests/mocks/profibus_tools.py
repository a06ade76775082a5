"""A master on the pseudo terminal of the PROFIBUS mock that sends bytes as they are."""

from __future__ import annotations

import asyncio
import contextlib
import os
import termios
import tty

from mock_program import PATIENCE_S, MockProgram

__all__ = ["Master", "request"]

_LENGTHS = {0x10: 6, 0xA2: 14, 0xDC: 3, 0xE5: 1}


def request(
    destination: int, sap: int | None, data: str = "", *, source: int = 2, control: int = 0x4D, ssap: int = 62
) -> bytes:
    """Return a request telegram; without a service access point it is a Data_Exchange."""
    extension = 0 if sap is None else 0x80
    saps = b"" if sap is None else bytes([sap, ssap])
    body = bytes([destination | extension, source | extension, control]) + saps + bytes.fromhex(data)
    tail = bytes([sum(body) & 0xFF, 0x16])
    if len(body) == 3:
        return b"\x10" + body + tail
    return bytes([0x68, len(body), len(body), 0x68]) + body + tail


class Master:
    """A client with the terminal open."""

    def __init__(self, program: MockProgram) -> None:
        path = next(iter(program.ready_event["endpoints"].values()))["path"]
        self.fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self.fd)
        termios.tcflush(self.fd, termios.TCIFLUSH)
        os.set_blocking(self.fd, False)
        self._buffer = b""

    def send(self, raw: bytes) -> None:
        os.write(self.fd, raw)

    async def take(self, count: int) -> bytes:
        """Return the next bytes."""
        loop = asyncio.get_running_loop()
        readable = asyncio.Event()
        async with asyncio.timeout(PATIENCE_S):
            loop.add_reader(self.fd, readable.set)
            try:
                while len(self._buffer) < count:
                    await readable.wait()
                    readable.clear()
                    self._read()
            finally:
                loop.remove_reader(self.fd)
        found, self._buffer = self._buffer[:count], self._buffer[count:]
        return found

    async def telegram(self) -> bytes:
        """Return the next telegram."""
        start = await self.take(1)
        if start[0] in _LENGTHS:
            return start + await self.take(_LENGTHS[start[0]] - 1)
        length = await self.take(1)
        return start + length + await self.take(length[0] + 4)

    async def ask(self, raw: bytes) -> str:
        """Send a telegram and return the one that answers it, in hexadecimal digits."""
        self.send(raw)
        return (await self.telegram()).hex()

    async def exchange(self, station: int, outputs: str, *, ident: str, cfg: str, watchdog: str = "ff64") -> str:
        """Parameterise and configure a slave, and send outputs; return the answer to these."""
        assert await self.ask(request(station, 61, f"88{watchdog}00{ident}00")) == "e5"
        assert await self.ask(request(station, 62, cfg)) == "e5"
        return await self.ask(request(station, None, outputs))

    def nothing_came(self) -> bool:
        """Tell whether there is nothing to read."""
        self._read()
        return not self._buffer

    def _read(self) -> None:
        with contextlib.suppress(BlockingIOError):
            self._buffer += os.read(self.fd, 4096)

    def drop(self) -> None:
        """Forget what has come and was not read."""
        termios.tcflush(self.fd, termios.TCIFLUSH)
        self._buffer = b""

    def close(self) -> None:
        os.close(self.fd)
