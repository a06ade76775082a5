"""Adapters beside a capture: tcpdump shows what goes to a stand-in of another author, and the kit holds nothing back."""

from __future__ import annotations

import shutil
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from pytest_otmcp.errors import KitError, UsageError
from pytest_otmcp.plant import mirror
from pytest_otmcp.plant.devices import Plant
from pytest_otmcp.plant.mirror import Mirror, OwnConnections
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.record import load
from pytest_otmcp.session.loop import LoopThread
from pytest_otmcp.wire.modbus import frame
from tests.foreign_software.conftest import Npm, npm

from .conftest import DEFECT, HERE, failing, words
from .test_real_devices import (
    IDENTITY,
    Controller,
    Judge,
    StandIn,
    consent_to,
    controller,
    device,
    judge,
    statuses,
)
from .test_real_opcua import Ask, server

__all__ = ["Npm", "controller", "device", "judge", "npm", "server"]

TCPDUMP = shutil.which("tcpdump")
pytestmark = pytest.mark.skipif(TCPDUMP is None, reason="no tcpdump here")


@contextmanager
def captured(url: str, path: Path) -> Iterator[Path]:
    """Have what goes to a device captured."""
    assert TCPDUMP is not None
    # Without -Z it becomes another user, who may not write here; without -B its buffer is full after some twenty packets of the loopback.
    options = ["--immediate-mode", "-U", "-s", "0", "-B", "65536", "-i", "lo", "-Z", "root", "-w", str(path)]
    command = [TCPDUMP, *options, f"tcp port {url.rpartition(':')[2]}"]
    capturing = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        assert capturing.stderr is not None
        if not any("listening on" in line for line in capturing.stderr):
            pytest.skip("tcpdump may not capture here")
        yield path
    finally:
        capturing.terminate()
        capturing.communicate()


@pytest.fixture
def capture(device: tuple[StandIn, str], tmp_path: Path) -> Iterator[Path]:
    with captured(device[1], tmp_path / "mirror.pcap") as path:
        yield path


def test_beside_a_capture_an_adapter_is_judged_by_reads(
    device: tuple[StandIn, str], judge: Judge, capture: Path
) -> None:
    stand_in, url = device
    results = judge(url, capture=capture)
    assert statuses(results) == ["PASS", "PASS", *["NOT_APPLICABLE"] * 3], words(results)
    assert stand_in.writes == []


def test_a_lie_is_found_beside_a_capture(device: tuple[StandIn, str], judge: Judge, capture: Path) -> None:
    stand_in, url = device
    results = judge(url, *DEFECT, "MU-01", capture=capture)
    assert failing(results) == {"F1-modbus", "F2-modbus"}, words(results)
    assert stand_in.writes == []


@pytest.mark.long
@pytest.mark.parametrize(("lie", "failed"), [(None, set()), ("wrong", {"F1-s7"}), ("heartbeat", {"F1-s7"})])
def test_beside_a_capture_of_s7(
    controller: tuple[Controller, str], judge: Judge, tmp_path: Path, lie: str | None, failed: set[str]
) -> None:
    counting, url = controller
    lying = [] if lie is None else [str(HERE / "lying_at_s7.py"), lie]
    with captured(url, tmp_path / "mirror.pcap") as capture:
        assert failing(judge(url, *lying, key="s7", capture=capture)) == failed
    # What nobody holds back arrives.
    assert (counting.changes > 0) is (lie == "heartbeat")


@pytest.mark.long
@pytest.mark.parametrize(("defect", "failed"), [(None, set()), ("MU-01o", {"F1-opcua"})])
def test_beside_a_capture_of_opc_ua_whose_second_client_speaks_as_soon_as_it_is_connected(
    server: tuple[str, Ask], judge: Judge, tmp_path: Path, defect: str | None, failed: set[str]
) -> None:
    url, _ = server
    lying = [] if defect is None else [*DEFECT, defect]
    with captured(url, tmp_path / "mirror.pcap") as capture:
        results = judge(url, *lying, key="opcua", capture=capture)
    assert failing(results) >= failed, words(results)
    assert (failing(results) == set()) is (defect is None), words(results)


