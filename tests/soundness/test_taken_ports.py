"""A port that another program takes during an outage: nothing is written there, and nobody is accused."""

from __future__ import annotations

import asyncio
import socket

import pytest

from pytest_otmcp.plant.device import Device
from pytest_otmcp.plant.devices import Plant
from pytest_otmcp.replay.rejudge import rejudge
from pytest_otmcp.session.loop import LoopThread
from pytest_otmcp.soundness.judging import measured
from pytest_otmcp.soundness.warm_start import WarmStart
from pytest_otmcp.subject import Subject, reference_subject
from pytest_otmcp.suite.catalogue import tasks_by_id
from pytest_otmcp.trial.adapter_under_test import BenchOptions
from pytest_otmcp.trial.bench import Bench
from tests.trials import as_read, recorded

from .conftest import Results

_READ_ONLY = (1, 2, 3, 4, 43)
"""Function codes of Modbus that change nothing."""


class Squatter:
    """A program that listens at the address of a device from its stop number ``at`` on, and keeps what it is sent.

    It closes each connection after the first request, as a server does that cannot make sense of it.
    """

    def __init__(self, device: Device, at: int) -> None:
        self.received: list[bytes] = []
        self._device = device
        self._stop = device.stop
        self._left = at
        self._server: asyncio.Server | None = None
        device.stop = self.stop  # type: ignore[method-assign]

    async def stop(self) -> None:
        await self._stop()
        self._left -= 1
        if self._left == 0:
            listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
            listener.bind((self._device.host, self._device.port))
            self._server = await asyncio.start_server(self._serve, sock=listener)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.received.append(await reader.read(1024))
        writer.close()

    def leave(self) -> None:
        """Give the address back."""
        del self._device.stop  # type: ignore[method-assign]
        assert self._server is not None, "the device was not stopped so often"
        self._server.close()


async def outage(bench: Bench, squatter: Squatter) -> Results:
    """Run the item with the outages, another one while the port is taken, and one after it was given back."""
    tasks = tasks_by_id()
    try:
        results = {name: await measured(bench, tasks[name]) for name in ("M1", "S10", "M2")}
        squatter.leave()
        results["M3"] = await measured(bench, tasks["M3"])
        record = recorded(bench, results.values())
    finally:
        await bench.close()
    assert await asyncio.to_thread(rejudge, as_read(record)) == []
    return results


@pytest.mark.long
@pytest.mark.parametrize("at", [1, 2])
def test_a_port_that_is_taken_during_an_outage_is_no_finding_and_gets_no_write(
    loop: LoopThread, warm_start: WarmStart, at: int
) -> None:
    plant = Plant()
    genuine = warm_start.subject(reference_subject())
    subject = Subject(name="one", version="0", adapters={"modbus": genuine.adapters["modbus"]}, source=genuine.source)
    try:
        device = loop.run(plant.device("modbus"))
        squatter = Squatter(device, at)
        results = loop.run(outage(Bench(subject, BenchOptions(), plant), squatter))
    finally:
        loop.run(plant.close())
    assert {name: item["status"] for name, item in results.items()} == {
        "M1": "PASS",
        "S10": "KIT_ERROR",
        "M2": "KIT_ERROR",
        "M3": "PASS",
    }
    for name in ("S10", "M2"):
        (finding,) = results[name]["findings"]
        assert finding["code"] == "exhausted"
        assert (
            f"another program has taken {device.host}:{device.port}, the address of a mock device" in finding["message"]
        )
        assert "file a bug" not in finding["message"]
    assert {frame[7] for frame in squatter.received if len(frame) > 7} <= set(_READ_ONLY)
