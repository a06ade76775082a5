"""The reader of a run record, which trusts nothing in it; it reads one sample at a time. Pure but for the file.

A record is copied to a private file first and read from there, so that the bytes that are read later are those that were
checked. It is read line by line, as :mod:`pytest_otmcp.record.writer` has laid it out: a record that was formatted anew is refused, as
its digest would be. Of the messages of journals it has frames, which are decoded as they are read.
"""

from __future__ import annotations

import gzip
import hashlib
import tempfile
import zlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, Any, BinaryIO, cast

from ..core.files import regular
from ..core.journal_entry import JournalEntry
from ..core.strict_json import parse_strict
from .consistency import Contradiction, RunChecker
from .journals import AFTER_SAMPLES, Journals
from .layout import head_of, sample_of
from .schema import (
    SCHEMA,
    DeviceEvidence,
    EntryEvidence,
    Footer,
    Header,
    Item,
    ItemHead,
    Run,
    Sample,
    ShapeError,
    check,
)
from .writer import ITEMS_LINE, NOT_ENDED

__all__ = ["RecordError", "StoredItem", "StoredRun", "load", "open_record"]

_FIRST_LINE = b'{"schema": "' + SCHEMA.encode() + b'",\n'
_LOOKED_AT = 200
_NO_RECORDS = {b"<!DOCTYPE html>": "a page for people", b"https://in-toto.io/": "a certificate"}
"""What the first bytes of other files of the kit have in them, to what these are."""
_HEAD_ENDS = b'"samples": [\n'
_BLOCK = 1 << 20
_KEPT = 100
"""Repetitions of an item at most that are kept until the next item is read."""
_GZIP = b"\x1f\x8b"
"""The first bytes of a file that gzip has compressed (RFC 1952, section 2.3.1)."""


class RecordError(Exception):
    """A run record cannot be read or believed; the message says why."""


@dataclass(slots=True)
class _Part:
    """Place of an item in the file: offsets of its head's line and of its first sample, the number of its samples; when it began; and how
    far its devices' journals had been read when it began, and after its repetitions."""

    begin: int
    samples: int
    count: int
    began_ns: int
    journals: Journals | None = None
    at_end: Journals | None = None

    def lines(self, file: BinaryIO) -> Iterator[Sample]:
        """Return its samples, with the evidence of their journals, from the first."""
        at = self.samples
        for _ in range(self.count):
            # Two items may be read alternately.
            file.seek(at)
            line = file.readline()
            at = file.tell()
            yield sample_of(parse_strict(line.rstrip(b",\n")), "a sample")

    def head(self, file: BinaryIO) -> ItemHead:
        """Return the item without its samples, with the evidence of its journals."""
        file.seek(self.begin)
        return head_of(_item_head(file.readline()), "an item")


class StoredItem:
    """An item of a record; its samples are read when they are asked for."""

    def __init__(self, head: ItemHead, samples: Callable[[], Iterator[Sample]]) -> None:
        self.head = head
        self._samples = samples

    def samples(self) -> Iterator[Sample]:
        """Return its samples, from the first."""
        return self._samples()


class StoredRun:
    """A record that has been checked: header, footer, and items in the order of the file.

    Attributes:
        sha256: of the file's bytes.
    """

    def __init__(
        self,
        header: Header,
        footer: Footer,
        items: list[Item] | tuple[_Chain, list[_Part]],
        *,
        sha256: str,
    ) -> None:
        self.header = header
        self.footer = footer
        self.sha256 = sha256
        self._items = items

    @classmethod
    def of(cls, run: Run) -> StoredRun:
        """Return a record that is in memory already as a stored run; nothing is checked."""
        return cls(run, run["footer"], run["items"], sha256="")

    def items(self) -> Iterator[StoredItem]:
        """Return the items, from the first."""
        if isinstance(self._items, list):
            for item in self._items:
                yield StoredItem(item, partial(iter, item["samples"]))
            return
        chain, parts = self._items
        for part in parts:
            yield chain.item(part)


