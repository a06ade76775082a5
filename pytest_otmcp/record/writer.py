"""The writer of a run record, item by item during the run. Pure but for the file.

The file is one JSON document, laid out in lines so that it can be written, read and sealed piece by piece, however long the run:
a line for each member of the header, a line for each item without its samples, a line for each sample, a line for the footer,
and a last line for the digest, which is the SHA-256 of every byte before that line.

The file is valid JSON after every item: the footer says ``"complete": false`` until the run is over. An item is written over
that footer; a write that a kill interrupts leaves whole lines, which the reader finds again.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from ..core.files import new_file, no_link
from .layout import kept_footer, kept_head, kept_sample
from .schema import Footer, Header, ItemHead, Sample

__all__ = ["ITEMS_LINE", "NOT_ENDED", "RunWriter", "SampleSpool", "dump", "laid_out"]

ITEMS_LINE = b' "items": [\n'
NOT_ENDED = "the run did not end"
_BLOCK = 1 << 20
_ITEM_END = b"\n  ]}"


def dump(value: object) -> bytes:
    """Return a value as one line of JSON.

    A lone surrogate may come from a device's topic or node name. UTF-8 cannot have it and no strict reader accepts it, so it
    becomes a question mark.
    """
    return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode("utf-8", "replace")


def laid_out(samples: Iterable[Sample]) -> Iterator[bytes]:
    """Return samples as the record has them in its item."""
    for index, sample in enumerate(samples):
        yield (b",\n   " if index else b"\n   ") + dump(kept_sample(sample))


_UNFINISHED = b'\n ],\n "footer": ' + dump({"complete": False, "reason": NOT_ENDED}) + b"}\n"


class SampleSpool:
    """The samples of one running item in a file of their own, laid out as in the record.

    Args:
        path: the file; it is made with the first sample.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._count = 0
        self._digest = hashlib.sha256()

    @property
    def digest(self) -> str:
        """SHA-256 of what was added."""
        return self._digest.hexdigest()

    def add(self, sample: Sample) -> None:
        """Append a sample."""
        content = (b",\n   " if self._count else b"\n   ") + dump(kept_sample(sample))
        # Unbuffered: what a full disk has torn must not be written again when the file is closed.
        with open(self.path, "ab", buffering=0, opener=no_link) as file:
            begin = file.tell()
            try:
                _write(file.fileno(), begin, content)
            except OSError:
                file.truncate(begin)
                raise
        self._count += 1
        self._digest.update(content)

    @staticmethod
    def read(path: Path, expected: str) -> Iterator[bytes]:
        """Return what a spool of another process holds, in blocks.

        Args:
            path: of the spool.
            expected: its digest.

        Raises:
            OSError: at its end, if it is not what was added: an adapter can write wherever its user can.
        """
        digest = hashlib.sha256()
        with suppress(FileNotFoundError), open(path, "rb", opener=no_link) as file:
            for block in _blocks(file.fileno(), 0, os.fstat(file.fileno()).st_size):
                digest.update(block)
                yield block
        if digest.hexdigest() != expected:
            raise OSError("another program has changed the samples of an item")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Written:
    order: int
    begin: int
    end: int
    digest: bytes


class RunWriter:
    """The writer of one run record.

    Args:
        path: the file; it is replaced when it exists.
        header: everything but items and footer, as far as it is known.
    """

    def __init__(self, path: Path, header: Header) -> None:
        self._path = path
        self._items: list[_Written] = []
        head = _head(header)
        self._end = len(head)
        with new_file(path) as file:
            file.write(head + _UNFINISHED)

    def append(self, item: ItemHead, samples: Iterable[bytes]) -> None:
        """Add an item; the file is a valid record of an unfinished run when this returns.

        Args:
            item: the item without its samples.
            samples: laid out, see :func:`laid_out`.

        Raises:
            OSError: the item could not be written; the file is as it was before.
        """
        head = (b",\n" if self._items else b"") + b"  " + dump(kept_head(item))[:-1] + b', "samples": ['
        # Unbuffered, so that an interrupted write leaves whole lines before it.
        digest = hashlib.sha256(head.removeprefix(b",\n"))
        with open(self._path, "r+b", buffering=0, opener=no_link) as file:
            descriptor = file.fileno()
            try:
                at = _write(descriptor, self._end, head)
                for block in samples:
                    digest.update(block)
                    at = _write(descriptor, at, block)
                digest.update(_ITEM_END)
                end = _write(descriptor, at, _ITEM_END)
                _write(descriptor, end, _UNFINISHED)
            except OSError:
                _write(descriptor, self._end, _UNFINISHED)
                file.truncate(self._end + len(_UNFINISHED))
                raise
        begin = self._end + (2 if self._items else 0)
        self._items.append(_Written(order=item["order"], begin=begin, end=end, digest=digest.digest()))
        self._end = end

    def finish(self, header: Header, footer: Footer) -> None:
        """Seal the record: header and footer as now known, items in the suite's order. The file is replaced in one step.

        Raises:
            OSError: it could not be written, or is not what was written before.
        """
        fresh = self._path.with_suffix(".json.new")
        digest = hashlib.sha256()
        try:
            with new_file(fresh) as target, open(self._path, "rb", opener=no_link) as source:
                for block in self._sealed(source.fileno(), header, footer):
                    digest.update(block)
                    target.write(block)
                target.write(b' "digest": ' + dump("sha256:" + digest.hexdigest()) + b"}}\n")
            os.replace(fresh, self._path)
        except OSError:
            fresh.unlink(missing_ok=True)
            raise

    def _sealed(self, source: int, header: Header, footer: Footer) -> Iterator[bytes]:
        yield _head(header)
        for index, item in enumerate(sorted(self._items, key=lambda item: item.order)):
            if index:
                yield b",\n"
            digest = hashlib.sha256()
            for block in _blocks(source, item.begin, item.end):
                digest.update(block)
                yield block
            if digest.digest() != item.digest:
                # An adapter can write wherever its user can.
                raise OSError("another program has changed it")
        yield b'\n ],\n "footer": ' + dump(kept_footer(footer))[:-1] + b",\n"


def _head(header: Header) -> bytes:
    members = b",\n ".join(dump(name) + b": " + dump(value) for name, value in header.items())
    return b"{" + members + b",\n" + ITEMS_LINE


def _write(descriptor: int, at: int, content: bytes) -> int:
    os.lseek(descriptor, at, os.SEEK_SET)
    rest = memoryview(content)
    while rest:
        rest = rest[os.write(descriptor, rest) :]
    return at + len(content)


def _blocks(descriptor: int, begin: int, end: int) -> Iterator[bytes]:
    os.lseek(descriptor, begin, os.SEEK_SET)
    while begin < end:
        block = os.read(descriptor, min(_BLOCK, end - begin))
        if not block:
            raise OSError("the file has been cut off")
        begin += len(block)
        yield block
