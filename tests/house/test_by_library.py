"""The page by-library explains every hint of the registries, below the library's name."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from pytest_otmcp.core.finding_registry import finding_codes
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.subject.imports import libraries_used
from pytest_otmcp.suite.by_library import PAGE, advice, known_libraries
from pytest_otmcp.suite.requirements import requirements
from tests.stock.test_typescript import FOUND

CHECKOUT = Path(__file__).parents[2]
PATH = CHECKOUT / "docs" / f"{PAGE}.md"
PARTS = re.split(r'^<a id="([a-z0-9-]+)"></a>$', PATH.read_text(encoding="utf-8"), flags=re.MULTILINE)
FIRST = (CHECKOUT / "docs" / "first-adapter.md").read_text(encoding="utf-8")
CODES = finding_codes().keys() | {code for one in protocols().values() for code in finding_codes(one.package)}
BY_ANCHOR = dict(zip(PARTS[1::2], PARTS[2::2], strict=True))


def test_the_page_has_every_library() -> None:
    assert {library.anchor for library in known_libraries().values()} <= BY_ANCHOR.keys()


@pytest.mark.parametrize("name", known_libraries())
def test_every_hint_is_about_rows_that_the_page_explains_under_the_library(name: str) -> None:
    library = known_libraries()[name]
    assert library.python or library.node
    cited = {row for hint in library.hints for row in hint.requirements}
    assert cited <= requirements().keys()
    assert {row for row in cited if row not in BY_ANCHOR[library.anchor]} == set()
    assert {code for hint in library.hints for code in hint.codes} <= CODES


def test_every_anchor_that_a_page_leads_to_is_there() -> None:
    led_to = re.findall(r"\]\((?:by-library\.md)?#([^)]+)\)", "".join(PARTS) + FIRST)
    assert set(led_to) == BY_ANCHOR.keys()


@pytest.mark.parametrize("protocol", FOUND)
def test_every_finding_of_an_adapter_in_typescript_is_told_what_to_change(protocol: str) -> None:
    used = libraries_used(
        ["node", "as-first-written.ts"], CHECKOUT / "docs" / "first-adapter" / "typescript" / protocol
    )
    assert {row for rows in FOUND[protocol].values() for row in rows if not list(advice(row, used))} == set()


def test_the_page_cites_rows_of_the_catalogue_alone() -> None:
    text = PATH.read_text(encoding="utf-8")
    assert set(re.findall(r"\b[A-Z]{2,3}-\d{3}\b", text)) <= requirements().keys()


@pytest.mark.parametrize("page", [f"docs/{PAGE}.md", "docs/first-adapter.md"])
def test_the_files_that_a_page_names_are_there(page: str) -> None:
    text = (CHECKOUT / page).read_text(encoding="utf-8")
    assert [
        path for path in re.findall(r"\]\((first-adapter/[^)#]+)\)", text) if not (CHECKOUT / "docs" / path).is_file()
    ] == []
    assert [
        path
        for path in re.findall(r"otmcp docs (first-adapter/\S+\w)", text)
        if not (CHECKOUT / "docs" / path).is_file() and "NAME" not in path
    ] == []
