"""The search for what disables an adapter's writes: variables and options that its tools or its own files name, tried by a write."""

from __future__ import annotations

import re
from collections.abc import Awaitable, Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from ..core.errors import NoBindingError, SubjectError
from ..protocols.oracle import state_changing
from ..protocols.registry import protocols
from ..subject.imports import own_files, source_of
from ..subject.model import READ_WRITE, Adapter
from ..trial.adapter_under_test import AdapterUnderTest, BenchOptions
from .effects import Effect
from .evidence import claims_success
from .experimenter import Experimenter, NotProvenError
from .guess import Guess
from .proposal import Proposal, Shown

__all__ = ["Switch", "launched", "look_for_switch", "switches_of"]

Write = Callable[[], Awaitable[Shown]]

_TRIED = 4
"""At most so many variables and options are tried, those first that the adapter is given, then those that its tools name."""

_BOTH = {
    word: pair
    for pair in (("true", "false"), ("1", "0"), ("yes", "no"), ("on", "off"), ("enabled", "disabled"))
    for word in pair
}
_USUAL = [("true", "false"), ("1", "0"), ("true", "")]
"""A variable that is only looked for is off when it has nothing in it."""

# The patterns are bounded: a file may hold anything, a million letters in one word as well.
_VARIABLE = re.compile(r"\b[A-Z][A-Z0-9]*(?:_[A-Z0-9]+)+\b")
_MAY_DISABLE = re.compile(r"READ_?ONLY|WRIT(E|ABLE|ING)", re.IGNORECASE)
_OTHER = re.compile(r"TIMEOUT|DELAY|INTERVAL|RETR|TOPIC|REGISTER|TOKEN|KEY|USER|PASS|FILE|PATH|DIR|LOG|LIMIT|MAX|MIN")
"""Words in the names of variables that are about something else of writing."""

_ASKED = re.compile(
    r"""(?:environ|getenv|\benv|envvar|alias)\b[^\w\n]{0,3}(?:get\W{1,2})?['"`]?(?P<name>[A-Z][A-Z0-9_]{1,80})\b"""
)
"""A variable where a program asks for it: ``os.environ["NAME"]``, ``process.env.NAME``, ``Field(alias="NAME")``."""

_PLAIN = re.compile(
    r"""\b(?:[A-Z0-9]{1,30}_){0,6}
    (?: READ_?ONLY | WRIT(?:ABLE|ES?|ING)_(?:ENABLED?|ALLOWED|DISABLED?|PERMITTED|ACCESS|MODE|PROTECT(?:ED|ION)?)
      | (?:ALLOW|ENABLE|DISABLE|PERMIT|FORBID|BLOCK|DENY|UNLOCK|NO)_(?:[A-Z0-9]{1,30}_){0,4}WRIT(?:ES?|ING) )
    (?:_[A-Z0-9]{1,30})?\b""",
    re.VERBOSE,
)
"""A variable that says by its name alone what it does."""

_OPTION = re.compile(
    r"""(?<=['"`])--(?:[a-z0-9]{1,30}-){0,6}(?:read-?only|(?:allow|enable|disable|permit|forbid|block|deny|unlock|no)-(?:[a-z0-9]{1,30}-){0,4}writ(?:es?|ing))(?=['"`])"""
)
_PREFIX = re.compile(r"""env_prefix\s*=\s*['"](?P<prefix>[A-Z0-9_]+)['"]""")
_SETTING = re.compile(
    r"^[ \t]{1,40}(?P<name>\w{0,40}(?:read_?only|writ(?:able|es?|ing))\w{0,40})[ \t]*:[ \t]*bool\b", re.MULTILINE
)
"""A member of pydantic's settings, whose variable has a prefix."""

_FORBIDS = re.compile(r"read_?-?only|disable|forbid|block|deny|protect|lock|(^|[_-])no[_-]", re.IGNORECASE)
_UNLOCKS = re.compile("unlock", re.IGNORECASE)


@dataclass(frozen=True, slots=True, kw_only=True)
class Switch:
    """What may disable the adapter's writes.

    Attributes:
        name: of the variable, or the option.
        ro: the entries of the launch with writes disabled, ``env`` or ``args``.
        rw: those of the launch with writes enabled.
    """

    name: str
    ro: Mapping[str, object]
    rw: Mapping[str, object]


