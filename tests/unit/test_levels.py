"""The level of an adapter is a function of the catalogue and of the items of a run."""

from __future__ import annotations

import random
from collections.abc import Iterable
from typing import Any, cast

import pytest

from pytest_otmcp.core.matrix import REQUIREMENTS
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.record.schema import AdapterFacts, Item
from pytest_otmcp.suite.levels import Standing, said, shown, standing, standings
from pytest_otmcp.suite.requirements import Catalogue, Level, catalogue, read

from .samples import finding, item

KEYS = ("modbus", "mqtt", "opcua", "s7", "bacnet", "ethernetip", "dnp3", "profibus", "ethercat", "profinet")
DOCUMENTS = '[documents]\nx = { title = "x", at = "x", read = "text" }\n'


def check(row: str, protocol: str = "modbus", status: str = "PASS") -> dict[str, Any]:
    """Return the item of the requirement suite that judges a row."""
    entry = item(f"{row}.{protocol}", REQUIREMENTS, "", row, [])
    return {**entry, "status": status, "requirements": [row]}


def all_passed(protocol: str = "modbus", level: Level = Level.SILVER) -> dict[str, dict[str, Any]]:
    """Return items that meet every MUST that a level needs and that is judged, by row."""
    needed = [row.id for row in catalogue().needs(level, protocol) if row.strength == "MUST" and row.not_yet is None]
    return {row: check(row, protocol) for row in needed}


def stands(items: Iterable[dict[str, Any]], protocol: str = "modbus", rows: Catalogue | None = None) -> Standing:
    return standing(rows or catalogue(), cast(list[Item], list(items)), protocol)


def rank(found: Standing) -> int:
    return -1 if found.level is None else found.level.rank


def blamed(entry: dict[str, Any], requirement: str | None, strength: str = "MUST") -> dict[str, Any]:
    """Return an item with one more finding."""
    told = {**finding("wrong_value", "values differ", requirement), "strength": strength}
    return {**entry, "findings": [*entry["findings"], told]}


@pytest.mark.parametrize("protocol", KEYS)
def test_every_row_met_is_gold_where_the_protocol_has_a_secure_form(protocol: str) -> None:
    found = stands(all_passed(protocol, Level.GOLD).values(), protocol)
    assert found.failed == {}
    assert found.not_run == ()
    if protocols()[protocol].secure:
        assert found.level is Level.GOLD
        assert said(found).endswith(": Gold")
    else:
        assert (found.level, found.wanted, found.attainable) == (Level.SILVER, Level.GOLD, False)
        assert said(found).endswith(": Silver; Gold cannot be earned")
        assert shown(found, catalogue())[-1].startswith("Gold cannot be earned: the kit knows no form of ")


def test_gold_over_http_needs_callers_with_tokens() -> None:
    items = all_passed("modbus", Level.GOLD)
    items["MCP-011"] = check("MCP-011", "modbus", "NOT_APPLICABLE")
    unasked = cast(list[Item], [*items.values()])
    assert standing(catalogue(), unasked, "modbus").level is Level.GOLD
    found = standing(catalogue(), unasked, "modbus", over_http=True)
    assert (found.level, found.attainable, found.absent) == (Level.SILVER, True, ("MCP-011",))
    items["MCP-011"] = check("MCP-011", "modbus")
    assert standing(catalogue(), cast(list[Item], [*items.values()]), "modbus", over_http=True).level is Level.GOLD


@pytest.mark.parametrize("protocol", KEYS)
def test_the_rows_of_bronze_alone_are_bronze_when_nothing_else_is_claimed(protocol: str) -> None:
    items = all_passed(protocol)
    for row in items:
        if catalogue().rows[row].level is not Level.BRONZE:
            items[row] = check(row, protocol, "NOT_APPLICABLE")
    found = stands(items.values(), protocol)
    assert (found.level, found.wanted) == (Level.BRONZE, Level.SILVER)
    assert not found.shown
    assert "Nothing that Silver is about has been shown to work." in shown(found, catalogue())


def test_a_run_without_items_earns_nothing() -> None:
    found = stands([])
    assert (found.level, found.wanted) == (None, Level.BRONZE)
    assert len(found.not_run) == 51
    assert said(found).endswith("51 rows not shown (MCP-001, MCP-002, MCP-003, MCP-004, MCP-005 and 46 more)")


def test_of_a_run_without_the_requirement_suite_nothing_is_said() -> None:
    without = cast(list[Item], [item("M1", "normal", "Modbus", "Ping.", [1.0])])
    facts = cast(AdapterFacts, {})
    assert standings(catalogue(), without, {"modbus": facts}) == []
    both = cast(list[Item], [*without, check("WR-003")])
    assert [
        one.protocol for one in standings(catalogue(), both, dict.fromkeys(("modbus", "opcua", "semaphore"), facts))
    ] == [
        "modbus",
        "opcua",
    ]


