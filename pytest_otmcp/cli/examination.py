"""The examination of a run record, alone or with its certificate and its subject file: everything in them is derived again.

The files may be hostile. :mod:`pytest_otmcp.cli.confined` runs this in a process with bounded memory and time.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

from .. import __version__
from ..certificate.eligibility import objections
from ..certificate.statement import PREDICATE_TYPE, STATEMENT_TYPE, certificate, differences
from ..core.errors import UsageError
from ..core.strict_json import parse_strict
from ..core.verdict import Status, decide, exit_code, judge_deviations
from ..protocols.registry import protocols
from ..record.condensed import condensed
from ..record.consistency import clock_faults, header_faults, settings_faults
from ..record.reader import RecordError, StoredRun, open_record
from ..record.schema import Kit, Run
from ..record.tool_calls import never_called
from ..replay.rejudge import depends_on_seed, rejudge
from ..report.permission import not_covered
from ..report.verdict_file import verdict
from ..subject import comparison, load_subject
from ..subject.model import Deviation
from ..suite.catalogue import KIT, identity, kit_digest, suite_digest, tasks_by_id
from ..suite.levels import in_words, standings
from ..suite.requirements import catalogue
from ..suite.spoken import spoken, tell
from ..trial.task import Task
from . import Refusal, cut

__all__ = ["Certificate", "Examined", "answer", "examine"]

_SHOWN = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Certificate:
    """A certificate as it was read: its path for messages, and its bytes."""

    name: str
    content: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Examined:
    """The result of an examination that has found nothing wrong.

    Attributes:
        said: what was found, a sentence each.
        code: exit code of the verdict.
        run: what a program reads of the run, see :func:`pytest_otmcp.report.verdict_file.verdict`.
    """

    said: list[str]
    code: int
    run: dict[str, Any]


def answer(asked: Mapping[str, Any]) -> dict[str, Any]:
    """Examine the files that a JSON value names, and return the result as a JSON value; see :func:`examine`."""
    told = asked["certificate"]
    read = None if told is None else Certificate(name=told["name"], content=base64.b64decode(told["content"]))
    subject = None if asked["subject"] is None else Path(asked["subject"])
    found = examine(Path(asked["record"]), certificate=read, subject=subject, challenge=asked["challenge"])
    return {"said": found.said, "code": found.code, "run": found.run}


def examine(
    record: Path,
    *,
    certificate: Certificate | None = None,
    subject: Path | None = None,
    challenge: str | None = None,
) -> Examined:
    """Derive everything in a record again, and the certificate from the record.

    Args:
        record: the run.json.
        certificate: that is about the record; None for any record, also one that earns none.
        subject: the subject file that the record names; nothing of it is executed.
        challenge: the nonce that the run must have been made for.

    Raises:
        UsageError: the subject file cannot be read.
        Refusal: the certificate or the record does not hold; the message is one sentence.
    """
    try:
        told = None if certificate is None else _statement(certificate)
        # A run that did not come to its end is a record as well; only a certificate needs the whole.
        with open_record(record, allow_incomplete=certificate is None) as run:
            if certificate is not None and run.sha256 not in _bound(told):
                raise Refusal(f"refused: {certificate.name} is about another run.json than {record}")
            return _derived(run, record, certificate, told, subject, challenge)
    except RecordError as reason:
        raise Refusal(cut(f"refused: {reason}")) from None
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
        # A record that this kit wrote has everything that is read here: this one was not written by this kit.
        raise Refusal(cut(f"refused: {record} holds what no run of this kit has written ({error!r})")) from None


def _derived(
    stored: StoredRun,
    path: Path,
    certified: Certificate | None,
    told: object,
    subject: Path | None,
    challenge: str | None,
) -> Examined:
    _check_kit(path, stored.header["kit"], stored.header["subject"]["adapters"])
    if "digest" not in stored.footer:
        raise Refusal(f"refused: {path} was not sealed: {stored.footer['reason']}, or the file is not whole")
    run = condensed(stored)
    tasks = tasks_by_id(run["subject"]["adapters"], run["settings"]["suites"], run["settings"].get("devices", ()))
    why_none = objections(run, tasks)
    if certified is not None:
        _refuse(f"{path} earns no certificate", why_none)
        expected = certificate(run, stored.sha256, tasks)
        _refuse(f"{certified.name} does not say what the run says", list(differences(told, expected)))
    else:
        _refuse(f"{path} contradicts itself", [*clock_faults(run, run["items"]), *_wrong_verdict(run, tasks)])
    faults = [*settings_faults(run["settings"]), *header_faults(run, datetime.now(UTC)), *_wrong_subject(run, tasks)]
    _refuse(f"{path} contradicts itself", faults)
    asked = run["settings"].get("challenge")
    if challenge is not None and asked != challenge:
        other = "for none" if asked is None else f"for {asked!a}"
        raise Refusal(cut(f"refused: {path} was not made for the challenge {challenge!a}, but {other}"))
    if subject is not None:
        read = load_subject(subject, run=False)
        _refuse(f"{path} is not about {subject}", list(comparison.differences(read, run["subject"])))
    _refuse(f"{path} was not judged as its history deserves", rejudge(stored))
    if asked is not None and not depends_on_seed(stored):
        raise Refusal(
            f"refused: {path} names a challenge, but no value of the run follows from it: the run may be older"
        )
    said = list(_said(run, why_none if certified is None else None))
    if subject is not None:
        said.append(f"the subject, its claims, deadlines and bindings are those of {subject}")
    if challenge is not None:
        said.append(f"its values follow from the challenge {challenge}, so the run is newer than that question")
    elif asked is not None:
        said.append(f"its values follow from the challenge {asked!a}; whoever asked that gives --challenge")
    judges = [
        f"protocol {entry['key']}: {entry['distribution']} {entry['version']}"
        for entry in run["kit"]["protocols"]
        if entry["digest"] is not None and entry["key"] in run["subject"]["adapters"]
    ]
    if judges:
        said.append(f"judged by other packages than the kit, too: {', '.join(judges)}")
    statuses = {item["id"]: Status(item["status"]) for item in run["items"]}
    code = int(exit_code(decide(statuses, tasks)))
    return Examined(said=[cut(sentence) for sentence in said], code=code, run=verdict(run))


def _said(run: Run, why_none: Sequence[str] | None) -> Iterator[str]:
    """Say what was verified; ``why_none`` is None where the certificate is there."""
    level = in_words(standings(catalogue(), run["items"], run["subject"]["adapters"]))
    yield (
        f"verified: {_name(run)} is {run['footer'].get('verdict')}; {tell(spoken(run))}{', ' if level else ''}{level}; "
        f"{_repetitions(run)}, and judging them again found the same"
    )
    tools = [tool for facts in run["subject"]["adapters"].values() for tool in never_called(facts)]
    if without := not_covered(tools):
        yield f"{without[:1].lower()}{without[1:]}: {', '.join(tools)}"
    if why_none is None:
        return
    failed = [item["id"] for item in run["items"] if item["status"] not in (Status.PASS, Status.NOT_APPLICABLE)]
    if failed:
        yield f"did not pass: {', '.join(failed)}"
    yield f"it earns no certificate: {why_none[0]}" if why_none else "it earns a certificate; this is the record alone"


def _name(run: Run) -> str:
    return f"{run['subject']['name']} {run['subject']['version']}"


def _repetitions(run: Run) -> str:
    counted = [item for item in run["items"] if item["status"] != Status.NOT_APPLICABLE]
    good = sum(sample["ok"] for item in counted for sample in item["samples"])
    return f"{good} of {sum(item['planned'] for item in counted)} repetitions passed"


def _wrong_verdict(run: Run, tasks: Mapping[str, Task]) -> Iterator[str]:
    follows = decide({item["id"]: Status(item["status"]) for item in run["items"]}, tasks)
    if run["footer"].get("verdict") != follows:
        yield f"from its items follows {follows}, the footer says {run['footer'].get('verdict')}"


def _wrong_subject(run: Run, tasks: Mapping[str, Task]) -> Iterator[str]:
    """Say in a sentence each what cannot be of the subject of a run."""
    for protocol, facts in run["subject"]["adapters"].items():
        known = protocols()[protocol]
        for name in facts.get("offered", ()):
            if name not in known.facets or not known.is_voluntary(name):
                yield f"subject.adapters.{protocol} offers {name!r}, which is no voluntary facet of {known.name}"
    known_deviations = [
        Deviation(item=told["item"], reason=told["reason"], expires=date.fromisoformat(told["expires"]))
        for told in run["subject"]["deviations"]
    ]
    statuses = {item["id"]: Status(item["status"]) for item in run["items"]}
    began = datetime.fromisoformat(run["environment"]["started_at"]).date()
    try:
        follows = judge_deviations(known_deviations, statuses, tasks, began).as_record()
    except UsageError as reason:
        yield str(reason)
        return
    if run["footer"].get("deviations", follows) != follows:
        yield f"from its items follow the deviations {follows}, the footer says {run['footer'].get('deviations')}"


def _statement(certificate: Certificate) -> Any:
    try:
        statement = parse_strict(certificate.content)
    except ValueError as reason:
        raise Refusal(cut(f"refused: {certificate.name}: not strict JSON: {reason}")) from None
    types = (statement.get("_type"), statement.get("predicateType")) if isinstance(statement, dict) else None
    if types != (STATEMENT_TYPE, PREDICATE_TYPE):
        swapped = isinstance(statement, dict) and str(statement.get("schema")).startswith("otmcp-run/")
        hint = "; it is a run record: the certificate is named first, the record behind it" if swapped else ""
        raise Refusal(f"refused: {certificate.name}: not an in-toto statement about a test result{hint}")
    return statement


def _bound(statement: Any) -> list[Any]:
    """Return the digests of the records that a statement is about."""
    try:
        about = statement["predicate"]["configuration"]
        return [entry["digest"]["sha256"] for entry in about if entry["name"] == "run.json"]
    except (KeyError, TypeError):
        return []


def _check_kit(path: Path, judged_by: Kit, adapters: Iterable[str]) -> None:
    found = tuple(judged_by.get(name) for name in ("version", "suite_digest", "digest", "name"))
    if found == (__version__, suite_digest(), kit_digest(), KIT):
        _check_protocols(path, judged_by, adapters)
        return
    if found[0] == __version__:
        why = (
            f"another kit: a pytest-otmcp {__version__} with other files than this one (of another commit, or one of the two "
            "has been changed)"
        )
    else:
        why = f"another kit: pytest-otmcp {cut(str(found[0]))}, and this is {__version__}"
    raise Refusal(
        f"refused: {path} was judged by {why}; only that kit can verify it; `otmcp report` shows what the record says, "
        "`otmcp judge` what this kit finds otherwise"
    )


def _check_protocols(path: Path, judged_by: Kit, adapters: Iterable[str]) -> None:
    """Compare the protocols of other packages that judged the run with those that are installed here."""
    for entry in judged_by["protocols"]:
        if entry["digest"] is None:
            continue
        package = f"the protocol {entry['key']!r} of {entry['distribution']} {entry['version']}"
        installed = protocols().get(entry["key"])
        if installed is None or installed.origin is None:
            raise Refusal(cut(f"refused: {path} was judged by {package}; install it to judge the run again"))
        if installed.origin.digest != entry["digest"]:
            raise Refusal(cut(f"refused: {path} was judged by {package} with other files than those installed here"))
    stated = {entry["key"]: entry for entry in judged_by["protocols"]}
    for key in adapters:
        installed = protocols().get(key)
        if installed is not None and stated.get(key) != identity(installed):
            raise Refusal(cut(f"refused: {path} does not say rightly who judged the protocol {key!r}"))


def _refuse(what: str, reasons: list[str]) -> None:
    if reasons:
        more = f" (and {len(reasons) - _SHOWN} more)" if len(reasons) > _SHOWN else ""
        raise Refusal(cut(f"refused: {what}: {'; '.join(reasons[:_SHOWN])}") + more)
