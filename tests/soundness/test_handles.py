"""Handles from one call to the next: who yields them is judged by what the calls that take them do at the broker."""

from __future__ import annotations

import pytest

from .conftest import Judge, failing, passing, requirements, words


@pytest.mark.long
def test_an_adapter_that_is_told_its_handles_passes(judge_foreign: Judge) -> None:
    results = judge_foreign("mqtt-session", tasks="CON-001.mqtt MQT-002.mqtt MQT-004.mqtt REC-001.mqtt")
    assert passing(results) == results.keys(), words(results)


def test_a_handle_that_ends_the_subscription_of_another_is_found(judge_foreign: Judge) -> None:
    results = judge_foreign("mqtt-session", lie="ends-another", tasks="MQT-002.mqtt")
    assert failing(results) == {"MQT-002.mqtt"}
    assert requirements(results) == {"MQT-002"}, words(results)


def test_an_answer_without_the_handle_is_one_sentence(judge_foreign: Judge) -> None:
    results = judge_foreign("mqtt-session", tasks="Q2", described=('watch = "data.watch"', 'watch = "data.handle"'))
    assert (results["Q2"]["status"], results["Q2"]["reason"]) == (
        "NOT_TESTABLE",
        "mqtt: read takes $subscribe.watch, and the answer of watch has nothing where 'keep' looks for it",
    )


def test_a_connect_step_that_yields_no_handle_has_failed(judge_foreign: Judge) -> None:
    results = judge_foreign("mqtt-session", tasks="Q1", described=("data.session.number", "data.session.id"))
    assert failing(results) == {"Q1"}
    said = "the connect step 'open_session' failed: its answer has nothing where 'keep' looks for session; it said: {"
    assert said in words(results)


def test_a_subscription_that_fails_is_the_finding_and_not_the_handle_that_it_would_have_had(
    judge_foreign: Judge,
) -> None:
    results = judge_foreign("mqtt-session", lie="refuses-wildcards", tasks="Q2 MQT-004.mqtt")
    assert {result["status"] for result in results.values()} == {"FAIL"}
    assert "expected success" in words(results)
