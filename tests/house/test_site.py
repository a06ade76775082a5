"""The site: built offline and strictly, with an address for each id, no link that leads nowhere, and no error that axe-core finds."""

from __future__ import annotations

import functools
import http.server
import os
import shutil
import subprocess
import sys
import threading
import tomllib
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote, urlsplit

import pytest

from pytest_otmcp.core.errors import UsageError
from pytest_otmcp.core.site import DOCS_URL
from pytest_otmcp.suite.catalogue import all_tasks
from pytest_otmcp.suite.documentation import titles, write
from pytest_otmcp.suite.explanations import findings
from pytest_otmcp.suite.places import address, place
from pytest_otmcp.suite.requirements import requirements
from tests.console.conftest import CHROMIUM
from tests.once import once

if TYPE_CHECKING:
    from playwright.sync_api import Browser

CHECKOUT = Path(__file__).parents[2]
CONFIGURATION = CHECKOUT / "zensical.toml"
IDS = [*all_tasks(), *requirements(), *findings()]
LOOKED_AT = [
    "",
    "subject-file/",
    "requirements/",
    "requirements/WR-003/",
    "items/M3/",
    "codes/wrong_value/",
    "field-report/",
    "field-report/plctap/",
]


def test_the_navigation_has_every_page_once() -> None:
    def pages(entry: Any) -> list[str]:
        return (
            [entry]
            if isinstance(entry, str)
            else [name for one in entry for name in pages(next(iter(one.values())) if isinstance(one, dict) else one)]
        )

    listed = pages(tomllib.loads(CONFIGURATION.read_text(encoding="utf-8"))["project"]["nav"])
    assert sorted(listed) == sorted(["examples/README.md", *(name for name in titles() if not name.endswith(".json"))])


def test_every_id_has_a_page_and_an_unknown_one_has_none(monkeypatch: pytest.MonkeyPatch) -> None:
    assert [name for name in IDS if place(name) is None] == []
    assert place("nothing") is None
    assert address("WR-003") is None
    monkeypatch.setenv(DOCS_URL, "https://kit.example/docs/")
    assert [address(name) for name in ("WR-003", "WR-003.modbus", "M3", "wrong_value", "nothing")] == [
        "https://kit.example/docs/requirements/WR-003/",
        "https://kit.example/docs/requirements/WR-003/#WR-003.modbus",
        "https://kit.example/docs/items/M3/",
        "https://kit.example/docs/codes/wrong_value/",
        None,
    ]
    monkeypatch.setenv(DOCS_URL, "javascript:alert(1)")
    with pytest.raises(UsageError, match="begins with https://"):
        address("WR-003")


def _built(directory: Path) -> str:
    write(directory / "build" / "docs")
    shutil.copy(CONFIGURATION, directory)
    command = [str(Path(sys.executable).parent / "zensical"), "build", "--clean", "--strict"]
    done = subprocess.run(
        command, check=False, cwd=directory, capture_output=True, text=True, env={**os.environ, "NO_COLOR": "1"}
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "No issues found" in done.stdout + done.stderr
    return str(directory / "build" / "site")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site as continuous integration builds it."""
    return Path(once(tmp_path_factory, "site", _built))


class _Page(HTMLParser):
    """What a page links to, what it loads, and its anchors."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.anchors: set[str] = set()
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        self.anchors.add(values.get("id", ""))
        if tag == "a" and "href" in values:
            self.links.append(values["href"])
        elif tag in ("link", "script", "img") and (source := values.get("src") or values.get("href")):
            self.loaded.append(source)


@pytest.mark.long
def test_every_link_of_the_site_leads_to_a_file_and_an_anchor_and_nothing_is_loaded_from_elsewhere(site: Path) -> None:
    pages = {path: _Page(path) for path in site.rglob("*.html") if path.name != "404.html"}
    assert len(pages) > 400
    broken = []
    for path, page in pages.items():
        assert [source for source in page.loaded if urlsplit(source).netloc] == [], path
        for link in {*page.links, *page.loaded}:
            to = urlsplit(link)
            if to.scheme:
                continue
            target = (path.parent / unquote(to.path)).resolve() if to.path else path
            target = target / "index.html" if target.is_dir() else target
            # The theme's own anchors begin with an underscore: they are labels of its switches.
            anchor = unquote(to.fragment)
            if not target.exists() or (anchor and target in pages and anchor not in pages[target].anchors):
                broken.append((str(path.relative_to(site)), link))
    assert broken == []


@pytest.mark.long
def test_every_id_is_found_at_its_address_and_by_the_search(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(DOCS_URL, "https://kit.example")
    parsed = functools.cache(_Page)
    searched = (site / "search.json").read_text(encoding="utf-8")
    for name in IDS:
        to = urlsplit(address(name) or "")
        page = site / to.path.lstrip("/") / "index.html"
        assert page.exists(), name
        assert name in searched, name
        if to.fragment:
            assert to.fragment in parsed(page).anchors, name


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        """Say nothing."""


@pytest.fixture
def served(site: Path) -> Iterator[str]:
    """The address of the site, served on loopback."""
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(_Quiet, directory=str(site)))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}/"
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.fixture
def browser() -> Iterator[Browser]:
    """The Chromium that is installed."""
    playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("no Chromium is installed")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-dev-shm-usage"])
        yield browser
        browser.close()


@pytest.mark.long
@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (1280, "dark"), (390, "light")])
def test_axe_finds_no_error_in_the_site(served: str, browser: Browser, width: int, scheme: Any) -> None:
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-core is not installed").Axe()
    page = browser.new_page(viewport={"width": width, "height": 844}, color_scheme=scheme)
    asked, complaints = [], []
    page.on("request", lambda request: asked.append(request.url))
    page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
    for name in LOOKED_AT:
        page.goto(served + name)
        found = axe.run(page).response["violations"]
        assert [(one["id"], one["nodes"][0]["html"]) for one in found] == [], name
        assert page.evaluate("document.documentElement.scrollWidth") <= width, name
    assert {url for url in asked if not url.startswith((served, "data:", "blob:"))} == set()
    assert complaints == []