def _ways(name: str, env: Mapping[str, str]) -> Iterator[Switch]:
    """Yield a switch for each way in which a variable is usually set; what the adapter is given of it already says the way."""
    forbids = _FORBIDS.search(name) is not None and _UNLOCKS.search(name) is None
    if name.startswith("--"):
        given, none = {"args": [name]}, dict[str, object]()
        yield Switch(name=name, ro=given if forbids else none, rw=none if forbids else given)
        return
    pairs = [_BOTH[env[name].lower()]] if env.get(name, "").lower() in _BOTH else _USUAL
    for on, off in pairs:
        ro, rw = (on, off) if forbids else (off, on)
        yield Switch(name=name, ro={"env": {name: ro}}, rw={"env": {name: rw}})


def switches_of(adapter: Adapter, texts: Iterable[str]) -> tuple[Switch, ...]:
    """Return what may disable the writes of an adapter: by the variables that it is given, the texts of its tools, and its own files."""
    variant = adapter.variants[READ_WRITE]
    given = [name for name in variant.env if _MAY_DISABLE.search(name)]
    described = [name for text in texts for name in _VARIABLE.findall(text) if _MAY_DISABLE.search(name)]
    files = own_files(variant.command, variant.cwd or Path.cwd())
    read = [name for file in files for name in _in_source(source_of(file))]
    names = list(dict.fromkeys((*given, *described, *read)))[:_TRIED]
    return tuple(switch for name in names for switch in _ways(name, variant.env))


def _in_source(source: str) -> Iterator[str]:
    asked = (found["name"] for found in _ASKED.finditer(source))
    yield from (name for name in asked if _MAY_DISABLE.search(name) and not _OTHER.search(name))
    for prefix in {found["prefix"] for found in _PREFIX.finditer(source)}:
        yield from (f"{prefix}{found['name'].upper()}" for found in _SETTING.finditer(source))
    yield from (found[0] for pattern in (_PLAIN, _OPTION) for found in pattern.finditer(source))


def launched(adapter: Adapter, entries: Mapping[str, object]) -> Adapter:
    """Return an adapter whose launch has further entries of a switch."""
    variant = adapter.variants[READ_WRITE]
    env, args = entries.get("env", {}), entries.get("args", [])
    assert isinstance(env, dict)
    assert isinstance(args, list)
    changed = replace(variant, env={**variant.env, **env}, command=(*variant.command, *args))
    return replace(adapter, variants={**adapter.variants, READ_WRITE: changed})


async def look_for_switch(
    experimenter: Experimenter,
    adapter: Adapter,
    switches: Sequence[Switch],
    proposals: Mapping[str, Proposal],
    commands: Mapping[str, Effect],
) -> Switch | None:
    """Start the adapter with writes disabled by each switch, and write: the call has to fail, and the device must not be told it. Then start
    it with writes enabled, and the device has to be told it.

    Args:
        adapter: as it is launched without a switch.
    """
    write = _write(experimenter, proposals, commands)
    if write is None:
        return None
    before = experimenter.adapter
    try:
        for switch in switches:
            try:
                if await _is_refused(experimenter, launched(adapter, switch.ro), write) and await _is_done(
                    experimenter, launched(adapter, switch.rw), write
                ):
                    return switch
            except (SubjectError, NotProvenError, NoBindingError):
                # It does not start so, or does not find its device.
                continue
    finally:
        await experimenter.adapter.close()
        experimenter.adapter = before
    return None


def _write(
    experimenter: Experimenter, proposals: Mapping[str, Proposal], commands: Mapping[str, Effect]
) -> Write | None:
    """Return a write by an operation, or else by a named command; None where none is proven."""
    exercise = protocols()[experimenter.adapter.adapter.protocol].exercise
    if exercise is None:
        return None
    calls = [
        exercise.write(experimenter.random),
        *(exercise.every_write(experimenter.random) if exercise.every_write else ()),
    ]
    for one in calls:
        if one.operation in proposals and proposals[one.operation].proven:
            return partial(experimenter.perform, proposals[one.operation], one)
    for tool, effect in commands.items():
        drawn = effect.command.arguments(effect.command.examples()[0]) or {}
        arguments = {name: drawn.get(name, value) for name, value in effect.arguments.items()}
        return partial(experimenter.write, Guess.of_tool(tool, arguments), arguments)
    return None


async def _is_refused(experimenter: Experimenter, adapter: Adapter, write: Write) -> bool:
    await _start(experimenter, adapter)
    shown = await write()
    return shown.message is not None and not claims_success(shown.message) and not state_changing(shown.entries)


async def _is_done(experimenter: Experimenter, adapter: Adapter, write: Write) -> bool:
    await _start(experimenter, adapter)
    return bool(state_changing((await write()).entries))


async def _start(experimenter: Experimenter, adapter: Adapter) -> None:
    await experimenter.adapter.close()
    experimenter.adapter = AdapterUnderTest(adapter, READ_WRITE, experimenter.device, BenchOptions())
