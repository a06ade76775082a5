"""One TCP connection: link frames, transport segments and application fragments, in both directions.

dnp3py's frames, reassembly and parser are used without its runner, which does not say what became of a command, reports a fragment's values
before it has matched the fragment with the request, and reads only while somebody waits: what an outstation sends in between, a question
for the state of the link or events that it wants to have confirmed, would lie there.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from dataclasses import dataclass

from dnp3.application.fragment import ObjectBlock, ResponseFragment
from dnp3.application.parser import ParseError, parse_response
from dnp3.core.enums import FunctionCode, LinkFunctionCode
from dnp3.datalink.builder import build_ack, build_link_status, build_request_link_status, build_unconfirmed_user_data
from dnp3.datalink.frame import DataLinkFrame
from dnp3.datalink.parser import FrameParser
from dnp3.transport.reassembler import Reassembler, ReassemblyError
from dnp3.transport.segment import TransportSegment
from dnp3.transport.segmenter import Segmenter

from ..core import BadReply, Lost
from .objects import Point, points_of

__all__ = ["Connection", "Response"]

_LARGEST_FRAGMENT = 65536
_MOST_FRAGMENTS = 100
_ONE_FRAGMENT, _UNSOLICITED = 0xC0, 0x10
_SEQUENCES = 16

log = logging.getLogger(__name__)

Keep = Callable[[int, list[Point]], bool]
"""Takes points that an outstation tells as events, with its address; False where there is no room for them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """The answer to a request, all fragments together.

    Attributes:
        blocks: its objects.
        points: what they say, where they are points.
        indications: internal indications of the fragments, the first octet in the lower bits.
    """

    blocks: list[ObjectBlock]
    points: list[Point]
    indications: int


@dataclass(frozen=True, slots=True, kw_only=True)
class _Arrived:
    fragment: ResponseFragment
    points: list[Point]


