"""The certificate for a person repeats the statement and nothing else."""

from __future__ import annotations

import html
import re
from typing import Any

import pytest

from pytest_otmcp.certificate.statement import certificate
from pytest_otmcp.core.matrix import SUITES
from pytest_otmcp.report.certificate_page import certificate_page
from pytest_otmcp.suite.catalogue import tasks_by_id

from .certified import conformant_run

DIGEST = "cd" * 32


@pytest.fixture
def statement() -> dict[str, Any]:
    return certificate(conformant_run(), "ab" * 32, tasks_by_id(suites=SUITES))


def shown(statement: dict[str, Any], *, signed: bool = False) -> str:
    """Return the words of the page."""
    return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", certificate_page(statement, DIGEST, signed=signed))).split())


def test_it_names_the_adapter_and_every_digest(statement: dict[str, Any]) -> None:
    words = shown(statement)
    assert "acme-adapter 1.4.0" in words
    entries = (*statement["subject"], *statement["predicate"]["configuration"])
    assert all(value in words for entry in entries for value in entry["digest"].values())
    assert DIGEST in words


def test_a_level_is_said_with_what_it_allows(statement: dict[str, Any]) -> None:
    told = statement["predicate"]["otmcp"]
    count = told["items"]["Modbus"]
    allowed = "may be connected to a plant for reading, and may write there while a person watches"
    of_modbus = f"This adapter {allowed}. It passed {count['passed']} of {count['of']} Modbus items, all that apply"
    assert f"Modbus, OPC UA: Silver {of_modbus}" in shown(statement)
    told["level"]["awarded"]["modbus"] = None
    words = shown(statement)
    assert "Modbus: no level This adapter has earned no level, which" in words
    assert f"OPC UA: Silver This adapter {allowed}. It passed" in words


def test_what_is_not_claimed_is_there_with_the_reason_of_the_vendor_and_none_of_its_marks(
    statement: dict[str, Any],
) -> None:
    facets = statement["predicate"]["otmcp"]["adapters"]["modbus"]["facets"]
    facets["not_claimed"] = {"ping": "<img src=x onerror=alert(1)>"}
    assert "Modbus: the vendor does not claim it: <img src=x onerror=alert(1)> ( ping )" in shown(statement)
    assert "<img" not in certificate_page(statement, DIGEST, signed=False)


def test_the_walls_that_stood_and_those_that_were_missing_are_said(statement: dict[str, Any]) -> None:
    walls = {"seen": ["No address outside this run could be reached."], "missing": ["No wall around files: refused."]}
    statement["predicate"]["otmcp"]["isolation"] = walls
    words = shown(statement)
    assert "Walls No address outside this run could be reached. No wall around files: refused." in words
    assert words.count("Walls") == 1


def test_the_program_that_was_started_is_named_with_its_digest(statement: dict[str, Any]) -> None:
    tested = {
        "program": "acme-modbus",
        "program_sha256": f"sha256:{'e' * 64}",
        "files": 3,
        "files_sha256": f"sha256:{'f' * 64}",
        "packages": 1,
        "packages_sha256": f"sha256:{'0' * 64}",
        "image": None,
    }
    statement["predicate"]["otmcp"]["adapters"]["modbus"]["tested"] = tested
    page = shown(statement)
    assert f"Modbus: acme-modbus sha256 {'e' * 64}" in page
    assert f"Modbus: 3 files of its own sha256 {'f' * 64}" in page
    assert f"Modbus: 1 package sha256 {'0' * 64}" in page
    assert "own files" not in page
    tested |= {"files": 0, "files_sha256": None}
    assert "Modbus: own files none that the kit knows: the digest is that of acme-modbus" in shown(statement)


def test_a_run_for_a_challenge_names_it(statement: dict[str, Any]) -> None:
    assert "challenge" not in shown(statement)
    statement["predicate"]["otmcp"]["settings"]["challenge"] = "buyer-2026-11-26-7f3a9c"
    words = shown(statement)
    assert (
        f"on {statement['predicate']['otmcp']['measured_at']}, for the challenge buyer-2026-11-26-7f3a9c , by" in words
    )
    assert "otmcp verify --challenge buyer-2026-11-26-7f3a9c certificate.json run.json" in words


@pytest.mark.parametrize(
    ("signed", "command"),
    [
        (False, "otmcp verify certificate.json run.json"),
        (True, "otmcp verify --trust allowed_signers certificate.json run.json"),
    ],
)
def test_it_says_how_to_check_it(statement: dict[str, Any], signed: bool, command: str) -> None:
    assert command in shown(statement, signed=signed)
    words = shown(statement, signed=signed)
    assert ("t is not signed" in words) is not signed
    assert ("the signature says who that was" in words) is signed


def test_what_the_items_used_and_what_they_did_not_read_is_named(statement: dict[str, Any]) -> None:
    facts = statement["predicate"]["otmcp"]["adapters"]["modbus"]
    facts["facets"]["earned"], facts["outputs_not_judged"] = {"ping": ["M1"], "write_coil": ["WR-001.modbus"]}, []
    assert "Modbus: ping , write_coil ." in shown(statement)
    facts["outputs_not_judged"] = ["write_coil.value"]
    assert "Modbus: not found in its answers ( write_coil.value )" in shown(statement)


def test_what_was_not_tested_stands_above_the_digests(statement: dict[str, Any]) -> None:
    told = statement["predicate"]["otmcp"]
    told["adapters"]["modbus"]["facets"]["claimed_not_exercised"] = ["publish.qos"]
    why = "modbus.commands: the subject file has no named commands"
    told["not_applicable"] = {
        "WR-014.modbus": why,
        "ADR-003.modbus": why,
        "Q1": "mqtt.info: the subject has no adapter for MQTT",
    }
    words = shown(statement)
    assert "MQTT" not in words
    for told_of in (
        "Modbus: claimed, and no item needed it ( publish.qos )",
        "Modbus: named commands: the subject file has no named commands ( WR-014, ADR-003 )",
    ):
        assert words.index("What was not tested") < words.index(told_of) < words.index("What was tested")
    assert "by the vendor or whom he asked: it is not signed." in words


def test_a_reason_stands_once_and_without_values_that_were_drawn(statement: dict[str, Any]) -> None:
    inexpressible = "no named command of the subject can express write_holding with address=1, value="
    statement["predicate"]["otmcp"]["not_applicable"] = {
        "FM2": f"{inexpressible}70000",
        "CON-004": f"{inexpressible}17",
    }
    assert (
        "no named command of the subject can express write_holding with the values asked for ( FM2, CON-004 )"
        in shown(statement)
    )


def test_tools_that_were_never_called_are_named() -> None:
    record = conformant_run()
    record["subject"]["adapters"]["modbus"]["calls"] = {"flip": 0, "read": 7, "reset": 0}
    statement = certificate(record, "ab" * 32, tasks_by_id(suites=SUITES))
    assert statement["predicate"]["otmcp"]["adapters"]["modbus"]["tools_never_called"] == ["flip", "reset"]
    assert "Modbus: tools whose answers were never judged ( flip, reset )" in shown(statement)
