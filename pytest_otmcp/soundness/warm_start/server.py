"""``python server.py SOCKET MODULE...``: a server that imports these modules, forks an adapter for each request, and ends with its
standard input."""

from __future__ import annotations

import atexit
import ctypes
import gc
import json
import os
import runpy
import selectors
import signal
import socket
import struct
import sys
import threading
import traceback
from dataclasses import dataclass
from importlib import import_module
from typing import Any, NoReturn

TOKEN = "OTMCP_SESSION"  # noqa: S105
TOKEN_LETTERS = 32


@dataclass(frozen=True, slots=True, kw_only=True)
class Adapter:
    """A forked process.

    Attributes:
        process: its id, and that of its process group.
        handle: becomes readable when the process has ended.
        asked: the connection of the program that requested it; becomes readable when that program has ended.
    """

    process: int
    handle: int
    asked: socket.socket


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """The program that a forked process is to run.

    Attributes:
        arguments: those of ``python``.
        directory: the working directory.
        environment: the whole environment.
        privileges: capabilities of whoever asks, as bits.
        streams: standard input, output and error.
        namespaces: user, network, mount, IPC, name and process namespace of whoever asks.
    """

    arguments: list[str]
    directory: str
    environment: dict[str, str]
    privileges: int
    streams: list[int]
    namespaces: list[int]

    @classmethod
    def read(cls, asked: socket.socket) -> Request:
        """Read a request; it is one line."""
        line, given, _, _ = socket.recv_fds(asked, 65536, 9)
        while not line.endswith(b"\n"):
            line += asked.recv(65536)
        return cls(**json.loads(line), streams=given[:3], namespaces=given[3:])


class Server:
    """A server that forks adapters, kills those whose requester has ended, and reports how they ended."""

    def __init__(self, path: str) -> None:
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(path)
        self._listener.listen()
        self._selector = selectors.DefaultSelector()
        self._running: set[Adapter] = set()

    def serve(self) -> Request | None:
        """Serve until standard input ends, and return None; in a forked process, return what it is to run."""
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._selector.register(0, selectors.EVENT_READ)
        while True:
            for key, _ in self._selector.select():
                if key.fileobj is self._listener:
                    request = self._fork()
                    if request is not None:
                        return request
                elif key.data is None:
                    self._end()
                    return None
                # The handle and the connection may both have become readable, so the adapter may be finished already.
                elif key.data in self._running:
                    self._finish(key.data)

    def _fork(self) -> Request | None:
        asked, _ = self._listener.accept()
        request = Request.read(asked)
        # A lock that another thread holds would never be released in the forked process.
        assert threading.active_count() == 1
        process = os.fork()
        # Both processes do this, as either may come first; a new session could not be made from outside.
        os.setpgid(process, process)
        if process == 0:
            return request
        for descriptor in (*request.streams, *request.namespaces):
            os.close(descriptor)
        adapter = Adapter(process=process, handle=os.pidfd_open(process), asked=asked)
        self._selector.register(adapter.handle, selectors.EVENT_READ, adapter)
        self._selector.register(adapter.asked, selectors.EVENT_READ, adapter)
        self._running.add(adapter)
        return None

    def _finish(self, adapter: Adapter) -> None:
        """Kill what is left of the adapter's group and report how the adapter ended."""
        self._running.remove(adapter)
        self._selector.unregister(adapter.handle)
        self._selector.unregister(adapter.asked)
        os.close(adapter.handle)
        # The process has not been waited for yet, so its number has not been reused.
        os.killpg(adapter.process, signal.SIGKILL)
        _, status = os.waitpid(adapter.process, 0)
        with adapter.asked:
            try:
                adapter.asked.sendall(b"%d\n" % os.waitstatus_to_exitcode(status))
            except BrokenPipeError:
                return

    def _end(self) -> None:
        for adapter in [*self._running]:
            self._finish(adapter)


