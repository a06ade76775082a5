"""``otmcp call``: one operation through an adapter at its mock device; reply, frames and journal beside each other."""

from __future__ import annotations

import argparse
import json
import shutil
import textwrap
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.errors import NoBindingError, SubjectError, UsageError
from ..core.names import describe_unknown
from ..core.text import printable
from ..protocols.journal import judged
from ..protocols.protocol import LAUNCHES
from ..protocols.registry import protocols
from ..subject.model import READ_WRITE, Function, placeholders
from . import Refusal, add_json, show_json, tell
from .doctor import named_or_here
from .isolated import add_option, isolated

if TYPE_CHECKING:
    from ..protocols.journal import JournalEntry
    from ..protocols.protocol import Operation
    from ..session.isolation import Isolation
    from ..subject import Subject
    from ..subject.model import Adapter
    from ..trial.reply import Reply

__all__ = ["add_parser", "run"]

_ARRIVING_S = 0.5
"""Seconds within which the device must have seen a write that claims success; a message may arrive after the answer."""

_FALLBACK = (100, 24)
"""Columns and lines where the output is no terminal and COLUMNS says nothing."""

_LONGEST = 16_384
"""Characters that are shown of a frame."""


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "call",
        help="perform one operation through an adapter and show what the device saw",
        description=(
            "Start an adapter of a subject file at its mock device, perform one operation through the tool that is bound to it, "
            "and show the reply, the frames and the device's journal. A value is JSON where it can be read as JSON, else text. "
            "Nothing is written before a random value went between the mock device and the adapter."
        ),
    )
    parser.add_argument("--subject", metavar="FILE", type=Path, help="a subject file (default: otmcp.toml)")
    parser.add_argument("--protocol", choices=tuple(protocols()), help="whose operation (default: the one that has it)")
    parser.add_argument(
        "--variant",
        choices=(READ_WRITE, *LAUNCHES.values()),
        default=READ_WRITE,
        help="with writes enabled or disabled, or another launch of the subject file (default: rw)",
    )
    add_option(parser)
    parser.add_argument(
        "operation",
        metavar="OPERATION",
        help="an operation of the protocol, such as read, or a named command or reading",
    )
    parser.add_argument("inputs", metavar="KEY=VALUE", nargs="*", help="its inputs")
    add_json(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Perform the operation and show it; return 0 when the adapter claims success, else 1.

    Raises:
        UsageError: there is no such operation, it has other inputs, or no tool is bound to it; or a reference
            adapter lacks its library.
        Refusal: the adapter cannot be started, or nothing proves that it talks to the mock device, and the operation writes.
    """
    from ..session.loop import LoopThread
    from ..subject import load_subject, reference_subject
    from ..subject.selection import missing_library

    source = named_or_here(args.subject)
    subject = reference_subject() if source is None else load_subject(source)
    adapter, operation, inputs = _asked(subject, args)
    if args.variant not in adapter.variants:
        known = " ".join(adapter.variants)
        raise UsageError(f"--variant {args.variant}: [adapter.{adapter.protocol}] has no such launch, it has {known}")
    if source is None and (missing := missing_library(protocols()[adapter.protocol])):
        raise UsageError(f"{protocols()[adapter.protocol].name}: {missing}")
    loop = LoopThread()
    try:
        with isolated(args) as isolation:
            reply, entries = loop.run(_perform(adapter, args.variant, operation, inputs, isolation))
    except SubjectError as failure:
        doctor = "otmcp doctor" + ("" if args.subject is None else f" --subject={args.subject}")
        raise Refusal(f"{adapter.protocol} ('{doctor}' may know why): {failure}", quotes=True) from None
    finally:
        loop.close()
    if args.json:
        show_json(_document(reply, entries, inputs))
        return 0 if reply.success and not reply.faulty else 1
    named = args.operation in adapter.commands
    for line in _shown(reply, entries, inputs, shutil.get_terminal_size(_FALLBACK).columns, named=named):
        tell(line)
    return 0 if reply.success and not reply.faulty else 1


# -- what is asked ----------------------------------------------------------------------------------------------


def _asked(subject: Subject, args: argparse.Namespace) -> tuple[Adapter, str, dict[str, object]]:
    """Return the adapter, the operation and its inputs that are asked for, also by the name of a command or a reading.

    Raises:
        UsageError: there is nothing of this name, it takes other values, or no tool is bound to it.
    """
    for adapter in subject.adapters.values():
        named = adapter.commands | adapter.readings
        if args.protocol in (None, adapter.protocol) and args.operation in named:
            operation = named[args.operation]
            return adapter, operation, _effect(adapter, operation, args.operation, args.inputs)
    adapter = _adapter(subject, args.operation, args.protocol, args.inputs)
    inputs = _inputs(args.operation, protocols()[adapter.protocol].operations[args.operation], args.inputs)
    _check_filling(adapter, args.operation, inputs)
    return adapter, args.operation, inputs


def _effect(adapter: Adapter, operation: str, name: str, words: Sequence[str]) -> dict[str, object]:
    """Return the inputs of the operation that a command or a reading performs, for its arguments, which are written as KEY=VALUE.

    Raises:
        UsageError: it draws other values.
    """
    bound = adapter.operations[operation]
    cases = () if isinstance(bound, Function) else bound
    command = next(case.command for case in cases if case.command is not None and case.command.name == name)
    values = _words(name, words, command.draws, "argument")
    if missing := [key for key in command.draws if key not in values]:
        raise UsageError(f"{name}: {' and '.join(missing)} must be given, as {missing[0]}=VALUE")
    try:
        return command.effect_of(values)
    except LookupError as error:
        key = error.args[0]
        raise UsageError(f"{name}: the subject file does not draw {values[key]!r} for {key}") from None


def _adapter(subject: Subject, operation: str, protocol: str | None, words: Sequence[str]) -> Adapter:
    """Return the adapter that the operation is for; of several the one whose operation has the inputs that are written.

    Raises:
        UsageError: there is none, or more than one.
    """
    if protocol is not None and protocol not in subject.adapters:
        raise UsageError(f"{subject.source}: there is no [adapter.{protocol}]")
    asked = [protocol] if protocol is not None else list(subject.adapters)
    able = [key for key in asked if operation in protocols()[key].operations]
    if not able:
        known = {
            name
            for key in asked
            for names in (protocols()[key].operations, subject.adapters[key].commands, subject.adapters[key].readings)
            for name in names
        }
        raise UsageError(describe_unknown("operation", operation, known))
    named = {word.partition("=")[0] for word in words}
    fitting = [key for key in able if named <= {*protocols()[key].operations[operation].accepted}] or able
    if len(fitting) > 1:
        raise UsageError(f"{operation}: {' and '.join(fitting)} have it; say which by --protocol")
    return subject.adapters[fitting[0]]


def _inputs(name: str, operation: Operation, words: Sequence[str]) -> dict[str, object]:
    """Return the inputs that are written as KEY=VALUE.

    Raises:
        UsageError: a word has another form, or the operation has other inputs.
    """
    inputs = _words(name, words, operation.accepted, "input")
    if missing := [key for key in operation.inputs if key not in inputs and key not in operation.optional]:
        raise UsageError(f"{name}: {' and '.join(missing)} must be given, as {missing[0]}=VALUE")
    return inputs


def _words(name: str, words: Sequence[str], known: Collection[str], noun: str) -> dict[str, object]:
    """Return the values that are written as KEY=VALUE, by key.

    Args:
        noun: what a key is.

    Raises:
        UsageError: a word has another form, or another key.
    """
    values: dict[str, object] = {}
    for word in words:
        key, found, value = word.partition("=")
        if not found:
            raise UsageError(f"{name}: expected KEY=VALUE, found {word!r}")
        if key not in known:
            raise UsageError(f"{name}: {describe_unknown(noun, key, known)}")
        if key in values:
            raise UsageError(f"{name}: {key} is given twice")
        values[key] = _value(value)
    return values


def _check_filling(adapter: Adapter, operation: str, inputs: Mapping[str, object]) -> None:
    """Make sure, before anything is started, that a tool is bound and that its arguments can be made from the inputs.

    Raises:
        UsageError: no tool is bound to the operation with these inputs, or they do not fit its arguments.
    """
    bound = adapter.operations.get(operation)
    if isinstance(bound, Function):
        return
    binding = next((case for case in bound or () if case.fits(inputs)), None)
    if binding is None:
        raise UsageError(f"{adapter.protocol}: the subject binds no tool to {operation} with these inputs")
    if binding.resource or binding.command is not None:
        return
    voluntary = protocols()[adapter.protocol].operations[operation].voluntary_inputs
    if lacking := sorted(placeholders(binding.arguments) - {*inputs, *voluntary}):
        raise UsageError(f"{operation}: {binding.tool} needs {' and '.join(lacking)}, as {lacking[0]}=VALUE")
    try:
        binding.fill(inputs, {})
    except (TypeError, ValueError) as error:
        raise UsageError(f"{operation}: the inputs do not fit the arguments of {binding.tool}: {error}") from None


def _value(text: str) -> object:
    from ..core.strict_json import parse_strict

    try:
        return parse_strict(text.encode())
    except ValueError:
        return text


# -- what happens -----------------------------------------------------------------------------------------------


async def _perform(
    adapter: Adapter, variant: str, operation: str, inputs: Mapping[str, object], isolation: Isolation
) -> tuple[Reply, list[JournalEntry]]:
    from ..plant.mock_device import MockDevice
    from ..subject.model import SECURE_FORM
    from ..trial.adapter_under_test import AdapterUnderTest, BenchOptions
    from ..trial.session_proof import prove_session

    known = protocols()[adapter.protocol]
    device = MockDevice(known.mock, adapter.protocol, secure=variant == SECURE_FORM)
    device.walls = isolation.walls(outside=adapter.openings.why_outside, cable=protocols()[adapter.protocol].cable)
    under_test = None
    try:
        await device.launch()
        under_test = AdapterUnderTest(adapter, variant, device, BenchOptions())
        await under_test.open()
        writes = known.operations[operation].writes
        if writes and (problem := await prove_session(under_test)) is not None:
            raise Refusal(f"{adapter.protocol}: {problem}")
        since = await device.mark()
        reply = await under_test.call(operation, inputs)
        if writes and reply.success:
            await device.wait(since, {"state_changing": True}, timeout_s=_ARRIVING_S)
        return reply, judged((await device.journal(since)).entries)
    except NoBindingError as gap:
        raise UsageError(str(gap)) from None
    finally:
        if under_test is not None:
            await under_test.close()
        await device.close()


# -- what is shown ----------------------------------------------------------------------------------------------


def _has_effect(protocol: str, operation: str, inputs: Mapping[str, object], entries: Sequence[JournalEntry]) -> bool:
    """Tell whether a request asks the device for the first effect of a named command; also where that cannot be told."""
    from ..protocols.exercise import THEN, Asked

    exercise = protocols()[protocol].exercise
    recognised = None if exercise is None else exercise.recognised.get(operation)
    asked = Asked(operation=operation, inputs={name: value for name, value in inputs.items() if name != THEN})
    return recognised is None or any(recognised(entry, asked) for entry in entries if entry["state_changing"])


def _shown(
    reply: Reply, entries: Sequence[JournalEntry], inputs: Mapping[str, object], width: int, *, named: bool
) -> Iterator[str]:
    from ..report.exchange import conversation
    from ..report.lanes import lanes

    call = {
        "role": "task",
        "adapter": reply.adapter,
        "variant": reply.variant,
        "tool": reply.tool,
        "arguments": reply.arguments,
        "latency_ms": reply.latency_ms,
        "ok": not reply.faulty,
        "envelope": reply.envelope,
        "error_code": reply.error_code,
        "sent_ns": reply.exchange.sent_ns,
        "received_ns": reply.exchange.received_ns,
        "frames": {"failure": reply.exchange.failure},
    }
    placed = [{"protocol": reply.adapter, **entry} for entry in entries]
    asked = " ".join(f"{key}={_json(value)}" for key, value in inputs.items())
    yield printable(f"{reply.operation} {asked}".rstrip())
    yield ""
    name = protocols()[reply.adapter].name
    yield from lanes(conversation([call], placed), f"{name} adapter ({reply.variant})", f"{name} mock device", width)
    yield ""
    claim = {True: "success", False: f"failure, {reply.error_code or 'without a code'}", None: "none that can be read"}
    yield f"reply: {printable(claim[reply.success])}"
    for output, value in reply.outputs.items():
        yield from _wrapped(f"output {output}", _json(value), width)
    for fault in reply.faults:
        yield from _wrapped("fault", fault.message, width)
    if reply.success and protocols()[reply.adapter].operations[reply.operation].writes:
        changed = sum(entry["state_changing"] for entry in entries)
        yield f"device: it saw {changed or 'no'} request{'' if changed == 1 else 's'} that change{'s' if changed == 1 else ''} its state"
        # Where outputs are exchanged in cycles, a value that was there before changes nothing.
        other = named and not _has_effect(reply.adapter, reply.operation, inputs, entries)
        if other and changed:
            yield "device: none of them has the effect that the subject file states for this command"
        if other or not any(entry["request"] for entry in entries):
            yield "reply and device contradict each other"
    yield from _wrapped("request frame", _frame(reply.exchange.request), width)
    yield from _wrapped("response frame", _frame(reply.exchange.response), width)


def _document(reply: Reply, entries: Sequence[JournalEntry], inputs: Mapping[str, object]) -> dict[str, object]:
    """Return what a program reads; times are milliseconds, frames are text."""
    frames = {"request": reply.exchange.request, "response": reply.exchange.response}
    return {
        "protocol": reply.adapter,
        "variant": reply.variant,
        "operation": reply.operation,
        "inputs": inputs,
        "tool": reply.tool,
        "arguments": reply.arguments,
        "success": reply.success,
        "error_code": reply.error_code,
        "outputs": reply.outputs,
        "faults": [fault.message for fault in reply.faults],
        "envelope": reply.envelope,
        "latency_ms": reply.latency_ms,
        "frames": {
            name: None if frame is None else frame.decode("utf-8", "backslashreplace") for name, frame in frames.items()
        },
        "journal": entries,
    }


def _frame(frame: bytes | None) -> str:
    if frame is None:
        return "none"
    text = frame.decode("utf-8", "backslashreplace")
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ... ({len(text)} characters in all)"


def _wrapped(label: str, text: str, width: int) -> list[str]:
    return textwrap.wrap(printable(f"{label}: {text}"), width, subsequent_indent="  ", break_on_hyphens=False)


def _json(value: object) -> str:
    return json.dumps(value, ensure_ascii=False, default=str)
