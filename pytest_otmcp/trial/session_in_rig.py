"""The session of a rig, as the steps of a repetition look at it. What they see is in this one place: a further look is one more method."""

from __future__ import annotations

from collections.abc import Mapping

from ..record.schema import Footprint, ToolListing
from .player import Player

__all__ = ["SessionInRig"]


class SessionInRig:
    """An adapter's session at which the steps look, beside its calls."""

    def __init__(self, player: Player) -> None:
        self._player = player

    async def footprint(self) -> Footprint:
        """Return what the processes of the session take of the machine."""
        return await self._player.ask("process", lambda adapter: adapter.footprint())

    async def tools(self) -> Mapping[str, ToolListing]:
        """Return the tools that the session listed at its start, name to entry."""
        return await self._player.ask("listed", lambda adapter: adapter.listed())

    async def listed_tools(self) -> str:
        """Ask for the list of tools again; see :meth:`pytest_otmcp.session.session.McpSession.list_anew`.

        Raises:
            SubjectError: there is no answer.
        """
        return await self._player.ask("tools", lambda adapter: adapter.list_anew(), spent="tool calls")

    async def listing_took_s(self) -> float:
        """Ask for the list of tools again, and return the seconds until it was there; raises as :meth:`listed_tools`."""
        await self.listed_tools()
        return self._player.took_s

    async def send_line(self, line: str) -> bool:
        """Write a line to the adapter's standard input as it is; return whether there is such a stream."""
        return await self._player.ask("line_sent", lambda adapter: adapter.write_line(line))

    async def refuses(self, tool: str) -> bool | None:
        """Call a tool that the adapter does not have, without arguments; return whether the answer is a failure, or None where there is
        none within the deadline."""
        return await self._player.ask("refuses", lambda adapter: adapter.refuses(tool), spent="tool calls")

    async def made_file(self, name: str) -> bool:
        """Return whether a file of this name has come to be where the adapter works, and remove it."""
        return await self._player.ask("made_file", lambda adapter: adapter.made_file(name))

    async def stderr(self) -> list[str]:
        """Return the newest lines that the adapter has written to standard error, oldest first."""
        return await self._player.ask("stderr", lambda adapter: adapter.stderr_tail())
