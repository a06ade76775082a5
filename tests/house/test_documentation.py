"""The documentation: it can be built as a whole, and every link of a page leads to a file and an anchor."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from pytest_otmcp import cli
from pytest_otmcp.suite.documentation import content, titles, write
from tests.once import once

CHECKOUT = Path(__file__).parents[2]
DOCS = CHECKOUT / "docs"
BUILT = tomllib.loads((DOCS / "built.toml").read_text(encoding="utf-8")).keys()
WRITTEN = [
    *(CHECKOUT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
    *(DOCS / name for name in titles() if name not in BUILT),
    DOCS / "examples" / "README.md",
    *sorted((DOCS / "field-report").glob("*.md")),
]


def _written(directory: Path) -> str:
    write(directory / "site")
    return str(directory / "site")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The whole documentation in a directory."""
    return Path(once(tmp_path_factory, "documentation", _written))


def prose(page: Path) -> str:
    """Return the text of a page without blocks of code, where brackets are no link and a number sign begins no heading."""
    return re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page: those that it sets, and those that a forge makes of headings."""
    text = prose(page)
    headings = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in re.findall(r"^#+ (.*)$", text, re.MULTILINE))
    return {*re.findall(r'<a id="([^"]+)">', text), *(heading.replace(" ", "-") for heading in headings)}


def broken(page: Path) -> Iterator[str]:
    """Yield the links of a page that lead nowhere."""
    known: dict[Path, set[str]] = {}
    for link in re.findall(r"\]\(([^()\s]+)\)", prose(page)):
        if "://" in link:
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        if not target.exists() or (target.parent == DOCS and target.name in BUILT):
            yield link
        elif anchor:
            if target not in known:
                known[target] = anchors(target)
            if anchor not in known[target]:
                yield link


@pytest.mark.parametrize("page", WRITTEN, ids=lambda page: str(page.relative_to(CHECKOUT)))
def test_every_link_of_a_page_in_the_repository_leads_to_a_stored_file(page: Path) -> None:
    assert list(broken(page)) == []


def test_every_link_of_the_built_documentation_stays_in_it_and_leads_to_an_anchor(site: Path) -> None:
    pages = [*site.rglob("*.md")]
    assert {page.name for page in pages} >= {name for name in titles() if name.endswith(".md")}
    assert {str(page.relative_to(site)): links for page in pages if (links := list(broken(page)))} == {}
    assert "**Honest adapters accused: 0 of " in prose(site / "honest-adapters.md")
    outside = {link for page in pages for link in re.findall(r"\]\((\.\./[^)]*)\)", prose(page)) if page.parent == site}
    assert outside == set()


def test_a_link_to_a_built_page_leads_to_the_page_in_a_directory_and_to_the_index_in_the_repository(site: Path) -> None:
    assert "[requirement suite](README.md#checks.md)" in (DOCS / "certificate.md").read_text(encoding="utf-8")
    assert "[requirement suite](checks.md)" in (site / "certificate.md").read_text(encoding="utf-8")


def test_the_index_lists_every_page_and_says_how_to_print_the_built_ones() -> None:
    index = (DOCS / "README.md").read_text(encoding="utf-8")
    pages = titles().keys() - {"README.md"}
    assert pages == {*re.findall(r"\]\(([\w-]+\.md)\)", index), *re.findall(r'<a id="([^"]+)">', index)}
    assert {
        f"{name}.md" if f"{name}.md" in pages else name for name in re.findall(r"`otmcp docs ([\w.-]+)`", index)
    } == {"NAME", *(name for name in BUILT if not name.endswith("/"))}


def test_nothing_that_is_built_is_stored() -> None:
    ignored = (CHECKOUT / ".gitignore").read_text(encoding="utf-8")
    assert {name for name in BUILT if f"/{name}\n" not in ignored} == set()


def test_a_directory_with_other_files_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "README.md").write_text("# Mine\n")
    for directory in (tmp_path, DOCS, CHECKOUT):
        assert cli.main(["docs", f"{directory}/"]) == 2
        assert capsys.readouterr().err.endswith("has other files; name a new or empty directory\n")


@pytest.mark.long
def test_an_earlier_copy_is_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "README.md").write_bytes(content("README.md"))
    assert cli.main(["docs", str(tmp_path)]) == 0
    assert (tmp_path / "ci.md").read_bytes() == content("ci.md")
    assert capsys.readouterr().out.endswith(f"files written; begin with {tmp_path}/README.md\n")
