"""The closing lines on the terminal say what happened in the run."""

from __future__ import annotations

import copy
import re

import pytest

from pytest_otmcp.report.console import summary
from pytest_otmcp.report.limits import narrowed
from pytest_otmcp.report.verdict_file import verdict
from pytest_otmcp.suite.requirements import requirements

from .certified import conformant_run
from .samples import finding, item, run, written_twice
from .test_latex import ALL


def text(record: dict[str, object], width: int = 120, verbosity: int = 0) -> str:
    return "\n".join(line for line, _ in summary(record, width, verbosity=verbosity))


def without_adapter(identifier: str) -> dict[str, object]:
    family = "OPC UA" if identifier.startswith("O") else "MQTT"
    unclaimed = item(identifier, "normal", family, "Read.", [])
    return unclaimed | {
        "status": "NOT_APPLICABLE",
        "planned": 30,
        "reason": f"the subject has no adapter for {family}",
    }


def test_the_last_line_is_the_verdict() -> None:
    assert text(run(ALL)).splitlines()[-1] == "VERDICT: CONFORMANT (6 of 38 items passed; 150/150 runs passed)"


def test_warnings_stand_beside_the_verdict_and_are_told_once_for_each_kind() -> None:
    record = copy.deepcopy(run(ALL))
    warning = {**finding("no_text", "there is no text block", "MCP-006"), "strength": "SHOULD"}
    for warned in record["items"][:2]:
        for sample in warned["samples"]:
            sample["findings"] = [warning]
    shown = text(record)
    assert "warnings\n  MCP-006, 60 times in M1 M2: there is no text block\n" in shown
    assert shown.endswith("VERDICT: CONFORMANT (6 of 38 items passed; 150/150 runs passed, 1 warning)")
    assert "causes" not in shown


def test_thirty_passes_are_printed_with_their_bound() -> None:
    # The bound is 0.90497: it is rounded down, as in the certificate.
    assert re.search(r"30/30 +90\.4 %", text(run(ALL), verbosity=1))
    assert re.search(r"normal +3/3 +90/90 +90\.4 %", text(run(ALL)))


def test_a_failing_item_shows_its_findings() -> None:
    shown = text(run([item("M2", "normal", "Modbus", "Read.", [1.0] * 7, failing=2)]))
    assert "M2 rep 6/7, 2 times in all: values differ [wrong_value]" in shown


def test_an_incomplete_run_says_why() -> None:
    assert text(run(ALL, complete=False)).endswith("interrupted by the user)")


def test_withheld_latencies_are_explained() -> None:
    shown = text(run(ALL, timing_valid=False))
    assert "latencies withheld" in shown
    assert "1.50" not in shown


@pytest.mark.parametrize("width", [60, 80, 120])
def test_no_line_is_wider_than_the_terminal(width: int) -> None:
    red = [item(name, "normal", "Modbus", "Read.", [1.0] * 30, failing=1) for name in ("M2", "M3")]
    record = run([*ALL[2:], *red, *(without_adapter(name) for name in ("O1", "O2"))], complete=False)
    record["settings"]["narrowed"] = [
        "28 of 38 items were taken out by -k M3 or Q1 or Q2 or FM or S10: M1, M2, M4 and 25 more"
    ]
    record["footer"]["breakdown_s"] = {"fresh sessions": 8.76, "tool calls": 0.44, "adapter starts": 3.21, "kit": 4.0}
    lines = [line for line, _ in summary(record, width, verbosity=1, fold_verdict=True)]
    assert max(map(len, lines)) <= width
    assert not [line for line in lines if re.match(r" +(?:s|ms|%)(?!\w)", line)]
    # In a log the verdict is one line, so that programs find it whole.
    assert [line for line, _ in summary(record, width)][-1].endswith("interrupted by the user)")


def test_an_adapters_words_can_neither_colour_the_terminal_nor_forge_a_line() -> None:
    broken = item("M2", "normal", "Modbus", "Read.\x1b[2J", [1.0], failing=1)
    broken["samples"][0]["findings"][0]["message"] = "no\r\nVERDICT: CONFORMANT\x1b[32m \u202e \x9b"
    lines = text(run([broken])).splitlines()
    assert all(line.isprintable() for line in lines)
    assert [line for line in lines if line.startswith("VERDICT")] == [lines[-1]]
    assert r"        | VERDICT: CONFORMANT\x1b[32m \u202e \x9b [wrong_value]" in lines


