"""Adapters at a real DNP3 outstation, for which one of opendnp3 stands: honest ones pass, liars are found, and what it counts itself shows that
it was read and nothing else."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.core.errors import NoBindingError
from pytest_otmcp.errors import UsageError
from pytest_otmcp.plant.field_dnp3 import Dnp3FieldDevice
from pytest_otmcp.session.free_port import free_port
from pytest_otmcp.session.loop import LoopThread
from pytest_otmcp.wire.dnp3.application import DISABLE_UNSOLICITED

from .conftest import HERE, failing, words
from .test_real_devices import Judge, consent_to, judge, launched, statuses

__all__ = ["judge"]

pytestmark = pytest.mark.long

PROGRAM = Path(__file__).parents[1] / "adapters" / "opendnp3_outstation.py"


@contextmanager
def serving(outstation: int = 10, master: int = 1, mode: str = "CloseNew") -> Iterator[tuple[str, Callable[[], Any]]]:
    """URL of an outstation that takes one connection at a time, and what ends it and tells which functions it was asked for."""
    port, pipe = free_port(socket.socket), subprocess.PIPE
    command = [sys.executable, str(PROGRAM), str(port), "measured", str(outstation), str(master), mode]
    process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True)
    assert process.stdout
    assert process.stdout.readline() == "ready\n"
    try:
        yield f"tcp://127.0.0.1:{port}", lambda: json.loads(process.communicate()[0])
    finally:
        if process.returncode is None:
            process.communicate()


@pytest.mark.parametrize(
    ("lie", "failed", "mode"),
    [
        (None, set(), "CloseNew"),
        ("once", set(), "CloseNew"),
        ("once", set(), "CloseExisting"),
        ("wrong", {"F1-dnp3"}, "CloseNew"),
        ("memory", {"F1-dnp3"}, "CloseNew"),
        ("operating", {"F1-dnp3", "F2-dnp3"}, "CloseNew"),
        ("zero", {"F2-dnp3"}, "CloseNew"),
    ],
)
def test_an_adapter_is_judged_at_an_outstation_that_is_only_read(
    judge: Judge, lie: str | None, failed: set[str], mode: str
) -> None:
    with serving(mode=mode) as (url, ended):
        lying = [] if lie is None else [str(HERE / "lying_at_dnp3.py"), lie]
        results = judge(url, *lying, key="dnp3")
        assert failing(results) == failed, words(results)
        assert statuses(results)[2:] == ["NOT_APPLICABLE"] * 3
        assert ended().keys() == {"READ"}


@pytest.mark.parametrize(("need", "told"), [("events", "the adapter asks for events"), ("eager", "writes the clock")])
def test_an_adapter_that_needs_what_is_withheld_is_not_judged(judge: Judge, need: str, told: str) -> None:
    with serving() as (url, ended):
        results = judge(url, str(HERE / "lying_at_dnp3.py"), need, key="dnp3")
        assert statuses(results) == ["NOT_TESTABLE"] * 2 + ["NOT_APPLICABLE"] * 3, words(results)
        assert told in words(results)
        assert ended().keys() == {"READ"}


def test_outstation_and_master_are_those_of_the_url(loop: LoopThread) -> None:
    with serving(1024, 3) as (url, ended):
        device = Dnp3FieldDevice(f"{url}/1024/3")
        try:
            loop.run(device.launch())
            image: Any = loop.run(device.image())
        finally:
            loop.run(device.close())
        # Whole numbers cut the fraction of the input 2 off, so it is left out; 8 to 15 have not been measured.
        analog = {f"1024/analog_input/{index}": -1000 + 7 * index for index in range(8) if index != 2}
        binary = {f"1024/binary_input/{index}": index % 3 == 0 for index in range(8)}
        assert image["points"] == {**analog, **binary}
        assert image["beyond"] == {"analog_input": (1024, 65535), "binary_input": (1024, 65535)}
        consent = replace(consent_to(url, None), device=f"dnp3={url}/1024/3")
        for place, given, problem in (
            ("/1024", None, "does not answer"),
            ("/10/3", None, "does not answer"),
            ("/1024/3", consent, "nothing to DNP3 outstations"),
        ):
            with pytest.raises(UsageError, match=problem):
                launched(loop, url + place, given, key="dnp3")
        assert ended().keys() == {"READ"}


def test_a_master_of_another_author_that_gets_no_further_is_no_liar(loop: LoopThread) -> None:
    with serving() as (url, ended):
        device = Dnp3FieldDevice(url)
        loop.run(device.launch())
        master = [sys.executable, str(PROGRAM.parents[1] / "mocks" / "opendnp3_master.py"), str(device.port)]
        process = subprocess.Popen(master, stderr=subprocess.DEVNULL)
        try:
            (asked,) = loop.run(device.wait(0, {"kind": "request"}, timeout_s=60))
            assert (asked["function"], asked["fault"]) == (DISABLE_UNSOLICITED, "withheld")  # type: ignore[typeddict-item]
            with pytest.raises(NoBindingError, match="switches unsolicited responses"):
                device.excuse()
        finally:
            process.kill()
            process.wait()
            loop.run(device.close())
        assert ended().keys() == {"READ"}
