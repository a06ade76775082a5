"""A run for a buyer's question, and what was tested in it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.cli import main
from pytest_otmcp.core.challenge import is_nonce, seed_of
from pytest_otmcp.record.consistency import settings_faults
from pytest_otmcp.subject.tested import fingerprint

NONCE = "kX3f-29ab.Qw81:zz"


def test_the_seed_is_of_the_whole_nonce_and_fits_the_option() -> None:
    seeds = {seed_of(NONCE), seed_of(NONCE + "0"), seed_of(NONCE.lower())}
    assert len(seeds) == 3
    assert all(0 <= seed < 2**63 for seed in seeds)
    # Pinned, as another kit has to come to the same.
    assert seed_of(NONCE) == 2142957622110568942


@pytest.mark.parametrize("text", ["", "short", "x" * 129, "sixteen letters\n!", "a nonce of words"])
def test_what_could_be_guessed_or_misread_is_no_nonce(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert not is_nonce(text)
    assert main(["certify", "--challenge", text]) == 2
    assert "--challenge: expected 16 to 128 letters, digits and -_.:=" in capsys.readouterr().err


def settings(**changes: Any) -> Any:
    return {"reps": 0, "repetitions": {}, "seed": seed_of(NONCE), "challenge": NONCE, **changes}


def test_a_seed_that_does_not_follow_from_the_challenge_is_refused() -> None:
    assert list(settings_faults(settings())) == []
    assert "does not follow from the challenge" in next(settings_faults(settings(seed=1)))
    assert "does not follow from the challenge" in next(settings_faults(settings(challenge=NONCE + "0")))


# -- what was tested ------------------------------------------------------------------------------------------------------


def test_a_script_is_known_by_its_own_files_and_by_the_program_that_runs_it(tmp_path: Path) -> None:
    (tmp_path / "adapter.py").write_text("import helper\n")
    (tmp_path / "helper.py").write_text("x = 1\n")
    before = fingerprint([sys.executable, "adapter.py"], tmp_path)
    assert (before["files"], before["image"]) == (2, None)
    assert before["program"].startswith("python")
    assert before["program_sha256"] is not None
    (tmp_path / "helper.py").write_text("x = 2\n")
    after = fingerprint([sys.executable, "adapter.py"], tmp_path)
    assert {name for name in before if dict(before)[name] != dict(after)[name]} == {"files_sha256"}


def test_the_packages_beside_a_program_are_known_by_their_lists(tmp_path: Path) -> None:
    program = tmp_path / "bin" / "acme-adapter"
    listed = tmp_path / "lib" / "python3.12" / "site-packages" / "acme-1.0.dist-info" / "RECORD"
    for file, content in ((program, "#!/bin/sh\n"), (listed, "acme.py,sha256=x,1\n")):
        file.parent.mkdir(parents=True)
        file.write_text(content)
    before = fingerprint([str(program)], None)
    assert (before["program"], before["packages"], before["files"]) == ("acme-adapter", 1, 0)
    listed.write_text("acme.py,sha256=y,1\n")
    after = fingerprint([str(program)], None)
    assert {name for name in before if dict(before)[name] != dict(after)[name]} == {"packages_sha256"}


@pytest.mark.parametrize("named", [True, False])
def test_an_image_is_known_if_the_command_names_its_digest(tmp_path: Path, named: bool) -> None:
    image = "registry.example/acme@sha256:" + "a" * 64
    found = fingerprint(
        [str(tmp_path / "podman"), "run", "-i", image if named else "registry.example/acme:latest"], tmp_path
    )
    assert found["image"] == (image if named else None)
    assert found["program_sha256"] is None
