"""The certificate for a person: ``certificate.html.jinja``, filled from the statement and nothing else. Pure.

Programs judge ``certificate.json``; this page repeats it on a sheet of paper, and says how to check it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from ..core.text import counted
from ..protocols.protocol import FACETS
from ..protocols.registry import protocols
from ..suite.requirements import Level
from .applying import without_values
from .page import filled
from .permission import covered, not_covered, permitted
from .text import calls_made

__all__ = ["certificate_page"]


def certificate_page(certificate: Mapping[str, Any], sha256: str, *, signed: bool) -> str:
    """Return the page.

    Args:
        certificate: the statement, as :func:`pytest_otmcp.certificate.statement.certificate` makes it.
        sha256: hexadecimal digest of the file ``certificate.json``.
        signed: ``certificate.json.sig`` is beside it.
    """
    told = certificate["predicate"]["otmcp"]
    (subject,) = certificate["subject"]
    *kit, record = certificate["predicate"]["configuration"]
    return filled(
        "certificate.html.jinja",
        subject=subject["name"],
        levels=list(_levels(told)),
        partial=bool(told["isolation"]["missing"])
        or any(one["tools_never_called"] for one in told["adapters"].values()),
        facts=_facts(told),
        digests=[
            ("Subject file", subject["digest"]["sha256"]),
            *_programs(told),
            *((entry["name"], entry["digest"]["sha256"]) for entry in kit),
            ("run.json", record["digest"]["sha256"]),
            ("certificate.json", sha256),
        ],
        shown=[
            (protocols()[protocol].name, list(facts["facets"]["earned"]))
            for protocol, facts in told["adapters"].items()
        ],
        vocabulary=[
            (protocols()[protocol].name, one["name"], _stated(one))
            for protocol, facts in told["adapters"].items()
            for one in facts["vocabulary"]
        ],
        warnings=told["warnings"],
        not_tested=list(_not_tested(told)),
        limits=told["limits"],
        wheel=f"{kit[0]['name'].replace('-', '_').replace(' ', '-')}-py3-none-any.whl",
        signed=signed,
        measured=told["measured_at"],
        challenge=told["settings"].get("challenge"),
    )


def _levels(told: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield each level that was earned, and "no level", with what it allows, the protocols, and what was passed at each."""
    awarded = told["level"]["awarded"]
    for level in dict.fromkeys(awarded.get(protocol) for protocol in told["adapters"]):
        earning = [protocol for protocol in told["adapters"] if awarded.get(protocol) == level]
        yield {
            "level": "no level" if level is None else level.capitalize(),
            "meaning": _meaning(level),
            "protocols": ", ".join(protocols()[protocol].name for protocol in earning),
            "passed": [
                *(_passed(protocol, told) for protocol in earning),
                *(
                    f"{about}."
                    for tools in [[tool for one in earning for tool in told["adapters"][one]["tools_judged"]]]
                    if (about := covered(tools))
                ),
                *(
                    f"{without}: {', '.join(tools)}."
                    for tools in [[tool for one in earning for tool in told["adapters"][one]["tools_never_called"]]]
                    if (without := not_covered(tools))
                ),
            ],
        }


def _passed(protocol: str, told: Mapping[str, Any]) -> str:
    facts, name = told["adapters"][protocol], protocols()[protocol].name
    count = told["items"][name]
    below = ", all that apply (what was not tested stands below)" if count["passed"] < count["of"] else ""
    server = " ".join(filter(None, (facts["server"]["name"], facts["server"]["version"])))
    called = f"; it calls itself {server}" if server else ""
    return f"It passed {count['passed']} of {count['of']} {name} items{below}, every call within {facts['deadline_s']:g} s{called}."


def _stated(named: Mapping[str, Any]) -> str:
    """Say what a name means, as the vendor states it, and with which values it was tested."""
    asks = ", then ".join(
        f"{one['operation']} {' '.join(f'{name}={_shown(value)}' for name, value in one['inputs'].items())}"
        for one in named["asks"]
    )
    parts = [*([f"the tool {named['tool']}"] if named["tool"] != named["name"] else []), asks]
    parts += [f"${name} {_range(values)}" for name, values in named["arguments"].items()]
    if "holds" in named:
        means = named["means"]
        if means is not None:
            parts.append(f"what it tells means {means if isinstance(means, str) else _shown(means)}")
        parts.append(f"tested while the device held {_range(named['holds'])}")
    return "; ".join(parts)


