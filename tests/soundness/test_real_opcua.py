"""Adapters at a real OPC UA server, for which one built on node-opcua stands: honest ones pass, liars are found, and what it counts itself
shows that nothing which may change it has arrived."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.errors import UsageError
from pytest_otmcp.plant.field_opcua import OpcUaFieldDevice
from pytest_otmcp.protocols.field import Consent, Writable
from pytest_otmcp.record import load
from pytest_otmcp.session.loop import LoopThread
from tests.foreign_software.conftest import Npm, npm
from tests.reference_text import reference_text

from .conftest import DEFECT, HERE, failing, words
from .test_real_devices import Judge, consent_to, judge, launched, statuses

__all__ = ["judge", "npm"]

pytestmark = pytest.mark.long

PROGRAMS = HERE.parent / "foreign_software"
HELD = {"Temperature": 21.5, "Pressure": 1.1, "Level": 3, "Pump": True, "Speed": 1480.25, "Steps": 70000}
CHANGING = {"Write", "Call", "HistoryUpdate", "AddNodes", "AddReferences", "DeleteNodes", "DeleteReferences"}

Ask = Callable[[], Mapping[str, Any]]


@pytest.fixture
def server(npm: Npm) -> Iterator[tuple[str, Ask]]:
    """URL of the stand-in, and a function that tells what it was asked for and what it holds."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port: int = free.getsockname()[1]
    with npm.node(HERE / "standing_in_opcua.cjs", str(port), str(npm.directory)) as process:
        said, asking = process.stdout, process.stdin
        assert said is not None
        assert asking is not None
        told = json.loads(said.readline())
        assert told == {"port": port, "namespace": 1}

        def ask() -> Mapping[str, Any]:
            asking.write("\n")
            asking.flush()
            found: Mapping[str, Any] = json.loads(said.readline())
            return found

        yield f"opc.tcp://127.0.0.1:{port}", ask


def unchanged(told: Mapping[str, Any]) -> None:
    assert told["held"] == HELD
    assert not CHANGING.intersection(told["asked"]), told["asked"]
    assert told["asked"]["Read"] > 0


@pytest.mark.parametrize(
    ("kind", "failed"),
    [
        (None, set()),
        ("digits", set()),
        ("led", set()),
        ("wrong", {"F1-opcua"}),
        ("memory", {"F1-opcua"}),
        ("heartbeat", {"F1-opcua", "F2-opcua"}),
        ("zero", {"F2-opcua"}),
    ],
)
def test_an_adapter_is_judged_at_a_server_that_is_only_read(
    server: tuple[str, Ask], judge: Judge, kind: str | None, failed: set[str]
) -> None:
    url, ask = server
    program = [] if kind is None else [str(HERE / "lying_at_opcua.py"), kind]
    results = judge(url, *program, key="opcua")
    assert failing(results) == failed, words(results)
    assert statuses(results)[2:] == ["NOT_APPLICABLE"] * 3
    unchanged(ask())


def consented(url: str, *nodes: str) -> Consent:
    writable = tuple(Writable(target=node, lowest=0, highest=100) for node in nodes)
    return replace(consent_to(url), device=f"opcua={url}", writable=writable)


def outside(told: Mapping[str, Any], node: str) -> list[Any]:
    return [write for write in told["writes"] if write[0] != node or not 0 <= write[1] <= 100]


@pytest.mark.parametrize("name", ["Level", "Temperature", "Pump", "Pressure"])
def test_what_was_written_with_consent_is_given_back(server: tuple[str, Ask], judge: Judge, name: str) -> None:
    url, ask = server
    node = f"ns=1;s={name}"
    results = judge(url, key="opcua", consent=consented(url, node))
    assert statuses(results) == ["PASS"] * 5, words(results)
    told = ask()
    # A number of 32 bits comes back as it was on the wire.
    assert told["held"] == {**HELD, name: pytest.approx(HELD[name])}
    assert [write[0] for write in told["writes"]] == [node, node]


LIES = {
    "MU-14o": "F4-opcua F5-opcua",
    "MU-20o": "F3-opcua",
    "MU-25o": "F4-opcua",
}
"""Defects to the items that find them: "written" of what was never sent, a guard that sends, a write that is sent twice."""


@pytest.mark.parametrize("defect", LIES)
def test_a_lie_is_found_and_nothing_is_written_beyond_the_consent(
    server: tuple[str, Ask], judge: Judge, defect: str
) -> None:
    url, ask = server
    results = judge(url, *DEFECT, defect, key="opcua", consent=consented(url, "ns=1;s=Level"))
    assert failing(results) == set(LIES[defect].split()), words(results)
    told = ask()
    assert outside(told, "ns=1;s=Level") == []
    assert told["held"] == HELD


