"""The registry of libraries that adapters are made with (``libraries.toml``, here and in each protocol's package) as frozen data. Pure.

A hint is about rules that the library does not keep by itself, and about the change that keeps them. The page ``by-library`` of the
documentation explains each, under the library's name.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources

__all__ = ["Hint", "Library", "libraries"]

_FILE = "libraries.toml"


@dataclass(frozen=True, slots=True, kw_only=True)
class Hint:
    """One thing to change.

    Attributes:
        requirements: ids of the rules that are not kept without the change.
        change: what to change, and why, in one sentence.
        codes: of the findings that the change answers; empty where it answers all that cite the rules.
    """

    requirements: tuple[str, ...]
    change: str
    codes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Library:
    """One library.

    Attributes:
        name: as its package index has it.
        python: the modules by whose import it is seen in a Python program.
        node: the modules by whose import it is seen in a program for Node.js.
    """

    name: str
    python: tuple[str, ...]
    node: tuple[str, ...]
    hints: tuple[Hint, ...]

    @property
    def anchor(self) -> str:
        """The place in the page: the name in small letters, a scope of npm without its marks."""
        return self.name.lower().removeprefix("@").replace("/", "-")


@cache
def libraries(package: str = __package__) -> Mapping[str, Library]:
    """Return the libraries that a package declares, by name; none where it declares none.

    Args:
        package: that of a protocol; without it the libraries that adapters of any protocol use.
    """
    file = resources.files(package) / _FILE
    if not file.is_file():
        return {}
    return {
        name: Library(
            name=name,
            python=tuple(entry.get("python", ())),
            node=tuple(entry.get("node", ())),
            hints=tuple(
                Hint(
                    requirements=tuple(hint["requirements"]),
                    change=hint["change"],
                    codes=tuple(hint.get("codes", ())),
                )
                for hint in entry["hints"]
            ),
        )
        for name, entry in tomllib.loads(file.read_text(encoding="utf-8")).items()
    }
