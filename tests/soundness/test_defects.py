"""The proof that the suite works: each defective adapter fails exactly its tasks, and for the right reason."""

from __future__ import annotations

import pytest

from .conftest import IMPATIENT, Judge, failing, requirements, words
from .defective import DEFECTS

READS_INPUT = "M2 S1 S7 S10 R-modbus"
FAILS_IN_WORDS = "M4 FM1 FM2 S10 R-modbus"

EXPECTED = {
    "none": ("", "", ""),
    "unknown-tool": ("M1", "MCP-007", "Unknown tool: ping"),
    "traceback-as-text": (FAILS_IN_WORDS, "ENV-001", "no structuredContent object"),
    "write-sent-twice": ("M3 M4 X2 X2p FM2 S4", "WR-003", "it saw 2"),
    "hang": (READS_INPUT, "TMO-001", "no reply within the deadline"),
    "wrong-value": ("M2 X1 X1p FX1 S1 S7", "RD-001", "values should be"),
    "wrong-at-first": ("M2", "RD-001", "warmup: read_input_registers(address=0, count=4): values should be"),
    "demo-without-a-device": ("R-modbus", "REC-002", "it claims success"),
    "ping-that-only-connects": (
        "M1",
        "RD-004",
        "should have answered at least 1 request(s) during the call(s), it saw none",
    ),
    "swapped-parallel-replies": ("S1", "RD-001", "values should be"),
    "incomplete-enumeration": ("O4", "OUA-006", "1 missing, for instance"),
}
"""Name to the items that fail, the requirements that the findings cite, and words that one of them has."""


ALONE = {"hang": "M1 M2 M3 M4 FM2 S1 S4 S7 S10 R-modbus"}
"""Tasks of this protocol alone: when one adapter hangs, all those of the task are started again, which takes long. Not FM1: the
adapter's own time-out, for which it waits there, is longer than the shortened deadline."""


@pytest.mark.long
@pytest.mark.parametrize("name", DEFECTS)
def test_a_defect_fails_exactly_its_tasks_for_its_requirements(judge: Judge, name: str) -> None:
    tasks, rules, reason = EXPECTED[name]
    protocol, _ = DEFECTS[name]
    time_scale = IMPATIENT if name == "hang" else 1.0
    results = judge(protocol, "defective.py", name, tasks=ALONE.get(name), time_scale=time_scale)
    found = failing(results)
    assert found == set(tasks.split()), f"{found ^ set(tasks.split())}:\n{words(results)}"
    assert requirements(results) == set(rules.split()), words(results)
    assert reason in words(results)
    assert "KIT_ERROR" not in {result["status"] for result in results.values()}


def test_short_deadlines_leave_the_watch_for_what_must_not_happen_as_long_as_it_is(judge: Judge) -> None:
    results = judge("modbus", "defective.py", "none", tasks="FM2", time_scale=IMPATIENT)
    assert results["FM2"]["status"] == "PASS"
    assert results["FM2"]["timing_ms"]["quiet windows"] >= 250
