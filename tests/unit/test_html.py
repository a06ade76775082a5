"""The HTML report shows what a record says, runs nothing of what an adapter wrote, and asks no network."""

from __future__ import annotations

import base64
import copy
import hashlib
import json
import os
import re
import shutil
import subprocess
from collections import Counter
from collections.abc import Callable
from html import unescape
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.report.capabilities import Grade, earned
from pytest_otmcp.report.html import page, write_html
from pytest_otmcp.report.plainly import in_words
from pytest_otmcp.suite.catalogue import all_tasks
from pytest_otmcp.suite.requirements import requirements

from .samples import around as checks
from .samples import call, entry, finding, item, run, wire, written_twice
from .test_latex import ALL, M1

VOID = {"meta", "link", "input"}
HOSTILE = "\"'><script>alert(1)</script><img src=x onerror=alert(2)>{{ 7*7 }}{% raw %}&lt;\u202e\x1b[31m"

UNCLAIMED = {**item("Q2", "normal", "MQTT", "Inspect.", []), "status": "NOT_APPLICABLE", "planned": 30}
BROKEN_KIT = {
    **item("O1", "normal", "OPC UA", "Read.", []),
    "status": "KIT_ERROR",
    "planned": 3,
    "findings": [
        {"code": "kit_error", "message": "the device died", "requirement": None, "evidence": None, "strength": "MUST"}
    ],
}