@pytest.mark.parametrize("status", ["FAIL", "NOT_TESTABLE"])
def test_a_row_is_violated_only_by_a_finding_about_it(status: str) -> None:
    own = blamed(check("WR-003", status=status), "WR-003")
    found = stands({**all_passed(), "WR-003": own}.values())
    assert (found.level, found.failed, found.hidden) == (Level.BRONZE, {"WR-003": ("WR-003.modbus",)}, ())
    assert said(found) == "Modbus: Bronze; for Silver: 1 row violated (WR-003)"
    assert "WR-003 is violated, as WR-003.modbus shows." in shown(found, catalogue())
    other = blamed(check("MCP-001", status=status), "WR-003")
    found = stands({**all_passed(), "MCP-001": other}.values())
    assert (found.level, found.failed, found.not_run) == (None, {}, ("MCP-001",))
    assert said(found) == "Modbus: no level; for Bronze: 1 row not shown (MCP-001)"
    assert shown(found, catalogue())[0] == "Not shown, because the item about it failed for another cause: MCP-001."
    assert standing(catalogue(), cast(list[Item], [other]), "modbus").hidden == ("MCP-001",)


@pytest.mark.parametrize("status", ["FAIL", "NOT_TESTABLE"])
def test_a_row_whose_item_failed_without_a_finding_is_not_shown(status: str) -> None:
    found = stands({**all_passed(), "WR-003": check("WR-003", status=status)}.values())
    assert (found.level, found.failed, found.hidden) == (Level.BRONZE, {}, ("WR-003",))


@pytest.mark.parametrize("status", ["KIT_ERROR", "INTERRUPTED", None])
def test_a_row_that_no_item_decided_is_missing(status: str | None) -> None:
    items = all_passed()
    del items["WR-003"]
    if status is not None:
        items["WR-003"] = check("WR-003", status=status)
    found = stands(items.values())
    assert (found.level, found.not_run) == (Level.BRONZE, ("WR-003",))
    assert said(found) == "Modbus: Bronze; for Silver: 1 row not shown (WR-003)"


def test_a_row_that_is_not_claimed_is_not_asked_for() -> None:
    found = stands({**all_passed(), "WR-011": check("WR-011", status="NOT_APPLICABLE")}.values())
    assert found.level is Level.SILVER
    assert found.unclaimed == ("WR-011",)


def test_a_finding_of_another_suites_item_denies_the_row() -> None:
    found = stands([*all_passed().values(), blamed(item("M3", "normal", "Modbus", "Write.", [1.0]), "WR-001")])
    assert (found.level, found.failed) == (Level.BRONZE, {"WR-001": ("M3",)})


def test_a_finding_counts_for_the_protocol_of_its_item_alone() -> None:
    elsewhere = blamed(item("Q3", "normal", "MQTT", "Publish.", [1.0]), "RD-004")
    assert stands([*all_passed().values(), elsewhere]).level is Level.SILVER
    across = blamed(item("X1", "normal", "Cross-protocol", "Read all.", [1.0]), "RD-004")
    assert stands([*all_passed().values(), across]).level is None
    across["devices"] = {"mqtt": {}, "opcua@ro": {}}
    assert stands([*all_passed().values(), across]).level is Level.SILVER
    assert stands([*all_passed("opcua").values(), across], "opcua").level is None


def test_a_warning_and_a_finding_of_an_item_that_the_kit_broke_deny_nothing() -> None:
    warned = blamed(check("RD-001"), "RD-001", "SHOULD")
    broken = blamed({**item("M3", "normal", "Modbus", "Write.", [1.0]), "status": "KIT_ERROR"}, "RD-001")
    assert stands([*{**all_passed(), "RD-001": warned}.values(), broken]).level is Level.SILVER


def test_a_failure_that_is_about_no_row_denies_every_level() -> None:
    dead = {**item("M1", "normal", "Modbus", "Ping.", []), "status": "FAIL"}
    for entry in (dead, blamed(dead, None), blamed(dead, "ACME 7")):
        found = stands([*all_passed().values(), entry])
        assert (found.level, found.unattributed) == (None, ("M1",))
        assert said(found) == "Modbus: no level; for Bronze: 1 item failed for what is no row of the protocol (M1)"


