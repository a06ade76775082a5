"""One adapter at its mock device, as the console uses it: start, call, and what is done to the device."""

from __future__ import annotations

import asyncio
import json
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from ..core.errors import KitError, NoBindingError, SubjectError, UsageError
from ..core.strict_json import parse_strict
from ..onboarding.known_causes import find_advice
from ..onboarding.pack import load_pack
from ..plant.mock_device import MockDevice
from ..protocols.journal import ADAPTER
from ..protocols.registry import protocols
from ..session.isolation import Isolation
from ..subject.answers import extract
from ..subject.model import READ_WRITE, SECURE_FORM, Adapter, OutputRule, Subject
from ..subject.tools import only_reads
from ..trial.adapter_under_test import AdapterUnderTest, BenchOptions
from ..trial.session_proof import prove_session, why_reachable_in_outage
from .approvals import Approvals
from .copying import Called, Done, as_binding, as_test
from .feed import Event
from .reading import Claim, Seen, claim, compared
from .showing import shown_call, shown_row
from .tools import described
from .witness import Row, Witness

__all__ = ["Bench"]

_ARRIVING_S = 0.5
"""Seconds within which the device must have seen a write that claims success; a message may arrive after the answer."""

_CALLS, _ROWS, _CHANGES = 50, 500, 200
"""Calls, rows of the journal, and looks at the image that a page gets when it comes; also the most changes of one look."""

_DECIDES_S = 300.0
"""Seconds that a person has for a decision, in which a call may wait."""

_DELAY_S = 2.0
"""Of the fault rule that the page proposes."""


