"""The launcher, seen from outside: starts, stops and ends of a mock."""

from __future__ import annotations

import asyncio
import contextlib
import os
import pathlib
import signal
import socket
import sys
from collections.abc import Awaitable, Callable

import psutil
import pytest
from mock_program import PATIENCE_S, MockProgram

pytestmark = pytest.mark.asyncio


async def complaint(*arguments: str) -> tuple[int, str]:
    return await (await MockProgram.start(*arguments)).end()


async def test_the_ready_line_tells_where_everything_is(modbus: MockProgram) -> None:
    assert set(modbus.ready_event) == {"event", "protocol", "host", "port", "endpoints", "control", "pid"}
    assert modbus.ready_event["protocol"] == "modbus"
    address = {"kind": "tcp", "host": modbus.host, "port": modbus.port}
    assert modbus.ready_event["endpoints"] == {"modbus": address}


async def test_the_control_socket_goes_with_the_device_and_its_directory_with_the_program(modbus: MockProgram) -> None:
    path = modbus.ready_event["control"]
    modbus.say("stop")
    await modbus.event()
    with pytest.raises(FileNotFoundError):
        os.stat(path)
    modbus.say("start")
    await modbus.ready()
    await modbus.end()
    with pytest.raises(FileNotFoundError):
        os.stat(os.path.dirname(path))


