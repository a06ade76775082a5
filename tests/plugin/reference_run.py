"""A genuine run of the whole suite with the reference adapters, two repetitions each; the tests of a test run share it."""

from __future__ import annotations

from pathlib import Path

import pytest

from pytest_otmcp.soundness.warm_start import WarmStart
from tests.once import once

from .vendor import Repository

__all__ = ["reference_run"]


def reference_run(factory: pytest.TempPathFactory, warm_start: WarmStart) -> Path:
    """Return the path of its record, which nobody may change; the subject file is ``otmcp.toml`` three directories above it."""

    def run(directory: Path) -> str:
        repository = Repository(directory, warm_start)
        repository.reference_subject()
        outcome = repository.pytest("--otmcp-reps=2", "--otmcp-seed=7")
        assert "VERDICT" in outcome.output, outcome.output
        return str(outcome.report / "run.json")

    return Path(once(factory, "reference-run", run))
