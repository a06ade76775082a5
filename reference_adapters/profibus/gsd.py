"""The parser of GSD files (EN 50170, part 8-2; the specification is public at PROFIBUS International).

A GSD file is text in ISO 8859-1: ``Keyword = value`` line by line, ``\\`` at the end of a line that goes on, ``;`` before a comment, and
modules between ``Module`` and ``EndModule``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

__all__ = ["BadGsd", "DeviceFile", "Module", "parse"]

_FIRST = "#profibus_dp"
_SPEED = re.compile(r"([\d.]+m?)_supp", re.IGNORECASE)
_MOST_MODULES = 500
_Value = int | str | list[int]


class BadGsd(Exception):
    """A text that is no GSD file; the message says why."""


@dataclass(frozen=True, slots=True)
class Module:
    """One module: its name and its configuration identifiers."""

    name: str
    cfg: bytes


@dataclass(slots=True)
class DeviceFile:
    """What a GSD file says of a device.

    Attributes:
        keywords: names, in lower case, to their values.
        modules: in the order of the file.
    """

    keywords: dict[str, _Value] = field(default_factory=dict)
    modules: list[Module] = field(default_factory=list)

    def text(self, name: str) -> str | None:
        """Return a text; None where the file has none."""
        value = self.keywords.get(name.lower())
        return value if isinstance(value, str) else None

    def number(self, name: str) -> int | None:
        """Return a number; None where the file has none."""
        value = self.keywords.get(name.lower())
        return value if isinstance(value, int) else None

    @property
    def baud_rates(self) -> list[str]:
        """The baud rates that the device supports, as the file names them: ``19.2``, ``1.5M`` (in kbit/s, or with M in Mbit/s)."""
        found = (_SPEED.fullmatch(name) for name, value in self.keywords.items() if value == 1)
        return [match[1].upper() for match in found if match]


def parse(text: str) -> DeviceFile:
    """Return what a GSD file says.

    Raises:
        BadGsd: it does not begin as one, a line cannot be read, or a module has no end.
    """
    lines = _lines(text)
    if not lines or lines[0][1].lower() != _FIRST:
        raise BadGsd("a GSD file begins with #Profibus_DP")
    file = DeviceFile()
    module: Module | None = None
    skipped: str | None = None
    for number, line in lines[1:]:
        name, equals, value = (part.strip() for part in line.partition("="))
        word = name.lower()
        if skipped is not None:
            skipped = None if word == skipped else skipped
        elif word == "endmodule":
            if module is None:
                raise BadGsd(f"line {number}: EndModule without Module")
            file.modules.append(module)
            module = None
        elif word == "module" and equals:
            if module is not None or len(file.modules) >= _MOST_MODULES:
                raise BadGsd(f"line {number}: a module in a module, or more than {_MOST_MODULES}")
            module = _module(number, value)
        elif word.partition("(")[0] in _BLOCKS:
            # Texts and parameters of modules say how people are asked for parameters.
            skipped = _BLOCKS[word.partition("(")[0]]
        elif equals and module is None:
            file.keywords[word] = _value(number, value)
        elif not equals and (module is None or not word.isdecimal()):
            raise BadGsd(f"line {number}: neither a keyword with a value nor a block")
    if module is not None or skipped is not None:
        raise BadGsd("a block has no end")
    return file


_BLOCKS = {
    "prmtext": "endprmtext",
    "extuserprmdata": "endextuserprmdata",
    "unit_diag_area": "unit_diag_area_end",
    "slotdefinition": "endslotdefinition",
    "unitdiagtype": "endunitdiagtype",
}
"""Blocks that are passed over, to their ends; the value behind the equals sign of their first line does not matter."""


def _lines(text: str) -> list[tuple[int, str]]:
    """Return the lines that say something, with their numbers: without comments, those that go on put together."""
    found: list[tuple[int, str]] = []
    goes_on = False
    for number, raw in enumerate(text.splitlines(), 1):
        line = _without_comment(raw).strip()
        continued, line = line.endswith("\\"), line.removesuffix("\\").strip()
        if goes_on and found:
            found[-1] = (found[-1][0], found[-1][1] + line)
        elif line:
            found.append((number, line))
        goes_on = continued
    return found


def _without_comment(line: str) -> str:
    quoted = False
    for index, character in enumerate(line):
        if character == '"':
            quoted = not quoted
        elif character == ";" and not quoted:
            return line[:index]
    return line


def _module(number: int, value: str) -> Module:
    match = re.fullmatch(r'"([^"]*)"\s*(.*)', value)
    numbers = _numbers(match[2]) if match else None
    if match is None or numbers is None or not all(0 <= one <= 255 for one in numbers):
        raise BadGsd(f"line {number}: a module has a name and bytes")
    return Module(match[1], bytes(numbers))


def _value(number: int, value: str) -> _Value:
    if value.startswith('"') and value.endswith('"') and len(value) > 1:
        return value[1:-1]
    numbers = _numbers(value)
    if numbers is None:
        return value
    if not numbers:
        raise BadGsd(f"line {number}: a keyword without a value")
    return numbers[0] if len(numbers) == 1 else numbers


def _numbers(text: str) -> list[int] | None:
    """Return numbers between commas, decimal or hexadecimal; None where there is something else."""
    parts = [part.strip() for part in text.split(",") if part.strip()]
    if not all(re.fullmatch(r"0x[0-9a-f]{1,8}|\d{1,10}", part, re.IGNORECASE) for part in parts):
        return None
    return [int(part, 16 if part.lower().startswith("0x") else 10) for part in parts]
