"""Sparkplug host applications: honest ones are accused of nothing, each lie about a command or a STATE is found."""

from __future__ import annotations

import pytest

from .conftest import Judge, failing, lane, passing, requirements, words
from .test_commands import checks_of, on

HONEST = {
    "mqtt-host": (
        "MCP-005 ERR-006 ERR-007 WR-003 WR-004 WR-005 WR-010 TMO-004 SPB-010 SPB-011 SPB-013",
        "Q1 S8 S11 R-mqtt",
    ),
    "mqtt-listener": ("SPB-010 SPB-011", ""),
}

LIES = {
    ("mqtt-host", "sends-it-later"): ("SPB-010", "WR-010"),
    ("mqtt-host", "says-sent"): ("SPB-010", "SPB-010"),
    ("mqtt-host", "any-group"): ("SPB-010", "SPB-002"),
    ("mqtt-host", "devices-of-levels"): ("SPB-010", "SPB-001 SPB-002"),
    ("mqtt-host", "numbers-commands"): ("SPB-010", "SPB-010"),
    ("mqtt-host", "any-metric"): ("SPB-010", "SPB-010"),
    ("mqtt-host", "all-nodes"): ("SPB-010", "SPB-010"),
    ("mqtt-host", "sends-twice"): ("SPB-010", "WR-003"),
    ("mqtt-host", "retained-commands"): ("SPB-010", "SPB-010 SPB-002"),
    ("mqtt-host", "unguarded"): ("WR-004", "WR-004"),
    ("mqtt-host", "state-once"): ("SPB-013", "SPB-013"),
    ("mqtt-host", "state-not-retained"): ("SPB-013", "SPB-013"),
    ("mqtt-host", "no-will"): ("SPB-013", "SPB-013"),
    ("mqtt-host", "other-timestamp"): ("SPB-013", "SPB-013"),
    ("mqtt-host", "believes-its-death"): ("SPB-013", "SPB-013"),
    ("mqtt-listener", "sends-it-later"): ("SPB-010", "WR-010"),
    ("mqtt-listener", "devices-of-levels"): ("SPB-010", "SPB-001 SPB-002"),
}
"""Each lie with the row that is about it, and the requirements that may be cited."""

QUICK = {("mqtt-host", "sends-it-later"), ("mqtt-host", "state-once"), ("mqtt-listener", "sends-it-later")}

OUTAGES = {"sends-it-later": "S11 WR-010.mqtt", "says-sent": "S11 WR-010.mqtt"}
"""Lies that an outage brings to light as well, with the items that have one."""


@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=() if one == "mqtt-listener" else pytest.mark.long) for one in HONEST]
)
def test_an_honest_host_passes_what_is_asked_of_hosts(judge_foreign: Judge, name: str) -> None:
    rows, _ = HONEST[name]
    results = judge_foreign(name, tasks=" ".join(on("mqtt", rows)))
    assert passing(results) == results.keys(), words(results)


@pytest.mark.long
def test_a_message_of_qos_0_may_leave_after_the_last_reply_of_an_item(judge_foreign: Judge) -> None:
    results = judge_foreign("mqtt-listener", lie="a-moment-later", tasks="SPB-010.mqtt SPB-011.mqtt")
    assert passing(results) == results.keys(), words(results)


@pytest.mark.long
@pytest.mark.parametrize("name", HONEST)
def test_an_honest_host_is_accused_of_nothing(judge_foreign: Judge, name: str) -> None:
    rows, items = HONEST[name]
    results = judge_foreign(name, tasks=checks_of("mqtt"))
    assert failing(results) == set(), words(results)
    assert passing(results) >= on("mqtt", rows)
    benchmark = judge_foreign(name)
    assert failing(benchmark) == set(), words(benchmark)
    assert passing(benchmark) == set(items.split())


@pytest.mark.parametrize(
    ("name", "lie"), [pytest.param(*lie, marks=lane(number, lie in QUICK)) for number, lie in enumerate(LIES)]
)
def test_a_lie_of_a_host_is_found(judge_foreign: Judge, name: str, lie: str) -> None:
    row, cited = LIES[name, lie]
    results = judge_foreign(name, lie=lie, tasks=f"{row}.mqtt")
    assert failing(results) == {f"{row}.mqtt"}, words(results)
    assert requirements(results) <= set(cited.split()), words(results)


@pytest.mark.long
@pytest.mark.parametrize("lie", OUTAGES)
def test_an_outage_shows_what_became_of_a_command(judge_foreign: Judge, lie: str) -> None:
    results = judge_foreign("mqtt-host", lie=lie, tasks="S11 R-mqtt WR-010.mqtt")
    assert failing(results) == set(OUTAGES[lie].split()), words(results)


def test_a_command_that_is_sent_after_its_answer_is_not_taken_for_that_of_the_next_call(judge_foreign: Judge) -> None:
    results = judge_foreign("mqtt-host", lie="answers-first", tasks="INJ-003.mqtt")
    assert requirements(results) == set(), words(results)
    assert passing(results) == {"INJ-003.mqtt"}
