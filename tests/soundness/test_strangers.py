"""Other programs at the devices accuse nobody and prove nothing: the adapter's own connections alone are judged."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import pytest
from pytest_otmcp.reference_adapters.defects.table import DEFECTS

from pytest_otmcp.plant.devices import Plant
from pytest_otmcp.session.loop import LoopThread
from pytest_otmcp.subject import reference_subject

from .conftest import DEFECT, HERE, IMPATIENT, Judge, Results, failing, passing, requirements, words
from .test_rogue_processes import rogue

EVERYWHERE = ("modbus", "modbus@ro", "mqtt", "mqtt@ro", "opcua", "opcua@ro")

Beside = Callable[..., Any]


@pytest.fixture
def beside(loop: LoopThread, plant: Plant) -> Beside:
    """``beside(what, device, …)``: a context in which another program speaks to these devices again and again."""

    @contextmanager
    def scanned(what: str, *devices: str, pause_s: float = 0.02) -> Iterator[None]:
        ports = [str(loop.run(plant.device(name)).port) for name in devices]
        command = [sys.executable, str(HERE / "scanner.py"), what, str(pause_s), *ports]
        scanner = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        with scanner:
            assert scanner.stdin is not None
            assert scanner.stdout is not None
            assert scanner.stdout.readline() == b"scanned\n"
            yield
            assert scanner.poll() is None
            scanner.stdin.close()
        assert scanner.returncode == 0

    return scanned


def noted(results: Results) -> dict[tuple[str, str, str | None], set[str]]:
    """What the items say of others than the adapters: device, origin and program, and what was sent there."""
    found: dict[tuple[str, str, str | None], set[str]] = {}
    for result in results.values():
        for one in result.get("strangers", ()):
            found.setdefault((one["at"], one["origin"], one["program"]), set()).update(one["sent"])
    return found


SENT = {
    "http": ("modbus mqtt opcua", {"mqtt": "b'GET / HTTP/1.1"}),
    "silence": ("modbus mqtt opcua", {}),
    "half-a-handshake": ("modbus mqtt opcua", {"modbus": "no message of the protocol"}),
    "modbus-read": ("modbus", {"modbus": "FC 04 address 0 quantity 4"}),
    "modbus-refused-write": ("modbus", {"modbus": "FC 06 address 9999 quantity 1 values [7]"}),
    "mqtt-exchange": ("mqtt", {"mqtt": "< PINGREQ"}),
    "mqtt-publish": ("mqtt", {"mqtt": "< PUBLISH 'control/pump' QoS 0 b'stop'"}),
    "opcua-read": ("opcua", {"opcua": "OpenSecureChannel"}),
    "opcua-refused-write": ("opcua", {"opcua": "OpenSecureChannel"}),
}


@pytest.mark.long
@pytest.mark.weekly
def test_strangers_that_change_nothing_are_notes_beside_a_whole_run(judge_described: Judge, beside: Beside) -> None:
    with ExitStack() as scanners:
        for what, (devices, _) in SENT.items():
            both = [name for device in devices.split() for name in (device, f"{device}@ro")]
            scanners.enter_context(beside(what, *both, pause_s=0.25))
        results = judge_described(reference_subject())
    assert failing(results) == set(), words(results)
    found = noted(results)
    for what, (devices, sent) in SENT.items():
        assert {at for at, origin, name in found if (origin, name) == ("stranger", what[:15])} >= set(devices.split())
        for at, text in sent.items():
            assert any(text in one for one in found[at, "stranger", what[:15]]), found


@pytest.mark.long
def test_a_stranger_that_was_gone_before_it_could_be_asked_who_it_was_is_no_adapter(
    judge_described: Judge, beside: Beside
) -> None:
    with beside("http-and-gone", *EVERYWHERE):
        results = judge_described(reference_subject(), "M1 M2 M4 Q1 Q3 Q4 FQ1 O1 O3")
    assert failing(results) == set(), words(results)
    assert {origin for _, origin, _ in noted(results)} <= {"stranger", "unknown"}


@pytest.mark.parametrize(
    ("what", "device", "tasks"),
    [("modbus-write", "modbus", "M2"), ("mqtt-retain", "mqtt", "Q1"), ("opcua-write", "opcua", "O1")],
)
def test_an_item_at_a_device_that_a_stranger_changes_cannot_be_judged(
    judge_described: Judge, beside: Beside, what: str, device: str, tasks: str
) -> None:
    with beside(what, device):
        results = judge_described(reference_subject(), tasks)
    for result in results.values():
        assert result["status"] == "KIT_ERROR"
        assert f"another program, {what} (process" in result["reason"]
        assert "end that program and run this again" in result["reason"]
    assert words(results) == ""


@pytest.mark.long
def test_a_strangers_exchange_proves_nothing_for_an_adapter_that_answers_from_memory(
    judge: Judge, beside: Beside
) -> None:
    with beside("mqtt-exchange", "mqtt"):
        results = judge("mqtt", *DEFECT, "MU-36q")
    assert failing(results) == {*DEFECTS["MU-36q"].items.split(), "R-mqtt"}, words(results)
    assert requirements(results) == set(DEFECTS["MU-36q"].requirements.split()), words(results)
    with beside("modbus-read", "modbus"):
        results = judge("modbus", command=rogue("stderr-flood"), tasks="M1", time_scale=IMPATIENT)
    assert failing(results) == {"M1"}
    assert "the device should have answered at least" in words(results)


def test_a_strangers_write_proves_nothing_for_an_adapter_that_writes_nothing(judge: Judge, beside: Beside) -> None:
    with beside("modbus-write", "modbus"):
        results = judge("modbus", *DEFECT, "MU-15", tasks="M3")
    assert passing(results) == set()
