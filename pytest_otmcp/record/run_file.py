"""The run record ``run.json``: written as the run goes, read with suspicion. Pure.

The file is valid JSON after every item: header, items, and a footer that says ``"complete": false`` until the run is
over. An item costs one write over the footer, however long the record has become; a write that is torn by a kill
leaves whole lines, which :func:`load` finds again, so that at most the item being written is lost.

The digest is the SHA-256 of the canonical JSON of everything but the digest itself: UTF-8, member names sorted by code
point, no blanks, nothing escaped that need not be, numbers as Python writes them (the shortest digits that read back
as the same double).
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ..core.matrix import SUITES
from ..core.strict_json import parse_strict
from ..core.verdict import Status, Verdict, decide

__all__ = ["RecordError", "RunWriter", "count_calls", "digest", "load"]

SCHEMA = "otmcp-run/1"
ROLES = ("task", "control", "setup", "warmup", "recovery")
_KEYS = ("schema", "kit", "subject", "environment", "settings", "items", "footer")
_ITEMS = b',\n "items": [\n'
_ORDER = (
    "M1 M2 M3 M4 Q1 Q2 Q3 Q4 O1 O2 O3 O4 X1 X2 X1p X2p FM1 FM2 FQ1 FQ2 FO1 FO2 FX1 "
    "S1 S2 S3 S4 S5 S6 S7 S8 S9 S10 S11 S12 R-modbus R-mqtt R-opcua"
).split()

_NUMBER = int | float
_TOP: Mapping[str, Any] = {
    "kit": dict,
    "subject": dict,
    "environment": dict,
    "settings": dict,
    "items": list,
    "footer": dict,
}
_ITEM: Mapping[str, Any] = {
    "id": str,
    "suite": str,
    "family": str,
    "title": str,
    "status": str,
    "planned": int,
    "samples": list,
    "other_calls": list,
    "findings": list,
}
_SAMPLE: Mapping[str, Any] = {"repetition": int, "ok": bool, "duration_ms": _NUMBER, "calls": list, "findings": list}
_CALL: Mapping[str, Any] = {"role": str, "ok": bool, "error_code": str | None}
_FINDING: Mapping[str, Any] = {"code": str, "message": str}
_PHASES: Mapping[str, Any] = {
    "detect": _NUMBER | None,
    "restart": _NUMBER | None,
    "same_session": _NUMBER | None,
    "same_session_ok": bool,
    "fresh_session": _NUMBER | None,
    "fresh_session_ok": bool,
}


class RecordError(Exception):
    """A run record that cannot be believed; the message says why."""


def _dump(value: Any, **style: Any) -> bytes:
    # A lone surrogate, which no UTF-8 has and no strict reader takes, may come from a device's topic or node name.
    return json.dumps(value, ensure_ascii=False, allow_nan=False, **style).encode("utf-8", "replace")


def digest(run: Mapping[str, Any]) -> str:
    """The digest of a run record, whatever its footer claims it to be."""
    footer = {name: value for name, value in run["footer"].items() if name != "digest"}
    canonical = _dump({**run, "footer": footer}, sort_keys=True, separators=(",", ":"))
    return "sha256:" + hashlib.sha256(canonical).hexdigest()


def count_calls(items: Iterable[Mapping[str, Any]]) -> dict[str, int]:
    """The tool calls of these items by role.

    The paper's count of tool calls leaves the recovery suite out, and so does the role ``task`` here.
    """
    counts = dict.fromkeys(ROLES, 0)
    for item in items:
        for call in [call for sample in item["samples"] for call in sample["calls"]] + item["other_calls"]:
            role = "recovery" if item["suite"] == "recovery" and call["role"] == "task" else call["role"]
            counts[role] += 1
    return counts


def _unfinished(items: int) -> bytes:
    footer = {"complete": False, "reason": "the run did not end", "items": items}
    return b'\n ],\n "footer": ' + _dump(footer) + b"\n}\n"


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
        head = _dump(self._header, indent=1).removesuffix(b"\n}") + _ITEMS
        self._end = len(head)
        path.write_bytes(head + _unfinished(0))

    def append(self, item: dict[str, Any]) -> None:
        """Add an item; the file is a valid record of an unfinished run when this returns.

        Raises:
            OSError: it could not be written; the file is what it was before.
        """
        line = (b",\n  " if self._items else b"  ") + _dump(item)
        # Unbuffered: one write, always longer than the footer that it replaces, so that nothing is left to cut off.
        with self._path.open("r+b", buffering=0) as file:
            try:
                self._overwrite(file.fileno(), line + _unfinished(len(self._items) + 1))
            except OSError:
                self._overwrite(file.fileno(), _unfinished(len(self._items)))
                file.truncate(self._end + len(_unfinished(len(self._items))))
                raise
        self._items.append(item)
        self._end += len(line)

    def _overwrite(self, descriptor: int, content: bytes) -> None:
        os.lseek(descriptor, self._end, os.SEEK_SET)
        rest = memoryview(content)
        while rest:
            rest = rest[os.write(descriptor, rest) :]

    def finish(self, footer: Mapping[str, Any], adapters: Mapping[str, Any]) -> None:
        """Write the whole record again, items in the suite's order, and put it in place in one step."""
        run = {
            **self._header,
            "subject": {**self._header["subject"], "adapters": dict(adapters)},
            "items": sorted(self._items, key=_place),
            "footer": dict(footer),
        }
        run["footer"]["digest"] = digest(run)
        head = _dump({name: run[name] for name in self._header}, indent=1).removesuffix(b"\n}") + _ITEMS
        lines = b",\n".join(b"  " + _dump(item) for item in run["items"])
        # One level deeper than it was dumped; strings hold no line breaks of their own.
        tail = _dump(run["footer"], indent=1).replace(b"\n", b"\n ")
        fresh = self._path.with_suffix(".json.new")
        try:
            fresh.write_bytes(head + lines + b'\n ],\n "footer": ' + tail + b"\n}\n")
            os.replace(fresh, self._path)
        except OSError:
            fresh.unlink(missing_ok=True)
            raise