class Bench:
    """One adapter at its mock device.

    Args:
        number: its name in the console.
        tell: is given every event, for the pages.
    """

    def __init__(
        self, number: int, subject: Subject, adapter: Adapter, isolation: Isolation, tell: Callable[[Event], None]
    ) -> None:
        self._number = number
        self._subject = subject
        self._adapter = adapter
        self._protocol = protocols()[adapter.protocol]
        self._isolation = isolation
        self._tell_pages = tell
        self._device: MockDevice | None = None
        self._witness: Witness | None = None
        self._under_test: AdapterUnderTest | None = None
        self._living, self._calling, self._looking = asyncio.Lock(), asyncio.Lock(), asyncio.Lock()
        approval = None if adapter.governed is None else adapter.governed.told.approval
        self._approval_id = "" if approval is None else str(approval["id"])
        self._approvals = Approvals({} if approval is None else approval["form"], self._tell_state)
        self._variant = READ_WRITE
        self._problem = ""
        self._network = "open"
        self._rules: Sequence[Mapping[str, object]] = ()
        self._image: Mapping[str, Any] = {}
        self._wrote: set[str] = set()
        self._changes: deque[Event] = deque(maxlen=_CHANGES)
        self._calls: deque[Event] = deque(maxlen=_CALLS)
        self._steps: deque[Called | Done] = deque(maxlen=_CALLS)
        self._called = 0

    # -- told to pages ------------------------------------------------------------------------------------------------

    def story(self) -> list[Event]:
        """Return the events that bring a page that comes now to where the others are."""
        rows = [] if self._witness is None else list(self._witness.rows)[-_ROWS:]
        return [self._state(), self._rows(rows), *self._changes, *self._calls]

    def _state(self) -> Event:
        device, under_test = self._device, self._under_test
        listed = (None if under_test is None else under_test.tools) or {}
        pokes = self._protocol.proof.restore(self._image) if self._image else ()
        return {
            "kind": "bench",
            "bench": self._number,
            "name": f"{self._subject.name} {self._subject.version}, {self._protocol.name}",
            "source": str(self._subject.source),
            "command": " ".join(self._adapter.variants[self._variant].command),
            "variants": list(self._adapter.variants),
            "variant": self._variant,
            "started": under_test is not None,
            "device": "none" if device is None else "running" if device.running else "stopped",
            "network": self._network,
            "faults": json.dumps(self._rules) if self._rules else "",
            "problem": self._problem,
            "approvals": self._approvals.story(),
            "tools": [{**tool, "wrote": tool["name"] in self._wrote} for tool in described(self._adapter, listed)],
            "poke": json.dumps(next(iter(pokes), {})),
            "rules": json.dumps([{**rule, "action": {"delay_s": _DELAY_S}} for rule in self._protocol.delayed]),
        }

    def _rows(self, rows: Sequence[Row]) -> Event:
        return {
            "kind": "rows",
            "bench": self._number,
            "rows": [shown_row(self._adapter.protocol, row) for row in rows],
        }

    def _tell_state(self, problem: str | None = None) -> None:
        self._problem = self._problem if problem is None else problem
        self._tell_pages(self._state())

    # -- life ---------------------------------------------------------------------------------------------------------

    async def start(self, variant: str) -> None:
        """Start a mock device and the adapter at it, in one of its launches.

        Raises:
            UsageError: it has no such launch, or cannot be started; the message says what may help.
        """
        if variant not in self._adapter.variants:
            raise UsageError(f"there is no launch {variant!r}")
        async with self._living:
            await self._end()
            self._forget()
            self._tell_pages({"kind": "new", "bench": self._number})
            self._variant = variant
            secure = variant == SECURE_FORM
            self._device = device = MockDevice(self._protocol.mock, self._adapter.protocol, secure=secure)
            device.walls = self._isolation.walls(outside=self._adapter.openings.why_outside, cable=self._protocol.cable)
            self._witness = Witness(device, self._take, self._tell_state)
            try:
                await device.launch()
                self._witness.begin()
                self._under_test = AdapterUnderTest(self._adapter, variant, device, BenchOptions())
                # Whatever the adapter asks, a person decides.
                self._under_test.person = self._approvals
                await self._under_test.open()
                await self._look()
            except BaseException as failure:
                await self._end()
                if not isinstance(failure, SubjectError):
                    raise
                self._problem = "\n".join([str(failure), *self._advice(str(failure))])
                raise UsageError(self._problem) from failure
            finally:
                self._tell_state()

    def _advice(self, words: str) -> list[str]:
        known = self._protocol.onboarding is not None
        causes = load_pack(self._adapter.protocol).causes if known else ()
        return [f"-> {advice.cause} {advice.remedy}" for advice in find_advice(words, causes)]

    def _forget(self) -> None:
        self._problem, self._network, self._rules, self._image = "", "open", (), {}
        for story in (self._changes, self._calls, self._steps, self._wrote):
            story.clear()

    async def stop(self) -> None:
        """End adapter and device."""
        async with self._living:
            await self._end()
            self._tell_state()

    async def _end(self) -> None:
        witness, under_test, device = self._witness, self._under_test, self._device
        self._approvals.end()
        if under_test is not None:
            await under_test.close()
        if witness is not None:
            await witness.end()
        if device is not None:
            await device.close()
        self._under_test = self._device = None

    # -- the device's side --------------------------------------------------------------------------------------------

    async def _take(self, rows: Sequence[Row]) -> None:
        # A page keeps no more than it gets when it comes.
        self._tell_pages(self._rows(rows[-_ROWS:]))
        if any(row.entry["state_changing"] or row.entry["origin"] in ("plant", "kit") for row in rows):
            await self._look()

    async def _look(self) -> None:
        """Look at the device's image, and tell how it differs from the last look."""
        async with self._looking:
            device = self._device
            if device is None or not device.running:
                return
            before, self._image = self._image.get("points", {}), await device.image()
            changed = [
                f"{name}: {json.dumps(before.get(name))} → {json.dumps(value)}"
                for name, value in self._image["points"].items()
                if before and before.get(name) != value
            ]
            if changed:
                more = [f"… and {len(changed) - _CHANGES} more"] if len(changed) > _CHANGES else []
                event = {"kind": "image", "bench": self._number, "changed": [*changed[:_CHANGES], *more]}
                self._changes.append(event)
                self._tell_pages(event)

    async def image(self) -> str:
        """Return what the device holds, as JSON.

        Raises:
            UsageError: it is not running.
        """
        return json.dumps(await self._running().image(), indent=1, ensure_ascii=False)

    async def to_device(self, what: str, value: object) -> None:
        """Do something to the device.

        Args:
            what: ``stop``, ``start``, ``pause``, ``resume``, ``tick``, ``reset``, ``poke`` or ``fault``.
            value: the parameters of a poke, or the list of fault rules.

        Raises:
            UsageError: it cannot be done now, or the device refuses it.
        """
        async with self._living:
            match what:
                case "stop":
                    await self._stop_device()
                case "start":
                    await self._start_device()
                case "pause" | "resume":
                    await self._poke({"network": "stalled" if what == "pause" else "open"})
                    self._network = "stalled" if what == "pause" else "open"
                case "tick":
                    await self._running().tick()
                    self._steps.append(Done(what="tick"))
                case "reset":
                    await self._running().reset()
                    self._rules = ()
                    self._steps.append(Done(what="reset"))
                case "poke" if isinstance(value, dict):
                    await self._poke(value)
                case "fault" if isinstance(value, list) and all(isinstance(rule, dict) for rule in value):
                    await self._fault(value)
                case "poke" | "fault":
                    raise UsageError("a poke is a JSON object, and fault rules are a JSON list of objects")
                case _:
                    raise UsageError(f"nothing is known that is called {what!r}")
            await self._look()
            self._tell_state("")

    def _running(self) -> MockDevice:
        if self._device is None or not self._device.running:
            raise UsageError("the device is not running")
        return self._device

    async def _stop_device(self) -> None:
        device = self._running()
        assert self._witness is not None
        await self._witness.end()
        await device.stop()
        self._rules, self._network = (), "open"
        self._steps.append(Done(what="stop"))

    async def _start_device(self) -> None:
        if self._device is None or self._device.running:
            raise UsageError("the device is not stopped")
        assert self._witness is not None
        await self._device.start()
        if self._under_test is not None:
            self._under_test.cursor.withdraw_proof()
        self._witness.begin()
        self._steps.append(Done(what="start"))

    async def _poke(self, params: Mapping[str, object]) -> None:
        device = self._running()
        try:
            await device.poke(**params)
        except KitError as error:
            raise UsageError(str(error)) from None
        self._steps.append(Done(what="poke", arguments=(params,)))

    async def _fault(self, rules: Sequence[Mapping[str, object]]) -> None:
        device = self._running()
        try:
            await device.fault(*rules)
        except KitError as error:
            raise UsageError(str(error)) from None
        self._rules = rules
        self._steps.append(Done(what="fault", arguments=tuple(rules)))

    # -- calls --------------------------------------------------------------------------------------------------------

    async def call(self, tool: str, arguments: str) -> str:
        """Call a tool, and tell what it claims beside what the device saw; return the reply as a host's model gets it.

        Args:
            arguments: as JSON, sent as they are.

        Raises:
            UsageError: they are no JSON object, or nothing may be written now.
            SubjectError: the adapter has ended and cannot be started again.
        """
        try:
            given = parse_strict(arguments)
        except ValueError as error:
            raise UsageError(f"the arguments are not strict JSON: {error}") from None
        if not isinstance(given, dict):
            raise UsageError("the arguments must be a JSON object")
        async with self._calling:
            under_test, witness, device = self._under_test, self._witness, self._device
            if under_test is None or witness is None or device is None:
                raise UsageError("the adapter is not started")
            session = under_test.session
            await under_test.open()
            if under_test.session is not session:
                self._tell_state("The adapter had ended, and was started again.")
            writes = not only_reads(self._adapter, tool)
            began_ns = time.monotonic_ns()
            if writes and (problem := await self._why_not_written(under_test, device)) is not None:
                raise UsageError(problem)
            stopped = not device.running
            generation = witness.generation
            timeout_s = 1.2 * under_test.deadline_s + _DECIDES_S * bool(self._approval_id)
            try:
                exchange = await under_test.call_tool(tool, given, writes=writes, timeout_s=timeout_s)
            except NoBindingError as gap:
                raise UsageError(str(gap)) from None
            claimed = claim(exchange, self._adapter)
            # A call that was answered by a question is made of two requests.
            own = await self._own(witness, device, exchange.asked_ns, waits=writes and claimed.success is True)
            seen = Seen(
                stopped=stopped and witness.generation == generation,
                paused=self._network != "open",
                entries=[row.entry for row in own],
            )
            if device.running and writes and claimed.success and not seen.changing:
                # Where did it go? Before anything else is written this must be known.
                under_test.cursor.withdraw_proof()
            self._note(tool, given, claimed, seen)
            if (request := self._told_of(claimed)) is not None:
                self._approvals.lies_outside(request, f"{tool} {json.dumps(given, ensure_ascii=False)}")
            says, contradicts = compared(self._adapter, tool, claimed, seen)
            self._called += 1
            event = {
                "kind": "call",
                "bench": self._number,
                "call": self._called,
                "says": says,
                "contradicts": contradicts,
                "proof": _proof(witness.rows, began_ns, exchange.asked_ns),
                **shown_call(exchange, claimed, own),
            }
            self._calls.append(event)
            self._tell_pages(event)
            if (session := under_test.session) is not None and session.died:
                self._tell_state(await session.death_note())
            return claimed.text or str(event["reply"]) or claimed.words

    def _told_of(self, claimed: Claim) -> str | None:
        """Return the name of the request outside of MCP of which a refusal tells; None where it tells of none that could be approved."""
        governed = self._adapter.governed
        if claimed.success is not False or governed is None or not governed.approve:
            return None
        found = extract({"told": OutputRule(path=self._approval_id)}, claimed.document or claimed.text).get("told")
        return found if isinstance(found, str) else None

    async def decide(self, number: object, what: object, content: object) -> str:
        """Accept or decline what waits for a person; return what is to be done then, if anything.

        Args:
            what: ``accept`` or ``decline``.
            content: of the form of a question, as JSON.

        Raises:
            UsageError: it does not wait any more, or cannot be decided so.
            SubjectError: the command of the subject file cannot be run.
        """
        if what not in ("accept", "decline"):
            raise UsageError("a decision is 'accept' or 'decline'")
        if not self._approvals.is_outside(number):
            self._approvals.answer_client(number, "accept" if what == "accept" else "decline", content)
            return ""
        under_test, governed = self._under_test, self._adapter.governed
        assert under_test is not None
        assert governed is not None
        if what == "decline" and not governed.decline:
            raise UsageError("the subject file has no command that declines (approval.decline)")
        request = self._approvals.take(number).outside
        done = await (under_test.approve(request) if what == "accept" else under_test.decline(request))
        if not done:
            raise UsageError(f"the command of the subject file refused: {request} may have ended")
        return "Approved: make the same call again." if what == "accept" else "Declined."

    def functions(self) -> list[dict[str, object]]:
        """Return the tools of the adapter, which must be started, as the chat interface describes functions."""
        listed = (None if self._under_test is None else self._under_test.tools) or {}
        return [
            {
                "type": "function",
                "function": {
                    "name": name,
                    "description": entry.get("description") or "",
                    "parameters": entry.get("inputSchema") or {"type": "object"},
                },
            }
            for name, entry in listed.items()
        ]

    async def _why_not_written(self, under_test: AdapterUnderTest, device: MockDevice) -> str | None:
        """Return why nothing may be written now, by the rules of every command that writes; or None."""
        if not device.running:
            if under_test.cursor.proven is None:
                return "nothing has shown that this session talks to the mock device, so nothing is written while it is stopped"
            return await why_reachable_in_outage(under_test)
        if under_test.cursor.proven is None and (self._rules or self._network != "open"):
            return "before a write a random value has to go between the mock device and the adapter: let the device answer as usual first"
        problem = await prove_session(under_test)
        if problem is not None:
            # The next call may try again.
            under_test.cursor.withdraw_proof()
        return problem

    async def _own(self, witness: Witness, device: MockDevice, since_ns: int, *, waits: bool) -> list[Row]:
        """Return the adapter's rows of the journal since a call was begun."""
        end = time.monotonic() + (_ARRIVING_S if waits else 0.0)
        await witness.catch_up()
        while device.running and not any(row.entry["state_changing"] for row in _adapters(witness.rows, since_ns)):
            if (left_s := end - time.monotonic()) <= 0:
                break
            await witness.news(left_s)
        return _adapters(witness.rows, since_ns)

    def _note(self, tool: str, arguments: Mapping[str, object], claimed: Claim, seen: Seen) -> None:
        changing = None if seen.stopped else len(seen.changing)
        self._steps.append(Called(tool=tool, arguments=arguments, success=claimed.success, changing=changing))
        if seen.changing:
            self._wrote.add(tool)
            self._tell_state()

    # -- copies -------------------------------------------------------------------------------------------------------

    def copied(self, form: str, calls: int) -> str:
        """Return the last calls, with what was done to the device between them, as a ``test``; or the last one as a ``binding``.

        Raises:
            UsageError: there is no call.
        """
        steps = list(self._steps)
        places = [place for place, step in enumerate(steps) if isinstance(step, Called)]
        if not places:
            raise UsageError("there is no call to copy")
        last = steps[places[-1]]
        assert isinstance(last, Called)
        if form == "binding":
            return as_binding(self._adapter, last)
        first = places[-calls - 1] + 1 if 0 < calls < len(places) else 0
        return as_test(self._adapter.protocol, [*_standing(steps[:first]), *steps[first : places[-1] + 1]])


def _adapters(rows: Iterable[Row], since_ns: int) -> list[Row]:
    return [row for row in rows if row.entry["t_ns"] >= since_ns and row.entry["origin"] == ADAPTER]


def _proof(rows: Iterable[Row], began_ns: int, sent_ns: int) -> list[str]:
    """Return the names of the rows of what the adapter was asked before a call, to prove its session."""
    asked = [row for row in _adapters(rows, began_ns) if row.entry["t_ns"] < sent_ns]
    return [row.name for row in asked if row.entry["request"] or row.entry["answers"] is not None]


def _standing(steps: Sequence[Called | Done]) -> list[Done]:
    """Return what has to be done to a fresh device so that it is as it was after these steps, as far as they say: stopped, or with a fault."""
    standing: list[Done] = []
    for step in steps:
        if isinstance(step, Done) and step.what in ("stop", "start", "reset", "fault"):
            standing = [step] if step.what in ("stop", "fault") else []
    return standing
