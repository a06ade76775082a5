"""The suite accuses no honest adapter: each passes every item, with exactly the warnings that are due."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

from pytest_otmcp.core.matrix import REQUIREMENTS
from pytest_otmcp.subject import Adapter, reference_subject
from pytest_otmcp.suite.catalogue import all_tasks
from pytest_otmcp.trial.applicability import applicability

from .conftest import Judge, Results, failing, passing, requirements, words
from .honest.zoo import ZOO

QUICK = {
    "modbus": "M1 M2 M3 M4",
    "mqtt": "Q1 Q2 Q3 Q4",
    "opcua": "O1 O3 FO1",
    "s7": "K1 K2 K3 ENC-003.s7 WR-004.s7 ENC-004.s7 ENC-006.s7",
    "dnp3": "D2 D5 D7 WR-001.dnp3",
    "bacnet": "B2 B3 FB1",
    "ethernetip": "E2 E3 FE1",
    "profibus": "P2 P3 FP1",
    "ethercat": "C2 C3 C4 C5 C6 FC1 FC4",
    "profinet": "N2 N3 N4 FN1",
}
"""Items that most choices show in, by protocol."""

CLOSEST = """
    mcp/no-text-block modbus/split-reads modbus/block-reads
    mqtt/retained-online mqtt/status-from-a-declared-cache
    mqtt/always-qos-1 mqtt/delivers-again-with-dup
    opcua/reads-by-monitored-items opcua/browses-before-reading
    s7/few-types s7/short-texts dnp3/events-beside-a-read dnp3/no-pulses
    bacnet/reads-all-properties ethernetip/symbol-instances
    ethercat/inputs-by-process-data ethercat/refuses-by-its-description ethercat/in-op-from-the-first-call
    profinet/inputs-of-the-next-frame profinet/reads-as-a-supervisor
