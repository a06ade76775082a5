"""The version of an adapter's product: that of the package which its launch command starts, as the package itself says, else the commit."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

from ..subject.imports import own_files, source_of

__all__ = ["product_version"]

_FOLDERS = 4
"""Folders above a program in which the file that describes its package, and its repository, may be."""

_COMMIT, _SHORT = re.compile(r"[0-9a-f]{40}(?:[0-9a-f]{24})?"), 7
"""A commit, and the digits by which Git names it in short."""


def product_version(command: Sequence[str], cwd: Path) -> tuple[str, str] | None:
    """Return the version of the package that a launch command starts, and what says so: the name of a file, or Git of a copy of a
    repository; None where nothing does.

    Args:
        command: the launch command, with its placeholders as they are.
        cwd: the directory that it is started in.
    """
    file = next(own_files(command, cwd), None)
    if file is None:
        return None
    return next(_installed(file) if "site-packages" in file.parts else chain(_described(file), _committed(file)), None)


def _installed(file: Path) -> Iterator[tuple[str, str]]:
    """Yield what the metadata of the installed package say that has brought a file."""
    depth = file.parts.index("site-packages") + 1
    packages, within = Path(*file.parts[:depth]), Path(*file.parts[depth:]).as_posix()
    for record in packages.glob("*.dist-info/RECORD"):
        if any(line.startswith(f"{within},") for line in source_of(record).splitlines()):
            told = source_of(record.parent / "METADATA").splitlines()
            yield from ((line.partition(": ")[2], record.parent.name) for line in told if line.startswith("Version: "))


def _described(file: Path) -> Iterator[tuple[str, str]]:
    """Yield what the nearest description of a package says, of Node.js or of Python."""
    for folder in file.resolve().parents[:_FOLDERS]:
        for name in ("package.json", "pyproject.toml"):
            version = _version(folder / name)
            if version is not None:
                yield version, name


def _committed(file: Path) -> Iterator[tuple[str, str]]:
    """Yield the commit of the repository that a file is in."""
    for git in (folder / ".git" for folder in file.resolve().parents[:_FOLDERS]):
        head = source_of(git / "HEAD").strip()
        branch = head.removeprefix("ref: ")
        packed = (line.partition(" ") for line in source_of(git / "packed-refs").splitlines())
        commits = (head, source_of(git / branch).strip(), *(commit for commit, _, name in packed if name == branch))
        yield from (
            (commit[:_SHORT], "the commit that its repository is at") for commit in commits if _COMMIT.fullmatch(commit)
        )


def _version(description: Path) -> str | None:
    source = source_of(description)
    try:
        told: Any = json.loads(source) if description.suffix == ".json" else tomllib.loads(source).get("project")
    except (ValueError, RecursionError):
        return None
    version = told.get("version") if isinstance(told, dict) else None
    return version if isinstance(version, str) and version else None
