"""The walls around an adapter, made of the kernel's namespaces (namespaces(7)) with what the system calls alone offer.

The standard library alone is imported here: the keeper (``keeper``) runs this, and a process that is to be walled in for the rest of its
life must not have a second thread. Nothing needs a privilege: a user namespace gives the one that is needed inside it
(user_namespaces(7)), and an adapter is started without it.
"""

from __future__ import annotations

import array
import ctypes
import errno
import fcntl
import os
import re
import resource
import socket
import stat
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

__all__ = [
    "NEW_NETWORK",
    "NEW_PROCESSES",
    "NEW_USER",
    "RefusedError",
    "enclose",
    "enter_network",
    "enter_user",
    "filter_calls",
    "forbid_users",
    "give_up_privileges",
    "join",
    "received",
    "serve_sockets",
    "unshare",
]

NEW_USER, NEW_PROCESSES, NEW_NETWORK = 0x10000000, 0x20000000, 0x40000000
_NEW_MOUNTS, _NEW_NAME, _NEW_IPC = 0x00020000, 0x04000000, 0x08000000

# mount(2), umount2(2), open_tree(2), move_mount(2), mount_setattr(2): the numbers of the last three are the same on every architecture
# of Linux but alpha.
_NOSUID, _NODEV, _NOEXEC, _BIND, _RECURSIVE, _PRIVATE, _DETACH = 0x2, 0x4, 0x8, 0x1000, 0x4000, 0x40000, 0x2
_OPEN_TREE, _MOVE_MOUNT, _MOUNT_SETATTR = 428, 429, 442
_AT_FDCWD, _AT_RECURSIVE, _AT_EMPTY_PATH, _FROM_EMPTY_PATH = -100, 0x8000, 0x1000, 0x4
_CLONE, _CLOEXEC = 0x1, os.O_CLOEXEC
_READ_ONLY, _NO_SETUID, _NO_DEVICES = 0x1, 0x2, 0x4
_MOUNT_READ_ONLY = 0x1

_NO_NEW_PRIVS, _DROP_FROM_BOUNDS, _AMBIENT, _RAISE = 38, 24, 47, 2
_OF_A_CABLE, _CAPABILITIES_3 = (12, 13), 0x20080522
"""CAP_NET_ADMIN, without which some libraries set no interface up, and CAP_NET_RAW."""
_GET_FLAGS, _SET_FLAGS, _UP = 0x8913, 0x8914, 0x1

_TEMPORARY = ("/tmp", "/var/tmp", "/run")  # noqa: S108
_NODES = ("null", "zero", "full", "random", "urandom", "tty")
_EMPTY = "/proc/empty"
_LINKS = {"fd": "/proc/self/fd", "stdin": "/proc/self/fd/0", "stdout": "/proc/self/fd/1", "stderr": "/proc/self/fd/2"}

_CALLS = {
    "x86_64": (0xC000003E, 41, 160, 302, (248, 249, 250, 321)),
    "aarch64": (0xC00000B7, 198, 164, 261, (217, 218, 219, 280)),
}
"""Machine to its architecture as filters know it, to its numbers of socket(2), setrlimit(2) and prlimit(2), and to those of add_key(2),
request_key(2), keyctl(2) and bpf(2)."""
_NEW_PROCESS, _RING = 435, 425
"""clone3(2) and io_uring_setup(2), which have the same number everywhere."""
_FAMILIES = (socket.AF_UNIX, socket.AF_INET, socket.AF_INET6, socket.AF_NETLINK, socket.AF_PACKET)
_SECCOMP, _FILTER = 22, 2

_libc = ctypes.CDLL(None, use_errno=True)


class RefusedError(OSError):
    """The machine refuses a wall.

    Attributes:
        step: what was refused.
    """

    def __init__(self, number: int, step: str) -> None:
        super().__init__(number, os.strerror(number), step)
        self.step = step


def _call(step: str, function: str, *arguments: object) -> int:
    """Call a function of the C library.

    Raises:
        RefusedError: it failed.
    """
    result: int = getattr(_libc, function)(*arguments)
    if result < 0:
        raise RefusedError(ctypes.get_errno(), step)
    return result


