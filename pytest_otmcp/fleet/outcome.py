"""What became of the rows of a fleet: an outcome, the verdict behind it, and how often it was tried. Pure but for reading and writing.

The outcome is read from the verdict of the record, never from an exit code: an adapter that does not start, a run that was narrowed
and a lie all end with 1.
"""

from __future__ import annotations

import gzip
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Any

import msgspec

__all__ = [
    "RECORD",
    "RESULT",
    "Outcome",
    "Result",
    "Tries",
    "file_digest",
    "judged",
    "pack",
    "read_result",
    "write_result",
]

RESULT, RECORD = "result.json", "run.json.gz"
_BLOCK = 1 << 20


class Outcome(StrEnum):
    """What became of a row."""

    CONFORMANT = "conformant"
    NOT_CONFORMANT = "not conformant"
    DID_NOT_START = "did not start"
    """The adapter came to no session in which an item could pass."""
    NARROWED = "narrowed"
    """Not everything was asked, so nothing is shown yet."""
    WRONG_SUBJECT = "wrong subject file"
    """The subject file has a mistake, or claims nothing that could be asked: the suite did not begin."""
    OUT_OF_TIME = "out of time"
    FAULT = "fault of kit or machine"
    """Also: the adapter could not be installed. The row is tried again."""
    NOT_RUN = "not run"

    @property
    def is_judged(self) -> bool:
        """It is the verdict of a record."""
        return self in (Outcome.CONFORMANT, Outcome.NOT_CONFORMANT, Outcome.DID_NOT_START, Outcome.NARROWED)

    @property
    def tone(self) -> str:
        """How a page colours it."""
        bad = (Outcome.NOT_CONFORMANT, Outcome.DID_NOT_START)
        return "good" if self is Outcome.CONFORMANT else "bad" if self in bad else "open"


def judged(verdict: Mapping[str, Any]) -> Outcome:
    """Return what a verdict says, as ``verdict.json`` has it (:mod:`pytest_otmcp.report.verdict_file`)."""
    said, passed = verdict["verdict"], sum(count["passed"] for count in verdict["items"].values())
    if said == "INDETERMINATE":
        return Outcome.FAULT
    if said == "NOT CONFORMANT":
        causes = verdict["causes"]
        never = bool(causes) and causes[0]["code"] == "cannot_start" and not passed
        return Outcome.DID_NOT_START if never else Outcome.NOT_CONFORMANT
    if said == "CONFORMANT" and not verdict["narrowed"]:
        return Outcome.CONFORMANT
    return Outcome.NARROWED


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """What a row has come to, as ``result.json`` keeps it.

    Attributes:
        key, id, version: those of the plan.
        reason: why there is no verdict, or no certificate.
        verdict: that of the record, derived again from its history after the run.
        certificate: whether one lies beside the record.
        record: SHA-256 of ``run.json``, as a certificate has it; None without a record that was judged.
        packed: SHA-256 of ``run.json.gz``, which is what lies there.
        tries: how often the row was tried.
        seconds: duration of the run.
    """

    key: str
    id: str
    version: str
    outcome: Outcome
    reason: str | None = None
    verdict: dict[str, Any] | None = None
    certificate: bool = False
    record: str | None = None
    packed: str | None = None
    tries: int = 1
    seconds: float


def write_result(directory: Path, result: Result) -> None:
    """Write a result: the last file of a row, which is there as a whole or not at all."""
    new = directory / f"{RESULT}.new"
    new.write_bytes(msgspec.json.format(msgspec.json.encode(result), indent=1) + b"\n")
    new.replace(directory / RESULT)


def read_result(directory: Path) -> Result:
    """Read a result.

    Raises:
        ValueError: it is none; the message is one sentence.
    """
    try:
        return msgspec.json.decode((directory / RESULT).read_bytes(), type=Result)
    except (OSError, ValueError, RecursionError) as reason:
        raise ValueError(f"{directory / RESULT}: {getattr(reason, 'strerror', None) or reason}") from None


def pack(record: Path) -> tuple[str, str]:
    """Compress a record in its place; return the digests before and after."""
    before, target = hashlib.sha256(), record.with_name(RECORD)
    with record.open("rb") as source, target.open("wb") as raw, gzip.GzipFile("", "wb", 6, raw, mtime=0) as packed:
        while block := source.read(_BLOCK):
            before.update(block)
            packed.write(block)
    record.unlink()
    return before.hexdigest(), file_digest(target)


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@dataclass(frozen=True, slots=True)
class Tries:
    """The tries of a row, in a file that outlives each of them: a line when one begins, and one when it fails.

    A try that was interrupted does not count. One that was killed does.
    """

    path: Path

    @classmethod
    def of(cls, fleet: Path, key: str) -> Tries:
        """Return those of a row of the fleet in this folder."""
        return cls(fleet / "tries" / f"{key}.jsonl")

    def begin(self) -> None:
        """Note that another try begins."""
        self._note({"began": datetime.now(UTC).isoformat(timespec="seconds")})

    def fail(self, reason: str, *, interrupted: bool = False) -> None:
        """Note why the try that has begun came to nothing."""
        self._note({"failed": reason, "interrupted": interrupted})

    def read(self) -> tuple[int, str | None]:
        """Return how many there were, and why the last of them failed that did."""
        count, last = 0, None
        for line in self.path.read_bytes().splitlines() if self.path.is_file() else ():
            try:
                entry = json.loads(line)
            except ValueError:
                # Torn, as when the machine went down.
                continue
            count += "began" in entry
            if "failed" in entry:
                last = entry["failed"]
                count -= entry["interrupted"]
        return count, last

    def _note(self, entry: dict[str, object]) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry) + "\n")
