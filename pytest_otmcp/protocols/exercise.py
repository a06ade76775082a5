"""How a check that holds for every protocol reads and writes on one of them, and makes its device fall silent. Pure.

A check of the requirement suite that is about any adapter, whatever it talks to, asks the protocol's description what to do:
see :class:`Exercise`. A protocol without one has no such checks.
"""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from .journal import Entries, JournalEntry

__all__ = [
    "LARGEST_FLOAT32",
    "NO_INTEGERS",
    "NO_REALS",
    "READING",
    "THEN",
    "Asked",
    "Clamped",
    "Contended",
    "DeviceText",
    "Exercise",
    "Limited",
    "Texts",
    "Waiting",
    "Writing",
    "every_change",
    "number_in_json",
]

THEN = "then"
"""Name, among the inputs of an operation, of what else a named command asks of the device after it: a list of operations with their inputs."""
READING = "reading"
"""Name, among the inputs of an operation, of the named reading that performs it."""
LARGEST_FLOAT32: float = struct.unpack(">f", bytes.fromhex("7f7fffff"))[0]
"""The largest finite number of 32 bits (IEEE 754)."""
NO_INTEGERS = (40.7, "abc", "40", [40], None)
NO_REALS = ("abc", "7.5", True, [7.5], None)
"""What is no value of a whole number, or of a floating-point number; some would be one after a conversion that nobody asked for."""

Poke = Mapping[str, object]
"""What a mock device is told to set out of band."""

