"""Whatever the kit cites is explained, every row of the catalogue is whole, and no code is explained that the kit does not cite."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

import pytest_otmcp
from pytest_otmcp.core.error_registry import registry
from pytest_otmcp.core.finding_registry import finding_codes
from pytest_otmcp.protocols.own import OWN
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.suite.catalogue import SUITE, all_tasks
from pytest_otmcp.suite.explanations import explained, findings
from pytest_otmcp.suite.keys import keys_of_code, keys_of_task
from pytest_otmcp.suite.requirements import Level, catalogue, cited, read, requirements
from pytest_otmcp.trial.explanation import explanation

CHECKOUT = Path(__file__).parents[2]
KIT = Path(pytest_otmcp.__file__).parent
SUITE_FOLDER = Path(next(iter(import_module(SUITE).__path__)))

ID = re.compile(r"\b(?!SHA)[A-Z]{2,3}-\d{3}\b")

NOTED_BY = {"_note": 0, "finding": 0, "SubjectError": 0, "_end": 1, "_finding": 1}
"""Functions that make a finding of their arguments, and which of them is its code."""

NOT_YET: tuple[str, ...] = ()
"""Areas whose rows need what the kit does not have yet."""

LATER = {
    # To publish is to write, and an adapter of the lowest level only reads.
    "MQT-001": Level.SILVER,
    "MQT-003": Level.SILVER,
    # Write safety by people and by records belongs to the highest level.
    "AUD-003": Level.GOLD,
    "APR-001": Level.GOLD,
    "APR-002": Level.GOLD,
    "APR-003": Level.GOLD,
}
"""Rows that a level needs only later than their profiles say."""


def sources() -> list[Path]:
    """Return the modules that judge."""
    other_rooms = ("conformance", "mocks", "reference_adapters")
    kit = (path for path in KIT.rglob("*.py") if path.relative_to(KIT).parts[0] not in other_rooms)
    return sorted([*kit, *SUITE_FOLDER.rglob("*.py")])


@cache
def trees() -> list[tuple[Path, ast.Module]]:
    """Return the modules that judge, parsed."""
    return [(path, ast.parse(path.read_text(encoding="utf-8"))) for path in sources()]


def cited_requirements() -> set[str]:
    """Return the ids in every string of the modules that judge, docstrings included."""
    return {
        name
        for _, tree in trees()
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
        for name in ID.findall(node.value)
    }


def texts(node: ast.expr) -> Iterator[str]:
    """Yield the strings that an expression may be."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    elif isinstance(node, ast.IfExp):
        yield from texts(node.body)
        yield from texts(node.orelse)


def assigned(function: ast.AST, name: str) -> Iterator[str]:
    """Yield the strings that a function assigns to a name, also as one of several."""
    for node in ast.walk(function):
        if not isinstance(node, ast.Assign):
            continue
        for target in node.targets:
            pairs = [(target, node.value)]
            if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                pairs = list(zip(target.elts, node.value.elts, strict=True))
            for to, value in pairs:
                if isinstance(to, ast.Name) and to.id == name:
                    yield from texts(value)


def codes_in(tree: ast.Module) -> Iterator[str]:
    """Yield the codes of the findings that a module makes."""
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    for function in [tree, *functions]:
        for call in ast.walk(function):
            if not isinstance(call, ast.Call):
                continue
            name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
            given = [keyword.value for keyword in call.keywords if keyword.arg == "code" and name == "Finding"]
            given += [call.args[NOTED_BY[name]]] if name in NOTED_BY and len(call.args) > NOTED_BY[name] else []
            for code in given:
                yield from texts(code)
                if isinstance(code, ast.Name) and function is not tree:
                    yield from assigned(function, code.id)


def own_protocol(path: Path) -> str | None:
    """Return the protocol in whose folder a module is."""
    return next((key for key in OWN if (KIT / "protocols" / key) in path.parents), None)


def cited_codes() -> dict[str, set[str | None]]:
    """Return each code of a finding, with the protocols in whose folders it is made, or None for elsewhere."""
    cited: dict[str, set[str | None]] = {}
    for path, tree in trees():
        for code in codes_in(tree):
            cited.setdefault(code, set()).add(own_protocol(path))
    return cited


def test_every_cited_requirement_is_a_row_of_the_catalogue() -> None:
    assert sorted(cited_requirements() - requirements().keys()) == []


def test_every_row_that_a_first_check_judges_is_cited() -> None:
    # The checks of the other rows are the requirement suite's.
    first = {name for name, row in requirements().items() if row.since == "0.1"}
    assert sorted(first - cited_requirements()) == []


