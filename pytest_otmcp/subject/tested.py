"""What was tested, as far as the kit can know it: the program that a command starts, its own files, and what is installed beside it.

A command may start anything, on another machine too. What is found here is the state at the first start of the adapter; the list of
installed packages is that of their installer, whose digests are not compared with the files.
"""

from __future__ import annotations

import hashlib
import re
import shutil
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from ..core import files
from ..core.text import recorded_name
from ..record.schema import Tested
from .imports import own_files
from .model import READ_WRITE, Subject

__all__ = ["fingerprint", "programs"]

_CONTAINERS = ("docker", "podman", "nerdctl")
_IMAGE = re.compile(r"[\w./:-]+@sha256:[0-9a-f]{64}")
_LISTS_OF_NODE = ("node_modules/.package-lock.json", "package-lock.json")


def fingerprint(command: Sequence[str], cwd: Path | None) -> Tested:
    """Return what a command starts.

    Args:
        command: the launch command, with its placeholders replaced.
        cwd: the directory that it is started in; None is the kit's own.
    """
    here = cwd or Path.cwd()
    program = Path(shutil.which(command[0]) or here / command[0])
    own = sorted(own_files(command, here), key=str)
    packages = [(file.parent.name, _digest(file)) for file in _package_lists(program, own)]
    image = next((part for part in command if _IMAGE.fullmatch(part)), None) if program.name in _CONTAINERS else None
    return {
        "program": recorded_name(program.name),
        "program_sha256": _digest(program),
        "files": len(own),
        "files_sha256": _of_all([(file.name, _digest(file)) for file in own]) if own else None,
        "packages": len(packages),
        "packages_sha256": _of_all(packages) if packages else None,
        "image": image,
    }


def programs(subject: Subject) -> Iterator[Path]:
    """Yield the files that the commands of a subject name, where they are without placeholders of the device."""
    for adapter in subject.adapters.values():
        launch = adapter.variants[READ_WRITE]
        for part in launch.command:
            path = Path(part.replace("{python}", sys.executable).replace("{dir}", str(adapter.directory)))
            for place in ((launch.cwd or Path.cwd()) / path, *([Path(found)] if (found := shutil.which(path)) else [])):
                if place.is_file():
                    yield place


def _package_lists(program: Path, own: Sequence[Path]) -> list[Path]:
    """Return the lists of files of the Python distributions that are installed beside a program, or the lock of a Node.js package."""
    found = sorted(program.parent.parent.glob("lib/python3*/site-packages/*.dist-info/RECORD"))
    for folder in [] if found or not own else own[0].parents:
        found = [path for name in _LISTS_OF_NODE if (path := folder / name).is_file()][:1]
        if found:
            break
    return found


def _digest(path: Path) -> str | None:
    try:
        with open(path, "rb", opener=files.regular) as file:
            return f"sha256:{hashlib.file_digest(file, 'sha256').hexdigest()}"
    except (OSError, ValueError):
        return None


def _of_all(parts: Sequence[tuple[str, str | None]]) -> str:
    """Return the digest of a line for each part: its name, a blank, its digest."""
    lines = "".join(f"{name} {digest}\n" for name, digest in parts)
    return f"sha256:{hashlib.sha256(lines.encode('utf-8', 'replace')).hexdigest()}"
