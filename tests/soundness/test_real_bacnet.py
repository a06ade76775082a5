"""Adapters at a real BACnet/IP device, for which one built on bacpypes3 and one built on rusty-bacnet stand: honest ones pass, liars are found,
and what reaches the socket of the device shows that nothing which may change it has arrived."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rusty_bacnet import BACnetServer

from pytest_otmcp.errors import UsageError
from pytest_otmcp.plant.devices import Plant
from pytest_otmcp.plant.field_bacnet import BacnetFieldDevice
from pytest_otmcp.session.isolation import Isolation
from pytest_otmcp.session.loop import LoopThread

from .conftest import HERE, failing, words
from .test_real_devices import Judge, consent_to, judge, launched, statuses

__all__ = ["judge"]

pytestmark = pytest.mark.long

PROGRAM = str(HERE / "standing_in_bacnet.py")
LYING = str(HERE / "lying_at_bacnet.py")
HELD = {
    "analog-input,1": 21.5,
    "analog-input,2": pytest.approx(1.1),
    "analog-input,3": -3.25,
    "analog-value,1": 1480.25,
    "binary-value,1": 1,
    "multi-state-value,1": 2,
}
READ = ("00", "02"), ("0c", "0e")
"""First bytes and services of ReadProperty and ReadPropertyMultiple, as the standard writes them."""

Ask = Callable[[], Mapping[str, Any]]


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port: int = free.getsockname()[1]
    return port


@contextmanager
def standing_in(*how: str) -> Iterator[tuple[str, Ask]]:
    """URL of a stand-in, and a function that tells what has reached it and what it holds."""
    port = free_port()
    command = [sys.executable, PROGRAM, str(port), *how]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        said, asking = process.stdout, process.stdin
        assert said is not None
        assert asking is not None
        assert json.loads(said.readline()) == {"port": port}

        def ask() -> Mapping[str, Any]:
            asking.write("\n")
            asking.flush()
            found: Mapping[str, Any] = json.loads(said.readline())
            return found

        yield f"udp://127.0.0.1:{port}", ask
        asking.close()


@pytest.fixture
def device() -> Iterator[tuple[str, Ask]]:
    with standing_in() as found:
        yield found


def is_read(datagram: str) -> bool:
    """Tell whether a datagram to this device alone, of this network, asks for a property, or which device this is."""
    link, control, apdu = datagram[:4], datagram[8:12], datagram[12:]
    if link != "810a" or control not in ("0100", "0104"):
        return False
    return apdu[:4] == "1008" or (apdu[:2] in READ[0] and apdu[6:8] in READ[1])


def unchanged(told: Mapping[str, Any]) -> None:
    assert told["held"] == HELD
    assert [one for one in told["received"] if not is_read(one)] == []
    assert len(told["received"]) > 10


@pytest.mark.parametrize(
    ("program", "failed"),
    [
        ((), set()),
        ((str(HERE / "honest" / "adapter.py"), "bacnet/reads-all-properties"), set()),
        ((LYING, "wrong"), {"F1-bacnet"}),
        ((LYING, "memory"), {"F1-bacnet"}),
        ((LYING, "heartbeat"), {"F1-bacnet", "F2-bacnet"}),
        ((LYING, "zero"), {"F2-bacnet"}),
    ],
)
def test_an_adapter_is_judged_at_a_device_that_is_only_read(
    device: tuple[str, Ask], judge: Judge, program: tuple[str, ...], failed: set[str]
) -> None:
    url, ask = device
    results = judge(url, *program, key="bacnet")
    assert failing(results) == failed, words(results)
    assert statuses(results)[2:] == ["NOT_APPLICABLE"] * 3
    unchanged(ask())


def test_a_device_built_on_another_library_is_read_as_well(judge: Judge, loop: LoopThread) -> None:
    server = BACnetServer(
        device_instance=4194302, interface="127.0.0.1", port=free_port(), broadcast_address="127.0.0.1"
    )
    for instance in range(1, 5):
        server.add_analog_input(instance, f"input {instance}", present_value=10.1 * instance)

    async def start() -> str:
        await server.start()
        address: str = await server.local_address()
        return f"udp://{address}"

    async def stop() -> None:
        await server.stop()

    url = loop.run(start())
    try:
        results = judge(url, key="bacnet")
        assert statuses(results) == ["PASS"] * 2 + ["NOT_APPLICABLE"] * 3, words(results)
    finally:
        loop.run(stop())


def test_an_adapter_that_looks_for_a_device_which_broadcasts_its_answer_is_not_judged(
    judge: Judge, loop: LoopThread
) -> None:
    with standing_in("shouts") as (url, ask):
        results = judge(f"{url}/4711", key="bacnet")
        assert statuses(results) == ["NOT_TESTABLE"] * 2 + ["NOT_APPLICABLE"] * 3, words(results)
        with pytest.raises(UsageError, match="does not answer a Who-Is; where it broadcasts"):
            launched(loop, url, None, key="bacnet")
        assert "give the adapter a launch that knows the device's address" in words(results)
        unchanged(ask())


@pytest.mark.parametrize(("program", "failed"), [((), set()), ((LYING, "memory"), {"F1-bacnet", "F6-bacnet"})])
def test_an_adapter_is_judged_while_the_device_is_away(
    judge: Judge, tmp_path: Path, program: tuple[str, ...], failed: set[str]
) -> None:
    port = str(free_port())
    url, switch, file = f"udp://127.0.0.1:{port}", (sys.executable, str(HERE / "switched.py")), str(tmp_path / "device")
    on, off = (*switch, "on", "0", file, sys.executable, PROGRAM, port, "stays"), (*switch, "off", "0", file)
    subprocess.run(on, check=True)
    try:
        consent = replace(consent_to(url), device=f"bacnet={url}", writable=(), stop=off, start=on)
        results = judge(url, *program, key="bacnet", consent=consent)
        assert failing(results) == failed, words(results)
        assert (results["F6-bacnet"]["status"] == "PASS") == (not failed), words(results)
    finally:
        subprocess.run(off, check=False)


def test_the_place_of_the_url_is_where_numbers_are_looked_for(device: tuple[str, Ask], loop: LoopThread) -> None:
    url, ask = device

    async def found(place: str) -> Any:
        real = BacnetFieldDevice(url + place)
        try:
            await real.launch()
            return await real.image(), real.witnesses
        finally:
            await real.close()

    near = [f"4711/{name}" for name in HELD if not name.startswith("binary")]
    image, witnesses = loop.run(found(""))
    assert list(image["points"]) == near
    assert image["beyond"] == {"point": "4711/analog-input,4194301"}
    assert witnesses["identity"] == "Foreign Stand-in 1.0"
    image, _ = loop.run(found("/4711/4"))
    assert list(image["points"]) == near[-len(image["points"]) :] != near
    with pytest.raises(UsageError, match=r"fewer than 3 values differ.* such as /12345/100"):
        loop.run(found("/4711/7"))
    with pytest.raises(UsageError, match="as device 4712 it does not tell"):
        loop.run(found("/4712"))
    with pytest.raises(UsageError, match="nothing to BACnet devices"):
        launched(loop, url, replace(consent_to(url), device=f"bacnet={url}"), key="bacnet")
    unchanged(ask())


def test_behind_walls_there_is_no_way_past_the_tap(device: tuple[str, Ask], loop: LoopThread) -> None:
    url, ask = device
    read = bytes.fromhex("810a0011 0104 00050b0c 0c00000001 1955")
    isolation = Isolation()
    try:
        walls = isolation.walls()
        if walls is None or not walls.network:
            pytest.skip("this machine makes no networks of their own")
        plant = Plant({"bacnet": url}, isolation)
        try:
            tapped = loop.run(plant.device("bacnet"))
            with walls.socket(socket.SOCK_DGRAM) as inside:
                inside.settimeout(60)
                inside.sendto(read, ("127.0.0.1", int(url.rpartition(":")[2])))
                inside.sendto(read, (tapped.host, tapped.port))
                answer, sender = inside.recvfrom(1500)
                assert sender == (tapped.host, tapped.port)
                assert answer[6:9] == bytes.fromhex("300b0c")
        finally:
            loop.run(plant.close())
        # Where nobody listens in there, nothing can arrive later either.
        assert ask()["received"].count(read.hex()) == 1
    finally:
        isolation.close()


def test_what_speaks_no_bacnet_is_told(loop: LoopThread) -> None:
    with pytest.raises(UsageError, match="cannot be used"):
        launched(loop, f"udp://127.0.0.1:{free_port()}", None, key="bacnet")