def test_data_of_the_kit_cites_rows_of_the_catalogue_only() -> None:
    data = [path for path in KIT.rglob("*") if path.suffix in {".toml", ".json", ".jinja"}]
    assert data
    found = {name for path in data for name in ID.findall(path.read_text(encoding="utf-8"))}
    assert sorted(found - requirements().keys()) == []


def test_a_task_that_cites_no_row_of_the_catalogue_is_refused() -> None:
    cited("M3", ["WR-003"])
    with pytest.raises(ValueError, match=r"^M3 cites 'WR-999', which is no row of the requirement catalogue$"):
        cited("M3", ["WR-003", "WR-999"])


def test_the_tasks_are_checked_when_they_are_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    declared = import_module(f"{SUITE}.tasks")
    wrong = replace(all_tasks()["M3"], requirements=("WR-999",))
    monkeypatch.setattr(declared, "tasks", lambda: [wrong])
    with pytest.raises(ValueError, match=r"^M3 cites 'WR-999'"):
        all_tasks()


def test_there_are_as_many_rows_of_each_level_as_there_were() -> None:
    counted = Counter((row.level.value, row.strength) for row in requirements().values())
    assert counted == {
        ("bronze", "MUST"): 67,
        ("bronze", "SHOULD"): 2,
        ("silver", "MUST"): 40,
        ("silver", "SHOULD"): 3,
        ("gold", "MUST"): 12,
        ("gold", "SHOULD"): 2,
    }
    not_yet = {name for name, row in requirements().items() if row.not_yet is not None}
    assert {name for name in not_yet if requirements()[name].area not in NOT_YET} == {
        "WR-013",
    }
    assert {name for name, row in requirements().items() if row.area in NOT_YET} <= not_yet
    assert {requirements()[name].level for name in not_yet if requirements()[name].strength == "MUST"} == set()


@pytest.mark.parametrize(
    ("protocol", "bronze", "silver"),
    [
        ("modbus", 51, 76),
        ("mqtt", 47, 75),
        ("opcua", 50, 76),
        ("s7", 40, 61),
        ("bacnet", 40, 61),
        ("ethernetip", 40, 61),
        ("dnp3", 39, 60),
        ("profibus", 39, 60),
        ("ethercat", 39, 60),
        ("profinet", 39, 60),
    ],
    ids=lambda value: value,
)
def test_a_level_needs_as_many_rows_of_a_protocol_as_it_did(protocol: str, bronze: int, silver: int) -> None:
    def needed(level: Level) -> int:
        return sum(row.strength == "MUST" for row in catalogue().needs(level, protocol))

    assert (needed(Level.BRONZE), needed(Level.SILVER)) == (bronze, silver)


def test_a_level_needs_what_the_levels_below_need() -> None:
    for protocol in OWN:
        bronze, silver, gold = (catalogue().needs(level, protocol) for level in Level)
        assert [row for row in silver if row in bronze] == bronze
        assert [row for row in gold if row in silver] == silver


def test_a_row_begins_with_the_lowest_level_of_its_profiles() -> None:
    for row in requirements().values():
        lowest = min((catalogue().profiles[name].level for name in row.profiles), key=lambda level: level.rank)
        if row.id in LATER:
            assert row.level == LATER[row.id] != lowest, row.id
        else:
            assert row.level == lowest, row.id


def test_the_rows_are_whole() -> None:
    for row in requirements().values():
        for text in (row.statement, row.judged, row.source, row.related or "-", row.since, row.not_yet or "-"):
            assert text.strip() == text, row.id
            assert text, row.id
            assert "|" not in text, f"{row.id}: its page has tables"


def test_every_document_is_named_by_a_row_and_every_row_by_the_names_of_documents() -> None:
    # That a row names documents of the table alone, and places only of what was read, is checked whenever the file is read.
    named = {entry for row in requirements().values() for entry in f"{row.source}; {row.related}".split("; ")}
    for name in catalogue().documents:
        assert any(entry == name or entry.startswith(f"{name}, ") for entry in named), name


def test_a_rule_of_the_kit_itself_is_not_stricter_than_its_source() -> None:
    assert [row.id for row in requirements().values() if row.stricter and "The kit" in row.source.split("; ")] == []


