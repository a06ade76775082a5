"""What an adapter's own program imports: read in the files that its launch command names, never guessed.

A library that is installed beside the adapter is not a library that it uses, and a name in a message proves nothing. A file is
followed to the files of the adapter beside it, and a console script or ``-m`` to its package; no library's own files are read.
"""

from __future__ import annotations

import ast
import re
import shutil
import warnings
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

from ..core.library_registry import Library, libraries
from ..protocols.registry import protocols

__all__ = ["libraries_used"]

_NODE = {".js", ".mjs", ".cjs", ".ts", ".mts"}
_OF_NODE = re.compile(r"""(?:\bfrom|\bimport|\brequire\s*\()\s*\(?\s*["']([^"'\n]+)["']""")
_FILES = 200
_BYTES = 1_000_000


def libraries_used(command: Sequence[str], cwd: Path | None) -> dict[str, str]:
    """Return the known libraries that the adapter's own files import: name to the name of the first such file.

    Args:
        command: the launch command, with its placeholders replaced.
        cwd: the directory that it is started in; None is the kit's own.
    """
    known = [*libraries().values(), *(one for each in protocols().values() for one in libraries(each.package).values())]
    found: dict[str, str] = {}
    for file in _own_files(command, cwd or Path.cwd()):
        modules = {name for name in _imported(file) if not name.startswith(".")}
        for library in known:
            if not modules.isdisjoint(_names(library, file)):
                found.setdefault(library.name, file.name)
    return dict(sorted(found.items()))


def _names(library: Library, file: Path) -> Sequence[str]:
    return library.node if file.suffix in _NODE else library.python


def _own_files(command: Sequence[str], cwd: Path) -> Iterator[Path]:
    """Yield the files of the adapter's program, each once."""
    program = shutil.which(command[0], path=None) or str(cwd / command[0])
    installed = [*Path(program).parent.parent.glob("lib/python3*/site-packages")]
    waiting = [cwd / part for part in command if (cwd / part).suffix in {".py", *_NODE}]
    for place in (place for flag, place in pairwise(command) if flag == "-m"):
        waiting += _modules(place, [cwd, *installed])
    if not waiting and Path(program).suffix == "" and _text(Path(program)).startswith("#!"):
        # A console script imports the package that it starts.
        for name in _imported(Path(program)):
            waiting += _modules(name, installed)
    seen: set[Path] = set()
    while waiting and len(seen) < _FILES:
        file = waiting.pop(0)
        if file in seen or not file.is_file():
            continue
        seen.add(file)
        yield file
        waiting += _beside(file)


def _modules(name: str, places: Sequence[Path]) -> list[Path]:
    folders = [place.joinpath(*name.split(".")) for place in places]
    return [file for at in folders for file in (at.with_suffix(".py"), *sorted(at.rglob("*.py"))[:_FILES])]


def _beside(file: Path) -> list[Path]:
    if file.suffix in _NODE:
        relative = [file.parent / name for name in _imported(file) if name.startswith(".")]
        return [path.with_suffix(suffix) for path in relative for suffix in (path.suffix, ".ts", ".js") if suffix]
    return [] if file.parent.name == "site-packages" else [file.parent / f"{name}.py" for name in _imported(file)]


def _imported(file: Path) -> list[str]:
    """Return what a file imports: the first part of the names of Python modules, the whole names of those of Node.js."""
    source = _text(file)
    if file.suffix in _NODE:
        return _OF_NODE.findall(source)
    try:
        with warnings.catch_warnings(action="ignore"):
            tree = ast.parse(source)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return []
    names: list[str] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [each.name for each in node.names]
        elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
            names.append(node.module)
    return [name.split(".")[0] for name in names]


def _text(file: Path) -> str:
    try:
        if not file.is_file():
            return ""
        with file.open("rb") as stream:
            return stream.read(_BYTES).decode("utf-8", "replace")
    except OSError:
        return ""
