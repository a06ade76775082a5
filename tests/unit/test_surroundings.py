"""Files around a run that somebody changes meanwhile."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from pytest_otmcp.plugin import surroundings
from pytest_otmcp.plugin.surroundings import Surroundings, unknown_startup_files


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of installed modules with one distribution."""
    place = tmp_path / "site-packages"
    info = place / "known-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: known\nVersion: 1.0\n")
    (info / "RECORD").write_text("known.pth,,\n")
    (place / "known.pth").write_text("import known_hook\n")
    monkeypatch.setattr(sysconfig, "get_path", lambda name: str(place))
    monkeypatch.setattr(surroundings.site, "ENABLE_USER_SITE", False)
    return place


def changes(subject: Path, folder: Path, change: object) -> list[str]:
    assert callable(change)
    found = Surroundings([subject], [folder], lambda: "the same")
    change()
    return [
        sentence.removesuffix(" during the run; look at it before anything else is run here")
        for sentence in found.changes()
    ]


def test_what_is_made_changed_and_removed_is_told(installed: Path, tmp_path: Path) -> None:
    subject, ini, rc = tmp_path / "otmcp.toml", tmp_path / "pytest.ini", tmp_path / "matplotlibrc"
    subject.write_text("[subject]")
    ini.write_text("[pytest]")
    plugin = installed / "evil-1.0.dist-info"

    def change() -> None:
        subject.write_text("[subject] # milder")
        ini.unlink()
        os.mkfifo(rc)
        (installed / "evil.pth").write_text("import evil")
        plugin.mkdir()
        (plugin / "entry_points.txt").write_text("[pytest11]\nevil = evil\n")

    assert changes(subject, tmp_path, change) == [
        "evil-1.0.dist-info/entry_points.txt in site-packages was made",
        "evil.pth in site-packages was made",
        "matplotlibrc was made",
        "otmcp.toml was changed",
        "pytest.ini was removed",
    ]


def test_what_runs_meanwhile_and_changes_nothing_of_that_is_not_told(installed: Path, tmp_path: Path) -> None:
    subject = tmp_path / "otmcp.toml"
    subject.write_text("[subject]")

    def change() -> None:
        (tmp_path / "adapter.log").write_text("started")
        (installed / "__pycache__").mkdir()

    assert changes(subject, tmp_path, change) == []


def test_changed_code_of_the_kit_is_told(installed: Path, tmp_path: Path) -> None:
    digests = iter(["before", "after"])
    found = Surroundings([], [tmp_path], lambda: next(digests))
    assert found.changes() == [
        "the code of the kit was changed during the run; look at it before anything else is run here"
    ]


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("evil.pth", "import os; os.system('true')\n", True),
        ("evil.pth", "/somewhere\nimport\tevil\n", True),
        ("sitecustomize.py", "", True),
        ("folders.pth", "/opt/lib/python\n# import nothing\n", False),
        ("_virtualenv.pth", "import _virtualenv\n", False),
    ],
)
def test_code_at_the_start_that_belongs_to_no_distribution_is_told(
    installed: Path, name: str, content: str, told: bool
) -> None:
    (installed / name).write_text(content)
    said = f"Python runs code at its start that belongs to no installed distribution: {name}"
    assert unknown_startup_files() == ([said] if told else [])


@pytest.mark.parametrize("command", [["--version"], ["certify", "--reps", "1"], ["verify", "none.json"]])
def test_no_other_process_of_the_user_may_look_into_a_command(tmp_path: Path, command: list[str]) -> None:
    get_dumpable = 3
    program = (
        "import ctypes\n"
        "from pytest_otmcp.cli import main\n"
        f"main({command!r})\n"
        f"raise SystemExit(ctypes.CDLL(None).prctl({get_dumpable}, 0, 0, 0, 0))\n"
    )
    assert (
        subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, check=False).returncode == 0
    )


@pytest.mark.parametrize("planted", ["settings", "pipe"])
def test_figures_are_drawn_without_the_settings_of_the_working_directory(tmp_path: Path, planted: str) -> None:
    if planted == "pipe":
        os.mkfifo(tmp_path / "matplotlibrc")
    else:
        (tmp_path / "matplotlibrc").write_text("text.usetex: True\nlines.linewidth: 77\n")
    program = (
        "from pytest_otmcp.report.figures import _matplotlib\n"
        "mpl = _matplotlib()\n"
        "assert mpl.rcParams['text.usetex'] is False, mpl.rcParams['text.usetex']\n"
        "assert mpl.rcParams['lines.linewidth'] == 1.5\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
