"""The reader of a run record, which trusts nothing in it; it reads one sample at a time. Pure but for the file.

A record is copied to a private file first and read from there, so that the bytes that are read later are those that were
checked. A record of ``otmcp-run/2`` is read line by line, as :mod:`pytest_otmcp.record.writer` has laid it out: a record that
was formatted anew is refused, as its digest would be. A record of ``otmcp-run/1`` is read as a whole and returned in the shape
of today.
"""

from __future__ import annotations

import gzip
import hashlib
import tempfile
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, BinaryIO, cast

from ..core.files import regular
from ..core.strict_json import parse_strict
from . import version1
from .consistency import Contradiction, RunChecker
from .schema import SCHEMA, Footer, Header, Item, ItemHead, Run, Sample, ShapeError, check
from .writer import ITEMS_LINE

__all__ = ["RecordError", "StoredItem", "StoredRun", "load", "open_record"]

_FIRST_LINE = b'{"schema": "' + SCHEMA.encode() + b'",\n'
_HEAD_ENDS = b'"samples": [\n'
_BLOCK = 1 << 20
_GZIP = b"\x1f\x8b"
"""The first bytes of a file that gzip has compressed (RFC 1952, section 2.3.1)."""


class RecordError(Exception):
    """A run record cannot be read or believed; the message says why."""


@dataclass(frozen=True, slots=True)
class _Part:
    """Place of an item in the file: offsets of its head's line and of its first sample, and the number of its samples."""

    begin: int
    samples: int
    count: int


class StoredItem:
    """An item of a record; its samples are read when they are asked for."""

    def __init__(self, head: ItemHead, source: Iterable[Sample] | tuple[BinaryIO, _Part]) -> None:
        self.head = head
        self._source = source

    def samples(self) -> Iterator[Sample]:
        """Return its samples, from the first."""
        if not isinstance(self._source, tuple):
            yield from self._source
            return
        file, part = self._source
        at = part.samples
        for _ in range(part.count):
            # Two items may be read alternately.
            file.seek(at)
            line = file.readline()
            at = file.tell()
            yield cast(Sample, parse_strict(line.rstrip(b",\n")))


class StoredRun:
    """A record that has been checked: header, footer, and items in the order of the file.

    Attributes:
        version: of the file's schema; header and items are in the shape of today in any case.
        sha256: of the file's bytes.
    """

    def __init__(
        self,
        header: Header,
        footer: Footer,
        items: list[Item] | tuple[BinaryIO, list[_Part]],
        *,
        version: str,
        sha256: str,
    ) -> None:
        self.header = header
        self.footer = footer
        self.version = version
        self.sha256 = sha256
        self._items = items

    @classmethod
    def of(cls, run: Run) -> StoredRun:
        """Return a record that is in memory already as a stored run; nothing is checked."""
        return cls(run, run["footer"], run["items"], version=SCHEMA, sha256="")

    def items(self) -> Iterator[StoredItem]:
        """Return the items, from the first."""
        if isinstance(self._items, list):
            for item in self._items:
                yield StoredItem(item, item["samples"])
            return
        file, parts = self._items
        for part in parts:
            file.seek(part.begin)
            yield StoredItem(_item_head(file.readline()), (file, part))


@contextmanager
def open_record(path: Path, *, allow_incomplete: bool = False, compressed: bool = False) -> Iterator[StoredRun]:
    """Open a run record; it can be read as long as the context lasts.

    Args:
        path: the file.
        allow_incomplete: accept a record whose footer says that it is not complete, and a record that was torn while an
            item was written: that item is left out.
        compressed: the file may be compressed by gzip. Only for files that are trusted: a small one may hold more than any disk.

    Raises:
        RecordError: the file is no record, is unfinished, or contradicts itself; the message is one sentence.
    """
    with tempfile.TemporaryFile(prefix="otmcp-") as private:
        try:
            digest = hashlib.sha256()
            with _opened(path, compressed=compressed) as source:
                while block := source.read(_BLOCK):
                    digest.update(block)
                    private.write(block)
            run = _read(private, digest.hexdigest(), allow_incomplete=allow_incomplete)
            if not run.footer["complete"] and not allow_incomplete:
                raise RecordError(f"the run is incomplete: {run.footer['reason']}")
        except (OSError, EOFError, zlib.error) as error:
            reason = getattr(error, "strerror", None) or error
            raise RecordError(f"{path}: cannot be read ({reason})") from None
        except ValueError as reason:
            raise RecordError(f"{path}: not strict JSON: {reason}") from None
        except (RecordError, ShapeError, Contradiction) as reason:
            raise RecordError(f"{path}: {reason}") from None
        yield run


def _opened(path: Path, *, compressed: bool) -> IO[bytes]:
    if compressed:
        with open(path, "rb", opener=regular) as file:
            if file.read(len(_GZIP)) == _GZIP:
                return cast("IO[bytes]", gzip.open(path))
    return open(path, "rb", opener=regular)


def load(path: Path, *, allow_incomplete: bool = False) -> Run:
    """Read a whole run record into memory; see :func:`open_record`."""
    with open_record(path, allow_incomplete=allow_incomplete) as run:
        items = [cast(Item, {**item.head, "samples": list(item.samples())}) for item in run.items()]
        header = {**run.header, "schema": run.version}
        return cast(Run, {**header, "items": items, "footer": run.footer})


