"""Draw ``run.svg``: what the terminal says of an adapter that answers "written" and sends nothing.

``python docs/images/run_svg.py`` runs the normal suite against such an adapter (one of the kit's own tests) and writes the
picture beside this file. Nothing in it is made up; pytest's head and foot are cut off.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from html import escape
from pathlib import Path

from pytest_otmcp.report.console_lines import wrapped

HERE = Path(__file__).resolve().parent
COLUMNS = 80
COMMAND = "pytest --otmcp-suite=normal"
COMMENT = '# the adapter says "written" and sends nothing'
SUBJECT = """
[subject]
name = "acme-modbus"
version = "2.4.1"

[adapter.modbus]
start_timeout_s = 300
command = ["{python}", "-m", "pytest_otmcp.reference_adapters.defects", "MU-14"]
env = { MODBUS_HOST = "{host}", MODBUS_PORT = "{port}" }
rw = { env = { MODBUS_WRITES_ENABLED = "true" } }
"""

NO_BREAK_SPACE = "\N{NO-BREAK SPACE}"
LINE, LETTER, LEFT, TOP = 20.0, 8.43, 16.0, 44.0
GROUND, INK, SOFT = "#16191d", "#d7dce2", "#8b949e"
# Contrast with the ground is 6 at least.
COLOURS = {"31": "#ff8078", "32": "#5fd38d", "33": "#e3b341", "36": "#76c7e8"}


def told() -> list[str]:
    """Run the suite and return the lines from its first row to the verdict, with their colours."""
    with tempfile.TemporaryDirectory() as name:
        directory = Path(name)
        (directory / "otmcp.toml").write_text(SUBJECT)
        (directory / "pytest.ini").write_text("[pytest]\n")
        command = [sys.executable, "-m", *COMMAND.split(), "--color=yes", "-p", "no:cacheprovider"]
        environment = {**os.environ, "COLUMNS": str(COLUMNS)}
        done = subprocess.run(
            command, cwd=directory, env=environment, capture_output=True, encoding="utf-8", check=False
        )
    lines = done.stdout.splitlines()
    begin = next(index for index, line in enumerate(lines) if line == "normal suite")
    end = next(index for index, line in enumerate(lines) if "VERDICT:" in line) + 1
    # A log has no moving line: it says once that devices and adapters start, and its verdict is one line.
    shown = [part for line in lines[begin:end] if "starting" not in line for part in folded(line)]
    return [line for index, line in enumerate(shown) if line or shown[index - 1]]


def folded(line: str) -> list[str]:
    """Wrap a line of one style as the kit does on a terminal."""
    style, text = re.fullmatch(r"((?:\x1b\[[\d;]*m)*)(.*)", line, re.DOTALL).groups()  # type: ignore[union-attr]
    if "\x1b" in text.removesuffix("\x1b[0m"):
        return [line]
    return [f"{style}{part}" for part in wrapped(text.removesuffix("\x1b[0m"), COLUMNS, "  ")]


def spans(line: str) -> Iterator[tuple[int, str, str]]:
    """Yield the column, the text and the style attributes of each part of a line with SGR sequences."""
    column, bold, colour = 0, False, ""
    for code, text in re.findall(r"(?:\x1b\[([\d;]*)m)|([^\x1b]+)", line):
        if text:
            shown = text.lstrip()
            column += len(text) - len(shown)
            style = f' fill="{COLOURS[colour]}"' if colour else ""
            yield column, shown, style + (' font-weight="700"' if bold else "")
            column += len(shown)
            continue
        for one in code.split(";"):
            bold = one == "1" or (bold and one not in ("", "0", "22"))
            colour = "" if one in ("", "0", "39") else one if one in COLOURS else colour


def picture(lines: list[str]) -> str:
    """Return the lines as SVG; letters stay letters, in the reader's own monospaced font."""
    height = TOP + LINE * len(lines) + 8
    width = 2 * LEFT + LETTER * COLUMNS
    rows = []
    for index, line in enumerate(lines):
        y = TOP + LINE * (index + 0.7)
        rows += [
            f'<text x="{LEFT + LETTER * column:.1f}" y="{y:.1f}" textLength="{LETTER * len(text):.1f}"{style}>{escape(text).replace(" ", NO_BREAK_SPACE)}</text>'
            for column, text, style in spans(line)
            if text.strip()
        ]
    dots = "".join(f'<circle cx="{20 + 18 * at}" cy="20" r="5.5" fill="#3a4149"/>' for at in range(3))
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" role="img">',
            "<title>A run of pytest-otmcp: an adapter that says it wrote, and did not, is caught</title>",
            f'<rect width="100%" height="100%" rx="8" fill="{GROUND}"/>{dots}',
            f'<g font-family="ui-monospace, SFMono-Regular, Menlo, Consolas, \'DejaVu Sans Mono\', monospace" font-size="14" fill="{INK}">',
            *rows,
            "</g>",
            "</svg>",
            "",
        ]
    )


def main() -> None:
    """Write the picture."""
    head = f"$ {COMMAND}  {COMMENT}"
    (HERE / "run.svg").write_text(picture([head, *told()]), encoding="utf-8")


if __name__ == "__main__":
    main()
