"""Fixtures: a wheel built from this checkout with an environment in which nothing else of the checkout can be found, and a clone
that is installed as editable."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
from pathlib import Path

import pytest

from tests.once import once

CHECKOUT = Path(__file__).parents[2]
FOLDERS = {
    "pytest_otmcp": "pytest_otmcp",
    "conformance": "pytest_otmcp/conformance",
    "mocks": "pytest_otmcp/mocks",
    "reference_adapters": "pytest_otmcp/reference_adapters",
}
"""Folder of the checkout to folder of the wheel."""
SCHEMAS = ("pytest_otmcp/record/run.schema.json", "pytest_otmcp/subject/subject.schema.json")
"""Files of the wheel that the build makes."""
_CLUTTER = shutil.ignore_patterns(
    *(
        "__pycache__",
        "*.pyc",
        "*.egg-info",
        "node_modules",
        "pki",
        ".git",
        ".venv",
        ".*_cache",
        "build",
        "dist",
        "reports",
        # What the tests of walls have there for a while: a socket cannot be copied.
        "outside-*",
    ),
    *(Path(name).name for name in SCHEMAS),
)
"""What a clone does not have; its reports are not needed here."""

_BUILD = """
import sys
from setuptools import build_meta
print(getattr(build_meta, sys.argv[1])(sys.argv[2]))
"""


def _quietly(*command: str | Path, cwd: Path, env: dict[str, str] | None = None) -> str:
    done = subprocess.run(
        [str(part) for part in command], cwd=cwd, env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def _with_setuptools(directory: Path) -> dict[str, str]:
    """Return the environment of a process that finds the version of setuptools for which pyproject.toml asks."""
    tools = directory / "setuptools"
    _quietly(sys.executable, "-m", "pip", "install", "--quiet", "--target", tools, "setuptools>=77", cwd=directory)
    return {**os.environ, "PYTHONPATH": str(tools)}


def _build(directory: Path) -> str:
    """Build a wheel from a source distribution: a file that this lacks is missing in the wheel as well."""
    env = _with_setuptools(directory)
    source = directory / "source"
    for folder in FOLDERS:
        shutil.copytree(CHECKOUT / folder, source / folder, ignore=_CLUTTER)
    shutil.copytree(CHECKOUT / "docs", source / "docs", ignore=_CLUTTER)
    for file in ("pyproject.toml", "setup.py", "README.md", "LICENSE"):
        shutil.copy(CHECKOUT / file, source)
    told = _quietly(sys.executable, "-c", _BUILD, "build_sdist", directory, cwd=source, env=env)
    unpacked = directory / "unpacked"
    with tarfile.open(directory / told.splitlines()[-1]) as archive:
        archive.extractall(unpacked, filter="data")
    [source] = unpacked.iterdir()
    told = _quietly(sys.executable, "-c", _BUILD, "build_wheel", directory, cwd=source, env=env)
    return str(directory / told.splitlines()[-1])


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The path of the wheel."""
    return Path(once(tmp_path_factory, "wheel", _build))


def environment(factory: pytest.TempPathFactory, wheel: Path) -> Path:
    """Make a directory with nothing in it but a virtual environment ``.venv`` into which the wheel is installed.

    The wheel's dependencies are those of this environment, linked one by one: the checkout is not among them.
    """
    root = factory.mktemp("empty")
    python = _python(root, factory.mktemp("dependencies"))
    _quietly(sys.executable, "-m", "pip", "--python", python, "install", "--no-deps", "--no-index", wheel, cwd=root)
    return root


def _python(root: Path, linked: Path) -> Path:
    """Make ``.venv`` below the root, with the dependencies of this environment, and return its interpreter."""
    _quietly(sys.executable, "-m", "venv", "--without-pip", root / ".venv", cwd=root)
    python = root / ".venv" / "bin" / "python"
    ours = _quietly(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=root).strip()
    for entry in Path(sysconfig.get_path("purelib")).iterdir():
        if not entry.name.startswith(("pytest_otmcp", "__editable__", "__pycache__")):
            (linked / entry.name).symlink_to(entry)
    Path(ours, "dependencies.pth").write_text(f"{linked}\n")
    return python


def _clone(directory: Path) -> str:
    root = directory / "clone"
    shutil.copytree(CHECKOUT, root, ignore=_CLUTTER)
    linked = directory / "dependencies"
    linked.mkdir()
    python = _python(root, linked)
    pip = [
        sys.executable,
        "-m",
        "pip",
        "--python",
        python,
        "install",
        "--no-deps",
        "--no-index",
        "--no-build-isolation",
    ]
    _quietly(*pip, "-e", root, cwd=root, env=_with_setuptools(directory))
    return str(root)


@pytest.fixture(scope="session")
def clone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the checkout, with an environment ``.venv`` into which it is installed as editable."""
    return Path(once(tmp_path_factory, "clone", _clone))


@pytest.fixture(scope="session")
def empty(tmp_path_factory: pytest.TempPathFactory, wheel: Path) -> Path:
    """A directory with nothing in it but an environment with the wheel."""
    return environment(tmp_path_factory, wheel)
