"""Installation of the adapters of ``docs/examples``, each with the versions that its requirements files, or its package.json, name.

An environment is made once: later runs of the same Python find it by the digest of the requirements.
"""

from __future__ import annotations

import fcntl
import hashlib
import importlib.util
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

__all__ = ["EXAMPLES", "NAMES", "NotInstalled", "install", "requirement_files", "sources"]

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
NAMES = sorted(path.parent.name for path in EXAMPLES.glob("*/otmcp.toml"))

_INSTALL_TIMEOUT_S = 600.0
_SOURCE = re.compile(r"\{env:(\w+)\}")
"""What a subject file calls the directory of a copy of the source of an adapter that is on no index."""


class NotInstalled(Exception):
    """An adapter cannot be installed here; the message says why."""


def requirement_files(name: str) -> list[Path]:
    """Return the requirements files of an example: ``requirements-X.txt`` is that of the environment ``.venv-X``."""
    return sorted((EXAMPLES / name).glob("requirements*.txt"))


def sources(name: str) -> list[str]:
    """Return the environment variables that have to name directories with the source of an adapter."""
    return sorted({*_SOURCE.findall((EXAMPLES / name / "otmcp.toml").read_text(encoding="utf-8"))})


def _packages(name: str) -> list[Path]:
    return list((EXAMPLES / name).glob("package.json"))


def install(name: str, cache: Path) -> Path:
    """Install an example's adapter; return its subject file, in a directory of its own below ``cache``.

    Raises:
        NotInstalled: its packages, its Python or its source cannot be had.
    """
    for variable in sources(name):
        if not os.environ.get(variable):
            raise NotInstalled(f"{name}: {variable} does not say where its source is")
    version = _python_version(name)
    key = hashlib.sha256(version.encode())
    for file in (*requirement_files(name), *_packages(name)):
        key.update(file.name.encode() + b"\n" + file.read_bytes())
    home = cache / f"{name}-{key.hexdigest()[:12]}"
    home.mkdir(parents=True, exist_ok=True)
    with (home / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (home / "complete").exists():
            if os.environ.get("OTMCP_NO_NETWORK"):
                raise NotInstalled(f"{name} is not installed, and OTMCP_NO_NETWORK forbids to install it")
            for file in requirement_files(name):
                _install(name, _python(version), home / file.stem.replace("requirements", ".venv"), file)
            for file in _packages(name):
                shutil.copy(file, home)
                _run(name, ["npm", "install", "--silent", "--ignore-scripts", "--no-package-lock"], home)
            (home / "complete").touch()
        for variable in sources(name):
            # It runs from a copy: a record does not say where somebody keeps sources.
            shutil.copytree(os.environ[variable], home / variable, symlinks=True, dirs_exist_ok=True)
            os.environ[variable] = str(home / variable)
    for own in (EXAMPLES / name).iterdir():
        if own.is_file():
            shutil.copy(own, home)
    return home / "otmcp.toml"


def _python_version(name: str) -> str:
    """Return the version of Python that an adapter needs, as the tools that read ``.python-version`` do; else today's."""
    file = EXAMPLES / name / ".python-version"
    return file.read_text(encoding="utf-8").strip() if file.exists() else "{}.{}".format(*sys.version_info[:2])


def _python(version: str) -> str:
    """Return an interpreter of this version.

    Raises:
        NotInstalled: there is none.
    """
    if version == "{}.{}".format(*sys.version_info[:2]):
        return sys.executable
    for candidate in _interpreters(version):
        # A shim of a version manager is on the PATH whether or not it leads to an interpreter.
        if subprocess.run([candidate, "--version"], capture_output=True, check=False).returncode == 0:
            return candidate
    raise NotInstalled(f"there is no Python {version}")


def _interpreters(version: str) -> Iterator[str]:
    if found := shutil.which(f"python{version}"):
        yield found
    root = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    yield from map(str, sorted(root.glob(f"versions/{version}.*/bin/python")))


def _install(name: str, python: str, environment: Path, requirements: Path) -> None:
    shutil.rmtree(environment, ignore_errors=True)
    inside = str(environment / "bin" / "python")
    if importlib.util.find_spec("uv") is not None:
        uv = [sys.executable, "-m", "uv"]
        steps = [
            [*uv, "venv", "--quiet", "--python", python, str(environment)],
            [*uv, "pip", "install", "--quiet", "--python", inside, "-r", str(requirements)],
        ]
    else:
        steps = [
            [python, "-m", "venv", "--without-pip", str(environment)],
            [sys.executable, "-m", "pip", "--python", inside, "install", "--quiet", "-r", str(requirements)],
        ]
    for step in steps:
        _run(name, step, environment.parent)


def _run(name: str, step: list[str], directory: Path) -> None:
    try:
        done = subprocess.run(
            step, cwd=directory, capture_output=True, text=True, timeout=_INSTALL_TIMEOUT_S, check=False
        )
    except FileNotFoundError:
        raise NotInstalled(f"{name} cannot be installed here: there is no {step[0]}") from None
    except subprocess.TimeoutExpired:
        raise NotInstalled(f"{name} could not be installed within {_INSTALL_TIMEOUT_S:g} s") from None
    if done.returncode:
        reason = (done.stderr.strip() or done.stdout.strip() or "no reason given").splitlines()[-1]
        raise NotInstalled(f"{name} cannot be installed here: {reason}")
