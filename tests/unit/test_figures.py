"""The figures are drawn from the record, in both formats, and only where there is something to draw."""

from __future__ import annotations

from pathlib import Path

from pytest_otmcp.report.figures import write_figures

from .samples import run
from .test_latex import ALL, M1

NAMES = ("latency_boxplot", "error_classes", "recovery_modes", "recovery_phases", "protocol_map")


def test_every_figure_comes_as_pdf_and_png(tmp_path: Path) -> None:
    write_figures(run(ALL), tmp_path)
    for name in NAMES:
        assert (tmp_path / f"{name}.pdf").read_bytes().startswith(b"%PDF")
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_the_same_record_gives_the_same_bytes(tmp_path: Path) -> None:
    for directory in ("one", "two"):
        write_figures(run(ALL), tmp_path / directory)
    for name in NAMES:
        for suffix in (".png", ".pdf"):
            one, two = ((tmp_path / directory / f"{name}{suffix}").read_bytes() for directory in ("one", "two"))
            assert one == two


def test_a_stale_figure_does_not_survive_a_run_without_its_data(tmp_path: Path) -> None:
    write_figures(run(ALL), tmp_path)
    write_figures(run([M1]), tmp_path)
    assert not (tmp_path / "recovery_modes.png").exists()
    assert (tmp_path / "latency_boxplot.png").exists()


def test_latencies_of_a_parallel_run_are_not_drawn(tmp_path: Path) -> None:
    write_figures(run(ALL, timing_valid=False), tmp_path)
    assert not (tmp_path / "latency_boxplot.png").exists()
    assert (tmp_path / "recovery_modes.png").exists()
