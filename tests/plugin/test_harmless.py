"""``otmcp init``, ``otmcp doctor``, fixtures and ``otmcp certify`` write to the mock device and nowhere else, also where there are no walls.

Behind walls (docs/isolation.md) an adapter that wanders reaches nothing, which tests/plugin/test_walls.py shows.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from pytest_otmcp.plant.mock_device import MockDevice
from pytest_otmcp.protocols.oracle import state_changing
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.session.loop import LoopThread
from pytest_otmcp.soundness.warm_start import WarmStart

from .vendor import Repository

WANDERING = Path(__file__).parents[1] / "soundness" / "wandering.py"

TESTS = """
import pytest
from pytest_otmcp.devices import SubjectError

KEY, WRITE, TOOL = {arguments}

def test_operation(otmcp_session):
    with pytest.raises(SubjectError, match="does not talk to the mock device"):
        otmcp_session(KEY).call(WRITE[0], **WRITE[1])

def test_tool(otmcp_session):
    with pytest.raises(SubjectError, match="nothing was written"):
        otmcp_session(KEY).tool(TOOL, **WRITE[1])

def test_variant(otmcp_session):
    with pytest.raises(SubjectError, match="nothing was written"):
        otmcp_session(KEY, variant="ro").call(WRITE[0], **WRITE[1])
"""

WRITES = {
    "modbus": (("write_holding", {"address": 1, "value": 7}), "write_register"),
    "mqtt": (("publish", {"topic": "control/pump", "payload": "on", "qos": 0}), "publish_message"),
    "opcua": (("write", {"node": "ns=2;s=ValvePosition", "value": 7.0}), "write_opcua_node"),
    "s7": (("write_db", {"db": 10, "start": 0, "type": "INT", "value": 7}), "write_db"),
    "bacnet": (
        ("write", {"device": 12345, "type": "analog-value", "instance": 1, "value": 7.0, "priority": 8}),
        "write_property",
    ),
    "ethernetip": (("write_tag", {"tag": "ValvePosition", "value": 7, "type": "DINT"}), "write_tag"),
    "dnp3": (("write_binary", {"outstation": 10, "index": 2, "value": True}), "write_binary_output"),
    "profibus": (("write_outputs", {"slave": 5, "data": [1, 2]}), "write_outputs"),
}

SLAVES = '{"5": {"ident": "809C", "cfg": "11 21"}}'
"""The slave map without which no PROFIBUS adapter would write in any case."""


class Elsewhere:
    """A second device of a protocol, which no kit knows of."""

    def __init__(self, loop: LoopThread, protocol: str) -> None:
        self._loop = loop
        self._device = MockDevice(protocols()[protocol].mock, protocol)
        loop.run(self._device.launch())

    @property
    def address(self) -> str:
        (first, *_) = self._device.endpoints.values()
        return first.path or f"{first.host}:{first.port}"

    @property
    def place(self) -> str:
        """What stands in a subject file for such an address."""
        return "{host}:{port}" if self._device.port else "{serial}"

    @property
    def changes(self) -> list[str]:
        """What may have changed it."""
        return [entry["kind"] for entry in state_changing(self._loop.run(self._device.journal(0)).entries)]

    @property
    def touched(self) -> bool:
        """Somebody was there."""
        return any(entry["origin"] == "client" for entry in self._loop.run(self._device.journal(0)).entries)

    def close(self) -> None:
        self._loop.run(self._device.close())


@pytest.fixture(params=[pytest.param(name, marks=() if name == "mqtt" else pytest.mark.long) for name in WRITES])
def protocol(request: pytest.FixtureRequest) -> str:
    found: str = request.param
    return found


@pytest.fixture
def elsewhere(protocol: str) -> Iterator[Elsewhere]:
    loop = LoopThread()
    device = Elsewhere(loop, protocol)
    yield device
    device.close()
    loop.close()


Otmcp = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def otmcp(tmp_path: Path) -> Otmcp:
    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "pytest_otmcp.cli", *arguments]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=600, check=False)

    return run


TIMES = {"profibus": ("4", "6")}
"""Seconds of an adapter's time-outs where silence is an answer: nobody says on a line that a station is not there."""


def files(protocol: str) -> dict[str, str]:
    """Variables that name a file below {work}, each with what it holds."""
    return {"PROFIBUS_SLAVE_MAP": SLAVES} if protocol == "profibus" else {}


