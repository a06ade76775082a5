"""The kit's own regular expressions take a time that does not grow with the square of what an adapter says."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from pytest_otmcp.core.finding import Finding, kind_of
from pytest_otmcp.core.text import harmless, marked, one_line
from pytest_otmcp.onboarding import evidence, matching
from pytest_otmcp.protocols.envelope import check_result
from pytest_otmcp.report import causes, console_lines, markdown
from pytest_otmcp.subject import answers
from pytest_otmcp.trial import proving

SIZE = 1_000_000
ROWS = (
    "a",
    "/a",
    "/a.",
    "[",
    "\\'",
    "'\\\\",
    '"\\\\',
    "#",
    "##a",
    "::",
    " ",
    "1",
    "1.",
    "-",
    "a-",
    "<a",
    ' File "',
    "`",
    "www.",
    "\\",
    "\n",
    "aError",
)
"""What worst texts are rows of: a pattern that begins with it is tried anew at each of them."""


def _leaks(text: str) -> object:
    failed = {"success": False, "data": None, "error": {"code": "timeout", "message": text}, "meta": {"endpoint": text}}
    return check_result({"structuredContent": failed, "content": [], "isError": True}, measured_latency_ms=1.0)


def _named(text: str) -> object:
    attempt: Any = SimpleNamespace(reply=SimpleNamespace(envelope={"text": text}))
    at: Any = SimpleNamespace(device=SimpleNamespace(url="modbus+tcp://127.0.0.1:1"))
    return proving._named(at, [attempt])


SEARCHES: dict[str, Callable[[str], object]] = {
    "leaks": _leaks,
    "address": _named,
    "admission": answers._ADMISSION.search,
    "values": lambda text: kind_of("code", None, text),
    "variable": lambda text: causes._VARIABLE.sub("x", Finding(code="x", message=text).message),
    "role": lambda text: causes._ROLE.sub("", text),
    "unit": lambda text: console_lines._UNIT.sub("x", text),
    "harmless": harmless,
    "marked": marked,
    "one_line": one_line,
    "markdown": lambda text: markdown.escape(Finding(code="x", message=text).message),
    "up": evidence._UP.search,
    "failing": evidence._FAILING_WORDS.search,
    "foreign": matching._FOREIGN.search,
}


@pytest.mark.long
@pytest.mark.parametrize("name", SEARCHES)
def test_a_megabyte_of_the_worst_text_takes_no_longer_than_any_other(name: str) -> None:
    for row in ROWS:
        text = row * (SIZE // len(row))
        begun = time.process_time()
        SEARCHES[name](text)
        spent = time.process_time() - begun
        assert spent < 5.0, (name, row, spent)


def test_the_message_of_a_finding_is_cut_off() -> None:
    assert len(Finding(code="json_rpc_error", message="x" * SIZE).message) < 11_000