def unshare(flags: int, step: str) -> None:
    """Leave a namespace for a new one; of processes, the next child does.

    Raises:
        RefusedError: the machine refuses ``step``.
    """
    _call(step, "unshare", flags)


def join(namespace: int, kind: int) -> None:
    """Enter a namespace that a descriptor stands for.

    Raises:
        RefusedError: this process may not.
    """
    _call("entering a namespace", "setns", namespace, kind)


# -- user and network -----------------------------------------------------------------------------------------------


def enter_user() -> None:
    """Enter a user namespace of one's own, as who one is. This process must have one thread.

    Raises:
        RefusedError: the machine does not let this user have one.
    """
    user, group = os.geteuid(), os.getegid()
    unshare(NEW_USER, "a user namespace")
    for name, line in (("setgroups", "deny"), ("uid_map", f"{user} {user} 1"), ("gid_map", f"{group} {group} 1")):
        try:
            with open(f"/proc/self/{name}", "w", encoding="ascii") as file:
                file.write(line)
        except OSError as error:
            raise RefusedError(error.errno or 0, "a user namespace") from None


def forbid_users() -> None:
    """Have nothing in this user namespace make another one, in which it would have every privilege: over the control groups of the machine, for one.

    Raises:
        RefusedError: the machine refuses.
    """
    try:
        with open("/proc/sys/user/max_user_namespaces", "w", encoding="ascii") as file:
            file.write("0")
    except OSError as error:
        raise RefusedError(error.errno or 0, "a limit of user namespaces") from None


def enter_network() -> None:
    """Enter a network namespace of one's own, in which there is loopback and nothing else.

    Raises:
        RefusedError: the machine refuses.
    """
    unshare(NEW_NETWORK, "a network namespace")
    request = struct.Struct("16sh14x")
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
            answer = fcntl.ioctl(any_socket, _GET_FLAGS, request.pack(b"lo", 0))
            fcntl.ioctl(any_socket, _SET_FLAGS, request.pack(b"lo", request.unpack(answer)[1] | _UP))
    except OSError as error:
        raise RefusedError(error.errno or 0, "loopback in a network namespace") from None


def serve_sockets(asked: socket.socket) -> None:
    """Make sockets of this process's network for another process: it sends address family and type, a byte each, and is sent the socket."""
    while wanted := asked.recv(2, socket.MSG_WAITALL):
        try:
            with socket.socket(*wanted) as made:
                socket.send_fds(asked, [b"\0"], [made.fileno()])
        except OSError as error:
            asked.sendall(bytes([error.errno or 255]))


def received(channel: socket.socket, size: int, most: int) -> tuple[bytes, list[int]]:
    """Return what was sent, and the descriptors with it, which no program inherits: Python's own ``recv_fds`` ignores the flag for that."""
    descriptors = array.array("i")
    data, ancillary, _, _ = channel.recvmsg(size, socket.CMSG_LEN(most * descriptors.itemsize), socket.MSG_CMSG_CLOEXEC)
    for level, kind, content in ancillary:
        if level == socket.SOL_SOCKET and kind == socket.SCM_RIGHTS:
            descriptors.frombytes(content[: len(content) - len(content) % descriptors.itemsize])
    return data, list(descriptors)


# -- processes and files --------------------------------------------------------------------------------------------


