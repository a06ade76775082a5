"""Digests of packages, which identify the code and data that judged a run. Pure but for reading the files."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator
from importlib import resources
from importlib.resources.abc import Traversable

__all__ = ["files_digest"]

_KINDS = (".py", ".json", ".toml")


def files_digest(*packages: str, excluded: Collection[str] = ()) -> str:
    """Return ``sha256:…`` over the code and data files of packages, the same from a wheel and from a checkout.

    Args:
        excluded: dotted names of sub-packages and files that do not count.
    """
    digest = hashlib.sha256()
    for package in packages:
        for name, file in sorted(_files(package, resources.files(package), excluded)):
            digest.update(name.encode() + b"\0" + file.read_bytes() + b"\0")
    return "sha256:" + digest.hexdigest()


def _files(name: str, folder: Traversable, excluded: Collection[str]) -> Iterator[tuple[str, Traversable]]:
    for entry in folder.iterdir():
        if f"{name}/{entry.name}".replace("/", ".") in excluded:
            continue
        # What is no file, as a pipe that has taken its place, cannot be read.
        if entry.name.endswith(_KINDS) and entry.is_file():
            yield f"{name}/{entry.name}", entry
        elif entry.is_dir():
            yield from _files(f"{name}/{entry.name}", entry, excluded)
