"""The session of a rig, as the steps of a repetition look at it. What they see is in this one place: a further look is one more method."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from ..record.schema import Footprint, Question, ToolListing, ToolSurface
from ..session.caller import Guise
from ..session.exchange import Answer
from .player import Player

__all__ = ["Answer", "Guise", "SessionInRig"]


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

    async def surface(self) -> Mapping[str, ToolSurface]:
        """Return what a model reads of each tool that the session listed at its start, by name."""
        return await self._player.ask("surface", lambda adapter: adapter.surface())

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

    # -- of the launch with a policy --------------------------------------------------------------------------

    async def answers(self, answer: Answer) -> None:
        """Answer so what the adapter asks its client from now on; see :class:`~pytest_otmcp.session.person.Person`."""
        await self._player.act(lambda adapter: adapter.answer(answer))

    async def disguise(self, guise: Guise) -> None:
        """Send the requests that follow as another caller, of the launch for tokens; a new session begins with one who may write."""
        await self._player.act(lambda adapter: adapter.disguise(guise))

    async def listens_beyond(self) -> bool:
        """Return whether the server of the launch for tokens is open at an address of this machine that it was not told."""
        return await self._player.ask("listens_beyond", lambda adapter: adapter.listens_beyond())

    async def redeem(self) -> None:
        """Let the next call bring the acceptance of the newest question that had no answer."""
        await self._player.act(lambda adapter: adapter.redeem())

    async def next_is(self, *, viewer: bool = False, can_ask: bool = True) -> None:
        """Say who calls in the next session, and whether the client can be asked; see :meth:`~.rig.Rig.fresh_session`."""
        await self._player.act(lambda adapter: adapter.play(viewer=viewer, can_ask=can_ask))

    async def questions(self) -> list[Question]:
        """Return what the adapter has asked since the last look."""
        return await self._player.ask("asked", lambda adapter: adapter.questions())

    async def approve(self, request: str) -> bool:
        """Approve a request outside of MCP; return whether that could be done."""
        return await self._player.ask("approved", lambda adapter: adapter.approve(request))

    async def audit(self) -> list[str]:
        """Return the lines of the audit log that are new since the last look at the log of this session."""
        return await self._player.ask("audit", lambda adapter: adapter.audit_lines())

    async def cramp(self, more: int | None) -> bool:
        """Let the audit log grow by so many bytes at most, or as it will; return whether it is so limited now."""
        return await self._player.ask("cramped", lambda adapter: adapter.cramp(more))

    async def verified(self, anchor: str, edits: Mapping[str, Callable[[list[bytes]], list[bytes]]]) -> dict[str, bool]:
        """Return for each edit whether the subject's verifier takes the edited audit log for whole; afterwards the log is as it was."""
        return await self._player.ask("verified", lambda adapter: adapter.verified(anchor, edits))

    async def stderr(self) -> list[str]:
        """Return the newest lines that the adapter has written to standard error, oldest first."""
        return await self._player.ask("stderr", lambda adapter: adapter.stderr_tail())
