"""Judging a run record again, from nothing but what it stores.

Every item's own steps run once more, with the stored calls, journals and images in the place of adapters and devices
(``driver``); what they find must be what the record says. ``reply`` lists what is believed unchecked. The facts about
processes (stray output, how they ended), the durations of stops and starts, and a fault of adapter or kit that ended an item
before its time are believed as well.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from ipaddress import ip_address
from typing import Any

from ..core.strict_json import same_json
from ..core.verdict import Status
from ..plant.endpoint import Endpoint, endpoint_values
from ..protocols.registry import protocols
from ..record.consistency import inapplicable_by_steps
from ..record.reader import StoredItem, StoredRun
from ..record.schema import CallJudgement, Finding, Header, ItemBody, ItemHead, ItemJudgement, Sample, SampleJudgement
from ..record.schema import Endpoint as EndpointFacts
from ..subject.claims import Claims
from ..suite.catalogue import known_tasks, suite_digest
from ..trial.applicability import why_not_in_field
from ..trial.task import Task
from ..trial.trial import Trial
from .device import DeviceHistory
from .difference import Difference, FindingDiffers, MemberDiffers, Objection, short
from .driver import ReplayDriver, UnfinishedError
from .player import RecordedAdapter
from .reply import UNREADABLE, HistoryError, at_its_place, restored_bindings

__all__ = ["depends_on_seed", "differences", "rejudge"]

_APART = frozenset({"findings", "strangers"})
"""Members of judgements that are compared one by one, or may be absent."""
_OF_ITEM = [name for name in ItemJudgement.__annotations__ if name not in _APART]
_OF_SAMPLE = [name for name in SampleJudgement.__annotations__ if name not in _APART]
_OF_CALL = [*CallJudgement.__annotations__, "envelope", "native", "listed", "group"]
"""Of a call also what is read from its frames, and whether it was made at the same time as others."""

Said = Mapping[str, Any]


def rejudge(run: StoredRun) -> list[str]:
    """Judge a run record again.

    Args:
        run: as :func:`pytest_otmcp.record.reader.open_record` gives it.

    Returns:
        Every disagreement between what the history shows and what the record says, a sentence each; empty when the
        judgement follows from the history.
    """
    digest = suite_digest()
    stated = run.header["kit"]["suite_digest"]
    if stated != digest:
        return [
            f"the run was judged by the suite {stated}, this is {digest}: judge it again with the version of the kit that made it"
        ]
    return list(map(str, differences(run)))


def depends_on_seed(run: StoredRun) -> bool:
    """Tell whether a record shows that its seed was known when the run was made: with another seed its steps ask for something else.

    Args:
        run: one that was judged as it deserves.
    """
    other = copy(run)
    other.header = {**run.header, "settings": {**run.header["settings"], "seed": run.header["settings"]["seed"] + 1}}
    return next(differences(other), None) is not None


def differences(run: StoredRun) -> Iterator[Difference]:
    """Judge a run record again by the oracles of this kit, whichever kit has made it.

    Args:
        run: as :func:`pytest_otmcp.record.reader.open_record` gives it.

    Returns:
        Every disagreement between what this kit finds in the history and what the record says.
    """
    tasks = known_tasks()
    try:
        judge = _Judge(run.header)
        yield from judge.devices()
    except UNREADABLE as error:
        yield Objection("the run", f"the stored history cannot be read ({at_its_place(error)})")
        return
    # A device passes from item to item in the order of the run, whatever the order of the items in the record.
    for item in sorted(run.items(), key=lambda item: item.head["began_ns"]):
        name = item.head["id"]
        task = tasks.get(name)
        if task is None:
            yield Objection(name, "the suite has no such task")
            continue
        try:
            yield from judge.item(item, task)
        except UNREADABLE as error:
            yield Objection(name, f"the stored history cannot be read ({at_its_place(error)})")


class _Judge:
    """The judge of a run's items, which it takes in the order in which they were executed."""

    def __init__(self, header: Header) -> None:
        self._settings = header["settings"]
        self._claims = Claims.of_record(header["subject"]["adapters"])
        self._adapters = {
            protocol: RecordedAdapter(
                protocol, facts, self._claims, restored_bindings(facts["bindings"]), self._settings["time_scale"]
            )
            for protocol, facts in header["subject"]["adapters"].items()
        }
        self._devices = {name: DeviceHistory(name, facts) for name, facts in header["devices"].items()}
        self._ended_ns: dict[str, int] = {}

    def devices(self) -> Iterator[Difference]:
        """Return what cannot be true of the devices: the kit's devices, and its tap before a device of the user's, are on one machine."""
        for name, history in self._devices.items():
            facts = history.facts
            if ("witnesses" in facts) != (facts["protocol"] in self._settings.get("devices", {})):
                yield Objection(name, "a device with witnesses is a real one that the settings name, and no other is")
            for endpoint in facts["endpoints"]:
                if endpoint["kind"] in ("tcp", "udp") and not _is_loopback(endpoint["host"]):
                    stated = f"a device of the kit listens on this machine only, the record says {endpoint['host']!r}"
                    yield Objection(name, stated)
                if _impossible(endpoint):
                    yield Objection(name, f"no endpoint of the kind {endpoint['kind']!r} is at {short(endpoint)}")
            endpoints = {endpoint["name"]: Endpoint(**endpoint) for endpoint in facts["endpoints"]}
            if len(endpoints) < len(facts["endpoints"]):
                yield Objection(name, "two of its endpoints have the same name")
            follows = endpoint_values(protocols()[facts["protocol"]].scheme, endpoints)
            if facts["placeholders"] != follows:
                stated = short(facts["placeholders"])
                yield Objection(name, f"from its endpoints follows {short(follows)}, the record says {stated}")

    def item(self, item: StoredItem, task: Task) -> Iterator[Difference]:
        """Judge an item again and return the disagreements with the record."""
        head = item.head
        name = head["id"]
        demanded = self._settings["repetitions"].get(head["suite"], head["planned"])
        if head["planned"] != demanded:
            yield Objection(name, f"{head['planned']} repetitions were planned, the settings demand {demanded}")
        if head["began_ns"] < self._ended_ns.get(head["worker"], 0):
            yield Objection(name, "it began before the item before it had ended")
        self._ended_ns[head["worker"]] = head["ended_ns"]
        yield from self._of_claims(head, task)
        yield from self._of_history(item, task)

    def _of_claims(self, head: ItemHead, task: Task) -> Iterator[Difference]:
        reason = why_not_in_field(task, self._settings.get("devices", {}))
        if (reason is not None) != (head["status"] == Status.NOT_APPLICABLE and head["reason"] == reason):
            yield Objection(head["id"], f"the record says {head['status']}, and of real devices follows: {reason}")
        if reason is not None:
            return
        # An adapter that had no device, as in a run that was narrowed, cannot be judged.
        gaps = [facet for facet in self._claims.required(task.needs) if not self._claims.has(facet)]
        if head["status"] == Status.NOT_APPLICABLE and not gaps and not inapplicable_by_steps(head):
            yield Objection(
                head["id"], f"the record says NOT_APPLICABLE, the subject claims {' and '.join(task.needs)}"
            )
        named = [facet for facet in gaps if self._claims.has_adapter(facet.partition(".")[0])]
        if head["status"] != Status.NOT_APPLICABLE and named:
            reason = f"the record says {head['status']}, the subject does not claim {' and '.join(named)}"
            yield Objection(head["id"], reason)

    def _of_history(self, item: StoredItem, task: Task) -> Iterator[Difference]:
        head = item.head
        name = head["id"]
        driver = ReplayDriver(
            item,
            task,
            adapters=self._adapters,
            devices=self._devices,
            seed=self._settings["seed"],
            time_scale=self._settings["time_scale"],
            soak=self._settings.get("soak", False),
        )
        found: list[Difference] = []

        def compare(sample: Sample) -> None:
            said = driver.sample
            assert said is not None
            if ("task", sample["repetition"]) not in driver.objections:
                found.extend(_of_sample(_where(name, "task", said["repetition"]), sample, said))

        try:
            shown, objection = asyncio.run(_again(Trial(driver, task, head["planned"], keep=compare)))
            objection = objection or driver.left_over()
        except UNREADABLE:
            driver.leave(judged=False)
            raise
        driver.leave(judged=objection is None and not driver.objections)
        for (role, rep), reason in driver.objections.items():
            yield Objection(_where(name, role, rep), reason)
        if objection is not None:
            yield Objection(name, objection)
        yield from found
        if objection is None and not driver.objections:
            yield from _differing(name, shown, head, _OF_ITEM)
            yield from _differing(name, {"strangers": []} | shown, {"strangers": []} | head, ("strangers",))
            for part, told in zip(shown["around"], head["around"], strict=True):
                yield from _of_calls(f"{name} {told['role']}", part["calls"], told["calls"])
            yield from _of_findings(name, shown["findings"], head["findings"])


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False


