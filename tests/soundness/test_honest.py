"""The suite accuses no honest adapter: each passes every item, with exactly the warnings that are due."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from .conftest import Judge, Results, failing, passing, words
from .honest.zoo import ZOO


def warnings(results: Results) -> Iterator[tuple[str | None, str]]:
    for result in results.values():
        for findings in (result["findings"], *(sample["findings"] for sample in result["samples"])):
            for finding in findings:
                if finding["strength"] == "SHOULD":
                    yield finding["requirement"], finding["code"]


@pytest.mark.parametrize("name", ZOO)
def test_an_honest_adapter_is_accused_of_nothing(judge: Judge, name: str) -> None:
    choice = ZOO[name]
    results: dict[str, dict[str, Any]] = judge(choice.protocol, "honest/adapter.py", name, described=choice.described)
    assert failing(results) == set(), words(results)
    assert passing(results) == results.keys()
    assert set(warnings(results)) == choice.warnings, words(results)
