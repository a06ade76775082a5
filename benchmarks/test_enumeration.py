"""The cost of an OPC UA enumeration of 100, 1000 and 10 000 variables: ``pytest benchmarks/test_enumeration.py``.

The raw client is asyncua's own, which browses the one folder and reads the values of its variables; the adapter searches the whole plant,
and answers with names, types, statuses and times. Both are measured in turns, in the same run. No time is asserted. The number of service
calls is: it grows with the pages in which the server sends references, not with the nodes.
"""

from __future__ import annotations

import asyncio
import math
import statistics

import pytest

from pytest_otmcp.plant.mock_device import MockDevice

from .pipe_client import PipeClient

PAGE = 1000
"""The references that the server sends in one answer."""

ROUNDS = 5
LEVELS = 3
"""One Browse for each: Objects, Plant, and its folders; that nothing is below the variables is known from the first enumeration."""

SIZES = (100, 1000, 10_000)


async def _plant(count: int) -> MockDevice:
    device = MockDevice("opcua")
    await device.launch()
    folder = {"folder": "Many.Folder"}
    variable = {"variable": "Many", "in": "Many.Folder", "type": "Int32", "value": 0, "copies": count - 1}
    await device.poke(create=[folder, variable])
    await device.poke(limits={"references_per_node": PAGE, "nodes_per_read": 0, "nodes_per_browse": 0})
    return device


@pytest.mark.parametrize("count", SIZES)
def test_the_service_calls_of_an_enumeration_grow_with_its_pages(
    count: int, capsys: pytest.CaptureFixture[str]
) -> None:
    with asyncio.Runner() as runner:
        device = runner.run(_plant(count))
        url = f"opc.tcp://{device.host}:{device.port}"
        patient = {"OPCUA_URL": url, "OPCUA_TIMEOUT_S": "50", "OPCUA_DEADLINE_S": "55"}
        adapter = PipeClient("pytest_otmcp.reference_adapters", "opcua", env=patient)
        raw = PipeClient("benchmarks.raw_client", "opcua_variables", device.host, str(device.port))
        try:
            for client in (adapter, raw):
                client.discover()
            # The first enumeration also asks once what is below each variable.
            adapter.call("get_all_variables", {})
            raw.exchange()
            times = [(adapter.call("get_all_variables", {}), raw.exchange()) for _ in range(ROUNDS)]
            mark = runner.run(device.mark())
            adapter.call("get_all_variables", {})
            entries = runner.run(device.journal(mark)).entries
        finally:
            adapter.close()
            raw.close()
            runner.run(device.close())
    services = [entry["kind"] for entry in entries if entry["direction"] == "in"]
    mine, theirs = (statistics.median(taken) / 1e6 for taken in zip(*times, strict=True))
    with capsys.disabled():
        print(
            f"\n{count} variables: adapter {mine:.0f} ms, raw asyncua {theirs:.0f} ms, ratio {mine / theirs:.2f}; "
            f"{len(services)} service calls: {', '.join(f'{services.count(kind)} {kind}' for kind in dict.fromkeys(services))}"
        )
    pages = math.ceil(count / PAGE)
    assert len(services) <= LEVELS + (pages - 1) + 1, services