def test_an_adapter_whose_requests_nobody_can_see_is_not_judged(
    server: tuple[str, Ask], judge: Judge, tmp_path: Path
) -> None:
    url, ask = server
    results = judge(url, str(HERE / "lying_at_opcua.py"), "sealed", str(tmp_path), key="opcua")
    assert statuses(results) == ["NOT_TESTABLE"] * 2 + ["NOT_APPLICABLE"] * 3, words(results)
    assert "opens a channel with the security policy Basic256Sha256, and the tap sees into" in words(results)
    assert not CHANGING.intersection(ask()["asked"])


def test_the_node_of_the_url_is_where_values_are_looked_for(server: tuple[str, Ask], loop: LoopThread) -> None:
    url, ask = server

    async def found(place: str) -> object:
        device = OpcUaFieldDevice(url + place)
        try:
            await device.launch()
            return await device.image()
        finally:
            await device.close()

    near = {f"ns=1;s={name}" for name in HELD}
    for place in ("", "/ns=1;s=Plant", "/ns=1;s%3DPlant"):
        image: Any = loop.run(found(place))
        assert image["points"].keys() == near
        assert image["beyond"] == {"node": "i=4294967000" if not place else "ns=1;i=4294967000"}
    for place in ("/ns=1;s=Temperature", "/ns=1;s=Nothing"):
        with pytest.raises(UsageError, match=r"fewer than 3 values differ.* such as /ns=2;s=Plant"):
            loop.run(found(place))
    for consent, problem in (
        (consent_to(url, "Another 1.0"), "it says that it is 'Foreign Stand-in 1.0', the consent is for 'Another 1.0'"),
        (consented(url, "ns=1;s=Nothing"), "it tells no number and no truth value of ns=1;s=Nothing"),
    ):
        with pytest.raises(UsageError, match=problem):
            launched(loop, url, consent, key="opcua")
    unchanged(ask())


def test_a_run_by_url_says_that_both_clients_are_of_one_library(server: tuple[str, Ask], tmp_path: Path) -> None:
    url, ask = server

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-P", "-m", *words]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)

    shipped, words = reference_text(), '"-m", "pytest_otmcp.reference_adapters", "opcua"'
    assert words in shipped
    (tmp_path / "otmcp.toml").write_text(
        shipped.replace(words, json.dumps(str(HERE / "lying_at_opcua.py")) + ', "digits"')
    )
    options = (f"--otmcp-device=opcua={url}/ns=1;s=Plant", "--otmcp-subject=otmcp.toml", "--otmcp-report-dir=report")
    done = run("pytest", "-p", "no:cacheprovider", "--pyargs", "pytest_otmcp.conformance", *options)
    assert done.returncode == 0, done.stdout[-4000:]
    assert (
        "2 of 6 OPC UA items passed, 4 do not apply; 2/2 runs passed; a field record, at a real device" in done.stdout
    )
    expected = {
        "wire": "the kit's tap",
        "state": "the kit's own client, built on asyncua, as the adapter is",
        "identity": "Foreign Stand-in 1.0",
    }
    assert [facts["witnesses"] for facts in load(tmp_path / "report" / "run.json")["devices"].values()] == [expected]
    verified = run("pytest_otmcp.cli", "verify", "report/run.json")
    assert verified.returncode == 0, verified.stdout + verified.stderr
    unchanged(ask())


def test_a_client_of_another_author_subscribes_through_the_tap(
    server: tuple[str, Ask], npm: Npm, loop: LoopThread
) -> None:
    url, ask = server
    device = OpcUaFieldDevice(url)
    loop.run(device.launch())
    try:
        tapped = f"opc.tcp://{device.host}:{device.port}"
        with npm.node(PROGRAMS / "opcua_client.cjs", tapped, "ns=1;s=Steps") as client:
            assert client.stdout is not None
            # It says before, in words, that it makes itself a certificate.
            told = next(line for line in client.stdout if line.startswith("{"))
            assert json.loads(told) == {"event": "value", "value": HELD["Steps"]}
        assert device.gate.unseen is None
        journal = loop.run(device.journal(0)).entries
        assert {"CreateMonitoredItems", "Publish"} <= {entry["kind"] for entry in journal}
        assert not [entry for entry in journal if entry.get("fault")]
    finally:
        loop.run(device.close())
    unchanged(ask())


def test_what_speaks_no_opcua_is_told(loop: LoopThread) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
    with pytest.raises(UsageError, match="cannot be used"):
        launched(loop, f"opc.tcp://127.0.0.1:{port}", None, key="opcua")
