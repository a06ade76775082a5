"""The LaTeX tables equal the paper's to the character, and LaTeX accepts them."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.report.latex import escape, write_tables

from .samples import item, run

M1 = item("M1", "normal", "Modbus", "Ping the adapter and confirm the TCP mock is reachable.", [1.1] * 30)
M2 = item("M2", "normal", "Modbus", "Read a four-register sensor block from the Modbus mock.", [1.5] * 29 + [1.7])
Q1 = item("Q1", "normal", "MQTT", "Inspect broker connectivity through the MCP adapter.", [1.8] * 30)
FM2 = item(
    "FM2",
    "fault",
    "Modbus",
    "Write overflow value (70000 > uint16 max) and expect adapter rejection.",
    [1.0] * 30,
    error_code="range_overflow",
)
S1 = item("S1", "stress", "Modbus", "Four concurrent register reads.", [2.0] * 10)
R = item("R-modbus", "recovery", "Modbus", "Recover.", [9.0] * 20)
ALL = [M1, M2, Q1, FM2, S1, R]

DOCUMENT = r"""
\documentclass{article}
\usepackage{booktabs,tabularx,array}
\newcolumntype{Y}{>{\raggedright\arraybackslash}X}
\input{exact_counts}
\begin{document}
\totalRuns{} runs, \totalToolCalls{} calls, \modbusToolCount{} tools.
\input{tab_results} \input{tab_taskbreakdown} \input{tab_faultresults}
\input{tab_stress} \input{tab_recovery} \input{tab_statistics}
\end{document}
"""


def lines(directory: Path, name: str) -> list[str]:
    return (directory / f"{name}.tex").read_text().splitlines()


def test_rows_equal_the_papers(tmp_path: Path) -> None:
    write_tables(run(ALL), tmp_path)
    assert r"        M1 & Modbus & Ping the adapter and confirm the TCP mock is reachable. & 1.1 & 1.1 \\" in lines(
        tmp_path, "tab_taskbreakdown"
    )
    assert (
        r"        FM2 & Modbus & Write overflow value (70000 $>$ uint16 max) and expect adapter rejection. & 100.0 & 1.0 "
        r"& range overflow \\" in lines(tmp_path, "tab_faultresults")
    )
    assert r"        Modbus & 2 & 100.0 & 100.0 & 1.3 & 1.5 & 100.0 \\" in lines(tmp_path, "tab_results")
    assert r"        & & (\%) & (\%) & (ms) & (ms) & (\%) \\" in lines(tmp_path, "tab_results")
    assert r"\newcommand{\totalRuns}{150}" in lines(tmp_path, "exact_counts")
    assert r"\newcommand{\modbusToolCount}{17}" in lines(tmp_path, "exact_counts")


def test_a_macro_is_named_by_letters_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    s7 = replace(protocols()["modbus"], key="s7_plus", name="S7comm")
    monkeypatch.setattr("pytest_otmcp.report.latex.protocols", lambda: {s7.key: s7})
    record = run(ALL)
    record["subject"]["adapters"] = {"s7_plus": {"tools": 20}}
    write_tables(record, tmp_path)
    assert r"\newcommand{\sSevenplusToolCount}{20}" in lines(tmp_path, "exact_counts")


FURTHER = item("K1", "normal", "Further", "Ping the controller.", [1.1] * 30)


def test_further_protocols_have_a_table_to_themselves_and_change_no_other(tmp_path: Path) -> None:
    alone, beside = tmp_path / "alone", tmp_path / "beside"
    write_tables(run(ALL), alone)
    write_tables(run([*ALL, FURTHER]), beside)
    assert r"        Further & 1 & 100.0 & 100.0 & 1.1 & 1.1 & --- \\" in lines(beside, "tab_protocols")
    assert {path.name for path in beside.iterdir()} == {"tab_protocols.tex", *(path.name for path in alone.iterdir())}
    for path in alone.iterdir():
        assert lines(alone, path.stem) == lines(beside, path.stem)


def test_a_run_of_further_protocols_alone_has_the_usual_tables(tmp_path: Path) -> None:
    write_tables(run([FURTHER]), tmp_path)
    assert not (tmp_path / "tab_protocols.tex").exists()
    assert r"        Further & 1 & 100.0 & 100.0 & 1.1 & 1.1 & --- \\" in lines(tmp_path, "tab_results")


def test_families_are_separated_by_a_rule(tmp_path: Path) -> None:
    write_tables(run(ALL), tmp_path)
    breakdown = lines(tmp_path, "tab_taskbreakdown")
    assert breakdown[breakdown.index(next(line for line in breakdown if "Q1 &" in line)) - 1].strip() == r"\midrule"


def test_latencies_of_a_parallel_run_are_withheld(tmp_path: Path) -> None:
    write_tables(run(ALL, timing_valid=False), tmp_path)
    assert "& --- & --- " in "\n".join(lines(tmp_path, "tab_taskbreakdown"))


def test_a_failure_lowers_the_rate(tmp_path: Path) -> None:
    write_tables(run([item("M1", "normal", "Modbus", "Ping.", [1.0] * 4, failing=1)]), tmp_path)
    assert r"        Modbus & 1 & 75.0 & 75.0 & 1.0 & 1.0 & --- \\" in lines(tmp_path, "tab_results")


def test_every_special_character_is_escaped() -> None:
    assert escape(r"50 % & _x_ #1 $ {a} ~ ^ \ < > |") == (
        r"50 \% \& \_x\_ \#1 \$ \{a\} \textasciitilde{} \textasciicircum{} \textbackslash{} $<$ $>$ \textbar{}"
    )


def test_what_pdflatex_cannot_set_is_shown_by_its_code_point() -> None:
    assert escape("a\x00b\nc\u202ed µ") == "aU+0000bU+000AcU+202Ed U+00B5"


def test_a_subjects_name_cannot_leave_its_comment(tmp_path: Path) -> None:
    record = run(ALL)
    record["subject"]["name"] = "x\n\\input{/etc/passwd}\r\\end"
    write_tables(record, tmp_path)
    assert all(
        line.startswith("%")
        for name in tmp_path.iterdir()
        for line in name.read_text().splitlines()
        if "passwd" in line
    )


def test_numbers_of_a_column_are_aligned_at_the_decimal_point(tmp_path: Path) -> None:
    write_tables(run(ALL), tmp_path)
    for name in (
        "tab_results",
        "tab_taskbreakdown",
        "tab_faultresults",
        "tab_stress",
        "tab_recovery",
        "tab_statistics",
    ):
        opening, *rest = (line.strip() for line in lines(tmp_path, name) if not line.startswith("%"))
        spec = re.findall(r"[lcrY]", opening.rpartition("{@{}")[2])
        table = [line.removesuffix(r" \\").split(" & ") for line in rest if line.endswith(r"\\")]
        for column, cells in enumerate(zip(*(row for row in table if len(row) == len(spec)), strict=True)):
            figures = [cell for cell in cells if re.fullmatch(r"\d+\.\d+", cell)]
            if figures:
                # Right-aligned figures with the same number of decimals have their points below each other.
                assert spec[column] == "r"
                assert len({len(figure.partition(".")[2]) for figure in figures}) == 1


def test_units_stand_in_brackets_in_every_head(tmp_path: Path) -> None:
    write_tables(run(ALL), tmp_path)
    heads = [line for path in tmp_path.iterdir() for line in path.read_text().partition("midrule")[0].splitlines()]
    assert any(r"(\%)" in line for line in heads)
    assert not [
        line for line in heads if re.search(r"[^(]\\%|\bms\b(?!\))", line.partition("% ")[0]) and "CI" not in line
    ]


HOSTILE = item("FM1", "fault", "Modbus", "\x1b\\ ^^M & \U0001f600", [1.0], error_code="\n\\end{tabularx}%")


@pytest.mark.long
@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="pdflatex is not installed")
@pytest.mark.parametrize("items", [ALL, [M1], [], [HOSTILE]], ids=["complete", "one item", "empty", "hostile"])
def test_latex_compiles_the_tables(tmp_path: Path, items: list[dict[str, object]]) -> None:
    write_tables(run(items, complete=bool(items)), tmp_path)
    (tmp_path / "document.tex").write_text(DOCUMENT)
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "document.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout[-3000:]


@pytest.mark.long
@pytest.mark.skipif(None in (shutil.which("pdflatex"), shutil.which("pdftotext")), reason="no pdflatex or pdftotext")
def test_a_reader_of_the_paper_sees_the_words_as_they_are(tmp_path: Path) -> None:
    odd = item("FM1", "fault", "Modbus", 'Read a < b | "c" > d.', [1.0])
    write_tables(run([*ALL, odd]), tmp_path)
    (tmp_path / "document.tex").write_text(DOCUMENT)
    for command in (["pdflatex", "-interaction=nonstopmode", "document.tex"], ["pdftotext", "-raw", "document.pdf"]):
        subprocess.run(command, cwd=tmp_path, capture_output=True, timeout=120, check=True)
    told = " ".join((tmp_path / "document.txt").read_text(encoding="utf-8").split())
    assert "70000 > uint16" in told
    assert "Read a < b" in told
    assert "> d." in told
    assert not {"¡", "¿"} & set(told)
