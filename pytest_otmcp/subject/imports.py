"""What an adapter's own program imports: read in the files that its launch command names, never guessed.

A library that is installed beside the adapter is not a library that it uses, and a name in a message proves nothing. A file is
followed to the files of the adapter beside it, and a console script or ``-m`` to its package; no library's own files are read, and
nothing is executed.
"""

from __future__ import annotations

import ast
import os
import re
import shutil
import warnings
from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

from ..core.files import regular
from ..core.library_registry import Library, libraries
from ..protocols.registry import protocols

__all__ = ["libraries_used", "own_files", "source_of"]

_NODE = (".ts", ".mts", ".cts", ".js", ".mjs", ".cjs")
_OF_NODE = re.compile(
    r"""
    //[^\n]* | /\*(?:.*?\*/|.*)  # a comment; one without an end goes on to that of the file
    | (?<![\w$.])(?:from\s*|import\s*(?:\(\s*)?|require\s*\(\s*)(["'])(?P<name>[^"'\n]+)\1
    | "(?:\\.|[^"\\\n])*"? | '(?:\\.|[^'\\\n])*'? | `(?:\\.|[^`\\])*`?  # another text
    """,
    re.VERBOSE | re.DOTALL,
)
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
    for file in own_files(command, cwd or Path.cwd()):
        modules = {_module(name, file) for name in _imported(file)}
        for library in known:
            if not modules.isdisjoint(_names(library, file)):
                found.setdefault(library.name, file.name)
    return dict(sorted(found.items()))


def _module(name: str, file: Path) -> str:
    """Return the package of a module of Node.js, which has two parts where it has a scope; a name of Python as it is."""
    return "/".join(name.split("/")[: 1 + name.startswith("@")]) if file.suffix in _NODE else name


def _names(library: Library, file: Path) -> Sequence[str]:
    return library.node if file.suffix in _NODE else library.python


def own_files(command: Sequence[str], cwd: Path) -> Iterator[Path]:
    """Yield the files of the adapter's program, each once."""
    program = shutil.which(command[0], path=None) or str(cwd / command[0])
    installed = [*Path(program).parent.parent.glob("lib/python3*/site-packages")]
    waiting = [cwd / part for part in command if (cwd / part).suffix in (".py", *_NODE)]
    # npm links a package's program to a file of the package.
    waiting += [linked for linked in [Path(os.path.realpath(program))] if linked.suffix in _NODE]
    for place in (place for flag, place in pairwise(command) if flag == "-m"):
        waiting += _modules(place, [cwd, *installed])
    if not waiting and Path(program).suffix == "" and source_of(Path(program)).startswith("#!"):
        # A console script imports the package that it starts.
        for name in _imported(Path(program)):
            waiting += _modules(name, installed)
    seen: set[Path] = set()
    while waiting and len(seen) < _FILES:
        file = waiting.pop(0)
        if file in seen or not _is_file(file):
            continue
        seen.add(file)
        yield file
        waiting += _beside(file)


def _modules(name: str, places: Sequence[Path]) -> list[Path]:
    folders = [place.joinpath(*name.split(".")) for place in places]
    return [file for at in folders for file in (at.with_suffix(".py"), *sorted(at.rglob("*.py"))[:_FILES])]


def _beside(file: Path) -> list[Path]:
    names = _imported(file)
    if file.suffix in _NODE:
        relative = [name for name in names if name.startswith(".") and "node_modules" not in name.split("/")]
        return [path for name in relative for path in _of_node(Path(os.path.normpath(file.parent / name)))]
    return [] if file.parent.name == "site-packages" else [file.parent / f"{name}.py" for name in names]


def _of_node(path: Path) -> Iterator[Path]:
    """Yield the files that a path in an import may be about: without its suffix, of a folder, and the source of what tsc makes."""
    if path.suffix in _NODE:
        yield path
    yield from (Path(f"{path}{suffix}") for suffix in _NODE)
    yield from (path / f"index{suffix}" for suffix in _NODE)
    if path.suffix in (".js", ".mjs", ".cjs"):
        yield path.with_suffix(path.suffix.replace("js", "ts"))


def _imported(file: Path) -> Sequence[str]:
    """Return what a file imports: the first part of the names of Python modules, the whole names of those of Node.js."""
    try:
        status = file.stat()
    except OSError:
        return ()
    return _parsed(file, status.st_mtime_ns, status.st_size)


# Each session asks anew, and an installed package may have as many files as are read.
@lru_cache(maxsize=8 * _FILES)
def _parsed(file: Path, changed_ns: int, size: int) -> Sequence[str]:
    source = source_of(file)
    if file.suffix in _NODE:
        return [found["name"] for found in _OF_NODE.finditer(source) if found["name"]]
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


def _is_file(file: Path) -> bool:
    try:
        return file.is_file()
    except OSError:  # a name that is too long for one
        return False


def source_of(file: Path) -> str:
    """Return the text of a file of the adapter's program, the first million bytes of it; nothing where it cannot be read."""
    try:
        with open(file, "rb", opener=regular) as stream:
            return stream.read(_BYTES).decode("utf-8", "replace")
    except (OSError, ValueError):  # as of a name that no file can have
        return ""
