"""Fixtures: a wheel built from this checkout, and an environment in which nothing else of the checkout can be found."""

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


def _build(directory: Path) -> str:
    """Build a wheel from a source distribution: a file that this lacks is missing in the wheel as well."""
    # pyproject.toml asks for this version.
    tools = directory / "setuptools"
    _quietly(sys.executable, "-m", "pip", "install", "--quiet", "--target", tools, "setuptools>=77", cwd=directory)
    env = {**os.environ, "PYTHONPATH": str(tools)}
    source = directory / "source"
    built = [Path(name).name for name in SCHEMAS]
    clutter = shutil.ignore_patterns("__pycache__", "*.pyc", "*.egg-info", "node_modules", "pki", *built)
    for folder in FOLDERS:
        shutil.copytree(CHECKOUT / folder, source / folder, ignore=clutter)
    shutil.copytree(CHECKOUT / "docs", source / "docs", ignore=clutter)
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
    _quietly(sys.executable, "-m", "venv", "--without-pip", root / ".venv", cwd=root)
    python = root / ".venv" / "bin" / "python"
    _quietly(sys.executable, "-m", "pip", "--python", python, "install", "--no-deps", "--no-index", wheel, cwd=root)
    ours = _quietly(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=root).strip()
    linked = factory.mktemp("dependencies")
    for entry in Path(sysconfig.get_path("purelib")).iterdir():
        if not entry.name.startswith(("pytest_otmcp", "__editable__", "__pycache__")):
            (linked / entry.name).symlink_to(entry)
    Path(ours, "dependencies.pth").write_text(f"{linked}\n")
    return root


@pytest.fixture(scope="session")
def empty(tmp_path_factory: pytest.TempPathFactory, wheel: Path) -> Path:
    """A directory with nothing in it but an environment with the wheel."""
    return environment(tmp_path_factory, wheel)
