"""A synthetic record of a run that earns a certificate, for tests that take something away from it."""

from __future__ import annotations

from typing import Any

from pytest_otmcp import __version__
from pytest_otmcp.certificate.eligibility import needed, why_not_claimed
from pytest_otmcp.core.matrix import SUITES, repetitions
from pytest_otmcp.record.run_file import digest
from pytest_otmcp.suite.catalogue import kit_digest, suite_digest, tasks_by_id

from .samples import item, run

NO_PING = "it has no such tool"


def conformant_run(adapters: dict[str, dict[str, Any]] | None = None) -> dict[str, Any]:
    """Everything that applies passed 30 times.

    Args:
        adapters: the subject's, see :func:`adapter`; by default Modbus without a ping, OPC UA, and no MQTT.
    """
    if adapters is None:
        adapters = {
            "modbus": adapter("acme-modbus", "2026-07-28", unclaimed={"ping": NO_PING}),
            "opcua": adapter("acme-opcua", "2025-11-25", envelope="synthesised", unmet=["ENV-001"]),
        }
    planned = repetitions(30)
    items = []
    for task in tasks_by_id().values():
        entry = item(task.id, task.suite, task.family, task.title, [1.0] * planned[task.suite])
        if any(why_not_claimed(facet, adapters) is not None for facet in needed(task, adapters)):
            entry |= {"status": "NOT_APPLICABLE", "samples": []}
        items.append(entry)
    record = run(items)
    record["kit"] |= {"version": __version__, "suite_digest": suite_digest(), "digest": kit_digest()}
    record["subject"] = {
        "name": "acme-adapter",
        "version": "1.4.0",
        "digest": "sha256:" + "5" * 64,
        "deviations": [],
        "adapters": adapters,
    }
    record["environment"] = {"python": "3.11.7", "started_at": "2026-11-21T07:03:43Z"}
    record["settings"] = {
        "reps": 30,
        "repetitions": planned,
        "seed": 7,
        "era": "auto",
        "time_scale": 1.0,
        "suites": list(SUITES),
        "xdist_workers": 0,
        "broker": "embedded",
        "narrowed": [],
    }
    return resealed(record)


def adapter(name: str, revision: str, **more: Any) -> dict[str, Any]:
    facts = {"server_name": name, "server_version": "1.4.0", "protocol_version": revision, "tools": 5}
    return {
        **facts,
        "envelope": "native",
        "recovery": "same_session",
        "blocking": [],
        "unclaimed": {},
        "unjudged": [],
        **more,
    }


def resealed(record: dict[str, Any]) -> dict[str, Any]:
    """The record with the digest that belongs to what it holds now."""
    record["footer"]["digest"] = digest(record)
    return record
