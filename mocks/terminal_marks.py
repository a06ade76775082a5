"""Marks in what is sent over a pseudo terminal: what was sent before a mark is read before it.

The kernel moves what is sent from one side of a terminal to the other in its own time, and in its order.
"""

from __future__ import annotations

import itertools
import secrets

__all__ = ["Marks"]

_DIGITS = 8


class Marks:
    """The marks of one terminal: a letter, 16 random digits, and the number of the mark, all of them hexadecimal but the letter.

    Attributes:
        passed: number of the latest mark that was read, 0 for none.
    """

    def __init__(self) -> None:
        self.passed = 0
        # No end of it is its beginning again: what was sent in front of a mark cannot be taken for a part of it.
        self._begin = b"m" + secrets.token_hex(8).encode()
        self._numbers = itertools.count(1)
        self._latest = 0
        self._kept = b""

    def next(self) -> tuple[int, bytes]:
        """Return the number of a new mark, and the mark."""
        self._latest = next(self._numbers)
        return self._latest, self._begin + b"%0*x" % (_DIGITS, self._latest)

    def without(self, data: bytes) -> bytes:
        """Return what was read without the marks in it. What may be the beginning of a mark is kept back until the rest has come."""
        if self.passed == self._latest:
            return data
        data, self._kept = self._kept + data, b""
        read = b""
        while (at := data.find(self._begin)) >= 0 and len(data) >= (end := at + len(self._begin) + _DIGITS):
            read += data[:at]
            self.passed = int(data[end - _DIGITS : end], 16)
            data = data[end:]
        if self.passed < self._latest:
            at = self._beginning(data) if at < 0 else at
            data, self._kept = data[:at], data[at:]
        return read + data

    def _beginning(self, data: bytes) -> int:
        most = min(len(data), len(self._begin) - 1)
        return len(data) - next(size for size in range(most, -1, -1) if data.endswith(self._begin[:size]))
