"""What needs no operation is asked of every server, and what needs a read is asked by a call that waits where there is no other one."""

from __future__ import annotations

import pytest

from pytest_otmcp.suite.catalogue import all_tasks

from .conftest import IMPATIENT, Judge, failing, passing, words

NEEDS_NOTHING = {f"MCP-{number:03}" for number in (1, 2, 3, 4, 7, 9, 10)}
WAITING = """
    MCP-001 MCP-002 MCP-003 MCP-005 MCP-006 MCP-007 MCP-008 MCP-009 MCP-010 ERR-001 ERR-005 ERR-007 RD-004 WR-003 WR-010 TMO-001 TMO-002
    TMO-003 TMO-004 REC-001 REC-002 REC-003 REC-005 KEY-001
""".split()
"""Rows that are asked of an MQTT adapter which publishes, and receives by a call that waits alone."""


def on_mqtt(*rows: str) -> str:
    return " ".join(f"{row}.mqtt" for row in rows)


@pytest.mark.long
def test_an_adapter_that_waits_for_messages_and_publishes_passes_what_it_is_asked(judge_foreign: Judge) -> None:
    results = judge_foreign("mqtt-wait", tasks=on_mqtt(*WAITING))
    assert failing(results) == set(), words(results)
    assert passing(results) == set(on_mqtt(*WAITING).split())


LIES = {
    # It starts when the broker is there, so nothing else of it is amiss.
    "needs-the-broker": ("MCP-002 MCP-009", {"MCP-002"}, "could not be started|exited"),
    "never-refused": ("ERR-001 MCP-009", {"ERR-001"}, "should have failed"),
    "publishes-into-the-void": ("REC-002 MCP-009", {"REC-002"}, "it claims success"),
    "makes-up-for-it": ("WR-010 MCP-009", set(), ""),
}
