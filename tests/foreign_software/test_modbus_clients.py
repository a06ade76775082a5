"""The Modbus mock with mbpoll, the command-line client of libmodbus."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterator
from typing import Any

import pytest

from pytest_otmcp.plant.mock_device import MockDevice
from pytest_otmcp.session.loop import LoopThread

from .conftest import PATIENCE_S, mock

pytestmark = pytest.mark.long

TABLES = {"coils": "0", "discrete_inputs": "1", "input_registers": "3", "holding_registers": "4"}
"""Table of the image to mbpoll's number of it."""


class Mbpoll:
    """The program at a mock whose simulation is paused; its references begin at 1, as on paper."""

    def __init__(self, loop: LoopThread, device: MockDevice) -> None:
        self._loop = loop
        self._device = device

    def __call__(self, *options: str, values: tuple[int, ...] = ()) -> subprocess.CompletedProcess[str]:
        command = ["mbpoll", "-m", "tcp", "-p", str(self._device.port), "-1", "-q", *options, self._device.host]
        return subprocess.run(
            [*command, *map(str, values)],
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
        )

    def held(self) -> dict[str, list[Any]]:
        """Return what the device holds."""
        unit: dict[str, list[Any]] = self._loop.run(self._device.image())["units"]["1"]
        return unit

    def reset(self) -> None:
        self._loop.run(self._device.reset())


@pytest.fixture(scope="module")
def launched() -> Iterator[Mbpoll]:
    if shutil.which("mbpoll") is None:
        pytest.skip("mbpoll is not installed")
    with mock("modbus") as (loop, device):
        yield Mbpoll(loop, device)


@pytest.fixture
def mbpoll(launched: Mbpoll) -> Mbpoll:
    launched.reset()
    return launched


@pytest.mark.parametrize("table", TABLES)
def test_each_table_is_read_as_it_is(mbpoll: Mbpoll, table: str) -> None:
    done = mbpoll("-a", "1", "-t", TABLES[table], "-r", "1", "-c", "8")
    assert done.returncode == 0, done.stderr
    read = [int(value) for _, value in re.findall(r"^\[(\d+)\]:\s+(\d+)", done.stdout, re.MULTILINE)]
    assert read == [int(value) for value in mbpoll.held()[table][:8]]


@pytest.mark.parametrize(("table", "values"), [("holding_registers", (0, 65535)), ("coils", (1, 1))])
@pytest.mark.parametrize("count", [1, 2])
def test_what_is_written_is_held_and_nothing_else_changes(
    mbpoll: Mbpoll, table: str, values: tuple[int, ...], count: int
) -> None:
    expected = mbpoll.held()
    expected[table][98 : 98 + count] = values[-count:]
    done = mbpoll("-a", "1", "-t", TABLES[table], "-r", "99", values=values[-count:])
    assert done.returncode == 0, done.stderr
    assert mbpoll.held() == expected


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("-a", "1", "-t", "4", "-r", "99", "-c", "4"), "Illegal data address"),
        (("-a", "2", "-t", "4", "-r", "1"), "Target device failed to respond"),
    ],
)
def test_a_wrong_request_is_refused_by_its_exception_code(mbpoll: Mbpoll, options: tuple[str, ...], said: str) -> None:
    done = mbpoll(*options)
    assert done.returncode == 1
    assert said in done.stderr + done.stdout
