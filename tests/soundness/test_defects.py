"""The proof that the suite works: each defective adapter fails exactly its tasks, and for the right reason."""

from __future__ import annotations

import pytest

from .conftest import IMPATIENT, Judge, failing, words
from .defective import DEFECTS

READS_INPUT = "M2 S1 S7 S10 R-modbus"
FAILS_IN_WORDS = "M4 FM1 FM2 S10 R-modbus"
EVERY_MODBUS_TASK = "M1 M2 M3 M4 X1 X2 X1p X2p FM1 FM2 FX1 S1 S4 S7 S10 R-modbus"

EXPECTED = {
    "none": ("", ""),
    "unknown-tool": ("M1", "Unknown tool: ping"),
    "traceback-as-text": (FAILS_IN_WORDS, "no structuredContent object"),
    "lying-guard": ("M4", "the device should have seen no state-changing request, it saw 1"),
    "write-not-sent": (
        "M3 M4 X2 X2p FM2 S4 S10",
        "should have seen one write of [40] to holding_registers 1, it saw 0",
    ),
    "write-sent-twice": ("M3 M4 X2 X2p FM2 S4", "it saw 2"),
    "never-reconnects": ("S10 R-modbus", "expected success, got error 'connect_failed'"),
    "hang": (READS_INPUT, "no reply within the deadline"),
    "stdout-noise": (EVERY_MODBUS_TASK, "'Connected to Modbus device'"),
    "wrong-value": ("M2 X1 X1p FX1 S1 S7", "values should be"),
    "swapped-parallel-replies": ("S1", "values should be"),
    "truncates-overflow": ("FM2", "it claims success"),
    "is-error-never-set": (FAILS_IN_WORDS, "isError is False although success is False"),
    "error-is-a-word": (FAILS_IN_WORDS, "error: "),
    "lying-guard-mqtt": ("Q3", "the broker should have seen no PUBLISH from the adapter, it saw 1"),
    "lying-guard-opcua": ("O3", "the server should have seen no state-changing request, it saw 1"),
    "cached-status": ("Q1 X1 X1p S8 S11 R-mqtt", "the broker should have answered at least"),
    "clamps-qos": ("FQ2", "it claims success"),
    "publish-not-sent": ("Q3 X2 X2p FQ1 FX1 S5 S11", "it received 0 message(s)"),
    "incomplete-enumeration": ("O4", "1 missing, for instance"),
    "bad-code": ("FO1 FX1", "error code should be illegal_address, it is 'protocol_error'"),
}


ALONE = {"hang": "M1 M2 M3 M4 FM1 FM2 S1 S4 S7 S10 R-modbus"}
"""Tasks of this protocol alone: when one adapter hangs, all those of the task are started again, which takes long."""


WAITED_FOR = ("hang", "publish-not-sent")


@pytest.mark.parametrize("name", DEFECTS)
def test_a_defect_fails_exactly_its_tasks(judge: Judge, name: str) -> None:
    tasks, reason = EXPECTED[name]
    protocol, _ = DEFECTS[name]
    time_scale = IMPATIENT if name in WAITED_FOR else 1.0
    results = judge(protocol, "defective.py", name, tasks=ALONE.get(name), time_scale=time_scale)
    found = failing(results)
    assert found == set(tasks.split()), f"{found ^ set(tasks.split())}:\n{words(results)}"
    assert reason in words(results)
    assert "KIT_ERROR" not in {result["status"] for result in results.values()}


def test_short_deadlines_leave_the_watch_for_what_must_not_happen_as_long_as_it_is(judge: Judge) -> None:
    results = judge("modbus", "defective.py", "none", tasks="FM2", time_scale=IMPATIENT)
    assert results["FM2"]["status"] == "PASS"
    assert results["FM2"]["timing_ms"]["quiet windows"] >= 250
