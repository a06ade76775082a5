"""The wheel that a vendor gets: it has one import name, and gives a verdict and a certificate in an empty directory."""

from __future__ import annotations

import configparser
import json
import os
import re
import subprocess
import zipfile
from pathlib import Path

import pytest

from pytest_otmcp.record import load
from pytest_otmcp.record.json_schema import json_schema
from pytest_otmcp.subject.schema import shipped_text
from pytest_otmcp.suite.catalogue import kit_digest
from pytest_otmcp.suite.documentation import titles
from tests.house.test_documentation import broken, prose
from tests.plugin.test_fixtures_doc import EXAMPLES, TESTS

from .conftest import CHECKOUT, FOLDERS, SCHEMAS

pytestmark = pytest.mark.long

SUBJECT = """
[subject]
name = "a reference adapter as a vendor would describe it"
version = "1.0"

[adapter.modbus]
command = ["{python}", "-m", "pytest_otmcp.reference_adapters", "modbus"]
env = { MODBUS_HOST = "{host}", MODBUS_PORT = "{port}", MODBUS_TIMEOUT_S = "4", MODBUS_DEADLINE_S = "5" }
rw = { env = { MODBUS_WRITES_ENABLED = "true" } }
deadline_s = 10
"""


def run(root: Path, *command: str, timeout: float = 900) -> subprocess.CompletedProcess[str]:
    """Run a program of the environment in ``root``, without the variables of this Python and this pytest."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "PYTEST", "VIRTUAL"))}
    program = root / ".venv" / "bin" / command[0]
    return subprocess.run(
        [str(program), *command[1:]],
        cwd=root,
        env=kept,
        capture_output=True,
        text=True,
        check=False,
        timeout=timeout,
    )


def test_the_wheel_holds_every_file_of_the_kit_and_one_import_name(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    [metadata] = {name.partition("/")[0] for name in names} - {"pytest_otmcp"}
    assert metadata.endswith(".dist-info")
    expected = {
        f"{target}/{path.relative_to(CHECKOUT / folder).as_posix()}"
        for folder, target in FOLDERS.items()
        for path in (CHECKOUT / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    docs = CHECKOUT / "docs"
    copied = (
        path
        for path in (docs / "first-adapter").rglob("*")
        if path.is_file() and not {"__pycache__", "node_modules", "pki"} & {*path.parts}
    )
    documents = (*docs.glob("*.md"), docs / "built.toml", *copied)
    expected |= {*SCHEMAS, *(f"pytest_otmcp/docs/{path.relative_to(docs)}" for path in documents)}
    shipped = {name for name in names if name.startswith("pytest_otmcp/")}
    assert expected - shipped == set()
    assert shipped - expected == set()
    assert "pytest_otmcp/py.typed" in shipped


def test_the_wheel_offers_a_pytest_plugin_and_the_command_otmcp(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        [name] = [name for name in archive.namelist() if name.endswith("entry_points.txt")]
        points = configparser.ConfigParser()
        points.read_string(archive.read(name).decode())
    assert dict(points["pytest11"]) == {"otmcp": "pytest_otmcp.plugin"}
    assert dict(points["console_scripts"]) == {"otmcp": "pytest_otmcp.cli:main"}


def test_the_description_has_no_link_or_image_that_leads_nowhere_on_an_index_page(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        [name] = [name for name in archive.namelist() if name.endswith(".dist-info/METADATA")]
        metadata = archive.read(name).decode()
    assert "Description-Content-Type: text/markdown" in metadata
    _, _, description = metadata.partition("\n\n")
    assert "The conformance kit for MCP-to-OT adapters" in description
    targets = re.findall(r"\]\(([^)]*)\)", description)
    assert [target for target in targets if not target.startswith(("https://", "#"))] == []
    assert "`otmcp docs subject-file`" in description


def test_the_build_makes_the_schemas_of_the_wheel(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        found = [archive.read(name).decode() for name in SCHEMAS]
    assert found == [json_schema(), shipped_text()]


def test_the_digest_of_the_kit_is_the_same_from_the_wheel_and_from_the_checkout(empty: Path) -> None:
    program = "from pytest_otmcp.suite.catalogue import kit_digest; print(kit_digest())"
    assert run(empty, "python", "-c", program).stdout == f"{kit_digest()}\n"


def test_the_documentation_can_be_read_from_the_wheel(empty: Path) -> None:
    listed = run(empty, "otmcp", "docs")
    assert listed.returncode == 0, listed.stderr
    assert [line.split()[0] for line in listed.stdout.splitlines()] == [name.removesuffix(".md") for name in titles()]
    assert run(empty, "otmcp", "docs", "ci").stdout == (CHECKOUT / "docs" / "ci.md").read_text()


def test_the_wheel_writes_the_whole_documentation_into_a_directory(
    empty: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    site = tmp_path_factory.mktemp("documentation")
    written = run(empty, "otmcp", "docs", str(site))
    assert written.returncode == 0, written.stderr
    assert {path.name for path in site.iterdir() if path.is_file()} == titles().keys()
    pages = {path: prose(path) for path in site.glob("*.md")}
    assert {str(page): links for page in pages if (links := list(broken(page)))} == {}
    assert "need the extra `dev`" in pages[site / "honest-adapters.md"]


@pytest.mark.weekly
def test_bare_pytest_in_an_empty_directory_gives_a_verdict(empty: Path) -> None:
    done = run(empty, "python", "-m", "pytest", "--otmcp-reps=1")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "VERDICT: CONFORMANT" in done.stdout
    record = load(empty / "reports" / "latest" / "run.json")
    assert record["settings"]["narrowed"] == []
    assert set(record["subject"]["adapters"]) == {"modbus", "mqtt", "opcua"}


def test_the_examples_of_the_fixtures_run_as_printed(empty: Path) -> None:
    files = [empty / f"test_example_{number}.py" for number in range(len(EXAMPLES))]
    for file, example in zip(files, EXAMPLES, strict=True):
        file.write_text(example)
    done = run(empty, "python", "-m", "pytest", *(file.name for file in files))
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{TESTS} passed" in done.stdout


@pytest.mark.weekly
def test_a_subject_file_is_certified_and_the_certificate_verified(
    empty: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    subject = tmp_path_factory.mktemp("subject") / "otmcp.toml"
    subject.write_text(SUBJECT)
    certified = run(empty, "otmcp", "certify", "--subject", str(subject), "--out", "certificate", timeout=1800)
    assert certified.returncode == 0, certified.stdout + certified.stderr
    statement = json.loads((empty / "certificate" / "certificate.json").read_text())
    assert statement["predicateType"].startswith("https://in-toto.io/attestation/")
    verified = run(empty, "otmcp", "verify", "certificate/certificate.json", "certificate/run.json")
    assert verified.returncode == 0, verified.stdout + verified.stderr


def test_the_installed_kit_shows_that_it_notices_defects(empty: Path) -> None:
    done = run(empty, "otmcp", "self-check", "MU-13", "MU-12q", "-n", "2")
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"^MU-12q +noticed +mqtt: ", done.stdout, re.MULTILINE)
    assert re.search(r"^MU-13 +noticed +modbus: ", done.stdout, re.MULTILINE)
    assert "by MCP-004.modbus for MCP-004" in done.stdout
    assert done.stdout.splitlines()[-1] == "all as expected"


def test_a_changed_file_of_the_installed_kit_is_on_record(empty: Path) -> None:
    [module] = (empty / ".venv" / "lib").glob("python*/site-packages/pytest_otmcp/conformance/test_normal.py")
    genuine = module.read_bytes()
    module.write_bytes(genuine + b"# changed\n")
    try:
        run(empty, "python", "-m", "pytest", "--otmcp-reps=1", "-k", "M1", "--otmcp-report-dir=changed")
    finally:
        module.write_bytes(genuine)
    record = load(empty / "changed" / "run.json", allow_incomplete=True)
    assert (
        "files of the installed kit were changed: pytest_otmcp/conformance/test_normal.py"
        in record["settings"]["narrowed"]
    )
