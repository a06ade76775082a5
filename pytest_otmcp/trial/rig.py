"""The rig: one adapter at its device, as the steps of a repetition see it.

It has three parts: ``subject``, what the subject states of the adapter; ``device``, at which the steps look and which they change; and
``session``, at which they look beside its calls. Calls, the life of device and session, and what is judged of them are the rig's own. A
task's steps are judged in the same way whether adapter and device run or not: a player (``player``) does what they ask for, or hands out
what the history of a run has of it.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from typing import Any, cast

from ..core.finding import Finding
from ..core.verdict import INEXPRESSIBLE, UNBOUND
from ..protocols.journal import ADAPTER, judged
from ..protocols.proof import Proof
from ..protocols.protocol import READINGS
from ..protocols.registry import protocols
from ..record.schema import DeviceEntry, Footprint, Role
from ..subject.command import Command, names_in
from ..subject.model import READ_WRITE, Binding
from .alteration import Alteration
from .asked_for import AskedFor
from .cursor import Oracle
from .ledger import Entry, Ledger
from .limits import excess
from .named_readings import with_readings
from .player import FreshSession, Player
from .reply import Reply
from .session_in_rig import Guise, SessionInRig
from .write_gate import EndedError, WriteGate

__all__ = ["Command", "EndedError", "Entry", "Footprint", "FreshSession", "Guise", "Rig", "adapter_name"]


def adapter_name(protocol: str, variant: str) -> str:
    """Return the name that tasks use for an adapter variant."""
    return protocol if variant == READ_WRITE else f"{protocol}@{variant}"


_NOTICING_PAUSE_S = 0.05


class Rig(WriteGate):
    """One adapter at its device.

    Attributes:
        protocol, variant: the adapter whose session it is, such as ``modbus`` and ``rw``.
        name: protocol and variant in one, such as ``modbus`` and ``modbus@ro``.
        session: a look at the session beside its calls.
    """

    def __init__(self, player: Player) -> None:
        super().__init__(player)
        self.variant = player.variant
        self.name = adapter_name(player.protocol, player.variant)
        self.session = SessionInRig(player)

    def join(self, ledger: Ledger) -> None:
        """Write into the ledger of a repetition from now on."""
        self._ledger = ledger
        self._player.join(ledger)

    @property
    def time_scale(self) -> float:
        """The factor on windows and deadlines."""
        return self._ledger.time_scale

    def excess(self, operation: str, **inputs: object) -> str | None:
        """Return in words which bound of the tool's own schema a call with these inputs would not keep; None where it would keep
        all, or is not performed by one tool call."""
        cases = self.bindings(operation)
        binding = next((case for case in cases or () if case.fits(inputs)), None)
        if binding is None or binding.resource:
            return None
        return self._excess(operation, binding.tool, binding.fill(inputs, self._player.placeholders))

    # -- named commands and readings ----------------------------------------------------------------------

    def commands(self) -> list[tuple[str, Command]]:
        """Return the named commands of the subject, each with the operation that it performs first."""
        return self._named(readings=False)

    def readings(self) -> list[tuple[str, Command]]:
        """Return the named readings of the subject, each with the operation that it performs."""
        return self._named(readings=True) if self.subject.claims(READINGS) else []

    @property
    def proof(self) -> Proof:
        """What shows that a session talks to the mock device: that of the protocol, and the named readings of the subject."""
        return with_readings(protocols()[self.protocol].proof, self.protocol, self.readings())

    def _named(self, *, readings: bool) -> list[tuple[str, Command]]:
        return [
            (name, case.command)
            for name in protocols()[self.protocol].operations
            if self.subject.claims(name)
            for case in self.bindings(name) or ()
            if case.command is not None and (case.command.holds is not None) == readings
        ]

    def by_command_alone(self, operation: str) -> bool:
        """Tell whether a subject performs an operation by named commands or readings and in no other way."""
        cases = self.bindings(operation)
        return bool(cases) and all(case.command is not None for case in cases or ())

    def expresses(self, operation: str, inputs: Mapping[str, object]) -> bool:
        """Tell whether the subject's named commands, or readings, can express these inputs, where it performs the operation by them alone."""
        return not self.by_command_alone(operation) or self._player.is_bound(operation, inputs)

    def _is_command(self, operation: str, inputs: Mapping[str, object]) -> bool:
        return any(case.command is not None and case.fits(inputs) for case in self.bindings(operation) or ())

    def _must_express(self, operation: str, inputs: Mapping[str, object]) -> None:
        if not self.expresses(operation, inputs):
            reason = INEXPRESSIBLE[protocols()[self.protocol].operations[operation].writes]
        elif not self.subject.claims(operation) or self._is_voluntary_for_others(operation, inputs):
            reason = UNBOUND
        else:
            return
        if not any(finding.is_must for finding in self._ledger.findings):
            said = ", ".join(f"{name}={value!r}" for name, value in inputs.items())
            self._ledger.inapplicable = f"{reason} {operation} with {said:.60}"
        raise EndedError

    def _is_voluntary_for_others(self, operation: str, inputs: Mapping[str, object]) -> bool:
        """Tell whether bindings that nobody has to have are for other inputs than these."""
        voluntary = protocols()[self.protocol].operations[operation].voluntary
        return voluntary and bool(self.bindings(operation)) and not self._player.is_bound(operation, inputs)

    def _excess(self, operation: str, tool: str, arguments: Mapping[str, object]) -> str | None:
        listing = self.listing(operation, tool)
        return None if listing is None else excess(listing.get("inputSchema"), arguments)

    # -- what the steps of a task do ----------------------------------------------------------------------

    async def call(self, operation: str, *, role: Role | None = None, **inputs: object) -> Reply:
        """Perform an operation; see :meth:`pytest_otmcp.trial.adapter_under_test.AdapterUnderTest.call`.

        An operation that writes is performed only in a session that is proven to talk to the mock device.
        """
        return await self._call(operation, inputs, role)

    async def call_altered(
        self, operation: str, altered: Alteration, *, role: Role | None = None, **inputs: object
    ) -> Reply:
        """Perform an operation by a tool call whose arguments are changed; see :meth:`call`.

        The operation must be one of :meth:`alterable`.
        """
        return await self._call(operation, inputs, role, altered)

    async def call_beyond(self, operation: str, altered: Alteration, remark: Finding, **inputs: object) -> Reply:
        """Perform an operation as :meth:`call_altered` does, with arguments that no adapter must be able to read: to be answered by
        an error of MCP instead of a result, or not at all, is worth the remark and nothing else. The end of the session is a fault.
        """
        self._must_express(operation, inputs)
        await self._before(operation)
        inputs = self._complete(operation, inputs)
        reply = await self._player.perform(operation, inputs, altered)
        if reply.unread:
            reply = replace(reply, faults=(remark,))
        self._ledger.add(reply, inputs, altered=altered)
        if not (reply.answered or reply.unread):
            raise EndedError
        return reply

    async def _call(
        self, operation: str, inputs: Mapping[str, object], role: Role | None, altered: Alteration | None = None
    ) -> Reply:
        self._must_express(operation, inputs)
        writes = await self._before(operation)
        inputs = self._complete(operation, inputs)
        there = self.device.running
        reply = await self._player.perform(operation, inputs, altered)
        if reply.success is False:
            reply = replace(reply, excess=self._excess(operation, reply.tool, reply.arguments))
        self._ledger.add(reply, inputs, role, reachable=there and self.device.running, altered=altered)
        if writes:
            self._after(reply)
            # What a command of few values has failed to send will be asked for again.
            if not (there or reply.success or self._is_command(operation, inputs)):
                self._cursor.note_failed(inputs)
        if not reply.answered:
            raise EndedError
        return reply

    def _complete(self, operation: str, inputs: Mapping[str, object]) -> dict[str, object]:
        """Return inputs with what the schema of the tool requires beyond them, of that for which the operation has a default."""
        defaults = protocols()[self.protocol].operations[operation].defaults
        missing = {name: value for name, value in defaults.items() if name not in inputs}
        given = {name: value for name, value in missing.items() if self.subject.claims(f"{operation}.{name}")}
        arguments = self.arguments_of(operation, **inputs, **given) if given else None
        tool = self.tool_of(operation, **inputs)
        listing = None if tool is None or arguments is None else self.listing(operation, tool)
        schema = None if listing is None else listing.get("inputSchema")
        required = schema.get("required") if isinstance(schema, Mapping) else None
        if arguments is None or not isinstance(required, list):
            return dict(inputs)
        return {**inputs, **{name: value for name, value in given.items() if arguments.get(name) in required}}

    async def call_and_cancel(
        self,
        operation: str,
        *,
        seen: Mapping[str, object],
        timeout_s: float,
        meanwhile: Callable[[], Awaitable[object]] | None = None,
        **inputs: object,
    ) -> Reply:
        """Perform an operation and cancel the call as soon as the device has seen an entry that matches, or after the timeout.

        The reply is ``cancelled``, unless the answer came first.

        Args:
            meanwhile: is done after that and before the call is cancelled; a look of this rig.
        """
        self._must_express(operation, inputs)
        await self._before(operation)
        inputs = self._complete(operation, inputs)
        with nullcontext() if meanwhile is None else self._ledger.one_group():
            reply = await self._player.perform_and_cancel(
                operation, inputs, {"origin": ADAPTER, **seen}, timeout_s, meanwhile
            )
            self._ledger.add(reply, inputs)
        return reply

    def arguments_of(self, operation: str, **inputs: object) -> dict[str, str] | None:
        """Return the inputs of an operation by the tool argument that each is given as, where it is given as it is.

        None where the operation is not performed by one tool call, so that its arguments cannot be changed.
        """
        cases = self.bindings(operation)
        binding = next((case for case in cases or () if case.fits(inputs)), None)
        if binding is None or binding.resource:
            return None
        taken = {value: name for name, value in binding.arguments.items() if isinstance(value, str)}
        if binding.command is not None:
            # An input that a value has a part in.
            parts = {name: sorted(names_in(template)) for name, template in binding.command.effect.items()}
            return {name: taken[f"${found[0]}"] for name, found in parts.items() if found and f"${found[0]}" in taken}
        return {
            name: taken[f"${name}"]
            for name in inputs
            if f"${name}" in taken and name not in {*binding.offset, *binding.names, *binding.convert}
        }

    def drawn_for(self, operation: str, name: str, **inputs: object) -> object:
        """Return the value of the argument of a named command, or reading, that makes an input; None where neither performs the operation."""
        cases = self.bindings(operation)
        binding = next((case for case in cases or () if case.fits(inputs)), None)
        if binding is None or binding.command is None:
            return None
        (part, *_) = sorted(names_in(binding.command.effect[name]))
        return (binding.command.arguments(inputs) or {}).get(part)

    def argument_drawn(self, operation: str, part: str, **inputs: object) -> str | None:
        """Return the argument of the tool that is given what a named command draws under this name, as it is; None where none is."""
        cases = self.bindings(operation)
        binding = next((case for case in cases or () if case.fits(inputs)), None)
        given = {} if binding is None else binding.arguments
        return next((name for name, value in given.items() if value == f"${part}"), None)

    def words_of(self, operation: str, **inputs: object) -> list[Any]:
        """Return what the words of a named reading mean at the device; none where its answers are no words."""
        cases = self.bindings(operation)
        binding = next((case for case in cases or () if case.fits(inputs)), None)
        rules = () if binding is None else binding.outputs.values()
        return [meant for rule in rules if isinstance(rule.means, Mapping) for meant in rule.means.values()]

    def tool_of(self, operation: str, **inputs: object) -> str | None:
        """Return the tool that performs an operation; None where it is not performed by one tool call."""
        cases = self.bindings(operation)
        return next((case.tool for case in cases or () if case.fits(inputs) and not case.resource), None)

    async def call_until_success(
        self, operation: str, *, window_s: float, from_first_call: bool = False, **inputs: Any
    ) -> list[Reply]:
        """Call until the adapter succeeds or the window, counted from the moment the device accepts connections,
        is over. Only the last call has the repetition's role; the calls before it have the role ``recovery``.

        Args:
            operation, inputs: as of :meth:`call`.
            window_s: length of the window.
            from_first_call: the window is counted from the first of these calls: the device was there, and has worked badly.
        """
        window_ns = int(window_s * self._ledger.time_scale * 1e9)
        replies: list[Reply] = []
        while True:
            reply = await self.call(operation, **inputs)
            replies.append(reply)
            end = window_ns + (replies[0].exchange.sent_ns if from_first_call else self.device.accepting_ns)
            # A call may begin too early and answer late: only a call that began after the window is the last.
            if reply.success or (len(replies) > 1 and reply.exchange.sent_ns >= end):
                return replies
            self._ledger.set_aside(reply)
            await self._player.reconnecting()

    async def call_until_failure(self, operation: str, *, window_s: float, **inputs: Any) -> Reply:
        """Call until the adapter has noticed that the device is gone, or the window, counted from the first call, is over.
        Only the last call has the repetition's role; the calls before it have the role ``recovery``.
        """
        window_ns = int(window_s * self._ledger.time_scale * 1e9)
        begun_ns = None
        while True:
            reply = await self.call(operation, **inputs)
            begun_ns = begun_ns or reply.exchange.sent_ns
            if not reply.success or reply.exchange.sent_ns - begun_ns >= window_ns:
                return reply
            self._ledger.set_aside(reply)
            await self.pause(_NOTICING_PAUSE_S)

    async def stays_quiet(self, seconds: float, judge: Callable[[list[Entry]], list[Finding]]) -> None:
        """Watch the device for a while, then judge what reached it; for messages that must not come.

        Shorter deadlines do not make a message come sooner, so a time scale below 1 leaves this window as it is.
        """
        await self.watch(seconds)
        self._ledger.witnessed(judge(await self.journal()))

    async def watch(self, seconds: float) -> None:
        """Leave the adapter alone for a while; see :meth:`stays_quiet`."""
        await self.pause(seconds * max(1.0, self._ledger.time_scale))

    async def keep_journal(self) -> None:
        """Keep what the device's journal holds of this repetition, before the device's process or the repetition ends."""
        # The read-only variant has a device of its own, whose entries count from 0 as well.
        variant = {} if self.variant == READ_WRITE else {"variant": self.variant}
        entries = await self._player.take_slice()
        self._compare(judged(entries))
        self._claimed = 0
        kept = ({"protocol": self.protocol, **variant, **entry} for entry in entries)
        self._ledger.journal.extend(cast(DeviceEntry, entry) for entry in kept)

    async def stop_device(self) -> float:
        """Kill the device process and keep its journal with this repetition; return the milliseconds that the kill took."""
        await self.keep_journal()
        return await self._player.stop()

    async def start_device(self) -> float:
        """Start a new device process on the same port; return the milliseconds until it accepted connections."""
        return await self._player.start()

    async def fresh_session(self) -> FreshSession:
        """End the adapter's session and process, and start anew; the new session is in use from now on."""
        # The oracles of the session that ends are to see what it did to its end.
        if self.device.running:
            await self._feed()
        fresh = await self._player.replace_session()
        if fresh.ended in ("terminated", "killed"):
            self._ledger.finding(
                "does_not_exit",
                f"{self.protocol}: the adapter did not exit within {fresh.seconds:.1f} s of its stdin closing and had "
                f"to be {fresh.ended}",
                requirement="MCP-009",
            )
        return fresh

    async def open_by_handshake(self) -> bool:
        """End the session and start the adapter anew in MCP's era of the handshake, 2025-11-25 and older; return whether there is such a
        session now. It is replaced by its like until :meth:`close_handshake_era`.

        Where the session is of that era already nothing is done: the adapter speaks no newer one, or the subject file says so.
        """
        # The oracles of the session that ends are to see what it did to its end.
        if self.device.running:
            await self._feed()
        return (await self._player.open_by_handshake())["revision"] is not None

    async def close_handshake_era(self) -> None:
        """End the session and its process; the next session is opened as the subject file and the run's options say."""
        await self._player.close_handshake_era()

    async def garble_switch(self) -> bool:
        """After the session was closed, start the adapter with a write switch whose value means nothing; return whether there is a
        session then."""
        return await self._player.start_garbled()

    async def start_without_certificate(self) -> bool:
        """After the session was closed, start the adapter without the files of its own certificate; return whether there is a session then."""
        return await self._player.start_without_certificate()

    async def close_session(self) -> None:
        """End the adapter's session and its process."""
        await self._player.close_session()

    def session_faults(self) -> list[Finding]:
        """Return what is wrong with the session as such, as far as its device has seen it; each fault once."""
        return self._cursor.take_faults()

    @property
    def asked_for(self) -> AskedFor:
        """What the adapter's calls have asked for, in earlier items as well."""
        return self._cursor.asked_for

    async def prove_first(self) -> None:
        """Prove the session before the steps, with a slice of the journal of its own: the steps' slice begins after it."""
        if self._cursor.proven is None:
            await self.prove()
            await self.keep_journal()

    # -- the journal --------------------------------------------------------------------------------------

    async def journal(self) -> list[Entry]:
        entries, _ = await self._player.entries("journal", self._cursor.next)
        return judged(entries)

    async def wait_for(self, *, timeout_s: float, count: int = 1, **match: object) -> list[Entry]:
        """Return the adapter's journal entries of this repetition that match, as soon as there are ``count``, or after the
        timeout."""
        return await self._player.wait({"origin": ADAPTER, **match}, timeout_s=timeout_s, count=count)

    async def session_journal(self) -> list[Entry]:
        """Return the entries of this repetition since the adapter's session was opened.

        A session of earlier repetitions caused more entries than these: :meth:`follow` judges all of them.
        """
        entries, _ = await self._player.entries("session_journal", self._cursor.began)
        return judged(entries)

    async def follow(self, kind: type[Oracle]) -> Oracle:
        """Return the session oracle of this kind, which has seen everything that the session did at the device so far."""
        await self._feed()
        return self._cursor.oracle(kind)

    async def _feed(self) -> None:
        entries, end = await self._player.entries("followed", self._cursor.fed)
        self._cursor.feed(entries, end)

    def bindings(self, operation: str) -> Sequence[Binding] | None:
        """Return the subject's bindings of an operation; None for one that a Python function performs."""
        return self._player.bindings(operation)

    def listing(self, operation: str, tool: str) -> Mapping[str, object] | None:
        """Return what ``tools/list`` says of the tool that a binding of this operation calls; None where it says nothing."""
        return self._player.listing(operation, tool)
