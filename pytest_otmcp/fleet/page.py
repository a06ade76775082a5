"""The matrix of a fleet as a page, and for programs: ``index.html``, ``fleet.json``, ``junit.xml``, ``changes.md``."""

from __future__ import annotations

import base64
import hashlib
from collections import Counter
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from xml.sax.saxutils import quoteattr

import msgspec
from markupsafe import Markup

from ..core.errors import UsageError
from ..core.matrix import CROSS_PROTOCOL
from ..core.text import printable
from ..protocols.registry import protocols
from ..report.page import filled
from .changes import Changes
from .lines import Line
from .outcome import Outcome

__all__ = ["FLEET", "NAMES", "read_lines", "write_pages"]

FLEET = "fleet.json"
NAMES = (FLEET, "index.html", "changes.md", "junit.xml")
_SCHEMA = "otmcp-fleet/1"


class _Fleet(msgspec.Struct, frozen=True, kw_only=True):
    schema: str
    name: str
    rows: list[Line]


def read_lines(path: Path) -> list[Line]:
    """Read the rows of a ``fleet.json``.

    Raises:
        UsageError: it is none.
    """
    try:
        return msgspec.json.decode(path.read_bytes(), type=_Fleet).rows
    except (OSError, ValueError, RecursionError) as reason:
        raise UsageError(f"{path}: {getattr(reason, 'strerror', None) or reason}") from None


def write_pages(name: str, found: Sequence[Line], told: Changes, directory: Path, *, compared: bool) -> None:
    """Write the four files below a folder.

    Args:
        name: of the fleet.
        compared: whether there was an earlier fleet.
    """
    document = msgspec.json.encode({"schema": _SCHEMA, "name": name, "rows": found})
    texts = {
        FLEET: document.replace(b'{"key":', b'\n{"key":') + b"\n",
        "index.html": _page(name, found, told).encode(),
        "changes.md": told.markdown(compared=compared).encode(),
        "junit.xml": _junit(name, found, told).encode(),
    }
    directory.mkdir(parents=True, exist_ok=True)
    for file, text in texts.items():
        # Nothing is written through a link.
        (directory / file).unlink(missing_ok=True)
        (directory / file).write_bytes(text)


def _page(name: str, found: Sequence[Line], told: Changes) -> str:
    known = [*(protocol.name for protocol in protocols().values()), CROSS_PROTOCOL]
    seen = {protocol for one in found for protocol in one.cells}
    columns = [protocol for protocol in known if protocol in seen] + sorted(seen.difference(known))
    outcomes = Counter(one.outcome for one in found)
    script = _resource("filter.js")
    return filled(
        "fleet.html.jinja",
        folder=__package__,
        more_style=_resource("fleet.css"),
        name=name,
        lines=found,
        first={index for index, one in enumerate(found) if not index or found[index - 1].id != one.id},
        adapters=len({one.id for one in found}),
        columns=columns,
        outcomes=[(outcome, outcomes[outcome]) for outcome in Outcome if outcomes[outcome]],
        broke=told.broke,
        kit=next((one.kit for one in found if one.kit is not None), None),
        # Our own file: with its hash the page may run it, and nothing else.
        script=Markup(script),  # noqa: S704
        script_hash=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
    )


def _resource(name: str) -> str:
    return (resources.files(__package__) / name).read_text(encoding="utf-8")


def _junit(name: str, found: Sequence[Line], told: Changes) -> str:
    """Return a test case for each row: a failure is what broke, an error what has no verdict; the verdict itself is a property."""
    faults = sum(one.outcome in (Outcome.FAULT, Outcome.NOT_RUN) for one in found)
    text = [
        '<?xml version="1.0" encoding="utf-8"?>',
        f'<testsuites><testsuite name={_attribute(name)} tests="{len(found)}" failures="{len(told.broke)}" errors="{faults}" skipped="0">',
    ]
    for one in found:
        text.append(
            f'<testcase classname={_attribute(one.id)} name={_attribute(one.version)} time="{one.seconds or 0:g}">'
        )
        text.append(f'<properties><property name="otmcp_outcome" value={_attribute(one.outcome)}/>')
        text.append(f'<property name="otmcp_tries" value="{one.tries}"/></properties>')
        if (one.id, one.version) in told.broke:
            text.append(f"<failure message={_attribute(told.broke[one.id, one.version])}/>")
        elif one.outcome in (Outcome.FAULT, Outcome.NOT_RUN):
            text.append(f"<error message={_attribute(one.reason or one.outcome)}/>")
        text.append("</testcase>")
    return "\n".join([*text, "</testsuite></testsuites>", ""])


def _attribute(text: str) -> str:
    return quoteattr(printable(text))
