"""The chain of hashes of an audit log, as it is read. The standard library alone: whoever verifies a log need not run its adapter.

A record ends in ``,"hash":"…"}``: the SHA-256 of all bytes of its line before that. One of these is ``prev``, the hash of the record before, so
that a verifier in any language needs no canonical JSON. A record's *anchor*, its number and the first sixteen digits of its hash, is the
envelope's ``meta.audit_id``: whoever has an answer can tell that the log was cut off before its record. Without an anchor nobody can: the
last records of a chain can be removed, and who may write the file can make the whole chain again.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator
from typing import BinaryIO, NamedTuple

__all__ = ["START", "Broken", "Record", "Verdict", "records", "verify"]

START = "0" * 64
"""``prev`` of the first record."""
_RECORD = re.compile(rb'(\{"seq":(\d+),.*"prev":"([0-9a-f]{64})"),"hash":"([0-9a-f]{64})"\}')
_EVENT = re.compile(rb'\{"seq":\d+,"time":"[^"]*","event":"([a-z]+)"(?:,"lost_bytes":(\d+))?')


class Broken(Exception):
    """The log is not as it was written; the text says where, and in which respect."""


class Record(NamedTuple):
    """One line of a log: its number, the hash of the record before and its own, what it tells of, and how many bytes before it, by its own
    word, are no record."""

    seq: int
    prev: str
    hash: str
    event: str
    lost_bytes: int

    @property
    def anchor(self) -> str:
        return f"{self.seq}:{self.hash[:16]}"


class Verdict(NamedTuple):
    """What a verified log is.

    Attributes:
        first, last: numbers of its first and last records.
        anchor: that of the last record.
        unfinished: bytes at the end that are no record: an interrupted write, which was refused.
    """

    first: int
    last: int
    anchor: str
    unfinished: int


def records(lines: Iterable[bytes]) -> Iterator[tuple[Record | None, bytes]]:
    """Return what each line is: a record whose hash is that of its bytes, or None."""
    for line in lines:
        found = _RECORD.fullmatch(line)
        if found is None or hashlib.sha256(found[1]).hexdigest().encode() != found[4]:
            yield None, line
            continue
        event = _EVENT.match(line)
        kind, lost = ("", 0) if event is None else (event[1].decode(), int(event[2] or 0))
        yield Record(int(found[2]), found[3].decode(), found[4].decode(), kind, lost), line


def verify(files: Iterable[BinaryIO], anchors: Iterable[str] = ()) -> Verdict:
    """Verify a log.

    Args:
        files: the file, or its parts in their order.
        anchors: of records that must be in it.

    Raises:
        Broken: a record was changed, removed, added or moved, or has no end that an anchor tells of.
    """
    wanted, number = set(anchors), 0
    first: Record | None = None
    last: Record | None = None
    lost: int | None = None
    """Bytes since the last record of lines that are no records; None where there are no such lines."""
    for file in files:
        for record, line in records(one.removesuffix(b"\n") for one in file):
            number += 1
            if record is None:
                lost = (lost or 0) + len(line)
                continue
            where = f"line {number}, record {record.seq}"
            # What this log leaves behind is never an empty line.
            if lost is not None and not lost == record.lost_bytes > 0:
                raise Broken(f"{where}: before it are {lost} bytes that are no record, and it does not tell of them")
            if last is None:
                if record.event != "continued" and (record.seq, record.prev) != (1, START):
                    raise Broken(f"{where}: the beginning is missing")
                first = record
            elif record.prev != last.hash or record.seq != last.seq + 1:
                raise Broken(f"{where}: it does not follow on record {last.seq}")
            last, lost = record, None
            wanted.discard(record.anchor)
    if first is None or last is None:
        raise Broken("there is no record")
    if wanted:
        raise Broken(f"the record of {min(wanted)} is missing or was changed")
    return Verdict(first.seq, last.seq, last.anchor, lost or 0)
