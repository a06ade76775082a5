"""A test run leaves the long tests out unless it asks for them, and says that it does."""

from __future__ import annotations

import inspect

import pytest

from tests import long_tests

TESTS = """
import pytest

@pytest.mark.long
def test_long():
    pass

def test_short():
    pass
"""


@pytest.fixture
def suite(pytester: pytest.Pytester) -> pytest.Pytester:
    """A long test and another one, in a directory of their own."""
    pytester.makeini("[pytest]\nmarkers = long: left out\n")
    pytester.makeconftest(f"{inspect.getsource(long_tests)}\npytest_terminal_summary = say_what_was_left_out\n")
    pytester.makepyfile(TESTS)
    return pytester


@pytest.mark.parametrize("options", [(), ("-n", "1")])
def test_long_tests_are_left_out_and_counted(suite: pytest.Pytester, options: tuple[str, ...]) -> None:
    result = suite.runpytest_subprocess(*options)
    result.assert_outcomes(passed=1, deselected=0 if options else 1)
    result.stdout.fnmatch_lines(["1 long tests were left out; pytest -m long runs them"])


@pytest.mark.parametrize(("expression", "passed"), [("long", 1), ("long or not long", 2), ("not long", 1)])
def test_what_is_asked_for_is_run(suite: pytest.Pytester, expression: str, passed: int) -> None:
    result = suite.runpytest_subprocess("-m", expression)
    result.assert_outcomes(passed=passed, deselected=2 - passed)
    assert "left out" not in result.stdout.str()
