"""What narrowed or shadowed the suite in this process, a sentence each.

The rule: a filter is mentioned when it took something away; whatever runs around the items, or stands in the place of
something of the kit's, is mentioned for being there. Nothing here changes a result; results are the kit's own, whatever
pytest or a plugin makes of them.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from ..core.matrix import SUITES
from ..protocols.external import external_devices
from .collection import is_shipped, task_of
from .options import RunSettings

if TYPE_CHECKING:
    from ..trial.task import Task

__all__ = ["Interference", "named", "outcome_for"]

_KIT = Path(__file__).parents[1]
_PACKAGE = __package__.partition(".")[0]

_AROUND = (
    "pytest_runtest_protocol",
    "pytest_runtest_setup",
    "pytest_runtest_call",
    "pytest_runtest_makereport",
    "pytest_pyfunc_call",
    "pytest_fixture_setup",
)
"""Hooks by which a conftest can change what an item does, or what becomes of it."""

_MARKS = ("skip", "skipif", "xfail", "usefixtures")

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


def outcome_for(status: str) -> str:
    """What pytest reports of an item of the suite when nobody interferes."""
    return _OUTCOMES.get(status, "failed")


def named(identifiers: Collection[str], most: int = 6) -> str:
    """Some ids for a sentence."""
    shown = list(identifiers)
    return ", ".join(shown[:most]) + (f" and {len(shown) - most} more" if len(shown) > most else "")


class Interference:
    """Collects the sentences of one process."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._collected: Counter[str] = Counter()
        self._gathered: defaultdict[str, list[str]] = defaultdict(list)
        self.sentences: list[str] = []

    def note(self, *sentences: str) -> None:
        """Add sentences, each once."""
        self.sentences += [sentence for sentence in dict.fromkeys(sentences) if sentence not in self.sentences]

    # -- collection ---------------------------------------------------------------------------------------

    def before(self, items: Iterable[pytest.Item]) -> None:
        """Note what was collected, before anything filters or sorts it."""
        self._collected = Counter(task.id for item in items if (task := task_of(item)) and is_shipped(item.path))

    def after(self, items: Iterable[pytest.Item], shipped: Collection[str], settings: RunSettings) -> None:
        """Compare what is left with what was collected, and with the shipped suite."""
        ours: list[tuple[Task, pytest.Item]] = []
        for item in items:
            if (task := task_of(item)) is None:
                continue
            if is_shipped(item.path):
                ours.append((task, item))
            else:
                self.note(f"{item.nodeid} is not of the shipped suite and is not counted")
        self.note(*_wishes(settings))
        left = Counter(task.id for task, _ in ours)
        if several := [identifier for identifier, count in left.items() if count > 1]:
            self.note(f"{named(several)} would run more than once; the first time counts")
        if missing := [identifier for identifier in shipped if identifier not in self._collected]:
            self.note(f"{len(missing)} of {len(shipped)} items were not collected{self._why_not_collected()}")
        if removed := [
            identifier for identifier in shipped if identifier in self._collected and identifier not in left
        ]:
            self.note(f"{len(removed)} of {len(shipped)} items were taken out{self._why_removed(removed)}")
        for _, item in ours:
            self._look_at(item)

    def final(self, planned: list[str], executed: list[str]) -> None:
        """Compare what will run with what the kit has left to run: nobody else may have had the last word."""
        if gone := [identifier for identifier in planned if identifier not in executed]:
            self.note(f"items were taken out behind the kit's back: {named(gone)}")
        elif planned != executed:
            self.note("the order of the items was changed behind the kit's back")

    def _why_not_collected(self) -> str:
        if self._config.args_source is pytest.Config.ArgsSource.ARGS:
            return f": pytest was asked for {' '.join(map(str, self._config.args))}"
        return ""

    def _why_removed(self, removed: list[str]) -> str:
        reasons = [f"by {words}" for words in self._filters()]
        if not reasons:
            suspects = sorted(_own_plugins(self._config, self._config.hook.pytest_collection_modifyitems))
            reasons = ["by a plugin" if not suspects else f"by {' or '.join(suspects)}"]
        return f" {', '.join(reasons)}: {named(removed)}"

    def _filters(self) -> Iterator[str]:
        """The filters of pytest's own that are on; an ini or an environment variable may have given them."""
        given = " ".join(map(str, self._config.invocation_params.args))
        for option, flags in _FILTERS.items():
            value = self._config.getoption(option, None)
            if not value:
                continue
            text = "" if value is True else value if isinstance(value, str) else " ".join(map(str, value))
            asked = text in given if text else any(flag in given for flag in flags)
            yield f"{flags[0]} {text}".strip() + ("" if asked else " (not from the command line)")

    def _look_at(self, item: pytest.Item) -> None:
        for mark in _MARKS:
            if item.get_closest_marker(mark) is not None:
                self.note(f"items are marked {mark} by something outside the suite")
        info: Any = getattr(item, "_fixtureinfo", None)
        for name, definitions in (info.name2fixturedefs if info is not None else {}).items():
            function = definitions[-1].func
            file = getattr(getattr(function, "__code__", None), "co_filename", "")
            if function.__module__.startswith(f"{_PACKAGE}."):
                continue
            if name.startswith("otmcp"):
                self.note(f"the fixture {name} of {self._place(function)} shadows the kit's")
            elif _own(file, self._config.rootpath):
                self.note(f"the fixture {name} of {self._place(function)} runs around the items")
        for hook in _AROUND:
            for who in _own_plugins(self._config, getattr(item.ihook, hook)):
                self.note(f"{who} has a hook around the items: {hook}")

    def _place(self, function: Any) -> str:
        """Where a function is defined: file and line if it is the repository's, else its module."""
        code, root = getattr(function, "__code__", None), self._config.rootpath
        if code is None or not Path(code.co_filename).is_relative_to(root):
            return str(function.__module__)
        return f"{_relative(Path(code.co_filename), root)}:{code.co_firstlineno}"

    # -- execution ----------------------------------------------------------------------------------------

    def not_executed(self, item: pytest.Item) -> None:
        """An item of the suite is over and its task was not run."""
        self._gathered[_NOT_EXECUTED].append(item.name)

    def reported(self, identifier: str, status: str, outcome: str) -> None:
        """Compare pytest's outcome of an item with the kit's result."""
        if outcome != outcome_for(status):
            self._gathered[_MISREPORTED].append(f"{identifier} {outcome} for {status}")

    def repeated(self, identifier: str) -> None:
        """An item has come to a second result."""
        self._gathered[_REPEATED].append(identifier)

    def finish(self) -> None:
        """Add what was gathered while the items ran."""
        # What does not apply to the subject is the least news among them.
        for sentence, names in self._gathered.items():
            names.sort(key=lambda name: name.endswith("NOT_APPLICABLE"))
            self.note(f"{sentence}: {named(dict.fromkeys(names))}")
        self._gathered.clear()


