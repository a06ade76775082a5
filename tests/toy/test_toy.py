"""A protocol that the kit does not know goes through the whole kit: two toys, over TCP and over UDP, of a third party."""

from __future__ import annotations

import asyncio
import importlib
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.plant.mock_device import MockDevice
from pytest_otmcp.plant.tap.tap import new_tap

SITE = Path(__file__).parent / "site"
UNDRAWN = Path(__file__).parents[1] / "plugin" / "undrawn"
"""A plugin for runs whose figures no test looks at."""
ADAPTER = """
[adapter.{key}]
command = ["{{python}}", "-m", "otmcp_toy.adapter", "{transport}", "{{host}}", "{{{port}}}", "{manner}"]
env = {{ PYTHONPATH = "{{env:PYTHONPATH}}" }}
rw = {{ args = ["writes"] }}
answer = "structured"
unclaimed = {{ recovery = "not looked at" }}
deadline_s = 30
errors = [{{ text = "disabled", code = "writes_disabled" }}, {{ text = "no such register", code = "illegal_address" }}]
bind.read = {{ tool = "get", arguments = {{ address = "$address" }}, result = {{ value = "value" }} }}
bind.write.tool = "put"
bind.write.arguments = {{ address = "$address", value = "$value" }}
bind.write.result = {{ value = "value" }}
"""
RUN, CERTIFICATE = "reports/latest/run.json", "reports/latest/certificate.json"

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """A function that runs a program of the kit where the toy is installed, or at another place."""

    def start(*command: str, at: str = os.pathsep.join((str(SITE), str(UNDRAWN)))) -> subprocess.CompletedProcess[str]:
        program, environment = [sys.executable, "-m", *command], {**os.environ, "PYTHONPATH": at}
        return subprocess.run(program, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)

    return start


def subject(tmp_path: Path, *, manner: str = "honest") -> None:
    text = '[subject]\nname = "toys"\nversion = "1"\n'
    for key, transport, port in (("toy", "tcp", "port"), ("toyudp", "udp", "udp_port")):
        text += ADAPTER.format(key=key, transport=transport, port=port, manner=manner)
    (tmp_path / "otmcp.toml").write_text(text, encoding="utf-8")


def record(tmp_path: Path) -> Any:
    """Return the record as it is read where the toy is installed, whose decoder its frames need."""
    program = (
        f"import json; from pytest_otmcp.record import load; print(json.dumps(load('{RUN}', allow_incomplete=True)))"
    )
    environment = {**os.environ, "PYTHONPATH": str(SITE)}
    return json.loads(subprocess.check_output([sys.executable, "-c", program], cwd=tmp_path, env=environment))


@pytest.mark.long
def test_toys_are_collected_run_witnessed_recorded_reported_and_judged_again(run: Run, tmp_path: Path) -> None:
    subject(tmp_path)
    done = run("pytest", "--otmcp-reps=3", "-p", "no:cacheprovider")
    assert done.returncode == 0, done.stdout + done.stderr
    items = {item["id"]: item for item in record(tmp_path)["items"]}
    passed = {name for name, item in items.items() if item["status"] == "PASS"}
    assert passed == {f"{suite}{letter}{number}" for suite in ("", "S") for letter in "TU" for number in (1, 2, 3)}
    assert {item["status"] for name, item in items.items() if name not in passed} == {"NOT_APPLICABLE"}
    written = [one["value"] for sample in items["U2"]["samples"] for one in sample["device"] if one["state_changing"]]
    assert written == [40, 41, 42]
    assert "Toy (UDP)" in (tmp_path / "reports/latest/report.html").read_text(encoding="utf-8")
    again = run("pytest_otmcp.cli", "report", RUN)
    assert again.returncode == 0, again.stderr


@pytest.mark.long
@pytest.mark.parametrize(
    ("manner", "found"),
    [
        # The write reached no device, and the read tells what the device holds.
        ("lies", {"T2": {"not_written_once", "device_differs"}, "T3": {"not_written_once"}}),
        # Only the guard is broken: with writes enabled the same write is no finding, as it came before any call.
        ("greets", {"T2": set(), "T3": {"wrote"}}),
    ],
)
def test_a_toy_that_lies_or_writes_unasked_is_found_out_by_its_device(
    run: Run, tmp_path: Path, manner: str, found: dict[str, set[str]]
) -> None:
    subject(tmp_path, manner=manner)
    chosen = ("-p", "undrawn", "-k", "normal and (T2 or T3 or U2 or U3)")
    done = run("pytest", "--otmcp-reps=1", "-p", "no:cacheprovider", *chosen)
    assert done.returncode == 1, done.stdout + done.stderr
    codes = {
        item["id"]: {one["code"] for part in (item, *item["samples"]) for one in part["findings"]}
        for item in record(tmp_path)["items"]
    }
    assert codes == found | {f"U{name[1:]}": expected for name, expected in found.items()}


