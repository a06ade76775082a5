"""Data types of a Logix controller: elementary ones, structures, and the templates that describe structures to a client.

Sources: Rockwell 1756-PM020, "Data types" and "Structure templates"; codes are those of CIP, volume 1, appendix C.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field
from typing import Any

__all__ = ["ELEMENTARY", "NO_NUMBERS", "RECIPE", "STRING", "Elementary", "Member", "Structure"]

NO_NUMBERS = {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}
"""What JSON has no numbers for, as journal, image and pokes say it."""
_TRUE = 0xFF
_STRUCTURE = 0x8000
_HANDLE_FOLLOWS = 0x02A0
"""Type code of a structure; its handle follows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Elementary:
    """A type of one value.

    Attributes:
        code: of CIP.
        form: of :mod:`struct`.
    """

    name: str
    code: int
    form: str

    @property
    def size(self) -> int:
        """Number of bytes."""
        return struct.calcsize(f"<{self.form}")

    @property
    def symbol_type(self) -> int:
        """The type as symbols and members of templates have it."""
        return self.code

    @property
    def head(self) -> bytes:
        """What stands before the values in a read's answer and in a write."""
        return struct.pack("<H", self.code)

    def decode(self, content: bytes) -> Any:
        """Return the value of these bytes, as JSON has it."""
        if self.name == "BOOL":
            return bool(content[0])
        (value,) = struct.unpack(f"<{self.form}", content)
        if isinstance(value, float) and not math.isfinite(value):
            return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
        return value

    def encode(self, value: Any) -> bytes:
        """Return the bytes of a value as JSON has it.

        Raises:
            ValueError: the type cannot hold it.
        """
        real = self.form in "fd"
        wanted = (bool,) if self.name == "BOOL" else (int, float) if real else (int,)
        if real and isinstance(value, str):
            value = NO_NUMBERS.get(value, value)
        if type(value) not in wanted:
            raise ValueError(f"a {self.name} cannot hold {value!r}")
        if self.name == "BOOL":
            return bytes([_TRUE if value else 0])
        try:
            return struct.pack(f"<{self.form}", value)
        except (struct.error, OverflowError):
            raise ValueError(f"a {self.name} cannot hold {value!r}") from None


ELEMENTARY = {
    name: Elementary(name=name, code=code, form=form)
    for name, code, form in (
        ("BOOL", 0xC1, "B"),
        ("SINT", 0xC2, "b"),
        ("INT", 0xC3, "h"),
        ("DINT", 0xC4, "i"),
        ("LINT", 0xC5, "q"),
        ("USINT", 0xC6, "B"),
        ("UINT", 0xC7, "H"),
        ("UDINT", 0xC8, "I"),
        ("ULINT", 0xC9, "Q"),
        ("REAL", 0xCA, "f"),
        ("LREAL", 0xCB, "d"),
    )
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Member:
    """A member of a structure.

    Attributes:
        offset: of its first byte.
        count: number of elements of an array, 0 for none.
        bit: number of the bit that a BOOL is; None for other types.
    """

    name: str
    kind: Elementary | Structure
    offset: int
    count: int = 0
    bit: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Structure:
    """A structure.

    Attributes:
        template: instance of its template object.
        handle: what stands for it in reads and writes.
        size: number of bytes.
        hidden: members that no client is to see by name; a BOOL member is a bit of one.
    """

    name: str
    template: int
    handle: int
    size: int
    members: tuple[Member, ...] = field(default=())
    hidden: tuple[Member, ...] = field(default=())

    @property
    def symbol_type(self) -> int:
        """The type as symbols and members of templates have it."""
        return _STRUCTURE | self.template

    @property
    def head(self) -> bytes:
        """What stands before the values in a read's answer and in a write."""
        return struct.pack("<HH", _HANDLE_FOLLOWS, self.handle)

    def member(self, name: str) -> Member | None:
        """Return the member of this name, in whichever case."""
        return next((one for one in self.members if one.name.lower() == name.lower()), None)

    def definition(self) -> bytes:
        """Return what a client reads of the template: type and place of each member, then the names."""
        every = sorted((*self.members, *self.hidden), key=lambda one: (one.offset, one.bit is not None))
        places = b"".join(
            struct.pack("<HHI", one.count if one.bit is None else one.bit, one.kind.symbol_type, one.offset)
            for one in every
        )
        # Behind the name, two letters tell the access rights of each member.
        names = [f"{self.name};n{'EA' * len(every)}", *(one.name for one in every)]
        return places + b"".join(name.encode("ascii") + b"\0" for name in names)

    def words(self) -> int:
        """Return the size of the definition, as the template's attribute 4 has it: 32-bit words, with 23 bytes on top."""
        return -(-(len(self.definition()) + 23) // 4)


STRING = Structure(
    name="ASCIISTRING82",
    template=0x0FCE,
    handle=0x0FCE,
    size=88,
    members=(
        Member(name="LEN", kind=ELEMENTARY["DINT"], offset=0),
        Member(name="DATA", kind=ELEMENTARY["SINT"], offset=4, count=82),
    ),
)
"""Logix's own STRING: a length and 82 characters."""

RECIPE = Structure(
    name="Recipe",
    template=0x0234,
    handle=0x5A21,
    size=100,
    members=(
        Member(name="Name", kind=STRING, offset=0),
        Member(name="Rate", kind=ELEMENTARY["REAL"], offset=88),
        Member(name="Count", kind=ELEMENTARY["DINT"], offset=92),
        Member(name="Enabled", kind=ELEMENTARY["BOOL"], offset=96, bit=0),
    ),
    hidden=(Member(name="ZZZZZZZZZZRecipe3", kind=ELEMENTARY["SINT"], offset=96),),
)
"""A structure of the plant's program, as engineers define them."""
