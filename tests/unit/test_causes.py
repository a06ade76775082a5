"""The causes of a run's findings: one for each rule that an adapter does not keep."""

from __future__ import annotations

from typing import Any, cast

import pytest

from pytest_otmcp.core.finding_registry import finding_codes
from pytest_otmcp.core.matrix import CROSS_PROTOCOL
from pytest_otmcp.record.schema import Item, Run
from pytest_otmcp.record.warnings import passed_beside
from pytest_otmcp.report.causes import Cause, causes, extent, rows
from pytest_otmcp.report.overview import requirements as requirement_rows
from pytest_otmcp.suite.requirements import requirements

from .samples import call, item, run


def finding(message: str, requirement: str | None = "WR-001", **more: str) -> dict[str, Any]:
    return {
        "code": "not_written_once",
        "message": message,
        "requirement": requirement,
        "evidence": None,
        "strength": "MUST",
        **more,
    }


def failing(name: str, family: str, *found: dict[str, Any], around: tuple[dict[str, Any], ...] = ()) -> dict[str, Any]:
    made = item(name, "normal", family, f"title of {name}", [1.0, 2.0])
    made |= {"status": "FAIL", "findings": list(around)}
    made["samples"][1] |= {"ok": False, "findings": list(found)}
    return made


def causes_of(*items: dict[str, Any]) -> list[Cause]:
    return causes(cast(Run, run(list(items))))


def test_a_run_without_findings_has_no_cause() -> None:
    assert causes_of(item("M1", "normal", "Modbus", "a title", [1.0])) == []


def test_findings_that_differ_in_values_alone_are_one_cause() -> None:
    (cause,) = causes_of(
        failing("M3", "Modbus", finding("should have seen one write of [40] to holding_registers 1, it saw 0")),
        failing("S4", "Modbus", finding("should have seen one write of [977] to holding_registers 20, it saw 0")),
    )
    assert (cause.items, cause.where["id"], cause.repetition, cause.times) == (("M3", "S4"), "M3", 1, 2)
    assert cause.first["message"].endswith("[40] to holding_registers 1, it saw 0")
    assert cause.further == ()


def test_other_words_about_the_same_rule_are_told_once() -> None:
    (cause,) = causes_of(
        failing("M3", "Modbus", finding("one write of [40], it saw 0"), finding("point 1 should hold 40, it holds 3")),
        failing("S4", "Modbus", finding("one write of [41], it saw 0"), finding("point 2 should hold 41, it holds 0")),
    )
    assert cause.further == ("point 1 should hold 40, it holds 3",)


def test_a_closing_check_that_finds_the_same_is_no_other_kind_of_finding() -> None:
    (cause,) = causes_of(
        failing("M3", "Modbus", finding("one write of [40], it saw 0")),
        failing("M4", "Modbus", around=(finding("control: one write of [999], it saw 0"),)),
    )
    assert (cause.items, cause.further) == (("M3", "M4"), ())


def test_two_rules_and_two_protocols_are_different_causes() -> None:
    found = causes_of(
        failing("M3", "Modbus", finding("wrote twice", "WR-003"), finding("wrote elsewhere", "WR-002")),
        failing("O3", "OPC UA", finding("wrote twice", "WR-003")),
    )
    assert [(cause.family, cause.rule) for cause in found] == [
        ("Modbus", "WR-003"),
        ("Modbus", "WR-002"),
        ("OPC UA", "WR-003"),
    ]


def test_a_finding_without_a_requirement_is_told_by_its_kind() -> None:
    (cause,) = causes_of(failing("M3", "Modbus", finding("expected success", None, code="not_successful")))
    assert (cause.rule, cause.statement) == ("not_successful", "")


def test_a_cause_states_its_rule() -> None:
    (cause,) = causes_of(failing("M3", "Modbus", finding("it wrote twice", "WR-003")))
    assert cause.statement == requirements()["WR-003"].statement


def test_a_finding_about_several_protocols_belongs_to_the_protocol_with_the_same_words() -> None:
    found = causes_of(
        failing("M3", "Modbus", finding("the device saw 0 writes of [40]")),
        failing("O3", "OPC UA", finding("the server saw 0 writes of 'a'")),
        failing("X2", CROSS_PROTOCOL, finding("the server saw 0 writes of 'b'")),
    )
    assert [(cause.family, cause.items) for cause in found] == [("Modbus", ("M3",)), ("OPC UA", ("O3", "X2"))]


def test_a_finding_about_several_protocols_that_two_may_have_caused_is_a_cause_of_its_own() -> None:
    found = causes_of(
        failing("M3", "Modbus", finding("the device saw 0 writes")),
        failing("O3", "OPC UA", finding("the server saw 0 writes")),
        failing("X2", CROSS_PROTOCOL, finding("nothing was written")),
    )
    assert [(cause.family, cause.items) for cause in found][-1] == (CROSS_PROTOCOL, ("X2",))


def test_a_warning_is_no_cause() -> None:
    assert causes_of(failing("M1", "Modbus", finding("no text block", "MCP-006", strength="SHOULD"))) == []