def _place(item: Mapping[str, Any]) -> tuple[int, int, str]:
    identifier = item["id"]
    known = _ORDER.index(identifier) if identifier in _ORDER else len(_ORDER)
    return SUITES.index(item["suite"]), known, identifier


def load(path: Path, *, allow_incomplete: bool = False) -> dict[str, Any]:
    """Read a run record.

    Args:
        path: the file.
        allow_incomplete: accept a record whose footer says that it is not complete, and one that was torn while an
            item was written: that item is left out.

    Raises:
        RecordError: no record, an unfinished one, or one that contradicts itself; one sentence.
    """
    try:
        content = path.read_bytes()
        try:
            run = parse_strict(content)
        except ValueError:
            if not allow_incomplete or (kept := _whole_lines(content)) is None:
                raise
            run = parse_strict(kept)
        _check_shape(run)
        if not run["footer"]["complete"] and not allow_incomplete:
            raise RecordError(f"the run is incomplete: {run['footer'].get('reason')}")
        _check_counts(run)
        _check_judgement(run)
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror})") from None
    except ValueError as reason:
        raise RecordError(f"{path}: not strict JSON: {reason}") from None
    except RecordError as reason:
        raise RecordError(f"{path}: {reason}") from None
    result: dict[str, Any] = run
    return result


def _whole_lines(content: bytes) -> bytes | None:
    """The record as it was before a write that was torn: an item is a line, and whole lines are whole items."""
    head, found, body = content.partition(_ITEMS)
    if not found:
        return None
    lines: list[bytes] = []
    for line in body.split(b"\n"):
        item = line.removesuffix(b",")
        try:
            parse_strict(item)
        except ValueError:
            break
        lines.append(item)
    return head + _ITEMS + b",\n".join(lines) + _unfinished(len(lines))


