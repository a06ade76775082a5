"""What the adapters do with large blocks, floods and many calls at once: ``pytest benchmarks/test_scale.py``.

Adapter and bare client take turns in one run, at the same device. Growth is asserted as counts from the device's journal: requests,
connections, messages. No time is asserted; times are printed with their ratio.
"""

from __future__ import annotations

import asyncio
import math
import statistics
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

import pytest

from pytest_otmcp.plant.mock_device import MockDevice
from pytest_otmcp.protocols.journal import JournalEntry

from .pipe_client import PipeClient
from .workload import BLOCKS, FLOOD, INBOX, INPUT_REGISTERS, PARALLEL, PAYLOAD, PDU_REGISTERS, TEMPERATURE, TOPIC

ROUNDS = 20
FLOOD_ROUNDS = 5
RATE_PER_S = 10_000
"""The messages of a flood that the broker publishes in a second, or as many as it can."""

MOST_KEPT = 5000
"""The messages that the adapter's inbox holds (``reference_adapters/mqtt/inbox.py``)."""
MOST_GROWTH_KIB = 20 * 1024
"""What a full inbox may take, and what further floods must not add again."""

PATIENT = {"TIMEOUT_S": "50", "DEADLINE_S": "55"}
"""Time limits that a busy machine does not reach, by the ends of their settings' names."""

PARALLEL_CALLS: Mapping[str, tuple[str, Mapping[str, Any], str]] = {
    "modbus": ("read_input_registers", {"address": 0, "count": INPUT_REGISTERS}, "request"),
    "mqtt": ("publish_message", {"topic": TOPIC, "payload": PAYLOAD, "qos": 1}, "PUBLISH"),
    "opcua": ("read_opcua_node", {"node_id": TEMPERATURE}, "Read"),
}
"""Tool, arguments, and the kind of the journal entry of its request, by protocol."""


SERVER_STATE = "i=2259"
"""The node that asyncua reads from time to time, of its own accord, to know that the connection lives."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """A device, the adapter, and the bare client that does the same."""

    runner: asyncio.Runner
    device: MockDevice
    adapter: PipeClient
    raw: PipeClient

    def journal(self, mark: int) -> list[JournalEntry]:
        """Return what has come to the device since."""
        entries = self.runner.run(self.device.journal(mark)).entries
        return [entry for entry in entries if entry["direction"] == "in"]

    def mark(self) -> int:
        """Return the place in the device's journal."""
        return self.runner.run(self.device.mark())

    def poke(self, **what: Any) -> None:
        """Change the device past its protocol."""
        self.runner.run(self.device.poke(**what))


@contextmanager
def pair(protocol: str, exchange: str) -> Iterator[Pair]:
    """Start a device, its adapter and a bare client; end them all."""
    with ExitStack() as stack:
        runner = stack.enter_context(asyncio.Runner())
        device = MockDevice(protocol)
        stack.callback(lambda: runner.run(device.close()))
        runner.run(device.launch())
        prefix, where = protocol.upper(), {"HOST": device.host, "PORT": str(device.port)}
        if protocol != "modbus":
            scheme = {"mqtt": "mqtt", "opcua": "opc.tcp"}[protocol]
            where = {"URL": f"{scheme}://{device.host}:{device.port}"}
        env = {f"{prefix}_{name}": value for name, value in {**where, **PATIENT, "WRITES_ENABLED": "true"}.items()}
        adapter = PipeClient("pytest_otmcp.reference_adapters", protocol, env=env)
        stack.callback(adapter.close)
        raw = PipeClient("benchmarks.raw_client", exchange, device.host, str(device.port))
        stack.callback(raw.close)
        adapter.discover()
        yield Pair(runner=runner, device=device, adapter=adapter, raw=raw)


def compared(times: list[tuple[float, float]]) -> str:
    """Return least and median of adapter and bare client in words, and their ratios."""
    mine, theirs = zip(*times, strict=True)
    least, middle = (min(mine), min(theirs)), (statistics.median(mine), statistics.median(theirs))
    return (
        f"adapter {least[0]:.1f} / {middle[0]:.1f} ms, raw {least[1]:.1f} / {middle[1]:.1f} ms (least / median), "
        f"ratio {least[0] / least[1]:.2f} / {middle[0] / middle[1]:.2f}"
    )


