"""Numbers beyond a limit that is the end of a type: nothing is asked for that no device could be asked."""

from __future__ import annotations

import pytest
from pytest_otmcp.conformance.requirements.fenced import beyond

from pytest_otmcp.protocols.registry import protocols


@pytest.mark.parametrize("protocol", protocols())
def test_a_number_that_no_type_has_is_not_asked_for_or_can_be_made(protocol: str) -> None:
    asks = protocols()[protocol].exercise
    assert asks is not None
    for target in asks.limited.values():
        for way in target.ways:
            (within,) = beyond(way, 7.0)
            assert within == way(7)
            beyond(way, 1e300)


def test_the_highest_word_of_a_controller_has_none_beyond_it() -> None:
    asks = protocols()["s7"].exercise
    assert asks is not None
    (way,) = asks.limited["DB10.DBW48"].ways
    assert len(beyond(way, 2**15 - 1)) == 1
    assert beyond(way, 2**15) == []
