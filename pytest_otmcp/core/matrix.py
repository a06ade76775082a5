"""The suites and how often each of their items is repeated. Pure."""

from __future__ import annotations

__all__ = ["SUITES", "repetitions"]

SUITES = ("normal", "fault", "stress", "recovery")
"""The suites in the order in which they run."""


def repetitions(reps: int) -> dict[str, int]:
    """Repetitions per suite from the one number N: N, N, ceil(N/3), ceil(2N/3) (N = 30 gives the paper's matrix).

    Raises:
        ValueError: N is below 1.
    """
    if reps < 1:
        raise ValueError("repetitions must be at least 1")
    return {"normal": reps, "fault": reps, "stress": -(-reps // 3), "recovery": -(-2 * reps // 3)}