def _check_shape(run: Any) -> None:
    if not isinstance(run, dict) or run.get("schema") != SCHEMA:
        raise RecordError(f"not a run record of schema {SCHEMA}")
    if missing := [name for name in _KEYS if name not in run]:
        raise RecordError(f"lacks {', '.join(missing)}")
    _require(run, _TOP, "the record")
    _require(run["subject"], {"adapters": dict}, "its subject")
    _require(run["footer"], {"complete": bool, "items": int}, "its footer")
    for index, item in enumerate(run["items"]):
        _require(item, _ITEM, f"item {index + 1}")
        name = item["id"]
        if item["suite"] not in SUITES or item["status"] not in set(Status):
            raise RecordError(f"{name} has the unknown suite or status {item['suite']!r}, {item['status']!r}")
        for sample in item["samples"]:
            _require(sample, _SAMPLE, f"a sample of {name}")
            _require_all(sample["findings"], _FINDING, f"a finding of {name}")
            _require_all(sample["calls"], _CALL, f"a call of {name}")
            if sample.get("phases") is not None:
                _require(sample["phases"], _PHASES, f"the phases of a sample of {name}")
        _require_all(item["findings"], _FINDING, f"a finding of {name}")
        _require_all(item["other_calls"], _CALL, f"a call of {name}")


def _require_all(values: list[Any], fields: Mapping[str, Any], where: str) -> None:
    for value in values:
        _require(value, fields, where)
        if "role" in fields and value["role"] not in ROLES:
            raise RecordError(f"{where} has the unknown role {value['role']!r}")


def _require(value: Any, fields: Mapping[str, Any], where: str) -> None:
    if not isinstance(value, dict):
        raise RecordError(f"{where} is no object")
    for name, kind in fields.items():
        found = value.get(name)
        # JSON's true is no number, though Python's is.
        if not isinstance(found, kind) or (isinstance(found, bool) and kind is not bool):
            raise RecordError(f"{where} has no valid {name!r}")


def _check_counts(run: Mapping[str, Any]) -> None:
    items, footer = run["items"], run["footer"]
    identifiers = [item["id"] for item in items]
    if twice := sorted({name for name in identifiers if identifiers.count(name) > 1}):
        raise RecordError(f"an item occurs twice: {', '.join(twice)}")
    counted = {
        "items": len(items),
        "samples": sum(len(item["samples"]) for item in items),
        "tool_calls": count_calls(items),
    }
    for what, found in counted.items():
        if what in footer and footer[what] != found:
            raise RecordError(f"the footer counts {footer[what]} {what}, there are {found}")
    if "digest" in footer and footer["digest"] != digest(run):
        raise RecordError("the digest does not match: the file has been changed")
    if footer["complete"] and "digest" not in footer:
        raise RecordError("a complete record without a digest")


def _check_judgement(run: Mapping[str, Any]) -> None:
    for item in run["items"]:
        repetitions = [sample["repetition"] for sample in item["samples"]]
        if repetitions != list(range(len(repetitions))) or len(repetitions) > item["planned"]:
            raise RecordError(f"the repetitions of {item['id']} are not the first of {item['planned']}")
        if any(sample["ok"] and sample["findings"] for sample in item["samples"]):
            raise RecordError(f"a repetition of {item['id']} is called ok, but has findings")
        if item["status"] == Status.PASS and (
            item["findings"]
            or len(repetitions) < item["planned"]
            or not all(sample["ok"] for sample in item["samples"])
        ):
            raise RecordError(f"{item['id']} is called PASS, but not everything of it passed")
    statuses = {item["id"]: Status(item["status"]) for item in run["items"]}
    claimed = run["footer"].get("verdict")
    if claimed == Verdict.CONFORMANT and decide(statuses, statuses.keys()) != Verdict.CONFORMANT:
        raise RecordError("the footer says CONFORMANT, the items do not")
