"""``otmcp explain`` says what an id means, and names what is near an unknown one."""

from __future__ import annotations

import json
import re

import pytest

from pytest_otmcp import cli
from pytest_otmcp.suite.catalogue import all_tasks
from pytest_otmcp.suite.explanations import explained, facets
from pytest_otmcp.suite.requirements import requirements
from pytest_otmcp.trial.explanation import Explanation, explanation


def told(capsys: pytest.CaptureFixture[str], *identifiers: str) -> str:
    """Return what the command prints, on one line."""
    assert cli.main(["explain", *identifiers]) == 0
    return " ".join(capsys.readouterr().out.split())


def test_an_item_is_told_from_its_declaration(capsys: pytest.CaptureFixture[str]) -> None:
    task = all_tasks()["FM1"]
    text = told(capsys, "FM1")
    assert text.startswith(f"FM1 (item): {task.title}")
    steps = explanation(task.steps)
    assert all(part in text for part in (steps.asked, steps.said, steps.seen, steps.why))
    for name in task.requirements:
        assert f"{name}: {requirements()[name].statement} Source: {requirements()[name].source}." in text
    assert "[adapter.modbus] probes.missing_address: Asked for instead of 9999." in text


def test_an_item_tells_what_happens_once_around_its_repetitions(capsys: pytest.CaptureFixture[str]) -> None:
    text = told(capsys, "Q4")
    assert "Once before Announce the device." in text
    assert "Once afterwards Announce a device through the adapter that was started with writes disabled." in text


def test_a_requirement_is_told_with_its_source_and_what_is_related(capsys: pytest.CaptureFixture[str]) -> None:
    text = told(capsys, "WR-003", "MCP-001")
    with_related, without = text.split("MCP-001 (requirement): ")
    row = requirements()["WR-003"]
    assert f"Source {row.source} Related {row.related} " in with_related
    assert "Items about it M3, Q3," in with_related
    assert f"Source {requirements()['MCP-001'].source} " in without
    assert "Related" not in without