def test_a_subject_without_toys_has_no_items_of_them(run: Run) -> None:
    done = run("pytest", "--collect-only", "-q", "--pyargs", "pytest_otmcp.conformance")
    assert "test_normal[M1]" in done.stdout
    assert "T1" not in done.stdout


@pytest.mark.long
def test_a_certificate_names_the_protocols_of_third_parties(run: Run, tmp_path: Path) -> None:
    subject(tmp_path)
    done = run("pytest_otmcp.cli", "certify", "--out", "reports/latest")
    assert done.returncode == 0, done.stdout + done.stderr
    verify = ("pytest_otmcp.cli", "verify", CERTIFICATE, RUN)
    verified = run(*verify)
    assert verified.returncode == 0, verified.stdout + verified.stderr
    strangers = [entry for entry in record(tmp_path)["kit"]["protocols"] if entry["digest"]]
    named = [(entry["key"], entry["distribution"], entry["version"]) for entry in strangers]
    assert named == [("toy", "otmcp-toy", "1.0"), ("toyudp", "otmcp-toy", "1.0")]
    told = json.loads((tmp_path / CERTIFICATE).read_text(encoding="utf-8"))["predicate"]["configuration"]
    judges = {entry["name"]: entry["digest"] for entry in told}
    assert judges["protocol toy: otmcp-toy 1.0"] == {"sha256": strangers[0]["digest"].removeprefix("sha256:")}
    assert "protocol toyudp: otmcp-toy 1.0" in verified.stdout
    elsewhere = run(*verify, at="")
    assert elsewhere.returncode == 1
    assert "was judged by the protocol 'toy' of otmcp-toy 1.0; install it to judge the run again" in elsewhere.stderr


ASKS = """
import socket, sys
with socket.socket(type=getattr(socket, sys.argv[1])) as client:
    client.connect(("127.0.0.1", int(sys.argv[2])))
    for line in (b"R 3\\n", b"W 1 7\\n"):
        client.send(line)
        print(client.recv(100).decode().strip())
"""


@pytest.mark.parametrize("name", ["toy", "udp"])
def test_the_tap_sees_of_a_toy_what_its_device_sees(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.syspath_prepend(str(SITE))
    monkeypatch.setenv("PYTHONPATH", str(SITE))
    toy = importlib.import_module("otmcp_toy.protocol").TOY
    # It was not installed when this process read the registry.
    monkeypatch.setattr("pytest_otmcp.plant.mock_device.protocols", lambda: {"toy": toy})

    def ask(port: int) -> list[str]:
        # This process hides its memory, so that only root could tell whose the connection is.
        command = [sys.executable, "-c", ASKS, "SOCK_STREAM" if name == "toy" else "SOCK_DGRAM", str(port)]
        return subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout.splitlines()

    def told(entries: Any) -> list[list[object]]:
        members = ("kind", "direction", "request", "state_changing", "address", "value", "origin")
        return [[*map(one.get, members), one["answers"] is not None] for one in entries if one["kind"].islower()]

    async def watched() -> tuple[list[str], list[list[object]], list[list[object]]]:
        device = MockDevice(toy.mock, toy.key)
        await device.launch()
        # The adapter is somebody else than this process.
        device.sessions.expect()
        tap = new_tap(device.endpoints[name], toy.framing)
        await tap.start()
        try:
            answers = await asyncio.to_thread(ask, tap.port)
            tapped = device.sessions.attribute(tap.journal.since(0), tap.journal.peers)
            return answers, told((await device.journal(0)).entries), told(tapped)
        finally:
            await tap.aclose()
            await device.close()

    answers, seen, tapped = asyncio.run(asyncio.wait_for(watched(), 60))
    assert answers == ["V 3 0", "K 1 7"]
    assert tapped == seen
    assert tapped == [
        ["read", "in", True, False, 3, None, "stranger", False],
        ["value", "out", False, False, 3, 0, "stranger", True],
        ["write", "in", True, True, 1, 7, "stranger", False],
        ["written", "out", False, False, 1, 7, "stranger", True],
    ]
