"""Objections that keep a run from earning a certificate. Pure.

A certificate is about the whole suite, run with the settings that it demands, with nothing excused; and an item may only be
left out because the subject does not claim what the item needs. The record says all of that, and each statement is compared
with the rest before it is believed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import cast
from unicodedata import category

from ..core.matrix import SUITES, repetitions
from ..core.verdict import Status, Verdict, decide
from ..protocols.external import DEVICE, external_devices
from ..protocols.protocol import GUARD
from ..protocols.registry import protocols
from ..record.consistency import clock_faults, inapplicable_by_steps
from ..record.schema import Item, Run
from ..record.warnings import findings_of
from ..subject.claims import Claims
from ..trial.task import Task

__all__ = [
    "MAXIMUM_DEADLINE_S",
    "MINIMUM_REPS",
    "exercised",
    "objections",
    "slowest_recovery_s",
    "unguarded",
    "unhurried",
]

MINIMUM_REPS = 30
"""Repetitions of the paper's matrix: thirty passes of thirty mean at least 90 % with 95 % confidence, fewer mean less."""

MAXIMUM_DEADLINE_S = 30
"""The longest deadline of a call: an answer that takes longer is one that nobody waited for."""

MINIMUM_RECOVERY_S = 0.1
"""The kit calls again after 0.05 s, so it measures no shorter time."""

_INVISIBLE = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
"""Unicode categories of control characters, of marks of the reading direction, of lone surrogates and of line separators."""

_EMPTY = frozenset("\u034f\u115f\u1160\u17b4\u17b5\u180b\u180c\u180d\u180f\u2065\u2800\u3164\uffa0")
"""Characters of other categories that show nothing: Default_Ignorable_Code_Point of Unicode, and the empty Braille pattern. Variation
selectors are not among them, as they stand behind a letter or a sign."""

_NAMES = ("subject.name", "subject.version")
_NAMED, _NO_START = 12, "cannot_start"
"""How many items a sentence names; and the code of an adapter that does not run at all."""

Tasks = Mapping[str, Task]


def objections(run: Run, tasks: Tasks) -> list[str]:
    """Say why a run earns no certificate, one sentence for each reason; empty when it earns one.

    Args:
        run: a run record that :func:`pytest_otmcp.record.load` accepted.
        tasks: the whole suite.
    """
    found = [
        *_verdict_objections(run, tasks),
        *(
            _gaps(run)
            or [
                *_settings_objections(run),
                *unguarded(_claims(run), run["subject"]["adapters"]),
                *unhurried({protocol: facts["deadline_s"] for protocol, facts in run["subject"]["adapters"].items()}),
                *_unrecovered(run),
                *clock_faults(run, run["items"]),
                *_unprintable(run),
            ]
        ),
    ]
    # A run that did not pass needs no further reason; a run that passed must have exercised everything that the subject claims.
    return found or list(_item_objections(run, tasks))


def _claims(run: Run) -> Claims:
    return Claims.of_record(run["subject"]["adapters"])


def _gaps(run: Run) -> list[str]:
    """Say what a certificate needs and the record does not have."""
    gaps = [
        f"the record's adapter {protocol!r} is none that the kit knows"
        for protocol in run["subject"]["adapters"]
        if protocol not in protocols()
    ]
    gaps += [
        f"the journal of {name} does not begin with the run"
        for name, device in run["devices"].items()
        if device["first"] != 0
    ]
    return gaps


def _verdict_objections(run: Run, tasks: Tasks) -> Iterator[str]:
    statuses = {item["id"]: Status(item["status"]) for item in run["items"]}
    if not run["footer"]["complete"]:
        yield f"the run is incomplete: {run['footer'].get('reason')}"
    verdict = decide(statuses, tasks)
    if verdict == Verdict.CONFORMANT:
        if run["footer"].get("verdict") != Verdict.CONFORMANT:
            yield f"the record calls the run {run['footer'].get('verdict')}, its items do not"
        return
    missing = [name for name in tasks if name not in statuses]
    bad = [name for name, status in statuses.items() if status not in (Status.PASS, Status.NOT_APPLICABLE)]
    why = [f"{_some(bad)} did not pass"] if bad else []
    why += [f"{_some(missing)} did not run"] if missing else []
    found = (finding for item in run["items"] for finding in findings_of(item))
    if not any(map(_has_passed, run["items"])) and (
        none := next((one for one in found if one["code"] == _NO_START), None)
    ):
        why = [none["message"]]
    yield f"the verdict is {verdict}: {'; '.join(why) or 'nothing applies to the subject'}"


def _has_passed(item: Item) -> bool:
    return item["status"] == Status.PASS


def _some(names: Sequence[str]) -> str:
    more = len(names) - _NAMED
    return ", ".join(names[:_NAMED]) + (f" and {more} more" if more > 0 else "")


def _settings_objections(run: Run) -> Iterator[str]:
    settings, deviations = run["settings"], run["subject"]["deviations"]
    for key in settings.get("devices", {}):
        yield f"the {key} device was a real one: a field record shows no level and earns no certificate"
    if deviations:
        yield f"known deviations are declared, and a certificate excuses nothing: {_some([one['item'] for one in deviations])}"
    for sentence in settings["narrowed"]:
        yield f"the suite was narrowed: {sentence}"
    reps = settings["reps"]
    if reps < MINIMUM_REPS:
        yield f"{reps!r} repetitions are not the {MINIMUM_REPS} that a certificate needs"
    if settings["time_scale"] != 1:
        yield f"deadlines and windows were scaled by {settings.get('time_scale')}"
    for device in external_devices().values():
        if device.option != DEVICE and cast(dict[str, object], settings).get(device.option) != "embedded":
            yield f"the {device.option} was not the kit's own"
    if settings["suites"] != list(SUITES):
        left = ", ".join(suite for suite in SUITES if suite not in settings["suites"])
        yield f"suites were left out, which otmcp certify runs: {left}"


