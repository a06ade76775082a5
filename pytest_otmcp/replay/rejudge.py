"""History first, judgement after: judges a run record again, from nothing but what it stores.

Every item's own steps run once more, with the stored calls, journals and images in the place of adapters and devices
(``recorded_stage``); what they find must be what the record says. What is believed in doing so is said in
``recorded_reply``; believed as well are the facts about processes (stray output, how they ended), durations of stops and
starts, and a fault of adapter or kit that ended an item before its time.
"""

from __future__ import annotations

import asyncio
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from ..core.strict_json import same_json
from ..core.verdict import Status
from ..protocols.registry import protocols
from ..suite.catalogue import suite_digest, tasks_by_id
from ..trial.task import Task
from ..trial.trial import Trial
from .driver import ReplayDriver, UnfinishedError
from .reply import UNREADABLE, HistoryError

__all__ = ["rejudge"]

_OF_ITEM = ("suite", "family", "title", "requirements", "status", "reason")
_OF_SUBJECT = ("deadline_s", "recovery", "unclaimed", "probes", "lacks")
_OF_SAMPLE = ("ok", "duration_ms", "phases")
_OF_CALL = (
    "role",
    "adapter",
    "variant",
    "operation",
    "tool",
    "arguments",
    "latency_ms",
    "ok",
    "envelope",
    "native",
    "listed",
    "outputs",
    "error_code",
)

Record = Mapping[str, Any]


def rejudge(run: Record) -> list[str]:
    """Judge a run record again.

    Args:
        run: as :func:`pytest_otmcp.record.load` returns it.

    Returns:
        Every disagreement between what the history shows and what the record says, a sentence each; empty when the
        judgement follows from the history.
    """
    digest = suite_digest()
    if run["kit"]["suite_digest"] != digest:
        return [
            f"the run was judged by the suite {run['kit']['suite_digest']}, this is {digest}: "
            "judge it again with the version of the kit that made it"
        ]
    return list(_disagreements(run))


def _disagreements(run: Record) -> Iterator[str]:
    tasks = tasks_by_id()
    yield from _readable("the run", _of_subject(run))
    for item in run["items"]:
        task = tasks.get(item["id"])
        if task is None:
            yield f"{item['id']}: the suite has no such task"
        else:
            yield from _readable(item["id"], _of_claims(item, task, run["subject"]["adapters"]))
            yield from _readable(item["id"], _of_item(item, task, run["settings"]))


def _readable(where: str, disagreements: Iterator[str]) -> Iterator[str]:
    try:
        yield from disagreements
    except UNREADABLE as error:
        yield f"{where}: the stored history cannot be read ({error!r})"


def _of_subject(run: Record) -> Iterator[str]:
    """Whether all items were told the same of the subject, and as much as their suite demands was planned for each."""
    known: dict[tuple[str, ...], tuple[str, Any]] = {}
    for protocol, facts in run["subject"]["adapters"].items():
        known[protocol, "recovery"] = "the subject", facts.get("recovery")
        known[protocol, "unclaimed"] = "the subject", sorted(facts.get("unclaimed", []))
    for item in run["items"]:
        for station in item.get("history", {}).get("stations", []):
            told = {name: station.get(name) for name in _OF_SUBJECT}
            told |= {f"the binding of {name}": cases for name, cases in station.get("bindings", {}).items()}
            for name, value in told.items():
                where, expected = known.setdefault((str(station.get("protocol")), name), (item["id"], value))
                if not same_json(value, expected):
                    yield f"{item['id']}: {name} is {_short(value)}, with {where} it is {_short(expected)}"
        demanded = run["settings"].get("repetitions", {}).get(item["suite"], item["planned"])
        if item["planned"] != demanded:
            yield f"{item['id']}: {item['planned']} repetitions were planned, the settings demand {demanded}"


