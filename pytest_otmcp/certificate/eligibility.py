"""What keeps a run from earning a certificate. Pure.

A certificate is about the whole suite, run as it is meant to be, with nothing excused; and an item may only be left out
because the subject does not claim what it needs. The record says all of that, and it is not believed without being compared.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any, TypeGuard

from ..core.matrix import SUITES, repetitions
from ..core.verdict import Status, Verdict, decide
from ..protocols.external import external_devices
from ..protocols.protocol import GUARD
from ..protocols.registry import protocols
from ..trial.task import Task

__all__ = ["MINIMUM_REPS", "needed", "objections", "unguarded", "why_not_claimed"]

MINIMUM_REPS = 30
"""The paper's matrix: thirty passes of thirty mean at least 90 % with 95 % confidence, fewer mean less."""

_DIGEST = re.compile("sha256:[0-9a-f]{64}")

Run = Mapping[str, Any]
Tasks = Mapping[str, Task]


def objections(run: Run, tasks: Tasks) -> list[str]:
    """Why a run earns no certificate, one sentence each; empty when it does.

    Args:
        run: a run record that :func:`pytest_otmcp.record.load` accepted.
        tasks: the whole suite.
    """
    found = [
        *_verdict_objections(run, tasks),
        *(_gaps(run) or [*_settings_objections(run), *unguarded(run["subject"]["adapters"])]),
    ]
    # What did not pass needs no further reason; what did must be everything that the subject claims.
    return found or list(_item_objections(run, tasks))


def _gaps(run: Run) -> list[str]:
    """What a certificate needs to say and the record does not."""
    environment = run["environment"] if isinstance(run["environment"], dict) else {}
    texts = {
        "kit.name": run["kit"].get("name"),
        "kit.version": run["kit"].get("version"),
        "kit.digest": run["kit"].get("digest"),
        "kit.suite_digest": run["kit"].get("suite_digest"),
        "subject.name": run["subject"].get("name"),
        "subject.version": run["subject"].get("version"),
        "subject.digest": run["subject"].get("digest"),
        "environment.started_at": environment.get("started_at"),
    }
    lists = {
        "subject.deviations": run["subject"].get("deviations"),
        "settings.narrowed": run["settings"].get("narrowed"),
    }
    gaps = [
        f"the record has no valid {name}"
        for name, text in texts.items()
        if not isinstance(text, str) or (name.endswith("digest") and not _DIGEST.fullmatch(text))
    ]
    gaps += [f"the record has no list {name}" for name, entries in lists.items() if not isinstance(entries, list)]
    if not isinstance(run["footer"].get("tool_calls"), dict):
        gaps.append("the record does not count its tool calls")
    for protocol, facts in run["subject"]["adapters"].items():
        known = protocol in protocols() and isinstance(facts, dict)
        if not known or not isinstance(facts.get("unclaimed"), dict) or not isinstance(facts.get("blocking"), list):
            gaps.append(f"the record's adapter {protocol!r} is none that the kit knows")
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
    why = [f"{', '.join(bad)} did not pass"] if bad else []
    why += [f"{', '.join(missing)} did not run"] if missing else []
    yield f"the verdict is {verdict}: {'; '.join(why) or 'nothing applies to the subject'}"


def _settings_objections(run: Run) -> Iterator[str]:
    settings, deviations = run["settings"], run["subject"]["deviations"]
    if deviations:
        yield f"known deviations are declared, and a certificate excuses nothing: {deviations}"
    for sentence in settings["narrowed"]:
        yield f"the suite was narrowed: {sentence}"
    reps = settings.get("reps")
    if not _is_count(reps) or reps < MINIMUM_REPS:
        yield f"{reps!r} repetitions are not the {MINIMUM_REPS} that a certificate needs"
    if settings.get("time_scale") != 1:
        yield f"deadlines and windows were scaled by {settings.get('time_scale')}"
    for device in external_devices().values():
        if settings.get(device.option) != "embedded":
            yield f"the {device.option} was not the kit's own"
    if settings.get("suites") != list(SUITES):
        yield f"not every suite was chosen: {settings.get('suites')}"


def unguarded(adapters: Mapping[str, Any]) -> Iterator[str]:
    """A sentence for each adapter that writes and is not claimed to refuse that when it is told to.

    Requirement WR-004 is a MUST for every adapter: a claim that is left out must not be the way around it.

    Args:
        adapters: as in ``subject.adapters`` of a run record.
    """
    for protocol in adapters:
        writing = [name for name, operation in protocols()[protocol].operations.items() if operation.writes]
        reason = why_not_claimed(f"{protocol}.{GUARD}", adapters)
        if reason is not None and any(why_not_claimed(f"{protocol}.{name}", adapters) is None for name in writing):
            yield (
                f"{protocol}: it writes, and that its writes can be disabled ({GUARD}, requirement WR-004) "
                f"is not claimed: {reason}"
            )


def _item_objections(run: Run, tasks: Tasks) -> Iterator[str]:
    reps = run["settings"].get("reps")
    planned = repetitions(reps) if _is_count(reps) else {}
    adapters = run["subject"]["adapters"]
    for item in run["items"]:
        name = item["id"]
        task = tasks.get(name)
        if task is None:
            yield f"there is no item {name} in the suite"
        elif (item["suite"], item["family"]) != (task.suite, task.family):
            yield f"{name} is an item of {task.suite}, {task.family}, the record says {item['suite']}, {item['family']}"
        elif item["planned"] != planned.get(task.suite):
            yield f"{name} has {item['planned']} repetitions, the settings say {planned.get(task.suite)}"
        elif (item["status"] == Status.NOT_APPLICABLE) != _applies_not(task, adapters):
            yield f"{name} is called {item['status']}, which is not what the subject claims"


def _is_count(value: Any) -> TypeGuard[int]:
    # JSON's true is no number, though Python's is.
    return isinstance(value, int) and not isinstance(value, bool) and value > 0


def _applies_not(task: Task, adapters: Mapping[str, Any]) -> bool:
    """Something that the task needs is not claimed."""
    return any(why_not_claimed(facet, adapters) is not None for facet in needed(task, adapters))


def needed(task: Task, adapters: Mapping[str, Any]) -> list[str]:
    """The facets that a task needs of these adapters, each with its protocol.

    Args:
        task: of the suite.
        adapters: ``subject.adapters`` of a run record.
    """
    found = []
    for need in task.needs:
        protocol, _, name = need.partition(".")
        blocking = adapters[protocol].get("blocking", ()) if protocol in adapters else ()
        found += [f"{protocol}.{real}" for real in protocols()[protocol].required_facets(name, blocking)]
    return list(dict.fromkeys(found))


def exercised(task: Task, adapters: Mapping[str, Any]) -> list[str]:
    """The facets that a task says something about: those that it needs, and guards that it looks at when there are any."""
    guards = [f"{protocol}.{GUARD}" for protocol in task.guards]
    return [*needed(task, adapters), *(facet for facet in guards if why_not_claimed(facet, adapters) is None)]


def why_not_claimed(facet: str, adapters: Mapping[str, Any]) -> str | None:
    """Why a facet, such as ``modbus.guard``, is not claimed; None when it is."""
    protocol, _, name = facet.partition(".")
    if protocol not in adapters:
        return f"the subject has no adapter for {protocols()[protocol].name}"
    unclaimed = adapters[protocol]["unclaimed"]
    reason: str | None = unclaimed.get(name, unclaimed.get(name.partition(".")[0]))
    return reason