def _range(values: Any) -> str:
    if isinstance(values, dict):
        step = "" if values["step"] == 1 else f" by {values['step']:g}"
        return f"{values['lowest']:.12g} to {values['highest']:.12g}{step}"
    told = [
        f"{_shown(one['value'])} ({_shown(one['means'])})" if isinstance(one, dict) else _shown(one) for one in values
    ]
    return ", ".join(told)


def _shown(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def _not_tested(told: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Yield what the run says nothing about: whose it is, what, and why not; what has one reason stands together."""
    found: dict[tuple[str, str], list[str]] = {}
    for name, what, why in _each_not_tested(told):
        found.setdefault((name, why), []).append(what)
    yield from ((name, ", ".join(what), why) for (name, why), what in found.items())


def _each_not_tested(told: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    for protocol, facts in told["adapters"].items():
        name, facets = protocols()[protocol].name, facts["facets"]
        yield from ((name, tool, "tools whose answers were never judged") for tool in facts["tools_never_called"])
        yield from (
            (name, facet, f"the vendor does not claim it: {why}") for facet, why in facets["not_claimed"].items()
        )
        yield from ((name, facet, "claimed, and no item needed it") for facet in facets["claimed_not_exercised"])
        yield from ((name, output, "not found in its answers") for output in facts["outputs_not_judged"])
        yield from (
            (name, f"{tool}: {', '.join(members)}", "members of answers that no named reading is of")
            for tool, members in facts["members_not_judged"].items()
        )
    for item, why in told["not_applicable"].items():
        facet, _, reason = why.partition(": ")
        protocol, _, name = facet.partition(".")
        if protocol not in protocols() or not reason:
            yield "", item, without_values(why)
        # What the subject does not speak is not about it.
        elif protocol in told["adapters"]:
            yield (
                protocols()[protocol].name,
                item.removesuffix(f".{protocol}"),
                f"{_in_words(protocol, name)}: {reason}",
            )


def _in_words(protocol: str, facet: str) -> str:
    """Return what a facet is, for somebody who has never seen a subject file."""
    if facet in FACETS:
        return FACETS[facet][0]
    operation, _, part = facet.partition(".")
    known = protocols()[protocol].operations.get(operation)
    meaning = facet if known is None else known.meaning.rstrip(".")
    return f"{part!r} of {operation}" if part else f"{meaning[:1].lower()}{meaning[1:]}"


def _programs(told: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield what the adapters' commands start, as far as the kit can know it, each with its digest; what is the same for some once."""
    digests: dict[tuple[str, str], list[str]] = {}
    for protocol, facts in told["adapters"].items():
        tested = facts["tested"]
        if tested is None:
            continue
        for what, digest in (
            (tested["program"], tested["program_sha256"]),
            (f"{counted(tested['files'], 'file')} of its own", tested["files_sha256"]),
            (counted(tested["packages"], "package"), tested["packages_sha256"]),
        ):
            if digest is not None:
                digests.setdefault((what, digest.partition(":")[2]), []).append(protocols()[protocol].name)
    for (what, sha256), names in digests.items():
        yield f"{', '.join(names)}: {what}", sha256


def _unknown_files(told: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield the adapters of whose own files the kit knows none."""
    programs: dict[str, list[str]] = {}
    for protocol, facts in told["adapters"].items():
        tested = facts["tested"]
        if tested is not None and tested["files_sha256"] is None and tested["image"] is None:
            programs.setdefault(tested["program"], []).append(protocols()[protocol].name)
    for program, names in programs.items():
        yield f"{', '.join(names)}: own files", f"none that the kit knows: the digest is that of {program}"


def _meaning(level: str | None) -> str:
    return (
        "has earned no level, which would say what a plant may ask of it" if level is None else permitted(Level(level))
    )


def _facts(told: Mapping[str, Any]) -> list[tuple[str, str]]:
    total, counts, settings = told["counts"]["total"], told["counts"], told["settings"]
    walls = [*told["isolation"]["seen"], *told["isolation"]["missing"]]
    return [
        (
            "Machine",
            f"{told['environment']['platform']}, Python {told['environment']['python']}",
        ),
        (
            "Repetitions",
            f"{total['passed']} of {total['planned']} passed, {calls_made(counts['tool_calls'])}; N = {settings['reps']}",
        ),
        *([("Walls", " ".join(walls))] if walls else []),
        *_unknown_files(told),
        ("Run", f"{told['run_id']}, seed {settings['seed']}, catalogue of requirements {told['catalogue']}"),
    ]
