"""What a JUnit file says of the run as a whole."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import pytest
from _pytest.junitxml import LogXML, xml_key

from ..core.text import one_line
from .collection import is_shipped_id

if TYPE_CHECKING:
    from .controller import RunRecorder

__all__ = ["JUnitFile", "tell_junit"]


_CLASSES = "pytest_otmcp.conformance."


class JUnitFile:
    """A plugin that has a run which the kit refuses, or which was interrupted, in the JUnit file as an error: a file without failures looks
    like one of a run in which nothing failed. The classes of the suite's own items have the same name wherever the kit is installed."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Name the item's class by the suite's module. pytest names it by the file, such as
        ``.venv.lib.python3.11.site-packages.pytest_otmcp.conformance.test_normal``, so that dashboards lose its history when the
        environment moves; a name that is there already stays."""
        file = self._config.stash.get(xml_key, None)
        if file is not None and is_shipped_id(self._config, report.nodeid):
            module = PurePath(report.nodeid.partition("::")[0]).stem
            named = ".".join(filter(None, (file.prefix, f"{_CLASSES}{module}")))
            file.node_reporter(report).attrs.setdefault("classname", named)

    def pytest_keyboard_interrupt(self, excinfo: pytest.ExceptionInfo[BaseException]) -> None:
        """Take the sentence with which the run ends, as pytest's own file takes an internal error."""
        file = self._config.stash.get(xml_key, None)
        if file is None:
            return
        sentence = excinfo.value.msg if isinstance(excinfo.value, pytest.exit.Exception) else "interrupted"
        _add_error(file, sentence)


def tell_junit(config: pytest.Config, recorder: RunRecorder) -> None:
    """Give a JUnit file the verdict, the levels and the counts."""
    file = config.stash.get(xml_key, None)
    if file is None:
        return
    if not recorder.statuses:
        _add_error(file, f"{recorder.verdict}: no item of the suite ran")
        return
    from ..record.condensed import condensed
    from ..record.reader import open_record
    from ..report.limits import narrowed
    from ..report.overview import deviations
    from ..report.verdict_file import properties

    with open_record(recorder.path, allow_incomplete=True) as stored:
        run = condensed(stored)
    for name, value in properties(run).items():
        file.add_global_property(name, value)
    _excuse(file, run)
    if recorder.exit_code and not file.stats["failure"]:
        outdated = [
            f"known deviation {one.item}: {one.state}." for one in deviations(run) if one.kind in ("stale", "expired")
        ]
        _add_error(file, f"{recorder.verdict}: {' '.join([*outdated, *narrowed(run)])}")


def _add_error(file: LogXML, sentence: str) -> None:
    """Have the run as a whole as an error, unless it is one already."""
    if any(str(key[0]) == "otmcp" for key in file.node_reporters):
        return
    reporter = file.node_reporter("otmcp")
    reporter.attrs.update(classname="otmcp", name="run")
    reporter._add_simple("error", one_line(sentence), "")


def _excuse(file: LogXML, run: Mapping[str, Any]) -> None:
    """Tell failures of known deviations as pytest tells those that are expected: a dashboard that reads failures is as green as the exit code."""
    # A run whose record could not be finished has no footer that says it.
    used = set(run["footer"].get("deviations", {}).get("used", ()))
    known = {one["item"]: one for one in run["subject"]["deviations"] if one["item"] in used}
    for reporter in file.node_reporters_ordered:
        case = reporter.to_xml()
        named = re.fullmatch(r".*\[(.+)\]", case.get("name", ""))
        if named is None or named[1] not in known or _CLASSES not in case.get("classname", ""):
            continue
        deviation = known[named[1]]
        for failure in case.findall("failure"):
            failure.tag = "skipped"
            failure.set("type", "pytest.xfail")
            failure.set("message", one_line(f"known deviation until {deviation['expires']}: {deviation['reason']}"))
            file.stats["failure"] -= 1
            file.stats["skipped"] += 1
