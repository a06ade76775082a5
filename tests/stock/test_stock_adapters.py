"""The adapters of docs/first-adapter, made with stock parts: as one writes them first, and after the changes that the documents name.

The first forms are honest and have faults: the rows that they violate are pinned. The second ones earn Silver, so that every MUST up to
that level can be kept with the official SDK's high-level server and a common client library.
"""

from __future__ import annotations

import os
import subprocess
import venv
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any, cast

import pytest

from pytest_otmcp.core.matrix import SUITES
from pytest_otmcp.plant.devices import Plant
from pytest_otmcp.record.schema import Item
from pytest_otmcp.record.warnings import failing, findings_of
from pytest_otmcp.session.loop import LoopThread
from pytest_otmcp.soundness.judging import measured
from pytest_otmcp.subject import load_subject
from pytest_otmcp.suite.by_library import advice
from pytest_otmcp.suite.catalogue import all_tasks, tasks_by_id
from pytest_otmcp.suite.levels import standing
from pytest_otmcp.suite.requirements import Level, catalogue
from pytest_otmcp.trial.adapter_under_test import BenchOptions
from pytest_otmcp.trial.bench import Bench

FILES = Path(__file__).parents[2] / "docs" / "first-adapter"

ADAPTERS = {"modbus": "modbus", "modbus_async": "modbus", "mqtt": "mqtt", "opcua": "opcua"}
"""Each adapter, and its protocol."""

VIOLATED = {
    "modbus": "ADR-004 MCP-004 MCP-005 RD-004 RD-005 TMO-001 TMO-003 WR-003 WR-005 WR-009",
    "modbus_async": "ADR-004 MCP-004 MCP-005 RD-004 RD-005 TMO-001 WR-003 WR-005 WR-009",
    "mqtt": "ADR-006 ADR-007 ENC-006 ERR-004 INJ-002 MCP-002 MCP-004 MCP-005 MQT-001 MQT-002 MQT-004 RD-004 REC-002 REC-004 WR-003 WR-005 WR-010",
    "opcua": "ADR-003 INJ-002 MCP-002 MCP-004 MCP-005 OUA-001 REC-001 WR-005",
}
"""MUSTs that each first form violates in every run; on a busy machine a deadline may be missed as well."""

SAMPLE = {
    "modbus": {"M1": "RD-004", "M4": "WR-005", "WR-009.modbus": "WR-009", "ADR-004.modbus": "ADR-004"},
    "mqtt": {"Q1": "RD-004", "Q2": "", "S2": "", "MQT-002.mqtt": "MQT-002", "INJ-002.mqtt": "INJ-002"},
    "opcua": {"O1": "", "O3": "WR-005", "OUA-001.opcua": "OUA-001", "INJ-002.opcua": "INJ-002"},
}
"""A few items of each protocol, with exactly the rows that the first forms violate in them."""

WIDE = "RD-003 RD-006 RD-007 WR-008 WR-011 ENC-001 ENC-003 ENC-004 ENC-005 ENC-006".split()
"""Rows about what the Modbus adapters of the documents do not offer."""

OWN = {"WR-005"}
"""The switch of an adapter is its author's own: no library has a hint for it."""

WARNED_OF = {
    ("ADR-009", "too_deep_to_read"),
    ("TLS-001", "wrong_error_code"),
    ("TLS-002", "wrong_error_code"),
}
"""The only warnings: the SDK's own parser drops what is nested 200 deep, and who passes the context of the library on does not tell a
failed handshake from a connection that failed."""

USED = {"modbus": {"mcp", "pymodbus"}, "mqtt": {"mcp", "paho-mqtt"}, "opcua": {"mcp", "asyncua"}}

Results = dict[str, dict[str, Any]]
Judge = Callable[[Path, Collection[str] | None], tuple[Results, dict[str, Any]]]


