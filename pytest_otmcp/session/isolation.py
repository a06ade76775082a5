"""The isolation of the adapters that this process starts: which walls the machine allows, and which the kit saw stand.

The walls are built by the keeper (``keeper``, ``walls``). The kit itself stays outside, and so does whoever else lives in its process: a
user's own tests, other plugins. It speaks to its mock devices by Unix sockets, to adapters by pipes, and to those that serve HTTP by
sockets that were made inside.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import socket
import stat
import sys
import sysconfig
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..core.errors import KitError, UsageError
from ..core.text import one_line
from ..core.walls import AUTO, NETWORK, OFF, REQUIRE, WALLS, Wall
from .keeping import Keeper
from .walls import received

__all__ = ["Isolation", "Walls", "remedy"]

_FOLDERS = ("/tmp", "/var/tmp")  # noqa: S108  (not used: the adapter gets empty ones in their place)
_EXACT = ("/run/", "/dev/")
"""Folders that are the adapter's own: below the first ones all that lies beside a named path is needed, below the others that path alone."""
_KIT = Path(__file__).parents[2]
_OF_A_VIEW = tuple(wall for wall in WALLS if wall != NETWORK)
_FEW_STARTS = 4
_MOST_LINKS = 40
"""Links that the kernel follows in a path (path_resolution(7))."""
_OF_LAYERS = "user.overlay."
_ANSWER_BYTES = 4096
_PATIENCE_S = 60.0
"""A file system that does not answer must not hold up more than the walls."""

_REMEDIES = (
    (
        "kernel/apparmor_restrict_unprivileged_userns",
        "1",
        "`sudo sysctl kernel.apparmor_restrict_unprivileged_userns=0` allows it",
    ),
    ("kernel/unprivileged_userns_clone", "0", "`sudo sysctl kernel.unprivileged_userns_clone=1` allows it"),
    ("user/max_user_namespaces", "0", "`sudo sysctl user.max_user_namespaces=10000` allows it"),
)
"""Settings below ``/proc/sys``, the value by which each forbids namespaces, and what can be done."""