def test_a_narrow_terminal_gets_no_column_of_means() -> None:
    assert "mean ms" in text(run(ALL), 120, verbosity=1)
    assert "mean ms" not in text(run(ALL), 119, verbosity=1)


def test_what_is_not_claimed_is_neither_passed_nor_failed() -> None:
    unclaimed = {**item("Q2", "normal", "MQTT", "Inspect.", []), "status": "NOT_APPLICABLE", "planned": 30}
    shown = text(run([*ALL, unclaimed]))
    assert "VERDICT: CONFORMANT (6 of 38 items passed, 1 does not apply; 150/150 runs passed)" in shown
    assert "causes" not in shown


def test_what_cannot_be_tested_says_why() -> None:
    why = "modbus: the subject binds no tool to the operation 'ping'"
    untestable = {**item("M1", "normal", "Modbus", "Ping.", []), "status": "NOT_TESTABLE", "planned": 3, "reason": why}
    assert why in text(run([untestable]))


def test_one_fault_is_printed_once_however_many_repetitions_show_it() -> None:
    broken = item("M2", "normal", "Modbus", "Read.", [1.0] * 7, failing=3)
    for index, sample in enumerate(broken["samples"][4:]):
        sample["findings"][0]["message"] = f"values should be [{index}, 7], the reply says [{index + 1}.5]"
    shown = text(run([broken]))
    assert shown.count("values should be") == 1
    assert "M2 rep 5/7, 3 times in all: values should be [0, 7], the reply says [1.5] [wrong_value]" in shown


def test_the_keys_of_the_subject_file_that_may_be_why_are_named() -> None:
    late = item("FM1", "fault", "Modbus", "Read.", [1.0], failing=1)
    # A finding about another rule does not hang on the address that the item asks for.
    assert "in the subject file" not in text(run([late]))
    late["requirements"] = ["RD-001"]
    assert "in the subject file: [adapter.modbus] probes.missing_address: Asked for instead of 9999." in text(
        run([late])
    )
    late["samples"][0]["findings"][0]["code"] = "no_reply"
    assert "in the subject file: deadline_s: Time within which every call must have answered." in text(run([late]))
    recovery = item("R-modbus", "recovery", "Modbus", "Recover.", [1.0], failing=1) | {"requirements": ["RD-001"]}
    assert "in the subject file: [adapter.modbus] recovery: How work goes on after an outage." in text(run([recovery]))
    dead = item("M1", "normal", "Modbus", "Ping.", [])
    dead |= {"status": "FAIL", "findings": [finding("cannot_start", "the adapter exited with code 1", "MCP-002")]}
    assert "in the subject file: era: 'legacy' for a server that must be" in text(run([dead]))
    assert "in the subject file" not in text(run([item("M2", "normal", "Modbus", "Read.", [1.0], failing=1)]))


def test_a_fault_that_turns_many_items_red_is_told_once_with_its_rule() -> None:
    broken = [item(name, "normal", "Modbus", "Read.", [1.0], failing=1) for name in ("M2", "M3")]
    shown = text(run([*broken, item("M1", "normal", "Modbus", "Ping.", [1.0])]))
    assert "  RD-001 Modbus: M2 M3" in shown.splitlines()
    assert shown.count("values differ") == 1
    assert requirements()["RD-001"].statement.split(".")[0][:50] in shown


def test_what_does_not_apply_is_one_sentence_however_much_it_is() -> None:
    unclaimed = item("M1", "normal", "Modbus", "Ping.", [])
    unclaimed |= {"status": "NOT_APPLICABLE", "planned": 30, "reason": "modbus.ping is not claimed: no tool for it"}
    shown = text(run([unclaimed, *map(without_adapter, ("Q1", "Q2", "O1"))]))
    assert "1 does not apply: modbus.ping (1): no tool for it" in shown
    assert "NOT_APPLICABLE" not in text(run([unclaimed, *map(without_adapter, ("Q1", "Q2", "O1"))]), verbosity=1)
    assert "apply" not in text(run([without_adapter("Q1")]))


