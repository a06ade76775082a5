"""A console in a process of its own, and pages of a real browser that look at it."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import psutil
import pytest

from ..plugin.command import OTMCP

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)

END_S = 60
"""Seconds in which everything must have ended."""

Serve = Callable[..., str]
Look = Callable[..., "Page"]


@pytest.fixture
def console(tmp_path: Path) -> Iterator[Serve]:
    """A function that starts ``otmcp console`` with these arguments and returns the address that it prints.

    At the end Ctrl-C must end the console and everything that it has started.
    """
    started: list[subprocess.Popen[str]] = []

    def serve(*arguments: str | Path) -> str:
        command = [*OTMCP, "console", *map(str, arguments)]
        process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        started.append(process)
        assert process.stdout is not None
        return process.stdout.readline().split()[-1]

    yield serve
    for process in started:
        family = psutil.Process(process.pid).children(recursive=True)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=END_S)
        assert process.returncode == 0, said
        assert "the console has ended, and everything that it had started" in said
        assert "Traceback" not in said
        gone, left = psutil.wait_procs(family, timeout=END_S)
        assert left == [], (gone, left)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Debian's Chromium, or another one that is installed: Playwright's own need not be had.

    It is not kept longer, because Playwright's driver has an event loop that runs all the time, and other tests want one of their own.
    """
    playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("no Chromium is installed")
    # Chromium has no sandbox for root, as in a container of a CI job.
    options = ["--no-sandbox"] if os.geteuid() == 0 else []
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=[*options, "--disable-dev-shm-usage"])
        yield browser
        browser.close()


@pytest.fixture
def look(browser: Browser) -> Iterator[Look]:
    """A function that opens an address in a window of its own.

    No page may complain in the browser's console: the Content-Security-Policy is tested by that, too.
    """
    complaints: list[str] = []
    contexts = []

    def opened(address: str, *, width: int = 1280, dark: bool = False) -> Page:
        context = browser.new_context(
            viewport={"width": width, "height": 900}, color_scheme="dark" if dark else "light", reduced_motion="reduce"
        )
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda said: complaints.append(said.text) if said.type in ("error", "warning") else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(address)
        return page

    yield opened
    for context in contexts:
        context.close()
    assert complaints == []