def enclose(
    *, reads: Sequence[str], needed: Sequence[str], writes: Sequence[str], layers: Sequence[str], cwd: str
) -> None:
    """Give this process, the first of a new namespace of processes, a view of the machine of its own.

    Files are read-only. ``/tmp`` and its like, ``/run`` and ``/dev`` are its own and all but empty. Elsewhere pipes, Unix sockets and devices
    are there by name and lead nowhere: an overlay has such files of its own (Documentation/filesystems/overlayfs.rst).

    Args:
        reads: paths that can be read although they lie in a folder that is its own; devices, pipes and sockets among them can be used.
        needed: folders that can be read although they lie in such a folder; what is special in them leads nowhere.
        writes: paths that are written to for good.
        layers: folders in which what is written lies above what is there, and ends with the processes.
        cwd: its working directory.

    Raises:
        RefusedError: the machine refuses a step.
    """
    unshare(_NEW_MOUNTS | _NEW_IPC | _NEW_NAME, "a mount namespace")
    _mount("none", "/", "", _RECURSIVE | _PRIVATE)
    nodes = {f"/dev/{name}": _held(f"/dev/{name}") for name in _NODES}
    mounted = [*_mounts()]
    seen = {path: _held(path) for path in dict.fromkeys((*reads, *needed, *writes, *layers))}
    # The machine lets this be done as long as nothing covers a part of its own /proc.
    _mount("proc", "/proc", "proc", _NOSUID | _NODEV | _NOEXEC)
    _set_flags("/", _READ_ONLY | _NO_SETUID | _NO_DEVICES)
    if os.geteuid() != 0:
        # Programs name their threads there; root would change settings and modes that are the whole machine's.
        _set_flags("/proc", 0, cleared=_READ_ONLY, recursive=False)
    _veil(mounted, needed=(*seen, os.path.realpath(cwd)))
    _cover_folders()
    for path in sorted(seen, key=lambda one: one.count("/")):
        if path not in writes:
            _set_flags("", _READ_ONLY | _NO_SETUID, at=seen[path])
        _place(seen[path], path)
        if path in needed and path not in layers and os.path.isdir(path):
            with _empty_folder():
                _lay_nothing_over(path)
        if path in layers and not any(_is_below(path, folder) for folder in writes):
            try:
                _lay_over(path)
            except RefusedError:
                if path == os.path.realpath(cwd):
                    raise
                # What has been placed here would uncover the special files in it.
                _call("the end of a mount", "umount2", os.fsencode(path), _DETACH)
        os.close(seen[path])
    for path, tree in nodes.items():
        # Of such a file system the modes of a device cannot be changed, which are those of the machine's own; it is written to all the same.
        _set_flags("", _READ_ONLY | _NO_SETUID, at=tree)
        _place(tree, path)
        os.close(tree)
    os.chdir(cwd)


def filter_calls(*, network: bool) -> None:
    """Have this process, and all that comes of it, make no call for what namespaces do not hold (seccomp(2)).

    Keys (keyrings(7)) are those of whoever started the kit; bpf(2) opens what others have pinned; clone3(2) starts a process in any control
    group that can be written to, and libraries use clone(2) where it is missing. The machine's handler of crashes (core(5)) runs outside, and is not
    called as long as the limit of core dumps is exactly 1: whoever sets that limit is told that it was done, and it stays. Programs of another
    architecture are refused. On a machine whose calls are not known here, and by a kernel without filters, nothing is refused.

    Args:
        network: it makes sockets of the usual families alone, as it has a network of its own: ``AF_VSOCK`` reaches the host of a virtual machine.
            Rings of system calls (io_uring(7)) are refused, because they make sockets past the filter.
    """
    if (known := _CALLS.get(os.uname().machine)) is None:
        return
    architecture, socket_number, set_limit, limits, never = known
    load, equal, and_, answer = 0x20, 0x15, 0x54, 0x06
    allow, fails = 0x7FFF0000, 0x00050000
    refused = [*never, _NEW_PROCESS, *([_RING] if network else ())]
    # The second set of calls of x86-64 has the same numbers with a bit of its own.
    number = [(load, 0, 0, 0), (and_, 0, 0, 0xBFFFFFFF)]
    # Each step: code, steps to skip where it holds and where it does not, operand. Number and architecture of a call are at 0 and 4, its
    # arguments of 8 bytes at 16 and beyond.
    steps = [
        (load, 0, 0, 4),
        (equal, 1, 0, architecture),
        (answer, 0, 0, fails | errno.ENOSYS),
        *number,
        *(step for call in refused for step in ((equal, 0, 1, call), (answer, 0, 0, fails | errno.ENOSYS))),
        (equal, 0, 3, set_limit),
        (load, 0, 0, 16),
        (equal, 8, 0, resource.RLIMIT_CORE),
        (answer, 0, 0, allow),
        (equal, 0, 7, limits),
        (load, 0, 0, 24),
        (equal, 0, 5, resource.RLIMIT_CORE),
        # Who sets no limit gives no address of one.
        (load, 0, 0, 32),
        (equal, 0, 2, 0),
        (load, 0, 0, 36),
        (equal, 1, 0, 0),
        (answer, 0, 0, fails),
        *number,
    ]
    if network:
        steps += [
            (equal, 1, 0, socket_number),
            (answer, 0, 0, allow),
            (load, 0, 0, 16),
            *((equal, len(_FAMILIES) - index, 0, family) for index, family in enumerate(_FAMILIES)),
            (answer, 0, 0, fails | errno.EAFNOSUPPORT),
        ]
    steps.append((answer, 0, 0, allow))
    filters = ctypes.create_string_buffer(b"".join(struct.pack("=HBBI", *one) for one in steps))
    program = struct.pack("@HP", len(steps), ctypes.addressof(filters))
    _libc.prctl(_SECCOMP, ctypes.c_ulong(_FILTER), program, ctypes.c_ulong(0), ctypes.c_ulong(0))


