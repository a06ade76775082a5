"""Where the shipped suite is, and how it is collected: whole, whatever the ini of the repository it runs in says.

Two things belong to the user and not to the ini: which of its items run (``-k``, ``--otmcp-suite`` …) and whether it
runs at all. File name patterns, name prefixes and directories not to be recursed into are about the user's own tests.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from ..core.errors import UsageError

if TYPE_CHECKING:
    from ..trial.task import Task

__all__ = [
    "SUITE",
    "ShippedModule",
    "is_shipped",
    "names_shipped",
    "names_suite",
    "quiet",
    "suite_by_default",
    "suite_root",
    "task_of",
]

_PACKAGE = __package__.partition(".")[0]
SUITE = f"{_PACKAGE}.conformance"


@cache
def suite_root() -> Path:
    """The directory of the shipped suite."""
    spec = find_spec(SUITE)
    assert spec is not None
    assert spec.submodule_search_locations is not None
    return Path(spec.submodule_search_locations[0]).resolve()


@cache
def _is_root(directory: Path) -> bool:
    return directory.resolve() == suite_root()


def is_shipped(path: Path) -> bool:
    """``path`` is a module of the shipped suite with tests, or its directory."""
    if path.suffix == ".py":
        return path.name.startswith("test_") and _is_root(path.parent)
    return _is_root(path)


def task_of(item: pytest.Item) -> Task | None:
    """The task of an item that is, or says that it is, a conformance item."""
    callspec = getattr(item, "callspec", None)
    task = callspec.params.get("task") if callspec is not None else None
    # The module is loaded by whatever has a task; in a run without conformance items it need not be.
    declaring = sys.modules.get(f"{_PACKAGE}.trial.task")
    return task if declaring is not None and isinstance(task, declaring.Task) else None


class ShippedModule(pytest.Module):
    """A module of the shipped suite: ``python_functions`` and ``python_classes`` do not apply to it."""

    def funcnamefilter(self, name: str) -> bool:
        return name.startswith("test_")

    def classnamefilter(self, name: str) -> bool:
        return False

    def collect(self) -> Iterable[pytest.Item | pytest.Collector]:
        from ..protocols.registry import protocols

        with quiet():
            try:
                protocols()
            except UsageError as error:
                pytest.exit(str(error), returncode=2)
            return list(super().collect())


@contextmanager
def quiet() -> Iterator[None]:
    """Warnings of the kit and of its libraries are not judged by the ``filterwarnings`` of the repository it runs in."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def names_suite(config: pytest.Config) -> bool:
    """The shipped suite is among what pytest was asked for, by name, by path or by default."""
    return any(
        argument == SUITE or argument.startswith((f"{SUITE}.", f"{SUITE}::")) or _is_root(_path(config, argument))
        for argument in map(str, config.args)
    )


def names_shipped(config: pytest.Config, identifier: str) -> bool:
    """The item of this node id is of the shipped suite.

    pytest writes the file relative to the root directory or, for a file outside of it, relative to what it was asked for.
    """
    file = identifier.partition("::")[0]
    places = [config.rootpath, *(_path(config, argument) for argument in map(str, config.args))]
    return any(is_shipped(place / file) for place in places)


def suite_by_default(config: pytest.Config) -> None:
    """Bare ``pytest --otmcp-…`` means the shipped suite.

    Somebody's own tests run when no option of the kit is on the command line, or when they are named.
    """
    if config.args_source is pytest.Config.ArgsSource.ARGS or names_suite(config):
        return
    if any(argument.startswith("--otmcp-") for argument in map(str, config.invocation_params.args)):
        config.args = [SUITE]
        config.option.pyargs = True


def _path(config: pytest.Config, argument: str) -> Path:
    return config.invocation_params.dir / argument.partition("::")[0]
