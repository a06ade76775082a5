"""The plan of a fleet: ``fleet.toml``, read and written down as one file for each row.

The name of a row's file is its *key*: a digest of the kit, of the suite, of the subject file with the files beside it, and of
how the adapter is installed. Whoever has the file can carry out the row; a row whose key is known has been carried out before.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shlex
import tomllib
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TypeVar

import msgspec

from .. import __version__
from ..core.errors import UsageError
from ..core.walls import MODES, REQUIRE
from ..suite.catalogue import kit_digest, suite_digest

__all__ = ["PLAN", "ROWS", "RUNS", "Kit", "Plan", "Planned", "Row", "planned", "read_plan", "read_row", "write_plan"]

PLAN, ROWS, RUNS = "plan.json", "rows", "runs"
"""What lies in the folder of a fleet: the plan, a file for each row, a folder for the run of each row."""

_T = TypeVar("_T")

_SCHEMA = "otmcp-plan/1"
_LARGEST = 1 << 20
"""Bytes of all files of a subject: a subject file, bindings and lists of packages have some kilobytes."""
_LEFT_OUT = ("node_modules", "reports", "__pycache__")
_OWN = (".python-version", ".npmrc")
"""Hidden files that say how an adapter is installed."""
_VERSION = re.compile(r"""(?m)^(\s*version\s*=\s*)("[^"\n]*"|'[^'\n]*')""")
_DIGEST = re.compile(r".+@sha256:[0-9a-f]{64}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Kit:
    """Which kit judges; a fleet is judged by one."""

    version: str
    digest: str
    suite_digest: str

    def __str__(self) -> str:
        return f"pytest-otmcp {self.version} ({self.digest.removeprefix('sha256:')[:12]})"

    @classmethod
    def installed(cls) -> Kit:
        """Return the one that is running."""
        return cls(version=__version__, digest=kit_digest(), suite_digest=suite_digest())


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """An adapter in one version, with all that is needed to judge it.

    Attributes:
        id: name of the adapter in the matrix.
        version: that is judged; the subject file of the row is given it.
        subject: name of the subject file among ``files``.
        files: content by name, below the folder of the subject file.
        install: commands that build the environment, in that folder, with the network.
        env: variables of these commands and of the run; ``{dir}`` is the folder.
        image: a container with the kit and the adapter, by digest, in place of ``install``.
        reps: repetitions.
        isolation: walls around the adapter, see ``docs/isolation.md``.
        limit_minutes: after these the row is ended.
        kit: that the row was planned for.
    """

    id: str
    version: str
    subject: str
    files: dict[str, str]
    install: list[str] = field(default_factory=list)
    env: dict[str, str] = field(default_factory=dict)
    image: str | None = None
    reps: int
    isolation: str
    limit_minutes: int
    kit: Kit

    @property
    def key(self) -> str:
        """The digest of the row: hexadecimal, 32 digits."""
        return hashlib.sha256(json.dumps(asdict(self), sort_keys=True).encode()).hexdigest()[:32]


@dataclass(frozen=True, slots=True, kw_only=True)
class Planned:
    """A row as the plan names it."""

    key: str
    id: str
    version: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """A plan as it was written.

    Attributes:
        rows: in the order of ``fleet.toml``; versions of one adapter from old to new.
    """

    schema: str
    name: str
    kit: Kit
    limit_minutes: int
    rows: list[Planned]


class _RowTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    id: str
    version: str
    subject: str
    install: list[str] = []
    env: dict[str, str] = {}
    image: str | None = None


class _Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    name: str
    row: list[_RowTable]
    reps: int = 30
    isolation: str = REQUIRE
    limit_minutes: int = 30


def planned(file: Path) -> tuple[str, Iterator[Row]]:
    """Return the name of a fleet and, one after the other, its rows.

    Args:
        file: the ``fleet.toml``; paths in it begin at its folder.

    Raises:
        UsageError: the file cannot be read, or says something that no fleet has; also while the rows are made.
    """
    table = _read(file)
    if table.isolation not in MODES:
        raise UsageError(f"{file}: isolation: expected one of {', '.join(MODES)}, found {table.isolation!r}")
    if table.reps < 1 or table.limit_minutes < 1 or not table.row:
        raise UsageError(f"{file}: a fleet has a row, a repetition and a minute at least")
    for (name, version), number in Counter((row.id, row.version) for row in table.row).items():
        if number > 1:
            raise UsageError(f"{file}: {name} {version} is planned {number} times")
    return table.name, _rows(file, table)


def _rows(file: Path, table: _Table) -> Iterator[Row]:
    kit = Kit.installed()
    known: dict[Path, dict[str, str]] = {}
    for one in table.row:
        what = f"{file}: {one.id} {one.version}"
        if one.image is not None and (one.install or one.env):
            raise UsageError(f"{what}: an image is installed already: leave out install and env")
        if one.image is not None and not _DIGEST.fullmatch(one.image):
            raise UsageError(
                f"{what}: image: expected NAME@sha256:DIGEST, which alone says what runs, found {one.image!r}"
            )
        _check_environment(one, what)
        subject = file.parent / one.subject
        if subject not in known:
            known[subject] = _files(subject, what)
        yield Row(
            id=one.id,
            version=one.version,
            subject=subject.name,
            files={**known[subject], subject.name: _versioned(known[subject][subject.name], one.version, what)},
            install=one.install,
            env=one.env,
            image=one.image,
            reps=table.reps,
            isolation=table.isolation,
            limit_minutes=table.limit_minutes,
            kit=kit,
        )


def _check_environment(row: _RowTable, what: str) -> None:
    """Raise UsageError for a command or a variable that no process can be started with."""
    for command in row.install:
        try:
            words = shlex.split(command)
        except ValueError as reason:
            raise UsageError(f"{what}: install: {command!r} cannot be split into words: {reason}") from None
        if not any(words[:1]) or "\0" in command + row.version:
            raise UsageError(f"{what}: install: expected a command, found {command!r}")
    for name, value in row.env.items():
        if not name or "=" in name or "\0" in name + value:
            raise UsageError(f"{what}: env: no variable can be {name!r} = {value!r}")


def _read(file: Path) -> _Table:
    try:
        return msgspec.convert(tomllib.loads(file.read_text(encoding="utf-8")), _Table)
    except (OSError, ValueError) as reason:
        raise UsageError(f"{file}: {getattr(reason, 'strerror', None) or reason}") from None


def _files(subject: Path, what: str) -> dict[str, str]:
    """Return the files in the folder of a subject file by their names; environments and what is hidden are left out."""
    found: dict[str, str] = {}
    left = _LARGEST
    for folder, folders, names in os.walk(subject.parent):
        folders[:] = sorted(name for name in folders if not name.startswith(".") and name not in _LEFT_OUT)
        for name in sorted(names):
            path = Path(folder, name)
            if (name.startswith(".") and name not in _OWN) or not path.is_file():
                continue
            left -= path.stat().st_size
            if left < 0:
                raise UsageError(f"{what}: the files beside {subject} are no subject's: give it a folder of its own")
            try:
                found[str(path.relative_to(subject.parent))] = path.read_text(encoding="utf-8")
            except UnicodeDecodeError:
                raise UsageError(f"{what}: {path} is no text: give the subject file a folder of its own") from None
    if subject.name not in found:
        raise UsageError(f"{what}: {subject}: there is no such file")
    return found


def _versioned(text: str, version: str, what: str) -> str:
    """Return a subject file that names this version, in which nothing else is different.

    A file that is no TOML is returned as it is: the row says what is wrong with it.
    """
    try:
        told = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return text
    if not isinstance(told.get("subject"), dict):
        return text
    wanted = {**told, "subject": {**told["subject"], "version": version}}
    for match in [None, *_VERSION.finditer(text)]:
        changed = text if match is None else f"{text[: match.start(2)]}{json.dumps(version)}{text[match.end(2) :]}"
        if tomllib.loads(changed) == wanted:
            return changed
    raise UsageError(
        f'{what}: [subject] of its subject file needs a line version = "…", in which the plan writes its own'
    )


def write_plan(file: Path, directory: Path) -> Plan:
    """Write the plan of a ``fleet.toml`` below a folder: a row at a time, and none again that is there.

    Raises:
        UsageError: that of :func:`planned`.
    """
    name, rows = planned(file)
    (directory / ROWS).mkdir(parents=True, exist_ok=True)
    listed, kit, limit = [], Kit.installed(), 0
    for row in rows:
        path = _place(directory, row.key)
        if not path.exists():
            _write(path, row)
        listed.append(Planned(key=row.key, id=row.id, version=row.version))
        limit = row.limit_minutes
    plan = Plan(schema=_SCHEMA, name=name, kit=kit, limit_minutes=limit, rows=listed)
    _write(directory / PLAN, plan)
    return plan


def read_plan(directory: Path) -> Plan:
    """Read the plan of a fleet.

    Raises:
        UsageError: there is none that this kit can read.
    """
    return _decoded(directory / PLAN, Plan)


def read_row(path: Path) -> Row:
    """Read a row of a plan.

    Raises:
        UsageError: it is none, it was changed, or it was planned for another kit.
    """
    row = _decoded(path, Row)
    if row.key != path.stem:
        raise UsageError(f"{path}: the row was changed after it was planned")
    if row.kit != Kit.installed():
        raise UsageError(f"{path}: planned for another kit than this pytest-otmcp {__version__}; plan the fleet again")
    return row


def _place(directory: Path, key: str) -> Path:
    return directory / ROWS / f"{key}.json"


def _decoded(path: Path, kind: type[_T]) -> _T:
    try:
        return msgspec.json.decode(path.read_bytes(), type=kind)
    except (OSError, ValueError, RecursionError) as reason:
        raise UsageError(f"{path}: {getattr(reason, 'strerror', None) or reason}") from None


def _write(path: Path, document: object) -> None:
    """Write a file that is there as a whole, or not at all."""
    new = path.with_name(path.name + ".new")
    new.write_bytes(msgspec.json.format(msgspec.json.encode(document), indent=1) + b"\n")
    new.replace(path)