async def test_a_temporary_directory_with_a_long_name_is_no_obstacle(
    start_mock: Callable[..., Awaitable[MockProgram]], tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    deep = tmp_path / ("d" * 100)
    deep.mkdir()
    monkeypatch.setenv("TMPDIR", str(deep))
    program = await start_mock("modbus")
    assert len(program.ready_event["control"]) < 108
    assert list(deep.iterdir()) == []


async def test_a_stopped_device_is_gone_and_its_port_refuses(modbus: MockProgram) -> None:
    reader, writer = await asyncio.open_connection(modbus.host, modbus.port)
    device = modbus.ready_event["pid"]
    modbus.say("stop")
    assert await modbus.event() == {"event": "stopped", "port": modbus.port}
    assert not psutil.pid_exists(device)
    with pytest.raises(ConnectionRefusedError):
        await asyncio.open_connection(modbus.host, modbus.port)
    # The device is dead and not only silent: the connection ends, in an orderly way or not.
    with contextlib.suppress(ConnectionResetError):
        assert await asyncio.wait_for(reader.read(), PATIENCE_S) == b""
    writer.close()


async def test_the_port_of_a_stopped_device_is_given_to_nobody(modbus: MockProgram) -> None:
    modbus.say("stop")
    await modbus.event()
    with socket.socket() as other:
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with pytest.raises(OSError, match="in use"):
            other.bind((modbus.host, modbus.port))


async def test_a_device_does_not_share_its_port_with_a_program_that_took_it_meanwhile(modbus: MockProgram) -> None:
    modbus.say("stop")
    await modbus.event()
    with socket.socket() as other:
        # One of the same user can: the reservation has the option, too, as the device will have it.
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        other.bind((modbus.host, modbus.port))
        other.listen()
        modbus.say("start")
        assert await modbus.event() == {"event": "died", "port": modbus.port, "exit": 69}
    modbus.say("start")
    await modbus.ready()


async def test_two_hundred_restarts_with_a_client_connected_each_time(modbus: MockProgram) -> None:
    """A killed server leaves its side of connections in TIME_WAIT; none may keep the next server from the port."""
    writers = []
    for _ in range(200):
        _, writer = await asyncio.open_connection(modbus.host, modbus.port)
        writers.append(writer)
        await modbus.restart()
    for writer in writers:
        writer.close()


async def test_commands_may_be_written_ahead(modbus: MockProgram) -> None:
    modbus.say("stop", "start", "stop", "start")
    assert [(await modbus.event())["event"] for _ in range(3)] == ["stopped", "ready", "stopped"]
    await modbus.ready()
    await modbus.control.image()


async def test_a_device_that_dies_is_reported_and_can_be_replaced(modbus: MockProgram) -> None:
    os.kill(modbus.ready_event["pid"], signal.SIGKILL)
    assert await modbus.event() == {"event": "died", "port": modbus.port, "exit": -signal.SIGKILL}
    modbus.say("start")
    await modbus.ready()


async def test_a_death_just_before_a_stop_is_reported_first(modbus: MockProgram) -> None:
    launcher = psutil.Process(modbus.process.pid)
    # The launcher is suspended, so that it finds both the death and the stop when it continues.
    launcher.suspend()
    device = psutil.Process(modbus.ready_event["pid"])
    device.kill()
    while device.status() != psutil.STATUS_ZOMBIE:  # only its suspended parent is notified  # noqa: ASYNC110
        await asyncio.sleep(0.001)
    modbus.say("stop", "start")
    assert modbus.process.stdin is not None
    await modbus.process.stdin.drain()
    launcher.resume()
    assert (await modbus.event())["event"] == "died"
    assert (await modbus.event())["event"] == "stopped"
    await modbus.ready()


async def test_what_is_no_command_is_answered_and_changes_nothing(modbus: MockProgram) -> None:
    modbus.say("reboot", "", "x" * 10_000, "\x00\ufffe", "start")
    messages = [await modbus.event() for _ in range(4)]
    assert {message["event"] for message in messages} == {"error"}
    assert "unknown command 'reboot'" in messages[0]["message"]
    assert len(messages[1]["message"]) < 200
    assert messages[3]["message"] == "the device is already running"
    await modbus.control.image()


async def test_end_of_input_ends_everything(modbus: MockProgram) -> None:
    assert await modbus.end() == (0, "")
    assert not psutil.pid_exists(modbus.ready_event["pid"])


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
async def test_a_signal_ends_everything(modbus: MockProgram, number: signal.Signals) -> None:
    modbus.process.send_signal(number)
    assert await asyncio.wait_for(modbus.process.wait(), PATIENCE_S) == 0
    assert not psutil.pid_exists(modbus.ready_event["pid"])


async def test_a_killed_launcher_leaves_no_device(modbus: MockProgram) -> None:
    modbus.process.kill()
    # Standard error ends with the last process that holds it.
    assert await modbus.end() == (-signal.SIGKILL, "")
    with pytest.raises(ConnectionRefusedError):
        await asyncio.open_connection(modbus.host, modbus.port)
    with pytest.raises(FileNotFoundError):
        os.stat(os.path.dirname(modbus.ready_event["control"]))


async def test_a_launcher_killed_after_a_restart_leaves_no_device(modbus: MockProgram) -> None:
    await modbus.restart()
    modbus.process.kill()
    assert await modbus.end() == (-signal.SIGKILL, "")


async def test_a_launcher_whose_listener_has_gone_ends(modbus: MockProgram) -> None:
    transport = modbus.process._transport.get_pipe_transport(1)  # type: ignore[attr-defined]
    transport.close()
    # The pipe is really closed one turn of the loop later; the launcher must not find it still open.
    await asyncio.sleep(0)
    modbus.say("stop")
    assert await asyncio.wait_for(modbus.process.wait(), PATIENCE_S) == 0


async def test_input_that_is_dev_null_has_ended() -> None:
    process = await asyncio.create_subprocess_shell(
        f'exec "{sys.executable}" -m pytest_otmcp.mocks modbus < /dev/null',
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    stdout, stderr = await asyncio.wait_for(process.communicate(), PATIENCE_S)
    assert (process.returncode, stdout.count(b"\n"), stderr) == (0, 1, b"")


async def test_a_port_that_another_program_serves_on_is_refused_in_one_sentence() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        code, stderr = await complaint("modbus", "--port", str(port))
    assert (code, stderr) == (1, f"cannot serve on 127.0.0.1:{port}: Address already in use\n")


async def test_a_port_that_another_mock_has_is_refused_even_while_its_device_is_stopped(modbus: MockProgram) -> None:
    assert (await complaint("modbus", "--port", str(modbus.port)))[0] == 1
    modbus.say("stop")
    await modbus.event()
    assert (await complaint("modbus", "--port", str(modbus.port)))[0] == 1


async def test_a_mock_can_take_the_port_of_one_that_just_ended(
    modbus: MockProgram, start_mock: Callable[..., Awaitable[MockProgram]]
) -> None:
    _, writer = await asyncio.open_connection(modbus.host, modbus.port)
    await modbus.restart()  # leaves the connection in TIME_WAIT
    await modbus.end()
    again = await start_mock("modbus", "--port", str(modbus.port))
    assert await again.end() == (0, "")
    writer.close()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["hart"],
            "there is no mock 'hart'; there are bacnet, dnp3, ethercat, ethernetip, modbus, mqtt, opcua, profibus, profinet, s7, sparkplug, and modules",
        ),
        (["thirdparty.hart"], "thirdparty.hart cannot be imported: No module named 'thirdparty.hart'"),
        (["thirdparty.nothing"], "thirdparty.nothing offers no mock: it lacks ENDPOINTS, warm, create"),
        (["thirdparty.terminal", "--port", "1502"], "--port: thirdparty.terminal serves on a pseudo terminal"),
        (["modbus", "--port", "70000"], "--port: expected 0 to 65535, found 70000"),
        (["modbus", "--port", "x"], "invalid int value: 'x'"),
        (["modbus", "--broker", "mqtt://127.0.0.1"], "unrecognized arguments: --broker mqtt://127.0.0.1"),
        (["sparkplug"], "required: --broker"),
        ([], "required: PROTOCOL"),
    ],
)
async def test_a_wrong_option_is_named_and_ends_with_2(arguments: list[str], words: str) -> None:
    code, stderr = await complaint(*arguments)
    assert code == 2
    assert words in stderr
    assert "Traceback" not in stderr
