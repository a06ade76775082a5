"""The certificate of a run: an in-toto statement of what was earned; it says nothing that the run record does not say. Pure.

A certificate is a function of the run record alone, so everybody who has the record can make it again and compare:
:func:`certificate` returns the same document each time for the same record. It is not signed here. Sources:

- Statement: in-toto Attestation Framework, Statement v1, https://in-toto.io/Statement/v1;
- predicate: Test Result v0.1, https://in-toto.io/attestation/test-result/v0.1; facts without a field there are below
  ``otmcp``, an extension field as the framework's parsing rules allow it;
- bounds: Clopper and Pearson, see :mod:`pytest_otmcp.core.statistics`.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Container, Iterable, Iterator, Mapping, Set
from typing import Any

from ..core.matrix import SUITES
from ..core.statistics import lower_bound, proportion_interval
from ..core.verdict import Status
from ..core.walls import missing, stood
from ..protocols.external import external_devices
from ..protocols.registry import protocols
from ..record.schema import AdapterFacts, Environment, Item, Run, Settings, Tested
from ..record.tool_calls import judged, never_called
from ..record.unread import unread_replies
from ..record.warnings import warnings
from ..subject.claims import Claims
from ..suite.levels import said, shown, standings
from ..suite.requirements import catalogue
from ..suite.spoken import spoken
from ..trial.task import Task
from .eligibility import exercised, slowest_recovery_s

__all__ = ["PREDICATE_TYPE", "STATEMENT_TYPE", "awarded", "certificate", "differences"]

STATEMENT_TYPE = "https://in-toto.io/Statement/v1"
PREDICATE_TYPE = "https://in-toto.io/attestation/test-result/v0.1"
SCHEMA = "otmcp-certificate/1"

_CONFIDENCE = 0.95
_FIRST_STATELESS = "2026-07-28"
"""The first revision of MCP without ``initialize``: revisions are dates, and compare as text."""

_LIMITS = [
    "Self-certification: the vendor, or whom he asked, has run the kit. Only a signature says who that was.",
    "Tamper-evident, not tamper-proof: otmcp verify makes this document again from run.json and judges the stored history again.",
    "It is about the subject with this digest, started as its subject file says, at simulated devices, in the environment "
    "that run.json describes; another version of the adapter needs another run.",
    "Bounds take repetitions as independent; they share a session.",
]

Tasks = Mapping[str, Task]


def certificate(run: Run, run_sha256: str, tasks: Tasks) -> dict[str, object]:
    """Return the certificate of a run that has no :func:`~pytest_otmcp.certificate.eligibility.objections`.

    Args:
        run: the run record.
        run_sha256: hexadecimal digest of the file that holds it.
        tasks: the whole suite.
    """
    subject, kit, footer = run["subject"], run["kit"], run["footer"]
    warned = warnings(run["items"])
    walls = run["environment"].get("walls", {})
    with_warnings = {name for one in warned for name in one["items"]}
    passed = [item["id"] for item in run["items"] if item["status"] == Status.PASS]
    called = _called(run)
    return {
        "_type": STATEMENT_TYPE,
        "subject": [{"name": f"{subject['name']} {subject['version']}", "digest": _digest_set(subject["digest"])}],
        "predicateType": PREDICATE_TYPE,
        "predicate": {
            "result": "WARNED" if warned else "PASSED",
            "configuration": [
                {"name": f"{kit['name']} {kit['version']}", "digest": _digest_set(kit["digest"])},
                {"name": "conformance suite", "digest": _digest_set(kit["suite_digest"])},
                *(
                    # The package that judges a protocol which is not the kit's own is named.
                    {
                        "name": f"protocol {entry['key']}: {entry['distribution']} {entry['version']}",
                        "digest": _digest_set(entry["digest"]),
                    }
                    for entry in kit["protocols"]
                    if entry["digest"] is not None and entry["key"] in subject["adapters"]
                ),
                {"name": "run.json", "digest": {"sha256": run_sha256}, "mediaType": "application/json"},
            ],
            "passedTests": [name for name in passed if name not in with_warnings],
            "warnedTests": [name for name in passed if name in with_warnings],
            "failedTests": [],
            "otmcp": {
                "schema": SCHEMA,
                "verdict": footer["verdict"],
                "warnings": warned,
                "catalogue": catalogue().version,
                "items": {family: {"passed": count.passed, "of": count.of} for family, count in spoken(run).items()},
                "level": awarded(run),
                "run_id": run["run_id"],
                "measured_at": run["environment"]["started_at"],
                "adapters": {
                    protocol: _adapter(protocol, facts, run, tasks, called)
                    for protocol, facts in sorted(subject["adapters"].items())
                },
                "counts": _counts(run),
                "not_applicable": _not_applicable(run, tasks),
                "deviations": [],
                "settings": _known(
                    run["settings"], {*Settings.__annotations__, *(one.option for one in external_devices().values())}
                ),
                "environment": _known(run["environment"], Environment.__annotations__),
                "isolation": {"seen": stood(walls), "missing": missing(walls)},
                "limits": list(_LIMITS),
            },
        },
    }


def _known(table: Mapping[str, Any], members: Container[str]) -> dict[str, Any]:
    """Return the members that a record has by its schema: a certificate repeats nothing that nobody has looked at."""
    return {name: value for name, value in table.items() if name in members}


def awarded(run: Run) -> dict[str, object]:
    """Return the level of each protocol, in a line, and what is missing for the next one."""
    rows = catalogue()
    found = standings(rows, run["items"], dict(sorted(run["subject"]["adapters"].items())))
    return {
        "awarded": {one.protocol: None if one.level is None else one.level.value for one in found},
        "why": " ".join(f"{said(one)}." for one in found),
        "next": {one.protocol: shown(one, rows) for one in found},
    }


def _digest_set(digest: str) -> dict[str, str]:
    algorithm, _, value = digest.partition(":")
    return {algorithm: value}


def _called(run: Run) -> Mapping[str, Set[str]]:
    """Return the items in which each operation was called, and given each of its inputs, by facet: checks use more than they need."""
    found: defaultdict[str, set[str]] = defaultdict(set)
    for item in run["items"]:
        for sample in item["samples"]:
            for call in sample["calls"]:
                # Of repetitions that are alike only the first is whole.
                if "operation" not in call:
                    continue
                facet = f"{call['adapter'].partition('@')[0]}.{call['operation']}"
                for name in (facet, *(f"{facet}.{given}" for given in call["inputs"])):
                    found[name].add(item["id"])
    return found


def _adapter(
    protocol: str, facts: AdapterFacts, run: Run, tasks: Tasks, called: Mapping[str, Set[str]]
) -> dict[str, object]:
    claims = Claims.of_record(run["subject"]["adapters"])
    earned, not_exercised, not_claimed = {}, [], {}
    for name in protocols()[protocol].facets:
        facet = f"{protocol}.{name}"
        if claims.is_silent(facet):
            continue
        behind = [
            item
            for item in run["items"]
            if facet in exercised(tasks[item["id"]], claims) or item["id"] in called.get(facet, ())
        ]
        applying = [item for item in behind if item["status"] != Status.NOT_APPLICABLE]
        if (reason := claims.why_not(facet)) is not None:
            not_claimed[name] = reason
        elif applying:
            # These items have all passed; otherwise there would be no certificate.
            earned[name] = [item["id"] for item in applying]
        elif not protocols()[protocol].is_voluntary(name) or name in protocols()[protocol].operations:
            not_exercised.append(name)
    revision = str(facts["protocol_version"])
    return {
        "server": {"name": facts["server_name"], "version": facts["server_version"]},
        "mcp": {"revision": revision, "era": "stateless" if revision >= _FIRST_STATELESS else "initialize"},
        "tested": None if (tested := facts.get("tested")) is None else _known(tested, Tested.__annotations__),
        "deadline_s": facts["deadline_s"],
        "envelope": facts["envelope"],
        "envelope_requirements_unmet": facts["unmet"],
        "outputs_not_judged": list(_not_judged(facts)),
        "recovery": facts["recovery"],
        "recovery_s": facts["recovery_s"],
        "recovered_within_s": slowest_recovery_s(protocol, run["items"]),
        "call_limit": facts.get("call_limit"),
        "cached_s": facts["cached"],
        "tools_judged": judged(facts),
        "tools_never_called": never_called(facts),
        "vocabulary": list(_vocabulary(facts)),
        "members_not_judged": _members_not_judged(protocol, facts, run),
        "facets": {"earned": earned, "claimed_not_exercised": not_exercised, "not_claimed": not_claimed},
    }


def _members_not_judged(protocol: str, facts: AdapterFacts, run: Run) -> dict[str, list[str]]:
    """Return the members of answers that no named reading and no named command states, by tool: an assistant reads them as well."""
    known: defaultdict[str, str] = defaultdict(str)
    for case in (case for cases in facts["bindings"].values() for case in cases or ()):
        if (command := case.get("command")) is not None:
            # The name of a sensor in its answer is no value. What a command was given is one: the answer may deny it.
            repeated = case["arguments"] if "holds" in command else ()
            known[case["tool"]] += " ".join(map(str, [*case["outputs"].values(), *repeated]))
    found: defaultdict[str, set[str]] = defaultdict(set)
    calls = (call for item in run["items"] for sample in item["samples"] for call in sample["calls"] if "tool" in call)
    for call in calls:
        tool, envelope = call["tool"], call.get("envelope")
        data = (
            envelope.get("data")
            if isinstance(envelope, Mapping) and call["adapter"].partition("@")[0] == protocol
            else None
        )
        if tool in known and isinstance(data, Mapping):
            document = data.get("document", data)
            names = document if isinstance(document, Mapping) else ()
            found[tool] |= {name for name in names if not re.search(rf"\b{re.escape(name)}\b", known[tool])} - {"text"}
    return {tool: sorted(names) for tool, names in sorted(found.items()) if names}


def _vocabulary(facts: AdapterFacts) -> Iterator[dict[str, object]]:
    """Yield what names of the adapter's own mean, as the subject file states it: nothing else was asked for, and nothing else is shown."""
    for operation, cases in facts["bindings"].items():
        for case in cases or ():
            command = case.get("command")
            if command is None:
                continue
            effects = [{"operation": operation, "inputs": command["effect"]}]
            effects += [{"operation": one["operation"], "inputs": one["effect"]} for one in command.get("then", ())]
            holds = command.get("holds")
            said = {name: rule.get("means") for name, rule in case["outputs"].items()}
            yield {
                "name": command["name"],
                "tool": case["tool"],
                "arguments": {name: _values(draw) for name, draw in command["draws"].items()},
                "asks": effects,
                **({} if holds is None else {"holds": _values(holds), "means": next(iter(said.values()), None)}),
            }


