"""The cost of an OPC UA enumeration of 100, 1000 and 10 000 variables: ``pytest benchmarks/test_enumeration.py``.

The raw client makes the same service calls with asyncua: it browses the folders, which it knows, at once and reads the values of all
variables; the adapter, in a session that has enumerated before, does the same, and answers with names, types, statuses and times. Both are
measured in turns, in the same run. No time is asserted. The number of service calls is: it grows with the pages in which the server
sends references, not with the nodes.
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

ROUNDS = {100: 60, 1000: 12, 10_000: 5}
"""The variables of each size, and how often they are enumerated."""


async def _plant(count: int) -> MockDevice:
    device = MockDevice("opcua")
    await device.launch()
    folder = {"folder": "Many.Folder"}
    variable = {"variable": "Many", "in": "Many.Folder", "type": "Int32", "value": 0, "copies": count - 1}
    await device.poke(create=[folder, variable])
    await device.poke(limits={"references_per_node": PAGE, "nodes_per_read": 0, "nodes_per_browse": 0})
    return device


@pytest.mark.parametrize("count", ROUNDS)
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
            # The first enumeration also finds out level by level which folders there are, and that nothing is below the variables.
            adapter.call("get_all_variables", {})
            raw.exchange()
            times = [(adapter.call("get_all_variables", {}), raw.exchange()) for _ in range(ROUNDS[count])]
            mark = runner.run(device.mark())
            adapter.call("get_all_variables", {})
            entries = runner.run(device.journal(mark)).entries
        finally:
            adapter.close()
            raw.close()
            runner.run(device.close())
    services = [entry["kind"] for entry in entries if entry["direction"] == "in"]
    mine, theirs = ([one / 1e6 for one in taken] for taken in zip(*times, strict=True))
    least, middle = min(mine) / min(theirs), statistics.median(mine) / statistics.median(theirs)
    with capsys.disabled():
        print(
            f"\n{count} variables: adapter {min(mine):.0f} / {statistics.median(mine):.0f} ms, raw asyncua {min(theirs):.0f} / "
            f"{statistics.median(theirs):.0f} ms (least / median), ratio {least:.2f} / {middle:.2f}; "
            f"{len(services)} service calls: {', '.join(f'{services.count(kind)} {kind}' for kind in dict.fromkeys(services))}"
        )
    pages = math.ceil(count / PAGE)
    # One Browse of all folders, its further pages, one Read.
    assert len(services) == pages + 1, services
