"""The documentation: the pages that people write, which lie in ``docs/``, and those that ``docs/built.toml`` names.

A built page is what its program prints, so it cannot differ from the declarations; an entry with a slash is a folder, whose program
prints all of its pages as one JSON object. A link to one leads to its entry in the index
(``README.md#items.md``), because a forge shows the folder without it; in a directory that is written here it leads to the page.
"""

from __future__ import annotations

import json
import posixpath
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

from ..core.errors import KitError, UsageError

__all__ = ["INDEX", "content", "copies", "titles", "write"]

INDEX = "README.md"
"""Name of the page that lists the others."""

_TABLE = "built.toml"
_COPIED = "first-adapter/"
"""The folder of adapters and subject files that beginners copy."""

_LEFT_BEHIND = ("__pycache__", "node_modules", "pki")
"""What Python, npm and an adapter leave in a folder of a checkout."""

_LINK = re.compile(r"!?\[((?:[^\[\]]|\[[^\[\]]*\])*)\]\(([^()\s]+)\)")

_MOST_S = 120.0
"""Time that a program has for its page, in seconds; on a busy machine the slowest takes ten."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Built:
    """A page that is built.

    Attributes:
        program: a module for ``python -m``, and its arguments.
        from_tests: whether the module belongs to the kit's own tests, which the wheel does not have.
    """

    title: str
    program: list[str]
    from_tests: bool = False


def titles() -> dict[str, str]:
    """Return the titles of all pages and schemas, by file name."""
    written = {name: content(name).decode().partition("\n")[0].lstrip("# ") for name in _files() if _is_page(name)}
    built = {name: one.title for name, one in _built().items() if not name.endswith("/")}
    return dict(sorted({**written, **built}.items()))


def copies() -> list[str]:
    """Return the paths of the files that a page tells to copy."""
    return [path for path in _files() if path.startswith(_COPIED)]


def content(path: str) -> bytes:
    """Return a file of the documentation, as it is stored or built.

    Args:
        path: from the folder of the documentation; of a folder that is built, with its slash, a JSON object of its pages.

    Raises:
        KeyError: there is no such file.
        KitError: the installation has no documentation, or a page cannot be built.
    """
    built = _built().get(path)
    return _files()[path].read_bytes() if built is None else _print(path, built)


def write(directory: Path) -> int:
    """Write the whole documentation into a directory, and return the number of files.

    A link to what is not written, such as a module of the checkout, becomes its text.

    Raises:
        UsageError: the directory has other files, or is the source of the documentation.
        KitError: the installation has no documentation, or a page cannot be built.
    """
    if not _may_be_written(directory):
        raise UsageError(f"{directory}: has other files; name a new or empty directory")
    asked = {*_files(), *_built()} - {_TABLE}
    with ThreadPoolExecutor() as pool:
        contents = dict(zip(asked, pool.map(content, asked), strict=True))
    for folder in [name for name in contents if name.endswith("/")]:
        pages: dict[str, str] = json.loads(contents.pop(folder))
        contents |= {f"{folder}{name}": text.encode() for name, text in pages.items()}
    names = {*contents}
    for name, data in contents.items():
        page = name.endswith(".md")
        file = directory / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(_linked(data.decode(), posixpath.dirname(name), names).encode() if page else data)
    return len(names)


def _may_be_written(directory: Path) -> bool:
    """Tell whether the directory is new or empty, or a copy that an earlier call has written."""
    if not directory.is_dir() or not any(directory.iterdir()):
        return not directory.is_file()
    copy = directory / INDEX
    return (
        copy.is_file()
        and not (directory / _TABLE).exists()
        and copy.read_bytes().partition(b"\n")[0] == content(INDEX).partition(b"\n")[0]
    )


def _linked(text: str, folder: str, names: set[str]) -> str:
    """Return a page whose links lead to files of these names, to an address, or within the page."""
    targets = {*names, *(parent for name in names for parent in _parents(name))}

    def link(match: re.Match[str]) -> str:
        shown, target = match.groups()
        path, _, anchor = target.partition("#")
        if not path or "://" in path:
            return match.group()
        if posixpath.basename(path) == INDEX and anchor in _built():
            return match.group().replace(target, posixpath.join(posixpath.dirname(path), anchor))
        return match.group() if posixpath.normpath(posixpath.join(folder, path)) in targets else shown

    # Every second part is a block of code, where brackets are no link.
    parts = re.split(r"(^```.*?^```)", text, flags=re.MULTILINE | re.DOTALL)
    return "".join(part if number % 2 else _LINK.sub(link, part) for number, part in enumerate(parts))


def _parents(path: str) -> Iterator[str]:
    while path := posixpath.dirname(path):
        yield path


def _print(name: str, built: _Built) -> bytes:
    checkout = _checkout()
    elsewhere = (
        f"# {built.title}\n\nThis page is built from the kit's own tests, which are in its repository and need the extra `dev`: "
        f"`otmcp docs {name.removesuffix('.md')}` prints it there.\n"
    ).encode()
    if built.from_tests and checkout is None:
        return elsewhere
    # Only the tests are looked for in the working directory: a user's may have a folder of any name.
    command = [sys.executable, *([] if built.from_tests else ["-P"]), "-m", *built.program]
    where = checkout if built.from_tests else None
    try:
        done = subprocess.run(
            command, cwd=where, stdin=subprocess.DEVNULL, capture_output=True, check=True, timeout=_MOST_S
        )
    except subprocess.TimeoutExpired:
        raise KitError(f"the page {name} was not built within {_MOST_S:g} s") from None
    except subprocess.CalledProcessError as error:
        if built.from_tests and b"\nModuleNotFoundError: " in error.stderr:
            return elsewhere
        raise KitError(f"the page {name} could not be built: {error.stderr.decode(errors='replace')[-400:]}") from None
    return done.stdout


@cache
def _built() -> Mapping[str, _Built]:
    table = tomllib.loads(_files()[_TABLE].read_text(encoding="utf-8"))
    return {name: _Built(**entry) for name, entry in table.items()}


@cache
def _files() -> Mapping[str, Traversable]:
    """Return the stored files by their path from the folder of the documentation.

    Raises:
        KitError: the installation has no documentation.
    """
    checkout = _checkout()
    found = dict(_below(_in_package() if checkout is None else checkout / "docs", ""))
    if _TABLE not in found:
        raise KitError("the installation has no documentation")
    return found


def _below(folder: Traversable, before: str) -> Iterator[tuple[str, Traversable]]:
    for entry in folder.iterdir() if folder.is_dir() else ():
        if entry.is_file():
            yield f"{before}{entry.name}", entry
        elif entry.name not in _LEFT_BEHIND:
            yield from _below(entry, f"{before}{entry.name}/")


def _in_package() -> Traversable:
    return files(__package__.partition(".")[0]) / "docs"


def _checkout() -> Path | None:
    """Return the checkout whose kit this is; None where it is a wheel's, which has the documentation in its package."""
    return None if _in_package().is_dir() else Path(__file__).parents[2]


def _is_page(path: str) -> bool:
    return path.endswith(".md") and "/" not in path and path not in _built()