def _values(draw: Mapping[str, Any]) -> object:
    """Return values, each with what it means at the device where it is another, or a range."""
    if not draw["values"]:
        return {name: draw[name] for name in ("lowest", "highest", "step")}
    if not draw["means"]:
        return [*draw["values"]]
    return [{"value": value, "means": meaning} for value, meaning in zip(draw["values"], draw["means"], strict=True)]


def _not_judged(facts: AdapterFacts) -> Iterator[str]:
    """Yield the outputs that no binding says the place of; named commands, which are judged by their effects, have none."""
    for name in facts["unjudged"]:
        operation, _, output = name.partition(".")
        cases = facts["bindings"].get(operation) or []
        if not any(output in case["outputs"] or case.get("command") is not None for case in cases):
            yield name


def _counts(run: Run) -> dict[str, object]:
    items = run["items"]
    return {
        "confidence": _CONFIDENCE,
        "bounds": "Clopper-Pearson: at_least is one-sided, interval two-sided",
        "items": {item["id"]: _item_counts(item) for item in items if item["status"] != Status.NOT_APPLICABLE},
        "suites": {suite: _tally(item for item in items if item["suite"] == suite) for suite in SUITES},
        "total": _tally(items),
        "tool_calls": run["footer"]["tool_calls"],
        # Of what is not in the record as it was on the wire, nothing can be judged again.
        "replies_not_read_again": unread_replies(items),
    }


