"""The keeper of the kit's processes: it starts adapters, and sees to it that nothing that comes of one outlives it.

A child may leave its process group and its session, lose its parents and clear its environment; only the kernel knows then what it
descends from, and hands it to the next ancestor that takes such orphans (PR_SET_CHILD_SUBREAPER, prctl(2)). So each adapter has a
*watcher* above it that does: whatever descends from the adapter descends from the watcher, and nothing else does. The kit
cannot be that ancestor itself: pytest hosts other people's processes. The keeper forks the watchers, in a millisecond each.

The keeper is run as a program of the standard library alone. It reads from a socket: for each adapter a byte ``W`` with four file
descriptors, which are a socket for the adapter's watcher and the adapter's standard streams; and a byte ``S`` when a watcher has
ended that should not have: whatever has no watcher is killed then. A keeper that is told to build walls (see ``walls``) answers first, with
a line that says which of them the machine refuses, and with descriptors of a user namespace, of the adapters' one below it where there is a cable, of
a network namespace, and of a socket for sockets of that network.

The kit writes to the watcher a line with ``{"command", "env", "cwd", "network", "raw", "view"}``, then single bytes, and reads lines.
``network`` tells whether the adapter is put into the network of its own, ``raw`` whether it may open packet sockets there, ``view`` which paths the walls leave open to it: a process
between watcher and adapter is then the first of a namespace of processes, and when that is killed, the kernel kills all others.
A line with ``{"layers", "cwd"}`` asks whether the machine allows such walls where nothing else is open; the answer is ``{"refused"}``, null if it
does.

=====================  ==========================================================================================
``{"pid", "root", "watcher", "namespaces"}``
                        the adapter runs; all that descends from ``root`` is the adapter or comes of it
``{"failed"}``          number of the error for which it does not; the watcher ends
``{"refused"}``         number of an error and the wall for which it does not; the watcher ends
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
import resource
import select
import signal
import socket
import sys
import time
from collections.abc import Collection
from typing import Any, NoReturn

from . import walls

__all__ = ["die_with_parent", "hide_memory"]

_SET_PDEATHSIG = 1
_SET_DUMPABLE = 4
_SET_CHILD_SUBREAPER = 36
_HANDLED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGCHLD, signal.SIGPIPE, signal.SIGXFSZ)
_MOST_TOLD = 20
_HUNT_S = 15.0
"""Seconds for which processes are killed that do not end; the kit waits longer than that for a watcher."""
_LOOK_S = 0.2
"""Seconds between two looks at all processes while processes are killed."""
_PAUSE_S = 0.0005
"""Seconds until the numbers that were given meanwhile are looked at. The kernel reports no birth of a grandchild that could be waited for."""


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


def _kill_descendants(besides: Collection[int] = (), unnamed: Collection[int] = (), first: int = 0) -> list[str]:
    """Kill all descendants, also those that appear meanwhile, until none is left or :data:`_HUNT_S` have passed.

    A look at all processes takes ten milliseconds, so one that forks and ends again and again is never met by it. Between two such looks
    only those are looked at whose numbers were given meanwhile.

    Args:
        besides: children that are left alone with all that descends from them.
        unnamed: processes that are killed like the others, and expected.
        first: a child to be killed before all others: with the first process of a namespace the kernel kills the rest.

    Returns:
        The names of what there was.
    """
    names: set[str] = set()
    until = time.monotonic() + _HUNT_S
    newest, looked = 0, 0.0
    if first:
        look = _Look()
        names = {name for number in _numbers() if number not in unnamed and (name := look.name(number, besides))}
        with contextlib.suppress(OSError):
            os.kill(first, signal.SIGKILL)
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
                names |= set() if number in unnamed else {name}
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

    def __init__(self, kit: socket.socket, streams: list[int], network: int | None) -> None:
        self._kit = kit
        self._streams = streams
        self._network = network
        self._told, self._tells = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._told.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
        self._pid = 0
        self._root = 0
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
        if not request:
            return
        asked = json.loads(request)
        if "layers" in asked:
            self.say(refused=_tried(**asked))
            return
        if not self._start(**asked):
            return
        watched: list[Any] = [self._kit, wake, self._told]
        while True:
            ready, _, _ = select.select(watched, [], [])
            if self._told in ready and not self._hear():
                watched.remove(self._told)
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

    def _start(self, network: bool, view: dict[str, Any] | None, **adapter: Any) -> bool:
        failed, fail = os.pipe()
        try:
            if network:
                assert self._network is not None
                walls.join(self._network, walls.NEW_NETWORK)
            if view is not None:
                walls.unshare(walls.NEW_PROCESSES, "a process namespace")
        except walls.RefusedError as error:
            # It was tried before the first adapter was started: what is in the way now is no rule of the machine's.
            self.say(failed=error.errno, of="machine")
            return False
        self._root = os.fork()
        if self._root == 0:
            signal.set_wakeup_fd(-1)
            for number in _HANDLED:
                signal.signal(number, signal.SIG_DFL)
            if view is not None:
                self._be_first(fail, view, network=network, **adapter)
            self._become_adapter(fail, walled=network, network=network, **adapter)
        self._running = True
        self._tells.close()
        for descriptor in (fail, *self._streams):
            os.close(descriptor)
        with open(failed, "rb") as file:
            reason = file.read()
        if reason:
            os.waitpid(self._root, 0)
            self.say(**json.loads(reason))
            return False
        namespaces, ancillary, _, _ = self._told.recvmsg(256, socket.CMSG_SPACE(12))
        # The kernel says which process wrote this, by the number that it has here.
        (self._pid,) = (int.from_bytes(data[:4], sys.byteorder) for _, _, data in ancillary)
        root = os.getpid() if view is None else self._root
        self.say(pid=self._pid, root=root, watcher=os.getpid(), namespaces=json.loads(namespaces))
        return True

    def _be_first(self, fail: int, view: dict[str, Any], **adapter: Any) -> NoReturn:
        """Be the first process of its namespace: whatever loses its parent becomes this one's child."""
        try:
            die_with_parent()
            try:
                os.stat(adapter["cwd"])
            except OSError as error:
                _fail(fail, failed=error.errno)
            try:
                walls.enclose(**view, cwd=adapter["cwd"])
            except OSError as error:
                _fail(fail, refused=_refusal(error))
            if (number := os.fork()) == 0:
                self._become_adapter(fail, walled=True, **adapter)
            for descriptor in (fail, *self._streams, self._kit.fileno()):
                os.close(descriptor)
            with contextlib.suppress(ChildProcessError):
                while True:
                    ended, status = os.waitpid(-1, 0)
                    if ended == number:
                        self._tells.send(json.dumps(os.waitstatus_to_exitcode(status)).encode())
        finally:
            os._exit(0)

    def _become_adapter(
        self, fail: int, walled: bool, network: bool, raw: bool, command: list[str], env: dict[str, str], cwd: str
    ) -> NoReturn:
        try:
            os.setsid()
            die_with_parent()
            self._tells.send(json.dumps({kind: _namespace(kind) for kind in ("net", "pid", "mnt")}).encode())
            for target, descriptor in enumerate(self._streams):
                os.dup2(descriptor, target)
            os.chdir(cwd)
            if walled:
                # It must be so before the filter forbids to change it (core(5)). A hard limit of 0 cannot be raised.
                with contextlib.suppress(ValueError):
                    resource.setrlimit(resource.RLIMIT_CORE, (1, 1))
                walls.give_up_privileges(raw=raw)
                walls.filter_calls(network=network)
            os.execvpe(command[0], command, env)  # noqa: S606
        except OSError as error:
            _fail(fail, failed=error.errno)
        finally:
            os._exit(255)

    def _hear(self) -> bool:
        """Tell the kit of the adapter's end, if the first process of its namespace says so; return whether it may say more."""
        try:
            said = self._told.recv(256, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return True
        if said:
            self._running = False
            self.say(exit=json.loads(said))
        return bool(said)

    def _reap(self) -> None:
        while True:
            try:
                number, status = os.waitpid(-1, os.WNOHANG)
            except ChildProcessError:
                if not self._told_empty:
                    self._told_empty = True
                    self._hear()
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
        self.say(left=_kill_descendants(unnamed=(self._pid, self._root), first=self._root)[:_MOST_TOLD])
        return False


def _namespace(kind: str) -> int:
    return os.stat(f"/proc/self/ns/{kind}").st_ino


def _refusal(error: OSError) -> list[Any]:
    return [error.errno, getattr(error, "step", "a view of the machine of its own")]


def _fail(fail: int, **event: object) -> NoReturn:
    os.write(fail, json.dumps(event).encode())
    os._exit(255)


def _build(kit: socket.socket, cwd: str, *, cable: bool) -> tuple[int | None, set[int]]:
    """Build the walls that are the same for all adapters, try the others, and tell the kit what the machine refuses.

    Args:
        cable: adapters get a user namespace below that of their device, whose network they would set up as well otherwise.

    Returns:
        The network namespace, None where there is none, and the numbers of the processes that must stay.
    """
    refused: dict[str, Any] = {}
    given: list[int] = []
    hand = users = 0
    try:
        for _ in range(1 + cable):
            walls.enter_user()
            given.append(os.open("/proc/self/ns/user", os.O_RDONLY | os.O_CLOEXEC))
        users = len(given)
        walls.forbid_users()
    except walls.RefusedError as error:
        given = []
        refused = dict.fromkeys(("network", "view"), _refusal(error))
    else:
        ours, theirs = socket.socketpair()
        if (hand := os.fork()) == 0:
            ours.close()
            _be_hand(theirs)
        theirs.close()
        said, descriptors = walls.received(ours, 256, 1)
        if descriptors:
            given += [*descriptors, ours.detach()]
        else:
            refused["network"] = json.loads(said)
        if (why := _tried([cwd] if cwd != "/" else [], cwd)) is not None:
            refused["view"] = why
    socket.send_fds(kit, [json.dumps(refused).encode() + b"\n"], given)
    kept = given[users] if len(given) > users else None
    for descriptor in given:
        if descriptor != kept:
            os.close(descriptor)
    return kept, {hand}


def _be_hand(asked: socket.socket) -> NoReturn:
    """Make the network namespace and stay in it, as the hand by which the kit gets sockets there, until the kit lets go of it."""
    try:
        walls.enter_network()
        descriptor = os.open("/proc/self/ns/net", os.O_RDONLY | os.O_CLOEXEC)
        socket.send_fds(asked, [b"[]"], [descriptor])
        os.close(descriptor)
        walls.serve_sockets(asked)
    except walls.RefusedError as error:
        asked.sendall(json.dumps(_refusal(error)).encode())
    finally:
        os._exit(0)


def _tried(layers: list[str], cwd: str) -> Any:
    """Try the walls of an adapter that nothing else is open to; return what the machine refuses, or None."""
    failed, fail = os.pipe()
    if (trying := os.fork()) == 0:
        try:
            walls.unshare(walls.NEW_PROCESSES, "a process namespace")
            if (first := os.fork()) == 0:
                walls.enclose(reads=[], needed=[], writes=[], layers=layers, cwd=cwd)
            else:
                os.waitpid(first, 0)
        except OSError as error:
            os.write(fail, json.dumps(_refusal(error)).encode())
        finally:
            os._exit(0)
    os.close(fail)
    with open(failed, "rb") as file:
        why = file.read()
    os.waitpid(trying, 0)
    return json.loads(why) if why else None


def _keep(kit: socket.socket, parent: int, network: int | None, staying: set[int]) -> None:
    """Fork a watcher for each request, until the kit has ended or has closed the socket."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        # Ctrl-C is for the kit, which then ends adapters one by one.
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    watched: list[Any] = [kit, parent]
    watchers = staying
    while True:
        ready, _, _ = select.select(watched, [], [])
        if parent in ready:
            return
        word, descriptors = walls.received(kit, 1, 4)
        if not word:
            return
        if word == b"S":
            # What an adapter leaves that has killed its own watcher has become the keeper's.
            _kill_descendants(besides=watchers)
        if len(descriptors) == 4:
            watchers.add(_fork_watcher(kit, parent, descriptors, network))
        for descriptor in descriptors:
            os.close(descriptor)


def _fork_watcher(kit: socket.socket, parent: int, descriptors: list[int], network: int | None) -> int:
    """Fork the watcher of an adapter; return its number, 0 if there is none."""
    told = socket.socket(fileno=os.dup(descriptors[0]))
    number = 0
    try:
        if (number := os.fork()) == 0:
            kit.close()
            os.close(parent)
            try:
                _Watcher(told, descriptors[1:], network).watch()
            finally:
                _kill_descendants()
                os._exit(0)
    except OSError as error:
        told.sendall(json.dumps({"failed": error.errno, "of": "machine"}).encode() + b"\n")
    told.close()
    return number


def main() -> None:
    """Serve the kit, whose socket and process (pidfd_open(2)) are the first two descriptors that the command line names.

    A third word asks for walls: ``build`` for new ones, tried in the directory that follows, and after it ``cable`` for those of a cable; or descriptors of the
    adapters' user namespace, and the network namespace if there is one, that an earlier keeper has built.
    """
    # A fork copies what the collector touches.
    gc.disable()
    kit, parent = socket.socket(fileno=int(sys.argv[1])), int(sys.argv[2])
    network, staying = None, set[int]()
    _prctl(_SET_CHILD_SUBREAPER, 1)
    if sys.argv[3:4] == ["build"]:
        network, staying = _build(kit, sys.argv[4], cable=sys.argv[5:] == ["cable"])
    elif sys.argv[3:]:
        user, *others = map(int, sys.argv[3:])
        walls.join(user, walls.NEW_USER)
        os.close(user)
        for network in others:
            os.set_inheritable(network, False)
    # Who hides its memory cannot say any more who it is in a user namespace.
    hide_memory()
    _keep(kit, parent, network, staying)
    _kill_descendants()


if __name__ == "__main__":
    main()