def give_up_privileges(*, raw: bool = False) -> None:
    """Have what this process executes run without the privileges that it has in its namespaces, and never gain any (capabilities(7)).

    Args:
        raw: it keeps those of opening packet sockets and of setting interfaces up in its network, which holds nothing else.

    Raises:
        RefusedError: it would keep more.
    """
    _call("a program without new privileges", "prctl", _NO_NEW_PRIVS, ctypes.c_ulong(1), 0, 0, 0)
    for capability in range(64):
        # It fails beyond the last one that the kernel knows.
        if not (raw and capability in _OF_A_CABLE):
            _libc.prctl(_DROP_FROM_BOUNDS, ctypes.c_ulong(capability), 0, 0, 0)
    if raw:
        # An ordinary user's program has only what is handed on to it.
        own = sum(1 << capability for capability in _OF_A_CABLE)
        _call(
            "packet sockets",
            "capset",
            struct.pack("=Ii", _CAPABILITIES_3, 0),
            struct.pack("=6I", own, own, own, 0, 0, 0),
        )
        for capability in _OF_A_CABLE:
            _libc.prctl(_AMBIENT, ctypes.c_ulong(_RAISE), ctypes.c_ulong(capability), 0, 0)


def _is_below(path: str, folder: str) -> bool:
    return path == folder or path.startswith(folder.rstrip("/") + "/")


def _mount(source: str, target: str, kind: str, flags: int, options: str = "") -> None:
    arguments = [os.fsencode(text) for text in (source, target, kind)]
    _call(f"a mount on {target}", "mount", *arguments, ctypes.c_ulong(flags), os.fsencode(options) if options else None)


def _mounts() -> Iterator[str]:
    """Yield where something is mounted."""
    with open("/proc/self/mountinfo", "rb") as file:
        for line in file:
            # A blank in a path is told as \\040 (proc_pid_mountinfo(5)).
            place = re.sub(rb"\\([0-7]{3})", lambda octal: bytes([int(octal[1], 8)]), line.split(b" ")[4])
            yield os.fsdecode(place)


def _veil(mounted: Sequence[str], needed: Sequence[str]) -> None:
    """Lay an empty layer over each folder of the machine that is not the adapter's own.

    Args:
        mounted: where something is mounted. A layer would hide it, and the kernel lets nobody do that, so that folders above have layers over
            their parts.
        needed: paths that must stay visible; what cannot lie below a layer is covered otherwise.
    """
    pending = ["/"]
    with _empty_folder():
        while pending:
            try:
                pending += _veiled(pending.pop(), mounted, needed)
            except OSError as error:
                # What was there a moment ago may have been removed.
                if error.errno not in (errno.ENOENT, errno.ENOTDIR):
                    raise


@contextmanager
def _empty_folder() -> Iterator[None]:
    """Have a folder that is empty for ever as :data:`_EMPTY`: a layer holds it when no path leads to it any more. A folder that was removed is
    none that can be listed, and neither were the layer then."""
    _mount("tmpfs", "/proc", "tmpfs", _NOSUID | _NODEV, "mode=700")
    os.mkdir(_EMPTY)
    yield
    _call("the end of a mount", "umount2", b"/proc", _DETACH)


