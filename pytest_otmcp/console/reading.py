"""What the reply to a call claims, beside what the device saw of it. Pure.

The sentences state facts, and say where the two contradict each other. They are no verdicts: why a call looks as it does, the suite
finds out with values that nobody can guess.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..core.strict_json import parse_strict
from ..protocols.journal import Entries, JournalEntry
from ..protocols.registry import protocols
from ..session.exchange import Exchange
from ..subject.answers import interpret, read_answer
from ..subject.model import Adapter
from ..subject.tools import bound

__all__ = ["Claim", "Seen", "claim", "compared"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """The outcome that a reply claims.

    Attributes:
        success: None where there is no reply, or none that can be read.
        words: the claim in a few words.
        document: the reply's structured content, or the JSON-RPC message where it has none; None where neither can be read.
        text: the reply's text blocks, a line each.
    """

    success: bool | None
    words: str
    document: object = None
    text: str = ""


def claim(exchange: Exchange, adapter: Adapter) -> Claim:
    """Read a reply by the rules of the subject file; a tool that it does not bind is read by the rules for all of them."""
    if exchange.response is None:
        return Claim(success=None, words=f"no reply ({(exchange.failure or 'unknown').replace('_', ' ')})")
    try:
        message = parse_strict(exchange.response)
    except ValueError as reason:
        return Claim(success=None, words=f"a response that is not strict JSON: {reason}")
    if not isinstance(message, dict):
        return Claim(success=None, words="a response that is no JSON object")
    structured, text, is_error = read_answer(message, "structured")
    document = message if structured is None else structured
    if "error" in message:
        return Claim(success=False, words="failure: a JSON-RPC error", document=document, text=text)
    answering = next((one.answering for _, one in bound(adapter, exchange.tool)), adapter.answering)
    if not answering.native:
        answer = interpret(message, answering)
        words = "success" if answer.success else f"failure: {answer.code}"
        return Claim(success=answer.success, words=words, document=document, text=text)
    told = structured.get("success") if isinstance(structured, dict) else None
    if not isinstance(told, bool):
        words = f"{'failure' if is_error else 'success'}, without an envelope"
        return Claim(success=not is_error, words=words, document=document, text=text)
    error = structured.get("error")
    code = error.get("code") if isinstance(error, dict) else None
    return Claim(success=told, words="success" if told else f"failure: {code}", document=document, text=text)


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """What the device saw of a call.

    Attributes:
        stopped: it was stopped all the time.
        paused: it reads nothing until it goes on.
        entries: the adapter's, between the request and the reply; of a write that claims success also those that came soon after.
    """

    stopped: bool
    paused: bool
    entries: Sequence[JournalEntry]

    @property
    def requests(self) -> list[JournalEntry]:
        """The requests among the entries."""
        return [entry for entry in self.entries if entry["request"]]

    @property
    def changing(self) -> list[JournalEntry]:
        """The requests that may change the device."""
        return [entry for entry in self.entries if entry["state_changing"]]


def compared(adapter: Adapter, tool: str, claimed: Claim, seen: Seen) -> tuple[str, bool]:
    """Return a sentence on both sides of a call, and whether they contradict each other."""
    said = f"The adapter claims {claimed.words}." if claimed.success is not None else f"There is {claimed.words}."
    return f"{said} {_device(seen)}", _contradict(adapter, tool, claimed, seen)


def _device(seen: Seen) -> str:
    if seen.stopped:
        return "The device is stopped and saw nothing."
    if seen.paused and not seen.entries:
        return "The device is paused and has read nothing."
    asked, changing = len(seen.requests), len(seen.changing)
    if not asked:
        return "The device saw no request."
    if asked == 1:
        return f"The device saw 1 request, which asks for {'a' if changing else 'no'} change."
    return (
        f"The device saw {asked} requests, of which {changing or 'none'} ask{'s' if changing < 2 else ''} for a change."
    )


def _contradict(adapter: Adapter, tool: str, claimed: Claim, seen: Seen) -> bool:
    known = protocols()[adapter.protocol]
    operations = {operation for operation, _ in bound(adapter, tool)}
    if claimed.success is False:
        return any(_carried_out(adapter.protocol, request, seen.entries) for request in seen.changing)
    if claimed.success is None or not operations:
        return False
    if all(known.operations[operation].writes for operation in operations):
        # A message may be sent without waiting for an answer, and is read when the device goes on.
        on_its_way = seen.paused and any(known.operations[operation].adds for operation in operations)
        return not seen.changing and not on_its_way
    # A status says truthfully that the device is gone, and messages that came before are still there.
    device_answers = {
        call.operation
        for call in known.proof.unreachable
        if not known.operations[call.operation].status and known.operations[call.operation].waits is None
    }
    return seen.stopped and operations <= device_answers


def _carried_out(protocol: str, request: JournalEntry, entries: Entries) -> bool:
    answer = next((entry for entry in entries if entry["answers"] == request["seq"]), None)
    return protocols()[protocol].carried_out(request, answer) is True and answer is not None