def test_a_cause_names_what_to_change_in_a_library_that_the_adapter_was_seen_to_use() -> None:
    told = run([failing("M3", "Modbus", finding("wrote twice", "WR-003"), finding("wrote elsewhere", "WR-002"))])
    twice, elsewhere = causes(cast(Run, told))
    assert (twice.by_library, elsewhere.by_library) == ((), ())
    told["subject"]["adapters"]["modbus"]["libraries"] = {"pymodbus": "server.py", "mcp": "server.py"}
    twice, elsewhere = causes(cast(Run, told))
    assert [change.partition("`retries=0`")[:2] for change in twice.by_library] == [("pymodbus: ", "`retries=0`")]
    assert twice.by_library[0].endswith("(otmcp docs by-library#pymodbus)")
    assert elsewhere.by_library == ()


def test_a_change_in_a_library_is_named_where_it_answers_the_finding_alone() -> None:
    refused = finding("error code should be illegal_value, it is 'range_overflow'", "ERR-003")
    told = run([failing("ERR-003.opcua", "OPC UA", refused)])
    told["subject"]["adapters"]["opcua"]["libraries"] = {"asyncua": "server.py"}
    for code, names in (("not_refused", True), ("wrong_error_code", False)):
        refused["code"] = code
        (cause,) = causes(cast(Run, told))
        assert any("get_children" in change for change in cause.by_library) == names


NOISE = {
    **finding("1 line(s) on stdout that are no MCP message, the first: 'Connected'", "MCP-001"),
    "code": "stdout_noise",
}


def test_of_a_fault_of_the_session_it_is_said_how_many_items_have_no_other_one() -> None:
    quiet = [failing(name, "Modbus", around=(NOISE,)) for name in ("M1", "M2")]
    for entry in quiet:
        entry["samples"][1] |= {"ok": True}
    noise, write = causes_of(*quiet, failing("M3", "Modbus", finding("one write, it saw 0"), around=(NOISE,)))
    assert (noise.rule, noise.items, noise.alone) == ("MCP-001", ("M1", "M2", "M3"), 2)
    assert extent(noise) == "2 of 3 items have no other finding"
    assert extent(write) == ""


def test_the_extent_of_a_fault_in_one_item_is_not_told() -> None:
    (cause,) = causes_of(failing("M1", "Modbus", around=(NOISE,)))
    assert extent(cause) == ""


def test_an_item_that_failed_for_the_session_alone_shows_its_rules_and_no_other() -> None:
    quiet = failing("M1", "Modbus", around=(NOISE,)) | {"requirements": ["RD-004"]}
    quiet["samples"][1] |= {"ok": True}
    rows = dict(requirement_rows(cast(Run, run([quiet]))))
    assert rows["RD-004"]["Modbus"].state == "kept"
    assert rows["MCP-001"]["Modbus"].state == "violated"
    assert not passed_beside(cast(Item, failing("M1", "Modbus", finding("one write, it saw 0"), around=(NOISE,))))
    assert not passed_beside(cast(Item, {**quiet, "findings": []}))


@pytest.mark.parametrize(
    ("code", "message", "said"),
    [
        (
            "not_refused",
            "w(a=1): expected an error envelope with code x or y, it claims success",
            "an error with code x or y",
        ),
        ("wrong_error_code", "r(): error code should be timeout, it is 'gone'", "an error with code timeout"),
        (
            "wrong_outcome",
            "w(): error outcome should be unknown, it is 'not_sent'",
            "an error whose outcome is unknown",
        ),
        ("not_successful", "r(): expected success, got error 'x': value should be 3, the reply says 4", "success"),
        ("no_reply", "r(): no reply within the deadline of 5 s", "an answer within 5 s"),
        ("wrong_value", "r(a=1): values should be [40], the reply says [5206]", "values [40]"),
        ("wrong_value", "r(): expected the server timestamp T, the reply says 'U'", "the server timestamp T"),
        # What the device holds, and what an adapter wrote, do not tell what it should have said.
        ("device_differs", "1/coils/4 should hold True, the device holds False", ""),
        ("stdout_noise", "1 line(s), the first: 'r(): value should be 3, the reply says 4'", ""),
    ],
)
def test_what_was_due_is_told_where_the_finding_tells_and_never_invented(code: str, message: str, said: str) -> None:
    (cause,) = causes_of(failing("M3", "Modbus", finding(message, code=code)))
    assert cause.due == said


def test_a_card_is_about_the_call_that_its_finding_names() -> None:
    told = failing("M3", "Modbus", finding("write(value=2): expected success, got no reply", code="not_successful"))
    told["samples"][1]["calls"] = [
        call(ok=False) | {"tool": "write", "arguments": {"value": value}} for value in (1, 2, 3)
    ]
    (cause,) = causes_of(told)
    assert cause.words is not None
    assert cause.words.asked == 'write {"value": 2}'
    assert [label for label, _ in rows(cause)] == ["asked", "the adapter said", "the device saw", "should have said"]


def test_what_to_change_is_said_by_the_code_where_no_library_is_known() -> None:
    (cause,) = causes_of(failing("M3", "Modbus", NOISE))
    assert cause.changes == (finding_codes()["stdout_noise"].change,)