def _read(file: BinaryIO, sha256: str, *, allow_incomplete: bool) -> StoredRun:
    file.seek(0)
    if file.readline() == _FIRST_LINE:
        scanner = _Scanner(file, allow_incomplete=allow_incomplete)
        scanner.scan()
        return StoredRun(scanner.header, scanner.footer, (file, scanner.parts), version=SCHEMA, sha256=sha256)
    file.seek(0)
    content = file.read()
    run = version1.parse(content, allow_incomplete=allow_incomplete)
    if isinstance(run, dict) and run.get("schema") == SCHEMA:
        raise RecordError("the file was formatted anew: a record is read in the lines in which the kit wrote it")
    if not isinstance(run, dict) or run.get("schema") != version1.SCHEMA:
        raise RecordError(f"not a run record of schema {SCHEMA} or {version1.SCHEMA}")
    version1.check_digest(run)
    today = check(version1.upgraded(run), Run, "the record")
    checker = RunChecker(today)
    for item in today["items"]:
        for _ in checker.item(item, item["samples"]):
            pass
    checker.footer(today["footer"])
    return StoredRun(today, today["footer"], today["items"], version=version1.SCHEMA, sha256=sha256)


class _Scanner:
    """The scanner of a record: it reads and checks the lines once, and notes the places of the items."""

    header: Header
    footer: Footer

    def __init__(self, file: BinaryIO, *, allow_incomplete: bool) -> None:
        self._file = file
        self._torn_is_well = allow_incomplete
        self._digest = hashlib.sha256()
        self.parts: list[_Part] = []

    def scan(self) -> None:
        """Read the whole record.

        Raises:
            ValueError: the lines are not those of a record, or no strict JSON.
            ShapeError, Contradiction: the record has another shape or contradicts itself.
        """
        self._file.seek(0)
        self._read_header()
        checker = RunChecker(self.header)
        try:
            if self._read_items(checker):
                self._read_footer()
        except ValueError:
            if not self._torn_is_well:
                raise
            self.footer = {"complete": False, "reason": "the run did not end", "items": len(self.parts)}
            return
        checker.footer(self.footer)

    def _line(self) -> bytes:
        line = self._file.readline()
        if not line.endswith(b"\n"):
            raise ValueError("the file ends in the midst of a line" if line else "the file ends before its footer")
        self._digest.update(line)
        return line

    def _read_header(self) -> None:
        lines = []
        while (line := self._line()) != ITEMS_LINE:
            lines.append(line)
        text = b"".join(lines)
        if not text.endswith(b",\n"):
            raise ValueError("the header does not end where the items begin")
        header = parse_strict(text[:-2] + b"}")
        if isinstance(header, dict) and (twice := {"items", "footer"} & header.keys()):
            raise ValueError(f"the member {min(twice)!r} occurs twice")
        self.header = check(header, Header, "the record")

    def _read_items(self, checker: RunChecker) -> bool:
        begin, line = self._file.tell(), self._line()
        if line == b"\n":
            line, more = self._line(), False
        else:
            more = True
        while more:
            head = check(_item_head(line), ItemHead, f"item {len(self.parts) + 1}")
            samples = self._file.tell()
            count = 0
            for _ in checker.item(head, self._read_samples(head["id"])):
                count += 1
            self.parts.append(_Part(begin, samples, count))
            more = self._another_item
            begin, line = self._file.tell(), self._line()
        if line != b" ],\n":
            raise ValueError(f"{line[:40]!r} where the items should end")
        return True

    def _read_samples(self, name: str) -> Iterator[Sample]:
        another: bool | None = None
        while (line := self._line()) not in (b"  ]}\n", b"  ]},\n"):
            if another is False:
                raise ValueError(f"a comma is missing between two samples of {name}")
            another = line.endswith(b",\n")
            yield check(parse_strict(line[: -2 if another else -1]), Sample, f"a sample of {name}")
        if another:
            raise ValueError(f"a comma after the last sample of {name}")
        self._another_item = line == b"  ]},\n"

    def _read_footer(self) -> None:
        line, digest = self._line(), self._digest.hexdigest()
        if not line.startswith(b' "footer": '):
            raise ValueError(f"{line[:40]!r} where the footer should begin")
        text = line.removeprefix(b' "footer": ')
        if text.endswith(b",\n"):
            last = self._file.readline()
            if not last.endswith(b"}}\n"):
                raise ValueError("the file ends in the midst of a line")
            self.footer = check(
                parse_strict(text[:-2] + b"," + last.rstrip(b"\n").removesuffix(b"}")), Footer, "the footer"
            )
            # Nothing but the digest is in the one line that the digest is not about.
            if last != b' "digest": "sha256:%s"}}\n' % digest.encode():
                raise Contradiction("the digest does not match: the file has been changed")
        else:
            self.footer = check(parse_strict(text.rstrip(b"\n").removesuffix(b"}")), Footer, "the footer")
        if self._file.read(1):
            raise ValueError("something follows the footer")


def _item_head(line: bytes) -> ItemHead:
    if not line.startswith(b"  {") or not line.endswith(_HEAD_ENDS):
        raise ValueError(f"{line[:40]!r} where an item should begin")
    head = parse_strict(line.rstrip(b"\n") + b"]}")
    del head["samples"]
    return cast(ItemHead, head)
