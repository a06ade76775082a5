"""The list of targets and the limits of the reference adapters."""

from __future__ import annotations

import math

import pytest
from pytest_otmcp.reference_adapters.core import AdapterError, Call, ConfigError, Environment
from pytest_otmcp.reference_adapters.core.bounds import Bounds


def bounds_of(**values: str) -> Bounds:
    found = Bounds.of(Environment(values))
    assert found is not None
    return found


def test_without_settings_there_are_no_bounds() -> None:
    assert Bounds.of(Environment({})) is None


@pytest.mark.parametrize("text", ["10..19", '{"a": 1}', "[1]"])
def test_a_list_that_cannot_be_read_stops_the_start(text: str) -> None:
    with pytest.raises(ConfigError, match="OT_WRITE_ALLOW"):
        bounds_of(OT_WRITE_ALLOW=text)


def test_one_forbidden_target_forbids_all_of_them() -> None:
    bounds = bounds_of(OT_WRITE_ALLOW='["a/10..19", "b/*/c"]')
    bounds.check([("a/10", 1), ("a/19", 2), ("b/x/c", None)])
    for target in ("a/9", "a/20", "b/x/y/c", "a/10 "):
        with pytest.raises(AdapterError) as refused:
            bounds.check([("a/10", 1), (target, 1)])
        assert (refused.value.code, refused.value.outcome) == ("access_denied", "not_sent")


@pytest.mark.parametrize("value", [-0.1, 80.1, math.nan, math.inf, None, True, "50"])
def test_what_is_beyond_a_limit_or_no_number_is_refused(value: object) -> None:
    bounds = bounds_of(OT_WRITE_LIMITS='{"a": {"lowest": 0, "highest": 80}}')
    bounds.check([("a", 0), ("a", 80), ("b", value)])
    with pytest.raises(AdapterError) as refused:
        bounds.check([("a", value)])
    assert refused.value.code == "range_overflow"


def test_the_same_target_twice_in_a_batch_is_looked_at_twice() -> None:
    with pytest.raises(AdapterError):
        bounds_of(OT_WRITE_LIMITS='{"a": {"highest": 80}}').check([("a", 81), ("a", 1)])


def test_steps_and_times_are_counted_from_the_last_write() -> None:
    bounds = bounds_of(OT_WRITE_LIMITS='{"a": {"step": 5}, "b": {"every_s": 3600}}')
    bounds.check([("a", 10), ("b", 1)])
    bounds.check([("a", 15)])
    for changes, code in (([("a", 9)], "range_overflow"), ([("b", 1)], "rate_limited")):
        with pytest.raises(AdapterError) as refused:
            bounds.check(changes)
        assert refused.value.code == code


def test_a_tool_that_does_not_say_what_it_changes_may_not_write_while_there_are_bounds() -> None:
    call = Call(protocol="x", operation="x", endpoint="x", writes=True, bounds=bounds_of(OT_WRITE_ALLOW='["a"]'))
    call.sending(changes_state=False)
    with pytest.raises(AdapterError) as refused:
        call.sending()
    assert (refused.value.code, call.writes_sent) == ("access_denied", 0)
    call.changes(("a", 1))
    call.sending()
    assert call.writes_sent == 1
