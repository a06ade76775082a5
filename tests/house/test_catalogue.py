"""Whatever the kit cites is explained, and nothing is explained that the kit does not cite."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
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
from pytest_otmcp.suite.pages import PAGES, page
from pytest_otmcp.suite.requirements import requirements
from pytest_otmcp.trial.explanation import explanation

CHECKOUT = Path(__file__).parents[2]
KIT = Path(pytest_otmcp.__file__).parent
SUITE_FOLDER = Path(next(iter(import_module(SUITE).__path__)))

ID = re.compile(r"\b(?!SHA)[A-Z]{2,3}-\d{3}\b")

NOTED_BY = {"_note": 0, "finding": 0, "SubjectError": 0, "_end": 1}
"""Functions that make a finding of their arguments, and which of them is its code."""


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


def test_every_row_of_the_catalogue_is_cited() -> None:
    assert sorted(requirements().keys() - cited_requirements()) == []


def test_the_rows_are_whole() -> None:
    for row in requirements().values():
        assert row.strength in ("MUST", "SHOULD"), row.id
        for text in (row.statement, row.judged, row.source):
            assert text.strip() == text, row.id
            assert text, row.id


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


@pytest.mark.parametrize("name", PAGES)
def test_the_pages_are_current(name: str) -> None:
    committed = (CHECKOUT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    assert committed == page(name), f"python -m pytest_otmcp.suite.pages {name} > docs/{name}.md"


def test_every_link_of_the_pages_leads_to_an_anchor() -> None:
    pages = {name: page(name) for name in PAGES}
    anchors = {
        f"{name}.md#{anchor}" for name, text in pages.items() for anchor in re.findall(r'<a id="([^"]+)">', text)
    }
    links = {link for text in pages.values() for link in re.findall(r"\]\(([^)]+)\)", text)}
    assert links
    assert links <= anchors