@pytest.fixture(scope="module")
def judge() -> Iterator[Judge]:
    """``judge(file, items)`` runs these items, or all, for a subject file; returns them, and what is known of the adapter."""
    loop, plant = LoopThread(), Plant()

    async def run(file: Path, items: Collection[str] | None) -> tuple[Results, dict[str, Any]]:
        subject = load_subject(file)
        [protocol] = subject.adapters
        own = (task for task in all_tasks().values() if set(task.protocols) == {protocol})
        bench = Bench(subject, BenchOptions(), plant)
        try:
            await bench.prepare(subject.adapters)
            assert bench.drift() == []
            chosen = [task for task in own if items is None or task.id in items]
            results = {task.id: await measured(bench, task) for task in chosen}
            return results, dict(bench.adapters()[protocol])
        finally:
            await bench.close()

    yield lambda file, items: loop.run(run(file, items))
    loop.run(plant.close())
    loop.close()


def violated(item: dict[str, Any]) -> set[str]:
    return {finding["requirement"] or finding["code"] for finding in failing(findings_of(cast(Item, item)))}


def words(results: Results) -> str:
    findings = ((name, one) for name, item in results.items() for one in findings_of(cast(Item, item)))
    return "\n".join(f"{name}: {one['requirement']} {one['message']}" for name, one in findings)


SAMPLED = [pytest.param(*pair, marks=() if pair[0] == "mqtt" else pytest.mark.long) for pair in ADAPTERS.items()]
"""One of them is run in every test run."""


@pytest.mark.parametrize(("name", "protocol"), SAMPLED)
def test_a_first_form_violates_what_the_documents_say_and_is_told_of_its_libraries(
    name: str, protocol: str, judge: Judge
) -> None:
    results, facts = judge(FILES / "first" / f"{name}.toml", SAMPLE[protocol])
    assert {item: " ".join(sorted(violated(found))) for item, found in results.items()} == SAMPLE[protocol]
    assert facts["libraries"] == dict.fromkeys(sorted(USED[protocol]), f"{name}.py")
    for row in {row for rows in SAMPLE[protocol].values() for row in rows.split()} - OWN:
        assert list(advice(row, facts["libraries"])), f"nothing says what to change for {row}"


def test_a_client_that_is_late_is_judged_as_one_that_is_not(judge: Judge, tmp_path: Path) -> None:
    late = tmp_path / "mqtt.toml"
    described = (FILES / "first" / "mqtt.toml").read_text()
    late.write_text(described.replace("{dir}/mqtt.py", str(Path(__file__).with_name("late_mqtt.py"))))
    results, _ = judge(late, ["Q2", "S2", "INJ-002.mqtt"])
    assert {item: " ".join(violated(found)) for item, found in results.items()} == {
        item: SAMPLE["mqtt"][item] for item in results
    }, words(results)


@pytest.mark.parametrize(("name", "protocol"), SAMPLED)
def test_a_second_form_keeps_what_the_first_one_violates(name: str, protocol: str, judge: Judge) -> None:
    results, _ = judge(FILES / f"{name}.toml", SAMPLE[protocol])
    assert {result["status"] for result in results.values()} == {"PASS"}, words(results)


def test_a_tool_that_is_called_only_to_see_whether_it_writes_counts_as_not_called(judge: Judge) -> None:
    results, facts = judge(FILES / "modbus.toml", ["MCP-008.modbus"])
    called = {call["tool"] for sample in results["MCP-008.modbus"]["samples"] for call in sample["calls"]}
    assert "ping" in called
    assert facts["calls"]["ping"] == 0
    assert facts["calls"]["write_register"] > 0


@pytest.mark.long
def test_an_adapter_with_the_default_context_of_its_library_keeps_the_rows_of_security(judge: Judge) -> None:
    results, _ = judge(FILES / "mqtt.toml", [f"TLS-00{number}.mqtt" for number in (1, 2, 3)])
    assert [result["status"] for result in results.values()] == ["PASS"] * 3, words(results)