def _impossible(endpoint: EndpointFacts) -> bool:
    """Tell whether an endpoint has more than its kind of address: a port has no path, a pseudo terminal has nothing else, and a cable
    has no port."""
    has = {name for name in ("host", "port", "path", "mac") if endpoint.get(name)}
    return has != {"pty": {"path"}, "cable": {"host", "path", "mac"}}.get(endpoint["kind"], {"host", "port"})


def _of_sample(where: str, found: Sample, said: Sample) -> Iterator[Difference]:
    yield from _differing(where, found, said, _OF_SAMPLE)
    yield from _of_calls(where, found["calls"], said["calls"])
    yield from _of_findings(where, found["findings"], said["findings"])


async def _again(trial: Trial) -> tuple[ItemBody, str | None]:
    try:
        return await trial.run(), None
    except UnfinishedError:
        return trial.interrupted(), None
    except HistoryError as objection:
        return trial.interrupted(), str(objection)


def _where(name: str, role: str, rep: int) -> str:
    return f"{name} repetition {rep + 1}" if role == "task" else f"{name} {role}"


def _of_calls(where: str, found: Sequence[Said], said: Sequence[Said]) -> Iterator[Difference]:
    # Concurrent calls are told apart by their questions, not by the order of their replies.
    left = list(found)
    for index, call in enumerate(said, start=1):
        match = next((other for other in left if _same_question(other, call)), None)
        if match is not None:
            left.remove(match)
            at = f"{where}, call {index} ({call['tool']})"
            yield from _differing(at, match, call, _OF_CALL)
            if "frames" in call:
                shown = match["frames"]["faults"] if "frames" in match else []
                yield from _of_findings(at, shown, call["frames"]["faults"])


def _same_question(one: Said, other: Said) -> bool:
    return all(same_json(one[name], other[name]) for name in ("adapter", "variant", "operation", "inputs", "sent_ns"))


def _of_findings(where: str, found: Sequence[Finding], said: Sequence[Finding]) -> Iterator[Difference]:
    for finding in _without(found, said):
        yield FindingDiffers(where, finding, is_shown=True)
    for finding in _without(said, found):
        yield FindingDiffers(where, finding, is_shown=False)


def _without(findings: Sequence[Finding], others: Sequence[Finding]) -> Iterator[Finding]:
    """Return the findings that the others have not, as often as there are more of them."""
    left = [_judged(other) for other in others]
    for finding in findings:
        if _judged(finding) in left:
            left.remove(_judged(finding))
        else:
            yield finding


def _judged(finding: Finding) -> tuple[str | None, ...]:
    return tuple(finding[name] for name in ("code", "strength", "message", "requirement", "cause"))


def _differing(where: str, found: Said, said: Said, names: Sequence[str]) -> Iterator[Difference]:
    for name in names:
        if not same_json(found[name], said[name]):
            yield MemberDiffers(where, name, found[name], said[name])