ROW = """
[areas]
WR = "Writing"
[profiles]
safe = { level = "silver", meaning = "write safety" }
[documents]
"A book" = { title = "A book, 2nd edition", at = "a library", read = "text" }
"A list" = { title = "A list", at = "a library", read = "titles" }
"Heard of" = { title = "Heard of", at = "a library" }
[WR-001]
strength = "MUST"
level = "silver"
profiles = ["safe"]
statement = "Do."
judged = "Looked at."
source = "A book, section 1; A book"
related = "Heard of; A list, 7 (Title); A book"
since = "0.1"
"""


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("since =", "sinse =", "WR-001 has an unknown key 'sinse'"),
        ('judged = "Looked at."', "", "WR-001 has no 'judged'"),
        ('"Do."', '""', "WR-001.statement has to be of type str and not empty"),
        ('"Heard of; A list, 7 (Title); A book"', "1", "WR-001.related has to be of type str and not empty"),
        ('"A book, section 1; ', '"A books; ', "WR-001.source begins with no name of a document: A books"),
        ('"A book, section 1; ', '"A list; ', "WR-001.source rests on a text that was not read: A list"),
        ('"A book, section 1; ', '"Heard of; ', "WR-001.source rests on a text that was not read: Heard of"),
        ('"Heard of; ', '"Unheard of; ', "WR-001.related begins with no name of a document: Unheard of"),
        ('"Heard of; ', '"Heard of, section 1; ', "WR-001.related names a place: Heard of, section 1"),
        ('(Title); A book"', '(Title); A book, section 1"', "WR-001.related names a place: A book, section 1"),
        ('"titles"', '"some"', "A list has an unknown value of 'read' 'some'; there are text, titles"),
        ('"MUST"', '"MAY"', "WR-001 has an unknown strength 'MAY'; there are MUST, SHOULD"),
        ('"silver"\nprofiles', '"tin"\nprofiles', "WR-001 has an unknown level 'tin'; there are bronze, silver, gold"),
        ('["safe"]', '["save"]', "WR-001 has an unknown profile 'save'; there are safe"),
        ('["safe"]', '["safe", "safe"]', "WR-001 names the profile 'safe' twice"),
        ('["safe"]', "[]", "WR-001 has no profile"),
        ("[WR-001]", "[RD-001]", "RD-001 has an unknown area 'RD'; there are WR"),
        ("[WR-001]", "[WR-1]", "'WR-1' is no id of a requirement"),
        ("since =", 'protocols = ["carrier pigeon"]\nsince =', "WR-001 has an unknown protocol 'carrier pigeon'; "),
        ("since =", 'capabilities = ["flying"]\nsince =', "WR-001 has an unknown capability 'flying'; "),
        ("meaning =", 'protocol = "x", meaning =', "safe has an unknown protocol 'x'; "),
        ("[areas]", "[area]", "there is no table [areas]"),
        ("since =", 'since = "0.2"\nsince =', "Cannot overwrite a value"),
        ("[WR-001]", "[WR-001]\n[WR-001]", "Cannot declare ('WR-001',) twice"),
    ],
)
def test_a_catalogue_that_is_not_whole_is_one_sentence(old: str, new: str, sentence: str) -> None:
    assert list(read(ROW).rows) == ["WR-001"]
    assert ROW.count(old) == 1
    with pytest.raises(ValueError, match=re.escape(sentence)) as error:
        read(ROW.replace(old, new))
    assert str(error.value).startswith("requirements.toml: ")
    assert "\n" not in str(error.value)


def test_every_code_of_a_finding_is_explained() -> None:
    assert sorted(cited_codes().keys() - findings().keys()) == []


def test_every_explained_code_is_one_of_a_finding() -> None:
    cited = cited_codes()
    assert sorted(findings().keys() - cited.keys()) == []
    for key in OWN:
        for code in finding_codes(protocols()[key].package):
            assert cited[code] == {key}, f"{code} is made elsewhere, too: it belongs into core/findings.toml"


def test_a_code_is_found_however_a_finding_gets_it() -> None:
    tree = ast.parse(
        "def f(self, x):\n"
        "    code, rule = 'a', 'WR-001'\n"
        "    code = 'b' if x else 'c'\n"
        "    Finding(code=code)\n"
        "    Finding(code='d' if x else 'e')\n"
        "    self._note('f', 'words')\n"
        "    raise SubjectError('g', 'words')\n"
    )
    assert set(codes_in(tree)) == set("abcdefg")


@pytest.mark.parametrize("name", all_tasks())
def test_every_item_is_explained(name: str) -> None:
    task = all_tasks()[name]
    steps = explanation(task.steps)
    assert all((steps.asked, steps.said, steps.seen, steps.why)), "its docstring needs Said:, Seen: and Why:"
    for around in (task.begin, task.end):
        assert around is None or explanation(around).asked, around
    assert set(task.requirements) <= requirements().keys()


def test_every_key_of_the_subject_file_that_is_named_exists() -> None:
    for task in all_tasks().values():
        assert len(list(keys_of_task(task))) == len(task.keys)
    for code, (entry, _) in findings().items():
        assert len(list(keys_of_code(code))) == len(entry.keys)


def test_every_id_is_explained_once_for_each_of_its_meanings() -> None:
    for name in [*all_tasks(), *requirements(), *registry(), *findings()]:
        meanings = [one.kind for one in explained(name)]
        assert meanings, name
        assert len(meanings) == len(set(meanings)), name
