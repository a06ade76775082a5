"""The launcher of a mock: one launcher process that lives on, and device processes that are started and killed.

A stopped device must really be gone: its process killed, its connections broken, its port refusing. So that a start
takes only milliseconds, the launcher imports and prepares everything once and forks the devices. It keeps the
addresses of the device over restarts (see ``reservation``).

Standard output carries one JSON object per line, standard input one word per line:

=========  ==========================================================================================
``stop``   kill the device; ``{"event": "stopped", "port"}``
``start``  a new device at the same addresses;
           ``{"event": "ready", "protocol", "host", "port", "endpoints", "control", "pid"}``
=========  ==========================================================================================

``endpoints`` maps the name of each endpoint to ``{"kind": "tcp" or "udp", "host", "port"}``, ``{"kind": "pty", "path"}`` or
``{"kind": "cable", "host", "path", "mac", "join"}``, where ``join`` is the number of a process in the network of the clients, for
nsenter(1). ``host`` and ``port`` are those of the first, null where it has none; ``control`` is the path of the control socket.
``{"event": "died", "port", "exit"}`` tells that a device ended by itself; ``start`` is understood afterwards. The exit code is
75 for a device that has run out of something, 69 for one whose port another program has taken, and else 1.
``{"event": "error", "message"}`` answers any other word. End of input ends everything.

Two pipes connect the processes, so that each notices the end of the other, however it ends: the device reads
end-of-file from the *life* pipe when the launcher has ended, the launcher from the *death* pipe when the device has.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import gc
import json
import os
import selectors
import signal
import sys
import traceback
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn

from .control import ControlServer
from .control_socket import ControlSocket
from .device import Device
from .exhaustion import EXIT_CODE, end_when_exhausted, is_exhaustion
from .memory import hide_memory
from .packages import MockPackage
from .reservation import Reservation, reserve

__all__ = ["run"]


_OCCUPIED = 69
"""Exit code of a device whose port another program has taken: EX_UNAVAILABLE of ``sysexits.h``."""

_STDIN, _STDOUT, _STDERR = 0, 1, 2
_END_SIGNALS = (signal.SIGTERM, signal.SIGINT)


def run(name: str, package: MockPackage, host: str, port: int, certificates: Path | None = None) -> int:
    """Serve until standard input closes and return the exit code. The garbage collector is off in the launcher.

    Args:
        name: name under which the package was requested, for the ready event.
        package: the mock.
        host: address of all ports.
        port: that of the first endpoint, 0 for a free one; the other endpoints have free ports.
        certificates: a folder of them, with which the device speaks the secure form of its protocol; see :mod:`.tls`.

    Raises:
        OSError: a port cannot be bound, or another program serves on it.
    """
    with contextlib.ExitStack() as kept:
        reservations: dict[str, Reservation] = {}
        for index, endpoint in enumerate(package.ENDPOINTS):
            reservation = reserve(endpoint, host, 0 if index else port)
            kept.callback(reservation.close)
            reservations[endpoint.name] = reservation
        package.warm()
        if certificates is not None:
            # What takes time is imported before devices are forked.
            package.create().secure(certificates)
        # The devices' garbage collectors do not touch frozen objects, so their memory pages are not copied.
        gc.freeze()
        return _run(name, package, reservations, certificates)


def _run(name: str, package: MockPackage, reservations: Mapping[str, Reservation], certificates: Path | None) -> int:
    hide_memory()
    # Signals are handled only where the launcher waits, so never between a fork and the storing of its process id.
    signal.pthread_sigmask(signal.SIG_BLOCK, _END_SIGNALS)
    signal.signal(signal.SIGTERM, _end)
    signal.signal(signal.SIGINT, _end)
    control = ControlSocket()
    launcher = _Launcher(name, package, reservations, control, certificates)
    try:
        launcher.start()
        launcher.serve_commands()
    except _Ended:
        pass
    finally:
        launcher.stop()
        control.remove()
    return 0


class _Ended(BaseException):
    """A signal asked the launcher to end, or its standard output was closed."""


def _end(number: int, frame: Any) -> NoReturn:
    raise _Ended


@contextlib.contextmanager
def _interruptible() -> Iterator[None]:
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _END_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_BLOCK, _END_SIGNALS)


class _Launcher:
    """The launcher process: it executes the commands of standard input, with one device process at a time."""

    def __init__(
        self,
        name: str,
        package: MockPackage,
        reservations: Mapping[str, Reservation],
        control: ControlSocket,
        certificates: Path | None,
    ) -> None:
        self._name = name
        self._certificates = certificates
        self._package = package
        self._reservations = reservations
        self._endpoints = {endpoint: reservation.address for endpoint, reservation in reservations.items()}
        first = next(iter(self._endpoints.values()))
        self._host, self._port = first.get("host"), first.get("port")
        self._control = control
        self._pid: int | None = None
        self._death = -1
        self._life_read, self._life_write = os.pipe()
        # poll and not epoll, which refuses files and /dev/null as standard input.
        self._selector = selectors.PollSelector()
        self._buffer = b""

    def say(self, **event: Any) -> None:
        """Write an event."""
        try:
            # The write is unbuffered: a forked device must not inherit buffered text and write it again.
            os.write(_STDOUT, json.dumps(event).encode() + b"\n")
        except BrokenPipeError:
            raise _Ended from None

    def serve_commands(self) -> None:
        """Read commands until standard input closes; report a device that dies."""
        self._selector.register(_STDIN, selectors.EVENT_READ)
        while True:
            with _interruptible():
                readable = {key.fd for key, _ in self._selector.select()}
            # The device's death comes first: a command may reap the device and reuse the descriptor of its pipe.
            if self._death in readable:
                self._device_died()
            if _STDIN in readable and not self._read_commands():
                return

    def _read_commands(self) -> bool:
        chunk = os.read(_STDIN, 4096)
        *lines, self._buffer = (self._buffer + chunk).split(b"\n")
        for line in lines:
            word = line.strip().decode("utf-8", "replace")
            if word == "stop":
                self.stop()
                self.say(event="stopped", port=self._port)
            elif word == "start" and self._pid is None:
                self.start()
            elif word == "start":
                self.say(event="error", message="the device is already running")
            elif word:
                self.say(event="error", message=f"unknown command {word[:80]!r}; known are stop and start")
        return bool(chunk)

    def start(self) -> None:
        """Fork a device and report when it serves."""
        death_read, death_write = os.pipe()
        pid = os.fork()
        if pid == 0:
            os.close(death_read)
            os.close(self._life_write)
            self._become_device(death_write)
        os.close(death_write)
        self._pid, self._death = pid, death_read
        self._selector.register(death_read, selectors.EVENT_READ)
        with _interruptible():
            is_ready = os.read(death_read, 1)
        if not is_ready:
            self._device_died()
            return
        self.say(
            event="ready",
            protocol=self._name,
            host=self._host,
            port=self._port,
            endpoints=self._endpoints,
            control=self._control.path,
            pid=pid,
        )

    def _reap(self) -> int:
        assert self._pid is not None
        self._selector.unregister(self._death)
        os.close(self._death)
        _, status = os.waitpid(self._pid, 0)
        self._pid, self._death = None, -1
        self._control.clear()
        return os.waitstatus_to_exitcode(status)

    def _device_died(self) -> None:
        self.say(event="died", port=self._port, exit=self._reap())

    def stop(self) -> None:
        """Kill the device, if there is one."""
        if self._pid is not None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._pid, signal.SIGKILL)
            self._reap()

    def _become_device(self, death: int) -> NoReturn:
        code = 1
        try:
            gc.enable()
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            # Ctrl-C in a terminal reaches the whole group; the launcher decides when a device ends.
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, _END_SIGNALS)
            # The launcher's commands are not for the device, and a stray print must not look like an event.
            null = os.open(os.devnull, os.O_RDWR)
            os.dup2(null, _STDIN)
            os.close(null)
            os.dup2(_STDERR, _STDOUT)
            device = self._package.create()
            device.port = self._port
            if self._certificates is not None:
                device.secure(self._certificates)
            asyncio.run(_serve(device, self._reservations, self._control, death, self._life_read))
            code = 0
        except BaseException as error:
            if is_exhaustion(error):
                code = EXIT_CODE
            elif isinstance(error, OSError) and error.errno == errno.EADDRINUSE:
                code = _OCCUPIED
            if code != _OCCUPIED:
                traceback.print_exc()
        finally:
            sys.stderr.flush()
            # This is not sys.exit: the launcher's exit handlers must not run in the device.
            os._exit(code)


async def _serve(
    device: Device, reservations: Mapping[str, Reservation], control: ControlSocket, death: int, life: int
) -> None:
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    loop.set_exception_handler(end_when_exhausted)
    loop.add_reader(life, ended.set)
    await device.serve({name: reservation.open() for name, reservation in reservations.items()})
    await ControlServer(device).start(control.listen())
    # The pipe stays open: its end shows the end of the device.
    with contextlib.suppress(BrokenPipeError):  # the launcher is gone already, and the life pipe will tell
        os.write(death, b"\n")
    await ended.wait()
    await device.aclose()
    # The launcher was killed and could not do this itself.
    control.remove()
