"""The engine accepts the workflow with each shipped profile: a dry run with the engine's own plugin, in an environment of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from pytest_otmcp.fleet.plan import write_plan
from tests.once import once

from .rows import plan, subject

pytestmark = pytest.mark.long

SNAKEFILE = Path(__file__).parents[2] / "pytest_otmcp" / "fleet" / "Snakefile"
PACKAGES = [
    "snakemake==9.27.1",
    "snakemake-executor-plugin-slurm",
    "snakemake-executor-plugin-kubernetes",
    "snakemake-executor-plugin-aws-batch",
    "snakemake-storage-plugin-fs",
]


@pytest.fixture(scope="session")
def engine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment with Snakemake and its plugins, without the kit: one of them wants another python-dateutil than asyncua."""
    if os.environ.get("OTMCP_NO_NETWORK"):
        pytest.skip("OTMCP_NO_NETWORK forbids to install the plugins")

    def make(directory: Path) -> str:
        uv, python = [sys.executable, "-m", "uv"], directory / "bin" / "python"
        for step in (
            [*uv, "venv", "--quiet", "--allow-existing", "--python", sys.executable, str(directory)],
            [*uv, "pip", "install", "--quiet", "--python", str(python), *PACKAGES],
        ):
            done = subprocess.run(step, capture_output=True, text=True, check=False)
            if done.returncode:
                return f"not installed: {done.stderr.strip()[-200:]}"
        return str(python)

    made = once(tmp_path_factory, "engine", make)
    if made.startswith("not installed"):
        pytest.skip(made)
    return Path(made)


@pytest.mark.parametrize("profile", ["slurm", "kubernetes", "aws-batch"])
def test_a_dry_run_of_each_profile_plans_every_row(engine: Path, tmp_path: Path, profile: str) -> None:
    subject(tmp_path, "honest")
    fleet = tmp_path / "fleet"
    planned = write_plan(plan(tmp_path, "honest 1 honest", "honest 2 honest"), fleet)
    command = [engine, "-m", "snakemake", f"--snakefile={SNAKEFILE}", f"--directory={fleet}", "--dry-run"]
    command.append(f"--profile={SNAKEFILE.parent / 'profiles' / profile}")
    if profile != "slurm":
        # The profile's own storage is a bucket, or a volume, that is not here.
        command += ["--default-storage-provider=fs", f"--default-storage-prefix={fleet}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stderr[-2000:]
    told = done.stdout + done.stderr
    assert all(f"wildcards: key={row.key}" in told for row in planned.rows)
    assert "runtime=50" in told
