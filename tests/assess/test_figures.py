"""What is computed from tries: pass^k, the exact test, and how tools were used."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import pytest
from scipy.stats import binomtest

from pytest_otmcp.assess import report, results
from pytest_otmcp.assess.figures import exact_mcnemar, paired, pass_hat_k, row, usage
from pytest_otmcp.assess.results import Assessment
from pytest_otmcp.core.errors import UsageError


def test_pass_k_is_the_chance_that_k_tries_are_all_right() -> None:
    assert pass_hat_k([[True] * 5, [True, True, True, False, False]], 2) == pytest.approx((1 + 3 / 10) / 2)
    assert pass_hat_k([[True] * 4 + [False]], 5) == 0
    assert pass_hat_k([], 1) == 0


@pytest.mark.parametrize(("first", "second"), [(0, 0), (1, 0), (0, 6), (3, 9), (10, 10), (40, 12)])
def test_the_test_of_mcnemar_is_the_exact_binomial_one(first: int, second: int) -> None:
    wanted = binomtest(first, first + second, 0.5).pvalue if first + second else 1.0
    assert exact_mcnemar(first, second) == pytest.approx(wanted)


def told(task: str, number: int, verdict: str, *calls: dict[str, Any]) -> dict[str, Any]:
    return {
        "task": task,
        "family": "read",
        "protocols": ["modbus"],
        "number": number,
        "verdict": verdict,
        "honesty": "true",
        "outcome": "done",
        "value": None,
        "wanted": None,
        "why": [],
        "changed": [],
        "calls": list(calls),
        "first_right": {"calls": 2, "ms": 5.0} if verdict == "right" else None,
        "seconds": 1.0,
        "tokens": None,
        "prompt": "",
        "answer": "",
        "problem": "",
    }


def called(tool: str, success: bool, *objected: str) -> dict[str, Any]:
    return {
        "protocol": "modbus",
        "tool": tool,
        "arguments": {},
        "success": success,
        "objected": list(objected),
        "at_ms": 0.0,
        "latency_ms": None,
        "bytes": 100,
        "text": "",
    }


def assessment(*tries: dict[str, Any], seed: int = 1) -> Assessment:
    return cast(
        Assessment,
        {
            "form": results.FORM,
            "kit": "1",
            "engine": "command",
            "began": "2026-11-26",
            "assistant": "some | model",
            "subject": {"name": "acme", "version": "1"},
            "seed": seed,
            "prompts": "p",
            "tools": {"modbus": {"names": ["read", "write", "idle"], "bytes": 300}},
            "tries": list(tries),
            "not_asked": {"modbus.guard": "it has no launch without writes"},
        },
    )


ONE = assessment(
    told("a", 0, "right", called("read", True)),
    told("a", 1, "right", called("read", True)),
    told("b", 0, "wrong", called("write", False, "value"), called("write", False)),
)
OTHER = assessment(told("a", 0, "right"), told("a", 1, "wrong"), told("b", 0, "right"))


def test_a_row_counts_tries_tasks_and_calls() -> None:
    found = row("all", ONE["tries"])
    assert (found.right, found.tries, found.steady, found.k, found.calls) == (2, 3, (1, 2), 1, 4)
    assert found.first_calls == 2
    assert found.tokens is None


def test_two_assessments_are_paired_by_task_and_try() -> None:
    pair = paired(ONE, OTHER)
    assert (pair.both, pair.first, pair.second, pair.neither, pair.p) == (1, 1, 1, 0, 1.0)
    assert (pair.gained, pair.lost) == (["b"], ["a"])


def test_assessments_with_other_seeds_are_not_compared() -> None:
    assert "no pairs" in report.compared(ONE, assessment(seed=2))


def test_tools_never_chosen_and_arguments_to_blame_are_told() -> None:
    by_tool = {one.tool: one for one in usage(ONE)}
    assert by_tool["idle"].calls == 0
    assert by_tool["write"].objected == {"value": 1, "": 1}
    said = report.summary(ONE)
    assert "never chosen: idle" in said
    assert "value 1" in said
    assert "no part of the adapter's conformance" in said
    assert "some \\| model" in said


def test_a_report_has_its_tables_and_figures_and_the_file_is_read_again(tmp_path: Path) -> None:
    results.write(tmp_path / "assessment.json", ONE)
    assert results.read([tmp_path / "assessment.json"]) == [ONE]
    names = {path.name for path in report.write(tmp_path, ONE)}
    assert names >= {"assessment.md", "tab_assessment.tex", "tab_operator.tex", "assessment_verdicts.png"}
    assert (tmp_path / "assessment_tools.pdf").stat().st_size > 1000


def test_a_file_that_is_no_assessment_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.json").write_text("[]")
    for path in (tmp_path / "x.json", tmp_path / "y.json"):
        with pytest.raises(UsageError, match=path.name):
            results.read([path])
