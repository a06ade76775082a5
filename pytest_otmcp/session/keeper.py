"""The keeper of the kit's processes: it starts adapters, and sees to it that nothing that comes of one outlives it.

A child may leave its process group and its session, lose its parents and clear its environment; only the kernel knows then what it
descends from, and hands it to the next ancestor that takes such orphans (PR_SET_CHILD_SUBREAPER, prctl(2)). So each adapter has a
*watcher* above it that does: whatever descends from the adapter descends from the watcher, and nothing else does. The kit
cannot be that ancestor itself: pytest hosts other people's processes. The keeper forks the watchers, in a millisecond each.

The keeper is run as a program of the standard library alone. It reads from a socket: for each adapter a byte ``W`` with four file
descriptors, which are a socket for the adapter's watcher and the adapter's standard streams; and a byte ``S`` when a watcher has
ended that should not have: whatever has no watcher is killed then. The kit writes to the watcher a line with
``{"command", "env", "cwd"}``, then single bytes, and reads lines:

=====================  ==========================================================================================
``{"pid", "watcher"}``  the adapter runs
``{"failed"}``          number of the error for which it does not; the watcher ends
``{"exit"}``            the adapter has ended, with this code as :mod:`subprocess` has it
``{"empty"}``           nothing of it is left
``T``                   send SIGTERM to the adapter's process group
``K``                   kill all that is left, and end; ``{"left": [name, ...]}`` tells what there was
=====================  ==========================================================================================

When the kit ends, however it ends, everything is killed.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import json
import os
import select
import signal
import socket
import sys
import time
from collections.abc import Collection
from typing import Any, NoReturn

__all__ = ["die_with_parent", "hide_memory"]

_SET_PDEATHSIG = 1
_SET_DUMPABLE = 4
_SET_CHILD_SUBREAPER = 36
_HANDLED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGCHLD, signal.SIGPIPE, signal.SIGXFSZ)
_MOST_TOLD = 20
_HUNT_S = 15.0
"""Seconds for which processes are killed that do not end; the kit waits longer than that for a watcher."""
_LOOK_S = 0.2
_PAUSE_S = 0.0005


_libc = ctypes.CDLL(None)


def _prctl(option: int, value: int) -> None:
    _libc.prctl(option, ctypes.c_ulong(value), 0, 0, 0)


def die_with_parent() -> None:
    """Have this process killed when the thread that started it ends, however that happens."""
    _prctl(_SET_PDEATHSIG, signal.SIGKILL)


def hide_memory() -> None:
    """Keep other processes of the same user from reading or changing the memory of this one, and from reading its
    environment. A process that may trace every other one, such as root's, still can."""
    _prctl(_SET_DUMPABLE, 0)


def _stat(number: int) -> tuple[int, str, str] | None:
    """Return the parent of a process, its state and its name (proc_pid_stat(5)); None if there is none of this number."""
    try:
        with open(f"/proc/{number}/stat", encoding="utf-8", errors="replace") as file:
            head, _, rest = file.read().rpartition(")")
    except OSError:
        return None
    state, parent = rest.split()[:2]
    return int(parent), state, head.partition("(")[2]


class _Look:
    """A look at processes: each is read once, however many descend from it."""

    def __init__(self) -> None:
        self._seen: dict[int, tuple[int, str, str] | None] = {}

    def name(self, number: int, besides: Collection[int]) -> str | None:
        """Return the name of a process that runs and descends from this one; None for any other.

        Args:
            number: of the process.
            besides: neither these count nor what descends from them.
        """
        found = self._stat(number)
        if found is None or found[1] in "ZX":
            return None
        above: set[int] = set()
        while number not in above and number not in besides:
            above.add(number)
            if (stat := self._stat(number)) is None:
                return None
            number = stat[0]
            if number == os.getpid():
                return found[2]
        return None

    def _stat(self, number: int) -> tuple[int, str, str] | None:
        if number not in self._seen:
            self._seen[number] = _stat(number)
        return self._seen[number]


def _numbers() -> list[int]:
    """Return the numbers of all processes, the youngest first: one that does not live long is looked at at once."""
    return sorted((int(entry) for entry in os.listdir("/proc") if entry.isdigit()), reverse=True)


def _newest() -> int:
    """Return the number that a process was given last (proc_loadavg(5))."""
    with open("/proc/loadavg", encoding="ascii") as file:
        return int(file.read().split()[-1])


def _kill_descendants(besides: Collection[int] = ()) -> list[str]:
    """Kill all descendants, also those that appear meanwhile, until none is left or :data:`_HUNT_S` have passed.

    A look at all processes takes ten milliseconds, so one that forks and ends again and again is never met by it. Between two such looks
    only those are looked at whose numbers were given meanwhile.

    Args:
        besides: children that are left alone with all that descends from them.

    Returns:
        The names of what there was.
    """
    names: set[str] = set()
    until = time.monotonic() + _HUNT_S
    newest, looked = 0, 0.0
    while _has_children() and (now := time.monotonic()) < until:
        before, newest = newest, _newest()
        # Numbers begin again at the lowest when the highest was given.
        if whole := now > looked + _LOOK_S or newest < before:
            numbers, looked = _numbers(), now
        else:
            numbers = list(range(newest, before, -1))
        look, met = _Look(), False
        for number in numbers:
            if (name := look.name(number, besides)) is not None:
                names.add(name)
                met = True
                with contextlib.suppress(OSError):
                    os.kill(number, signal.SIGKILL)
        if whole and besides and not met:
            break
        if not met:
            time.sleep(_PAUSE_S)
    return sorted(names)