def subject(warm_start: WarmStart, protocol: str, plant: Elsewhere) -> str:
    """A subject file whose variable for the address is misspelt; the adapter has the plant's for a default."""
    name = protocol.upper()
    command = json.dumps([*warm_start.python, str(WANDERING), protocol, "misspelt"])
    maps = files(protocol)
    timeout_s, deadline_s = TIMES.get(protocol, ("20", "25"))
    named = "".join(f', {variable} = "{{work}}/{variable}"' for variable in maps)
    return f"""
[subject]
name = "wandering"
version = "1"

[adapter.{protocol}]
command = {command}
env = {{ PLANT = "{plant.address}", ADRESS = "{plant.place}", {name}_TIMEOUT_S = "{timeout_s}", {name}_DEADLINE_S = "{deadline_s}"{named} }}
rw = {{ env = {{ {name}_WRITES_ENABLED = "true" }} }}
ro = {{ env = {{ {name}_WRITES_ENABLED = "true" }} }}
deadline_s = 30
files = {{ {", ".join(f"{variable} = '{content}'" for variable, content in maps.items())} }}
"""


def test_init_writes_nothing_and_says_where_the_adapter_was(
    otmcp: Otmcp, tmp_path: Path, warm_start: WarmStart, protocol: str, elsewhere: Elsewhere
) -> None:
    settings = {
        "PLANT": elsewhere.address,
        "ADRESS": elsewhere.place,
        f"{protocol.upper()}_WRITES_ENABLED": "true",
        **{name: f"{{work}}/{name}" for name in files(protocol)},
    }
    variables = [part for name, value in settings.items() for part in ("--env", f"{name}={value}")]
    for name, content in files(protocol).items():
        variables += ["--file", f"{name}={content}"]
    command = ("--", *warm_start.python, str(WANDERING), protocol, "misspelt")
    done = otmcp("init", "--isolation=off", "--protocol", protocol, *variables, *command)
    assert done.returncode == 1, done.stdout + done.stderr
    assert "no proposal: the adapter does not talk to the mock device at " in done.stderr
    assert "Nothing was written." in done.stderr
    assert not (tmp_path / "otmcp.toml").exists()
    assert elsewhere.touched
    assert elsewhere.changes == []


def test_the_doctor_names_the_variable_to_look_at(
    otmcp: Otmcp, tmp_path: Path, warm_start: WarmStart, protocol: str, elsewhere: Elsewhere
) -> None:
    (tmp_path / "otmcp.toml").write_text(subject(warm_start, protocol, elsewhere), encoding="utf-8")
    done = otmcp("doctor", "--isolation=off")
    assert done.returncode == 1, done.stdout + done.stderr
    assert "rw: the adapter does not talk to the mock device at " in done.stdout
    assert f"it names {protocols()[protocol].scheme}://{elsewhere.address}" in done.stdout
    assert f"Look at env.ADRESS below [adapter.{protocol}] of the subject file" in done.stdout
    assert elsewhere.touched
    assert elsewhere.changes == []


def test_the_doctor_says_of_a_good_adapter_that_it_talks_to_the_mock(
    otmcp: Otmcp, tmp_path: Path, warm_start: WarmStart, protocol: str, elsewhere: Elsewhere
) -> None:
    text = subject(warm_start, protocol, elsewhere).replace("ADRESS", "ADDRESS")
    (tmp_path / "otmcp.toml").write_text(text, encoding="utf-8")
    done = otmcp("doctor")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "a random value went between the mock device and the adapter" in done.stdout
    assert not elsewhere.touched


@pytest.mark.long
def test_fixtures_do_not_write_elsewhere(
    empty_repository: Repository, warm_start: WarmStart, protocol: str, elsewhere: Elsewhere
) -> None:
    tests = TESTS.replace("{arguments}", repr((protocol, *WRITES[protocol])))
    empty_repository.write(otmcp_toml=subject(warm_start, protocol, elsewhere), tests__test_it_py=tests)
    outcome = empty_repository.pytest()
    assert "3 passed" in outcome.output, outcome.output
    assert elsewhere.touched
    assert elsewhere.changes == []


# What certify does is the same on every protocol, and takes minutes: a device, and a broker.
@pytest.mark.parametrize("protocol", ["modbus", pytest.param("mqtt", marks=pytest.mark.weekly)], indirect=True)
@pytest.mark.long
def test_certify_does_not_write_elsewhere(
    otmcp: Otmcp, tmp_path: Path, warm_start: WarmStart, protocol: str, elsewhere: Elsewhere
) -> None:
    (tmp_path / "otmcp.toml").write_text(subject(warm_start, protocol, elsewhere), encoding="utf-8")
    done = otmcp("certify", "--isolation=off")
    assert done.returncode == 1, done.stdout + done.stderr
    assert not (tmp_path / "certificate.json").exists()
    assert elsewhere.touched
    assert elsewhere.changes == []
