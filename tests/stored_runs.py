"""Functions that write run records for tests: as a run leaves them, or as a forger would change them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from pytest_otmcp.record.consistency import count_calls
from pytest_otmcp.record.schema import Footer, Header, ItemHead, Run
from pytest_otmcp.record.writer import ITEMS_LINE, RunWriter, dump, laid_out

__all__ = ["counted", "header_of", "run_of", "store", "store_as_it_is"]

_NOT_HEADER = ("items", "footer")
_DIGEST = "sha256:" + "0" * 64


def header_of(run: Mapping[str, Any]) -> Header:
    """Return the record without items and footer."""
    return cast(Header, {name: value for name, value in run.items() if name not in _NOT_HEADER})


def store(path: Path, run: Mapping[str, Any]) -> Path:
    """Write a record as the kit would, with the digest that belongs to it."""
    writer = RunWriter(path, header_of(run))
    for item in run["items"]:
        head = {name: value for name, value in item.items() if name != "samples"}
        writer.append(cast(ItemHead, head), laid_out(item["samples"]))
    footer = {name: value for name, value in run["footer"].items() if name != "digest"}
    writer.finish(header_of(run), cast(Footer, footer))
    return path


def store_as_it_is(path: Path, file: Mapping[str, Any]) -> Path:
    """Write a record from what another file of a record holds, with the digest that belongs to it."""
    members = b",\n ".join(dump(name) + b": " + dump(value) for name, value in header_of(file).items())
    items = b",\n".join(
        b"  "
        + dump({name: value for name, value in item.items() if name != "samples"})[:-1]
        + b', "samples": ['
        + b",".join(b"\n   " + dump(sample) for sample in item["samples"])
        + b"\n  ]}"
        for item in file["items"]
    )
    footer = {name: value for name, value in file["footer"].items() if name != "digest"}
    content = b"{" + members + b",\n" + ITEMS_LINE + items + b'\n ],\n "footer": ' + dump(footer)[:-1] + b",\n"
    digest = hashlib.sha256(content).hexdigest().encode()
    path.write_bytes(content + b' "digest": "sha256:' + digest + b'"}}\n')
    return path


def counted(items: Sequence[Any]) -> dict[str, Any]:
    """Return what a reader counts of these items."""
    samples = sum(len(item["samples"]) for item in items)
    return {"items": len(items), "samples": samples, "tool_calls": count_calls(items)}


def run_of(
    items: Iterable[Mapping[str, Any]],
    *,
    adapters: Mapping[str, Any],
    devices: Mapping[str, Any],
    suite_digest: str = _DIGEST,
    seed: int = 0,
    time_scale: float = 1.0,
    soak: bool = False,
    repetitions: Mapping[str, int] | None = None,
) -> Run:
    """Return a record of these items of trials, in memory, as judging again needs it."""
    run_id = "0" * 32
    listed = [{**item, "run_id": run_id, "order": order} for order, item in enumerate(items)]
    record = {
        "schema": "otmcp-run/3",
        "run_id": run_id,
        "kit": {
            "name": "pytest-otmcp",
            "version": "0",
            "digest": _DIGEST,
            "suite_digest": suite_digest,
            "protocols": [],
        },
        "subject": {"name": "x", "version": "0", "digest": _DIGEST, "deviations": [], "adapters": dict(adapters)},
        "environment": {
            "python": "3",
            "platform": "Linux",
            "cpu_count": None,
            "packages": {},
            "started_at": "2026-11-21T07:03:43Z",
            "finished_at": "2026-11-21T07:04:43Z",
        },
        "settings": {
            "subject": None,
            "reps": 1,
            "repetitions": dict(repetitions or {}),
            "seed": seed,
            "era": "auto",
            "time_scale": time_scale,
            "soak": soak,
            "suites": ["normal", "fault", "stress", "recovery"],
            "xdist_workers": 0,
            "broker": "embedded",
            "narrowed": [],
        },
        "devices": dict(devices),
        "items": listed,
        "footer": {"complete": True, "reason": None, **counted(listed)},
    }
    return cast(Run, record)
