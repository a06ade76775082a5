"""A fleet of six rows on this machine: interrupted, resumed, merged, and once more with a version that broke."""

from __future__ import annotations

import base64
import json
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.fleet.outcome import RECORD, RESULT, Outcome
from pytest_otmcp.fleet.page import read_lines
from pytest_otmcp.fleet.plan import RUNS, read_plan
from tests.plugin.command import OTMCP, otmcp, sentence

from .rows import plan, subject

pytest.importorskip("snakemake", reason="Snakemake is not installed")

pytestmark = pytest.mark.long

LIAR = '["{python}", "-P", "-m", "pytest_otmcp.reference_adapters.defects", "MU-07r"]'
"""Reads another table than it says."""
PATIENCE_S = 3000.0
AT_ONCE = "--snakemake=--cores 8"


def results(fleet: Path) -> dict[str, Path]:
    """Return the results that there are, by id and version."""
    found = {f"{row.id} {row.version}": fleet / RUNS / row.key / RESULT for row in read_plan(fleet).rows}
    return {name: path for name, path in found.items() if path.is_file()}


def outcomes(fleet: Path) -> dict[str, Outcome]:
    return {f"{line.id} {line.version}": line.outcome for line in read_lines(fleet / "fleet.json")}


@pytest.mark.weekly
def test_a_fleet_is_interrupted_resumed_and_merged_and_a_new_version_breaks(tmp_path: Path) -> None:
    for name, more in (("honest", ()), ("liar", (LIAR,)), ("dead", ('["false"]',)), ("typo", ())):
        subject(tmp_path, name, *more)
    typo = tmp_path / "typo" / "otmcp.toml"
    typo.write_text(typo.read_text().replace("command", "comand"))
    once, go = tmp_path / "once", tmp_path / "go"
    # The first try fails: as where an index does not answer.
    failing = f"import os, sys; there = os.path.exists('{once}'); open('{once}', 'w'); sys.exit(not there)"
    slow = f"import os, time; [time.sleep(0.1) for _ in iter(lambda: os.path.exists('{go}'), True)]"
    rows = [
        "slow 1 typo install = ['''{python} -c \"" + slow + "\"''']",
        "liar 1 liar",
        "typo 1 typo",
        "unlucky 1 honest install = ['''{python} -c \"" + failing + "\"''']",
        "nowhere 1 honest install = ['no-such-program']",
    ]
    file, fleet = plan(tmp_path, *rows), tmp_path / "fleet"

    command = [*OTMCP, "fleet", "run", str(file), "--out", str(fleet), AT_ONCE]
    with subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as running:
        deadline = time.monotonic() + PATIENCE_S
        while not fleet.joinpath("plan.json").exists() or len(results(fleet)) < 3:
            assert running.poll() is None, running.stdout and running.stdout.read()
            assert time.monotonic() < deadline
            time.sleep(0.5)
        running.send_signal(signal.SIGINT)
        assert "otmcp: interrupted" in running.communicate(timeout=PATIENCE_S)[0]
    assert running.returncode == 2
    finished = {name: path.stat().st_mtime_ns for name, path in results(fleet).items()}
    assert {*finished} == {"liar 1", "typo 1", "unlucky 1"}
    assert not any((fleet / "work").iterdir())

    go.touch()
    done = otmcp("fleet", "run", str(file), "--out", str(fleet), AT_ONCE, cwd=tmp_path)
    # One row could not be installed, and nothing that was conformant broke.
    assert done.returncode == 3, done.stdout + done.stderr
    assert "5 rows planned, 3 of them carried out before" in done.stdout
    assert {name: path.stat().st_mtime_ns for name, path in results(fleet).items() if name in finished} == finished
    assert outcomes(fleet) == {
        "slow 1": Outcome.WRONG_SUBJECT,
        "liar 1": Outcome.NOT_CONFORMANT,
        "typo 1": Outcome.WRONG_SUBJECT,
        "unlucky 1": Outcome.CONFORMANT,
        "nowhere 1": Outcome.FAULT,
    }
    lines = {line.id: line for line in read_lines(fleet / "fleet.json")}
    # Each run tries three times what fails; the first may have been interrupted among these.
    assert lines.pop("nowhere").tries >= 3
    assert {name: line.tries for name, line in lines.items()} == {
        "slow": 1,
        "liar": 1,
        "typo": 1,
        "unlucky": 2,
    }
    assert "did you mean 'command'?" in str(lines["typo"].reason)
    assert "nowhere 1: fault of kit or machine: not installed: there is no no-such-program" in done.stdout
    assert "Modbus RD-001" in lines["liar"].causes

    # A new version of what was conformant does not start; the rows that were carried out stay as they are.
    before = tmp_path / "before.json"
    before.write_bytes((fleet / "fleet.json").read_bytes())
    file = plan(tmp_path, *rows[1:4], "unlucky 2 dead")
    done = otmcp("fleet", "run", str(file), "--out", str(fleet), f"--since={before}", AT_ONCE, cwd=tmp_path)
    assert done.returncode == 1, done.stdout + done.stderr
    assert "4 rows planned, 3 of them carried out before" in done.stdout
    assert "broke: unlucky 2: did not start: the adapter exited with code 1" in done.stdout
    assert (fleet / "changes.md").read_text().count("\n- slow 1") == 1

    refused(fleet, tmp_path)