def _wishes(settings: RunSettings) -> Iterator[str]:
    if settings.suites != SUITES:
        yield f"only the suites {', '.join(settings.suites)} were asked for (--otmcp-suite)"
    if settings.time_scale != 1:
        yield f"deadlines and windows were multiplied by {settings.time_scale:g} (--otmcp-time-scale)"
    for protocol, url in settings.external.items():
        device = external_devices()[protocol]
        yield f"the {device.noun} was {url}, which cannot be asked what it holds (--otmcp-{device.option})"


def _own_plugins(config: pytest.Config, hook: Any) -> Iterator[str]:
    """Who implements a hook and is no installed plugin: conftests, and modules of the repository given with ``-p``."""
    for implementation in hook.get_hookimpls():
        file = getattr(implementation.plugin, "__file__", None)
        if file is not None and _own(file, config.rootpath):
            yield _relative(Path(file), config.rootpath)


def _own(file: str, root: Path) -> bool:
    """A file of the repository that the suite runs in, or a conftest: nothing that is installed, and not the kit's.

    What installed plugins do is noticed by its effects; they are part of the environment, as Python is.
    """
    path = Path(file)
    if path.name == "conftest.py":
        return True
    inside = path.is_relative_to(root) and not {"site-packages", "dist-packages"} & set(path.parts)
    return inside and not path.is_relative_to(_KIT)


def _relative(path: Path, root: Path) -> str:
    return str(path.relative_to(root)) if path.is_relative_to(root) else str(path)