def _item_counts(item: Item) -> dict[str, object]:
    good, planned = sum(sample["ok"] for sample in item["samples"]), item["planned"]
    least, interval = lower_bound(good, planned, _CONFIDENCE), proportion_interval(good, planned, _CONFIDENCE)
    assert least is not None
    assert interval is not None
    # Bounds are rounded outwards, so that they never claim more than the repetitions have shown.
    return {
        "passed": good,
        "planned": planned,
        "at_least": math.floor(least * 1e4) / 1e4,
        "interval": [math.floor(interval[0] * 1e4) / 1e4, math.ceil(interval[1] * 1e4) / 1e4],
    }


def _tally(items: Iterable[Item]) -> dict[str, int]:
    counted = [item for item in items if item["status"] != Status.NOT_APPLICABLE]
    return {
        "items": len(counted),
        "passed": sum(sample["ok"] for item in counted for sample in item["samples"]),
        "planned": sum(item["planned"] for item in counted),
    }


def _not_applicable(run: Run, tasks: Tasks) -> dict[str, str]:
    """Return, by item, the first facet that it needs and the subject does not claim, with the reason; where it claims all of them, what
    the item itself has found not to apply."""
    claims = Claims.of_record(run["subject"]["adapters"])
    return {
        item["id"]: next(
            (
                f"{facet}: {reason}"
                for facet in claims.required(tasks[item["id"]].needs)
                if (reason := claims.why_not(facet)) is not None
            ),
            str(item["reason"]),
        )
        for item in run["items"]
        if item["status"] == Status.NOT_APPLICABLE
    }


def differences(found: object, expected: object, where: str = "") -> Iterator[str]:
    """Say where two JSON documents differ, one sentence for each place: what the first says, and what it should say."""
    if isinstance(found, dict) and isinstance(expected, dict):
        for name in {**expected, **found}:
            place = f"{where}.{name}" if where else name
            if name not in found:
                yield f"{place} is missing"
            elif name not in expected:
                yield f"{place} does not follow from the run"
            else:
                yield from differences(found[name], expected[name], place)
    elif isinstance(found, list) and isinstance(expected, list) and len(found) == len(expected):
        for index, (left, right) in enumerate(zip(found, expected, strict=True)):
            yield from differences(left, right, f"{where}[{index}]")
    # JSON's true is not 1, though Python's is.
    elif type(found) is not type(expected) or found != expected:
        yield f"{where} is {_short(found)}, from the run follows {_short(expected)}"


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