def become(request: Request) -> NoReturn:
    """Run the requested program in the process that was forked for it, and end this process."""
    code: Any = 1
    try:
        move(request.namespaces, request.privileges)
        run(request)
        code = 0
    except SystemExit as end:
        code = end.code
    except BaseException:
        traceback.print_exc()
    finally:
        # The other steps of a usual end touch everything that was imported, and each page of it has a cost.
        atexit._run_exitfuncs()
        if not isinstance(code, int | None):
            print(code, file=sys.stderr)
            code = 1
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code or 0)


def move(namespaces: list[int], privileges: int) -> None:
    """Go where the process is that has asked, with the privileges that it has there; this one stays above, waits for the end and has its exit code."""
    kinds = ("user", "net", "mnt", "ipc", "uts", "pid")
    others = [
        descriptor
        for kind, descriptor in zip(kinds, namespaces, strict=True)
        if os.fstat(descriptor).st_ino != os.stat(f"/proc/self/ns/{kind}").st_ino
    ]
    if not others:
        return
    libc = ctypes.CDLL(None, use_errno=True)
    for descriptor in others:
        if libc.setns(descriptor, 0) != 0:
            raise OSError(ctypes.get_errno(), "the walls of the adapter cannot be entered")
    if (process := os.fork()) != 0:
        _, status = os.waitpid(process, 0)
        code = os.waitstatus_to_exitcode(status)
        os._exit(code if code >= 0 else 128 - code)
    # prctl(2), PR_SET_PDEATHSIG and PR_SET_NO_NEW_PRIVS; capset(2), of which version 3 has two words for each of three sets.
    libc.prctl(1, signal.SIGKILL)
    libc.prctl(38, 1, 0, 0, 0)
    low, high = privileges & 0xFFFFFFFF, privileges >> 32
    libc.capset(struct.pack("=Ii", 0x20080522, 0), struct.pack("=6I", low, low, low, high, high, high))
    for number in range(64):
        if privileges >> number & 1:
            # PR_CAP_AMBIENT, PR_CAP_AMBIENT_RAISE: what it starts has them as well.
            libc.prctl(47, ctypes.c_ulong(2), ctypes.c_ulong(number), 0, 0)


def run(request: Request) -> None:
    """Set up the process as it was asked for and run the program as ``__main__``."""
    for number, stream in enumerate(request.streams):
        os.dup2(stream, number)
    # These descriptors are the server's and the other adapters'.
    os.closerange(3, os.sysconf("SC_OPEN_MAX"))
    os.environ.clear()
    os.environ.update(request.environment)
    show_token(request.environment.get(TOKEN, ""))
    os.chdir(request.directory)
    gc.enable()
    sys.argv = [argument for argument in request.arguments if argument != "-P"]
    module = sys.argv.pop(0) if sys.argv[0] == "-m" else None
    # The first place to look for modules was the server's own directory until here.
    sys.path[:1] = [] if "-P" in request.arguments else [os.getcwd() if module else os.path.dirname(sys.argv[0])]
    if module:
        runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
    else:
        runpy.run_path(sys.argv[0], run_name="__main__")


def show_token(token: str) -> None:
    """Let the process show the token of its session as the others do, in the environment that it was started with.

    That is memory of the process (proc_pid_stat(5), env_start), and a fork has what the server was started with.
    """
    with open("/proc/self/stat", encoding="utf-8") as file:
        begin, end = (int(field) for field in file.read().rpartition(")")[2].split()[47:49])
    at = ctypes.string_at(begin, end - begin).index(f"{TOKEN}=".encode()) + len(TOKEN) + 1
    ctypes.memmove(begin + at, token.ljust(TOKEN_LETTERS)[:TOKEN_LETTERS].encode(), TOKEN_LETTERS)


def main() -> None:
    """Import, serve, and run the requested program."""
    # The adapters set this themselves, too.
    os.environ["PYDANTIC_DISABLE_PLUGINS"] = "__all__"
    gc.disable()
    server = Server(sys.argv[1])
    # Requests wait until everything is imported.
    print("listening", flush=True)
    for name in sys.argv[2:]:
        import_module(name)
    gc.freeze()
    request = server.serve()
    if request is not None:
        become(request)


if __name__ == "__main__":
    main()
