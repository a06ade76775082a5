"""Print what ``verdict.json`` says as annotations of a GitHub job: ``python annotations.py VERDICT.JSON SUBJECT``.

A cause quotes the adapter, which may write anything: what GitHub would take for a command's end, or a command of its own, is escaped.
https://docs.github.com/actions/reference/workflows-and-actions/workflow-commands
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pytest_otmcp.core.text import one_line


def annotations(verdict: dict[str, Any], subject: str) -> Iterator[str]:
    """Yield an error for each rule that is broken, and a warning for what narrowed the suite; ``subject`` is the subject file."""
    for cause in verdict["causes"]:
        items = " ".join(cause["items"][:5])
        due = f"; should have said: {cause['due']}" if cause["due"] else ""
        yield _command(
            "error", subject, f"{cause['rule']} {cause['protocol']}", f"{cause['message']}{due} (in {items})"
        )
    for sentence in verdict["narrowed"]:
        yield _command("warning", subject, "narrowed", sentence)


def _command(kind: str, file: str, title: str, text: str) -> str:
    return f"::{kind} file={_property(file)},title={_property(title)}::{_value(text)}"


def _value(text: str) -> str:
    return one_line(text).replace("%", "%25")


def _property(text: str) -> str:
    return _value(text).replace(":", "%3A").replace(",", "%2C")


if __name__ == "__main__":
    for line in annotations(json.loads(Path(sys.argv[1]).read_text(encoding="ascii")), sys.argv[2]):
        print(line)
