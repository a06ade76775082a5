"""Place and collection of the shipped suite: it is always collected whole, and the ini of the repository does not apply to it.

The user decides on the command line, not in the ini, which items of the suite run (``-k``, ``--otmcp-suite`` …) and
whether it runs at all. File name patterns, name prefixes and directories not to be recursed into in an ini are about the
user's own tests.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from ..core.errors import UsageError
from ..core.matrix import BENCHMARK, FIELD, REQUIREMENTS

if TYPE_CHECKING:
    from ..trial.task import Task

__all__ = [
    "SUITE",
    "ShippedModule",
    "asks_for_suite",
    "default_to_suite",
    "ignore_warnings",
    "is_needed",
    "is_shipped",
    "is_shipped_id",
    "names_unasked_requirements",
    "suite_root",
    "task_of",
]

_PACKAGE = __package__.partition(".")[0]
SUITE = f"{_PACKAGE}.conformance"
_REQUIREMENTS_MODULE = f"test_{REQUIREMENTS}.py"


@cache
def suite_root() -> Path:
    """Return the directory of the shipped suite."""
    spec = find_spec(SUITE)
    assert spec is not None
    assert spec.submodule_search_locations is not None
    return Path(spec.submodule_search_locations[0]).resolve()


@cache
def _is_root(directory: Path) -> bool:
    return directory.resolve() == suite_root()


def is_shipped(path: Path) -> bool:
    """Tell whether ``path`` is a module with tests of the shipped suite, or the suite's directory."""
    if path.suffix == ".py":
        return path.name.startswith("test_") and _is_root(path.parent)
    return _is_root(path)


def task_of(item: pytest.Item | pytest.Collector) -> Task | None:
    """Return the task of an item that is a conformance item, or claims to be one; None for any other item."""
    callspec = getattr(item, "callspec", None)
    task = callspec.params.get("task") if callspec is not None else None
    # An item with a task has loaded this module; a run without conformance items need not load it.
    declaring = sys.modules.get(f"{_PACKAGE}.trial.task")
    return task if declaring is not None and isinstance(task, declaring.Task) else None


class ShippedModule(pytest.Module):
    """Module of the shipped suite; ``python_functions`` and ``python_classes`` do not apply to it.

    Args:
        required: returns the ids of the tasks that the run must have.
    """

    def __init__(self, *, required: Callable[[], Collection[str]], **arguments: Any) -> None:
        super().__init__(**arguments)
        self.required = required

    def funcnamefilter(self, name: str) -> bool:
        return name.startswith("test_")

    def classnamefilter(self, name: str) -> bool:
        return False

    def collect(self) -> Iterable[pytest.Item | pytest.Collector]:
        from ..protocols.registry import protocols

        with ignore_warnings():
            try:
                protocols()
            except UsageError as error:
                pytest.exit(str(error), returncode=2)
            found = list(super().collect())
            required = self.required()
        # Items on a protocol that the run is not about are not collected: pytest counts what is.
        return [one for one in found if (task := task_of(one)) is None or task.id in required]


def is_needed(path: Path, suites: Collection[str]) -> bool:
    """Tell whether a run that has asked for these suites needs a shipped file: the benchmark's modules belong together.

    What is not needed is not collected, so that pytest counts the items that the run is about.
    """
    if path.suffix != ".py":
        return True
    about = {REQUIREMENTS: {REQUIREMENTS}, FIELD: {FIELD}}.get(path.stem.removeprefix("test_"), {*BENCHMARK})
    return not about.isdisjoint(suites)


def names_unasked_requirements(config: pytest.Config, suites: Collection[str]) -> str | None:
    """Return the argument that names the requirement suite in a run that has not asked for it."""
    if REQUIREMENTS in suites:
        return None
    named = (str(argument) for argument in config.args)
    file, module = suite_root() / _REQUIREMENTS_MODULE, f"{SUITE}.{_REQUIREMENTS_MODULE.removesuffix('.py')}"
    return next((name for name in named if _path(config, name) == file or name.partition("::")[0] == module), None)


@contextmanager
def ignore_warnings() -> Iterator[None]:
    """Ignore warnings of the kit and of its libraries: the ``filterwarnings`` of the repository are not meant for them."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def asks_for_suite(config: pytest.Config) -> bool:
    """Tell whether pytest was asked for the shipped suite, by name, by path or by default."""
    return any(
        argument == SUITE or argument.startswith((f"{SUITE}.", f"{SUITE}::")) or _is_root(_path(config, argument))
        for argument in map(str, config.args)
    )


def is_shipped_id(config: pytest.Config, identifier: str) -> bool:
    """Tell whether the item with this node id is of the shipped suite.

    pytest writes the file relative to the root directory or, for a file outside of it, relative to one of its arguments.
    """
    file = identifier.partition("::")[0]
    places = [config.rootpath, *(_path(config, argument) for argument in map(str, config.args))]
    if SUITE in config.args:
        places.append(suite_root())
    return any(is_shipped(place / file) for place in places)


def default_to_suite(config: pytest.Config) -> None:
    """Run the shipped suite for a bare ``pytest --otmcp-…``.

    The user's own tests run when no option of the kit is on the command line, or when they are named.
    """
    if config.args_source is pytest.Config.ArgsSource.ARGS or asks_for_suite(config):
        return
    if any(argument.startswith("--otmcp-") for argument in map(str, config.invocation_params.args)):
        config.args = [SUITE]
        config.option.pyargs = True


def _path(config: pytest.Config, argument: str) -> Path:
    return config.invocation_params.dir / argument.partition("::")[0]
