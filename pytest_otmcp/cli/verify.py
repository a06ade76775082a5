"""``otmcp verify``: a check that a certificate follows from its run, and the run's judgement from its history.

The command refuses files that were edited or torn, or that are incomplete. It also refuses a valid record that another kit
judged: only the kit that judged a history can judge it again.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.errors import UsageError
from . import Refusal

if TYPE_CHECKING:
    from ..record.reader import StoredRun
    from ..record.schema import Kit

__all__ = ["add_parser", "run", "verify"]

_SHOWN = 3


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "verify",
        help="check a certificate against its record, and judge the record again",
        description="Check that a certificate says what its run record says, and judge the record's history again.",
    )
    parser.add_argument("certificate", metavar="CERT", type=Path, help="a certificate.json")
    parser.add_argument("record", metavar="RUN", type=Path, help="the run.json that it is about")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Verify the certificate and print the result.

    Raises:
        UsageError: one of the files is not there.
        Refusal: the certificate or the record does not hold.
    """
    told = verify(args.certificate, args.record)
    said = told["predicate"]["otmcp"]
    counts, applied = said["counts"]["total"], said["applied"]
    print(
        f"verified: {told['subject'][0]['name']} is {said['verdict']}; {applied['items']} of {applied['of']} items applied, "
        f"{counts['passed']} of {counts['planned']} repetitions passed, and judging them again found the same"
    )
    if judges := [
        entry["name"] for entry in told["predicate"]["configuration"] if entry["name"].startswith("protocol ")
    ]:
        print(f"judged by other packages than the kit, too: {', '.join(judges)}")
    print("the certificate is not signed: who ran the kit, and at which adapter, it cannot prove")
    return 0


def verify(certificate_path: Path, record_path: Path) -> dict[str, Any]:
    """Return the certificate, after everything in it has been derived again.

    Raises:
        UsageError: one of the files is not there.
        Refusal: the certificate or the record does not hold; the message is one sentence.
    """
    from ..record.reader import RecordError, open_record

    told = _statement(certificate_path)
    if not record_path.is_file():
        raise UsageError(f"{record_path}: there is no such file")
    try:
        with open_record(record_path) as run:
            return _derived(told, run, certificate_path, record_path)
    except RecordError as reason:
        raise Refusal(f"refused: {reason}") from None


def _derived(told: object, run: StoredRun, certificate_path: Path, record_path: Path) -> dict[str, Any]:
    from ..certificate.eligibility import objections
    from ..certificate.statement import certificate, differences
    from ..record.condensed import condensed
    from ..replay.rejudge import rejudge
    from ..suite.catalogue import tasks_by_id

    if run.sha256 not in _bound(told):
        raise Refusal(f"refused: {certificate_path} is about another run.json than {record_path}")
    _check_kit(record_path, run.header["kit"])
    record = condensed(run)
    tasks = tasks_by_id(run.header["subject"]["adapters"])
    try:
        _refuse(f"{record_path} earns no certificate", objections(record, tasks))
        expected = certificate(record, run.sha256, tasks)
        _refuse(f"{certificate_path} does not say what the run says", list(differences(told, expected)))
        _refuse(f"{record_path} was not judged as its history deserves", rejudge(run))
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        # A record that this kit wrote has everything that is read here: this one was not written by this kit.
        raise Refusal(f"refused: {record_path} holds what no run of this kit has written ({error!r})") from None
    return expected


def _statement(path: Path) -> Any:
    from ..certificate.statement import PREDICATE_TYPE, STATEMENT_TYPE
    from ..core.strict_json import parse_strict

    if not path.is_file():
        raise UsageError(f"{path}: there is no such file")
    try:
        statement = parse_strict(path.read_bytes())
    except ValueError as reason:
        raise Refusal(f"refused: {path}: not strict JSON: {reason}") from None
    types = (statement.get("_type"), statement.get("predicateType")) if isinstance(statement, dict) else None
    if types != (STATEMENT_TYPE, PREDICATE_TYPE):
        raise Refusal(f"refused: {path}: not an in-toto statement about a test result")
    return statement


def _bound(statement: Any) -> list[Any]:
    """Return the digests of the records that a statement is about."""
    try:
        about = statement["predicate"]["configuration"]
        return [entry["digest"]["sha256"] for entry in about if entry["name"] == "run.json"]
    except (KeyError, TypeError):
        return []


def _check_kit(path: Path, judged_by: Kit) -> None:
    from .. import __version__
    from ..suite.catalogue import kit_digest, suite_digest

    found = tuple(judged_by.get(name) for name in ("version", "suite_digest", "digest"))
    if found == (__version__, suite_digest(), kit_digest()):
        _check_protocols(path, judged_by)
        return
    if found[0] == __version__:
        why = f"a pytest-otmcp {__version__} with other files than this one (one of the two has been changed)"
    else:
        why = f"pytest-otmcp {found[0]}, and this is {__version__}; install that version to judge it again"
    raise Refusal(f"refused: {path} was judged by {why}")


def _check_protocols(path: Path, judged_by: Kit) -> None:
    """Compare the protocols of other packages that judged the run with those that are installed here."""
    from ..protocols.registry import protocols

    for entry in judged_by["protocols"]:
        if entry["digest"] is None:
            continue
        package = f"the protocol {entry['key']!r} of {entry['distribution']} {entry['version']}"
        installed = protocols().get(entry["key"])
        if installed is None or installed.origin is None:
            raise Refusal(f"refused: {path} was judged by {package}; install it to judge the run again")
        if installed.origin.digest != entry["digest"]:
            raise Refusal(f"refused: {path} was judged by {package} with other files than those installed here")


def _refuse(what: str, reasons: list[str]) -> None:
    if reasons:
        more = f" (and {len(reasons) - _SHOWN} more)" if len(reasons) > _SHOWN else ""
        raise Refusal(f"refused: {what}: {'; '.join(reasons[:_SHOWN])}{more}")
