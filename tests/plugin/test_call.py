"""``otmcp call``: one operation through a real adapter at its mock device, in a terminal and without one."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import select
import struct
import subprocess
import termios
from pathlib import Path

import pytest

from pytest_otmcp.cli import main
from pytest_otmcp.plant.mock_device import MockDevice
from pytest_otmcp.session.loop import LoopThread

from .command import OTMCP

MODBUS = """
[subject]
name = "a reference adapter with time for a busy machine"
version = "1"

[adapter.modbus]
command = ["{python}", "-P", "-m", "pytest_otmcp.reference_adapters", "modbus"]
env = { MODBUS_HOST = "{host}", MODBUS_PORT = "{port}", MODBUS_TIMEOUT_S = "50", MODBUS_DEADLINE_S = "55", MODBUS_WRITES_ENABLED = "true" }
deadline_s = 60
start_timeout_s = 280
"""


def rows(output: str) -> tuple[list[str], list[str]]:
    """Return what is written in the adapter's and in the device's column."""
    pairs = [
        line[9:].split(" | ", 1) if " | " in line else [line[9:].removesuffix(" |"), ""] for line in output.splitlines()
    ]
    return [left.strip() for left, _ in pairs], [right.strip() for _, right in pairs]


def called(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    """Run ``otmcp call`` in this process; return exit code, output and errors."""
    code = main(["call", *arguments])
    return code, *capsys.readouterr()


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty directory, in which the subject is the reference adapters."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "140")
    return tmp_path


def test_a_read_shows_reply_frames_and_what_the_device_saw(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "otmcp.toml").write_text(MODBUS)
    code, shown, _ = called(capsys, "read_holding", "address=1", "count=2")
    assert code == 0
    adapter, device = rows(shown)
    assert '-> read_multiple_holding_registers {"address": 1, "count": 2}' in adapter
    assert any(line.startswith("<- success") for line in adapter)
    assert any(line.startswith("-> request: read holding registers") for line in device)
    assert "output values: [30, 40]" in shown.splitlines()
    frames = shown.partition("request frame: ")[2].replace("\n  ", "")
    assert '"method":"tools/call"' in frames
    assert '"values":[30,40]' in frames


def test_a_program_reads_the_same_as_json(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "otmcp.toml").write_text(MODBUS)
    code, shown, _ = called(capsys, "--json", "read_holding", "address=1", "count=2")
    found = json.loads(shown)
    assert (code, found["success"], found["outputs"], found["faults"]) == (0, True, {"values": [30, 40]}, [])
    assert {"request", "response"} <= {entry["kind"] for entry in found["journal"]}
    assert json.loads(found["frames"]["request"])["method"] == "tools/call"


@pytest.mark.long
def test_a_write_shows_the_request_that_changed_the_device(capsys: pytest.CaptureFixture[str]) -> None:
    code, shown, _ = called(capsys, "publish", "topic=control/pump", "payload=faster", "qos=1")
    assert code == 0
    assert any("PUBLISH" in line and "(changes the device)" in line for line in rows(shown)[1])
    assert "device: it saw 1 request that changes its state" in shown.splitlines()


@pytest.mark.long
def test_a_claim_of_a_write_that_reached_nothing_is_called_a_contradiction(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    genuine, lying = '"pytest_otmcp.reference_adapters", "modbus"', '"pytest_otmcp.reference_adapters.defects", "MU-14"'
    (here / "otmcp.toml").write_text(MODBUS)
    _, shown, _ = called(capsys, "write_holding", "address=1", "value=77")
    assert "contradict" not in shown
    assert genuine in MODBUS
    (here / "otmcp.toml").write_text(MODBUS.replace(genuine, lying))
    _, shown, _ = called(capsys, "write_holding", "address=1", "value=77")
    assert "reply and device contradict each other" in shown.splitlines()


@pytest.mark.long
def test_a_refused_write_ends_with_1_and_shows_that_nothing_reached_the_device(
    capsys: pytest.CaptureFixture[str],
) -> None:
    code, shown, _ = called(capsys, "--variant=ro", "write", "node=ns=2;s=ValvePosition", "value=12.5")
    assert code == 1
    assert "reply: failure, writes_disabled" in shown.splitlines()
    assert "changes the device" not in shown


def test_nothing_is_written_by_an_adapter_that_is_not_at_the_mock(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    loop, plant = LoopThread(), MockDevice("modbus")
    try:
        loop.run(plant.launch())
        (here / "otmcp.toml").write_text(MODBUS.replace("{port}", str(plant.port)))
        code, shown, error = called(capsys, "--isolation=off", "write_holding", "address=1", "value=999")
        assert (code, shown) == (1, "")
        assert "the adapter does not talk to the mock device" in error
        assert "nothing was written" in error
        assert loop.run(plant.image())["units"]["1"]["holding_registers"][1] == 30
    finally:
        loop.run(plant.close())
        loop.close()


@pytest.mark.long
@pytest.mark.parametrize("columns", [80, 60])
def test_in_a_terminal_no_line_is_wider_than_it(here: Path, columns: int) -> None:
    (here / "otmcp.toml").write_text(MODBUS)
    main, end = pty.openpty()
    fcntl.ioctl(end, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    environment = {name: value for name, value in os.environ.items() if name != "COLUMNS"}
    with subprocess.Popen(
        [*OTMCP, "call", "read_input", "address=0", "count=20"], cwd=here, env=environment, stdout=end, stderr=end
    ) as process:
        os.close(end)
        shown = b""
        while select.select([main], [], [], 60.0)[0]:
            try:
                shown += os.read(main, 65536)
            except OSError:  # the other end is closed
                break
        os.close(main)
        assert process.wait(60) == 0
    lines = shown.decode().splitlines()
    assert any("-> request: read input" in line for line in lines)
    assert max(map(len, lines)) <= columns


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["read_holdin", "address=0"], "there is no operation 'read_holdin'; did you mean 'read_holding'?"),
        (["read_holding", "adress=0", "count=1"], "read_holding: there is no input 'adress'; did you mean 'address'?"),
        (["read_holding", "address=0"], "read_holding: count must be given, as count=VALUE"),
        (["read_holding", "address"], "read_holding: expected KEY=VALUE, found 'address'"),
        (["read_holding", "address=0", "address=1"], "read_holding: address is given twice"),
        (["publish", "topic=a", "payload=b"], "publish: publish_message needs qos, as qos=VALUE"),
        (["--subject=none.toml", "ping"], "none.toml: there is no such subject file"),
        (["--subject=one.toml", "--protocol=mqtt", "info"], "one.toml: there is no [adapter.mqtt]"),
        (["--subject=one.toml", "ping"], "the subject binds no tool to ping with these inputs"),
        (["--subject=one.toml", "read_holding", "address=zero", "count=1"], "do not fit the arguments of read"),
    ],
)
def test_what_cannot_be_called_is_said_in_a_sentence_and_ends_with_2(
    here: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    (here / "one.toml").write_text(
        '[subject]\nname = "one"\nversion = "1"\n[adapter.modbus]\ncommand = ["{python}", "-c", "", "{port}"]\n'
        '[adapter.modbus.bind.read_holding]\ntool = "read"\narguments = { address = "$address" }\noffset = { address = 1 }\nresult.values = "values"\n'
    )
    code, shown, error = called(capsys, *arguments)
    assert (code, shown) == (2, "")
    assert words in error
    assert len([line for line in error.splitlines() if line.startswith("otmcp: ")]) == 1


def test_a_reference_adapter_without_its_library_ends_with_2_and_the_extra_that_brings_it(
    here: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pytest_otmcp.subject.selection._is_installed", lambda name: name != "python-snap7")
    code, shown, error = called(capsys, "--protocol=s7", "ping")
    assert (code, shown) == (2, "")
    assert error.splitlines()[-1] == "otmcp: S7comm: python-snap7 is not installed; pip install 'pytest-otmcp[s7]'"


@pytest.mark.long
def test_an_adapter_that_does_not_start_is_one_sentence(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "otmcp.toml").write_text(
        '[subject]\nname = "silent"\nversion = "1"\n[adapter.modbus]\ncommand = ["{python}", "-c", "raise SystemExit(3)"]\n'
    )
    code, _, error = called(capsys, "ping")
    assert code == 1
    assert "'otmcp doctor' may know why" in error


COMMAND = (
    MODBUS
    + """
