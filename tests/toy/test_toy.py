"""A protocol that the kit does not know goes through the whole kit: two toys, over TCP and over UDP, of a third party."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

SITE = Path(__file__).parent / "site"
UNDRAWN = Path(__file__).parents[1] / "plugin" / "undrawn"
"""A plugin for runs whose figures no test looks at."""
ADAPTER = """
[adapter.{key}]
command = ["{{python}}", "-m", "otmcp_toy.adapter", "{transport}", "{{host}}", "{{port}}", "{manner}"]
env = {{ PYTHONPATH = "{{env:PYTHONPATH}}" }}
rw = {{ args = ["writes"] }}
answer = "structured"
unclaimed = {{ recovery = "not looked at" }}
deadline_s = 30
errors = [
    {{ text = "disabled", code = "writes_disabled" }},
    {{ text = "no such register", code = "illegal_address" }},
]

[adapter.{key}.bind.read]
tool = "get"
arguments = {{ address = "$address" }}
result = {{ value = "value" }}

[adapter.{key}.bind.write]
tool = "put"
arguments = {{ address = "$address", value = "$value" }}
result = {{ value = "value" }}
"""

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """A function that runs a program of the kit where the toy is installed."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(SITE), str(UNDRAWN)))}

    def start(*command: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", *command],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )

    return start


def subject(tmp_path: Path, *, manner: str = "honest") -> None:
    text = '[subject]\nname = "toys"\nversion = "1"\n'
    for key, transport in (("toy", "tcp"), ("toyudp", "udp")):
        text += ADAPTER.format(key=key, transport=transport, manner=manner)
    (tmp_path / "otmcp.toml").write_text(text, encoding="utf-8")


def record(tmp_path: Path) -> Any:
    return json.loads((tmp_path / "reports/latest/run.json").read_text(encoding="utf-8"))


@pytest.mark.long
def test_toys_are_collected_run_witnessed_recorded_reported_and_judged_again(run: Run, tmp_path: Path) -> None:
    subject(tmp_path)
    done = run("pytest", "--otmcp-reps=3", "-p", "no:cacheprovider")
    assert done.returncode == 0, done.stdout + done.stderr
    statuses = {item["id"]: item["status"] for item in record(tmp_path)["items"]}
    assert {name for name, status in statuses.items() if status == "PASS"} == {"T1", "T2", "U1", "U2"}
    assert {status for name, status in statuses.items() if name[0] not in "TU"} == {"NOT_APPLICABLE"}
    written = [item for item in record(tmp_path)["items"] if item["id"] == "U2"]
    entries = [entry for sample in written[0]["samples"] for entry in sample["device"] if entry["state_changing"]]
    assert [entry["value"] for entry in entries] == [40, 41, 42]
    page = (tmp_path / "reports/latest/report.html").read_text(encoding="utf-8")
    assert "Toy (UDP)" in page
    again = run("pytest_otmcp.cli", "report", "reports/latest/run.json")
    assert again.returncode == 0, again.stderr


@pytest.mark.long
def test_a_toy_that_says_written_and_wrote_nothing_is_found_out_by_its_device(run: Run, tmp_path: Path) -> None:
    subject(tmp_path, manner="lies")
    done = run("pytest", "--otmcp-reps=1", "-p", "no:cacheprovider", "-p", "undrawn", "-k", "T2 or U2")
    assert done.returncode == 1, done.stdout + done.stderr
    for item in record(tmp_path)["items"]:
        codes = {finding["code"] for sample in item["samples"] for finding in sample["findings"]}
        assert codes == {"not_written_once", "device_differs"}, item["id"]


@pytest.mark.long
def test_a_write_when_the_session_begins_is_found_at_its_end(run: Run, tmp_path: Path) -> None:
    subject(tmp_path, manner="greets")
    done = run("pytest", "--otmcp-reps=2", "-p", "no:cacheprovider", "-k", "T1 or T2 or U2")
    assert done.returncode == 1, done.stdout + done.stderr
    found = {item["id"]: [finding["code"] for finding in item["findings"]] for item in record(tmp_path)["items"]}
    # Only the guard is broken: with writes enabled the same write is no finding, as it came before any call.
    assert found == {"T1": [], "T2": ["wrote"], "U2": ["wrote"]}


def test_a_subject_without_toys_has_no_items_of_them(run: Run, tmp_path: Path) -> None:
    done = run("pytest", "--collect-only", "-q", "--pyargs", "pytest_otmcp.conformance")
    assert "test_normal[M1]" in done.stdout
    assert "T1" not in done.stdout


@pytest.mark.long
def test_a_certificate_names_the_protocols_of_third_parties(run: Run, tmp_path: Path) -> None:
    subject(tmp_path)
    done = run("pytest_otmcp.cli", "certify", "--out", "reports/latest")
    assert done.returncode == 0, done.stdout + done.stderr
    verified = run("pytest_otmcp.cli", "verify", "reports/latest/certificate.json", "reports/latest/run.json")
    assert verified.returncode == 0, verified.stdout + verified.stderr
    strangers = [entry for entry in record(tmp_path)["kit"]["protocols"] if entry["digest"]]
    assert [(entry["key"], entry["distribution"], entry["version"]) for entry in strangers] == [
        ("toy", "otmcp-toy", "1.0"),
        ("toyudp", "otmcp-toy", "1.0"),
    ]
    told = json.loads((tmp_path / "reports/latest/certificate.json").read_text(encoding="utf-8"))
    judges = {entry["name"]: entry["digest"] for entry in told["predicate"]["configuration"]}
    assert judges["protocol toy: otmcp-toy 1.0"] == {"sha256": strangers[0]["digest"].removeprefix("sha256:")}
    assert "protocol toyudp: otmcp-toy 1.0" in verified.stdout
    elsewhere = subprocess.run(
        [
            sys.executable,
            "-m",
            "pytest_otmcp.cli",
            "verify",
            "reports/latest/certificate.json",
            "reports/latest/run.json",
        ],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert elsewhere.returncode == 1
    assert "was judged by the protocol 'toy' of otmcp-toy 1.0; install it to judge the run again" in elsewhere.stderr


TAPPED = """
import asyncio, json, os, sys
from pytest_otmcp.plant.mock_device import MockDevice
from pytest_otmcp.plant.tap.faults import Action, FaultRule
from pytest_otmcp.plant.tap.tap import new_tap
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.protocols.oracle import requests, state_changing

class Lines(asyncio.DatagramProtocol):
    def __init__(self):
        self.lines = asyncio.Queue()
    def datagram_received(self, data, addr):
        self.lines.put_nowait(data)

async def ask(kind, port, *lines):
    if kind == "tcp":
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        answers = []
        for line in lines:
            writer.write(line)
            answers.append(await reader.readline())
        writer.close()
        return answers
    transport, replies = await asyncio.get_running_loop().create_datagram_endpoint(Lines, remote_addr=("127.0.0.1", port))
    answers = []
    for line in lines:
        transport.sendto(line)
        answers.append(await replies.lines.get())
    transport.close()
    return answers

async def owners(device):
    # The tap is this process, too.
    return [[entry["origin"], entry["process"]["pid"] == os.getpid()] for entry in (await device.journal(0)).entries]

async def main(key):
    protocol = protocols()[key]
    device = MockDevice(protocol.mock)
    await device.launch()
    # The adapter is somebody else than this process.
    device.sessions.expect()
    endpoint = next(iter(device.endpoints.values()))
    tap = new_tap(endpoint, protocol.framing)
    await tap.start()
    try:
        answers = await ask(endpoint.kind, tap.port, b"R 3\\n", b"W 1 7\\n")
        seen, told = (await device.journal(0)).entries, tap.journal.since(0)
        common = ("kind", "direction", "request", "state_changing", "address", "value")
        print(json.dumps({
            "answers": [answer.decode() for answer in answers],
            "device": [[entry.get(name) for name in common] for entry in seen if entry["kind"].islower()],
            "tap": [[entry.get(name) for name in common] for entry in told if entry["kind"].islower()],
            "links": [entry["answers"] is not None for entry in told if entry["direction"] == "out"],
            "writes": len(state_changing(told)),
            "direct": await ask(endpoint.kind, endpoint.port, b"R 3\\n") and await owners(device),
            "tapped": [
                [entry["origin"], entry["process"]["pid"] == os.getpid()]
                for entry in device.sessions.attribute(told, tap.journal.peers)
            ],
        }))
    finally:
        await tap.aclose()
        await device.close()

asyncio.run(asyncio.wait_for(main(sys.argv[1]), 60))
"""


@pytest.mark.parametrize("key", ["toy", "toyudp"])
def test_the_tap_sees_of_a_toy_what_its_device_sees(run: Run, tmp_path: Path, key: str) -> None:
    (tmp_path / "tapped.py").write_text(TAPPED.replace("\\\\n", "\\n"), encoding="utf-8")
    done = run("tapped", key)
    assert done.returncode == 0, done.stderr
    seen = json.loads(done.stdout)
    assert [answer.strip() for answer in seen["answers"]] == ["V 3 0", "K 1 7"]
    assert seen["tap"] == seen["device"]
    assert [kind for kind, *_ in seen["tap"]] == ["read", "value", "write", "written"]
    assert (seen["links"], seen["writes"]) == ([True, True], 1)
    for told in (seen["direct"], seen["tapped"]):
        assert told
        assert {(origin, of_this_process) for origin, of_this_process in told} == {("stranger", True)}
