"""Take the pictures of ``docs/console.md``: the console with an adapter that lies when its device is gone.

``python docs/images/console_png.py`` starts such an adapter (one of the kit's own tests) in the console, presses the buttons in a real
browser, and writes the pictures beside this file. It needs the extra ``dev`` and Chromium.
"""

from __future__ import annotations

import io
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, Page, expect, sync_playwright

HERE = Path(__file__).resolve().parent
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
COLOURS = 64
STILL_HEIGHT = 700
PATIENCE_MS = 60_000
SUBJECT = """
[subject]
name = "acme-modbus"
version = "2.4.1"

[adapter.modbus]
start_timeout_s = 300
command = ["{python}", "-m", "pytest_otmcp.reference_adapters.defects", "MU-14g"]
env = { MODBUS_HOST = "{host}", MODBUS_PORT = "{port}" }
rw = { env = { MODBUS_WRITES_ENABLED = "true" } }
"""


def look(browser: Browser, address: str, width: int, height: int = 900, *, dark: bool = False) -> Page:
    """Open the console in a window of its own."""
    scheme = "dark" if dark else "light"
    page = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme).new_page()
    page.goto(address)
    expect(page.locator("#connection")).to_have_text("connected")
    return page


def call(page: Page) -> None:
    """Press the button and wait for the answer."""
    calls = page.locator("#calls li").count()
    page.get_by_role("button", name="Call", exact=True).click()
    expect(page.locator("#calls li")).to_have_count(calls + 1, timeout=PATIENCE_MS)


def save(picture: bytes, name: str) -> None:
    """Write a picture with few colours: it is text on plain ground."""
    with Image.open(io.BytesIO(picture)) as image:
        image.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(HERE / f"{name}.png", optimize=True)


def still(page: Page, number: int) -> None:
    """Take one of the three stills: both sides of a call."""
    box = page.locator(".seen").bounding_box()
    assert box is not None
    save(page.screenshot(clip={**box, "height": STILL_HEIGHT}), f"console-{number}")


def pictures(address: str, browser: Browser) -> None:
    """Call, stop the device, call again; take the pictures on the way."""
    page = look(browser, address, 1280, 960)
    page.get_by_role("button", name="Start", exact=True).click()
    expect(page.locator("#call")).to_be_enabled(timeout=PATIENCE_MS)
    page.locator("#tool").select_option("write_register")
    page.locator("[data-name=address]").fill("7")
    page.locator("[data-name=value]").fill("42")
    call(page)
    expect(page.locator("#journal .own")).to_have_count(2)
    still(page, 1)
    save(page.screenshot(), "console-1280")
    page.get_by_role("button", name="Stop device").click()
    expect(page.locator("#device")).to_have_text("stopped", timeout=PATIENCE_MS)
    still(page, 2)
    call(page)
    expect(page.locator("#says")).to_contain_text("They contradict each other.")
    still(page, 3)
    dark = look(browser, address, 1280, 960, dark=True)
    expect(dark.locator("#says")).to_contain_text("They contradict each other.")
    save(dark.screenshot(), "console-dark")
    narrow = look(browser, address, 400, 1200)
    expect(narrow.locator("#says")).to_contain_text("They contradict each other.")
    narrow.locator(".seen").scroll_into_view_if_needed()
    save(narrow.screenshot(), "console-400")


def main() -> None:
    """Serve the console and take the pictures."""
    options = ["--no-sandbox"] if os.geteuid() == 0 else []
    with tempfile.TemporaryDirectory() as directory, sync_playwright() as driver:
        Path(directory, "otmcp.toml").write_text(SUBJECT)
        command = [sys.executable, "-m", "pytest_otmcp.cli", "console"]
        console = subprocess.Popen(command, cwd=directory, stdout=subprocess.PIPE, text=True)
        assert console.stdout is not None
        try:
            address = console.stdout.readline().split()[-1]
            browser = driver.chromium.launch(executable_path=CHROMIUM, args=options)
            pictures(address, browser)
            browser.close()
        finally:
            console.send_signal(signal.SIGINT)
            console.wait()


if __name__ == "__main__":
    main()