""".split()
"""Some of those that are closest to what the suite forbids; earlier suites accused each of them."""

CHECKED = [name for name in CLOSEST if name.startswith("modbus/")][:1]
"""Those that the requirement suite judges with the long tests: a minute or two each, and four where a device is silent in outages."""


NEIGHBOURS = [
    ("mqtt/host-application", "Q1 Q4 SPB-010.mqtt SPB-013.mqtt WR-004.mqtt WR-010.mqtt"),
    ("mcp/announces-new-descriptions", "MCP-010.modbus"),
    ("mcp/fills-a-cache-and-a-pool", "RES-001.modbus"),
    ("mcp/collects-late", "RES-001.modbus"),
    ("mqtt/publishing-only-adds", "MCP-008.mqtt"),
    ("mcp/few-annotations", "M3 MCP-008.modbus"),
    ("mcp/describes-in-other-scripts", "MCP-012.modbus MCP-013.modbus"),
    ("mcp/has-many-short-tools", "MCP-012.modbus MCP-013.modbus"),
    ("mqtt/says-which-settings-it-has", "KEY-001.mqtt"),
    ("mqtt/helper-with-the-password", "KEY-001.mqtt"),
    ("opcua/reads-before-browsing", "OUA-006.opcua"),
    ("modbus/asks-three-times", "TMO-001.modbus TMO-002.modbus"),
    ("modbus/gives-up-what-waits", "TMO-001.modbus"),
    ("s7/reads-again-after-silence", "TMO-002.s7"),
    (
        "bacnet/writes-by-multiple",
        "B3 FB2 SB4 ADR-003.bacnet CON-004.bacnet TMO-003.bacnet TMO-004.bacnet WR-001.bacnet WR-002.bacnet WR-003.bacnet",
    ),
    ("bacnet/reads-all-properties", "TMO-002.bacnet"),
    ("profibus/asks-for-any-station", "ADR-002.profibus"),
    ("ethercat/reads-again-after-silence", "TMO-002.ethercat"),
    ("ethercat/texts-end-at-zero", "ENC-006.ethercat"),
    ("ethercat/inputs-by-process-data", "RD-001.ethercat RD-004.ethercat CON-001.ethercat"),
    ("opcua/looks-before-writing", "O3 OUA-005.opcua WR-001.opcua WR-002.opcua"),
    ("opcua/writes-one-by-one", "WR-001.opcua WR-002.opcua WR-006.opcua CON-004.opcua"),
]
"""Honest adapters, each with the check that it is made for."""


def warnings(results: Results) -> Iterator[tuple[str | None, str]]:
    for result in results.values():
        for findings in (result["findings"], *(sample["findings"] for sample in result["samples"])):
            for finding in findings:
                if finding["strength"] == "SHOULD":
                    yield finding["requirement"], finding["code"]


def some(names: list[str], step: int) -> list[Any]:
    """Return each ``step``-th name for the fast lane, and the others for the long one."""
    return [pytest.param(name, marks=pytest.mark.long if number % step else ()) for number, name in enumerate(names)]


def accused_of_nothing(judge: Judge, name: str, tasks: str | None) -> None:
    choice = ZOO[name]
    results = judge(choice.protocol, "honest/adapter.py", name, described=choice.described, tasks=tasks)
    assert failing(results) == set(), words(results)
    # An adapter with a vocabulary of its own lacks most operations; every other one has them all.
    own = name.startswith("commands/")
    left_out = {item for item, result in results.items() if own and result["status"] == "NOT_APPLICABLE"}
    assert passing(results) == results.keys() - left_out != set()
    assert set(warnings(results)) == choice.warnings, words(results)


@pytest.mark.parametrize("name", some(CLOSEST, len(CLOSEST)))
def test_an_honest_adapter_is_accused_of_nothing_in_the_items_that_say_most(judge: Judge, name: str) -> None:
    accused_of_nothing(judge, name, QUICK[ZOO[name].protocol])


@pytest.mark.parametrize("name", some([name for name in ZOO if name.startswith("texts/")], 4))
def test_an_honest_adapter_that_treats_texts_otherwise_is_accused_of_nothing(judge: Judge, name: str) -> None:
    accused_of_nothing(judge, name, " ".join(f"INJ-00{number}.{ZOO[name].protocol}" for number in (1, 2, 3)))


@pytest.mark.parametrize("name", [name for name in ZOO if name.startswith("bounds/")])
@pytest.mark.long
def test_an_honest_adapter_that_keeps_bounds_in_its_own_way_is_accused_of_nothing(judge: Judge, name: str) -> None:
    protocol = ZOO[name].protocol
    accused_of_nothing(judge, name, f"WR-006.{protocol} WR-007.{protocol}")


@pytest.mark.long
@pytest.mark.parametrize("name", ["tls-1-2-alone", "compares-hosts-after-the-handshake", "security-is-a-connection"])
def test_an_honest_adapter_with_security_of_another_form_is_accused_of_nothing(judge: Judge, name: str) -> None:
    choice = ZOO[f"modbus/{name}"]
    checks = " ".join(f"TLS-00{number}.modbus" for number in (1, 2, 3, 4))
    results = judge("modbus", "honest/adapter.py", f"modbus/{name}", described=choice.described, tasks=checks)
    assert passing(results) == results.keys(), words(results)
    assert set(warnings(results)) == choice.checked_warnings, words(results)


@pytest.mark.long
@pytest.mark.parametrize("name", [name for name in ZOO if name.startswith("callers/")])
def test_an_honest_adapter_that_knows_its_callers_in_another_way_is_accused_of_nothing(judge: Judge, name: str) -> None:
    choice = ZOO[name]
    check = f"MCP-011.{choice.protocol}"
    results = judge(choice.protocol, "honest/adapter.py", name, described=choice.described, tasks=check)
    assert passing(results) == {check}, words(results)
    assert set(warnings(results)) == choice.checked_warnings, words(results)


SECURITY = ("SEC-001", "SEC-002", "AUD-001", "AUD-002", "AUD-003", "APR-001", "APR-002", "APR-003")
UNCLAIMED = {
    "security/asks-outside": {"APR-003"},
    "security/database": {"AUD-002"},
    "security/policy-alone": {"AUD-001", "AUD-002", "AUD-003"},
}


@pytest.mark.parametrize(
    "name",
    [
        # A minute each.
        pytest.param(name, marks=() if name in UNCLAIMED else pytest.mark.weekly)
        for name in ZOO
        if name.startswith("security/")
    ],
)
@pytest.mark.long
def test_an_honest_adapter_with_security_of_another_design_is_accused_of_nothing(judge: Judge, name: str) -> None:
    choice = ZOO[name]
    tasks = {row: f"{row}.{choice.protocol}" for row in SECURITY}
    results = judge(
        choice.protocol, "honest/adapter.py", name, described=choice.described, tasks=" ".join(tasks.values())
    )
    assert failing(results) == set(), words(results)
    assert {row for row, task in tasks.items() if results[task]["status"] == "NOT_APPLICABLE"} == UNCLAIMED.get(
        name, set()
    )
    assert set(warnings(results)) == choice.warnings, words(results)


@pytest.mark.parametrize("program", ["true", "false", "no anchor"])
@pytest.mark.long
def test_a_verifier_that_does_not_verify_is_noticed(judge: Judge, program: str) -> None:
    check = "AUD-002.modbus"

    def described(adapter: Adapter) -> Adapter:
        assert adapter.governed is not None
        verify = adapter.governed.verify[:-2] if program == "no anchor" else (program,)
        return replace(adapter, governed=replace(adapter.governed, verify=verify))

    results = judge("modbus", "-P", "-m", "pytest_otmcp.reference_adapters", "modbus", described=described, tasks=check)
    assert failing(results) == {check}, words(results)
    assert requirements(results) == {"AUD-002"}, words(results)


def test_an_adapter_without_security_is_accused_of_nothing() -> None:
    adapters = {
        protocol: replace(
            adapter,
            governed=None,
            tokens=None,
            variants={name: one for name, one in adapter.variants.items() if name not in ("governed", "tokens")},
        )
        for protocol, adapter in reference_subject().adapters.items()
    }
    for task in all_tasks().values():
        if task.id.partition(".")[0] in (*SECURITY, "MCP-011"):
            found = applicability(task, adapters)
            assert found is not None
            assert found[0] == "NOT_APPLICABLE", task.id


@pytest.mark.parametrize("name", [name for name in ZOO if name.startswith("commands/")])
@pytest.mark.long
def test_an_honest_adapter_with_commands_of_another_form_is_accused_of_nothing(judge: Judge, name: str) -> None:
    protocol = ZOO[name].protocol
    accused_of_nothing(judge, name, f"WR-003.{protocol} WR-004.{protocol} WR-010.{protocol} WR-014.{protocol}")


@pytest.mark.long
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(
            name,
            # Few of them, and every fourth of those that are closest to what the suite forbids, run with the long tests.
            marks=() if name in CLOSEST[::4] or not number % 80 else pytest.mark.weekly,
        )
        for number, name in enumerate(ZOO)
    ],
)
def test_an_honest_adapter_is_accused_of_nothing_in_the_whole_suite(judge: Judge, name: str) -> None:
    accused_of_nothing(judge, name, None)


@pytest.mark.long
@pytest.mark.parametrize(
    "name",
    # A minute each.
    [pytest.param(name, marks=() if name in CHECKED else pytest.mark.weekly) for name in ZOO],
)
def test_an_honest_adapter_is_accused_of_nothing_in_the_requirement_suite(judge: Judge, name: str) -> None:
    choice = ZOO[name]
    checks = " ".join(task.id for task in all_tasks().values() if task.suite == REQUIREMENTS)
    results = judge(choice.protocol, "honest/adapter.py", name, described=choice.described, tasks=checks)
    assert failing(results) == set(), words(results)
    assert set(warnings(results)) <= choice.warnings | choice.checked_warnings, words(results)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "checks"),
    [
        ("mcp/streamable-http", "ADR-009.modbus"),
        ("opcua/localized-texts-as-objects", "RD-001.opcua ENC-006.opcua"),
        ("mcp/no-answer-to-what-is-too-deep", "ADR-009.modbus"),
        ("mcp/parse-error-for-what-is-too-deep", "ADR-009.modbus"),
        ("mcp/utc-as-an-offset", "M1 FM1 ENV-001.modbus ENC-007.modbus"),
        ("modbus/deaf-to-cancellation", "TMO-003.modbus CON-005.modbus"),
        ("opcua/deaf-to-cancellation", "TMO-003.opcua"),
        ("opcua/subscription-in-every-session", "O1 S12 REC-006.opcua"),
        ("modbus/blocks-of-32", "WR-001.modbus WR-002.modbus WR-004.modbus WR-008.modbus"),
        ("modbus/blocks-of-2", "WR-001.modbus WR-002.modbus WR-008.modbus WR-009.modbus"),
        ("modbus/reads-of-8", "RD-001.modbus RD-006.modbus RD-007.modbus ENC-003.modbus"),
        ("modbus/values-up-to-1000", "WR-001.modbus WR-003.modbus CON-004.modbus ADR-003.modbus"),
        ("ethernetip/reads-with-another-tag", "TMO-002.ethernetip INJ-001.ethernetip"),
        ("modbus/reads-before-writing", "WR-006.modbus AUD-003.modbus"),
        ("modbus/blocks-of-2", "WR-006.modbus SEC-001.modbus"),
        ("modbus/values-up-to-1000", "WR-006.modbus SEC-001.modbus"),
        ("commands/writes-blocks-of-one", "MCP-001.modbus MCP-010.modbus"),
        ("bacnet/small-answers", "ENC-006.bacnet"),
        ("profibus/checks-the-configuration", "AUD-002.profibus"),
        ("dnp3/reads-before-operating", "AUD-003.dnp3"),
        ("ethernetip/asks-for-the-type-each-time", "AUD-003.ethernetip"),
        ("ethernetip/symbol-instances", "MCP-008.ethernetip WR-001.ethernetip"),
        ("mqtt/short-payloads", "Q3 MQT-001.mqtt MQT-003.mqtt ADR-007.mqtt WR-003.mqtt"),
        ("mqtt/encoding-required", "Q3 S5 S11 MQT-001.mqtt MQT-003.mqtt TMO-003.mqtt ENC-006.mqtt"),
        ("mqtt/data-by-alias-alone", "Q4 SPB-001.mqtt SPB-004.mqtt SPB-008.mqtt"),
        ("mqtt/every-payload-as-base64", "Q2 S2 S11 MQT-003.mqtt MQT-004.mqtt ENC-006.mqtt"),
    ],
)
def test_an_honest_adapter_that_a_check_once_accused_is_accused_no_more(judge: Judge, name: str, checks: str) -> None:
    choice = ZOO[name]
    results = judge(choice.protocol, "honest/adapter.py", name, described=choice.described, tasks=checks)
    assert passing(results) == set(checks.split()), words(results)


@pytest.mark.long
@pytest.mark.parametrize(("name", "checks"), NEIGHBOURS)
def test_an_adapter_that_is_close_to_what_a_check_forbids_passes_it(judge: Judge, name: str, checks: str) -> None:
    choice = ZOO[name]
    results = judge(choice.protocol, "honest/adapter.py", name, described=choice.described, tasks=checks)
    assert passing(results) == set(checks.split()), words(results)
    assert set(warnings(results)) == choice.warnings, words(results)