def _of_claims(item: Record, task: Task, adapters: Record) -> Iterator[str]:
    # An adapter that never had a session is not listed: of that one nothing can be said.
    gaps = [facet for facet in task.needs if not _claimed(facet, adapters)]
    if item["status"] == Status.NOT_APPLICABLE and not gaps:
        yield f"{item['id']}: the record says NOT_APPLICABLE, the subject claims {' and '.join(task.needs)}"
    named = [facet for facet in gaps if facet.partition(".")[0] in adapters]
    if item["status"] != Status.NOT_APPLICABLE and named:
        yield f"{item['id']}: the record says {item['status']}, the subject does not claim {' and '.join(named)}"


def _claimed(facet: str, adapters: Record) -> bool:
    protocol, _, name = facet.partition(".")
    if protocol not in adapters:
        return False
    unclaimed = adapters[protocol].get("unclaimed", {})
    needed = protocols()[protocol].required_facets(name, adapters[protocol].get("blocking", ()))
    return not any(real in unclaimed or real.partition(".")[0] in unclaimed for real in needed)


def _of_item(item: Record, task: Task, settings: Record) -> Iterator[str]:
    name = item["id"]
    stage = ReplayDriver(item, task, seed=settings["seed"], time_scale=settings["time_scale"])
    shown, objection = asyncio.run(_again(Trial(stage, task, item["planned"])))
    objection = objection or stage.left_over()
    for (role, rep), reason in stage.objections.items():
        yield f"{_where(name, role, rep)}: {reason}"
    if objection is not None:
        yield f"{name}: {objection}"
    for said, found in zip(item["samples"], shown["samples"], strict=False):
        if ("task", said["repetition"]) not in stage.objections:
            where = _where(name, "task", said["repetition"])
            yield from _differing(where, found, said, _OF_SAMPLE)
            yield from _of_calls(where, found["calls"], said["calls"])
            yield from _of_findings(where, found["findings"], said["findings"])
    if objection is None and not stage.objections:
        yield from _differing(name, shown, item, _OF_ITEM)
        yield from _of_calls(f"{name} around its repetitions", shown["other_calls"], item["other_calls"])
        yield from _of_findings(name, shown["findings"], item["findings"])


async def _again(trial: Trial) -> tuple[dict[str, Any], str | None]:
    try:
        return await trial.run(), None
    except UnfinishedError:
        return trial.interrupted(), None
    except HistoryError as objection:
        return trial.interrupted(), str(objection)


def _where(name: str, role: str, rep: int) -> str:
    return f"{name} repetition {rep + 1}" if role == "task" else f"{name} {role}"


def _of_calls(where: str, found: Sequence[Record], said: Sequence[Record]) -> Iterator[str]:
    # Concurrent calls are told apart by what was asked, not by whose reply came first.
    left = list(found)
    for index, call in enumerate(said, start=1):
        match = next((other for other in left if _same_question(other, call)), None)
        if match is not None:
            left.remove(match)
            yield from _differing(f"{where}, call {index} ({call['tool']})", match, call, _OF_CALL)


def _same_question(one: Record, other: Record) -> bool:
    return all(same_json(one[name], other[name]) for name in ("adapter", "variant", "operation", "inputs", "sent_ns"))


def _of_findings(where: str, found: Sequence[Record], said: Sequence[Record]) -> Iterator[str]:
    shown = Counter((finding["code"], finding["message"]) for finding in found)
    stated = Counter((finding["code"], finding["message"]) for finding in said)
    for code, message in shown - stated:
        yield f"{where}: the stored history shows {message!r} ({code}), the record says nothing of it"
    for code, message in stated - shown:
        yield f"{where}: the record says {message!r} ({code}), the stored history does not show it"


def _differing(where: str, found: Record, said: Record, names: Sequence[str]) -> Iterator[str]:
    for name in names:
        if not same_json(found[name], said[name]):
            yield f"{where}: the stored history shows {name} {_short(found[name])}, the record says {_short(said[name])}"


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 200 else text[:200] + "…"
