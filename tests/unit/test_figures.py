"""The figures are drawn from the record, in both formats, and only where there is something to draw."""

from __future__ import annotations

import resource
from pathlib import Path

import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.text import Text

from pytest_otmcp.core.matrix import CROSS_PROTOCOL
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.report.families import family_colour
from pytest_otmcp.report.figures import contrast, ink_on, write_figures

from .samples import item, run
from .test_latex import ALL, M1

NAMES = ("latency_boxplot", "error_classes", "recovery_phases", "protocol_map")


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The figures of a run that has something for each of them."""
    directory = tmp_path_factory.mktemp("figures")
    write_figures(run(ALL), directory)
    return directory


def test_every_figure_comes_as_pdf_and_png(drawn: Path) -> None:
    for name in NAMES:
        assert (drawn / f"{name}.pdf").read_bytes().startswith(b"%PDF")
        assert (drawn / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_the_same_record_gives_the_same_bytes_and_replaces_what_was_there(drawn: Path, tmp_path: Path) -> None:
    for name in NAMES:
        (tmp_path / f"{name}.png").write_bytes(b"stale")
    write_figures(run(ALL), tmp_path)
    for name in NAMES:
        for suffix in (".png", ".pdf"):
            assert (tmp_path / f"{name}{suffix}").read_bytes() == (drawn / f"{name}{suffix}").read_bytes()


def test_a_stale_figure_does_not_survive_a_run_without_its_data(tmp_path: Path) -> None:
    for name in NAMES:
        (tmp_path / f"{name}.png").write_bytes(b"stale")
    write_figures(run([M1]), tmp_path)
    assert not (tmp_path / "recovery_phases.png").exists()
    assert (tmp_path / "latency_boxplot.png").exists()


def test_latencies_of_a_parallel_run_are_not_drawn(tmp_path: Path) -> None:
    write_figures(run(ALL, timing_valid=False), tmp_path)
    assert not (tmp_path / "latency_boxplot.png").exists()
    assert (tmp_path / "error_classes.png").exists()


def test_an_adapter_cannot_break_a_figure_with_the_codes_it_makes_up(tmp_path: Path) -> None:
    codes = ["$x^", "\\frac{", "a\nb", "\u202e\u4e2d", "", *(f"code_{index}" for index in range(20))]
    items = [item(f"F{index}", "fault", "Modbus", "x", [1.0], error_code=code) for index, code in enumerate(codes)]
    write_figures(run(items), tmp_path)
    assert (tmp_path / "error_classes.pdf").is_file()


@pytest.mark.parametrize("name", ["$x^$", "x" * 10**6])
def test_a_record_cannot_break_a_figure_with_the_names_it_makes_up(tmp_path: Path, name: str) -> None:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_utime
    write_figures(run([item(name, suite, name, "x", [1.0], error_code="x") for suite in ("normal", "fault")]), tmp_path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_utime - before < 5
    assert {path.stem for path in tmp_path.glob("*.png")} >= {"latency_boxplot", "error_classes"}


def test_a_family_and_times_that_nobody_thought_of_are_drawn(tmp_path: Path) -> None:
    lost = item("R-profinet", "recovery", "PROFINET", "x", [1.0])
    lost["samples"][0]["phases"] |= {"detect": 0.0, "same_session": None, "same_session_ok": False}
    write_figures(run([item("M1", "normal", "PROFINET", "x", [0.0, 1e9]), lost]), tmp_path)
    assert {path.stem for path in tmp_path.glob("*.png")} == {
        "latency_boxplot",
        "recovery_phases",
        "protocol_map",
    }


def test_a_family_that_stands_apart_is_in_the_map_alone(tmp_path: Path) -> None:
    write_figures(
        run([item("M1", "fault", "Modbus", "x", [1.0]), item("N1", "normal", "PROFINET", "x", [1.0])]), tmp_path
    )
    assert {path.stem for path in tmp_path.glob("*.png")} == {"protocol_map"}


def test_the_map_of_the_papers_protocols_is_the_papers_alone(tmp_path: Path) -> None:
    vendors = run(ALL)
    vendors["settings"]["subject"] = "otmcp.toml"
    write_figures(vendors, tmp_path)
    assert not (tmp_path / "protocol_map.png").exists()
    assert (tmp_path / "latency_boxplot.png").exists()


def test_the_map_has_every_protocol_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    every = run(ALL)
    (facts, *_) = every["subject"]["adapters"].values()
    every["subject"]["adapters"] = dict.fromkeys(protocols(), facts)
    notes: list[str] = []
    monkeypatch.setattr(
        Figure,
        "savefig",
        lambda figure, path, **_: notes.extend(
            text.get_text() for text in figure.findobj(Text) if path.name == "protocol_map.png"
        ),
    )
    write_figures(every, tmp_path)
    assert len([note for note in notes if note.endswith("evaluated")]) == len(protocols())
    # The kit has every protocol that the paper lists.
    assert [note for note in notes if note.endswith("in the paper")] == []


@pytest.fixture
def texts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> dict[str, list[tuple[str, str]]]:
    """Every text that is drawn, with its colour and the colour of what lies behind it, by figure."""
    seen: dict[str, list[tuple[str, str]]] = {}

    def look(figure: Figure, path: Path, **_: object) -> None:
        figure.canvas.draw()
        renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
        (axes,) = figure.axes
        for text in figure.findobj(Text):
            if not text.get_text() or not text.get_visible():
                continue
            (x, y), ground = text.get_window_extent(renderer).get_points().mean(axis=0), "white"
            for patch in axes.patches:
                if patch.get_window_extent(renderer).contains(x, y):
                    ground = to_hex(patch.get_facecolor())
            seen.setdefault(Path(path).stem, []).append((to_hex(text.get_color()), ground))

    monkeypatch.setattr(Figure, "savefig", look)
    write_figures(run(ALL), tmp_path)
    return seen


def test_every_text_can_be_read_on_what_lies_behind_it(texts: dict[str, list[tuple[str, str]]]) -> None:
    assert texts.keys() == set(NAMES)
    assert {ground for _, ground in texts["protocol_map"]} > {
        family_colour("Modbus").light,
        family_colour("OPC UA").light,
    }  # type: ignore[union-attr]
    for name, pairs in texts.items():
        assert {pair: ratio for pair in pairs if (ratio := contrast(*pair)) < 4.5} == {}, name


def test_black_or_white_can_be_read_on_every_ground() -> None:
    families = [*(protocol.name for protocol in protocols().values()), CROSS_PROTOCOL]
    colours = [colour.light for name in families if (colour := family_colour(name)) is not None]
    for ground in [*colours, *(str(grey / 100) for grey in range(101))]:
        assert contrast(ink_on(ground), ground) >= 4.5
    # A colour is a protocol's alone: two of them could not be told apart otherwise.
    assert len(set(colours)) == len(colours)
