"""A client of a mock on TCP that sends bytes as they are."""

from __future__ import annotations

import asyncio
import contextlib

from mock_program import PATIENCE_S, MockProgram

__all__ = ["RawConnection"]


class RawConnection:
    """One connection; the protocols add their frames."""

    reader: asyncio.StreamReader
    writer: asyncio.StreamWriter

    async def dial(self, program: MockProgram) -> None:
        """Connect by TCP."""
        self.reader, self.writer = await asyncio.open_connection(program.host, program.port)

    async def take(self, count: int) -> bytes:
        """Return the next bytes, so many."""
        async with asyncio.timeout(PATIENCE_S):
            return await self.reader.readexactly(count)

    async def ended(self) -> bool:
        """Tell whether the device ends the connection, without sending anything more."""
        async with asyncio.timeout(PATIENCE_S):
            try:
                return await self.reader.read() == b""
            except ConnectionError:
                return True

    async def close(self) -> None:
        self.writer.close()
        with contextlib.suppress(ConnectionError):
            await self.writer.wait_closed()