class Page(HTMLParser):
    """A parsed page; tags that are not closed in order are refused."""

    def __init__(self, html: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: Counter[str] = Counter()
        self.attributes: list[tuple[str, str, str]] = []
        self.texts: list[tuple[str, str]] = []
        self.feed(html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags[tag] += 1
        self.attributes += [(tag, name, value or "") for name, value in attrs]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert "svg" in self.open
        self.handle_starttag(tag, attrs)
        self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append((self.open[-1] if self.open else "", data))

    def values(self, name: str) -> list[str]:
        return [value for _, found, value in self.attributes if found == name]

    @property
    def text(self) -> str:
        """The text that a person reads, with one blank for every gap."""
        return " ".join(" ".join(data for tag, data in self.texts if tag != "style").split())


def hostile(value: Any) -> Any:
    """Replace every text of the record that an adapter, or its subject file, can choose by a harmful one."""
    fixed = {
        "id",
        "suite",
        "status",
        "role",
        "schema",
        "verdict",
        "digest",
        "variant",
        "direction",
        "started_at",
        "strength",
    }
    if isinstance(value, dict):
        return {
            name: inner if name in fixed or (name == "family" and isinstance(inner, str)) else hostile(inner)
            for name, inner in value.items()
        }
    if isinstance(value, list):
        return [hostile(inner) for inner in value]
    return HOSTILE if isinstance(value, str) else value


PDFTOTEXT = shutil.which("pdftotext")


def chromium() -> str | None:
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@pytest.fixture
def browse(tmp_path: Path) -> Callable[..., tuple[str, list[str]]]:
    """A function that opens a page in a real browser, and returns the browser's DOM and the lines of its console."""

    def start(path: Path, *tasks: str) -> tuple[str, list[str]]:
        program = chromium()
        assert program is not None
        options = [
            "--headless",
            "--disable-gpu",
            "--disable-dev-shm-usage",
            "--enable-logging=stderr",
            f"--user-data-dir={tmp_path / 'profile'}",
        ]
        # Chromium has no sandbox for root, as in a container of a CI job.
        options += ["--no-sandbox"] if os.geteuid() == 0 else []
        command = [program, *options, *(tasks or ("--dump-dom",)), path.as_uri()]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
        return done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line]

    return start


RUNS = {
    "complete": run(ALL),
    "one item": run([M1]),
    "empty": run([]),
    "incomplete": run(ALL, complete=False),
    "parallel": run(ALL, timing_valid=False),
    "failing": run([*ALL, written_twice(3), UNCLAIMED, BROKEN_KIT]),
}
RUNS["failing"]["settings"]["narrowed"] = ["a conftest replaced something"]
RUNS["failing"]["subject"]["deviations"] = [{"item": "M3", "reason": "known", "expires": "2027-03-01"}]
RUNS["failing"]["subject"]["adapters"]["modbus"] |= {
    "command": ["acme", "--stdio"],
    "server_name": "acme",
    "server_version": "1",
    "protocol_version": "2026-07-28",
    "unmet": ["ENV-001"],
    "unclaimed": {"guard": "there is none"},
}
RUNS["failing"]["environment"] |= {"platform": "Linux", "packages": {"mcp": "2.3.0"}}
RUNS["hostile"] = hostile(copy.deepcopy(RUNS["failing"]))


@pytest.fixture(params=RUNS, name="record")
def every_record(request: pytest.FixtureRequest) -> dict[str, Any]:
    chosen: dict[str, Any] = RUNS[request.param]
    return chosen


def test_every_page_is_well_formed_and_its_links_lead_somewhere(record: dict[str, Any]) -> None:
    shown = Page(page(record))
    ids = shown.values("id")
    assert len(ids) == len(set(ids))
    assert all(re.fullmatch(r"\S+", name) for name in ids)
    targets = [*shown.values("href"), *shown.values("for")]
    assert {target for target in targets if not target.startswith("#")} <= {"data:,", "run.json", "only"}
    assert {target[1:] for target in targets if target.startswith("#")} <= set(ids)


def test_every_page_allows_its_own_style_sheet_and_nothing_else(record: dict[str, Any]) -> None:
    html = page(record)
    shown = Page(html)
    style = "".join(data for tag, data in shown.texts if tag == "style")
    digest = base64.b64encode(hashlib.sha256(style.encode()).digest()).decode()
    policy = next(value for value in shown.values("content") if value.startswith("default-src"))
    assert policy == (
        f"default-src 'none'; style-src 'sha256-{digest}'; img-src data:; base-uri 'none'; form-action 'none'"
    )
    assert shown.tags["style"] == 1
    assert not {"script", "iframe", "object", "img", "form", "base"} & shown.tags.keys()
    names = {name for _, name, _ in shown.attributes}
    assert not {name for name in names if name.startswith("on")} | names & {"style", "src", "srcset", "action"}
    assert "@import" not in style
    assert "url(" not in style


def test_nothing_that_an_adapter_wrote_becomes_markup() -> None:
    harmless, harmful = Page(page(RUNS["failing"])), Page(page(RUNS["hostile"]))
    # Some texts of the page depend on the texts that were replaced; no kind of tag, and no attribute's name, does.
    assert set(harmful.tags) == set(harmless.tags)
    assert {name for _, name, _ in harmful.attributes} == {name for _, name, _ in harmless.attributes}
    assert "<script>alert(1)</script>" in harmful.text
    assert "{{ 7*7 }}" in harmful.text
    assert r"\u202e\x1b[31m" in harmful.text
    assert "\u202e" not in harmful.text


def test_an_item_may_be_called_anything() -> None:
    strange = item('"><b> x#', "normal", "Modbus", "Strange.", [1.0], failing=1)
    shown = Page(page(run([strange, M1])))
    assert shown.tags["b"] == Page(page(run([M1, item("M2", "normal", "Modbus", "x", [1.0], failing=1)]))).tags["b"]
    assert "item_0" in shown.values("id")


def test_a_failure_shows_what_was_said_and_what_the_device_saw_in_the_order_of_time() -> None:
    shown = Page(page(run([M1, written_twice()]))).text
    at = [
        shown.index(words)
        for words in (
            "WR-003 A write that was asked for once is sent once",
            "the device should have seen one write, it saw 2",
            "pytest --pyargs pytest_otmcp.conformance --otmcp-reps=1 -k '[M3]'",
            "M3 ✗ failed Write a register.",
            "FC 06; FC 06",
            '+0.00 modbus → towards the device: write_register {"address": 1, "value": 40} request frame {"method"',
            "+0.50 modbus device, connection 1 → towards the device: request: write single register changes the device",
            "+0.60 modbus device, connection 1 ← back from the device: response: write single register",
            "+1.50 modbus device",
            '+2.00 modbus ← back from the device: success {"value": 40}, after 2.00 ms envelope {',
        )
    ]
    assert at == sorted(at)


def test_a_call_without_an_answer_says_so() -> None:
    failed = written_twice()
    spoken = failed["samples"][0]["calls"][0]
    spoken |= {"latency_ms": None, "envelope": None, "ok": False, **wire("{}", None, 100, None)}
    shown = Page(page(run([failed]))).text
    # Everything that the device saw came before the end of the wait.
    assert shown.index("+1.50 modbus device") < shown.index("no reply not as required timeout")


def test_an_error_and_its_reason_are_on_the_line_of_the_answer() -> None:
    failed = written_twice()
    failed["samples"][0]["calls"][0] |= {
        "ok": False,
        "error_code": "not_writable",
        "envelope": {"success": False, "error": {"code": "not_writable", "message": "read only"}},
    }
    assert "not_writable not as required read only, after 2.00 ms" in Page(page(run([failed]))).text


def test_calls_whose_times_are_not_recorded_come_first() -> None:
    failed = written_twice()
    for name in ("frames", "sent_ns", "received_ns"):
        del failed["samples"][0]["calls"][0][name]
    shown = Page(page(run([failed]))).text
    assert shown.index("write_register") < shown.index("success") < shown.index("+0.00 modbus device")


def test_the_same_fault_is_shown_once_however_often_it_happened() -> None:
    shown = Page(page(run([written_twice(30)])))
    assert "Repetition 1 of 30, and 29 more like it" in shown.text
    # On its card, and as the finding of its item.
    assert shown.text.count("it saw 2") == 2


def test_faults_of_other_kinds_are_shown_each() -> None:
    failed = written_twice(5)
    for index in range(1, 5):
        failed["samples"][index]["findings"][0] = finding(f"kind_{index}", f"another {index}", "WR-003")
    shown = Page(page(run([failed]))).text
    assert all(f"another {index}" in shown for index in (1, 2))
    assert "another 3" not in shown
    assert "2 more kinds of failing repetitions are in run.json." in shown


def test_what_failed_around_the_repetitions_is_shown_with_its_calls_and_its_device() -> None:
    around = item("M4", "normal", "Modbus", "Refuse.", [1.0])
    spoken = {**call(1.0, role="control"), "variant": "ro", **wire("{}", "{}", 10, 11)}
    around |= {
        "status": "FAIL",
        "findings": [finding("x", "control: it wrote", "WR-004")],
        "around": [
            checks("warmup", call(1.0, role="warmup")),
            checks("control", spoken) | {"device": [entry(10.5, "in", "request", function=6, variant="ro")]},
        ],
    }
    shown = Page(page(run([around]))).text
    assert "Asked ping {} (of the launch 'ro') The adapter said something that is no envelope The device saw" in shown
    assert "Around the repetitions: warm-up, set-up and controls control: it wrote WR-004" in shown
    assert "modbus (writes disabled), control" in shown
    assert "modbus device, connection 1 (writes disabled)" in shown
    # The warm-up showed no fault: its frames are not in the record, and it is not shown as evidence.
    assert "modbus, warm-up" not in shown


def test_a_message_on_the_wire_is_shown_as_text_where_it_is_text() -> None:
    failed = written_twice()
    failed["samples"][0]["device"] = [
        entry(101, "in", "PUBLISH", topic="line/1", payload=base64.b64encode(b"start \xc3\xa4").decode()),
        entry(101, "in", "PUBLISH", topic="line/2", payload=base64.b64encode(b"\xff\x00").decode()),
    ]
    shown = Page(page(run([failed]))).text
    assert 'topic=line/1 payload="start ä"' in shown
    assert "topic=line/2 payload=/wA=" in shown


def test_a_long_conversation_is_cut_in_its_middle() -> None:
    failed = written_twice()
    failed["samples"][0]["device"] = [entry(101 + index, "in", "request", seq=index) for index in range(200)]
    shown = Page(page(run([failed]))).text
    assert "152 events are left out here; run.json has them." in shown
    assert "+200.00" in shown


def test_what_went_wrong_in_the_middle_of_a_long_conversation_is_not_cut() -> None:
    failed = written_twice()
    calls = [{**call(1.0), **wire(f"request {index}", "{}", index, index + 0.5)} for index in range(100)]
    calls[60] |= {"ok": False, "error_code": "timeout", "envelope": {"success": False}}
    failed["samples"][0] |= {"calls": calls, "device": []}
    shown = Page(page(run([failed]))).text
    assert "+60.50 modbus ← back from the device: timeout not as required" in shown
    assert "request 60" in shown
    assert "+40.00" not in shown


def test_a_run_that_passes_is_a_small_page() -> None:
    rules = [item(f"RD-{index:03}", "normal", "Modbus", "A rule in one sentence.", [1.0] * 30) for index in range(200)]
    assert len(page(run(rules))) < 400_000


@pytest.mark.long
def test_a_run_that_fails_everywhere_with_endless_texts_is_a_page_below_twenty_megabytes() -> None:
    endless = '"<&>' * 3_000
    failed = written_twice(6)
    for index, sample in enumerate(failed["samples"]):
        spoken = {**sample["calls"][0], "arguments": {"x": endless}, "envelope": {"success": True, "data": endless}}
        sample["calls"] = [{**spoken, **wire(endless, endless, 1, 2)}] * 50
        sample["device"] = [entry(1, "in", "request", value=endless)] * 50
        sample["findings"] = [finding(f"{index}", endless, evidence=endless)] * 30
    record = run([])
    record["items"] = [{**failed, "id": f"WR-{index:03}"} for index in range(200)]
    size = len(page(record).encode())
    # The page still shows so much that the upper bound means something.
    assert 1_000_000 < size < 20_000_000


def test_the_verdict_is_in_words_first_and_what_narrowed_the_run_is_beside_it() -> None:
    shown = Page(page(run(ALL))).text
    assert "Verdict: ✓ CONFORMANT level not tested 6 of 38 items passed" in shown
    assert "What this run does not cover" not in shown
    record = run([*ALL, UNCLAIMED], complete=False, timing_valid=False)
    record["settings"] = {
        "reps": 3,
        "suites": ["normal"],
        "time_scale": 2.0,
        "era": "legacy",
        "broker": "mqtt://127.0.0.1:1884",
    }
    narrowed = Page(page(record)).text
    assert "Verdict: ○ INCOMPLETE 6 of 38 items passed, 1 does not apply" in narrowed
    assert narrowed.index("What this run does not cover") < narrowed.index("The run is not complete")
    for reason in (
        "The run is not complete: interrupted by the user.",
        "These suites were left out: fault, stress, recovery.",
        "With N = 3 instead of 30, an item that passes every time is shown to pass at least 36.8 % of the time",
        "1 does not apply: Q2: not claimed.",
        "Deadlines and windows were multiplied by 2.0.",
        "in the legacy era",
        "a foreign one, mqtt://127.0.0.1:1884",
        "Items ran in parallel",
    ):
        assert reason in narrowed


def test_known_deviations_are_listed_and_excuse_nothing() -> None:
    record = run([written_twice()])
    record["footer"]["deviations"] = {"used": ["M3"], "stale": [], "expired": []}
    record["subject"]["deviations"] = [{"item": "M3", "reason": "fixed in 2.5", "expires": "2027-03-01"}]
    shown = Page(page(record))
    assert "Known deviations" in shown.text
    assert "M3 : fixed in 2.5 (until 2027-03-01; it fails, and is excused from the exit code)" in shown.text
    assert "✗ NOT CONFORMANT" in shown.text


def test_what_is_to_be_known_of_an_adapters_answers_is_beside_its_name() -> None:
    record = run([M1])
    record["subject"]["adapters"]["modbus"] |= {
        "command": ["acme", "--stdio"],
        "envelope": "synthesised",
        "unmet": ["ENV-001"],
        "unjudged": ["write_holding.value"],
        "unclaimed": {"guard": "writes cannot be turned off"},
    }
    shown = Page(page(record)).text
    assert (
        "acme --stdio Its answers are not the envelope; the subject file says how they were read. "
        "Not claimed, and not met by its own answers: ENV-001. "
        "Not found in its answers, so not judged: write_holding.value. "
        "Does not claim guard: writes cannot be turned off."
    ) in shown


def test_an_item_that_does_not_apply_says_why_and_takes_nothing_from_what_was_earned() -> None:
    why = "modbus.ping is not claimed: there is no such tool"
    unclaimed = {**item("M1", "normal", "Modbus", "Ping.", []), "status": "NOT_APPLICABLE", "reason": why, "planned": 3}
    shown = Page(page(run([unclaimed, item("M2", "normal", "Modbus", "Read.", [2.0])]))).text
    assert f"M1 ○ not claimed Ping. {why}" in shown
    assert "✓ earned M2 without M1" in shown


def test_an_adapter_of_which_a_ping_alone_was_asked_has_not_earned_reading() -> None:
    unasked = {**item("M2", "normal", "Modbus", "Read.", []), "status": "NOT_APPLICABLE", "reason": "no tool"}
    (_, by_family) = next(row for row in earned(run([M1, unasked])) if row[0].name == "Reading")
    assert by_family["Modbus"].grade is Grade.NOT_ASKED


def test_the_first_lines_say_which_run_it_is() -> None:
    record = run([M1])
    for protocol, transport in (("modbus", "http"), ("mqtt", "stdio"), ("opcua", "stdio")):
        record["subject"]["adapters"][protocol]["transport"] = transport
    shown = Page(page(record)).text
    assert (
        "Date 2026-11-21 07:03 UTC Duration 1.0 s Kit pytest-otmcp 0.0.0 Repetitions N = 30 "
        "MCP revision 2026-07-28 Transport streamable HTTP, stdio Every item that applies passed"
    ) in shown
    # Checks run once, whatever N is.
    record["settings"]["suites"] = ["requirements"]
    assert "Repetitions one of each check MCP revision" in Page(page(record)).text
    # A record of an earlier kit does not say how it spoke to the adapters.
    assert "Transport — Every item that applies passed" in Page(page(run([M1]))).text


def of_every_protocol() -> dict[str, Any]:
    """A run of everything that there is; a fault item of each protocol failed, so that the longest grade is among the cells."""
    return run(
        [
            item(task.id, task.suite, task.family, task.title, [1.0], failing=int(task.suite == "fault"))
            for task in all_tasks().values()
        ]
    )


def test_many_protocols_are_rows_and_what_may_be_connected_columns() -> None:
    families = {task.family for task in all_tasks().values()}
    html = page(of_every_protocol())
    matrix = html.partition('<section id="earned">')[2].partition("</section>")[0]
    heads = re.findall(r'<th scope="row">([^<]*)</th>', matrix)
    assert len(heads) > 5
    assert set(heads) == families
    # What decided an earned capability is folded where it is long: a column of fifty names would hide the grade.
    assert re.search(r"<summary>\d+ items</summary>", matrix)
    assert "turned" not in page(run(ALL)).partition("<body>")[2]


@pytest.mark.long
@pytest.mark.skipif(chromium() is None, reason="no Chromium is installed")
@pytest.mark.parametrize("width", [1280, 500])
def test_the_tables_of_every_protocol_fit_a_screen_and_a_telephone(tmp_path: Path, browse: Any, width: int) -> None:
    path = tmp_path / "report.html"
    html = page(of_every_protocol())
    # The page forbids scripts, this one too, which measures.
    measure = (
        "<script>document.title = JSON.stringify([...document.querySelectorAll('.wide:has(.matrix)')]"
        ".map(part => [part.getAttribute('aria-label'), part.scrollWidth - part.clientWidth]))</script>"
    )
    html = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", html).replace("<details", "<details open")
    path.write_text(html.replace("</body>", f"{measure}</body>"), encoding="utf-8")
    dom, _ = browse(path, f"--window-size={width},900", "--dump-dom")
    measured = dict(json.loads(unescape(re.findall("<title>(.*?)</title>", dom)[0])))
    assert "What was earned" in measured
    assert max(measured.values()) == 0, measured


def test_outages_that_do_not_apply_have_no_row_and_empty_settings_are_not_named() -> None:
    lost = {**item("R-modbus", "recovery", "Modbus", "Recover.", []), "status": "NOT_APPLICABLE", "planned": 20}
    record = run([M1, lost])
    record["settings"] |= {"protocols": [], "not_measured": {}, "xdist_workers": 0}
    shown = Page(page(record)).text
    assert "medians in milliseconds, rates with their bound" not in shown
    assert "xdist_workers: 0" in shown
    assert "protocols:" not in shown
    assert "not_measured" not in shown


def test_the_answer_in_plain_words_comes_before_its_evidence() -> None:
    shown = Page(page(run([written_twice()]))).text
    words = (
        'Asked write_register {"address": 1, "value": 40} The adapter said success, {"value": 40} '
        "The device saw FC 06 address 1 quantity None values [40] FC 06 address 1 quantity None values [40]"
    )
    assert shown.index(words) < shown.index("the device should have seen one write")
    silent = written_twice()
    silent["samples"][0]["device"] = []
    assert "The device saw nothing" in Page(page(run([silent]))).text


def opened(shown: Page, kind: str) -> list[bool]:
    """Tell of each <details> of a class whether it is unfolded."""
    names = [(tag, name, value) for tag, name, value in shown.attributes if tag == "details"]
    found = []
    for index, (_, name, value) in enumerate(names):
        if (name, value) == ("class", kind):
            found.append(index + 1 < len(names) and names[index + 1][1] == "open")
    return found


def test_a_suite_that_passed_is_one_line_and_one_that_failed_is_unfolded() -> None:
    shown = Page(page(run([M1, item("FM1", "fault", "Modbus", "Read.", [1.0] * 3, failing=1)])))
    assert opened(shown, "suite") == [False, True]
    assert "Normal Does it do what it is asked? 1/1 items, 30/30 repetitions" in shown.text


def test_a_row_unfolds_to_what_is_asked_and_judged() -> None:
    shown = Page(page(run([M1]))).text
    assert "Asked Ask whether the device can be reached. Must be said Success" in shown
    assert "Must be seen at the device" in shown


def test_protocols_without_an_adapter_have_no_column() -> None:
    unclaimed = [{**UNCLAIMED, "reason": "the subject has no adapter for MQTT"}]
    record = run([M1, *unclaimed])
    record["subject"]["adapters"] = {"modbus": record["subject"]["adapters"]["modbus"]}
    assert set(Page(page(record)).values("data-of")) == {"Modbus"}
    assert "MQTT" not in page(record)


def test_requirements_that_were_kept_are_folded_and_the_others_are_not() -> None:
    passed = {**M1, "requirements": ["MCP-008"]}
    shown = Page(page(run([passed, written_twice()]))).text
    kept = shown.index("requirement was kept, as far as the items show")
    assert shown.index("WR-003 MUST") < kept < shown.index("MCP-008 MUST")


def test_a_failed_control_does_not_look_like_a_pass() -> None:
    lost = {**item("S10", "stress", "Modbus", "Restart.", [1.0] * 2), "status": "FAIL"}
    lost["findings"] = [finding("no_reply", "control: no reply", "REC-002")]
    shown = Page(page(run([lost]))).text
    assert "2/2, failed beside the repetitions — " in shown


def luminance(colour: str) -> float:
    """Relative luminance, as WCAG 2.2 defines it."""
    parts = [int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    red, green, blue = (part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(one: str, other: str) -> float:
    """Contrast ratio, as WCAG 2.2 defines it."""
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def test_every_text_can_be_read_on_every_ground_in_light_dark_and_print() -> None:
    style = "".join(data for tag, data in Page(page(RUNS["failing"])).texts if tag == "style")
    themes = [
        dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{6})", block))
        for block in re.findall(r":root \{([^}]*--page[^}]*)\}", style)
    ]
    assert len(themes) == 3
    grounds = {"page": ("ink", "soft", "link", "good", "bad"), "panel": ("ink", "soft", "link")}
    grounds |= {f"{tone}-panel": ("ink", "soft", "link", tone) for tone in ("good", "bad", "open")}
    for theme in themes:
        for ground, inks in grounds.items():
            assert {ink: ratio for ink in inks if (ratio := contrast(theme[ink], theme[ground])) < 4.5} == {}, ground


def test_a_requirement_is_violated_only_where_a_finding_names_it() -> None:
    shown = Page(page(run([M1, written_twice()]))).text
    table = shown[shown.index("Requirements by adapter “Violated”") :]
    rows = {
        name: table[table.index(f"{name} {row.strength} {row.statement}") :]
        for name, row in requirements().items()
        if name in table
    }
    assert re.match(r"WR-001 [^✗○✓]*○ not shown M3", rows["WR-001"])
    assert re.match(r"WR-003 [^✗○✓]*✗ violated M3", rows["WR-003"])


def test_a_finding_leads_to_the_words_and_the_source_of_its_requirement() -> None:
    shown = Page(page(run([M1, written_twice()])))
    row = requirements()["WR-003"]
    assert shown.values("href").count("#rule-WR-003") >= 2
    assert "rule-WR-003" in shown.values("id")
    assert row.related
    assert f"WR-003 MUST {row.statement} Source: {row.source}. Related: {row.related}." in shown.text


def test_a_requirement_of_another_catalogue_has_an_anchor_all_the_same() -> None:
    foreign = written_twice()
    for sample in foreign["samples"]:
        sample["findings"][0]["requirement"] = "ACME 7"
    shown = Page(page(run([foreign])))
    assert {target[1:] for target in shown.values("href") if target.startswith("#rule")} <= set(shown.values("id"))
    assert "ACME 7" in shown.text


def test_an_item_that_cannot_be_tested_says_why_and_names_the_keys() -> None:
    why = "modbus: the subject binds no tool to the operation 'ping'"
    untestable = {**item("M1", "normal", "Modbus", "Ping.", []), "status": "NOT_TESTABLE", "planned": 3, "reason": why}
    assert why in Page(page(run([untestable]))).text
    late = written_twice()
    late["samples"][0]["findings"][0]["code"] = "deadline_missed"
    assert "In the subject file deadline_s: Time within which" in Page(page(run([late]))).text


def test_deadlines_stand_beside_the_verdict_and_the_adapters() -> None:
    record = run([M1])
    record["subject"]["adapters"]["mqtt"]["deadline_s"] = 12.5
    shown = Page(page(record)).text
    assert "Deadlines of a call: Modbus 5 s, MQTT 12.5 s, OPC UA 5 s." in shown
    assert "mqtt acme 1 2026-07-28 15 12.5" in shown
    assert "1 of 38 items passed ; 30 of 30 repetitions" in shown


def test_latencies_of_a_parallel_run_are_not_drawn() -> None:
    assert Page(page(RUNS["complete"])).tags["figure"] == 2
    shown = Page(page(RUNS["parallel"]))
    assert shown.tags["figure"] == 0
    assert "Latencies are withheld" in shown.text
    assert "1.50" not in shown.text


def test_pictures_bear_times_that_a_clock_cannot_have() -> None:
    odd = item("M1", "normal", "Modbus", "Ping.", [0.0, 1e9])
    lost = item("R-modbus", "recovery", "Modbus", "Recover.", [1.0])
    lost["samples"][0]["phases"] |= {"detect": 0.0, "same_session": None, "same_session_ok": False}
    shown = Page(page(run([odd, lost])))
    assert "did not happen" in shown.text
    assert "nan" not in " ".join(shown.values("x"))


@pytest.mark.long
@pytest.mark.skipif(chromium() is None, reason="no Chromium is installed")
def test_a_browser_shows_the_page_runs_nothing_and_complains_about_nothing(tmp_path: Path, browse: Any) -> None:
    path = tmp_path / "report.html"
    write_html(RUNS["hostile"], path)
    dom, console = browse(path)
    assert "INDETERMINATE" in dom
    assert console == []
    made, written = Page(dom), Page(path.read_text(encoding="utf-8"))
    assert made.tags == written.tags
    assert made.text == written.text
    # A console that never says anything would prove nothing: it does report what the page forbids.
    path.write_text(
        path.read_text(encoding="utf-8").replace("<body>", "<body><script>alert(1)</script>"), encoding="utf-8"
    )
    _, console = browse(path)
    assert any("Content Security Policy" in line for line in console)


@pytest.mark.long
@pytest.mark.skipif(chromium() is None or PDFTOTEXT is None, reason="no Chromium, or no pdftotext")
def test_paper_has_the_beginning_of_a_long_conversation_and_what_was_wrong_in_it(tmp_path: Path, browse: Any) -> None:
    failed = written_twice()
    calls = [{**call(1.0), **wire(f"asked-{index:02}", "{}", index, index + 0.5)} for index in range(20)]
    calls[18] |= {"ok": False, "error_code": "timeout", "envelope": {"success": False}}
    failed["samples"][0] |= {"calls": calls, "device": []}
    path, pdf = tmp_path / "report.html", tmp_path / "report.pdf"
    write_html(run([failed]), path)
    browse(path, f"--print-to-pdf={pdf}")
    paper = subprocess.run([str(PDFTOTEXT), "-layout", pdf, "-"], capture_output=True, text=True, check=True).stdout
    assert "+5.00" in paper
    assert "+17.00" not in paper
    assert "not as required" in paper
    assert "Paper has the beginning of this conversation" in paper


def test_what_stands_between_backticks_in_a_rule_is_code_and_is_escaped() -> None:
    failing = item("M4", "normal", "Modbus", "Write.", [1.0], failing=1)
    for sample in failing["samples"]:
        sample["findings"] = [finding("not_refused", "it was written", "MCP-005")]
    assert '`"70"`' in requirements()["MCP-005"].statement
    shown = page(run([{**failing, "requirements": ["MCP-005"]}]))
    assert "<code>&#34;70&#34;</code>" in shown
    assert "`" not in shown.partition("<body>")[2]


def test_a_run_of_the_requirement_suite_has_a_section_about_levels() -> None:
    judged = item("WR-001.modbus", "requirements", "Modbus", "Write.", [1.0])
    shown = Page(page(run([written_twice(), judged])))
    assert "levels" in shown.values("id")
    assert "#levels" in shown.values("href")
    assert "Modbus: no level; for Bronze: 51 rows not shown (" in shown.text
    benchmark = Page(page(run([M1])))
    assert "levels" not in benchmark.values("id")
    assert (
        "Level: none is shown without the requirement suite, and no permission to connect follows; otmcp certify runs it"
        in benchmark.text
    )
    assert "none is shown" not in shown.text


def test_ids_lead_to_the_site_where_one_is_configured(monkeypatch: pytest.MonkeyPatch) -> None:
    record = run([written_twice()])
    assert "kit.example" not in page(record)
    monkeypatch.setenv("OTMCP_DOCS_URL", "https://kit.example/docs/")
    links = {value for tag, name, value in Page(page(record)).attributes if (tag, name) == ("a", "href")}
    assert {
        f"https://kit.example/docs/{where}/" for where in ("items/M3", "requirements/WR-003", "codes/not_written_once")
    } <= links


def test_what_a_finding_about_the_device_shows_is_the_call_that_gave_its_value() -> None:
    refused = {"ok": False, "tool": "write_register", "arguments": {"address": 1, "value": 63409}, "role": "task"}
    written = refused | {"ok": True, "arguments": {"address": 1, "value": 61706}}
    calls = [{**one, "latency_ms": None} for one in (written, refused)]
    told = in_words(calls, [], "1/holding_registers/1 should hold 61706, the device holds 0")
    assert told is not None
    assert told.asked == 'write_register {"address": 1, "value": 61706}'
    other = in_words(calls, [], "the device should have seen one write, it saw none")
    assert other is not None
    assert other.asked == 'write_register {"address": 1, "value": 63409}'


def test_bytes_into_a_dead_connection_and_what_came_too_late_are_what_the_device_saw() -> None:
    call = {"ok": False, "tool": "read", "role": "task", "latency_ms": 1.0, "sent_ns": 0, "received_ns": 10}
    told = in_words([call], [{"kind": "lost", "t_ns": 5, "count": 12, "request": False}])
    assert told is not None
    assert told.seen == ("12 bytes on a connection whose other end has vanished",)
    entry = {"protocol": "modbus", "kind": "request", "request": True, "unit": 1, "function": 6, "t_ns": 15}
    late = {**entry, "address": 20, "quantity": 1, "values": [7]}
    told = in_words([call], [late], "told too early", "told_too_early", "FC 06 address 20 quantity 1 values [7]")
    assert told is not None
    assert told.seen == ("(after the answer) FC 06 address 20 quantity 1 values [7]",)
    # A write that nothing confirms may be on its way when the call is answered, until another call is made.
    call |= {"adapter": "modbus", "operation": "write_holding"}
    late["state_changing"] = True
    told = in_words([call], [late])
    assert told is not None
    assert told.seen == ("(after the answer) FC 06 address 20 quantity 1 values [7]",)
    told = in_words([call, {**call, "ok": True, "sent_ns": 12, "received_ns": 30}], [late])
    assert told is not None
    assert told.seen == ()


def test_what_a_finding_shows_of_the_device_is_shown_with_the_call_during_which_it_came() -> None:
    asked = {"ok": True, "tool": "write_register", "role": "task", "latency_ms": 1.0}
    other_unit = {**asked, "arguments": {"address": 20, "value": 7}, "sent_ns": 0, "received_ns": 10}
    good = {**asked, "arguments": {"address": 1, "value": 34}, "sent_ns": 20, "received_ns": 30}
    entry = {"protocol": "modbus", "kind": "request", "request": True, "state_changing": True, "unit": 1, "function": 6}
    came = [
        {**entry, "t_ns": 5, "address": 20, "quantity": 1, "values": [7]},
        {**entry, "t_ns": 25, "address": 1, "quantity": 1, "values": [34]},
    ]
    message, shown = (
        "the device should have seen no state-changing request, it saw 1",
        "FC 06 address 20 quantity 1 values [7]",
    )
    told = in_words([other_unit, good], came, message, "wrote", shown)
    assert told is not None
    assert (told.asked, told.seen) == ('write_register {"address": 20, "value": 7}', (shown,))
    assert in_words([good], came, "the adapter did not exit", "does_not_exit") is None


def test_a_failure_in_words_of_the_adapters_own_is_told_as_one() -> None:
    envelope = {"success": False, "error": {"message": "Error: no such register", "outcome": "unknown"}}
    own = {**envelope, "meta": {"synthesised": True}}
    asked = {"ok": False, "tool": "read", "arguments": {}, "role": "task", "latency_ms": 1.0, "envelope": own}
    told = [in_words([{**asked, "error_code": code}], []) for code in ("unclassified", "illegal_address")]
    assert [one.said for one in told if one is not None] == [
        'a failure, "Error: no such register"',
        'a failure, "Error: no such register", which the subject file calls illegal_address',
    ]


def test_what_contradicts_an_adapter_is_shown_with_what_it_claimed_and_not_with_the_refusal_of_another_launch() -> None:
    asked = {"ok": True, "tool": "write_register", "arguments": {"value": 1}, "role": "task", "latency_ms": None}
    written, refused = ({**asked, "envelope": {"success": success}} for success in (True, False))
    refused["variant"] = "ro"
    message = (
        "write_register(value=1): with writes enabled the device should have seen one request that writes, it saw 0"
    )
    told = [in_words([refused, written], [], message, code) for code in ("not_written_once", "deadline_missed")]
    assert [one.asked for one in told if one is not None] == [
        'write_register {"value": 1}',
        "write_register {\"value\": 1} (of the launch 'ro')",
    ]


def test_a_missing_answer_is_not_shown_with_that_of_an_equal_call() -> None:
    silent = {"ok": True, "tool": "read", "arguments": {}, "role": "task", "latency_ms": None}
    answered = {**silent, "latency_ms": 4000.0, "envelope": {"success": True, "data": {}}}
    told = in_words([answered, silent], [], "read(): no reply within the deadline of 5 s", "no_reply")
    assert told is not None
    assert told.said == "nothing"


def test_the_verdict_says_whether_the_device_contradicts_the_adapter() -> None:
    short = item("M2", "normal", "Modbus", "Read.", [2.0], failing=1)
    for sample in short["samples"]:
        sample["findings"] = [finding("deadline_missed", "it answered after 9 s", "TMO-001", "")]
    assert "The adapter failed. Each cause is below" in Page(page(run([M1, short]))).text
    told = "The adapter failed, and its device contradicts what it said (1 of 2 causes: WR-003). Each cause"
    assert told in Page(page(run([written_twice(), short]))).text


def test_a_value_that_is_too_large_for_a_record_is_shown_in_words() -> None:
    arguments = {"payload": {"otmcp/filler": 10_000_000}, "qos": 0}
    told = in_words([{"ok": False, "tool": "publish", "arguments": arguments, "role": "task", "latency_ms": None}], [])
    assert told is not None
    assert told.asked == 'publish {"payload": "a text of 10000000 characters", "qos": 0}'