def _has_children() -> bool:
    """Tell whether this process has a child, dead ones not counted."""
    try:
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass
    except ChildProcessError:
        return False
    return True


class _Watcher:
    """The process above one adapter."""

    def __init__(self, kit: socket.socket, streams: list[int]) -> None:
        self._kit = kit
        self._streams = streams
        self._pid = 0
        self._running = False
        self._told_empty = False

    def say(self, **event: object) -> None:
        with contextlib.suppress(OSError):
            # The kit has gone, which is noticed soon.
            self._kit.sendall(json.dumps(event).encode() + b"\n")

    def watch(self) -> None:
        """Start the adapter and stay until all is over."""
        _prctl(_SET_CHILD_SUBREAPER, 1)
        wake, woken = os.pipe()
        os.set_blocking(woken, False)
        signal.signal(signal.SIGCHLD, lambda number, frame: None)
        signal.set_wakeup_fd(woken, warn_on_full_buffer=False)
        with self._kit.makefile("rb") as lines:
            request = lines.readline()
        if not request or not self._start(json.loads(request)):
            return
        watched: list[Any] = [self._kit, wake]
        while True:
            ready, _, _ = select.select(watched, [], [])
            if wake in ready:
                os.read(wake, 4096)
                self._reap()
            if self._kit in ready and not self._obey(self._received()):
                return

    def _received(self) -> bytes:
        try:
            return self._kit.recv(1)
        except OSError:
            return b""

    def _start(self, request: dict[str, object]) -> bool:
        failed, fail = os.pipe()
        self._pid = os.fork()
        if self._pid == 0:
            self._become_adapter(fail, **request)  # type: ignore[arg-type]
        self._running = True
        for descriptor in (fail, *self._streams):
            os.close(descriptor)
        if reason := os.read(failed, 16):
            os.waitpid(self._pid, 0)
            self.say(failed=int(reason))
            return False
        os.close(failed)
        self.say(pid=self._pid, watcher=os.getpid())
        return True

    def _become_adapter(self, fail: int, command: list[str], env: dict[str, str], cwd: str) -> NoReturn:
        try:
            os.setsid()
            die_with_parent()
            signal.set_wakeup_fd(-1)
            for number in _HANDLED:
                signal.signal(number, signal.SIG_DFL)
            for target, descriptor in enumerate(self._streams):
                os.dup2(descriptor, target)
            os.chdir(cwd)
            os.execvpe(command[0], command, env)  # noqa: S606
        except OSError as error:
            os.write(fail, str(error.errno).encode())
        finally:
            os._exit(255)

    def _reap(self) -> None:
        while True:
            try:
                number, status = os.waitpid(-1, os.WNOHANG)
            except ChildProcessError:
                if not self._told_empty:
                    self._told_empty = True
                    self.say(empty=True)
                return
            if number == 0:
                return
            if number == self._pid:
                self._running = False
                self.say(exit=os.waitstatus_to_exitcode(status))

    def _obey(self, word: bytes) -> bool:
        """Do what the kit asks for; return whether there is more to come."""
        if word == b"T":
            if self._running:
                with contextlib.suppress(OSError):
                    os.killpg(self._pid, signal.SIGTERM)
            return True
        self._reap()
        self.say(left=_kill_descendants()[:_MOST_TOLD])
        return False


def _keep(kit: socket.socket, parent: int) -> None:
    """Fork a watcher for each request, until the kit has ended or has closed the socket."""
    _prctl(_SET_CHILD_SUBREAPER, 1)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        # Ctrl-C is for the kit, which then ends adapters one by one.
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    watched: list[Any] = [kit, parent]
    watchers: set[int] = set()
    while True:
        ready, _, _ = select.select(watched, [], [])
        if parent in ready:
            return
        word, descriptors, _, _ = socket.recv_fds(kit, 1, 4, socket.MSG_CMSG_CLOEXEC)
        if not word:
            return
        if word == b"S":
            # What an adapter leaves that has killed its own watcher has become the keeper's.
            _kill_descendants(besides=watchers)
        if len(descriptors) == 4:
            watchers.add(_fork_watcher(kit, parent, descriptors))
        for descriptor in descriptors:
            os.close(descriptor)


def _fork_watcher(kit: socket.socket, parent: int, descriptors: list[int]) -> int:
    """Fork the watcher of an adapter; return its number, 0 if there is none."""
    told = socket.socket(fileno=os.dup(descriptors[0]))
    number = 0
    try:
        if (number := os.fork()) == 0:
            kit.close()
            os.close(parent)
            try:
                _Watcher(told, descriptors[1:]).watch()
            finally:
                _kill_descendants()
                os._exit(0)
    except OSError as error:
        told.sendall(json.dumps({"failed": error.errno, "of": "machine"}).encode() + b"\n")
    told.close()
    return number


def main() -> None:
    """Serve the kit, whose socket and process (pidfd_open(2)) are the two descriptors that the command line names."""
    hide_memory()
    # A fork copies what the collector touches.
    gc.disable()
    kit, parent = socket.socket(fileno=int(sys.argv[1])), int(sys.argv[2])
    _keep(kit, parent)
    _kill_descendants()


if __name__ == "__main__":
    main()