def test_a_failed_control_leaves_nothing_that_could_be_said_at_least() -> None:
    lost = item("S10", "stress", "Modbus", "Restart.", [1.0] * 2)
    assert "22.3 %" in text(run([lost]))
    lost |= {"status": "FAIL", "findings": [finding("no_reply", "control: no reply", "REC-002")]}
    shown = text(run([lost]), verbosity=1)
    assert "22.3 %" not in shown
    assert re.search(r"stress +0/1 +2/2 +---   S10", shown)


def test_a_quiet_run_tells_causes_and_verdict_and_a_quieter_one_the_verdict() -> None:
    record = run([item("M2", "normal", "Modbus", "Read.", [1.0], failing=1)])
    quiet = text(record, verbosity=-1)
    assert "causes" in quiet
    assert "suite " not in quiet
    assert text(record, verbosity=-2) == quiet.splitlines()[-1]


def test_one_of_a_thing_is_not_called_several() -> None:
    shown = text(run([item("M2", "normal", "Modbus", "Read.", [1.0])]))
    assert "1 run, 1 tool call in 1.0 s" in shown


def test_calls_of_the_requirement_suite_are_told_beside_those_of_the_benchmark() -> None:
    read, judged = (
        item("M2", "normal", "Modbus", "Read.", [1.0]),
        item("WR-003.modbus", "requirements", "Modbus", "W.", [1.0]),
    )
    assert "1 run, 1 tool call of the requirement suite in 1.0 s" in text(run([judged]))
    assert "2 runs, 1 tool call, 1 tool call of the requirement suite in 1.0 s" in text(run([read, judged]))


def test_a_run_of_the_requirement_suite_says_the_level_of_each_protocol_in_a_line() -> None:
    judged = item("WR-003.modbus", "requirements", "Modbus", "Write once.", [1.0], failing=1)
    shown = text(run([judged]), width=200)
    assert re.search(
        r"^level: Modbus: no level; for Bronze: 1 row violated \(RD-001\); 50 rows not shown ", shown, re.MULTILINE
    )
    assert len(re.findall(r"^level: ", shown, re.MULTILINE)) == 3
    assert (
        "level: none is shown without the requirement suite, and no permission to connect follows; otmcp certify runs it"
        in text(run(ALL))
    )
    # Of a run that failed nobody expects a level.
    assert "level:" not in text(run([written_twice()]))


def test_the_end_of_a_run_says_whom_it_is_about() -> None:
    # Without a subject file, or in another directory than the vendor meant, it is about the reference adapters.
    assert "subject: synthetic 0" in text(run(ALL)).splitlines()


def checked(identifier: str, family: str, *, failing: int = 0, **more: object) -> dict[str, object]:
    row = identifier.partition(".")[0]
    return {**item(identifier, "requirements", family, "Once.", [1.0], failing=failing), "requirements": [row], **more}


def test_of_a_few_rows_the_answer_comes_before_the_verdict_on_the_whole_suite() -> None:
    violated = checked("RD-001.opcua", "OPC UA", failing=1)
    not_asked = checked("WR-003.opcua", "OPC UA", status="NOT_APPLICABLE", reason="it only reads", samples=[])
    kept = [checked("WR-003.modbus", "Modbus"), checked("WR-003.mqtt", "MQTT"), not_asked]
    *_, reading, writing, verdict = summary(run([violated, *kept]))
    assert reading == ("RD-001: violated by OPC UA", "bad")
    assert writing == ("WR-003: kept by Modbus, MQTT; not asked over OPC UA", "plain")
    assert verdict[0].startswith("VERDICT: ")
    assert "WR-003: kept" not in text(run([*ALL, *kept]))


def test_tools_that_were_never_called_are_named_beside_a_pass() -> None:
    record = conformant_run()
    record["subject"]["adapters"]["opcua"]["calls"] = {"flip": 0, "read\x1b[8m": 0, "write": 7}
    told = "The OPC UA adapter lists 2 tools whose answers this run says nothing about: flip, read"
    assert told in text(record, 200)
    record["settings"]["suites"].remove("requirements")
    assert "says nothing about" not in text(record, 200)
    assert "\x1b" not in text(record, 200)
    assert narrowed(record)[0].startswith(told)
    assert verdict(record)["never_called"] == {"opcua": ["flip", "read\x1b[8m"]}
    record["subject"]["adapters"]["opcua"]["calls"] = {f"tool-{number}": 0 for number in range(1000)}
    assert narrowed(record)[0].endswith("tool-18, tool-19 and 980 more.")