class Isolation:
    """The walls of all adapters that this process starts.

    Args:
        mode: one of :data:`~pytest_otmcp.core.walls.MODES`.
        cable: they are those of one cable.

    Attributes:
        keeper: starts adapters with walls.

    Raises:
        UsageError: walls are required, and the machine refuses one.
    """

    def __init__(self, mode: str = AUTO, *, cable: bool = False) -> None:
        self._mode = mode
        self._users = 1 + cable
        self._missing: dict[Wall, dict[str, None]] = {wall: {} for wall in WALLS}
        self._descriptors: list[int] = []
        self._view = self._used = False
        self._starts = 0
        self._code: frozenset[str] | None = None
        self._hand: socket.socket | None = None
        self._cables: list[Isolation] = []
        self.keeper = Keeper(self._words)
        if mode == OFF:
            self._miss(WALLS, "they were switched off")
        else:
            self._build()

    @property
    def _network(self) -> int | None:
        return self._descriptors[-1] if len(self._descriptors) > self._users else None

    def _words(self) -> tuple[Sequence[str], Sequence[int]]:
        if not self._descriptors:
            return ("build", os.getcwd(), *(["cable"] if self._users > 1 else [])), ()
        own = self._descriptors[self._users - 1 :]
        return [str(number) for number in own], own

    def _build(self) -> None:
        try:
            listening = self.keeper.start()
            listening.settimeout(_PATIENCE_S)
            said, given = received(listening, _ANSWER_BYTES, self._users + 2)
            listening.settimeout(None)
            refused = json.loads(said)
        except (OSError, ValueError) as error:
            given, refused = [], dict.fromkeys(("network", "view"), (0, f"the process that builds them ({error})"))
        self._descriptors = list(given[: self._users + 1])
        if len(given) > self._users + 1:
            self._hand = socket.socket(fileno=given[-1])
        self._view = "view" not in refused
        for wall in refused:
            if wall == "view" or not _alone():
                self.refused(wall, refused[wall])

    def refused(self, wall: str, why: Sequence[Any]) -> None:
        """Note that the machine refuses the network of its own, or the view of the machine (``view``).

        Raises:
            UsageError: the wall is required.
        """
        number, step = why
        told = f" ({os.strerror(number)})" if number else ""
        sentence = f"this machine refuses {step}{told}; {remedy()}"
        if self._mode == REQUIRE:
            raise UsageError(one_line(f"isolation is required, and {sentence}"))
        self._miss((NETWORK,) if wall == "network" else _OF_A_VIEW, sentence)

    def _miss(self, walls: Iterable[Wall], sentence: str) -> None:
        for wall in walls:
            self._missing[wall][sentence] = None

    def walls(self, *, outside: str = "", cable: bool = False) -> Walls | None:
        """Return the walls around a device's adapters; None where there are none.

        Args:
            outside: why these need the network of the machine; empty where they do not.
            cable: they reach the device by a cable, which needs a network of its own even where walls were switched off.
        """
        self._used = True
        if cable:
            return self._around_cable()
        if outside and self._network is not None:
            self._miss((NETWORK,), outside)
        network = self._network is not None and not outside
        return Walls(isolation=self, network=network) if network or self._view else None

    def _around_cable(self) -> Walls | None:
        """Return walls with a network for one cable alone: who may open packet sockets reads all that passes in a network."""
        own = Isolation(AUTO, cable=True)
        self._cables.append(own)
        if self._mode == OFF:
            own._view = False
        walls = own.walls()
        return replace(walls, raw=True) if walls is not None and walls.network else None

    def account(self) -> dict[Wall, str | None]:
        """Return for each wall None, if it stood around every adapter, or why it did not; nothing before the first adapter."""
        every = (self, *self._cables)
        return (
            {wall: "; ".join({why: None for one in every for why in one._missing[wall]}) or None for wall in WALLS}
            if self._used
            else {}
        )

    def close(self) -> None:
        """Give the namespaces up; they end with the processes in them."""
        for cable in self._cables:
            cable.close()
        self._cables = []
        self.keeper.close()
        if self._hand is not None:
            self._hand.close()
        for descriptor in self._descriptors:
            os.close(descriptor)
        self._descriptors = []

    # -- for walls ----------------------------------------------------------------------------------------------------

    def namespaces(self) -> tuple[int, int]:
        """Return descriptors of the devices' user namespace and of the network namespace."""
        return self._descriptors[0], self._descriptors[-1]

    def socket(self, kind: int, family: int = socket.AF_INET) -> socket.socket:
        """Return a new socket in the network of the run.

        Raises:
            OSError: none can be made.
        """
        assert self._hand is not None
        self._hand.sendall(bytes([family, kind]))
        said, given = received(self._hand, 1, 1)
        if not given:
            number = said[0] if said else 0
            raise OSError(number, os.strerror(number) if number else "the process that makes sockets has ended")
        return socket.socket(fileno=given[0])

    @property
    def has_view(self) -> bool:
        """Whether adapters have a view of the machine of their own."""
        return self._view and not self._missing[_OF_A_VIEW[0]]

    def code(self) -> frozenset[str]:
        """Return the folders of Python's own code that need no layer, because there is no special file in them.

        A layer over them costs each start of an adapter 40 ms, and to look through them once costs as much as four of those.
        """
        self._starts += 1
        if self._code is None and self._starts > _FEW_STARTS:
            named = {os.path.realpath(sysconfig.get_path(name)) for name in ("stdlib", "purelib", "platlib")}
            self._code = frozenset(folder for folder in named if _is_plain(folder))
        return self._code or frozenset()

    def saw(self, namespaces: Mapping[str, int], *, network: bool, view: bool) -> None:
        """Compare the namespaces of an adapter's process with those that it should have.

        Raises:
            KitError: a wall is not there.
        """
        own = {kind: os.stat(f"/proc/self/ns/{kind}").st_ino for kind in namespaces}
        wanted = {"net": network and self._network is not None, "pid": view, "mnt": view}
        missing = [kind for kind, wall in wanted.items() if wall and namespaces[kind] == own[kind]]
        if network and self._network is not None and namespaces["net"] != os.fstat(self._network).st_ino:
            missing.append("net")
        if missing:
            raise KitError(f"the adapter was started without a wall that it should have: {', '.join(missing)}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Walls:
    """The walls around one adapter, or around all of a device's.

    Attributes:
        isolation: has built them.
        network: the device and its adapters have the network of the run, and no other.
        raw: that network is theirs alone, and they may open packet sockets in it.
        reads, writes: paths that are open to the adapter, beside what it needs to start.
    """

    isolation: Isolation
    network: bool
    raw: bool = False
    reads: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()

    @property
    def keeper(self) -> Keeper:
        """Starts the adapter."""
        return self.isolation.keeper

    def refused(self, why: Sequence[Any]) -> None:
        """See :meth:`Isolation.refused`, of the view."""
        self.isolation.refused("view", why)

    def open_to(self, *, reads: Iterable[str], writes: Iterable[str]) -> Walls:
        """Return the walls with these paths left open."""
        return replace(self, reads=tuple(reads), writes=tuple(writes))

    def socket(self, kind: int, family: int = socket.AF_INET) -> socket.socket:
        """Return a new socket in the network in which the device and its adapters are.

        Raises:
            OSError: none can be made.
        """
        return self.isolation.socket(kind, family) if self.network else socket.socket(family, kind)

    def request(self, command: Sequence[str], env: Mapping[str, str], cwd: str) -> dict[str, Any]:
        """Return what the keeper is asked for: see ``keeper``."""
        view = self._view(command, env, cwd) if self.isolation.has_view else None
        return {"network": self.network, "raw": self.raw, "view": view}

    def bare(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return what the keeper is asked for to learn whether the machine allows such walls where nothing is open to the adapter."""
        written, cwd = request["view"]["writes"], request["cwd"]

        def is_open(path: str) -> bool:
            return any(_is_below(path, folder) for folder in written)

        layers = [path for path in request["view"]["layers"] if not is_open(path)]
        return {"layers": layers, "cwd": "/" if is_open(os.path.realpath(cwd)) else cwd}

    def _view(self, command: Sequence[str], env: Mapping[str, str], cwd: str) -> dict[str, list[str]]:
        written = {os.path.realpath(path) for path in self.writes}
        for path in written:
            _forget_layers(path)

        def places(paths: Iterable[str]) -> set[str]:
            """Return the places of paths that are there. Where the adapter may write it may have put a link to anything."""
            return {
                os.path.realpath(path) for path in paths if os.path.exists(path) and not _leads_through(path, written)
            }

        layers = places(path for path in (cwd, env.get("HOME", "")) if os.path.isdir(path)) - {"/"}
        # Who starts an adapter with a path that leads to a socket means it.
        meant = (word for word in command if word.startswith("/") and _is_socket(word))
        # What the adapter writes below its working directory is its own, code as well.
        code = (one for one in self.isolation.code() if not any(_is_below(one, layer) for layer in layers))
        devices, folders = _needed(command, env, cwd, written)
        reads = places((*self.reads, *meant, *devices, *code)) - written
        return {
            "reads": sorted(reads),
            "needed": sorted(places(folders) - written - reads),
            "writes": sorted(written),
            "layers": sorted(layers),
        }

    def saw(self, request: Mapping[str, Any], namespaces: Mapping[str, int]) -> None:
        """Make sure that the adapter that was started so is in the namespaces that it was to have.

        Raises:
            KitError: it is not.
        """
        self.isolation.saw(namespaces, network=self.network, view=request["view"] is not None)


def _needed(
    command: Sequence[str], env: Mapping[str, str], cwd: str, written: Collection[str]
) -> tuple[set[str], set[str]]:
    """Return the paths in folders that are the adapter's own which must be there nevertheless: its programs, and what its command names.

    Args:
        written: folders in which it may write.

    Returns:
        Paths that are opened as they are, and others, below which nothing special is opened.
    """
    exact, beside = set[str](), set[str]()
    texts = (*command, *(value for name, value in env.items() if name != "TMPDIR"))
    words = [word for text in texts for word in re.split("[=:,]", text)]
    program = shutil.which(command[0], path=env.get("PATH")) or command[0]
    own = sorted({*_FOLDERS, os.environ.get("TMPDIR", _FOLDERS[0])}, key=len, reverse=True)
    for word in (*words, program, cwd, sys.prefix, sys.base_prefix, str(_KIT), *sys.path):
        if not word.startswith("/") or _leads_through(word, written):
            continue
        for path in {word, os.path.realpath(word)}:
            folder = next((folder for folder in own if path.startswith(f"{folder}/")), None)
            if folder is not None:
                # A program needs what lies beside it, as an environment of Python's does.
                first = os.path.join(folder, path[len(folder) + 1 :].split("/")[0])
                if os.path.isdir(first) or os.path.isfile(first):
                    beside.add(first)
            elif path.startswith(_EXACT):
                exact.add(path)
    return exact, beside


def _forget_layers(path: str) -> None:
    """Remove the attributes by which an overlay knows its own files: below a layer they make a path be refused or lead elsewhere, and an
    adapter may give them to what it may write to."""
    with suppress(OSError):
        for name in os.listxattr(path, follow_symlinks=False):
            if name.startswith(_OF_LAYERS):
                os.removexattr(path, name, follow_symlinks=False)


def _is_below(path: str, folder: str) -> bool:
    return f"{path}/".startswith(f"{folder}/")


def _leads_through(path: str, folders: Collection[str]) -> bool:
    """Tell whether something in one of these folders decides where a path leads, link by link."""
    parts, at, links = path.split("/")[::-1], "/", 0
    while parts:
        part = parts.pop()
        if part in ("", "."):
            continue
        at = os.path.dirname(at) if part == ".." else os.path.join(at, part)
        if any(at != folder and _is_below(at, folder) for folder in folders):
            return True
        if os.path.islink(at):
            if (links := links + 1) > _MOST_LINKS:
                return True
            target = os.readlink(at)
            parts += target.split("/")[::-1]
            at = "/" if target.startswith("/") else os.path.dirname(at)
    return False


def _is_plain(folder: str) -> bool:
    """Tell whether there is nothing but folders, regular files and links in a folder, however deep."""
    pending = [folder]
    try:
        while pending:
            with os.scandir(pending.pop()) as entries:
                for entry in entries:
                    if entry.is_dir(follow_symlinks=False):
                        pending.append(entry.path)
                    elif not (entry.is_file(follow_symlinks=False) or entry.is_symlink()):
                        return False
    except OSError:
        return False
    return True


def _is_socket(path: str) -> bool:
    try:
        return stat.S_ISSOCK(os.stat(path).st_mode)
    except OSError:
        return False


def _alone() -> bool:
    """Tell whether this process's own network is nothing but loopback, as in a container that was started without one."""
    return [name for _, name in socket.if_nameindex()] == ["lo"]


def remedy(
    otherwise: str = "a container without a network has such walls of its own: `podman run --network none`",
) -> str:
    """Return what makes this machine allow namespaces; ``otherwise`` where no setting forbids them."""
    for name, value, setting in _REMEDIES:
        with suppress(OSError):
            if Path("/proc/sys", name).read_text(encoding="ascii").strip() == value:
                return setting
    return otherwise
