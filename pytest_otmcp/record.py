"""The run record ``run.json``: written as the run goes, read with suspicion. Pure.

The file is valid JSON after every item: header, items, and a footer that says ``"complete": false`` until the run is
over. Its digest is the SHA-256 of the canonical JSON (sorted keys, no blanks, ASCII) of everything but the digest.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .envelope import parse_strict
from .task import SUITES

__all__ = ["RecordError", "RunWriter", "digest", "load"]

SCHEMA = "otmcp-run/1"
_KEYS = ("schema", "kit", "subject", "environment", "settings", "items", "footer")
_FAMILIES = ("Modbus", "MQTT", "OPC UA", "Cross-protocol")


class RecordError(Exception):
    """A run record that cannot be believed; the message says why."""


def _canonical(value: Any) -> bytes:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def digest(run: Mapping[str, Any]) -> str:
    """The digest of a run record, whatever its footer claims it to be."""
    footer = {name: value for name, value in run["footer"].items() if name != "digest"}
    return "sha256:" + hashlib.sha256(_canonical({**run, "footer": footer})).hexdigest()


class RunWriter:
    """Writes a run record item by item.

    Args:
        path: the file, replaced when it exists.
        header: every top-level member but ``items`` and ``footer``.
    """

    def __init__(self, path: Path, header: Mapping[str, Any]) -> None:
        self._path = path
        self._header = dict(header)
        self._items: list[dict[str, Any]] = []
        text = json.dumps(self._header, indent=1, allow_nan=False)
        self._head = text[: text.rindex("\n}")].encode() + b',\n "items": [\n'
        self._end = len(self._head)
        path.write_bytes(self._head + self._unfinished())

    def _unfinished(self) -> bytes:
        footer = {"complete": False, "reason": "the run did not end", "items": len(self._items)}
        return b'\n ],\n "footer": ' + json.dumps(footer).encode() + b"\n}\n"

    def append(self, item: dict[str, Any]) -> None:
        """Add an item; the file is a valid record of an unfinished run when this returns."""
        line = (b"  " if not self._items else b",\n  ") + json.dumps(item, allow_nan=False).encode()
        self._items.append(item)
        with self._path.open("r+b") as file:
            file.seek(self._end)
            file.write(line + self._unfinished())
            file.truncate()
        self._end += len(line)

    def finish(self, footer: Mapping[str, Any], adapters: Mapping[str, Any]) -> None:
        """Write the whole record again, items in the suite's order, and put it in place in one step."""
        run = {
            **self._header,
            "subject": {**self._header["subject"], "adapters": dict(adapters)},
            "items": sorted(self._items, key=lambda item: (SUITES.index(item["suite"]), _order(item["id"]))),
            "footer": dict(footer),
        }
        run["footer"]["digest"] = digest(run)
        text = json.dumps({name: value for name, value in run.items() if name != "items"}, indent=1, allow_nan=False)
        head, tail = text.split(',\n "footer": ')
        lines = ",\n  ".join(json.dumps(item, allow_nan=False) for item in run["items"])
        fresh = self._path.with_suffix(".json.new")
        fresh.write_text(f'{head},\n "items": [\n  {lines}\n ],\n "footer": {tail}\n', encoding="utf-8")
        os.replace(fresh, self._path)


_ORDER = (
    "M1 M2 M3 M4 Q1 Q2 Q3 Q4 O1 O2 O3 O4 X1 X2 X1p X2p FM1 FM2 FQ1 FQ2 FO1 FO2 FX1 "
    "S1 S2 S3 S4 S5 S6 S7 S8 S9 S10 S11 S12 R-modbus R-mqtt R-opcua"
).split()


def _order(identifier: str) -> tuple[int, str]:
    return (_ORDER.index(identifier) if identifier in _ORDER else len(_ORDER), identifier)


def load(path: Path, *, allow_incomplete: bool = False) -> dict[str, Any]:
    """Read a run record.

    Args:
        path: the file.
        allow_incomplete: accept a record whose footer says that it is not complete.

    Raises:
        RecordError: no record, an unfinished one, or one that contradicts itself.
    """

    def refuse(reason: str) -> RecordError:
        return RecordError(f"{path}: {reason}")

    try:
        run = parse_strict(path.read_bytes())
    except OSError as error:
        raise refuse(f"cannot be read ({error.strerror})") from None
    except ValueError as reason:
        raise refuse(f"not strict JSON: {reason}") from None
    if not isinstance(run, dict) or run.get("schema") != SCHEMA:
        raise refuse(f"not a run record of schema {SCHEMA}")
    if missing := [name for name in _KEYS if name not in run]:
        raise refuse(f"lacks {', '.join(missing)}")
    items, footer = run["items"], run["footer"]
    identifiers = [item["id"] for item in items]
    if len(set(identifiers)) != len(identifiers):
        raise refuse("an item occurs twice")
    if not footer.get("complete") and not allow_incomplete:
        raise refuse(f"the run is incomplete: {footer.get('reason')}")
    if footer.get("items") != len(items):
        raise refuse(f"the footer counts {footer.get('items')} items, there are {len(items)}")
    samples = sum(len(item["samples"]) for item in items)
    if "samples" in footer and footer["samples"] != samples:
        raise refuse(f"the footer counts {footer['samples']} samples, there are {samples}")
    if "digest" in footer and footer["digest"] != digest(run):
        raise refuse("the digest does not match: the file has been changed")
    if footer.get("complete") and "digest" not in footer:
        raise refuse("a complete record without a digest")
    result: dict[str, Any] = run
    return result
