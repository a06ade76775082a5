"""What an id means: of an item, a requirement, a facet, an error code or the code of a finding. Pure.

``otmcp explain`` prints it, the pages in ``docs/`` are made of it, and reports take their sentences from here.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator
from dataclasses import dataclass

from ..core.error_registry import ErrorCode, registry, wire_codes
from ..core.finding_registry import FindingCode, finding_codes
from ..protocols.protocol import ANY_READ, COMMANDS, FACETS, LAUNCHES, READ, READ_OR_STATUS, READINGS, WRITE
from ..protocols.registry import protocols
from ..subject.answers import UNCLASSIFIED
from ..trial.explanation import explanation
from ..trial.task import Task
from .by_library import advice
from .catalogue import all_tasks, known_tasks
from .keys import keys_of_code, keys_of_task
from .requirements import Level, Profile, Requirement, catalogue, requirements

__all__ = [
    "HOW_A_LEVEL_IS_EARNED",
    "Explained",
    "Part",
    "error_code",
    "explained",
    "facets",
    "finding_code",
    "findings",
    "identifiers",
    "item",
    "level",
    "near",
    "profile",
    "requirement",
]

Part = tuple[str, tuple[str, ...]]
"""A label, and the paragraphs below it."""

HOW_A_LEVEL_IS_EARNED = (
    "A level is earned for each protocol apart. It needs every MUST of its own profiles and of those of the levels below, as far as "
    "the subject claims what the row is about; of those that begin with Gold it needs every one."
)

_SOCKETS = ("pytest_otmcp.core", "errors.toml", "socket")
_ALIKE = 0.7
"""How much of an unknown id has to be in a known one, of 1, for it to have been meant."""

_REPEAT = {
    "yes": "May be repeated as it is",
    "no": "Must not be repeated without changing something",
    "verify": "May be repeated only after reading back has shown that the first one did not happen",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Explained:
    """One id in words.

    Attributes:
        kind: ``item``, ``requirement``, ``level``, ``profile``, ``facet``, ``error code`` or ``finding code``.
        about: the sentence for it.
        parts: what else there is to say; none is empty.
    """

    id: str
    kind: str
    about: str
    parts: tuple[Part, ...]


def explained(identifier: str) -> list[Explained]:
    """Return what an id means, whatever its case: more than one answer where an error and a finding have the same code, none for
    an unknown id."""
    identifier = _by_folded().get(identifier.casefold(), identifier)
    found = []
    if (task := known_tasks().get(identifier)) is not None:
        found.append(item(task))
    if (row := requirements().get(identifier)) is not None:
        found.append(requirement(row))
    if identifier in _levels():
        found.append(level(_levels()[identifier]))
    if (part := catalogue().profiles.get(identifier)) is not None:
        found.append(profile(part))
    if (code := registry().get(identifier)) is not None:
        found.append(error_code(code))
    if identifier == UNCLASSIFIED:
        found.append(_unclassified())
    if identifier in findings():
        found.append(finding_code(identifier))
    if identifier in facets():
        found.append(_explained_facet(identifier))
    # A subject file names a facet below its protocol, without it.
    return found or [_explained_facet(facet) for facet in facets() if facet.partition(".")[2] == identifier]


def near(identifier: str) -> list[str]:
    """Return the ids that an unknown one may have been meant for, the nearest first."""
    folded = _by_folded()
    return [folded[name] for name in difflib.get_close_matches(identifier.casefold(), folded, 3, _ALIKE)]


def _by_folded() -> dict[str, str]:
    return {name.casefold(): name for name in (*facets(), *identifiers())}


def identifiers() -> list[str]:
    """Return every id that can be explained, each once."""
    names = [*known_tasks(), *requirements(), *_levels(), *catalogue().profiles, *registry(), UNCLASSIFIED, *findings()]
    return list(dict.fromkeys(names))


def facets() -> list[str]:
    """Return every facet that a subject may claim, with its protocol; those that all protocols have also without one."""
    return [*FACETS, *(f"{key}.{name}" for key, protocol in protocols().items() for name in protocol.facets)]


def findings() -> dict[str, tuple[FindingCode, str | None]]:
    """Return every code of findings with the name of the protocol that alone has it, or None."""
    every: dict[str, tuple[FindingCode, str | None]] = {code: (entry, None) for code, entry in finding_codes().items()}
    for protocol in protocols().values():
        every |= {code: (entry, protocol.name) for code, entry in finding_codes(protocol.package).items()}
    return every


def _explained(
    identifier: str, kind: str, about: str, *parts: tuple[str, Iterator[str] | tuple[str, ...]]
) -> Explained:
    kept = ((label, tuple(text for text in texts if text)) for label, texts in parts)
    return Explained(id=identifier, kind=kind, about=about, parts=tuple(part for part in kept if part[1]))


def item(task: Task) -> Explained:
    """Explain an item of the suite."""
    steps, before, after = map(explanation, (task.steps, task.begin, task.end))
    # A check is about its rows, which say what they take away.
    about = f"; about {_words(task.capabilities)}" if task.capabilities else ""
    return _explained(
        task.id,
        "item",
        task.title,
        ("Asked", (steps.asked,)),
        ("Must be said", (steps.said,)),
        ("Must be seen at the device", (steps.seen,)),
        ("Once before", (before.asked, before.said, before.seen)),
        ("Once afterwards", (after.asked, after.said, after.seen)),
        ("Why", (steps.why,)),
        ("Suite", (f"{task.suite.capitalize()}, {task.family}{about}",)),
        ("Applies to", (_applying(task),)),
        ("Rules", tuple(map(_cited, task.requirements))),
        ("In the subject file", tuple(keys_of_task(task))),
    )


def _applying(task: Task) -> str:
    claimed = [_facet(need) for need in task.needs if "." in need]
    return f"A subject that claims {_list(claimed)}" if claimed else f"Every adapter for {task.family}"


def _facet(need: str) -> str:
    key, _, facet = need.partition(".")
    if facet in (ANY_READ, READ_OR_STATUS, WRITE):
        return f"one of ({', '.join(f'{key}.{name}' for name in protocols()[key].alternatives(facet, ()))})"
    exercise = protocols()[key].exercise
    if facet != READ or exercise is None or exercise.waiting is None:
        return need
    return f"{key}.{exercise.reading} or {key}.{exercise.waiting.operation} by a call that waits"


def requirement(row: Requirement) -> Explained:
    """Explain a row of the requirement catalogue."""
    strength = row.strength + (", and the kit asks for more than the source does" if row.stricter else "")
    lost = f"The grade for {_words(row.capabilities)}, whichever item the finding is in"
    profiles = _list([f"{name} ({catalogue().profiles[name].meaning})" for name in row.profiles])
    only = f", for {_list([protocols()[key].name for key in row.protocols])} only" if row.protocols else ""
    return _explained(
        row.id,
        "requirement",
        row.statement,
        ("Strength", (strength,)),
        ("Level", (f"{row.level.capitalize()} and above; profile {profiles}{only}; since version {row.since}",)),
        ("How it is judged", (row.judged,)),
        ("Not yet judged", (row.not_yet or "",)),
        ("Source", (row.source,)),
        ("Related", (row.related,)),
        ("What it takes away", (lost if row.capabilities else "",)),
        ("Items about it", (_list([task.id for task in all_tasks().values() if row.id in task.requirements]),)),
        ("By library", tuple(advice(row.id))),
    )


def level(level: Level) -> Explained:
    """Explain a level of conformance."""
    rows = [row for row in requirements().values() if row.level is level and row.strength == "MUST"]
    not_yet = [row.id for row in rows if row.not_yet]
    return _explained(
        level.capitalize(),
        "level",
        f"An adapter of this level {level.meaning}.",
        ("How it is earned", (HOW_A_LEVEL_IS_EARNED,)),
        ("Profiles that begin with it", tuple(map(_profile, _beginning(level)))),
        ("Rows that begin with it", (_list([row.id for row in rows if not row.not_yet]),)),
        ("Not yet judged", (_list(not_yet),)),
    )


def _levels() -> dict[str, Level]:
    return {level.capitalize(): level for level in Level}


def _beginning(level: Level) -> list[Profile]:
    return [profile for profile in catalogue().profiles.values() if profile.level is level]


def _profile(profile: Profile) -> str:
    return f"{profile.id}: {profile.meaning}"


def profile(profile: Profile) -> Explained:
    """Explain a profile: a part of an adapter that rows are about."""
    rows = [row.id for row in requirements().values() if profile.id in row.profiles]
    return _explained(
        profile.id,
        "profile",
        f"{profile.meaning[0].upper()}{profile.meaning[1:]}.",
        ("Level", (f"{profile.level.capitalize()} and above",)),
        ("Rows about it", (_list(rows),)),
    )


def error_code(code: ErrorCode) -> Explained:
    """Explain a code of the error registry."""
    return _explained(
        code.code,
        "error code",
        f"{code.meaning[0].upper()}{code.meaning[1:]}.",
        ("Class", (_list(code.classes, "or"),)),
        ("Outcome of a write", (_list(code.outcomes, "or"),)),
        ("The same read", (_REPEAT.get(code.retry_read or "", ""),)),
        ("The same write", (_REPEAT.get(code.retry_write or "", ""),)),
        ("Stands for", tuple(_wire(code.code))),
        ("The paper calls it", (code.label or "",)),
    )


def _unclassified() -> Explained:
    return _explained(
        UNCLASSIFIED,
        "error code",
        "A failure in words of the adapter's own, for which the subject file has no code.",
        ("Judged", ("As a failure: a code that cannot be told is not wrong.",)),
        (
            "In the subject file",
            ("`errors` of the adapter's table: a text of the failure, and the code that it stands for",),
        ),
    )


def _wire(code: str) -> Iterator[str]:
    tables = [(protocol.name, wire_codes(protocol.package)) for protocol in protocols().values()]
    for name, table in [*tables, ("Sockets", wire_codes(*_SOCKETS))]:
        if found := [wire.name for wire in table.values() if code in wire.codes]:
            yield f"{name}: {', '.join(found)}"


def finding_code(code: str) -> Explained:
    """Explain the code of a finding."""
    entry, protocol = findings()[code]
    return _explained(
        code,
        "finding code",
        entry.meaning,
        ("What to change", (entry.change,)),
        ("In the subject file", tuple(keys_of_code(code))),
        ("Protocol", (protocol or "",)),
    )


def _explained_facet(identifier: str) -> Explained:
    """Explain what a subject may claim: an operation, an input or output of one, or another thing."""
    key, _, name = ("", "", identifier) if identifier in FACETS else identifier.partition(".")
    first, _, part = name.partition(".")
    operation = protocols()[key].operations.get(first) if key else None
    table = f"[adapter.{key or 'KEY'}"
    if operation is None:
        about, claimed = FACETS[name][1], f"{table}.{LAUNCHES[name]}]" if name in LAUNCHES else ""
        claimed = f"{table}.{name}.NAME]" if name in (COMMANDS, READINGS) else claimed
    else:
        about = f"{part!r} of the operation {first}: {operation.meaning}" if part else operation.meaning
        claimed = f"{table}.bind] {first}"
    needing = [
        task.id for task in all_tasks().values() if identifier in (task.needs if key else map(_of_any, task.needs))
    ]
    return _explained(
        identifier,
        "facet",
        f"{about[0].upper()}{about[1:].rstrip('.')}.",
        ("In the subject file", (claimed, f"{table}] unclaimed, with the reason, where the adapter cannot do it")),
        ("Inputs", (_list(operation.accepted) if operation and not part else "",)),
        ("Outputs", (_list(operation.readable) if operation and not part else "",)),
        ("Items that need it", (_list(needing),)),
    )


def _of_any(need: str) -> str:
    return need.partition(".")[2]


def _cited(identifier: str) -> str:
    row = requirements().get(identifier)
    return identifier if row is None else f"{identifier}: {row.statement} Source: {row.source}."


def _words(capabilities: tuple[str, ...]) -> str:
    return _list([name.replace("_", " ") for name in capabilities])


def _list(words: tuple[str, ...] | list[str], last: str = "and") -> str:
    *first, end = words or ("",)
    return f"{', '.join(first)} {last} {end}" if first else end
