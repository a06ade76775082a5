"""Adapters with vocabularies of their own: honest ones are accused of nothing, each lie fails the items that are about it."""

from __future__ import annotations

import pytest

from pytest_otmcp.core.matrix import REQUIREMENTS
from pytest_otmcp.suite.catalogue import all_tasks

from .conftest import Judge, failing, passing, words

QUICK = "WR-001 WR-002 WR-003 WR-004 WR-005 WR-014"


def rows(protocol: str, ids: str) -> str:
    return " ".join(f"{row}.{protocol}" for row in ids.split())


def every_check(protocol: str) -> str:
    return " ".join(
        task.id for task in all_tasks().values() if task.suite == REQUIREMENTS and task.family == task.family
    )


@pytest.mark.parametrize("name", ["modbus-valves", "mqtt-lights"])
def test_dbg(judge_foreign: Judge, name: str) -> None:
    results = judge_foreign(name, tasks=every_check(name.partition("-")[0]))
    for k, v in results.items():
        if v["status"] != "PASS" and "no adapter" not in (v["reason"] or ""):
            print(k, v["status"], (v["reason"] or "")[:150])
    print(words(results))
    print("PASS", passing(results))
    assert failing(results) == set()


@pytest.mark.parametrize("name", ["modbus-valves", "mqtt-lights"])
def test_dbg_bench(judge_foreign: Judge, name: str) -> None:
    results = judge_foreign(name)
    for k, v in results.items():
        if v["status"] != "PASS" and "no adapter" not in (v["reason"] or ""):
            print(k, v["status"], (v["reason"] or "")[:150])
    print(words(results))
    print("PASS", passing(results))
    assert failing(results) == set()
