"""The Action's annotations name the broken rules, and no word of an adapter becomes a command of GitHub."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

from pytest_otmcp.report.verdict_file import verdict

from .samples import finding, item, run

annotations: Any = runpy.run_path(str(Path(__file__).parents[2] / ".ci" / "annotations.py"))["annotations"]


def test_each_broken_rule_is_an_error_at_the_subject_file_and_what_narrowed_the_run_a_warning() -> None:
    broken = item("M2", "normal", "Modbus", "Read.", [1.0], failing=1)
    said = "read(address=1): value should be 3, the reply says 4"
    broken["samples"][0]["findings"] = [finding("wrong_value", said, "RD-001")]
    record = run([broken])
    record["settings"]["narrowed"] = ["27 items were taken out by -k M2"]
    assert list(annotations(verdict(record), "a,b:otmcp.toml")) == [
        f"::error file=a%2Cb%3Aotmcp.toml,title=RD-001 Modbus::{said}; should have said: value 3 (in M2)",
        "::warning file=a%2Cb%3Aotmcp.toml,title=narrowed::27 items were taken out by -k M2",
    ]


def test_an_adapters_words_make_no_command() -> None:
    broken = item("M2", "normal", "Modbus", "Read.", [1.0], failing=1)
    broken["samples"][0]["findings"] = [finding("x", "100 %\r\n::error::forged\x1b[2J", None)]
    (line,) = annotations(verdict(run([broken])), "otmcp.toml")
    assert line.startswith("::error file=otmcp.toml,title=x Modbus::100 %25 ")
    assert line.isprintable()
    assert line.count("::error") == 1