def refused(fleet: Path, here: Path) -> None:
    """What is there twice, was exchanged or changed is refused."""
    done = otmcp("merge", str(fleet), str(fleet), "--again=0", cwd=here)
    assert sentence(done).startswith("otmcp: refused: liar 1 is there twice")
    honest, liar = (results(fleet)[name].parent for name in ("unlucky 1", "liar 1"))
    document: dict[str, Any] = json.loads((liar / RESULT).read_text())
    told = json.loads((honest / RESULT).read_text())["verdict"]
    (liar / RESULT).write_text(json.dumps({**document, "verdict": told, "outcome": "conformant"}))
    done = otmcp("merge", str(fleet), "--again=9", cwd=here)
    assert "judged again, the run of liar 1 is another than its result says" in sentence(done)
    # Nothing but the verdict is another.
    changed = {**document, "verdict": {**document["verdict"], "verdict": "CONFORMANT"}, "outcome": "conformant"}
    (liar / RESULT).write_text(json.dumps(changed))
    done = otmcp("merge", str(fleet), "--again=9", cwd=here)
    assert "judged again, the run of liar 1 is another than its result says" in sentence(done)
    (liar / RESULT).write_text(json.dumps({**document, "outcome": "conformant"}))
    done = otmcp("merge", str(fleet), cwd=here)
    assert "says conformant, from its verdict follows not conformant" in sentence(done)
    for lacking in ({"verdict": None}, {"verdict": told, "packed": None}):
        (liar / RESULT).write_text(json.dumps({**document, "outcome": "conformant", **lacking}))
        done = otmcp("merge", str(fleet), cwd=here)
        assert "says conformant, and not of which record that is the verdict" in sentence(done)
    (liar / RESULT).write_text(json.dumps(document))
    (liar / RECORD).write_bytes((honest / RECORD).read_bytes())
    done = otmcp("merge", str(fleet), cwd=here)
    assert "is not the record that result.json is about" in sentence(done)


def test_a_verdict_that_the_engine_did_not_live_to_see_is_kept(tmp_path: Path) -> None:
    subject(tmp_path, "typo")
    typo = tmp_path / "typo" / "otmcp.toml"
    typo.write_text(typo.read_text().replace("command", "comand"))
    file, fleet = plan(tmp_path, "typo 1 typo"), tmp_path / "fleet"
    otmcp("fleet", "run", str(file), "--out", str(fleet), cwd=tmp_path)
    [(_, result)] = results(fleet).items()
    before = result.stat().st_mtime_ns
    # So Snakemake marks what a job was making when it was ended.
    mark = base64.b64encode(f"{RUNS}/{result.parent.name}".encode()).decode()
    (fleet / ".snakemake" / "incomplete" / mark).touch()
    done = otmcp("fleet", "run", str(file), "--out", str(fleet), cwd=tmp_path)
    assert "1 row planned, 1 of them carried out before" in done.stdout
    assert result.stat().st_mtime_ns == before