def test_what_can_be_no_witness_is_refused_in_one_sentence(
    device: tuple[StandIn, str], capture: Path, loop: LoopThread, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    _, url = device
    monkeypatch.setattr(mirror, "_SHOWN_S", 0.5)
    empty, text = tmp_path / "empty", tmp_path / "text"
    empty.touch()
    text.write_text("this is a text and no capture")
    for key, path, consent, problem in (
        ("modbus", empty, None, "does not show within 0.5 s what goes to 127.0.0.1"),
        ("modbus", text, None, "cannot be read: it is neither pcap nor pcapng"),
        ("modbus", tmp_path / "none", None, "cannot be read: No such file or directory"),
        ("modbus", capture, consent_to(url), "a capture holds nothing back, so nothing is written"),
        ("dnp3", capture, None, "a capture is no witness for the DNP3 device"),
    ):
        plant = Plant({key: url}, consents={} if consent is None else {key: consent}, capture=path)
        try:
            with pytest.raises(UsageError, match=problem):
                loop.run(plant.device(key))
        finally:
            loop.run(plant.close())


def test_a_capture_that_has_lost_packets_is_no_witness(loop: LoopThread, tmp_path: Path) -> None:
    framing = protocols()["modbus"].framing
    assert framing is not None
    ended = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port: int = listener.getsockname()[1]
        path, holes = tmp_path / "whole", tmp_path / "holes"
        holes.touch()
        with captured(f"tcp://127.0.0.1:{port}", path):
            copying = threading.Thread(target=copy_without, args=(b"lost", path, holes, ended))
            copying.start()
            beside = Mirror(holes, "127.0.0.1", port, framing, lambda frame: None, OwnConnections())
            try:
                loop.run(beside.start())
                client = socket.create_connection(("127.0.0.1", port))
                # The connections of the marks are before it.
                while (server := listener.accept())[1] != client.getsockname():
                    server[0].close()
                with client, server[0]:
                    for piece in (b"said", b"lost", b"said"):
                        client.sendall(piece)
                        assert server[0].recv(16) == piece
                    with pytest.raises(KitError, match="has lost packets"):
                        loop.run(beside.settle())
            finally:
                ended.set()
                copying.join()
                loop.run(beside.aclose())


def test_what_other_machines_do_is_nobodys_of_the_adapter(loop: LoopThread, tmp_path: Path) -> None:
    framing = protocols()["modbus"].framing
    assert framing is not None
    write = frame(1, 1, struct.pack(">BHH", 6, 100, 7))
    with (
        socket.create_server(("127.0.0.1", 0)) as listener,
        captured(f"tcp://127.0.0.1:{listener.getsockname()[1]}", tmp_path / "mirror.pcap") as path,
    ):
        port = listener.getsockname()[1]
        beside = Mirror(path, "127.0.0.1", port, framing, lambda frame: None, OwnConnections())
        try:
            loop.run(beside.start())
            for here, found in (("127.0.0.2", []), ("127.0.0.1", ["CONNECTED", "request"])):
                with socket.create_connection(("127.0.0.1", port), source_address=(here, 0)) as client:
                    client.sendall(write)
                    loop.run(beside.settle())
                    assert [entry["kind"] for entry in beside.journal.since(0)][:2] == found
        finally:
            loop.run(beside.aclose())


def copy_without(text: bytes, path: Path, copy: Path, ended: threading.Event) -> None:
    """Copy a capture that grows, without the packets that have a text."""
    done = 0
    while not ended.wait(0.01):
        content = path.read_bytes() if path.exists() else b""
        while len(content) >= done + 16:
            length = 16 + struct.unpack_from("<I", content, done + 8)[0] if done else 24
            if len(content) < done + length:
                break
            record = content[done : done + length]
            done += length
            if text not in record:
                with copy.open("ab") as file:
                    file.write(record)


@pytest.mark.long
def test_a_run_beside_a_capture_names_its_witness(device: tuple[StandIn, str], capture: Path, tmp_path: Path) -> None:
    _, url = device

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-P", "-m", *words]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)

    options = (f"--otmcp-device=modbus={url}", f"--otmcp-mirror={capture}", "--otmcp-report-dir=report")
    done = run("pytest", "-p", "no:cacheprovider", "--pyargs", "pytest_otmcp.conformance", *options)
    assert done.returncode == 0, done.stdout[-4000:]
    for facts in load(tmp_path / "report" / "run.json")["devices"].values():
        expected = {"mirror": "the capture mirror.pcap", "state": "the kit's own Modbus client", "identity": IDENTITY}
        assert facts["witnesses"] == expected
    verified = run("pytest_otmcp.cli", "verify", "report/run.json")
    assert verified.returncode == 0, verified.stdout + verified.stderr
