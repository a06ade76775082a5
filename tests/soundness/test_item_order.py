"""The verdict of an item is its own: neither the items before it, nor their order, nor the number of repetitions change it."""

from __future__ import annotations

import pytest
from pytest_otmcp.reference_adapters.defects.table import DEFECTS

from .conftest import DEFECT, Judge, Results, failing

pytestmark = pytest.mark.long

# Defects that one item could hand on to the next: lost connections, and writes that were never sent. An adapter that remembers answers is
# none of them: which of its calls is answered from memory does depend on the calls before.


def verdicts(results: Results) -> dict[str, str]:
    return {name: result["status"] for name, result in sorted(results.items())}


@pytest.mark.weekly
@pytest.mark.parametrize("name", ["MU-126", "MU-126q"])
def test_items_in_another_order_have_the_same_verdicts(judge: Judge, name: str) -> None:
    protocol = DEFECTS[name].protocol
    usual = judge(protocol, *DEFECT, name)
    assert failing(usual) >= set(DEFECTS[name].items.split())
    assert verdicts(judge(protocol, *DEFECT, name, shuffled=1)) == verdicts(usual)


ADAPTERS = [
    ("modbus", ("defective.py",), "none"),
    *((DEFECTS[name].protocol, DEFECT, name) for name in ("MU-126q", "MU-14")),
]


@pytest.mark.weekly
@pytest.mark.parametrize(("protocol", "program", "name"), ADAPTERS)
def test_more_repetitions_have_the_same_verdicts(
    judge: Judge, protocol: str, program: tuple[str, ...], name: str
) -> None:
    once = judge(protocol, *program, name)
    assert verdicts(judge(protocol, *program, name, repetitions=3)) == verdicts(once)


@pytest.mark.weekly
@pytest.mark.parametrize(("protocol", "program", "name"), ADAPTERS)
def test_an_item_alone_has_the_same_verdict(judge: Judge, protocol: str, program: tuple[str, ...], name: str) -> None:
    usual = judge(protocol, *program, name)
    assert verdicts(judge(protocol, *program, name, shuffled=2)) == verdicts(usual)
    alone: Results = {}
    for item in usual:
        alone |= judge(protocol, *program, name, tasks=item)
    assert verdicts(alone) == verdicts(usual)