def test_a_failure_about_a_row_of_another_protocol_denies_every_level() -> None:
    items = all_passed("s7")
    wrong = blamed(item("K5", "normal", "S7comm", "Write a bit.", [1.0]), "WR-011")
    assert stands(items.values(), "s7").level is Level.SILVER
    found = stands([*items.values(), wrong], "s7")
    assert (found.level, found.unattributed) == (None, ("K5",))


def test_a_finding_about_a_row_that_is_not_yet_judged_denies_the_level() -> None:
    found = stands([*{**all_passed(), "ENV-006": blamed(check("ENV-006"), "KEY-001")}.values()])
    assert (found.level, found.failed) == (None, {"KEY-001": ("ENV-006.modbus",)})
    assert "KEY-001" not in found.not_yet


def test_an_adapter_that_may_write_has_to_show_that_it_can_be_kept_from_it() -> None:
    unguarded = {**all_passed(), "WR-004": check("WR-004", status="NOT_APPLICABLE")}
    found = stands(unguarded.values())
    assert (found.level, found.not_run) == (None, ("WR-004",))
    own = [
        row
        for row in unguarded
        if catalogue().rows[row].level is Level.SILVER and "mb-w" in catalogue().rows[row].profiles
    ]
    assert own == ["WR-001", "WR-002", "WR-008", "WR-009", "ADR-003", "ADR-004"]
    reading = {**unguarded, **{row: check(row, status="NOT_APPLICABLE") for row in own}}
    assert stands(reading.values()).level is Level.BRONZE
    # That a row about writing did not run does not show that the adapter cannot write.
    del reading[own[0]]
    assert stands(reading.values()).level is None


def test_a_protocol_without_profiles_of_its_own_earns_no_level() -> None:
    text = (
        DOCUMENTS
        + '[areas]\nENV = "x"\n[profiles]\ncore = { level = "bronze", meaning = "x" }\n[ENV-001]\nstrength = "MUST"\n'
    )
    text += 'level = "bronze"\nprofiles = ["core"]\nstatement = "x"\njudged = "x"\nsource = "x"\nsince = "0.2"\n'
    found = stands([check("ENV-001")], rows=read(text))
    assert (found.level, found.not_run, found.shown) == (None, (), False)
    assert said(found) == "Modbus: no level; for Bronze: nothing that belongs to it is claimed"


def test_gold_can_be_earned_once_its_rows_are_judged() -> None:
    row = 'strength = "MUST"\nstatement = "x"\njudged = "x"\nsource = "x"\nsince = "0.2"\n'
    text = (
        DOCUMENTS
        + '[areas]\nRD = "x"\nWR = "x"\nSEC = "x"\n[profiles]\nmb-r = { level = "bronze", protocol = "modbus", meaning = "x" }\n'
    )
    text += 'mb-w = { level = "silver", protocol = "modbus", meaning = "x" }\nsec = { level = "gold", meaning = "x" }\n'
    for name, level, profile in (
        ("RD-001", "bronze", "mb-r"),
        ("WR-001", "silver", "mb-w"),
        ("SEC-001", "gold", "sec"),
    ):
        text += f'[{name}]\nlevel = "{level}"\nprofiles = ["{profile}"]\n{row}'
    items = [check("RD-001"), check("WR-001"), check("SEC-001")]
    assert stands(items, rows=read(text)).level is Level.GOLD
    assert stands(items[:2], rows=read(text)).not_run == ("SEC-001",)


def test_gold_needs_every_row_of_its_own_also_those_that_are_not_asked_for() -> None:
    row = 'strength = "MUST"\nstatement = "x"\njudged = "x"\nsource = "x"\nsince = "0.2"\n'
    text = DOCUMENTS + '[areas]\nRD = "x"\nWR = "x"\nSEC = "x"\nMCP = "x"\n[profiles]\n'
    text += 'mb-r = { level = "bronze", protocol = "modbus", meaning = "x" }\n'
    text += 'mb-w = { level = "silver", protocol = "modbus", meaning = "x" }\nsec = { level = "gold", meaning = "x" }\n'
    for name, level, profile in (
        ("RD-001", "bronze", "mb-r"),
        ("WR-001", "silver", "mb-w"),
        ("SEC-001", "gold", "sec"),
        ("SEC-002", "gold", "sec"),
        ("MCP-011", "gold", "sec"),
    ):
        text += f'[{name}]\nlevel = "{level}"\nprofiles = ["{profile}"]\n{row}'
    met = [check("RD-001"), check("WR-001"), check("SEC-001")]
    found = stands([*met, check("SEC-002", status="NOT_APPLICABLE")], rows=read(text))
    assert (found.level, found.shown, found.absent) == (Level.SILVER, False, ("SEC-002",))
    assert said(found) == "Modbus: Silver; for Gold: 1 row not asked for (SEC-002)"
    assert shown(found, read(text))[0] == "Gold needs every row that begins with it; not asked for: SEC-002."
    assert stands([*met, check("SEC-002")], rows=read(text)).level is Level.GOLD