def _veiled(path: str, mounted: Sequence[str], needed: Sequence[str]) -> list[str]:
    """Lay an empty layer over a folder, or cover a special file; return the parts of a folder over which none can lie."""
    kind = os.lstat(path).st_mode
    if path in ("/dev", "/proc", "/sys", *_TEMPORARY) or stat.S_ISREG(kind) or stat.S_ISLNK(kind):
        return []
    if not stat.S_ISDIR(kind):
        _mount("/dev/null", path, "", _BIND)
    elif not os.access(path, os.X_OK):
        # Whoever may not enter a folder reaches nothing in it.
        pass
    elif any(one != path and _is_below(one, path) for one in mounted):
        return [os.path.join(path, name) for name in os.listdir(path)]
    else:
        try:
            _lay_nothing_over(path)
        except RefusedError:
            if any(_is_below(one, path) for one in needed):
                raise
            _mount("tmpfs", path, "tmpfs", _NOSUID | _NODEV | _MOUNT_READ_ONLY)
    return []


def _lay_nothing_over(path: str) -> None:
    os.chdir(path)
    try:
        # A path in the options would have to be escaped. Nothing is written here, so that no attributes of files are needed, and none are obeyed.
        _mount("overlay", path, "overlay", _NOSUID | _NODEV | _MOUNT_READ_ONLY, f"lowerdir=.:{_EMPTY}")
    finally:
        os.chdir("/")


def _held(path: str) -> int:
    """Return a descriptor of what is mounted at a path, which can be placed elsewhere when it is covered there."""
    flags = _CLONE | _CLOEXEC | _AT_RECURSIVE
    return _call(f"a copy of {path}", "syscall", _OPEN_TREE, _AT_FDCWD, os.fsencode(path), ctypes.c_uint(flags))


def _place(tree: int, path: str) -> None:
    """Mount what is held at its path, which is made where it is not there: on the folders above it that are the adapter's own."""
    if not os.path.lexists(path):
        os.makedirs(os.path.dirname(path), exist_ok=True)
        if stat.S_ISDIR(os.fstat(tree).st_mode):
            os.mkdir(path)
        else:
            os.close(os.open(path, os.O_CREAT | os.O_WRONLY | os.O_CLOEXEC, 0o600))
    _call(f"{path} in its place", "syscall", _MOVE_MOUNT, tree, b"", _AT_FDCWD, os.fsencode(path), _FROM_EMPTY_PATH)


def _set_flags(path: str, flags: int, *, cleared: int = 0, at: int = _AT_FDCWD, recursive: bool = True) -> None:
    attributes = struct.pack("=QQQQ", flags, cleared, 0, 0)
    how = (_AT_RECURSIVE if recursive else 0) | (0 if path else _AT_EMPTY_PATH)
    _call(
        f"read-only {path or 'folders'}",
        "syscall",
        _MOUNT_SETATTR,
        at,
        os.fsencode(path),
        how,
        attributes,
        len(attributes),
    )


def _cover_folders() -> None:
    """Cover the folders in which programs meet with empty ones, and ``/dev``."""
    covered: list[str] = []
    for path in dict.fromkeys((*_TEMPORARY, os.environ.get("TMPDIR", "/tmp"))):  # noqa: S108
        if any(_is_below(path, folder) for folder in covered):
            os.makedirs(path, exist_ok=True)
        elif os.path.isdir(path) and not os.path.islink(path):
            _mount("tmpfs", path, "tmpfs", _NOSUID | _NODEV, "mode=1777")
            covered.append(path)
    _mount("tmpfs", "/dev", "tmpfs", _NOSUID, "mode=755")
    for name, target in _LINKS.items():
        os.symlink(target, f"/dev/{name}")
    os.mkdir(shared := "/dev/shm")  # noqa: S108
    _mount("tmpfs", shared, "tmpfs", _NOSUID | _NODEV, "mode=1777")


def _lay_over(path: str) -> None:
    """Let what is written below a folder lie in memory, above what is there (Documentation/filesystems/overlayfs.rst)."""
    # What the layer needs is held by it, and need not stay visible.
    _mount("tmpfs", "/proc", "tmpfs", _NOSUID | _NODEV, "mode=700")
    os.mkdir("/proc/upper", os.stat(path).st_mode & 0o7777)
    os.mkdir("/proc/work")
    os.chdir(path)
    try:
        _mount(
            "overlay", path, "overlay", _NOSUID | _NODEV, "lowerdir=.,upperdir=/proc/upper,workdir=/proc/work,userxattr"
        )
    finally:
        os.chdir("/")
        _call("the end of a mount", "umount2", b"/proc", _DETACH)
