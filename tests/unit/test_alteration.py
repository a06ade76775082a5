"""A change to the arguments of a tool call, as it is sent, recorded and played back."""

from __future__ import annotations

from pytest_otmcp.trial.alteration import DEEP, ELEMENTS, Alteration, expanded, filler


def test_arguments_are_given_and_left_out() -> None:
    altered = Alteration(given={"unit": 7, "value": True}, left_out=("address",))
    assert altered.applied({"address": 1, "value": 2}) == {"unit": 7, "value": True}
    assert altered.as_record() == {"given": {"unit": 7, "value": True}, "left_out": ["address"], "tool": None}


def test_a_record_holds_no_megabytes() -> None:
    altered = Alteration(given={"payload": filler(3)})
    recorded = altered.applied({"topic": "a"})
    assert len(str(recorded)) < 100
    assert expanded(recorded) == {"topic": "a", "payload": "xxx"}


def test_a_filler_is_sent_as_what_it_stands_for() -> None:
    arguments = {"text": filler(3), "list": filler(2, ELEMENTS), "deep": filler(2, DEEP), "other": {"a": 1}, "value": 7}
    assert expanded(arguments) == {"text": "xxx", "list": [0, 0], "deep": [[[]]], "other": {"a": 1}, "value": 7}
