"""Tries guesses at a mock device: what the device saw, and where its values turn up in the answer, is the proof."""

from __future__ import annotations

import base64
import random
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, cast

from ..core.strict_json import parse_strict
from ..plant.mock_device import MockDevice
from ..protocols.journal import JournalEntry
from ..protocols.opcua.oracle import children_of, folder_id, some_service
from ..subject.answers import read_answer
from ..subject.model import Answering, Binding
from ..trial.adapter_under_test import AdapterUnderTest
from .evidence import Found, find, lists_in
from .vocabulary import Guess

__all__ = ["Proposal", "Trier"]

Entry = dict[str, Any]

_TRIES = 4
"""Likeliest tools that are tried for an operation."""

_VALVE = "ns=2;s=ValvePosition"
_MISSING_NODE = "ns=2;i=99999"


@dataclass(slots=True, kw_only=True)
class Proposal:
    """A binding, and what speaks for it.

    Attributes:
        proven: the device has seen what it should have seen.
        evidence: sentences for the file's comments.
        form: where the answer's document is: ``structured``, ``json`` or ``text``.
        outputs: output to its rule.
        good, bad: answers to a call that succeeded and to one that had to fail.
    """

    guess: Guess
    proven: bool
    evidence: list[str]
    offset: dict[str, int] = field(default_factory=dict)
    form: str | None = None
    outputs: dict[str, Mapping[str, Any]] = field(default_factory=dict)
    good: Mapping[str, Any] | None = None
    bad: Mapping[str, Any] | None = None
    bad_code: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Shown:
    """What a call showed: the answer, or why there is none, and what reached the device."""

    message: Mapping[str, Any] | None
    entries: list[Entry]
    words: str


