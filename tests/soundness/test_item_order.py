"""The verdict of an item is its own: neither the items before it nor their order change it."""

from __future__ import annotations

import pytest

from .conftest import Judge, Results

BAD = {
    "none": "modbus",
    "never-reconnects": "modbus",
    "write-not-sent": "modbus",
    "cached-status": "mqtt",
}
"""The reference adapter, and defects that one item could hand on to the next: lost connections, memories of answers."""


def verdicts(results: Results) -> dict[str, str]:
    return {name: result["status"] for name, result in sorted(results.items())}


@pytest.mark.parametrize("name", ["never-reconnects", "cached-status"])
def test_items_in_another_order_have_the_same_verdicts(judge: Judge, name: str) -> None:
    usual = judge(BAD[name], "defective.py", name)
    assert verdicts(judge(BAD[name], "defective.py", name, shuffled=1)) == verdicts(usual)


@pytest.mark.long
@pytest.mark.parametrize("name", BAD)
def test_an_item_alone_has_the_same_verdict(judge: Judge, name: str) -> None:
    usual = judge(BAD[name], "defective.py", name)
    assert verdicts(judge(BAD[name], "defective.py", name, shuffled=2)) == verdicts(usual)
    alone: Results = {}
    for item in usual:
        alone |= judge(BAD[name], "defective.py", name, tasks=item)
    assert verdicts(alone) == verdicts(usual)