Rule = Mapping[str, object]
"""A rule of the mock's fault plan."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """One call whose good answer is known.

    Attributes:
        operation: its name.
        inputs: of the operation; values are random, so that no other call has the same answer.
        outputs: what a successful answer has to say.
        pokes: what is set at the mock before the call.
        points: what the device's image holds after a write, by point; empty where the device has no such image.
        sent: what the request that writes says beside the value, such as a control code, by the names of ``says``.
        then: what the same call asks of the device after that, in this order, where a named command has several effects.
        condition: of a fault plan, which the requests of this call meet, and those of calls for something else do not.
    """

    operation: str
    inputs: Mapping[str, Any]
    outputs: Mapping[str, Any] = field(default_factory=dict)
    pokes: tuple[Poke, ...] = ()
    points: Mapping[str, object] = field(default_factory=dict)
    sent: Mapping[str, object] = field(default_factory=dict)
    then: tuple[Asked, ...] = ()
    condition: Rule = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Contended:
    """Writes and a read of one and the same target, for calls at the same time.

    Attributes:
        old: the value that the target holds before.
        new: the values that are written, by one write each.
        pokes: what sets the old value at the mock.
        first: the call that writes the old value, where it is a master's own and cannot be set at the mock; else None.
        read: the call that reads; it has no outputs, since any of the values may be right.
        output: the output of the read that is the value.
        writes: the calls that write, in the order of the new values.
    """

    old: object
    new: tuple[object, ...]
    pokes: tuple[Poke, ...]
    read: Asked
    output: str
    writes: tuple[Asked, ...]
    first: Asked | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Clamped:
    """A write that the device confirms, although it stores another value.

    Attributes:
        write: the call.
        output: the output that says what was written.
        held: the value that the device holds then.
        action: of the fault rules that make it so.
    """

    write: Asked
    output: str
    held: object
    action: Rule


@dataclass(frozen=True, slots=True, kw_only=True)
class Texts:
    """Reads and writes of a text.

    Attributes:
        encoding: the characters that the device can hold, as a codec of Python.
        longest: how many characters of one byte each a text may have that is asked for.
        limited: a longer one has no room at the device.
        filled_up: zero bytes fill a text up, so that the first one may be its end.
        read: makes a read of a text that is set at the mock before.
        write: makes a write of a text, with the points that hold it.
    """

    encoding: str
    longest: int
    limited: bool = True
    filled_up: bool = False
    read: Callable[[str], Asked]
    write: Callable[[str], Asked]


@dataclass(frozen=True, slots=True, kw_only=True)
class Limited:
    """A number that limits are asked for.

    Attributes:
        ways: make a write of the number, in the device's own terms, each by another operation, name or form.
        unit: what makes a number another one in all of these.
        given_as: the input that is the number, for what is no number.
    """

    ways: tuple[Callable[[float], Asked], ...]
    unit: float
    given_as: str = "value"


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceText:
    """A place where the device itself supplies a text, and the call that brings it to the adapter's client.

    Attributes:
        place: in words that follow "as".
        ask: makes the call for a text; its pokes put the text there. No two texts disturb each other.
        longest: characters that the place holds.
        encoding: the characters that it can hold, as a codec of Python.
        controls: they may be control characters.
        first: a call without which the text does not reach the adapter, such as a subscription.
        then: a call on the same connection: when it is answered, the adapter has read what the device sent before.
        output: the part of an answer that has the text, where an adapter may do without it.
    """

    place: str
    ask: Callable[[str], Asked]
    longest: int
    encoding: str = "utf-8"
    controls: bool = True
    first: Asked | None = None
    then: Asked | None = None
    output: str | None = None


def _no_points(operation: str, inputs: Mapping[str, Any]) -> Mapping[str, object]:
    return {}


def _no_refusals(entry: JournalEntry) -> Sequence[str]:
    return ()


def _must_be_done(entry: JournalEntry) -> str | None:
    return "WR-001"


@dataclass(frozen=True, slots=True, kw_only=True)
class Waiting:
    """A read by a call that waits for what it answers, for adapters that have no other one.

    Attributes:
        operation: its name.
        read: makes a call that the device has to answer; the argument behind the random numbers is how many seconds it may wait.
        device_texts: as the exercise's own, for an adapter whose calls of this operation wait; the second argument as for ``read``.
    """

    operation: str
    read: Callable[[random.Random, int], Asked]
    device_texts: Callable[[str, int], tuple[DeviceText, ...]] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Writing:
    """A write by another operation, for adapters that do not have that of the exercise.

    Attributes:
        operation: its name.
        write: as the exercise's own; inputs that a subject claims by binding them are left out where it does not.
        outside: as the exercise's own.
    """

    operation: str
    write: Callable[[random.Random], Asked]
    outside: Mapping[str, tuple[object, ...]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Exercise:
    """What checks for every protocol do on this one.

    Attributes:
        reading: name of the operation that reads.
        read: makes a call that changes nothing, and that the device has to answer during the call.
        waiting: takes the place of this read where the adapter has no operation for it; None where nothing does.
        writing: name of the operation that writes.
        write: makes a call that changes one thing at the device, by one request.
        otherwise: writes that take the place of this one where the adapter has no operation for it, the best first.
        number: the input of the write that is a number of limited range; None where there is none.
        bounded: inputs of the read and the write whose range the protocol itself limits.
        done: returns the requests among entries that ask the device for what a write asks for.
        too_late: id of the requirement that a success breaks which is told before the device sees this request that writes; None where no
            device confirms such a request, which may be on its way then.
        reads, writes: the conditions of a fault plan that the requests of the read, or of the write, meet, in whichever way an
            adapter makes them.
        silent: rules with which the device takes every request and never answers.
        reset: rules with which the device resets the connection instead of answering.
        refused: rules with which the device refuses what is read, by an answer of the protocol.
        unauthorised: rules with which the device refuses the account of a client that connects; empty where it knows no accounts.
        every_writing: the conditions that the request of each operation that writes meets, where ``writes`` are those of the usual one
            alone; empty where all writes are alike.
        write_refused: action of a fault rule with which the device refuses a write, and the code of the failure that this is; None where
            checks of the protocol's own have it.
        outside: values that are outside of the protocol's own domain of an input of the read or the write, by input; some are the good
            value when they are cut down to fit.
        unanswered: those of them that can be sent, such as an address that no device may have: that nothing answered is as good a failure.
        refusals: returns the keys of ``codes.toml`` by which an answer refuses what was asked for; none of another entry.
        distinct: makes so many reads, at most 64, of several targets, each with a condition of its own; None where there are none.
        every_read: makes reads by every operation that reads values, and of every type that has a form of its own; None where there are
            none.
        every_write: makes writes by every operation that writes; each changes what the device held before, by one request, and says all
            points that it changes. None where there are none.
        tells: makes a call by every further operation that writes, although the device does not hold what is written; None where there
            are none.
        clamped: makes a write that the device confirms and does not carry out as asked; None where no device can be made to.
        contended: makes writes and a read of one target; None where nothing can be read that was written.
        fenced: makes writes beside one another, by every operation that writes, some across the ends of what a list of targets can allow; the
            points of each are all its targets. None where there are none.
        limited: numbers whose limits can be asked for, by the name of the target.
        large: makes a read of each of these whole numbers of 64 bits, of a type with a sign or of one without; None where checks of the
            protocol's own have it.
        floats: make a read of a number, which may be infinite or no number at all: of the type ``float32``, and of ``float64``; empty where
            checks of the protocol's own have it.
        real: makes a write of a floating-point number of 32 bits, which is its input ``value``; its points may be left out.
        texts: reads and writes of a text; None as for ``large``.
        device_texts: returns the places where the device supplies texts; the argument is a name that nothing else has. None where no
            operation returns one.
        bounds: makes writes of values at a bound of their type, each with a value just beyond; None as for ``large``.
        misfits: makes writes, each with values of other kinds than the target's; None as for ``large``.
        commands: makes writes that say more than a value; an adapter may refuse what it does not offer. None where there are none.
        says: returns what a request of ``commands`` says, by name; None for another request.
        asks_for: returns what a request that writes asks for, as the values of ``contended`` are; None for another request.
        points_of: returns the points that the device's image holds after a write, from the operation and its inputs; none where the device
            has no such image, or where that cannot be told from the inputs alone.
        held: returns the poke that has the mock hold another value than this one at a point; None where that is not to be had.
        recognised: by operation that writes, whether a request asks for what its inputs say: what tells the requests of one call apart. Named
            commands may have several effects of these operations.
        changing: the conditions of a fault plan that any request meets which changes the plant; empty where those are ``writes``.
        commanded: makes a write, or several by one call, by every named command of the subject; None for a subject without.
    """

    reading: str
    read: Callable[[random.Random], Asked]
    writing: str
    write: Callable[[random.Random], Asked]
    number: str | None
    bounded: tuple[str, ...]
    done: Callable[[Entries, Asked], list[JournalEntry]]
    reads: tuple[Rule, ...]
    writes: tuple[Rule, ...]
    silent: tuple[Rule, ...]
    reset: tuple[Rule, ...]
    refused: tuple[Rule, ...]
    waiting: Waiting | None = None
    otherwise: tuple[Writing, ...] = ()
    unauthorised: tuple[Rule, ...] = ()
    write_refused: tuple[Mapping[str, object], str] | None = None
    every_writing: tuple[Rule, ...] = ()
    outside: Mapping[str, tuple[object, ...]] = field(default_factory=dict)
    unanswered: Mapping[str, tuple[object, ...]] = field(default_factory=dict)
    refusals: Callable[[JournalEntry], Sequence[str]] = _no_refusals
    distinct: Callable[[random.Random, int], tuple[Asked, ...]] | None = None
    every_read: Callable[[random.Random], tuple[Asked, ...]] | None = None
    every_write: Callable[[random.Random], tuple[Asked, ...]] | None = None
    tells: Callable[[random.Random], tuple[Asked, ...]] | None = None
    clamped: Callable[[random.Random], Clamped] | None = None
    contended: Callable[[random.Random], Contended] | None = None
    commands: Callable[[random.Random], tuple[Asked, ...]] | None = None
    says: Callable[[JournalEntry], Mapping[str, Any] | None] | None = None
    asks_for: Callable[[JournalEntry], object] | None = None
    bounds: Callable[[], tuple[tuple[Asked, object], ...]] | None = None
    misfits: Callable[[], tuple[tuple[Asked, tuple[object, ...]], ...]] | None = None
    fenced: Callable[[random.Random], tuple[Asked, ...]] | None = None
    limited: Mapping[str, Limited] = field(default_factory=dict)
    large: Callable[[Sequence[int], bool], tuple[Asked, ...]] | None = None
    floats: Mapping[str, Callable[[float], Asked]] = field(default_factory=dict)
    real: Callable[[float], Asked] | None = None
    texts: Texts | None = None
    device_texts: Callable[[str], tuple[DeviceText, ...]] | None = None
    points_of: Callable[[str, Mapping[str, Any]], Mapping[str, object]] = _no_points
    held: Callable[[str, object], Poke] | None = None
    too_late: Callable[[JournalEntry], str | None] = _must_be_done
    recognised: Mapping[str, Callable[[JournalEntry, Asked], bool]] = field(default_factory=dict)
    changing: tuple[Rule, ...] = ()
    commanded: Callable[[random.Random], tuple[Asked, ...]] | None = None

    def each_write(self, rng: random.Random) -> list[Asked]:
        """Return one write by each operation that writes, that of ``write`` first, and by each named command."""
        found = {self.writing: self.write(rng)}
        for makes in (self.every_write, self.tells):
            for asked in makes(rng) if makes else ():
                found.setdefault(asked.operation, asked)
        return [*found.values(), *(self.commanded(rng) if self.commanded else ())]


def every_change(entries: Entries, asked: Asked) -> list[JournalEntry]:
    """Return every request that may change the plant: what a write asks for, where an adapter sends nothing of its own."""
    return [entry for entry in entries if entry["state_changing"]]


def number_in_json(value: float) -> float | str:
    """Return a number as a mock is told it: what is infinite or no number is its name, such as ``"NaN"``."""
    if math.isfinite(value):
        return value
    return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
