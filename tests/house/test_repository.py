"""Files that machines outside read: workflows, components, citation. They agree with each other and with the project."""

from __future__ import annotations

import re
import tomllib
from collections import defaultdict
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest

from pytest_otmcp.plugin.options import add_options
from pytest_otmcp.record.condensed import condensed
from pytest_otmcp.record.reader import open_record
from pytest_otmcp.report.html import page
from pytest_otmcp.report.markdown import summary

CHECKOUT = Path(__file__).parents[2]
PROJECT = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
RECIPES = [
    CHECKOUT / "docs" / "ci.md",
    CHECKOUT / "action.yml",
    *sorted((CHECKOUT / "templates").glob("*.yml")),
    *sorted((CHECKOUT / ".github" / "workflows").glob("*.yml")),
]


def test_every_workflow_and_recipe_uses_one_version_of_an_action() -> None:
    used = defaultdict(set)
    for recipe in RECIPES:
        for action, version in re.findall(r"uses: ([\w./-]+)@(\S+)", recipe.read_text(encoding="utf-8")):
            used[action].add(version)
    assert used["actions/checkout"]
    assert {action: versions for action, versions in used.items() if len(versions) > 1} == {}


def test_recipes_install_the_version_that_this_is() -> None:
    text = "\n".join(recipe.read_text(encoding="utf-8") for recipe in RECIPES)
    assert set(re.findall(r"pytest-otmcp==([\d.]+\d)", text)) == {PROJECT["version"]}
    assert set(re.findall(r"OWNER/pytest-otmcp(?:/conformance)?@v?([\d.]+\d)", text)) == {PROJECT["version"]}
    [default] = re.findall(r'version:\n(?: +.*\n)*? +default: "([\d.]+)"', text)
    assert default == PROJECT["version"]


def test_the_citation_names_the_version_and_licence_of_the_project() -> None:
    citation = (CHECKOUT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {PROJECT['version']}\n" in citation
    assert f"\nlicense: {PROJECT['license']}\n" in citation
    assert PROJECT["authors"][0]["name"] in citation


def test_the_tests_run_on_every_python_and_pytest_that_is_promised() -> None:
    workflow = (CHECKOUT / ".github" / "workflows" / "weekly.yml").read_text(encoding="utf-8")
    promised = {name.rpartition(" ")[2] for name in PROJECT["classifiers"] if re.search(r"Python :: 3\.\d+$", name)}
    assert set(re.findall(r'python(?:-version)?: "(3\.\d+)"', workflow)) == promised
    [least] = [re.search(r">=([\d.]+)", name) for name in PROJECT["dependencies"] if re.match(r"pytest[><=]", name)]
    assert least is not None
    assert f'pytest: "{least[1]}"' in workflow


@pytest.mark.parametrize("name", ["tests", "long", "weekly"])
def test_the_shards_of_a_lane_are_all_of_its_parts(name: str) -> None:
    workflow = (CHECKOUT / ".github" / "workflows" / f"{name}.yml").read_text(encoding="utf-8")
    [shards] = re.findall(r"shard: \[([\d, ]+)\]", workflow)
    [parts] = re.findall(r"--shard=\$\{\{ matrix.shard \}\}/(\d+)", workflow)
    assert [int(part) for part in shards.split(",")] == list(range(1, int(parts) + 1))


def test_every_requirement_has_a_least_version_and_one_that_is_too_new() -> None:
    wanted = [*PROJECT["dependencies"], *(one for extra in PROJECT["optional-dependencies"].values() for one in extra)]
    assert [one for one in wanted if not re.fullmatch(r"[\w-]+>=[\d.]+,<[\d.]+", one)] == []


def test_what_the_kit_is_tested_with_is_searched_for_known_vulnerabilities() -> None:
    workflow = (CHECKOUT / ".github" / "workflows" / "tests.yml").read_text(encoding="utf-8")
    [audit] = re.findall(r"pip-audit (--.*)", workflow)
    # Without the first option a package that could not be looked up would be a line of the output and no failure.
    assert {"--strict", "--requirement .ci/locked.txt"} <= {f"--{part.strip()}" for part in audit.split("--")}


def test_the_lock_of_continuous_integration_has_every_version_with_hashes_and_no_address() -> None:
    lock = (CHECKOUT / ".ci" / "locked.txt").read_text(encoding="utf-8")
    constraints = (CHECKOUT / "constraints.txt").read_text(encoding="utf-8")
    versions = re.compile(r"^([\w.-]+)==([^\s\\]+)", re.MULTILINE)

    def pinned(text: str) -> set[tuple[str, str]]:
        return {(re.sub(r"[-_.]+", "-", name).lower(), version) for name, version in versions.findall(text)}

    assert pinned(lock) == pinned(constraints)
    files = re.split(versions, lock)[3::3]
    assert all(re.match(r"( \\\n +--hash=sha256:[0-9a-f]{64})+$", one.rstrip("\n")) for one in files), files
    assert "://" not in lock


def test_the_sample_is_what_the_kit_makes_of_its_record() -> None:
    # Made by: otmcp report reports/sample/run.json
    sample = CHECKOUT / "reports" / "sample"
    with open_record(sample / "run.json") as run:
        shown = condensed(run)
    assert (sample / "report.html").read_text(encoding="utf-8") == page(shown)
    assert (sample / "summary.md").read_text(encoding="utf-8") == summary(shown)


def test_the_documents_list_every_option_of_the_plugin() -> None:
    asked: list[str] = []
    group = SimpleNamespace(addoption=lambda name, **_: asked.append(name))
    parser = SimpleNamespace(getgroup=lambda *_, **__: group, addini=lambda *_, **__: None)
    add_options(cast(pytest.Parser, parser))
    page = (CHECKOUT / "docs" / "commands.md").read_text(encoding="utf-8")
    assert [name for name in asked if f"| `{name}" not in page] == []
    assert "--otmcp-reps" in asked
