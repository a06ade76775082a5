"""Files around a run that the kit, Python or the next pytest obeys: an adapter may change them meanwhile.

What judges has been imported when the first adapter starts. What comes later obeys them: a planted ``conftest.py`` runs in the process
of the next plain ``pytest``, a ``.pth`` file in every Python of this environment that is started. What is changed and changed back
is not seen.
"""

from __future__ import annotations

import site
import sysconfig
from collections.abc import Callable, Iterable, Iterator
from importlib import metadata
from pathlib import Path

from ..core import files

__all__ = ["Surroundings", "unknown_startup_files"]

_CONFIGURATION = (
    "conftest.py",
    "pytest.ini",
    ".pytest.ini",
    "pytest.toml",
    ".pytest.toml",
    "pyproject.toml",
    "tox.ini",
    "setup.cfg",
    "matplotlibrc",
)
_STARTUP = ("sitecustomize.py", "usercustomize.py")
"""Modules that Python imports at its start (documentation of the module ``site``)."""
_LARGEST_LIST = 1 << 20
"""Bytes of the largest .pth file that is read; a list of folders is shorter."""
_OF_VIRTUALENV = "_virtualenv.pth"
"""virtualenv and uv put it into each environment that they make, and no list of files has it."""


class Surroundings:
    """These files as they are at the start of a run.

    Args:
        described: the subject file, and the files that it names.
        folders: in which pytest looks for its configuration.
        judging: returns the digest of what judges, as it is on the disk.
    """

    def __init__(self, described: Iterable[Path], folders: Iterable[Path], judging: Callable[[], str]) -> None:
        self._described = tuple(described)
        self._folders = tuple(dict.fromkeys(folders))
        self._judging = judging
        self._before = self._look()

    def changes(self) -> list[str]:
        """Say in a sentence each what was changed since."""
        before, after = self._before, self._look()
        return [
            f"{name} was {_what(before.get(name), after.get(name))} during the run; look at it before anything else is run here"
            for name in sorted({**before, **after})
            if before.get(name) != after.get(name)
        ]

    def _look(self) -> dict[str, str]:
        found = {"the code of the kit": self._judging()}
        looked_at = {path.name: path for path in self._described}
        for folder in self._folders:
            shown = Path() if folder == self._folders[0] else Path(folder.name)
            looked_at |= {str(shown / name): folder / name for name in (*_CONFIGURATION, *_STARTUP)}
        for place in _site_folders():
            # A distribution may bring a plugin that pytest loads by itself.
            paths = [*_startup_files(place), *place.glob("*-info/entry_points.txt")]
            looked_at |= {f"{path.relative_to(place)} in {place.name}": path for path in paths}
        for name, path in looked_at.items():
            if (digest := _digest(path)) is not None:
                found[name] = digest
        return found


def unknown_startup_files() -> list[str]:
    """Return one sentence if the environment runs code at the start of Python that no installed distribution has brought."""
    places = [place for place in _site_folders() if place.is_dir()]
    suspects = [
        path for place in places for path in _startup_files(place) if path.name != _OF_VIRTUALENV and _executes(path)
    ]
    known = {
        Path(str(file.locate()))
        for distribution in (metadata.distributions(path=[str(place) for place in places]) if suspects else ())
        for file in distribution.files or ()
        if len(file.parts) == 1
    }
    unknown = [path.name for path in suspects if path not in known]
    return (
        [f"Python runs code at its start that belongs to no installed distribution: {', '.join(unknown)}"]
        if unknown
        else []
    )


def _what(before: str | None, after: str | None) -> str:
    if before is None:
        return "made"
    return "removed" if after is None else "changed"


def _site_folders() -> Iterator[Path]:
    """Return the folders of installed modules, the user's among them where it counts."""
    named = [sysconfig.get_path("purelib"), sysconfig.get_path("platlib")]
    if site.ENABLE_USER_SITE:
        named.append(site.getusersitepackages())
    return (Path(name) for name in dict.fromkeys(named))


def _startup_files(place: Path) -> list[Path]:
    return [*place.glob("*.pth"), *(path for name in _STARTUP if (path := place / name).exists())]


def _executes(path: Path) -> bool:
    """Tell whether a file has a line that is executed; the other lines of a .pth file are folders."""
    try:
        if path.suffix == ".py" or path.stat().st_size > _LARGEST_LIST:
            return True
        lines = files.read(path).splitlines()
    except OSError:
        return True
    return any(line.startswith((b"import ", b"import\t")) for line in lines)


def _digest(path: Path) -> str | None:
    """Return the digest of a file, a word for what is no regular file, None for what is not there."""
    try:
        return files.digest(path)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        return str(error.strerror)
