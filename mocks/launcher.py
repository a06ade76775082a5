"""Runs a mock: a launcher process that stays, and device processes that come and go.

A stopped endpoint must really be gone: its process killed, its connections dead, its port refusing. So that a start
takes milliseconds nevertheless, the launcher imports and prepares everything once and forks the devices.

The launcher keeps the port: a bound socket that never listens. Connections to it are refused while no device listens,
nobody else can take the port meanwhile, and no client's connect() can be given the port as its own source port (which
on loopback would connect it to itself). The device binds the same port with SO_REUSEPORT.

Standard output carries one JSON object per line, standard input one word per line:

=========  ==========================================================================================
``stop``   kill the device; ``{"event": "stopped", "port"}``
``start``  a new device on the same port; ``{"event": "ready", "protocol", "host", "port", "control", "pid"}``
=========  ==========================================================================================

``{"event": "died", "port", "exit"}`` tells that a device ended by itself. End of input ends everything.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import importlib
import json
import os
import selectors
import signal
import socket
import sys
from types import ModuleType
from typing import Any, NoReturn

from .control import ControlServer
from .device import Device

__all__ = ["run"]


def run(protocol: str, host: str, port: int) -> int:
    """Serve until standard input closes; returns the exit code.

    Raises:
        OSError: the port cannot be bound.
    """
    reservation = _bound(host, port)
    port = reservation.getsockname()[1]
    module = importlib.import_module(f".{protocol}", __package__)
    module.warm()
    # What the devices inherit must not be copied page by page by their garbage collectors.
    gc.collect()
    gc.freeze()
    launcher = _Launcher(protocol, host, port, module)
    signal.signal(signal.SIGTERM, _end)
    signal.signal(signal.SIGINT, _end)
    try:
        launcher.start()
        launcher.obey()
    except _Ended:
        pass
    finally:
        launcher.stop()
        reservation.close()
    return 0


class _Ended(BaseException):
    """A signal asked the launcher to end."""


def _end(number: int, frame: Any) -> NoReturn:
    raise _Ended


def _bound(host: str, port: int) -> socket.socket:
    # The protocol is named because asyncio sets TCP_NODELAY only where it reads IPPROTO_TCP.
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        listener.bind((host, port))
    except BaseException:
        listener.close()
        raise
    return listener


class _Launcher:
    def __init__(self, protocol: str, host: str, port: int, module: ModuleType) -> None:
        self._protocol = protocol
        self._host = host
        self._port = port
        self._module = module
        self._pid: int | None = None
        self._death: int | None = None
        # The device holds the reading end: it reads end-of-file when the launcher is gone, however it went.
        self._life_read, self._life_write = os.pipe()
        self._selector = selectors.DefaultSelector()
        self._buffer = b""

    def say(self, **event: Any) -> None:
        sys.stdout.write(json.dumps(event) + "\n")
        sys.stdout.flush()

    def obey(self) -> None:
        """Read commands until standard input closes; notice a device that dies."""
        self._selector.register(0, selectors.EVENT_READ)
        while True:
            for key, _ in self._selector.select():
                if key.fd != 0:
                    self._device_died()
                elif not self._read_commands():
                    return

    def _read_commands(self) -> bool:
        chunk = os.read(0, 4096)
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
        """Fork a device and tell when it accepts connections."""
        ready_read, ready_write = os.pipe()
        pid = os.fork()
        if pid == 0:
            os.close(ready_read)
            os.close(self._life_write)
            self._become_device(ready_write)
        os.close(ready_write)
        self._pid = pid
        with os.fdopen(ready_read, "rb", buffering=0) as pipe:
            control = pipe.readline()
        if not control:
            self._device_died()
            return
        if hasattr(os, "pidfd_open"):
            # Readable when the device has ended: no signal handler is needed.
            self._death = os.pidfd_open(pid)
            self._selector.register(self._death, selectors.EVENT_READ)
        self.say(
            event="ready",
            protocol=self._protocol,
            host=self._host,
            port=self._port,
            control=int(control),
            pid=pid,
        )

    def _reap(self) -> int:
        assert self._pid is not None
        death, self._death = self._death, None
        if death is not None:
            self._selector.unregister(death)
            os.close(death)
        _, status = os.waitpid(self._pid, 0)
        self._pid = None
        return os.waitstatus_to_exitcode(status)

    def _device_died(self) -> None:
        self.say(event="died", port=self._port, exit=self._reap())

    def stop(self) -> None:
        """Kill the device, if there is one."""
        if self._pid is not None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._pid, signal.SIGKILL)
            self._reap()

    def _become_device(self, ready: int) -> NoReturn:
        code = 1
        try:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            # Ctrl-C in a terminal reaches the whole group; the launcher decides when a device ends.
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            null = os.open(os.devnull, os.O_RDWR)
            os.dup2(null, 0)
            os.dup2(2, 1)
            self._selector.close()
            device = self._module.create()
            asyncio.run(_serve(device, _bound(self._host, self._port), ready, self._life_read))
            code = 0
        finally:
            sys.stderr.flush()
            # Not sys.exit: the launcher's exit handlers are not the device's.
            os._exit(code)


async def _serve(device: Device, listener: socket.socket, ready: int, life: int) -> None:
    ended = asyncio.Event()
    asyncio.get_running_loop().add_reader(life, ended.set)
    await device.serve(listener)
    control = ControlServer(device)
    port = await control.start()
    os.write(ready, f"{port}\n".encode())
    os.close(ready)
    await ended.wait()
    await device.aclose()
