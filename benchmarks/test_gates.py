"""What policy and audit log add to a write: ``pytest benchmarks/test_gates.py``; ``--basetemp=FOLDER`` says on which disk the log is.

Adapters with and without take turns at one device; times are printed, never asserted. The number of writes is asserted, from the device's
journal, and that the log verifies.
"""

from __future__ import annotations

import asyncio
import os
import random
import statistics
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import pytest

from pytest_otmcp.plant.mock_device import MockDevice

from .pipe_client import PipeClient

ROUNDS, WARM_UP, PAUSE_S = 400, 20, 0.001
RECORD_BYTES = 560
WRITE, READ = ("write_register", {"address": 20, "value": 5}), ("read_register", {"address": 20})
POLICY = "".join(
    f'[rule.r{number}]\ntargets = ["1/holding_registers/{number}"]\nlowest = 0\nhighest = 800\n' for number in range(21)
)


def test_a_write_through_the_gates(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "policy.toml").write_text(POLICY)
    policy = {"OT_POLICY": str(tmp_path / "policy.toml"), "OT_ROLE": "operator"}
    settings = {
        "neither": {},
        "policy of 21 rules": policy,
        "audit log": {"OT_AUDIT_LOG": str(tmp_path / "alone.jsonl")},
        "both": {**policy, "OT_AUDIT_LOG": str(tmp_path / "audit.jsonl")},
    }
    samples: dict[tuple[str, str], list[int]] = {}
    with asyncio.Runner() as runner, ExitStack() as stack:
        device = MockDevice("modbus")
        runner.run(device.launch())
        stack.callback(lambda: runner.run(device.close()))
        (endpoint,) = device.endpoints.values()
        where = {"MODBUS_HOST": endpoint.host, "MODBUS_PORT": str(endpoint.port), "MODBUS_WRITES_ENABLED": "true"}
        clients = {}
        for name, own in settings.items():
            clients[name] = client = PipeClient("pytest_otmcp.reference_adapters", "modbus", env=where | own)
            stack.callback(client.close)
            client.discover()
            for _ in range(WARM_UP):
                client.call(*WRITE)
        plain = os.open(tmp_path / "plain", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        stack.callback(os.close, plain)
        mark = runner.run(device.mark())
        probes = [(name, kind) for name in clients for kind in ("write", "read")]
        for _ in range(ROUNDS):
            random.shuffle(probes)
            for name, kind in probes:
                time.sleep(PAUSE_S)
                took = clients[name].call(*(WRITE if kind == "write" else READ))
                samples.setdefault((kind, name), []).append(took)
            time.sleep(PAUSE_S)
            samples.setdefault(("disk", "two records alone"), []).append(_two_records(plain))
        entries = runner.run(device.journal(mark)).entries
        assert sum(bool(entry.get("state_changing")) for entry in entries) == ROUNDS * len(clients)
    log, records = tmp_path / "audit.jsonl", 2 * (ROUNDS + WARM_UP) + 2
    command = [sys.executable, "-m", "pytest_otmcp.reference_adapters.audit", "verify", str(log)]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert f"records 1 to {records};" in said
    with capsys.disabled():
        print(f"\n{'microseconds':<36}{'p10':>8}{'median':>8}{'p95':>8}")
        for (kind, name), values in sorted(samples.items()):
            p10, *_, p95 = statistics.quantiles(values, n=20)[1:]
            row = (p10, statistics.median(values), p95)
            print(f"{f'{kind}, {name}':<36}" + "".join(f"{value / 1e3:>8.0f}" for value in row))
        print(f"{log.stat().st_size / records:.0f} bytes a record; load average {os.getloadavg()[0]:.1f}")


def _two_records(descriptor: int) -> int:
    started = time.perf_counter_ns()
    for _ in range(2):
        os.write(descriptor, bytes(RECORD_BYTES))
        os.fdatasync(descriptor)
    return time.perf_counter_ns() - started