def _unprintable(run: Run) -> Iterator[str]:
    """Name the texts that the certificate would show and that could move a cursor or turn a line around."""
    subject = {name: dict(run["subject"])[name] for name in ("name", "version")}
    told: dict[str, object] = {"subject": subject, "settings": run["settings"], "environment": run["environment"]}
    for protocol, facts in run["subject"]["adapters"].items():
        shown = ("server_name", "server_version", "protocol_version", "recovery", "unclaimed", "unmet", "unjudged")
        told[f"subject.adapters.{protocol}"] = {name: dict(facts)[name] for name in shown} | {
            "tested": facts.get("tested")
        }
    for place, text in _texts(told, ""):
        if any(category(letter) in _INVISIBLE for letter in text):
            yield f"{place} has a control character: {text[:80]!r}"
        elif any(letter in _EMPTY for letter in text):
            yield f"{place} has a letter that shows nothing: {text[:80]!a}"
        elif place in _NAMES and not any(category(letter)[0] in "LNPS" for letter in text):
            yield f"{place} shows nothing: {text[:80]!a}"


def _texts(value: object, place: str) -> Iterator[tuple[str, str]]:
    if isinstance(value, str):
        yield place, value
    elif isinstance(value, Mapping):
        for name, member in value.items():
            yield f"a member of {place or 'the record'}", name
            yield from _texts(member, f"{place}.{name}" if place else name)
    elif isinstance(value, list | tuple):
        for member in value:
            yield from _texts(member, place)


def unguarded(claims: Claims, adapters: Iterable[str]) -> Iterator[str]:
    """Name each adapter that writes, but is not claimed to refuse writes when they are disabled, in a sentence each.

    Requirement WR-004 is a MUST for every adapter: leaving out the claim must not be a way around it.

    Args:
        claims: of the subject.
        adapters: protocols of the adapters.
    """
    for protocol in adapters:
        writing = [name for name, operation in protocols()[protocol].operations.items() if operation.writes]
        reason = claims.why_not(f"{protocol}.{GUARD}")
        if reason is not None and any(claims.has(f"{protocol}.{name}") for name in writing):
            yield (
                f"{protocol}: it writes, and that its writes can be disabled ({GUARD}, requirement WR-004) "
                f"is not claimed: {reason}"
            )


def unhurried(deadlines: Mapping[str, float]) -> Iterator[str]:
    """Yield a sentence for each adapter whose deadline is longer than an assistant, or a person, waits for an answer.

    Args:
        deadlines: seconds within which a call must have answered, by protocol.
    """
    for protocol, deadline_s in deadlines.items():
        if deadline_s > MAXIMUM_DEADLINE_S:
            yield (
                f"{protocol}: its deadline_s of {deadline_s:g} s is above the {MAXIMUM_DEADLINE_S} s that a certificate allows"
            )


def _unrecovered(run: Run) -> Iterator[str]:
    """Name each adapter that took longer to work again than its subject file says, though its items passed: the window is counted to the
    begin of a call."""
    for protocol, facts in run["subject"]["adapters"].items():
        stated_s = facts.get("recovery_s")
        if stated_s is None:
            continue
        if stated_s < MINIMUM_RECOVERY_S:
            yield f"{protocol}: its recovery_s of {stated_s:g} s is less than the {MINIMUM_RECOVERY_S:g} s that the kit can measure"
        shown_s = slowest_recovery_s(protocol, run["items"], attempts=2)
        if shown_s is not None and shown_s > stated_s:
            yield f"{protocol}: it worked again after {shown_s:g} s, its recovery_s is {stated_s:g} s"


def slowest_recovery_s(protocol: str, items: Iterable[Item], *, attempts: int = 1) -> float | None:
    """Return the longest time in which an adapter worked again in the same session, in seconds; None where no item shows it.

    Args:
        protocol: of the adapter.
        items: of the run.
        attempts: only trials with at least so many calls count.
    """
    found = [
        phases["same_session"]
        for item in items
        if item["id"] == f"R-{protocol}"
        for sample in item["samples"]
        if (phases := sample["phases"]) is not None
        and phases["same_session"] is not None
        and phases["same_session_attempts"] >= attempts
    ]
    return round(max(found) / 1000, 4) if found else None


def _item_objections(run: Run, tasks: Tasks) -> Iterator[str]:
    planned = repetitions(max(1, run["settings"]["reps"]))
    claims = _claims(run)
    for item in run["items"]:
        name = item["id"]
        task = tasks.get(name)
        if task is None:
            yield f"there is no item {name} in the suite"
        elif (item["suite"], item["family"]) != (task.suite, task.family):
            yield f"{name} is an item of {task.suite}, {task.family}, the record says {item['suite']}, {item['family']}"
        elif item["planned"] != planned.get(task.suite):
            yield f"{name} has {item['planned']} repetitions, the settings say {planned.get(task.suite)}"
        elif _without_facets(item) == all(map(claims.has, claims.required(task.needs))):
            yield f"{name} is called {item['status']}, which is not what the subject claims"


def _without_facets(item: Item) -> bool:
    """Tell whether an item is said not to apply for want of a facet; the steps of a check may also find nothing to judge."""
    return item["status"] == Status.NOT_APPLICABLE and not inapplicable_by_steps(item)


def exercised(task: Task, claims: Claims) -> list[str]:
    """Return the facets that a task exercises: those that it needs, and those of its guards that the subject claims."""
    return [*claims.required(task.needs), *(facet for facet in task.guards if claims.has(facet))]
