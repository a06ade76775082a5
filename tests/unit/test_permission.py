"""What a run permits: what its levels say and a certificate confirms, and nothing without a level."""

from __future__ import annotations

from typing import Any, cast

import pytest

from pytest_otmcp.report import Run
from pytest_otmcp.report.permission import permission

from .certified import conformant_run
from .samples import run, written_twice

SILVER = "may be connected to a plant for reading, and may write there while a person watches."
NO_CERTIFICATE = " This report is no certificate: ask for one before you connect."


def broken(record: dict[str, Any]) -> Run:
    (read,) = (item for item in record["items"] if item["id"] == "RD-001.modbus")
    finding = {"code": "wrong_value", "message": "values differ", "requirement": "RD-001", "evidence": None}
    read["status"] = "FAIL"
    read["samples"][0] |= {"ok": False, "findings": [finding | {"strength": "MUST", "cause": None}]}
    return cast(Run, record)


@pytest.mark.parametrize(("certified", "more"), [(True, ""), (False, NO_CERTIFICATE)])
def test_levels_permit_what_they_say_where_there_is_a_certificate(certified: bool, more: str) -> None:
    assert permission(cast(Run, conformant_run()), certified=certified) == f"Modbus, OPC UA: {SILVER}{more}"


def test_a_protocol_without_a_level_is_not_permitted_beside_one_that_has_one() -> None:
    told = f"OPC UA: {SILVER} Modbus: no permission to connect follows.{NO_CERTIFICATE}"
    assert permission(broken(conformant_run())) == told


def test_without_a_level_nothing_is_permitted() -> None:
    assert permission(run([written_twice()])) == "No permission to connect follows."