[adapter.modbus.commands.set_pump]
tool = "write_register"
draws = { percent = { lowest = 0, highest = 100 } }
arguments = { address = 40, value = "$percent" }
effect.write_holding = { address = 40, value = "$percent" }
[adapter.modbus.bind]
ping = { tool = "ping" }
read_holding = { tool = "read_multiple_holding_registers", arguments = { address = "$address", count = "$count" }, result = { values = "data.values" } }
"""
)


def test_a_named_command_is_called_by_its_name_and_arguments(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "otmcp.toml").write_text(COMMAND)
    code, shown, _ = called(capsys, "set_pump", "percent=70")
    assert code == 0
    adapter, device = rows(shown)
    assert '-> write_register {"address": 40, "value": 70}' in adapter
    assert any(line.startswith("-> request: write single register") for line in device)
    assert "contradict" not in shown
    stated = 'effect.write_holding = { address = 40, value = "$percent'
    assert stated in COMMAND
    (here / "otmcp.toml").write_text(COMMAND.replace(stated, f"{stated} * 10"))
    lines = called(capsys, "set_pump", "percent=70")[1].splitlines()
    assert "device: none of them has the effect that the subject file states for this command" in lines
    assert "reply and device contradict each other" in lines


READING = """
[adapter.modbus.readings.level]
tool = "read_multiple_holding_registers"
arguments = { address = 30, count = 1 }
source.read_holding = { address = 30, count = 1 }
value = "data.values[0]"
"""


def test_a_named_reading_is_called_by_its_name(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "otmcp.toml").write_text(COMMAND + READING)
    code, shown, _ = called(capsys, "level")
    assert code == 0
    adapter, device = rows(shown)
    assert '-> read_multiple_holding_registers {"address": 30, "count": 1}' in adapter
    assert any(line.startswith("-> request: read holding registers") for line in device)
    assert "output values: [0]" in shown.splitlines()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((), "set_pump: percent must be given, as percent=VALUE"),
        (("percent=101",), "set_pump: the subject file does not draw 101 for percent"),
        (("percent=true",), "set_pump: the subject file does not draw True for percent"),
        (("percnt=1",), "set_pump: there is no argument 'percnt'; did you mean 'percent'?"),
    ],
)
def test_what_a_named_command_does_not_take_is_said(
    here: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], sentence: str
) -> None:
    (here / "otmcp.toml").write_text(COMMAND)
    code, _, said = called(capsys, "set_pump", *arguments)
    assert code == 2
    assert sentence in said
