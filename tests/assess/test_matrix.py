"""Each scripted assistant fails exactly its tasks, with the reference adapters and with public ones."""

from __future__ import annotations

import asyncio
import tomllib
from pathlib import Path

import pytest

from pytest_otmcp.assess.campaign import Tools, assignments, run_try, tries
from pytest_otmcp.assess.place import Place
from pytest_otmcp.assess.results import TryTold
from pytest_otmcp.session.isolation import Isolation
from pytest_otmcp.subject import load_subject, reference_subject
from pytest_otmcp.subject.model import Subject

from ..adapters_in_the_wild.conftest import Install, installed
from .choosers import KINDS, Chooser

__all__ = ["installed"]

EXPECTED = tomllib.loads((Path(__file__).parent / "expected.toml").read_text(encoding="utf-8"))
_SEED = 7


def expected(kind: str, task: str, family: str) -> str:
    rules = EXPECTED[kind]
    return str(rules.get(task, rules.get(family, rules.get("otherwise", "right"))))


async def assess(subject: Subject, kind: str, protocols: set[str]) -> list[TryTold]:
    """Let a chooser do every task that is about these protocols and no other."""
    isolation = Isolation()
    place = Place(subject, isolation)
    wanted = [one for one in assignments() if set(one.protocols) == protocols]
    tools: Tools = {}
    try:
        planned, _ = tries(place, wanted, 1, _SEED)
        chooser = Chooser(kind, _SEED, 1)
        return [await run_try(place, one, number, case, chooser, tools) for one, number, case in planned]
    finally:
        await place.close()
        isolation.close()


def fails_exactly_its_tasks(kind: str, told: list[TryTold]) -> None:
    found = {one["task"]: one["verdict"] for one in told}
    assert found == {one["task"]: expected(kind, one["task"], one["family"]) for one in told}, [
        (one["task"], one["why"]) for one in told
    ]
    if kind == "good":
        assert {one["honesty"] for one in told} == {"true"}
        assert all(one["first_right"] is not None for one in told if one["family"] != "control")
    if kind == "liar":
        assert {one["honesty"] for one in told if one["family"] != "control"} == {"false"}


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=pytest.mark.weekly if number % 3 else ()) for number, kind in enumerate(KINDS)]
)
@pytest.mark.parametrize(
    "protocols",
    [
        pytest.param({"modbus"}, id="modbus", marks=pytest.mark.long),
        pytest.param({"mqtt"}, id="mqtt", marks=pytest.mark.weekly),
        pytest.param({"opcua"}, id="opcua", marks=pytest.mark.weekly),
        pytest.param({"modbus", "mqtt", "opcua"}, id="cross", marks=pytest.mark.weekly),
    ],
)
def test_a_scripted_assistant_fails_exactly_its_tasks(kind: str, protocols: set[str]) -> None:
    told = asyncio.run(assess(reference_subject(), kind, protocols))
    assert len(told) >= 2
    fails_exactly_its_tasks(kind, told)


@pytest.mark.weekly
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("example", "protocol", "least"), [("kukapay-modbus-mcp", "modbus", 10), ("mcpmqtt", "mqtt", 10)]
)
def test_a_scripted_assistant_fails_exactly_its_tasks_with_a_public_adapter(
    installed: Install, kind: str, example: str, protocol: str, least: int
) -> None:
    told = asyncio.run(assess(load_subject(installed(example)), kind, {protocol}))
    assert len(told) >= least
    fails_exactly_its_tasks(kind, told)
