"""axe-core finds no error of accessibility in the pages that the kit writes, light and dark, on a screen and a telephone; the certificate
is one sheet of paper."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from html import unescape
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.certificate.statement import certificate
from pytest_otmcp.core.matrix import SUITES
from pytest_otmcp.record.condensed import condensed
from pytest_otmcp.record.reader import open_record
from pytest_otmcp.report.certificate_page import certificate_page
from pytest_otmcp.report.comparison import compared
from pytest_otmcp.report.comparison_pages import html as comparison_html
from pytest_otmcp.report.html import page
from pytest_otmcp.suite.catalogue import tasks_by_id
from tests.golden.files import path_of
from tests.unit.certified import conformant_run

from .conftest import PATIENCE_S, Npm

pytestmark = pytest.mark.long

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
LOOKS = {
    "a screen": ("--window-size=1280,900",),
    "a telephone": ("--window-size=500,844", "--blink-settings=preferredColorScheme=0"),
}
ASK = "axe.run(document).then(told => { document.title = JSON.stringify(told.violations) })"


def stored(name: str) -> Any:
    with open_record(path_of(name), compressed=True) as run:
        return condensed(run)


PAGES = {
    "honest": lambda: page(stored("reference-modbus")),
    "lying": lambda: page(stored("defect-MU-14dnp")),
    "partial": lambda: page(stored("foreign-modbus-prose-demo-mode")),
    "certificate": lambda: certificate_page(
        certificate(conformant_run(), "ab" * 32, tasks_by_id(suites=SUITES)),
        "cd" * 32,
        signed=True,  # type: ignore[arg-type]
    ),
    "comparison": lambda: comparison_html(compared([stored("reference-modbus"), stored("defect-MU-14dnp")])),
}


def browsed(page: Path, *options: str) -> str:
    """Open a page in a browser of its own, and return what that writes."""
    assert CHROMIUM is not None
    profile = page.with_name("profile")
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={profile}", *options]
    done = subprocess.run([*command, page.as_uri()], capture_output=True, text=True, timeout=PATIENCE_S, check=True)
    return done.stdout


in_a_browser = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")


@in_a_browser
@pytest.mark.parametrize("look", LOOKS)
@pytest.mark.parametrize("name", PAGES)
def test_axe_finds_no_error(npm: Npm, tmp_path: Path, name: str, look: str) -> None:
    # The page forbids scripts, this one too; what is folded is looked at as well.
    html = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", PAGES[name]())
    axe = (npm.directory / "node_modules" / "axe-core" / "axe.min.js").as_uri()
    asking = f'<script src="{axe}"></script><script>{ASK}</script></body>'
    path = tmp_path / "page.html"
    path.write_text(html.replace("<details", "<details open").replace("</body>", asking), encoding="utf-8")
    told = browsed(path, *LOOKS[look], "--virtual-time-budget=60000", "--dump-dom")
    violations = json.loads(unescape(re.findall("<title>(.*?)</title>", told, re.DOTALL)[0]))
    assert [(one["id"], [node["html"] for node in one["nodes"]][:3]) for one in violations] == []


@in_a_browser
def test_a_certificate_is_one_sheet_of_paper(tmp_path: Path) -> None:
    path, printed = tmp_path / "page.html", tmp_path / "page.pdf"
    path.write_text(PAGES["certificate"](), encoding="utf-8")
    browsed(path, f"--print-to-pdf={printed}", "--no-pdf-header-footer")
    assert len(re.findall(rb"/Type /Page\b", printed.read_bytes())) == 1
