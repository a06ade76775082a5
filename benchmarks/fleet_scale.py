"""``python -m benchmarks.fleet_scale [ROWS]``: the time and the memory that plan, engine and merge take for a fleet of this size.

No adapter runs. The rows are those of 2000 adapters in five versions; each has the record, the verdict and the report's place of a public
adapter of ``docs/field-report``, copied, so that the merge reads as many bytes as it would of real ones.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import lzma
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path

from pytest_otmcp.fleet.outcome import RECORD, Result, judged, pack, write_result
from pytest_otmcp.fleet.plan import RUNS, Kit, read_plan
from pytest_otmcp.record.condensed import condensed
from pytest_otmcp.record.reader import open_record
from pytest_otmcp.report.verdict_file import verdict

_CHECKOUT = Path(__file__).parents[1]
_VERSIONS = 5
_KB = 1024


def main() -> None:
    """Make the fleet in a temporary folder, measure, and print a table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fleet_scale", description=__doc__)
    parser.add_argument("rows", nargs="?", type=int, default=10_000)
    rows = parser.parse_args().rows
    with tempfile.TemporaryDirectory(prefix="otmcp-fleet-", dir=Path.home()) as name:
        home = Path(name)
        fleet = home / "fleet"
        _write_fleet(home, rows)
        print(f"| {rows} rows | seconds | MB |\n|---|---|---|")
        otmcp = [sys.executable, "-P", "-m", "pytest_otmcp.cli"]
        _measure("`otmcp fleet plan`", [*otmcp, "fleet", "plan", str(home / "fleet.toml"), "--out", str(fleet)])
        engine = [
            sys.executable,
            "-m",
            "snakemake",
            f"--snakefile={_CHECKOUT / 'pytest_otmcp' / 'fleet' / 'Snakefile'}",
        ]
        engine += [f"--directory={fleet}", "--cores=2", "--dry-run", "--quiet=all", "--rerun-triggers=mtime"]
        _measure("Snakemake, before the first row", engine)
        # In a process of its own: what this one holds would count as the memory of the programs that it starts.
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as apart:
            size = apart.submit(_carry_out, home, fleet).result()
        _measure(f"`otmcp merge`, {size / 1e9:.1f} GB of records", [*otmcp, "merge", str(fleet), "--again=0"])
        page = (fleet / "index.html").stat().st_size
        print(f"\nindex.html has {page / 1e6:.1f} MB")


def _write_fleet(home: Path, rows: int) -> None:
    shutil.copytree(_CHECKOUT / "docs" / "examples" / "plctap", home / "subject")
    text = ['name = "Synthetic"\n']
    for number in range(rows):
        adapter, version = divmod(number, _VERSIONS)
        text.append(f'[[row]]\nid = "adapter-{adapter:04}"\nversion = "1.{version}"\nsubject = "subject/otmcp.toml"\n')
        text.append('install = ["uv venv .venv", "uv pip install --python .venv adapter=={version}"]\n')
    (home / "fleet.toml").write_text("".join(text), encoding="utf-8")


def _carry_out(home: Path, fleet: Path) -> int:
    """Give each row the run of a public adapter; return the bytes of all records."""
    real, kit, size = [], asdict(Kit.installed()), 0
    for number, path in enumerate(sorted((_CHECKOUT / "docs" / "field-report").glob("*.json.xz"))):
        folder = home / f"real-{number}"
        folder.mkdir()
        (folder / "run.json").write_bytes(lzma.decompress(path.read_bytes()))
        with open_record(folder / "run.json") as run:
            told = verdict(condensed(run))
        # The records are of several kits, and a fleet is judged by one.
        real.append((folder / RECORD, {**told, "kit": {**told["kit"], **kit}}, pack(folder / "run.json")[1]))
    for number, row in enumerate(read_plan(fleet).rows):
        record, told, packed = real[number % len(real)]
        folder = fleet / RUNS / row.key
        folder.mkdir(parents=True)
        shutil.copyfile(record, folder / RECORD)
        size += record.stat().st_size
        write_result(
            folder,
            Result(
                key=row.key,
                id=row.id,
                version=row.version,
                outcome=judged(told),
                verdict=told,
                record=hashlib.sha256(json.dumps([packed, number]).encode()).hexdigest(),
                packed=packed,
                seconds=60.0,
            ),
        )
    return size


def _measure(what: str, command: Sequence[str]) -> None:
    began = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        sys.exit(f"{what} ended with {process.returncode}")
    print(f"| {what} | {time.monotonic() - began:.0f} | {used.ru_maxrss / _KB:.0f} |", flush=True)


if __name__ == "__main__":
    main()
