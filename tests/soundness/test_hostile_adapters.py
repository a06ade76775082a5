"""What an adapter does to the kit ends within its deadline, in a clear finding, and leaves nothing behind."""

from __future__ import annotations

import re
import sys

import pytest

from .conftest import HERE, IMPATIENT, Judge, failing, words

LONG = pytest.mark.long


def hostile(kind: str) -> tuple[str, ...]:
    """Return the command of a hostile adapter, which is started as a vendor's adapter is."""
    return (sys.executable, str(HERE / "hostile.py"), kind)


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        pytest.param("slow-pattern", r"the outputSchema of tool ping cannot be checked within 5 s"),
        pytest.param("slow-pattern-of-names", r"is not of type 'null'", marks=LONG),
        pytest.param("slow-references", r"the outputSchema of tool ping cannot be checked within 5 s", marks=LONG),
        pytest.param("endless-reference", r"nested too deeply", marks=LONG),
        pytest.param("foreign-reference", r"Unresolvable: http://127\.0\.0\.1:9/schema\.json", marks=LONG),
        pytest.param("bad-pattern", r"is not a 'regex'", marks=LONG),
    ],
)
def test_the_finding_says_what_the_adapter_did(judge: Judge, kind: str, expected: str) -> None:
    results = judge("modbus", command=hostile(kind), tasks="M1", time_scale=IMPATIENT)
    assert failing(results) == {"M1"}
    assert results["M1"]["status"] == "FAIL"
    assert re.search(expected, words(results), re.DOTALL | re.IGNORECASE), words(results)
