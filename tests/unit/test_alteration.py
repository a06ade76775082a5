"""Values that stand for large ones are sent as what they stand for, and recorded as they are."""

from __future__ import annotations

from pytest_otmcp.trial.alteration import DEEP, ELEMENTS, expanded, filler


def test_a_filler_is_sent_as_what_it_stands_for() -> None:
    arguments = {"text": filler(3), "list": filler(2, ELEMENTS), "deep": filler(2, DEEP), "other": {"a": 1}, "value": 7}
    assert expanded(arguments) == {"text": "xxx", "list": [0, 0], "deep": [[[]]], "other": {"a": 1}, "value": 7}
