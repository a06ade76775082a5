"""A test run leaves the long and the weekly tests out unless it asks for them, and says that it does."""

from __future__ import annotations

import inspect

import pytest

from tests import lanes

TESTS = """
import pytest

@pytest.mark.long
def test_long():
    pass

@pytest.mark.weekly
def test_weekly():
    pass

@pytest.mark.long
@pytest.mark.weekly
def test_long_and_weekly():
    pass

def test_fast():
    pass
"""


@pytest.fixture
def suite(pytester: pytest.Pytester) -> pytest.Pytester:
    """A test of each lane, in a directory of their own."""
    pytester.makeini("[pytest]\nmarkers =\n  long: left out\n  weekly: left out\n")
    pytester.makeconftest(f"{inspect.getsource(lanes)}\npytest_terminal_summary = say_what_was_left_out\n")
    pytester.makepyfile(TESTS)
    return pytester


@pytest.mark.parametrize("options", [(), ("-n", "1")])
def test_slow_tests_are_left_out_and_counted(suite: pytest.Pytester, options: tuple[str, ...]) -> None:
    result = suite.runpytest_subprocess(*options)
    result.assert_outcomes(passed=1, deselected=0 if options else 3)
    result.stdout.fnmatch_lines(
        [
            "1 long tests were left out; pytest -m long runs them",
            "2 weekly tests were left out; pytest -m weekly runs them",
        ]
    )


@pytest.mark.parametrize(
    ("expression", "passed", "left_out"),
    [
        ("long", 1, 2),
        ("not long", 1, 2),
        ("long or not long", 2, 2),
        ("weekly", 2, 0),
        ("long or weekly", 3, 0),
        ("not weekly", 2, 0),
    ],
)
def test_an_expression_with_weekly_alone_runs_weekly_tests(
    suite: pytest.Pytester, expression: str, passed: int, left_out: int
) -> None:
    result = suite.runpytest_subprocess("-m", expression)
    result.assert_outcomes(passed=passed, deselected=4 - passed)
    said = [line for line in result.outlines if "left out" in line]
    assert said == [f"{left_out} weekly tests were left out; pytest -m weekly runs them"] * bool(left_out)


def test_every_selected_test_is_in_one_shard(suite: pytest.Pytester) -> None:
    outputs = [
        suite.runpytest_subprocess("-v", "-m", "weekly or long", f"--shard={part}/2").outlines for part in (1, 2)
    ]
    ran = [{line.partition(" ")[0] for line in lines if "PASSED" in line} for lines in outputs]
    assert [len(part) for part in ran] == [2, 1]
    assert len(ran[0] | ran[1]) == 3


def test_of_the_long_tests_of_some_files_the_long_lane_has_a_part(suite: pytest.Pytester) -> None:
    name, number = "plugin/test_walls", 2
    assert lanes._ONE_IN[f"{name}.py"] == number
    several = "".join(f"@pytest.mark.long\ndef test_{one}():\n    pass\n\n" for one in range(4))
    suite.makepyfile(**{name: f"import pytest\n\n{several}"})
    for expression, passed in (("long", 2), ("weekly", 2), ("long or weekly", 4)):
        suite.runpytest("-p", "no:asyncio", "-m", expression, f"{name}.py").assert_outcomes(
            passed=passed, deselected=4 - passed
        )
    suite.runpytest("-p", "no:asyncio", "-m", "long", f"{name}.py::test_1").assert_outcomes(passed=1)
