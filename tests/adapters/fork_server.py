"""The program that starts adapters by forking a process that has imported them: ``python fork_server.py DESCRIPTOR``.

Most of an adapter's start is imports (measured: 0.9 of 1.0 s of processor time), and a test run starts dozens of adapters.
The descriptor is a socket that keeps messages apart. Each request on it is a command with its environment and the three
standard streams; the answers are the process id, and later the exit code. A forked adapter runs its command from ``main`` on,
as if it had been started.

In a forked adapter SIGUSR1 moves the event loop's clock on by :data:`STEP_S`, so that a time-out elapses when the test says
so: no test waits for it, and no pause of the machine can make a call time out that should not. The clock moves only once the
loop has dealt with what its threads were doing: a time-out that follows on a blocking call has begun by then.
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import runpy
import selectors
import signal
import socket
import sys
import time
import traceback
from asyncio import BaseEventLoop, Future
from collections.abc import Mapping
from typing import Any, NoReturn

STEP_S = 25.0
"""Seconds: more than an adapter's time-out for an exchange, less than its deadline and half a watchdog's period."""

_PRELOADED = (
    "core.run",
    "core.stdio",
    "bacnet.adapter",
    "ethercat.adapter",
    "ethernetip.adapter",
    "dnp3.adapter",
    "modbus.adapter",
    "mqtt.adapter",
    "opcua.adapter",
    "profibus.adapter",
    "profinet.adapter",
    "s7.adapter",
)


class _Clock:
    """The clock of the event loop, which a signal moves on."""

    def __init__(self) -> None:
        self._ahead_s = 0.0
        self._in_threads: set[Future[Any]] = set()

    def install(self) -> None:
        run_in_executor = BaseEventLoop.run_in_executor

        def noted(loop: BaseEventLoop, *call: Any) -> Future[Any]:
            future = run_in_executor(loop, *call)
            self._in_threads.add(future)
            future.add_done_callback(self._in_threads.discard)
            return future

        BaseEventLoop.run_in_executor = noted  # type: ignore[method-assign, assignment]
        BaseEventLoop.time = lambda loop: time.monotonic() + self._ahead_s  # type: ignore[method-assign]
        signal.signal(signal.SIGUSR1, lambda number, frame: self._move_on())

    def _move_on(self) -> None:
        if self._in_threads:
            # The task that awaits the thread is woken in the same round of the loop: it continues before the next.
            next(iter(self._in_threads)).add_done_callback(lambda ended: ended.get_loop().call_soon(self._move_on))
        else:
            self._ahead_s += STEP_S


def _run(command: list[str], env: Mapping[str, str], streams: list[int]) -> NoReturn:
    for target, stream in enumerate(streams):
        os.dup2(stream, target)
        os.close(stream)
    os.environ.clear()
    os.environ.update(env)
    _Clock().install()
    code: Any = 1
    try:
        if command[0] == "-m":
            sys.argv = command[1:]
            runpy.run_module(command[1], run_name="__main__", alter_sys=True)
        else:
            sys.argv = command
            runpy.run_path(command[0], run_name="__main__")
    except SystemExit as end:
        code = end.code
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code if isinstance(code, int) else 0)


def _serve(channel: socket.socket) -> None:
    waker, wakened = socket.socketpair()
    for end in (waker, wakened):
        end.setblocking(False)
    signal.set_wakeup_fd(waker.fileno())
    signal.signal(signal.SIGCHLD, lambda number, frame: None)
    selector = selectors.DefaultSelector()
    selector.register(channel, selectors.EVENT_READ)
    selector.register(wakened, selectors.EVENT_READ)

    def tell(**answer: int) -> None:
        channel.send(json.dumps(answer).encode())

    while True:
        ready = {key.fileobj for key, _ in selector.select()}
        if wakened in ready:
            with contextlib.suppress(BlockingIOError):
                wakened.recv(1 << 16)
        if channel in ready:
            data, streams, _, _ = socket.recv_fds(channel, 1 << 20, 3)
            if not data:
                return
            request = json.loads(data)
            pid = os.fork()
            if pid == 0:
                signal.set_wakeup_fd(-1)
                signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                selector.close()
                for end in (channel, waker, wakened):
                    end.close()
                _run(request["command"], request["env"], streams)
            for stream in streams:
                os.close(stream)
            tell(started=pid)
        with contextlib.suppress(ChildProcessError):
            while (ended := os.waitpid(-1, os.WNOHANG))[0]:
                tell(ended=ended[0], code=os.waitstatus_to_exitcode(ended[1]))


if __name__ == "__main__":
    for _name in _PRELOADED:
        __import__(f"pytest_otmcp.reference_adapters.{_name}")
    for _name in ("pytest", "jsonschema"):
        __import__(_name)
    gc.freeze()
    _serve(socket.socket(fileno=int(sys.argv[1])))
