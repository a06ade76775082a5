"""What was done in the console, as a pytest function and as a binding of the subject file. Pure."""

from __future__ import annotations

import json
import keyword
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..protocols.registry import protocols
from ..subject.model import Adapter
from ..subject.tools import bound

__all__ = ["Called", "Done", "as_binding", "as_test"]

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_WORD = re.compile(r"[A-Za-z]+")


@dataclass(frozen=True, slots=True, kw_only=True)
class Called:
    """A call and what came of it.

    Attributes:
        success: as claimed.
        changing: requests that change the device and that it saw of the call; None while it was stopped.
    """

    tool: str
    arguments: Mapping[str, object]
    success: bool | None
    changing: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Done:
    """Something that was done to the device: a method of its handle, and the method's arguments; ``poke`` takes others there."""

    what: str
    arguments: tuple[object, ...] = ()


def as_test(protocol: str, steps: Sequence[Called | Done]) -> str:
    """Return a pytest function that does the same with the kit's fixtures, and expects the same."""
    lines = [
        f"def test_copied_from_the_console_{protocol}(otmcp_device, otmcp_session):",
        f"    device = otmcp_device({protocol!r})",
        f"    adapter = otmcp_session({protocol!r})",
    ]
    changing = 0
    for step in steps:
        lines.append("")
        if isinstance(step, Called):
            changing += step.changing or 0
            lines += _called(step, changing)
        else:
            # The journal of the fixture goes on through a restart.
            lines.append(_done(step))
    return "\n".join(["# It expects what the console saw. Change what should be otherwise.", *lines, ""])


def _called(step: Called, changing: int) -> Iterator[str]:
    plain = all(name.isidentifier() and not keyword.iskeyword(name) for name in step.arguments)
    given = (
        [f"{name}={value!r}" for name, value in step.arguments.items()] if plain else [f"**{dict(step.arguments)!r}"]
    )
    yield f"    reply = adapter.tool({', '.join([repr(step.tool), *given])})"
    yield f"    assert reply.success is {step.success!r}"
    if step.changing is None:
        return
    if step.changing:
        yield f"    assert len(device.wait_for(count={changing}, state_changing=True)) == {changing}"
    else:
        yield f"    assert len([entry for entry in device.journal() if entry.writes]) == {changing}"


def _done(step: Done) -> str:
    if step.what == "poke":
        return f"    # The device was poked here, past the protocol: {step.arguments[0]!r}"
    return f"    device.{step.what}({', '.join(map(repr, step.arguments))})"


def as_binding(adapter: Adapter, step: Called) -> str:
    """Return a call as a line below ``[adapter.PROTOCOL.bind]``: the binding that there is, or one guessed by names."""
    head = f"[adapter.{adapter.protocol}.bind]\n"
    if found := bound(adapter, step.tool):
        lines = [_line(operation, step.tool, dict(binding.arguments)) for operation, binding in found]
        return "\n".join([f"{head}# The subject file binds it; 'result' and other keys are left out here.", *lines, ""])
    known = protocols()[adapter.protocol].operations
    writes = bool(step.changing)
    names = set(step.arguments)
    operation = max(
        (name for name in known if known[name].writes == writes),
        key=lambda name: (
            len(names & {*known[name].accepted}),
            len({*_words(name)} & {*_words(step.tool)}),
            -len(known[name].inputs),
        ),
        default=next(iter(known)),
    )
    inputs = known[operation].accepted
    arguments = {name: f"${name}" if name in inputs else value for name, value in step.arguments.items()}
    saw = "a request that changes it" if writes else "no request that changes it"
    hint = f"# Guessed by names; the device saw {saw}. 'otmcp init' proves bindings by what the device sees."
    return "\n".join([f"{head}{hint}", _line(operation, step.tool, arguments), ""])


def _words(name: str) -> list[str]:
    return _WORD.findall(name.lower().replace("_", " "))


def _line(operation: str, tool: str, arguments: dict[str, Any]) -> str:
    given = f", arguments = {_toml(arguments)}" if arguments else ""
    return f"{_key(operation)} = {{ tool = {_toml(tool)}{given} }}"


def _toml(value: object) -> str:
    if isinstance(value, Mapping):
        # TOML has no null: an argument that is null is left out.
        members = [f"{_key(name)} = {_toml(one)}" for name, one in value.items() if one is not None]
        return f"{{ {', '.join(members)} }}" if members else "{}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(_toml(one) for one in value if one is not None)}]"
    if isinstance(value, str):
        quoted = json.dumps(value, ensure_ascii=False)
        return "".join(letter if letter.isprintable() else f"\\U{ord(letter):08x}" for letter in quoted)
    return json.dumps(value)


def _key(name: str) -> str:
    return name if _BARE.fullmatch(name) else _toml(name)