class Trier:
    """Tries guesses through one open station."""

    def __init__(self, station: AdapterUnderTest, device: MockDevice, seed: int = 0) -> None:
        self._station = station
        self._device = device
        self._random = random.Random(f"proposal/{seed}")

    async def best(self, guesses: list[Guess]) -> Proposal | None:
        """The first guess that the device confirms, else the likeliest one with what was seen."""
        tried: list[Proposal] = []
        for variation in (variation for guess in guesses[:_TRIES] for variation in guess.variations()):
            proposal = await self._try(variation)
            if proposal.proven:
                return proposal
            tried.append(proposal)
        return tried[0] if tried else None

    async def _try(self, guess: Guess) -> Proposal:
        if guess.missing:
            lacking = ", ".join(guess.missing)
            return Proposal(guess=guess, proven=False, evidence=[f"not tried: no idea what to give for {lacking}"])
        experiments: dict[str, Callable[[Guess], Awaitable[Proposal]]] = {
            "ping": self._reaches,
            "info": self._reaches,
            "read_input": self._read_registers,
            "read_holding": self._read_registers,
            "write_holding": self._write_register,
            "subscribe": self._subscribe,
            "messages": self._messages,
            "publish": self._publish,
            "device_birth": self._sparkplug,
            "device_data": self._sparkplug,
            "read": self._read_node,
            "read_many": self._read_nodes,
            "browse": self._browse,
            "write": self._write_node,
            "variables": self._variables,
        }
        return await experiments[guess.operation](guess)

    async def _call(self, guess: Guess, offset: Mapping[str, int], **inputs: Any) -> _Shown:
        station = self._station
        binding = Binding(
            tool=guess.tool,
            arguments=guess.arguments,
            outputs={},
            answering=Answering(form="text"),
            when={},
            offset=offset,
            names={},
            convert=guess.convert,
        )
        await station.open()
        assert station.session is not None
        since = await self._device.mark()
        arguments = binding.fill(inputs, station.endpoint)
        exchange = await station.session.call(guess.tool, arguments, timeout_s=1.2 * station.deadline_s)
        if station.adapter.protocol == "mqtt":
            # A message without acknowledgement is still on its way when the answer is there.
            await self._device.wait(since, {"kind": "PUBLISH", "direction": "in"}, timeout_s=0.2)
        entries = cast("list[Entry]", (await self._device.journal(since)).entries)
        if exchange.response is None:
            return _Shown(message=None, entries=entries, words=f"no answer ({exchange.failure})")
        try:
            message = parse_strict(exchange.response)
        except ValueError as error:
            return _Shown(message=None, entries=entries, words=f"an answer that is no strict JSON ({error})")
        return _Shown(message=message, entries=entries, words=_words(message))

    # -- any protocol -------------------------------------------------------------------------------------

    async def _reaches(self, guess: Guess) -> Proposal:
        shown = await self._call(guess, {})
        exchanged = any(entry.get("direction", "in") == "in" for entry in shown.entries)
        evidence = [
            "the device saw an exchange" if exchanged else f"the device saw nothing; the answer: {shown.words}",
        ]
        return Proposal(guess=guess, proven=exchanged, evidence=evidence, good=shown.message)

    def _judged(self, guess: Guess, shown: _Shown, *, proven: bool, seen: str) -> Proposal:
        evidence = [f"the device saw {seen}" if proven else f"the device saw {seen or 'nothing of it'}; {shown.words}"]
        return Proposal(guess=guess, proven=proven, evidence=evidence, good=shown.message)

    def _locate(self, proposal: Proposal, output: str, expected: Any) -> None:
        """Look for a value that the device is known to have given."""
        found: Found | None = None if proposal.good is None else find(proposal.good, expected)
        if found is None:
            proposal.evidence.append(f"the value {str(expected)[:60]} was not found in the answer: fill in 'result'")
            return
        proposal.form = found.form
        proposal.outputs[output] = found.rule
        proposal.evidence.append(f"the value {str(expected)[:60]} of the device was found there")

    def _locate_echo(self, proposal: Proposal, output: str, expected: Any) -> None:
        """A value that an answer may repeat; only where a structure says that it is one, not somewhere in a sentence."""
        found = None if proposal.good is None else find(proposal.good, expected, ("structured", "json"))
        if found is not None and set(found.rule) == {"path"} and found.form == (proposal.form or found.form):
            proposal.form = found.form
            proposal.outputs[output] = found.rule

    # -- Modbus -------------------------------------------------------------------------------------------

    async def _read_registers(self, guess: Guess) -> Proposal:
        table, function = {
            "read_input": ("input_registers", 4),
            "read_holding": ("holding_registers", 3),
        }[guess.operation]
        values = [self._random.randrange(2000, 0x10000) for _ in range(3)]
        await self._device.poke(unit=1, table=table, address=10, values=values)
        shown = await self._call(guess, {}, address=10, count=3)
        offset: dict[str, int] = {}
        asked = _request(shown.entries, function)
        if asked is None or asked["address"] != 10:
            base = 0 if asked is None else 10 - asked["address"]
            for candidate in dict.fromkeys(
                (base, 40001 if function == 3 else 30001, 40000 if function == 3 else 30000, 1)
            ):
                if candidate:
                    again = await self._call(guess, {"address": candidate}, address=10, count=3)
                    request = _request(again.entries, function)
                    if request is not None and request["address"] == 10:
                        shown, asked, offset = again, request, {"address": candidate}
                        break
        proven = asked is not None and asked["address"] == 10 and asked["quantity"] == 3
        seen = (
            "" if asked is None else f"function {function} for address {asked['address']}, quantity {asked['quantity']}"
        )
        proposal = self._judged(guess, shown, proven=proven, seen=seen)
        proposal.offset = offset
        self._locate(proposal, "values", values)
        if proven:
            failing = await self._call(guess, offset, address=9999, count=1)
            proposal.bad, proposal.bad_code = failing.message, "illegal_address"
        return proposal

    async def _write_register(self, guess: Guess) -> Proposal:
        value = self._random.randrange(2000, 0x10000)
        offset: dict[str, int] = {}
        shown = await self._call(guess, offset, address=12, value=value)
        written = _written(shown.entries)
        if written is None or written["address"] != 12:
            for candidate in (40001, 40000, 1):
                again = await self._call(guess, {"address": candidate}, address=12, value=value)
                request = _written(again.entries)
                if request is not None and request["address"] == 12:
                    shown, written, offset = again, request, {"address": candidate}
                    break
        proven = written is not None and written["address"] == 12 and written["values"] == [value]
        seen = (
            ""
            if written is None
            else f"function {written['function']} for address {written['address']}, {written['values']}"
        )
        proposal = self._judged(guess, shown, proven=proven, seen=seen)
        proposal.offset = offset
        if proven:
            self._locate_echo(proposal, "value", value)
            failing = await self._call(guess, offset, address=12, value=70000)
            proposal.bad, proposal.bad_code = failing.message, "range_overflow"
        return proposal

    # -- MQTT ---------------------------------------------------------------------------------------------

    async def _subscribe(self, guess: Guess) -> Proposal:
        shown = await self._call(guess, {}, filter="otmcp/init/#", qos=0)
        seen = [entry for entry in shown.entries if entry["kind"] == "SUBSCRIBE" and "otmcp/init/#" in str(entry)]
        return self._judged(guess, shown, proven=bool(seen), seen="a SUBSCRIBE for the filter" if seen else "")

    async def _messages(self, guess: Guess) -> Proposal:
        nonce = f"nonce-{self._random.getrandbits(48):012x}"
        since = await self._device.mark()
        message = {
            "topic": "otmcp/init/x",
            "payload": base64.b64encode(nonce.encode()).decode(),
            "qos": 0,
            "retain": False,
        }
        await self._device.poke(publish=message)
        await self._device.wait(since, {"kind": "PUBLISH", "direction": "out"}, timeout_s=1.0)
        shown = await self._call(guess, {}, filter="otmcp/init/x")
        proven = nonce in str(shown.message)
        proposal = self._judged(
            guess, shown, proven=proven, seen="to it that the message it published is in the answer"
        )
        if not proven:
            proposal.evidence = [f"a message that was published was not in the answer: {shown.words}"]
            return proposal
        for form in ("structured", "json"):
            place = find(shown.message or {}, nonce, (form,))
            if place is not None and "[0]." in str(place.rule.get("path")):
                listed, payload = str(place.rule["path"]).split("[0].", 1)
                proposal.form = form
                proposal.outputs["messages"] = {"path": f"{listed}[].{{topic: topic, payload: {payload}}}"}
                return proposal
        proposal.evidence.append("where topic and payload are in the answer was not recognised: fill in 'result'")
        return proposal

    async def _publish(self, guess: Guess) -> Proposal:
        nonce = f"nonce-{self._random.getrandbits(48):012x}"
        shown = await self._call(guess, {}, topic="otmcp/init/y", payload=nonce, qos=0)
        seen = [entry for entry in shown.entries if entry["kind"] == "PUBLISH" and entry["direction"] == "in"]
        own = [entry for entry in seen if entry.get("topic") == "otmcp/init/y"]
        proposal = self._judged(
            guess, shown, proven=bool(own), seen=f"a PUBLISH with QoS {own[0].get('qos')}" if own else ""
        )
        if own:
            failing = await self._call(guess, {}, topic="", payload=nonce, qos=0)
            proposal.bad, proposal.bad_code = failing.message, "invalid_input"
        return proposal

    async def _sparkplug(self, guess: Guess) -> Proposal:
        kind = "DBIRTH" if guess.operation == "device_birth" else "DDATA"
        metric: dict[str, Any] = {"name": "temperature", "value": 20.5}
        if kind == "DBIRTH":
            metric["datatype"] = "Double"
        shown = await self._call(guess, {}, device="device-1", metrics=[metric])
        seen = [
            entry for entry in shown.entries if f"/{kind}/" in str(entry.get("topic")) and entry["direction"] == "in"
        ]
        return self._judged(guess, shown, proven=bool(seen), seen=f"a {kind}" if seen else "")

    # -- OPC UA -------------------------------------------------------------------------------------------

    async def _read_node(self, guess: Guess) -> Proposal:
        value = round(self._random.uniform(10.0, 90.0), 4)
        await self._device.poke(node="Temperature", value=value)
        shown = await self._call(guess, {}, node="ns=2;s=Temperature")
        seen = any(entry["kind"] == "Read" and "ns=2;s=Temperature" in str(entry) for entry in shown.entries)
        proposal = self._judged(guess, shown, proven=seen, seen="a Read of the node" if seen else "")
        self._locate(proposal, "value", value)
        if seen:
            failing = await self._call(guess, {}, node=_MISSING_NODE)
            proposal.bad, proposal.bad_code = failing.message, "illegal_address"
        return proposal

    async def _read_nodes(self, guess: Guess) -> Proposal:
        values = [round(self._random.uniform(10.0, 90.0), 4) for _ in range(2)]
        names = ("Temperature", "Pressure")
        for name, value in zip(names, values, strict=True):
            await self._device.poke(node=name, value=value)
        shown = await self._call(guess, {}, nodes=[f"ns=2;s={name}" for name in names])
        seen = all(any(f"ns=2;s={name}" in str(entry) for entry in shown.entries) for name in names)
        proposal = self._judged(guess, shown, proven=seen, seen="a Read of both nodes" if seen else "")
        self._locate(proposal, "values", values)
        return proposal

    async def _browse(self, guess: Guess) -> Proposal:
        image = await self._device.image()
        folder = folder_id(image, "Actuators")
        children = children_of(image, "Actuators")
        shown = await self._call(guess, {}, node=folder)
        seen = any(entry["kind"] == "Browse" and folder in str(entry) for entry in shown.entries)
        proposal = self._judged(guess, shown, proven=seen, seen="a Browse of the folder" if seen else "")
        self._locate_in_any_order(proposal, "node_ids", set(children.values()))
        self._locate_in_any_order(proposal, "browse_names", set(children))
        return proposal

    def _locate_in_any_order(self, proposal: Proposal, output: str, expected: set[str]) -> None:
        for form, rule, found in lists_in(proposal.good or {}):
            if set(found) == expected:
                proposal.form = proposal.form or form
                if form == proposal.form:
                    proposal.outputs[output] = rule
                    proposal.evidence.append(f"{len(expected)} {output} of the device were found there")
                    return
        proposal.evidence.append(f"the {output} of the device were not found in the answer: fill in 'result'")

    async def _write_node(self, guess: Guess) -> Proposal:
        value = round(self._random.uniform(10.0, 90.0), 2)
        shown = await self._call(guess, {}, node=_VALVE, value=value)
        image = await self._device.image()
        seen = any(entry["kind"] == "Write" and _VALVE in str(entry) for entry in shown.entries)
        proven = seen and str(value) in str(image)
        proposal = self._judged(guess, shown, proven=proven, seen="a Write, and holds the value" if proven else "")
        if proven:
            self._locate_echo(proposal, "value", value)
            failing = await self._call(guess, {}, node=_VALVE, value="fully open")
            proposal.bad, proposal.bad_code = failing.message, "type_mismatch"
        return proposal

    async def _variables(self, guess: Guess) -> Proposal:
        image = await self._device.image()
        shown = await self._call(guess, {})
        seen = not some_service(cast("list[JournalEntry]", shown.entries))
        proposal = self._judged(guess, shown, proven=seen, seen="services" if seen else "")
        self._locate_in_any_order(proposal, "node_ids", set(image["variables"]))
        proposal.proven = proposal.proven and "node_ids" in proposal.outputs
        return proposal


def _request(entries: list[Entry], function: int) -> Entry | None:
    return next((entry for entry in entries if entry["kind"] == "request" and entry["function"] == function), None)


def _written(entries: list[Entry]) -> Entry | None:
    return next((entry for entry in entries if entry["kind"] == "request" and entry["function"] in (6, 16)), None)


def _words(message: Mapping[str, Any]) -> str:
    _, text, is_error = read_answer(message, "text")
    return f"it {'failed' if is_error else 'answered'}: {' '.join(text.split())[:160]!r}"