@pytest.mark.long
@pytest.mark.weekly
@pytest.mark.parametrize("name", ADAPTERS)
def test_a_first_form_violates_these_rows_in_the_whole_suite(name: str, judge: Judge) -> None:
    results, facts = judge(FILES / "first" / f"{name}.toml", None)
    found = set().union(*map(violated, results.values()))
    assert set(VIOLATED[name].split()) - found == set(), words(results)
    assert {row for row in VIOLATED[name].split() if not list(advice(row, facts["libraries"]))} <= OWN


@pytest.fixture(scope="module")
def first_version(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The Python of an environment with version 1 of the SDK."""
    if os.environ.get("OTMCP_NO_NETWORK"):
        pytest.skip("OTMCP_NO_NETWORK forbids to install version 1 of the SDK")
    folder = tmp_path_factory.mktemp("sdk")
    venv.create(folder, with_pip=True)
    python = folder / "bin" / "python"
    subprocess.run(
        [python, "-m", "pip", "install", "--quiet", "mcp==1.30.0", "pymodbus==3.16.1"], check=True, timeout=600
    )
    return str(python)


@pytest.mark.long
@pytest.mark.weekly
@pytest.mark.parametrize("transport", ["stdio", "streamable-http"])
def test_an_adapter_on_version_1_of_the_sdk_violates_the_same_rows(
    transport: str, first_version: str, judge: Judge, tmp_path: Path
) -> None:
    program, described = ((FILES / "first" / f"modbus.{kind}").read_text() for kind in ("py", "toml"))
    program = program.replace("from mcp.server import MCPServer", "from mcp.server.fastmcp import FastMCP")
    made = 'FastMCP("plant-modbus", port=int(os.environ.get("PORT", "0")))'
    program = program.replace('MCPServer("plant-modbus")', made).replace("mcp.run()", f'mcp.run("{transport}")')
    (tmp_path / "modbus.py").write_text(program)
    described = described.replace("{python}", first_version)
    if transport != "stdio":
        url = '\ntransport = "http"\nurl = "http://127.0.0.1:{http_port}/mcp"\nenv = { PORT = "{http_port}",'
        described = described.replace("\nenv = {", url, 1)
    (tmp_path / "otmcp.toml").write_text(described)
    results, _ = judge(tmp_path / "otmcp.toml", None)
    found = set().union(*map(violated, results.values()))
    # A cancellation in stdio ends a session of version 1 in which a call cannot be interrupted.
    ending = {"MCP-007"} if transport == "stdio" else set()
    assert found == {*VIOLATED["modbus"].split()} | ending, words(results)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "protocol"),
    [pytest.param(*pair, marks=() if pair[0] == "modbus" else pytest.mark.weekly) for pair in ADAPTERS.items()],
)
def test_a_second_form_earns_silver(name: str, protocol: str, judge: Judge) -> None:
    results, facts = judge(FILES / f"{name}.toml", None)
    assert results.keys() <= tasks_by_id([protocol], SUITES).keys()
    told = {(one["requirement"], one["code"]) for item in results.values() for one in findings_of(cast(Item, item))}
    assert told <= WARNED_OF, words(results)
    assert {result["status"] for result in results.values()} <= {"PASS", "NOT_APPLICABLE"}
    assert standing(catalogue(), [cast(Item, item) for item in results.values()], protocol).level is Level.SILVER
    assert facts["server_version"] == "1.0.0"


@pytest.mark.long
def test_what_else_a_modbus_adapter_may_offer_can_be_kept_with_stock_parts(judge: Judge) -> None:
    results, _ = judge(Path(__file__).with_name("wide_modbus.toml"), [f"{row}.modbus" for row in WIDE])
    assert {name: item["status"] for name, item in results.items()} == {f"{row}.modbus": "PASS" for row in WIDE}, words(
        results
    )