class _Chain:
    """The items of a file in the order of time, whatever that of the file: in this order the journals of devices go on.

    What was read to come so far is given to whoever asks for it next, so that reading a record once decodes it once.
    """

    def __init__(self, file: BinaryIO, parts: Iterable[_Part]) -> None:
        self._file = file
        self._left = deque(sorted(parts, key=lambda part: part.began_ns))
        self._journals = Journals()
        self._latest: tuple[_Part, list[Sample]] | None = None

    def item(self, part: _Part) -> StoredItem:
        """Return an item of the file."""
        while part.journals is None:
            self._go_on(self._left.popleft())
        found = part.head(self._file)
        journals = part.journals.copy(found)
        head = journals.begin(found)
        if part.at_end is not None:
            head = part.at_end.copy(found).end(head)

        def samples() -> Iterator[Sample]:
            if self._latest is not None and self._latest[0] is part:
                return iter(self._latest[1])
            reading = journals.copy(found)
            return (reading.part(found, sample) for sample in part.lines(self._file))

        return StoredItem(head, samples)

    def _go_on(self, part: _Part) -> None:
        """Read the next item, and note how far the journals of its devices had been read before it and before its end."""
        head, journals = part.head(self._file), self._journals
        part.journals = journals.copy(head)
        journals.begin(head)
        samples = (journals.part(head, sample) for sample in part.lines(self._file))
        if part.count <= _KEPT:
            self._latest = (part, list(samples))
        else:
            deque(samples, maxlen=0)
        if any(around["role"] == AFTER_SAMPLES for around in head["around"]):
            part.at_end = journals.copy(head)
            journals.end(head)


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
        return cast(Run, {**run.header, "items": items, "footer": run.footer})


def _read(file: BinaryIO, sha256: str, *, allow_incomplete: bool) -> StoredRun:
    file.seek(0)
    if (first := file.readline(_LOOKED_AT)) != _FIRST_LINE:
        begins = first + file.read(_LOOKED_AT)
        beside = next(
            (
                f": it is {what}, and run.json beside it is the record"
                for mark, what in _NO_RECORDS.items()
                if mark in begins
            ),
            "",
        )
        raise RecordError(f"not a run record of schema {SCHEMA} in the lines in which the kit writes it{beside}")
    scanner = _Scanner(file, allow_incomplete=allow_incomplete)
    scanner.scan()
    return StoredRun(scanner.header, scanner.footer, (_Chain(file, scanner.parts), scanner.parts), sha256=sha256)


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
        self._counts = checker.counts()
        try:
            if self._read_items(checker):
                self._read_footer()
        except ValueError:
            if not self._torn_is_well:
                raise
            self.footer = check({"complete": False, "reason": NOT_ENDED, **self._counts}, Footer, "the footer")
            return
        self.footer = check({**self.footer, **self._counts}, Footer, "the footer")
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
            head = _checked_head(_item_head(line), f"item {len(self.parts) + 1}")
            samples = self._file.tell()
            count = 0
            for _ in checker.item(head, self._read_samples(head["id"])):
                count += 1
            self._counts = checker.counts()
            self.parts.append(_Part(begin, samples, count, head["began_ns"]))
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
            yield _checked_sample(parse_strict(line[: -2 if another else -1]), f"a sample of {name}")
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
            self.footer = parse_strict(text[:-2] + b"," + last.rstrip(b"\n").removesuffix(b"}"))
            # Nothing but the digest is in the one line that the digest is not about.
            if last != b' "digest": "sha256:%s"}}\n' % digest.encode():
                raise Contradiction("the digest does not match: the file has been changed")
        else:
            self.footer = parse_strict(text.rstrip(b"\n").removesuffix(b"}"))
        if self._file.read(1):
            raise ValueError("something follows the footer")


def _checked_head(kept: Any, where: str) -> ItemHead:
    """Check an item without its samples; its journals hold evidence.

    Raises:
        ShapeError: it has another shape.
    """
    head = head_of(kept, where)
    if isinstance(head.get("devices"), dict) and isinstance(head.get("around"), list):
        devices = {at: _without(found, where, "before", "missed") for at, found in head["devices"].items()}
        around = [_without(part, where, "device") for part in head["around"]]
        check({**head, "devices": devices, "around": around}, ItemHead, where)
    else:
        check(head, ItemHead, where)
    return head


def _checked_sample(kept: Any, where: str) -> Sample:
    sample = sample_of(kept, where)
    check(_without(sample, where, "device"), Sample, where)
    return sample


def _without(value: Any, where: str, *names: str) -> Any:
    """Return a part of an item without the evidence in these members, which is checked.

    Raises:
        ShapeError: the evidence has another shape.
    """
    if not isinstance(value, dict):
        return value
    kept = {name: value[name] for name in names if name in value}
    for name, entries in kept.items():
        check(entries, list[DeviceEvidence] if name == "device" else list[EntryEvidence], where)
        for entry in entries:
            if "frame" not in entry:
                check(entry, JournalEntry, f"{where}: the journal entry {entry['seq']}")
    return {**value, **{name: [] for name in kept}}


def _item_head(line: bytes) -> Any:
    if not line.startswith(b"  {") or not line.endswith(_HEAD_ENDS):
        raise ValueError(f"{line[:40]!r} where an item should begin")
    head = parse_strict(line.rstrip(b"\n") + b"]}")
    del head["samples"]
    return head
