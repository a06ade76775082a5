"""The summary for a CI job's page says what the record says, and takes no orders from an adapter."""

from __future__ import annotations

import copy
import re

import pytest

from pytest_otmcp.report.markdown import code, escape, summary

from .samples import item, run, written_twice
from .test_latex import ALL

UNCLAIMED = {**item("Q2", "normal", "MQTT", "Inspect.", []), "status": "NOT_APPLICABLE", "planned": 30}


def test_the_verdict_is_the_first_line() -> None:
    assert summary(run(ALL)).splitlines()[0] == "## ✅ CONFORMANT: ` synthetic 0 `"
    assert summary(run([written_twice()])).splitlines()[0] == "## ❌ NOT CONFORMANT: ` synthetic 0 `"
    assert summary(run(ALL, complete=False)).splitlines()[0] == "## ⚪ INCOMPLETE: ` synthetic 0 `"


def test_every_suite_has_a_table_with_a_row_for_each_item() -> None:
    lines = summary(run([*ALL, UNCLAIMED])).splitlines()
    assert [line for line in lines if line.startswith("### ")] == [
        "### Normal",
        "### Fault",
        "### Stress",
        "### Recovery",
    ]
    assert "| S1 | ✅ PASS | 10/10 | 74.1 % | 2.00 | 2.00 | Four concurrent register reads. |" in lines
    # What does not apply is one sentence, not rows without a number.
    assert not [line for line in lines if line.startswith("| Q2")]
    assert r"- 1 does not apply\: Q2\: not claimed." in lines


def test_a_table_is_whole() -> None:
    for block in re.findall(r"(?:^\|.*\n)+", summary(run([*ALL, written_twice()])), re.MULTILINE):
        rows = block.splitlines()
        assert re.fullmatch(r"\|( --- \|)+", rows[1])
        assert len({len(re.findall(r"(?<!\\)\|", row)) for row in rows}) == 1


def test_findings_come_with_the_command_that_shows_them_again_and_the_same_words_once() -> None:
    text = summary(run([written_twice(30)]))
    assert text.count("the device should have seen one write, it saw 2") == 1
    assert "  - ` the device should have seen one write, it saw 2 ` not\\_written\\_once\n" in text
    assert "  - again: ` pytest --pyargs pytest_otmcp.conformance --otmcp-reps=1 -k '[M3]' `\n" in text
    assert "### Further items" not in summary(run(ALL))


def test_findings_are_cut_where_a_page_would_burst_and_it_says_so() -> None:
    failed = written_twice(5)
    for index, sample in enumerate(failed["samples"]):
        sample["findings"][0]["message"] = "abcde"[index] + "x" * 5_000
        sample["findings"][0]["requirement"] = None
    record = run([{**failed, "id": f"M{index}"} for index in range(50)])
    for index, one in enumerate(record["items"]):
        one["samples"] = copy.deepcopy(one["samples"])
        for sample in one["samples"]:
            sample["findings"][0]["code"] = f"code_{index}"
    text = summary(record)
    assert "- 10 more causes; see report.html\n" in text
    # GitHub refuses a summary of more than one MiB.
    assert len(text.encode()) < 2**20


def test_known_deviations_are_beside_the_verdict() -> None:
    record = run([written_twice()])
    record["footer"]["deviations"] = {"used": [], "stale": [], "expired": ["M3"]}
    record["subject"]["deviations"] = [{"item": "M3", "reason": "fixed | in 2.5", "expires": "2026-03-01"}]
    assert (
        "- known deviation M3: ` fixed | in 2.5 `, until 2026-03-01; its day is over, and the exit code is 1 until it is mended or the day is moved\n"
        in summary(record)
    )


@pytest.mark.parametrize(
    ("text", "escaped"),
    [
        ("a|b\\|c", r"a\|b\\\|c"),
        ("**bold** _it_ `code`", r"\*\*bold\*\* \_it\_ \`code\`"),
        ("<b>&lt;[x](http://y)", r"\<b\>\&lt;\[x\](http\://y)"),
        ("www.y.example", r"www\.y.example"),
        ("ask @owner, see #12", "ask \\@\u200downer, see \\#\u200d12"),
        ("one\n# two\r\n- three", r"one \# two - three"),
        ("\x1b[31m\u202e", r"\\x1b\[31m\\u202e"),
    ],
)
def test_text_is_printed_as_it_is(text: str, escaped: str) -> None:
    assert escape(text) == escaped


@pytest.mark.parametrize(
    ("text", "span"),
    [
        ("plain", "` plain `"),
        ("a `b` ``c``", "``` a `b` ``c`` ```"),
        ("two\nlines", "` two lines `"),
        ("y" * 401, f"` {'y' * 400}… `"),
        ("\x07", r"` \x07 `"),
    ],
)
def test_a_code_span_cannot_be_left(text: str, span: str) -> None:
    assert code(text) == span


def test_the_causes_come_before_the_items_with_the_rule_in_plain_words() -> None:
    text = summary(run([written_twice()]))
    said = (
        "### Causes",
        "- **WR-003** Modbus: A write that was asked for once is sent once.",
        '  - asked: ` write_register {"address": 1, "value": 40} `',
        "  - the adapter said: ` success, ",
        "  - the device saw: ` FC 06",
        "  - in M3\n",
    )
    assert sorted(map(text.index, said)) == list(map(text.index, said))
    assert "### Causes" not in summary(run(ALL))
