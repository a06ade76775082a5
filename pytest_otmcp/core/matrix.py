"""The suites, the repetitions of their items, and the name of the family that spans protocols. Pure."""

from __future__ import annotations

__all__ = ["BENCHMARK", "CROSS_PROTOCOL", "FIELD", "KNOWN_SUITES", "REQUIREMENTS", "SUITES", "WARMED_UP", "repetitions"]

BENCHMARK = ("normal", "fault", "stress", "recovery")
"""The paper's suites in the order in which they run: what a run has when no suite is asked for."""

REQUIREMENTS = "requirements"
"""The suite with a check for each row of the requirement catalogue and each protocol."""

SUITES = (*BENCHMARK, REQUIREMENTS)
"""Every suite that is asked for by its name, in the order in which they run."""

FIELD = "field"
"""The suite of what can be judged at a real device: what a run has that names one. Each of its items has one repetition."""

KNOWN_SUITES = (*SUITES, FIELD)
"""Every suite that items may be of, in the order of tables."""

WARMED_UP = ("normal", "fault")
"""Suites whose items begin with one unmeasured repetition, so that no first-time cost is counted as the adapter's."""

CROSS_PROTOCOL = "Cross-protocol"
"""The family of items that need adapters for several protocols; every other item's family is the name of its protocol."""


def repetitions(reps: int) -> dict[str, int]:
    """Return the repetitions per suite for one number N: N, N, ceil(N/3), ceil(2N/3) (N = 30 gives the paper's matrix).

    A check of a requirement does by itself as often as its row needs what it is about, so it has one repetition.

    Raises:
        ValueError: N is below 1.
    """
    if reps < 1:
        raise ValueError("repetitions must be at least 1")
    return {"normal": reps, "fault": reps, "stress": -(-reps // 3), "recovery": -(-2 * reps // 3), REQUIREMENTS: 1}
