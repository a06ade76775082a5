"""Pytest hooks that leave the slow tests out of a run that does not ask for them, say how many there are, and divide a lane.

A test without a marker is fast: ``pytest tests`` runs it. A test marked ``long`` needs LaTeX, a browser, a foreign broker, packages
from an index, a built wheel, or 30 repetitions of the suite; ``-m long`` runs those. A test marked ``weekly`` is one of hundreds of
the same kind, of which another lane has a part; ``-m weekly`` runs those, whether or not they are long as well. Of the long tests of some
files each second, third or fourth is long, and the others are weekly: so the lane of each merge has a part of all. ``--shard=2/4`` runs the
second of four parts of what is selected.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

__all__ = [
    "pytest_addoption",
    "pytest_collection_modifyitems",
    "pytest_sessionfinish",
    "pytest_testnodedown",
    "say_what_was_left_out",
]

_HERE = Path(__file__).parent
_LANES = ("long", "weekly")

_ONE_IN = {
    "adapters_in_the_wild/test_init.py": 3,
    "console/test_journeys.py": 2,
    "plugin/test_certification.py": 2,
    "plugin/test_enemy_files.py": 2,
    "plugin/test_exhaustion.py": 2,
    "plugin/test_harmless.py": 3,
    "plugin/test_init.py": 2,
    "plugin/test_init_proofs.py": 2,
    "plugin/test_narrowing.py": 2,
    "plugin/test_requirement_suite.py": 2,
    "plugin/test_runs.py": 2,
    "plugin/test_walls.py": 2,
    "soundness/mutants/test_mutants.py": 3,
    "soundness/test_asked_of_every_server.py": 3,
    "soundness/test_commands.py": 3,
    "soundness/test_defects.py": 2,
    "soundness/test_first_do_no_harm.py": 3,
    "soundness/test_foreign.py": 3,
    "soundness/test_honest.py": 4,
    "soundness/test_hostile_adapters.py": 3,
    "soundness/test_hosts.py": 2,
    "soundness/test_real_devices.py": 2,
    "soundness/test_real_opcua.py": 3,
    "unit/test_one_answer.py": 2,
}
"""Files of ``tests`` whose long tests are of one kind, to the number of them of which one is in the long lane."""

_LEFT_OUT = pytest.StashKey[dict[str, int]]()
"""The number of tests of each lane that were left out of this run."""

_OF_WORKER = "left_out"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Declare the option for machines that share a lane."""
    parser.addoption("--shard", metavar="K/N", default="1/1", help="run the Kth of N parts of the selected tests")


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> Generator[None]:
    """Deselect the other lanes before, and the other shards after everything else has selected; put what takes longest first."""
    _thin_out(items)
    _keep(config, items, _of_lane(config, items))
    # Making a certificate takes minutes, and a lane is over when its last test is: what waits for one begins.
    items.sort(key=lambda item: "certified" not in getattr(item, "fixturenames", ()))
    yield
    part, _, parts = config.option.shard.partition("/")
    # One by one, because neighbours take about the same time.
    _keep(config, items, items[int(part) - 1 :: int(parts)])


def _thin_out(items: list[pytest.Item]) -> None:
    """Mark those long tests of a kind as weekly of which the long lane has a part."""
    seen: Counter[Path] = Counter()
    one_in = {_HERE / name: number for name, number in _ONE_IN.items()}
    for item in items:
        if item.path in one_in and item.get_closest_marker("long") and not item.get_closest_marker("weekly"):
            if seen[item.path] % one_in[item.path]:
                item.add_marker("weekly")
            seen[item.path] += 1


def _of_lane(config: pytest.Config, items: list[pytest.Item]) -> list[pytest.Item]:
    """Return all but the long tests, unless ``-m`` decides, and the weekly ones, unless ``-m`` names them."""
    asked = config.option.markexpr
    by_lane: dict[str, list[pytest.Item]] = {lane: [] for lane in _LANES}
    kept = []
    for item in items:
        if item.get_closest_marker("weekly") and "weekly" not in asked:
            by_lane["weekly"].append(item)
        elif item.get_closest_marker("long") and not asked:
            by_lane["long"].append(item)
        else:
            kept.append(item)
    config.stash[_LEFT_OUT] = {lane: len(tests) for lane, tests in by_lane.items()}
    return kept


def _keep(config: pytest.Config, items: list[pytest.Item], kept: list[pytest.Item]) -> None:
    """Deselect the items that are not kept."""
    chosen = {*kept}
    if left_out := [item for item in items if item not in chosen]:
        items[:] = kept
        config.hook.pytest_deselected(items=left_out)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Hand a worker's numbers to the controller, which collects nothing itself."""
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput[_OF_WORKER] = session.config.stash.get(_LEFT_OUT, {})


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Take the numbers from a worker; every worker collects all tests."""
    node.config.stash[_LEFT_OUT] = getattr(node, "workeroutput", {}).get(_OF_WORKER, {})


def say_what_was_left_out(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Say how many tests of each lane were left out, and how to run them."""
    for lane, number in config.stash.get(_LEFT_OUT, {}).items():
        if number:
            terminalreporter.write_line(f"{number} {lane} tests were left out; pytest -m {lane} runs them")
