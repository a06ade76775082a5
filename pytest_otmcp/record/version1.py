"""Records of ``otmcp-run/1`` in the shape of today, for reports. Pure.

Only the members that reports and tables read are carried over. Images, observations and an item's history, which judging
again needs, are not: a record is judged again by the version of the kit that made it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any, cast

from ..core.matrix import BENCHMARK
from ..core.strict_json import parse_strict
from .consistency import Contradiction
from .schema import SCHEMA as TODAY
from .schema import Footer, Header, Item, Run

__all__ = ["SCHEMA", "check_digest", "parse", "upgraded"]

SCHEMA = "otmcp-run/1"

_ITEMS = b',\n "items": [\n'
_NO_DIGEST = "sha256:" + "0" * 64
_NO_RUN = "0" * 32
_NO_TIME = "1970-01-01T00:00:00Z"

Old = Mapping[str, Any]


def parse(content: bytes, *, allow_incomplete: bool) -> Any:
    """Read the document. If it was torn in writing, and an incomplete record is allowed, read its whole items.

    Raises:
        ValueError: the document is no strict JSON.
    """
    try:
        return parse_strict(content)
    except ValueError:
        head, found, body = content.partition(_ITEMS)
        if not allow_incomplete or not found:
            raise
    items = []
    for line in body.split(b"\n"):
        try:
            items.append(parse_strict(line.removesuffix(b",")))
        except ValueError:
            break
    footer = {"complete": False, "reason": "the run did not end", "items": len(items)}
    return {**parse_strict(head + b"}"), "items": items, "footer": footer}


def check_digest(run: Old) -> None:
    """Compare the digest of a record with its content: canonical JSON of everything but the digest itself.

    Raises:
        Contradiction: the digest is not that of the content.
    """
    stated = run.get("footer")
    if not isinstance(stated, dict) or "digest" not in stated:
        return
    footer = {name: value for name, value in stated.items() if name != "digest"}
    canonical = json.dumps(
        {**run, "footer": footer}, ensure_ascii=False, allow_nan=False, sort_keys=True, separators=(",", ":")
    )
    if stated["digest"] != "sha256:" + hashlib.sha256(canonical.encode("utf-8", "replace")).hexdigest():
        raise Contradiction("the digest does not match: the file has been changed")


def upgraded(run: Old) -> Run:
    """Return the record in the shape of today: missing members are filled in; its faults are kept, to be found later.

    Raises:
        Contradiction: a part of the record is missing or has another type.
    """
    if missing := [
        name for name in ("kit", "subject", "environment", "settings", "items", "footer") if name not in run
    ]:
        raise Contradiction(f"lacks {', '.join(missing)}")
    for name in ("kit", "subject", "environment", "settings", "footer"):
        if not isinstance(run[name], dict):
            raise Contradiction(f"the record has no valid {name!r}")
    if not isinstance(run["items"], list) or not all(isinstance(item, dict) for item in run["items"]):
        raise Contradiction("the record has no valid 'items'")
    environment: dict[str, object] = {
        "python": "",
        "platform": "",
        "cpu_count": None,
        "packages": {},
        "started_at": _NO_TIME,
    }
    settings: dict[str, object] = {
        "subject": None,
        "reps": 0,
        "repetitions": {},
        "seed": 0,
        "era": "auto",
        "time_scale": 1.0,
    }
    settings |= {"suites": list(BENCHMARK), "xdist_workers": 0, "narrowed": []}
    header = {
        "schema": TODAY,
        "run_id": _NO_RUN,
        "kit": {"digest": _NO_DIGEST, **run["kit"], "protocols": []},
        "subject": {
            "digest": _NO_DIGEST,
            "deviations": [],
            **run["subject"],
            "adapters": {key: _adapter(facts) for key, facts in run["subject"].get("adapters", {}).items()},
        },
        "environment": {**environment, "finished_at": None, **run["environment"]},
        "settings": {**settings, **run["settings"]},
        "devices": {},
    }
    items = [_item(item, order) for order, item in enumerate(run["items"])]
    # Members that still have another shape are found when the whole record is checked.
    return {**cast(Header, header), "items": items, "footer": cast(Footer, run["footer"])}


def _adapter(facts: Old) -> dict[str, Any]:
    unknown = {"server_name": None, "server_version": None, "protocol_version": None, "tools": None}
    empty: dict[str, object] = {
        "command": [],
        "unclaimed": {},
        "blocking": [],
        "lacks": [],
        "unjudged": [],
        "unmet": [],
        "listing": {},
    }
    told = {"envelope": "native", "recovery": "", "deadline_s": 300.0, "probes": {}, "bindings": {}}
    return {**unknown, **empty, **told, **facts}


def _item(item: Old, order: int) -> Item:
    times = {"started_at": _NO_TIME, "finished_at": _NO_TIME, "began_ns": 0, "ended_ns": 0}
    around = {
        "role": "control",
        "calls": [_call(call) for call in item.get("other_calls", [])],
        "device": [_entry(entry) for entry in item.get("other_device", [])],
        "observations": [],
    }
    today = {
        "reason": None,
        "capabilities": [],
        "timing_ms": {},
        **{name: value for name, value in item.items() if name not in ("other_calls", "other_device", "history")},
        "run_id": _NO_RUN,
        "order": order,
        "worker": "main",
        **times,
        "findings": [_finding(finding) for finding in item.get("findings", [])],
        "requirement_rows": [],
        "devices": {},
        "around": [around],
        "sessions": [],
        "ended": None,
        "samples": [_sample(sample) for sample in item.get("samples", [])],
    }
    return cast(Item, today)


def _sample(sample: Old) -> dict[str, Any]:
    return {
        "phases": None,
        **sample,
        "device": [_entry(entry) for entry in sample.get("device", [])],
        "calls": [_call(call) for call in sample.get("calls", [])],
        "observations": [],
        "findings": [_finding(finding) for finding in sample.get("findings", [])],
    }


def _call(call: Old) -> dict[str, Any]:
    today = {"inputs": {}, "group": 0, "sent_ns": 0, "received_ns": None, "native": True, "listed": True, "outputs": {}}
    frames = call.get("frames")
    if isinstance(frames, dict):
        told = {name: frames.get(name) for name in ("request", "response", "failure", "complaint")}
        today["frames"] = {**told, "faults": [_finding(fault) for fault in frames.get("faults", [])]}
    return {**today, **{name: value for name, value in call.items() if name != "frames"}}


def _entry(entry: Old) -> dict[str, Any]:
    today = {"origin": "client", "request": False, "state_changing": False, "answers": None}
    return {**today, **{name: value for name, value in entry.items() if value is not None}}


def _finding(finding: Old) -> dict[str, Any]:
    return {"requirement": None, "evidence": None, **finding, "strength": "MUST", "cause": None}
