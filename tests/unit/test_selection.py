"""The adapters that a run measures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from pytest_otmcp.core.errors import UsageError
from pytest_otmcp.protocols.protocol import OtProtocol
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.subject import reference_subject
from pytest_otmcp.subject.selection import ALL, select

ALWAYS = [key for key, protocol in protocols().items() if protocol.always]


@pytest.fixture
def registry(monkeypatch: pytest.MonkeyPatch) -> Mapping[str, OtProtocol]:
    """The registry as if two of the protocols were only run when they are asked for, one of them without its library."""
    known = dict(protocols())
    first, second, *_ = known
    known[first] = replace(known[first], always=False, packages=("pytest", "otmcp-no-such-library"))
    known[second] = replace(known[second], always=False, packages=("pytest",))
    monkeypatch.setattr("pytest_otmcp.subject.selection.protocols", lambda: known)
    return known


def test_a_run_has_the_protocols_that_are_always_part_of_one() -> None:
    assert list(select(None).subject.adapters) == ALWAYS


def test_a_further_protocol_is_measured_when_it_is_asked_for(registry: Mapping[str, OtProtocol]) -> None:
    second, third = list(registry)[1:3]
    assert list(select(None).subject.adapters) == [third]
    chosen = select(None, (second,))
    assert list(chosen.subject.adapters) == [second, third]
    assert chosen.not_measured == {}


def test_a_protocol_without_its_library_is_not_measured_and_says_what_to_install(
    registry: Mapping[str, OtProtocol],
) -> None:
    first, second, *_ = registry
    missing = f"otmcp-no-such-library is not installed; pip install 'pytest-otmcp[{first}]'"
    chosen = select(None, (ALL,))
    assert first not in chosen.subject.adapters
    assert second in chosen.subject.adapters
    assert chosen.not_measured == {first: f"{registry[first].name} was not measured: {missing}"}


def test_a_protocol_that_is_named_needs_its_library(registry: Mapping[str, OtProtocol]) -> None:
    first, second, *_ = registry
    with pytest.raises(UsageError, match=f"--otmcp-protocols: {first}: otmcp-no-such-library is not installed"):
        select(None, (second, first))


def test_an_unknown_protocol_is_refused_in_one_sentence() -> None:
    near = f"{ALWAYS[0]}x"
    with pytest.raises(UsageError, match=f"--otmcp-protocols: .*{near}.*{ALWAYS[0]}"):
        select(None, (near,))


def test_a_subject_file_says_itself_what_is_tested() -> None:
    source = reference_subject().source
    assert list(select(source).subject.adapters) == list(reference_subject().adapters)
    with pytest.raises(UsageError, match="leave the option out"):
        select(Path(source), (ALL,))
