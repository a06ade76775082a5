"""A synthetic record of a run that earns a certificate, for tests that change it."""

from __future__ import annotations

from typing import Any

from pytest_otmcp import __version__
from pytest_otmcp.core.matrix import SUITES, repetitions
from pytest_otmcp.subject.claims import Claims
from pytest_otmcp.suite.catalogue import kit_digest, suite_digest, tasks_by_id

from . import samples
from .samples import item, run

NO_PING = "it has no such tool"


def conformant_run(adapters: dict[str, dict[str, Any]] | None = None) -> dict[str, Any]:
    """Return the record of a run with 30 repetitions in which everything that applies passed.

    Args:
        adapters: those of the subject, see :func:`adapter`; by default Modbus without a ping, OPC UA, and no MQTT.
    """
    if adapters is None:
        adapters = {
            "modbus": adapter("acme-modbus", "2026-07-28", unclaimed={"ping": NO_PING}),
            "opcua": adapter("acme-opcua", "2025-11-25", envelope="synthesised", unmet=["ENV-001"]),
        }
    planned = repetitions(30)
    claims = Claims.of_record(adapters)  # type: ignore[arg-type]
    items = []
    for task in tasks_by_id(suites=SUITES).values():
        entry = item(task.id, task.suite, task.family, task.title, [1.0] * planned[task.suite])
        if not all(map(claims.has, claims.required(task.needs))):
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
    record["settings"] |= {"suites": list(SUITES), "repetitions": planned, "seed": 7}
    return record


def adapter(name: str, revision: str, **more: Any) -> dict[str, Any]:
    told = {"server_name": name, "server_version": "1.4.0", "protocol_version": revision}
    return samples.adapter(5, **{**told, **more})