def a_run(seed: int) -> list[dict[str, Any]]:
    """Return items at random, most of which passed; some rows are judged twice, some not at all."""
    rng = random.Random(seed)
    rows = [row for row in all_passed() if rng.random() > rng.choice((0, 0, 0.01))]
    bad = ["FAIL", "NOT_APPLICABLE", "KIT_ERROR", "NOT_TESTABLE"]
    share = rng.choice((0, 0, 0.02, 0.3))
    items = [check(row, status=rng.choice(bad) if rng.random() < share else "PASS") for row in [*rows, *rows[:3]]]
    if rng.random() < 0.2:
        items.append(blamed(item("M3", "normal", "Modbus", "Write.", [1.0]), rng.choice([*catalogue().rows])))
    return items


SEEDS = range(60)


def test_the_runs_at_random_earn_each_level() -> None:
    assert {rank(stands(a_run(seed))) for seed in SEEDS} == {-1, 0, 1}


@pytest.mark.parametrize("seed", SEEDS)
def test_the_order_of_the_items_does_not_matter(seed: int) -> None:
    items = a_run(seed)
    shuffled = items[:]
    random.Random(seed).shuffle(shuffled)
    assert stands(items) == stands(shuffled)


@pytest.mark.parametrize("seed", SEEDS)
def test_what_is_worse_in_one_place_never_earns_more(seed: int) -> None:
    rng = random.Random(seed)
    items = a_run(seed)
    before = rank(stands(items))
    place = rng.randrange(len(items))
    for worse in ("FAIL", "NOT_TESTABLE", "KIT_ERROR", None):
        changed = [*items[:place], *([] if worse is None else [{**items[place], "status": worse}]), *items[place + 1 :]]
        if items[place]["status"] in ("PASS", "NOT_APPLICABLE"):
            assert rank(stands(changed)) <= before, (worse, items[place]["id"])
    assert rank(stands([*items, blamed(check("RD-001"), rng.choice([*catalogue().rows, None]))])) <= before


@pytest.mark.parametrize("seed", SEEDS)
def test_a_level_lacks_something_exactly_when_it_is_not_earned(seed: int) -> None:
    found = stands(a_run(seed))
    below = -1 if found.level is None else found.level.rank
    assert found.wanted.rank == below + 1
    assert not found.earned
    needed = {row.id for row in catalogue().needs(found.wanted, "modbus")}
    assert {*found.failed, *found.not_run, *found.unclaimed, *found.not_yet} <= needed
    assert not {*found.failed} & {*found.not_run}
    assert "\n" not in said(found)


def noisy(entry: dict[str, Any]) -> dict[str, Any]:
    """Return an item in whose sessions a line on standard output was no message."""
    told = finding("stdout_noise", "1 line(s) on stdout that are no MCP message, the first: 'Connected'", "MCP-001")
    return {**entry, "status": "FAIL", "findings": [*entry["findings"], told]}


def test_a_line_on_standard_output_is_one_fault_whatever_number_of_items_it_is_in() -> None:
    found = stands(map(noisy, all_passed().values()))
    assert found.level is None
    assert list(found.failed) == ["MCP-001"]
    assert (found.not_run, found.hidden, found.unattributed) == ((), (), ())


@pytest.mark.parametrize("requirement", ["RD-001", "MCP-007"])
def test_an_item_with_another_finding_beside_that_line_does_not_show_its_row(requirement: str) -> None:
    rows = {row: noisy(entry) for row, entry in all_passed().items()}
    found = stands({**rows, "WR-003": blamed(rows["WR-003"], requirement)}.values())
    assert {*found.failed} == {"MCP-001", requirement}
    assert found.hidden == ()
    silver = stands({**all_passed(), "WR-003": blamed(noisy(check("WR-003")), requirement)}.values())
    assert {*silver.failed} == {"MCP-001", requirement}


def test_an_item_that_ended_before_its_time_shows_nothing_though_a_line_is_its_only_finding() -> None:
    ended = {"fault_of": "subject", "code": "session_lost", "message": "the session was lost"}
    found = stands({**all_passed(), "MCP-009": {**noisy(check("MCP-009")), "ended": ended}}.values())
    assert "MCP-009" in found.hidden
    unfinished = stands({**all_passed(), "MCP-009": {**noisy(check("MCP-009")), "planned": 3}}.values())
    assert "MCP-009" in unfinished.hidden
