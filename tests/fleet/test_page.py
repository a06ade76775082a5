"""The matrix in a browser: it filters, has no fault of accessibility, and fits a screen and a telephone."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from pytest_otmcp.fleet.changes import changes
from pytest_otmcp.fleet.lines import Line
from pytest_otmcp.fleet.outcome import Outcome
from pytest_otmcp.fleet.page import write_pages

from .lines import LYING, row

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = pytest.mark.long

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("no Chromium is installed")
    with (
        api.sync_playwright() as playwright,
        playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"]) as browser,
    ):
        yield browser


@pytest.fixture
def address(tmp_path: Path) -> str:
    rows = [row("acme", "1"), row("acme", "2", LYING, tries=2), row("other", "1", certificate=True)]
    rows.append(
        Line(key="k", id="away", version="1", outcome=Outcome.FAULT, reason="not installed: " + "x" * 300, tries=3)
    )
    write_pages("A fleet", rows, changes(rows, [row("acme", "1")]), tmp_path, compared=True)
    folder = tmp_path / "runs" / "other-1"
    folder.mkdir(parents=True)
    (folder / "badge.svg").write_text('<svg xmlns="http://www.w3.org/2000/svg" width="90" height="20"/>')
    return (tmp_path / "index.html").as_uri()


def test_rows_are_filtered_by_words_outcome_and_protocol(browser: Browser, address: str) -> None:
    page = browser.new_page()
    complaints: list[str] = []
    page.on("console", lambda message: complaints.append(message.text))
    page.goto(address)
    shown = page.locator("tbody tr:visible th")
    count = page.locator("output")
    assert count.inner_text() == "4 of 4 rows"
    page.get_by_label("Adapter, version or broken rule").fill("acme 2")
    assert shown.all_inner_texts() == ["acme 2"]
    page.get_by_label("Adapter, version or broken rule").fill("")
    page.get_by_label("Outcome").select_option("broke since last time")
    assert shown.all_inner_texts() == ["acme 2"]
    page.get_by_label("Outcome").select_option("fault of kit or machine")
    assert shown.all_inner_texts() == ["away 1"]
    page.get_by_label("Outcome").select_option("")
    page.get_by_label("Protocol").select_option("Modbus")
    assert shown.all_inner_texts() == ["acme 1", "other 1"]
    assert count.inner_text() == "2 of 4 rows"
    page.close()
    assert complaints == []


@pytest.mark.parametrize("width", [1280, 390])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_matrix_has_no_fault_of_accessibility_and_fits(
    browser: Browser, address: str, width: int, scheme: str
) -> None:
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-core is not installed").Axe()
    page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme, bypass_csp=True)  # type: ignore[arg-type]
    page.goto(address)
    found = axe.run(page)
    assert found.response["violations"] == [], found.generate_report()
    assert page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth") == 0
    page.close()
