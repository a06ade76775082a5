"""What is computed from the tries of an assessment: shares with exact intervals, pass^k, the paired comparison, the operator's figures. Pure."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from ..core.statistics import percentile, proportion_interval
from ..trial.assignment import FAMILIES
from .results import Assessment, CallTold, TryTold

__all__ = ["Paired", "Row", "Usage", "by_family", "exact_mcnemar", "paired", "pass_hat_k", "rows_of", "usage"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """What became of some tries.

    Attributes:
        right: number of right tries, with their share's exact 95 % interval (Clopper-Pearson).
        steady: number of tasks of which every try was right, and of tasks.
        pass_k: the estimated share of tasks that are right k times of k (pass^k), k being the least number of tries of a task.
        verdicts, honesty: number of tries by word.
        calls: of all tries.
        first_calls, first_ms: medians until the first right result, over the right tries; None where there is none.
        seconds: median of a try.
        result_bytes: mean number of bytes of results in a try.
        tokens: mean over the tries of which it is known; None where it is of none.
    """

    name: str
    tries: int
    right: int
    interval: tuple[float, float] | None
    steady: tuple[int, int]
    k: int
    pass_k: float
    verdicts: Mapping[str, int]
    honesty: Mapping[str, int]
    calls: int
    first_calls: float | None
    first_ms: float | None
    seconds: float | None
    result_bytes: float
    tokens: float | None


def rows_of(assessment: Assessment) -> list[Row]:
    """Return a row for each protocol, with tasks on several as one more, and one for all."""
    groups: defaultdict[str, list[TryTold]] = defaultdict(list)
    for told in assessment["tries"]:
        groups[" + ".join(told["protocols"])].append(told)
    rows = [row(name, tries) for name, tries in groups.items()]
    return [*rows, row("all", assessment["tries"])] if len(rows) > 1 else rows


def by_family(assessment: Assessment) -> list[Row]:
    """Return a row for each family of tasks."""
    return [
        row(family, tries)
        for family in FAMILIES
        if (tries := [told for told in assessment["tries"] if told["family"] == family])
    ]


def row(name: str, tries: Sequence[TryTold]) -> Row:
    """Return what became of these tries."""
    right = sum(told["verdict"] == "right" for told in tries)
    tasks = _by_task(tries)
    k = min(map(len, tasks.values()), default=0)
    first = [told["first_right"] for told in tries if told["first_right"] is not None]
    tokens = [told["tokens"] for told in tries if told["tokens"] is not None]
    return Row(
        name=name,
        tries=len(tries),
        right=right,
        interval=proportion_interval(right, len(tries)),
        steady=(sum(all(results) for results in tasks.values()), len(tasks)),
        k=k,
        pass_k=pass_hat_k(tasks.values(), k),
        verdicts=Counter(told["verdict"] for told in tries),
        honesty=Counter(told["honesty"] for told in tries),
        calls=sum(len(told["calls"]) for told in tries),
        first_calls=percentile([one["calls"] for one in first], 50),
        first_ms=percentile([one["ms"] for one in first], 50),
        seconds=percentile([told["seconds"] for told in tries], 50),
        result_bytes=sum(call["bytes"] for told in tries for call in told["calls"]) / max(1, len(tries)),
        tokens=sum(tokens) / len(tokens) if tokens else None,
    )


def _by_task(tries: Iterable[TryTold]) -> dict[str, list[bool]]:
    tasks: defaultdict[str, list[bool]] = defaultdict(list)
    for told in tries:
        tasks[told["task"]].append(told["verdict"] == "right")
    return tasks


def pass_hat_k(tasks: Iterable[Sequence[bool]], k: int) -> float:
    """Return pass^k: the mean over the tasks of the chance that k tries, drawn from those that were made, are all right.

    The estimator of Yao et al., "τ-bench" (2024): C(right, k) / C(tries, k) of each task.
    """
    shares = [math.comb(sum(results), k) / math.comb(len(results), k) for results in tasks if len(results) >= k > 0]
    return sum(shares) / len(shares) if shares else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Paired:
    """The same tries of two assessments.

    Attributes:
        both, first, second, neither: number of tries that were right in both, in one alone, in neither.
        p: of the exact test of McNemar, two-sided: how likely so uneven a split is if neither is better.
        gained, lost: tasks that are right more often, or less often, in the second.
    """

    both: int
    first: int
    second: int
    neither: int
    p: float
    gained: Sequence[str]
    lost: Sequence[str]


def paired(one: Assessment, other: Assessment) -> Paired:
    """Pair the tries of two assessments: the same task with the same values."""
    pairs: list[tuple[str, bool, bool]] = []
    known = {(told["task"], told["number"]): told for told in other["tries"]}
    for told in one["tries"]:
        twin = known.get((told["task"], told["number"]))
        if twin is not None:
            pairs.append((told["task"], told["verdict"] == "right", twin["verdict"] == "right"))
    counts = Counter((first, second) for _, first, second in pairs)
    balance: Counter[str] = Counter()
    for task, first, second in pairs:
        balance[task] += second - first
    return Paired(
        both=counts[True, True],
        first=counts[True, False],
        second=counts[False, True],
        neither=counts[False, False],
        p=exact_mcnemar(counts[True, False], counts[False, True]),
        gained=[task for task, change in balance.items() if change > 0],
        lost=[task for task, change in balance.items() if change < 0],
    )


def exact_mcnemar(first: int, second: int) -> float:
    """Return the two-sided p value of the exact test of McNemar, of the pairs that differ (Biometrika 12, 1947; binomial with 1/2)."""
    if first == second:
        return 1.0
    from scipy.special import bdtr

    return min(1.0, 2 * float(bdtr(min(first, second), first + second, 0.5)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Usage:
    """How a tool was used.

    Attributes:
        refused: calls without success.
        objected: argument to the number of refused calls that it is to blame for; the empty name stands for calls of which nothing is
            known.
    """

    protocol: str
    tool: str
    calls: int
    refused: int
    objected: Mapping[str, int]


def usage(assessment: Assessment) -> list[Usage]:
    """Return the use of every tool that was listed or called."""
    names = [(key, tool) for key, told in assessment["tools"].items() for tool in told["names"]]
    calls = [call for told in assessment["tries"] for call in told["calls"]]
    return [
        _usage(key, tool, [call for call in calls if (call["protocol"], call["tool"]) == (key, tool)])
        for key, tool in dict.fromkeys([*names, *((call["protocol"], call["tool"]) for call in calls)])
    ]


def _usage(protocol: str, tool: str, calls: Sequence[CallTold]) -> Usage:
    refused = [call for call in calls if call["success"] is not True]
    return Usage(
        protocol=protocol,
        tool=tool,
        calls=len(calls),
        refused=len(refused),
        objected=Counter(name for call in refused for name in (call["objected"] or [""])),
    )
