"""The end of ``otmcp certify``: the record of the run is read, and the certificate written.

The adapter has run by then and may have changed files, so all that is needed is imported before: with this module.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from ..certificate.badge import badge, badge_svg
from ..certificate.eligibility import objections
from ..certificate.statement import certificate
from ..core.errors import KitError, UsageError
from ..core.verdict import ExitCode, Status, decide, exit_code
from ..record.condensed import condensed
from ..record.reader import RecordError, open_record
from ..record.schema import Run
from ..replay.rejudge import depends_on_seed
from ..report.certificate_page import certificate_page
from ..report.html import page
from ..report.markdown import summary
from ..suite.catalogue import tasks_by_id
from . import Refusal, show, tell

__all__ = ["concluded", "write", "write_pages"]


def concluded(out: Path, ended: int) -> tuple[Run, dict[str, Any]]:
    """Return the record of a run and its certificate.

    Args:
        out: folder of its record.
        ended: exit code of the pytest that made it.

    Raises:
        UsageError, KitError: there is no record.
        Refusal: there is no certificate.
    """
    path = out / "run.json"
    if not path.is_file():
        if ended in (2, 4):
            raise UsageError("no certificate: the suite did not begin, for the reason above")
        raise KitError(f"no certificate: pytest ended with {ended} before anything was recorded")
    try:
        with open_record(path) as stored:
            record, sha256 = condensed(stored), stored.sha256
            asked = record["settings"].get("challenge")
            follows = asked is None or depends_on_seed(stored)
    except RecordError as reason:
        raise Refusal(f"no certificate: {reason}") from None
    tasks = tasks_by_id(record["subject"]["adapters"], record["settings"]["suites"])
    if reasons := objections(record, tasks):
        statuses = {item["id"]: Status(item["status"]) for item in record["items"]}
        code = exit_code(decide(statuses, tasks), statuses=statuses.values())
        raise Refusal(f"no certificate: {'; '.join(reasons)}", max(code, ExitCode.NOT_CONFORMANT))
    if not follows:
        raise Refusal(
            "no certificate for a challenge: no item that applies draws a value, so nothing of the run follows from it"
        )
    return record, certificate(record, sha256, tasks)


def write(out: Path, statement: dict[str, Any]) -> None:
    """Write certificate and badge, and say what was earned."""
    for name in ("badge.json", "badge.svg", "certificate.json"):
        # During the run an adapter may have put a link there.
        (out / name).unlink(missing_ok=True)

    def dumped(document: dict[str, object]) -> str:
        return json.dumps(document, indent=1, ensure_ascii=False) + "\n"

    (out / "badge.json").write_text(dumped(badge(statement)), encoding="utf-8")
    (out / "badge.svg").write_text(badge_svg(statement), encoding="utf-8")
    (out / "certificate.json").write_text(dumped(statement), encoding="utf-8")
    told = statement["predicate"]["otmcp"]
    for protocol, adapter in told["adapters"].items():
        facets = adapter["facets"]
        tell(
            f"{protocol}: earned {', '.join(facets['earned']) or 'nothing'}, every call within {adapter['deadline_s']:g} s"
        )
        if facets["claimed_not_exercised"]:
            tell(
                f"{protocol}: claimed, but nothing applied that needs it: {', '.join(facets['claimed_not_exercised'])}"
            )
        for name, reason in facets["not_claimed"].items():
            tell(f"{protocol}: not claimed: {name} ({reason})")
    show(
        ", ".join(
            f"{count['passed']} of {count['of']} {family} items passed" for family, count in told["items"].items()
        )
    )
    show(told["level"]["why"])
    for sentence in (*told["isolation"]["seen"], *told["isolation"]["missing"]):
        show(sentence)
    show(f"certificate.json, badge.json and badge.svg are in {out}, beside the run.json that they are about")


def write_pages(out: Path, record: Run, statement: dict[str, Any], *, signed: bool) -> None:
    """Write the certificate for people, and the report again, which names it."""
    sha256 = hashlib.sha256((out / "certificate.json").read_bytes()).hexdigest()
    pages = {
        "certificate.html": certificate_page(statement, sha256, signed=signed),
        "report.html": page(record, certificate="certificate.html"),
        "summary.md": summary(record, certified=True),
    }
    for name, text in pages.items():
        (out / name).unlink(missing_ok=True)
        (out / name).write_text(text, encoding="utf-8", newline="\n")
    show(f"{out / 'certificate.html'} is the certificate on a page to print")