@pytest.mark.parametrize("count", BLOCKS)
def test_a_block_of_registers_takes_as_few_pdus_as_the_protocol_allows(
    count: int, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = {"address": 0, "count": count}
    with pair("modbus", f"modbus_{count}") as both:
        both.poke(unit=1, cells=65536)
        both.adapter.call("read_multiple_holding_registers", arguments)
        both.raw.exchange()
        times = [
            (both.adapter.call("read_multiple_holding_registers", arguments) / 1e6, both.raw.exchange() / 1e6)
            for _ in range(ROUNDS)
        ]
        mark = both.mark()
        envelope = both.adapter.ask("read_multiple_holding_registers", arguments)
        pdus = both.journal(mark)
    with capsys.disabled():
        print(f"\n{count} registers: {len(pdus)} PDUs; {compared(times)}")
    assert len(pdus) == math.ceil(count / PDU_REGISTERS)
    assert len(envelope["data"]["values"]) == count
    assert envelope["meta"].get("atomic", True) is (len(pdus) == 1)


def test_an_inbox_under_a_flood_is_bounded_and_counts_what_it_loses(capsys: pytest.CaptureFixture[str]) -> None:
    rates, memory, times = [], [], []
    with pair("mqtt", "mqtt_inbox") as both:
        both.adapter.call("subscribe_topic", {"topic": f"{INBOX}/adapter/#"})
        both.raw.exchange()

        def flood(receiver: str, answer: Any) -> float:
            loop = both.runner.get_loop()
            began = loop.time()
            both.poke(burst={"topic": f"{INBOX}/{receiver}/{{n}}", "count": FLOOD, "rate_per_s": RATE_PER_S})
            rates.append(FLOOD / (loop.time() - began))
            # The broker's answer comes after all messages that it had for the client.
            answer()
            return 1000 * (loop.time() - began)

        for _ in range(FLOOD_ROUNDS):
            took = flood("adapter", lambda: both.adapter.call("get_broker_info", {}))
            memory.append(both.adapter.resident_kib)
            times.append((took, flood("raw", both.raw.exchange)))
            taken, dropped, missing = 0, 0, True
            while missing:
                envelope = both.adapter.ask("read_messages", {"topic": f"{INBOX}/adapter/#", "limit": 1000})
                taken += len(envelope["data"]["messages"])
                dropped += envelope["data"]["dropped"]
                missing = "truncated" in envelope["meta"]
            assert taken == MOST_KEPT
            assert taken + dropped == FLOOD
    with capsys.disabled():
        print(
            f"\n{FLOOD} messages at {min(rates):.0f} to {max(rates):.0f} a second: {taken} kept, {dropped} dropped and counted; "
            f"{compared(times)}; {memory[0] // 1024} MB after the first flood, {memory[-1] // 1024} MB after the last"
        )
    assert memory[-1] - memory[0] < MOST_GROWTH_KIB


@pytest.mark.parametrize("protocol", PARALLEL_CALLS)
def test_calls_at_the_same_time_share_one_link(protocol: str, capsys: pytest.CaptureFixture[str]) -> None:
    tool, arguments, kind = PARALLEL_CALLS[protocol]
    with pair(protocol, f"{protocol}_together") as both:
        both.adapter.call(tool, arguments)
        both.raw.exchange()
        times = [
            (both.adapter.call_together(tool, arguments, PARALLEL) / 1e6, both.raw.exchange() / 1e6)
            for _ in range(ROUNDS)
        ]
        mark = both.mark()
        both.adapter.call_together(tool, arguments, PARALLEL)
        asked = [entry for entry in both.journal(mark) if entry["kind"] == kind]
        entries = [entry for entry in asked if SERVER_STATE not in str(entry.get("nodes"))]
    with capsys.disabled():
        print(f"\n{protocol}, {PARALLEL} calls at once: {len(entries)} requests; {compared(times)}")
    assert len(entries) == PARALLEL
    assert len({entry["connection"] for entry in entries}) == 1
