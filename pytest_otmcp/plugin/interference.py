"""Interference with the suite in this process: everything that narrowed or shadowed it, a sentence each.

=================================================  ============================================  =======================
case                                               evidence                                      method
=================================================  ============================================  =======================
an item claims to be a conformance item            its file is not of the shipped suite          ``check_selection``
only some suites, other deadlines, another device  options of the kit                            ``check_selection``
an item would run twice                            two items with the id of one task             ``check_selection``
items were not collected                           required items without a collected one        ``check_selection``
items were taken out by a filter or plugin         collected items that are not selected         ``check_selection``
items are skipped, xfailed or use other fixtures   markers of the items                          ``check_selection``
a fixture shadows the kit's                        a ``…otmcp…`` fixture from outside the kit  ``check_selection``
a fixture runs around items                        its file is of the repository                 ``check_selection``
a hook runs around items                           the file of its plugin is of the repository   ``check_selection``
items were removed or sorted after the kit's hook  planned items differ from those to be run     ``check_execution_plan``
the task of an item was not run                    the item ended without a result               ``add_unexecuted``
the outcome of an item was changed                 it does not fit the status                    ``check_outcome``
an item ran twice                                  a second result                               ``add_repeated``
=================================================  ============================================  =======================

``note`` takes sentences of other modules: changed files and functions of the kit (``integrity``), ``--maxfail``
(``hooks``), sentences of xdist workers.

A filter is mentioned when it took items away. Code that runs around the items, or replaces code of the kit, is always
mentioned. This module changes no result: results are the kit's own, also where pytest or a plugin reports another
outcome.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from ..core.matrix import BENCHMARK
from ..protocols.external import DEVICE, external_devices
from .collection import is_shipped, task_of
from .options import RunSettings

if TYPE_CHECKING:
    from ..trial.task import Task

__all__ = ["Interference", "expected_outcome", "join_ids"]

_KIT = Path(__file__).parents[1]
_PACKAGE = __package__.partition(".")[0]

_ITEM_HOOKS = (
    "pytest_runtest_protocol",
    "pytest_runtest_setup",
    "pytest_runtest_call",
    "pytest_runtest_makereport",
    "pytest_pyfunc_call",
    "pytest_fixture_setup",
)
"""Hooks by which a conftest can change what an item does, or what pytest reports of it."""

_ITEM_MARKS = ("skip", "skipif", "xfail", "usefixtures")

_FILTERS = {
    "keyword": ("-k",),
    "markexpr": ("-m",),
    "deselect": ("--deselect",),
    "lf": ("--last-failed", "--lf"),
    "stepwise": ("--stepwise", "--sw"),
}

_NOT_EXECUTED = "the kit did not execute these items, whatever pytest reports of them"
_MISREPORTED = "a conftest or plugin changed what pytest reports of items, not their results"
_REPEATED = "items ran more than once, the first time counts"

_OUTCOMES = {"PASS": "passed", "NOT_APPLICABLE": "skipped"}


def expected_outcome(status: str) -> str:
    """Return the outcome that pytest reports of an item of the suite without interference."""
    return _OUTCOMES.get(status, "failed")


def join_ids(identifiers: Collection[str], most: int = 6) -> str:
    """Join the first ids for a sentence."""
    shown = list(identifiers)
    return ", ".join(shown[:most]) + (f" and {len(shown) - most} more" if len(shown) > most else "")


class Interference:
    """Collector of the sentences of one process.

    Attributes:
        sentences: in the order in which they were noted, each once.
    """

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._collected: Counter[str] = Counter()
        self._gathered: defaultdict[str, list[str]] = defaultdict(list)
        self.sentences: list[str] = []

    def note(self, *sentences: str) -> None:
        """Add sentences, each once."""
        self.sentences += [sentence for sentence in dict.fromkeys(sentences) if sentence not in self.sentences]

    # -- collection ---------------------------------------------------------------------------------------

    def note_collected(self, items: Iterable[pytest.Item]) -> None:
        """Remember the collected items, before any filter or plugin changes them."""
        self._collected = Counter(task.id for item in items if (task := task_of(item)) and is_shipped(item.path))

    def check_selection(self, items: Iterable[pytest.Item], shipped: Collection[str], settings: RunSettings) -> None:
        """Compare the selected items with the collected ones and with the shipped suite, and look for code around them.

        Args:
            items: all items that are still selected.
            shipped: ids of all items that the run must have.
        """
        ours: list[tuple[Task, pytest.Item]] = []
        for item in items:
            if (task := task_of(item)) is None:
                continue
            if is_shipped(item.path):
                ours.append((task, item))
            else:
                self.note(f"{item.nodeid} is not of the shipped suite and is not counted")
        self.note(*_describe_settings(settings))
        selected = Counter(task.id for task, _ in ours)
        if several := [identifier for identifier, count in selected.items() if count > 1]:
            self.note(f"{join_ids(several)} would run more than once; the first time counts")
        if missing := [identifier for identifier in shipped if identifier not in self._collected]:
            self.note(f"{len(missing)} of {len(shipped)} items were not collected{self._explain_missing()}")
        if removed := [
            identifier for identifier in shipped if identifier in self._collected and identifier not in selected
        ]:
            self.note(f"{len(removed)} of {len(shipped)} items were taken out{self._explain_removed(removed)}")
        for _, item in ours:
            self._check_item(item)

    def check_execution_plan(self, planned: list[str], executed: list[str]) -> None:
        """Compare the ids of the items that will run with those that the kit has planned: no other plugin may have changed
        them since."""
        if gone := [identifier for identifier in planned if identifier not in executed]:
            self.note(f"items were taken out behind the kit's back: {join_ids(gone)}")
        elif planned != executed:
            self.note("the order of the items was changed behind the kit's back")

    def _explain_missing(self) -> str:
        if self._config.args_source is pytest.Config.ArgsSource.ARGS:
            return f": pytest was asked for {' '.join(map(str, self._config.args))}"
        return ""

    def _explain_removed(self, removed: list[str]) -> str:
        reasons = [f"by {words}" for words in self._describe_filters()]
        if not reasons:
            suspects = sorted(_find_own_plugins(self._config, self._config.hook.pytest_collection_modifyitems))
            reasons = ["by a plugin" if not suspects else f"by {' or '.join(suspects)}"]
        return f" {', '.join(reasons)}: {join_ids(removed)}"

    def _describe_filters(self) -> Iterator[str]:
        """Describe the active filters of pytest itself; an ini or an environment variable may have given them."""
        given = " ".join(map(str, self._config.invocation_params.args))
        for option, flags in _FILTERS.items():
            value = self._config.getoption(option, None)
            if not value:
                continue
            text = "" if value is True else value if isinstance(value, str) else " ".join(map(str, value))
            on_command_line = text in given if text else any(flag in given for flag in flags)
            yield f"{flags[0]} {text}".strip() + ("" if on_command_line else " (not from the command line)")

    def _check_item(self, item: pytest.Item) -> None:
        for mark in _ITEM_MARKS:
            if item.get_closest_marker(mark) is not None:
                self.note(f"items are marked {mark} by something outside the suite")
        info: Any = getattr(item, "_fixtureinfo", None)
        for name, definitions in (info.name2fixturedefs if info is not None else {}).items():
            function = definitions[-1].func
            file = getattr(getattr(function, "__code__", None), "co_filename", "")
            if function.__module__.startswith(f"{_PACKAGE}."):
                continue
            if name.lstrip("_").startswith("otmcp"):
                self.note(f"the fixture {name} of {self._locate(function)} shadows the kit's")
            elif _is_own(file, self._config.rootpath):
                self.note(f"the fixture {name} of {self._locate(function)} runs around the items")
        for hook in _ITEM_HOOKS:
            for file in _find_own_plugins(self._config, getattr(item.ihook, hook)):
                self.note(f"{file} has a hook around the items: {hook}")

    def _locate(self, function: object) -> str:
        """Return where a function is defined: file and line for one of the repository, else its module."""
        code, root = getattr(function, "__code__", None), self._config.rootpath
        if code is None or not Path(code.co_filename).is_relative_to(root):
            return str(function.__module__)
        return f"{_relative(Path(code.co_filename), root)}:{code.co_firstlineno}"

    # -- execution ----------------------------------------------------------------------------------------

    def add_unexecuted(self, item: pytest.Item) -> None:
        """Note an item of the suite that ended without its task having run."""
        self._gathered[_NOT_EXECUTED].append(item.name)

    def check_outcome(self, identifier: str, status: str, outcome: str) -> None:
        """Compare pytest's outcome of an item with the kit's status."""
        if outcome != expected_outcome(status):
            self._gathered[_MISREPORTED].append(f"{identifier} {outcome} for {status}")

    def add_repeated(self, identifier: str) -> None:
        """Note an item that has a second result."""
        self._gathered[_REPEATED].append(identifier)

    def finish(self) -> None:
        """Add the sentences on items that were gathered while they ran, with NOT_APPLICABLE items last."""
        for sentence, names in self._gathered.items():
            names.sort(key=lambda name: name.endswith("NOT_APPLICABLE"))
            self.note(f"{sentence}: {join_ids(dict.fromkeys(names))}")
        self._gathered.clear()


def _describe_settings(settings: RunSettings) -> Iterator[str]:
    if not {*BENCHMARK} <= {*settings.suites} and not settings.devices:
        asked = (
            f"suites {', '.join(settings.suites)} were"
            if len(settings.suites) > 1
            else f"suite {settings.suites[0]} was"
        )
        yield f"only the {asked} asked for (--otmcp-{'only' if settings.only else 'suite'})"
    if settings.time_scale != 1:
        yield f"deadlines and windows were multiplied by {settings.time_scale:g} (--otmcp-time-scale)"
    for protocol, url in settings.external.items():
        device = external_devices()[protocol]
        what = "a real one" if device.option == DEVICE else "which cannot be asked what it holds"
        yield f"the {device.noun} was {url}, {what} (--otmcp-{device.option})"


def _find_own_plugins(config: pytest.Config, hook: Any) -> Iterator[str]:
    """Find the files that implement a hook and are no installed plugins: conftests, and modules of the repository that were
    given with ``-p``."""
    for implementation in hook.get_hookimpls():
        file = getattr(implementation.plugin, "__file__", None)
        if file is not None and _is_own(file, config.rootpath):
            yield _relative(Path(file), config.rootpath)


def _is_own(file: str, root: Path) -> bool:
    """Tell whether a file is a conftest or of the repository that the suite runs in; installed files and the kit's are not.

    Installed plugins are part of the environment, as Python is; only their effects are noted.
    """
    path = Path(file)
    if path.name == "conftest.py":
        return True
    inside = path.is_relative_to(root) and not {"site-packages", "dist-packages"} & set(path.parts)
    return inside and not path.is_relative_to(_KIT)


def _relative(path: Path, root: Path) -> str:
    return str(path.relative_to(root)) if path.is_relative_to(root) else str(path)