@pytest.mark.parametrize(
    ("facet", "about", "claimed"),
    [
        ("modbus.guard", "The adapter can be launched so that it refuses every write.", "[adapter.modbus.ro]"),
        ("recovery", "After an outage of the device the same session works again.", "[adapter.KEY] unclaimed, with"),
        ("opcua.commands", "tools with a vocabulary of their own", "[adapter.opcua.commands.NAME]"),
        ("MQTT.subscribe.qos", "'qos' of the operation subscribe: ", "[adapter.mqtt.bind] subscribe"),
        ("opcua.write", "Write a variable's value.", "[adapter.opcua.bind] write"),
    ],
)
def test_a_facet_is_told_with_where_it_is_claimed(
    facet: str, about: str, claimed: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text = told(capsys, facet)
    assert text.startswith(f"{facet.lower()} (facet): ")
    assert about in text
    assert f"In the subject file {claimed}" in text


@pytest.mark.parametrize("facet", facets())
def test_every_facet_is_explained_with_the_items_that_need_it(facet: str) -> None:
    (found,) = explained(facet)
    for task in all_tasks().values():
        needed = facet in task.needs or ("." not in facet and any(need.endswith(f".{facet}") for need in task.needs))
        assert needed == (task.id in re.split(", | and ", dict(found.parts).get("Items that need it", ("",))[0]))


def test_a_requirement_is_told_with_what_to_change_in_every_library(capsys: pytest.CaptureFixture[str]) -> None:
    text = told(capsys, "WR-003")
    assert "By library pymodbus: `retries=0`" in text
    assert "paho-mqtt: `Client(reconnect_on_failure=False)`" in text


def test_an_error_code_is_told_with_what_the_protocols_call_it(capsys: pytest.CaptureFixture[str]) -> None:
    text = told(capsys, "illegal_address")
    assert "Modbus: ILLEGAL DATA ADDRESS" in text
    assert "OPC UA: BadNodeIdUnknown" in text


def test_the_code_of_a_finding_is_told_with_what_to_change(capsys: pytest.CaptureFixture[str]) -> None:
    text = told(capsys, "deadline_missed")
    assert "What to change Give the protocol library a timeout below the deadline." in text
    assert "In the subject file deadline_s: Time within which every call must have answered." in text


def test_a_level_is_told_with_its_meaning_and_its_rows(capsys: pytest.CaptureFixture[str]) -> None:
    text = told(capsys, "Bronze", "Gold")
    bronze, gold = text.split("Gold (level): ")
    assert bronze.startswith("Bronze (level): An adapter of this level may be connected to a plant for reading.")
    assert "mb-r: reading by Modbus" in bronze
    assert "RD-001" in bronze.partition("Not yet judged")[0]
    assert "TLS-001" in gold.partition("Not yet judged")[0]
    assert "AUD-003" in gold.partition("Not yet judged")[0]


def test_a_profile_is_told_with_its_level_and_its_rows(capsys: pytest.CaptureFixture[str]) -> None:
    text = told(capsys, "mb-w")
    assert text.startswith("mb-w (profile): Writing by Modbus. Level Silver and above Rows about it WR-001, ")


def test_a_check_is_about_a_row_and_its_protocol(capsys: pytest.CaptureFixture[str]) -> None:
    assert "Suite Requirements, Modbus Applies to" in told(capsys, "WR-003.modbus")


@pytest.mark.parametrize("columns", [40, 60])
def test_no_line_is_wider_than_the_terminal(
    columns: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    assert cli.main(["explain", "WR-003", "M3", "illegal_address"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert columns - 10 < max(map(len, lines)) <= columns


def test_a_program_reads_the_same_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["explain", "--json", "wr-003"]) == 0
    (found,) = json.loads(capsys.readouterr().out)
    assert (found["id"], found["kind"], found["about"]) == ("WR-003", "requirement", requirements()["WR-003"].statement)
    assert found["parts"]["Source"] == [requirements()["WR-003"].source]


@pytest.mark.parametrize("name", ["M3", "WR-003", "WR-003.modbus", "Bronze", "illegal_address"])
def test_the_case_of_an_id_does_not_matter(name: str) -> None:
    assert explained(name.upper()) == explained(name.lower()) == explained(name) != []


def test_an_id_with_two_meanings_is_told_twice() -> None:
    assert [one.kind for one in explained("internal_error")] == ["error code", "finding code"]


@pytest.mark.parametrize(
    ("unknown", "hint"),
    [
        ("WR-03", "WR-003"),
        ("bronz", "did you mean Bronze?"),
        ("wrong value", "did you mean wrong_value"),
        ("xyzzy", "'otmcp docs' prints the pages items, checks, requirements and codes, which list them all"),
    ],
)
def test_an_unknown_id_is_one_sentence(unknown: str, hint: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["explain", "M3", unknown]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    assert f"there is no item, requirement, level, profile, facet or code {unknown!r}; " in printed.err
    assert hint in printed.err


async def steps(run: object) -> None:
    """Ask for something
    and more.

    Said: this,
        and that.
    Why: it matters.
    """


async def silent(run: object) -> None:
    pass


def test_a_docstring_is_read_by_its_labels() -> None:
    assert explanation(steps) == Explanation(
        asked="Ask for something and more.", said="This, and that.", why="It matters."
    )
    assert explanation(silent) == explanation(None) == Explanation()


def test_without_an_id_all_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["explain"]) == 0
    listed = capsys.readouterr().out
    for name in ("M3 ", "WR-003 ", "WR-003.modbus ", "illegal_address ", "wrong_value ", "Silver "):
        assert f"\n{name}" in listed


def test_a_facet_is_explained_as_a_subject_file_names_it() -> None:
    assert [one.id for one in explained("publish.qos")] == ["mqtt.publish.qos"]
