"""Voluntary facets are claimed by a binding and in no other way; a file without one says nothing about them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import pytest

from pytest_otmcp.cli.call import _check_filling, _inputs
from pytest_otmcp.core.errors import UsageError
from pytest_otmcp.core.verdict import Status
from pytest_otmcp.protocols.modbus.tags import TAGS, Tag
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.subject import Adapter, Binding, load_subject, reference_subject
from pytest_otmcp.subject.claims import Claims
from pytest_otmcp.suite.catalogue import tasks_by_id
from pytest_otmcp.trial.applicability import applicability

HEAD = """
[subject]
name = "x"
version = "1"
[adapter.modbus]
command = ["adapter"]
answer = "json"
"""
READ = """
[adapter.modbus.bind.read_holding]
tool = "read"
arguments = { register = "$address", count = "$count" }
result.values = "values"
"""
READ_OF_A_UNIT = READ.replace('"$count" }', '"$count", slave = "$unit", more = { slaves = ["$unit"] } }')
COILS = """
[adapter.modbus.bind.read_coils]
tool = "coils"
arguments = { first = "$address", count = "$count" }
result.values = "values"
"""


def adapter(tmp_path: Path, *tables: str) -> Adapter:
    (tmp_path / "otmcp.toml").write_text(HEAD + "".join(tables), encoding="utf-8")
    return load_subject(tmp_path / "otmcp.toml").adapters["modbus"]


def claims(described: Adapter) -> Claims:
    """Return the claims of an adapter, and make sure that its record has the same."""
    of_subject = Claims.of_subject({"modbus": described})
    of_record = Claims.of_record({"modbus": json.loads(json.dumps(described.facts()))})
    for facet in protocols()["modbus"].facets:
        assert of_subject.why_not(f"modbus.{facet}") == of_record.why_not(f"modbus.{facet}")
    return of_subject


def case(described: Adapter, operation: str) -> Binding:
    bound = described.operations[operation]
    assert isinstance(bound, tuple)
    return bound[0]


def test_a_file_that_binds_nothing_voluntary_says_nothing_of_it(tmp_path: Path) -> None:
    described = adapter(tmp_path, READ)
    told = claims(described)
    assert described.offered == ()
    assert "offered" not in described.facts()
    assert described.facts()["unclaimed"] == {}
    assert told.is_silent("modbus.read_coils")
    assert told.why_not("modbus.read_coils") == "no tool is bound to it"
    assert told.why_not("modbus.read_holding.unit") == "no binding of 'read_holding' has 'unit'"
    assert told.has("modbus.read_holding")
    assert not told.is_silent("modbus.write_holding")


def test_a_binding_claims_its_operation_and_the_inputs_that_it_has_a_place_for(tmp_path: Path) -> None:
    described = adapter(tmp_path, READ_OF_A_UNIT, COILS)
    told = claims(described)
    assert described.facts()["offered"] == ["read_holding.unit", "read_coils"]
    assert told.has("modbus.read_coils")
    assert told.has("modbus.read_holding.unit")
    assert not told.has("modbus.read_coils.unit")


def test_a_task_that_needs_what_is_not_bound_does_not_apply(tmp_path: Path) -> None:
    task = replace(tasks_by_id()["M1"], needs=("modbus.read_coils", "modbus.read_holding.unit"))
    assert applicability(task, {"modbus": adapter(tmp_path, READ_OF_A_UNIT, COILS)}) is None
    without = applicability(task, {"modbus": adapter(tmp_path, READ_OF_A_UNIT)})
    assert without == (Status.NOT_APPLICABLE, "modbus.read_coils is not claimed: no tool is bound to it")


def test_what_is_bound_may_be_declared_as_unclaimed_with_a_reason(tmp_path: Path) -> None:
    described = adapter(tmp_path, 'unclaimed = { read_coils = "not yet" }\n', READ, COILS)
    told = claims(described)
    assert told.why_not("modbus.read_coils") == "not yet"
    assert not told.is_silent("modbus.read_coils")


def test_the_argument_for_an_input_that_is_not_given_is_left_out(tmp_path: Path) -> None:
    read = case(adapter(tmp_path, READ_OF_A_UNIT), "read_holding")
    asked = {"address": 3, "count": 1}
    assert read.fill(asked, {}) == {"register": 3, "count": 1, "more": {"slaves": []}}
    assert read.fill({**asked, "unit": 7}, {}) == {"register": 3, "count": 1, "slave": 7, "more": {"slaves": [7]}}


def test_the_calls_of_the_paper_are_what_they_were() -> None:
    modbus, mqtt = (reference_subject().adapters[key] for key in ("modbus", "mqtt"))
    assert case(modbus, "read_holding").fill({"address": 1, "count": 2}, {}) == {"address": 1, "count": 2}
    message = {"topic": "a", "payload": "b", "qos": 0}
    assert case(mqtt, "publish").fill(message, {}) == message


def test_a_call_may_leave_voluntary_inputs_out_and_no_others(tmp_path: Path) -> None:
    described = adapter(tmp_path, READ_OF_A_UNIT)
    operation = protocols()["modbus"].operations["read_holding"]
    assert _inputs("read_holding", operation, ["address=1", "count=2"]) == {"address": 1, "count": 2}
    given = _inputs("read_holding", operation, ["address=1", "count=2", "unit=7"])
    _check_filling(described, "read_holding", {"address": 1, "count": 2})
    _check_filling(described, "read_holding", given)
    with pytest.raises(UsageError, match="count must be given"):
        _inputs("read_holding", operation, ["address=1", "unit=7"])


def test_a_function_claims_the_voluntary_inputs_that_it_has(tmp_path: Path) -> None:
    (tmp_path / "bindings.py").write_text(
        "async def read_holding(tools, *, address, count, unit=None):\n    return {'values': []}\n"
        "async def write_coil(tools, *, address, value):\n    return {}\n",
        encoding="utf-8",
    )
    described = adapter(tmp_path, 'bindings = "bindings.py"\n')
    claims(described)
    assert described.offered == ("read_holding.unit", "write_coil")
    compared = load_subject(tmp_path / "otmcp.toml", run=False).adapters["modbus"]
    assert compared.facts() == described.facts()


def test_an_adapter_that_writes_nothing_but_coils_needs_a_guard_for_a_certificate(tmp_path: Path) -> None:
    from pytest_otmcp.certificate.eligibility import unguarded

    unclaimed = 'unclaimed = { guard = "none", write_holding = "none" }\n'
    coil = '[adapter.modbus.bind.write_coil]\ntool = "coil"\narguments = { at = "$address", on = "$value" }\n'
    assert list(unguarded(claims(adapter(tmp_path, unclaimed, READ)), ["modbus"])) == []
    assert len(list(unguarded(claims(adapter(tmp_path, unclaimed, READ, coil)), ["modbus"]))) == 1


def test_every_operation_that_changes_the_plant_says_so() -> None:
    reading = ("read", "browse", "variables", "ping", "info", "messages", "subscri", "unsub", "decode", "sparkplug")
    for protocol in ("modbus", "mqtt", "opcua"):
        for name, operation in protocols()[protocol].operations.items():
            assert operation.writes is not name.startswith(reading), name


def test_the_reference_adapter_is_launched_with_the_tags_that_checks_know() -> None:
    content = json.loads(reference_subject().adapters["modbus"].variants["rw"].files["tags.json"])
    configured = {name: cast("dict[str, Any]", tag) for name, tag in content.items()}
    assert {name: _tag(tag) for name, tag in configured.items()} == dict(TAGS)


def _tag(configured: dict[str, Any]) -> Tag:
    table = f"{configured.pop('table', 'holding')}_registers"
    return Tag(table=table, writable=configured.pop("writable", False), **configured)
