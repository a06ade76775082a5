"""The requirement catalogue (``requirements.toml`` beside the suite) as frozen data. Pure.

The file is read strictly: a key that is unknown, missing or of another type, a level, profile, protocol or document that does not
exist, and a place in a document that was not read, end in one sentence.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from importlib import resources
from typing import Any, Literal, cast

from ..core.capability import Capability
from ..protocols.registry import protocol_keys
from .package import SUITE

__all__ = ["Catalogue", "Document", "Level", "Profile", "Requirement", "catalogue", "cited", "read", "requirements"]

_FILE = "requirements.toml"
_ID = re.compile(r"[A-Z]{2,3}-[0-9]{3}")
_STRENGTHS = ("MUST", "SHOULD")
_READ = ("text", "titles")


class Level(StrEnum):
    """A level of conformance; each needs what is below it."""

    BRONZE = "bronze"
    SILVER = "silver"
    GOLD = "gold"

    @property
    def rank(self) -> int:
        """0 for the lowest level."""
        return list(Level).index(self)

    @property
    def meaning(self) -> str:
        """What an adapter of this level is good for, as the end of a sentence about it."""
        return _MEANINGS[self]


_MEANINGS = {
    Level.BRONZE: "may be connected to a plant for reading",
    Level.SILVER: "may write there while a person watches",
    Level.GOLD: "may write within a policy, audited, with a person's approval where the policy asks for it",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Profile:
    """A part of an adapter that rows are about.

    Attributes:
        level: the lowest level that looks at this part.
        meaning: the part in a few words.
        protocol: key of the protocol that it belongs to; None where every adapter has it.
    """

    id: str
    level: Level
    meaning: str
    protocol: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Document:
    """A document that rows name.

    Attributes:
        name: as rows name it.
        title: its whole title, with the edition.
        at: where it, or what was read of it, can be had.
        read: ``text`` where the authors of the rows had its text, ``titles`` where they had tables of its numbers and titles only;
            None where it is only named.
    """

    name: str
    title: str
    at: str
    read: Literal["text", "titles"] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Requirement:
    """One row of the catalogue.

    Attributes:
        id: as findings cite it, such as ``WR-003``.
        strength: ``MUST`` or ``SHOULD``; only a MUST that is not met turns an item red.
        level: the lowest level of conformance that needs the row.
        profiles: ids of the parts of an adapter that it is about.
        statement: what an adapter has to do.
        judged: what the kit looks at, in the answer and at the device.
        source: what the rule rests on: documents whose text was read, each with the place, between semicolons.
        related: other documents on the matter, by name alone unless their numbers and titles were read; empty for none.
        since: version of the kit that has the row.
        stricter: the kit asks for more than the source, which recommends it or gives the principle only.
        protocols: keys of the protocols that it is about, where its profiles do not say that; empty for those of the profiles.
        capabilities: what a plant must not rely on after a finding about the row, whichever item the finding was in.
        not_yet: why no check of the requirement suite judges it yet; None where one does.
        change: where the cause of a finding about it usually is; empty where the kind of finding says that.
    """

    id: str
    strength: Literal["MUST", "SHOULD"]
    level: Level
    profiles: tuple[str, ...]
    statement: str
    judged: str
    source: str
    since: str
    related: str = ""
    stricter: bool = False
    protocols: tuple[str, ...] = ()
    capabilities: tuple[Capability, ...] = ()
    not_yet: str | None = None
    change: str = ""

    @property
    def area(self) -> str:
        """The letters of its id, such as ``WR``."""
        return self.id.partition("-")[0]


@dataclass(frozen=True, slots=True, kw_only=True)
class Catalogue:
    """The whole catalogue, in the order of the file.

    Attributes:
        areas: the letters with which ids begin, to a heading.
        profiles: by id.
        documents: by the name that rows use.
        rows: by id.
    """

    areas: Mapping[str, str]
    profiles: Mapping[str, Profile]
    documents: Mapping[str, Document]
    rows: Mapping[str, Requirement]

    @property
    def version(self) -> str:
        """The version of the kit that has added the newest rows."""
        return max(
            (row.since for row in self.rows.values()), key=lambda since: [int(part) for part in since.split(".")]
        )

    def needs(self, level: Level, protocol: str) -> list[Requirement]:
        """Return the rows that an adapter for a protocol has to meet for a level, those of the levels below included.

        Args:
            level: the level that is asked for.
            protocol: key of the protocol.
        """
        return [
            row
            for row in self.rows.values()
            if row.level.rank <= level.rank
            and (not row.protocols or protocol in row.protocols)
            and any(
                self.profiles[name].level.rank <= level.rank and self.profiles[name].protocol in (None, protocol)
                for name in row.profiles
            )
        ]


def read(text: str) -> Catalogue:
    """Read a catalogue.

    Raises:
        ValueError: the text is no catalogue; one sentence.
    """
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{_FILE}: {error}") from None
    areas = _table(document, "areas")
    documents = {name: _document(name, table) for name, table in _table(document, "documents").items()}
    # Each question for the keys looks through all installed packages.
    keys = protocol_keys()
    profiles = {name: _profile(name, table, keys) for name, table in _table(document, "profiles").items()}
    rows = {name: _row(name, table, areas, profiles, documents, keys) for name, table in document.items()}
    return Catalogue(areas=areas, profiles=profiles, documents=documents, rows=rows)


def _document(name: str, table: object) -> Document:
    fields = _fields(table, name, {"title": str, "at": str}, {"read": str})
    _known([fields["read"]] if "read" in fields else [], _READ, name, "value of 'read'")
    return Document(name=name, title=fields["title"], at=fields["at"], read=fields.get("read"))


def _profile(name: str, table: object, protocols: Iterable[str]) -> Profile:
    fields = _fields(table, name, {"level": str, "meaning": str}, {"protocol": str})
    protocol = fields.get("protocol")
    if protocol is not None:
        _known((protocol,), protocols, name, "protocol")
    _known((fields["level"],), Level, name, "level")
    return Profile(id=name, level=Level(fields["level"]), meaning=fields["meaning"], protocol=protocol)


def _row(
    name: str,
    table: object,
    areas: Iterable[str],
    profiles: Iterable[str],
    documents: Mapping[str, Document],
    protocols: Iterable[str],
) -> Requirement:
    if _ID.fullmatch(name) is None:
        raise ValueError(f"{_FILE}: {name!r} is no id of a requirement")
    fields = _fields(
        table,
        name,
        {
            "strength": str,
            "level": str,
            "profiles": list,
            "statement": str,
            "judged": str,
            "source": str,
            "since": str,
        },
        {"stricter": bool, "related": str, "protocols": list, "capabilities": list, "not_yet": str, "change": str},
    )
    _known((name.partition("-")[0],), areas, name, "area")
    _known((fields["strength"],), _STRENGTHS, name, "strength")
    _known((fields["level"],), Level, name, "level")
    _known(fields["profiles"], profiles, name, "profile")
    _known(fields.get("protocols", ()), protocols, name, "protocol")
    _known(fields.get("capabilities", ()), Capability, name, "capability")
    if not fields["profiles"]:
        raise ValueError(f"{_FILE}: {name} has no profile")
    for entry in fields["source"].split("; "):
        if _named(entry, documents, f"{name}.source").read != "text":
            raise ValueError(f"{_FILE}: {name}.source rests on a text that was not read: {entry}")
    for entry in fields["related"].split("; ") if "related" in fields else ():
        if entry not in documents and _named(entry, documents, f"{name}.related").read != "titles":
            raise ValueError(f"{_FILE}: {name}.related names a place: {entry}")
    return Requirement(
        id=name,
        strength=cast(Literal["MUST", "SHOULD"], fields["strength"]),
        level=Level(fields["level"]),
        profiles=tuple(fields["profiles"]),
        statement=fields["statement"],
        judged=fields["judged"],
        source=fields["source"],
        since=fields["since"],
        related=fields.get("related", ""),
        stricter=fields.get("stricter", False),
        protocols=tuple(fields.get("protocols", ())),
        capabilities=tuple(map(Capability, fields.get("capabilities", ()))),
        not_yet=fields.get("not_yet"),
        change=fields.get("change", ""),
    )


def _named(entry: str, documents: Mapping[str, Document], where: str) -> Document:
    """Return the document whose name an entry of a row begins with."""
    for name, document in documents.items():
        if entry == name or entry.startswith(f"{name}, "):
            return document
    raise ValueError(f"{_FILE}: {where} begins with no name of a document: {entry}")


def _table(document: dict[str, Any], name: str) -> dict[str, Any]:
    found = document.pop(name, None)
    if not isinstance(found, dict):
        raise ValueError(f"{_FILE}: there is no table [{name}]")
    return found


def _fields(table: object, name: str, required: Mapping[str, type], optional: Mapping[str, type]) -> dict[str, Any]:
    """Return the keys of a row or profile, each of its type and none empty."""
    if not isinstance(table, dict):
        raise ValueError(f"{_FILE}: {name} is no table")
    known = {**required, **optional}
    for key, value in table.items():
        if key not in known:
            raise ValueError(f"{_FILE}: {name} has an unknown key {key!r}")
        if type(value) is not known[key] or value == "":
            raise ValueError(f"{_FILE}: {name}.{key} has to be of type {known[key].__name__} and not empty")
    for key in required:
        if key not in table:
            raise ValueError(f"{_FILE}: {name} has no {key!r}")
    return table


def _known(values: Iterable[object], known: Iterable[str], name: str, what: str) -> None:
    names = list(known)
    seen: list[object] = []
    for value in values:
        if value not in names:
            raise ValueError(f"{_FILE}: {name} has an unknown {what} {value!r}; there are {', '.join(names)}")
        if value in seen:
            raise ValueError(f"{_FILE}: {name} names the {what} {value!r} twice")
        seen.append(value)


@cache
def catalogue() -> Catalogue:
    """Return the catalogue of the shipped suite."""
    return read((resources.files(SUITE) / _FILE).read_text(encoding="utf-8"))


def requirements() -> Mapping[str, Requirement]:
    """Return its rows, id to row, in the order of the file."""
    return catalogue().rows


def cited(by: str, identifiers: Iterable[str]) -> None:
    """Check that whatever cites requirements cites rows of the catalogue.

    Args:
        by: what cites them, such as the id of a task.
        identifiers: what it cites.

    Raises:
        ValueError: the catalogue has no such row; one sentence.
    """
    for identifier in identifiers:
        if identifier not in requirements():
            raise ValueError(f"{by} cites {identifier!r}, which is no row of the requirement catalogue")