class Connection(asyncio.Protocol):
    """One connection to an outstation, or to several.

    Args:
        master: own link address.
        known: link addresses of the outstations whose unsolicited responses are taken; those that are asked are added.
        keep: takes events that nobody waits for.
    """

    def __init__(self, master: int, known: set[int], keep: Keep) -> None:
        self._master = master
        self._known = known
        self._keep = keep
        self._parser = FrameParser()
        self._reassemblers: dict[int, Reassembler] = {}
        self._segmenters: dict[int, Segmenter] = {}
        self._confirmed: dict[int, bytes] = {}
        self._asked: int | None = None
        self._answers: asyncio.Queue[_Arrived | Exception] = asyncio.Queue()
        self._transport: asyncio.Transport | None = None

    @property
    def is_open(self) -> bool:
        """Whether requests can be sent."""
        return self._transport is not None and not self._transport.is_closing()

    def abort(self) -> None:
        """End the connection at once."""
        if self._transport is not None:
            self._transport.abort()

    # -- requests ---------------------------------------------------------------------------------------------

    async def ask(self, outstation: int, sequence: int, function: int, objects: bytes, timeout_s: float) -> Response:
        """Send a request, confirm the fragments of the answer that ask for it, and return them.

        Raises:
            Lost: the connection ended before the answer began.
            ConnectionError: it ended within the answer.
            TimeoutError: a fragment did not come within ``timeout_s`` seconds.
            BadReply: what came is not the answer.
        """
        self._listen_to(outstation)
        self._send(outstation, bytes([_ONE_FRAGMENT | sequence, function]) + objects)
        fragments: list[_Arrived] = []
        try:
            while not fragments or not fragments[-1].fragment.is_final:
                async with asyncio.timeout(timeout_s):
                    fragments.append(await self._next((sequence + len(fragments)) % _SEQUENCES, not fragments))
                if fragments[-1].fragment.header.control.con:
                    self._confirm(outstation, fragments[-1].fragment.sequence)
                if len(fragments) > _MOST_FRAGMENTS:
                    raise BadReply(f"it has more than {_MOST_FRAGMENTS} fragments")
        except BaseException as error:
            # The outstation has forgotten the events that were confirmed: whoever polls next has to get them.
            self._keep(outstation, [point for one in fragments for point in one.points if point.is_event])
            if isinstance(error, Lost) and fragments:
                raise ConnectionError from None
            raise
        finally:
            self._asked = None
        indications = 0
        for one in fragments:
            indications |= int(one.fragment.header.iin)
        return Response(
            blocks=[block for one in fragments for block in one.fragment.objects],
            points=[point for one in fragments for point in one.points],
            indications=indications,
        )

    async def ask_link_status(self, outstation: int, timeout_s: float) -> None:
        """Ask the data link layer of an outstation for its status.

        Raises:
            Lost: the connection ended.
            TimeoutError: there was no answer.
        """
        self._listen_to(outstation)
        frame = build_request_link_status(destination=outstation, source=self._master, dir_from_master=True)
        self._write(frame)
        try:
            async with asyncio.timeout(timeout_s):
                answer = await self._answers.get()
        finally:
            self._asked = None
        if isinstance(answer, Lost):
            raise answer

    def _listen_to(self, outstation: int) -> None:
        if not self.is_open:
            raise Lost
        self._answers = asyncio.Queue()
        self._asked = outstation
        self._known.add(outstation)

    async def _next(self, sequence: int, is_first: bool) -> _Arrived:
        """Return the next fragment of the answer; one with another sequence number before the first is late for an earlier request."""
        while True:
            arrived = await self._answers.get()
            if isinstance(arrived, Exception):
                raise arrived
            if arrived.fragment.sequence == sequence:
                if arrived.fragment.is_first != is_first:
                    raise BadReply("its fragments do not follow each other")
                return arrived
            if not is_first:
                raise BadReply("the sequence numbers of its fragments do not follow each other")

    def _confirm(self, outstation: int, sequence: int, flags: int = 0) -> None:
        self._send(outstation, bytes([_ONE_FRAGMENT | flags | sequence, FunctionCode.CONFIRM]))

    def _send(self, outstation: int, fragment: bytes) -> None:
        for segment in self._segmenters.setdefault(outstation, Segmenter()).segment(fragment):
            self._write(
                build_unconfirmed_user_data(
                    destination=outstation, source=self._master, dir_from_master=True, user_data=segment.to_bytes()
                )
            )

    def _write(self, frame: DataLinkFrame) -> None:
        if self._transport is not None:
            self._transport.write(frame.to_bytes())

    # -- what arrives -----------------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """See :class:`asyncio.Protocol`."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport

    def connection_lost(self, exc: Exception | None) -> None:
        """See :class:`asyncio.Protocol`."""
        self._transport = None
        self._answers.put_nowait(Lost())

    def data_received(self, data: bytes) -> None:
        """See :class:`asyncio.Protocol`."""
        for frame in self._parser.feed(data):
            header = frame.header
            # Outstations that share a gateway see each other's frames and those of other masters.
            if header.destination == self._master and header.source in self._known:
                self._take(header.source, frame)

    def _take(self, source: int, frame: DataLinkFrame) -> None:
        control = frame.header.control
        if control.dir_from_master:
            return
        if not control.prm:
            if source == self._asked and control.function_code in (
                LinkFunctionCode.SEC_LINK_STATUS,
                LinkFunctionCode.SEC_NOT_SUPPORTED,
            ):
                self._answers.put_nowait(_LINK_STATUS)
            return
        if control.function_code == LinkFunctionCode.PRI_REQUEST_LINK_STATUS:
            self._write(build_link_status(destination=source, source=self._master, dir_from_master=True))
            return
        if control.function_code != LinkFunctionCode.PRI_UNCONFIRMED_USER_DATA:
            self._write(build_ack(destination=source, source=self._master, dir_from_master=True))
        if frame.user_data:
            self._reassemble(source, frame.user_data)

    def _reassemble(self, source: int, segment: bytes) -> None:
        reassembler = self._reassemblers.setdefault(source, Reassembler(max_fragment_size=_LARGEST_FRAGMENT))
        try:
            whole = reassembler.add(TransportSegment.from_bytes(segment))
            if whole is None:
                return
            fragment = parse_response(whole.data)
            if fragment.truncation is not None:
                raise BadReply(f"its objects cannot be read: {fragment.truncation.reason.value}")
            arrived = _Arrived(fragment=fragment, points=points_of(list(fragment.objects)))
        except (ReassemblyError, ParseError, BadReply) as error:
            log.warning("outstation %d sent what cannot be read: %s", source, error)
            if source == self._asked:
                self._answers.put_nowait(BadReply(str(error)))
            return
        if fragment.header.function == FunctionCode.UNSOLICITED_RESPONSE:
            self._unsolicited(source, arrived, whole.data)
        elif fragment.header.function == FunctionCode.RESPONSE and source == self._asked:
            self._answers.put_nowait(arrived)

    def _unsolicited(self, source: int, arrived: _Arrived, content: bytes) -> None:
        """Keep the points of an unsolicited response and confirm it; one that there is no room for stays with the outstation."""
        # Whoever did not get the confirmation sends the same again.
        is_new = self._confirmed.get(source) != content
        if is_new and not self._keep(source, arrived.points):
            return
        if arrived.fragment.header.control.con:
            self._confirmed[source] = content
            self._confirm(source, arrived.fragment.sequence, _UNSOLICITED)


_LINK_STATUS = _Arrived(fragment=parse_response(bytes([_ONE_FRAGMENT, FunctionCode.RESPONSE, 0, 0])), points=[])
"""Stands for the answer of the data link layer, which has no fragment."""
