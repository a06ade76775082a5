"""What each wall stops: a hostile program tries it with walls and without."""

from __future__ import annotations

import asyncio
import ctypes
import json
import os
import re
import secrets
import shutil
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from pytest_otmcp.core.errors import KitError, UsageError
from pytest_otmcp.core.walls import AUTO, OFF, REQUIRE, WALLS, Wall
from pytest_otmcp.session.isolation import Isolation, Walls
from pytest_otmcp.session.process import StopReport, SubjectProcess

from .outside import Outside

INTRUDER = Path(__file__).parent / "intruder.py"
HERE = Path(__file__).parent
GRACE_S = 5.0
CHAIN = "leaves a chain of processes that fork and exit"


TABLE = Path(__file__).parents[2] / "docs" / "isolation.md"
STOPPED_BY: dict[str, set[Wall]] = {
    attempt: {wall for wall in WALLS if f"`{wall}`" in stopped}
    for attempt, stopped in re.findall(
        r"^\| (?!what)(.+) \| (`.+) \|$", TABLE.read_text().split("\n## What was tried\n")[1], re.MULTILINE
    )
}
"""The table of the documents: what a program tries, and the walls of which each stops it."""

SERVERS = {
    "connects to a TCP port": "tcp",
    "sends a UDP datagram": "udp",
    "connects to an abstract Unix socket": "abstract",
    "connects to a Unix socket below `/tmp`": "path",
    "connects to a Unix socket elsewhere": "home",
    "connects to a Unix socket that was renamed": "renamed",
    "writes into a pipe": "pipe",
}


@dataclass(frozen=True, kw_only=True)
class Seen:
    """What an intruder could do.

    Attributes:
        standing: the walls around it.
        worked: attempt to whether it saw it work; behind walls that can be in a view of the machine of its own.
        harm: attempts that changed or reached something outside.
        declared: what it wrote to a folder that is open to it was there.
        alive: processes that it had started and that were there after its end.
    """

    standing: frozenset[Wall]
    worked: dict[str, bool]
    harm: set[str]
    declared: bool
    alive: int


def isolation_or_skip() -> Isolation:
    try:
        return Isolation(REQUIRE)
    except UsageError as refused:
        pytest.skip(str(refused))


def isolation_with(standing: frozenset[Wall]) -> tuple[Isolation, Walls | None]:
    """Return an isolation and walls of which just these stand."""
    if not standing:
        isolation = Isolation(OFF)
        return isolation, isolation.walls()
    isolation_or_skip().close()
    isolation = Isolation(AUTO)
    if "files" not in standing:
        isolation.refused("view", (0, "a view of the machine, for this test"))
    return isolation, isolation.walls(outside="" if "network" in standing else "for this test")


@pytest.fixture(
    scope="module",
    params=[
        frozenset(WALLS),
        pytest.param(frozenset({"network"}), marks=pytest.mark.long),
        pytest.param(frozenset({"processes", "files"}), marks=pytest.mark.long),
        frozenset(),
    ],
    ids=lambda walls: ", ".join(sorted(walls)) or "no walls",
)
def seen(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Seen]:
    isolation, walls = isolation_with(request.param)
    cwd, work = tmp_path_factory.mktemp("cwd"), tmp_path_factory.mktemp("work")
    (cwd / "reports").mkdir()
    (cwd / "run.json").write_text("{}")
    # A folder that is not below /tmp: what is there stays visible.
    outside = Outside(HERE)
    file, temporary = HERE / f"{outside.name}.txt", Path("/tmp", outside.name)  # noqa: S108
    with open(cwd.parent / "said", "w+b") as said:
        other = subprocess.Popen(["/bin/sleep", "600"], env={"SECRET_OF_THE_SHELL": "1"}, stdout=said)
        try:
            # Without walls nothing ends such a chain as long as it lasts.
            breed = 60 if "processes" in request.param else 0
            target = {**outside.addresses(), "process": other.pid, "file": str(file), "work": str(work / "done")}
            command = [sys.executable, str(INTRUDER), json.dumps({**target, "breed": breed})]
            worked = asyncio.run(_start(walls and walls.open_to(reads=(), writes=(str(work),)), command, cwd))
            came = outside.reached()
            harm = {attempt for attempt, server in SERVERS.items() if server in came}
            harm |= {attempt for attempt, stopping in STOPPED_BY.items() if "processes" in stopping and worked[attempt]}
            places = {
                "writes to the standard output of another process": said.seek(0, 2) > 0,
                "writes a file": file.exists(),
                "writes a file below `/tmp`": temporary.exists(),
                "writes a `conftest.py` in its working directory": (cwd / "conftest.py").exists(),
                "moves a folder of its working directory": not (cwd / "reports").exists(),
                "puts a pipe in place of a file": not (cwd / "run.json").is_file(),
            }
            harm = (harm - places.keys()) | {attempt for attempt, changed in places.items() if changed}
            yield Seen(
                standing=request.param,
                worked=worked,
                harm=harm,
                declared=(work / "done").exists(),
                alive=_alive(outside.name),
            )
        finally:
            other.kill()
            other.wait()
            outside.close()
            isolation.close()
            file.unlink(missing_ok=True)
            temporary.unlink(missing_ok=True)


async def _intrude(isolation: Isolation, command: list[str], cwd: Path, work: Path) -> dict[str, bool]:
    walls = isolation.walls()
    return await _start(None if walls is None else walls.open_to(reads=(), writes=(str(work),)), command, cwd)


async def _start(walls: Walls | None, command: list[str], cwd: Path) -> dict[str, bool]:
    said: asyncio.Queue[bytes] = asyncio.Queue()
    process = await SubjectProcess.start(
        command,
        env={"PATH": os.environ["PATH"], "HOME": os.environ["HOME"]},
        cwd=cwd,
        on_line=lambda now, line: said.put_nowait(line),
        on_overflow=lambda now: None,
        walls=walls,
    )
    worked: dict[str, bool] = json.loads(await said.get())
    await process.stop(grace_s=GRACE_S)
    return worked


def _alive(name: str) -> int:
    found = 0
    for entry in Path("/proc").iterdir():
        try:
            found += entry.name.isdigit() and name.encode() in (entry / "cmdline").read_bytes()
        except OSError:
            continue
    return found


@pytest.mark.parametrize("attempt", STOPPED_BY)
def test_a_wall_stops_what_the_document_says(seen: Seen, attempt: str) -> None:
    assert (attempt in seen.harm) == STOPPED_BY[attempt].isdisjoint(seen.standing)


def test_the_document_has_every_attempt(seen: Seen) -> None:
    assert {*seen.worked} == {*STOPPED_BY, CHAIN, "declared", "disk", "privileges"}


def test_no_privilege_is_left(seen: Seen) -> None:
    assert not (seen.standing and seen.worked["privileges"])
    assert not ("files" in seen.standing and seen.worked["disk"])


def test_what_is_written_to_a_declared_folder_stays(seen: Seen) -> None:
    assert seen.declared


def test_nothing_survives(seen: Seen) -> None:
    assert seen.worked[CHAIN] == ("processes" in seen.standing)
    assert seen.alive == 0


def test_a_keeper_that_was_killed_has_a_successor_with_the_same_walls(tmp_path: Path) -> None:
    isolation = isolation_or_skip()
    outside = Outside(HERE)
    target = {**outside.addresses(), "file": str(HERE / outside.name), "work": str(tmp_path / "done"), "breed": 0}
    command = [sys.executable, str(INTRUDER), json.dumps(target)]
    try:
        asyncio.run(_intrude(isolation, command, tmp_path, tmp_path))
        running = isolation.keeper._running
        assert running is not None
        running.process.kill()
        running.process.wait()
        asyncio.run(_intrude(isolation, command, tmp_path, tmp_path))
        with isolation.socket(socket.SOCK_STREAM) as made, pytest.raises(ConnectionRefusedError):
            made.connect(outside.tcp.getsockname())
        assert outside.reached() == set()
    finally:
        outside.close()
        isolation.close()


@pytest.mark.parametrize("special", [None, os.mkfifo])
def test_code_without_special_files_needs_no_layer_after_some_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, special: Callable[[Path], None] | None
) -> None:
    with tempfile.TemporaryDirectory(dir=HERE) as name:
        code, cwd = Path(name, "code"), Path(name, "cwd")
        for folder in (code / "package", cwd):
            folder.mkdir(parents=True)
        if special is not None:
            special(code / "package" / "pipe")
        monkeypatch.setattr("sysconfig.get_path", lambda kind: str(code))
        # What lies below the home of whoever runs this has a layer.
        monkeypatch.setenv("HOME", str(tmp_path))
        isolation = isolation_or_skip()
        look = f"import json, os, sys; print(json.dumps({{'device': os.stat({str(code)!r}).st_dev}}), flush=True); sys.stdin.read()"
        try:
            seen = [
                asyncio.run(_start(isolation.walls(), [sys.executable, "-c", look], cwd))["device"] for _ in range(6)
            ]
        finally:
            isolation.close()
        own = os.stat(code).st_dev
    assert own not in seen[:4]
    assert (seen[-1] == own) == (special is None)


OF_A_START = """
import json, os, socket, sys
folder = sys.argv[1]
told = {"descriptors": len(os.listdir("/proc/self/fd")) - 1, "listed": sorted(os.listdir(folder))}
libc = __import__("ctypes").CDLL(None, use_errno=True)
told["user namespace"] = libc.unshare(0x10000000) == 0
try:
    os.chmod("/dev/null", os.stat("/dev/null").st_mode & 0o777)
    told["mode of a device"] = True
except OSError:
    told["mode of a device"] = False
with open("/dev/null", "w") as nowhere:
    told["null"] = nowhere.write("x")
try:
    os.chmod("/proc/version", 0o444)
    told["mode in /proc"] = True
except OSError:
    told["mode in /proc"] = False
try:
    socket.socket(socket.AF_UNIX).connect(f"{folder}/socket")
    told["socket"] = True
except OSError:
    told["socket"] = False
print(json.dumps(told), flush=True)
sys.stdin.read()
"""


def test_a_start_hands_nothing_on(tmp_path: Path) -> None:
    isolation = isolation_or_skip()
    with tempfile.TemporaryDirectory(dir="/tmp") as folder, socket.socket(socket.AF_UNIX) as listening:
        listening.bind(f"{folder}/socket")
        listening.listen()
        Path(folder, "file").touch()
        try:
            told = asyncio.run(_start(isolation.walls(), [sys.executable, "-c", OF_A_START, folder], tmp_path))
        finally:
            isolation.close()
    assert told == {
        # Standard streams.
        "descriptors": 3,
        "listed": ["file", "socket"],
        "user namespace": False,
        "mode of a device": False,
        "null": 1,
        "mode in /proc": False,
        "socket": False,
    }


@pytest.mark.parametrize("through", ["link", "folder/link", "named"])
def test_a_link_that_an_adapter_made_opens_nothing(tmp_path: Path, through: str) -> None:
    isolation = isolation_or_skip()
    written = tmp_path / "written"
    (written / "folder").mkdir(parents=True)
    with tempfile.TemporaryDirectory(dir=HERE) as folder, socket.socket(socket.AF_UNIX) as listening:
        place = f"{folder}/s"
        # Its path is long: it is bound from its folder.
        before = os.getcwd()
        os.chdir(folder)
        try:
            listening.bind("s")
        finally:
            os.chdir(before)
        listening.listen()
        for link in (written / "link", written / "folder" / "link"):
            link.symlink_to(place)
        (tmp_path / "named").symlink_to("written/link")
        named = tmp_path / "named" if through == "named" else written / through
        walls = isolation.walls()
        assert walls is not None
        try:
            request = walls.open_to(reads=(), writes=[str(written)]).request([sys.executable, str(named)], {}, "/")
            meant = walls.request([sys.executable, str(named)], {}, "/")
        finally:
            isolation.close()
    assert place not in request["view"]["reads"]
    assert place in meant["view"]["reads"]


NOT_OF_A_NETWORK = """
import ctypes, errno, json, resource, socket, sys
libc = ctypes.CDLL(None, use_errno=True)
told = {}
for name in ("AF_INET", "AF_UNIX", "AF_VSOCK"):
    try:
        socket.socket(getattr(socket, name)).close()
        told[name] = True
    except OSError:
        told[name] = False
told["io_uring"] = libc.syscall(425, 1, ctypes.create_string_buffer(120)) >= 0
told["key"] = libc.syscall(int(sys.argv[1]), 10, -3, b"user", sys.argv[2].encode(), 0) > 0
for name, number in (("bpf", int(sys.argv[3])), ("clone3", 435)):
    libc.syscall(number, 0, 0, 0)
    told[name] = ctypes.get_errno() != errno.ENOSYS
own = resource.getrlimit(resource.RLIMIT_CORE)
told["core dumps"] = own != (1, 1)
told["other limits"] = resource.setrlimit(resource.RLIMIT_NOFILE, resource.getrlimit(resource.RLIMIT_NOFILE)) is None
for name, change in (("setrlimit", libc.setrlimit), ("prlimit", lambda kind, limit: libc.prlimit(0, kind, limit, None))):
    told[name] = change(resource.RLIMIT_CORE, (ctypes.c_ulong * 2)(0, 0)) == 0
told["core dumps after that"] = resource.getrlimit(resource.RLIMIT_CORE) != own
print(json.dumps(told), flush=True)
sys.stdin.read()
"""
KEYCTL = {"x86_64": (250, 248, 321), "aarch64": (219, 217, 280)}.get(os.uname().machine)


@pytest.mark.skipif(KEYCTL is None, reason="the numbers of system calls are known for x86-64 and AArch64")
def test_what_namespaces_do_not_hold_is_refused(tmp_path: Path) -> None:
    assert KEYCTL is not None
    isolation, name = isolation_or_skip(), f"otmcp-{secrets.token_hex(8)}"
    libc = ctypes.CDLL(None, use_errno=True)
    # Where the machine has no keys, there is none to find.
    key = libc.syscall(KEYCTL[1], b"user", name.encode(), b"secret", 6, -3)
    try:
        command = [sys.executable, "-c", NOT_OF_A_NETWORK, str(KEYCTL[0]), name, str(KEYCTL[2])]
        told = asyncio.run(_start(isolation.walls(), command, tmp_path))
    finally:
        libc.syscall(KEYCTL[0], 3, key)
        isolation.close()
    assert {name for name, worked in told.items() if worked} == {
        "AF_INET",
        "AF_UNIX",
        "other limits",
        "setrlimit",
        "prlimit",
    }


def test_at_a_cable_an_adapter_may_set_its_interface_up_and_open_packet_sockets(tmp_path: Path) -> None:
    look = (
        "import json, re, sys\n"
        "own = re.findall('Cap(?:Prm|Eff|Bnd|Amb):\\t([0-9a-f]+)', open('/proc/self/status').read())\n"
        "print(json.dumps({'privileges': [int(one, 16) for one in own]}), flush=True)\n"
        "sys.stdin.read()"
    )
    isolation = isolation_or_skip()
    try:
        told = asyncio.run(_start(isolation.walls(cable=True), [sys.executable, "-c", look], tmp_path))
    finally:
        isolation.close()
    # CAP_NET_ADMIN and CAP_NET_RAW, capabilities(7).
    assert told == {"privileges": [1 << 12 | 1 << 13] * 4}


MARKING = """
import json, os, sys
done = []
for path in sys.argv[1:]:
    for name in ("metacopy", "opaque", "redirect", "origin", "impure", "upper", "protattr", "uuid", "nlink"):
        try:
            os.setxattr(path, "user.overlay." + name, b"/x" if name == "redirect" else b"y" if name == "opaque" else b"")
            done.append(name)
        except OSError:
            pass
print(json.dumps({"pid": os.getpid(), "done": len(done)}), flush=True)
sys.stdin.read()
"""


@pytest.mark.parametrize("known", [True, False])
def test_no_attribute_that_an_adapter_leaves_takes_a_wall_down(monkeypatch: pytest.MonkeyPatch, known: bool) -> None:
    """An overlay obeys some attributes of the files below it; one that the kit does not know must not let an adapter out either."""
    if not known:
        monkeypatch.setattr("pytest_otmcp.session.isolation._OF_LAYERS", "user.none.")
    isolation = isolation_or_skip()
    with tempfile.TemporaryDirectory(dir=HERE) as name:
        file, folder, deep = Path(name, "state.db"), Path(name, "state"), Path(name, "state", "deep")
        file.touch()
        deep.mkdir(parents=True)
        command = [sys.executable, "-c", MARKING, str(file), str(folder), str(deep)]
        walls = isolation.walls()
        assert walls is not None
        try:
            for written in ([folder], [file], [file, folder]):
                opened = walls.open_to(reads=(), writes=map(str, written))
                for _ in range(2):
                    if not known and "user.overlay.metacopy" in os.listxattr(file):
                        with pytest.raises(KitError, match="could not be started behind its walls"):
                            asyncio.run(_start(opened, command, Path(name)))
                        continue
                    told = asyncio.run(_start(opened, command, Path(name)))
                    if not told["done"]:
                        pytest.skip("this file system has no attributes")
                    assert told["pid"] == 2
            assert isolation.account() == {"network": None, "processes": None, "files": None}
        finally:
            isolation.close()


STARVING = """
import os, signal
signal.signal(signal.SIGTERM, signal.SIG_IGN)
print("{}", flush=True)
for _ in range(2 * os.cpu_count()):
    if os.fork() == 0:
        while True:
            pass
os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
while True:
    pass
"""


def test_an_adapter_that_takes_the_processor_from_itself_is_ended_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pytest_otmcp.session.process._STARVED_S", 1.0)
    isolation = isolation_or_skip()

    async def ended() -> StopReport:
        begun = asyncio.Event()
        process = await SubjectProcess.start(
            [sys.executable, "-c", STARVING],
            env=dict(os.environ),
            cwd=tmp_path,
            on_line=lambda moment, line: begun.set(),
            on_overflow=lambda moment: None,
            walls=isolation.walls(),
        )
        await begun.wait()
        return await process.stop(grace_s=0.5)

    try:
        report = asyncio.run(ended())
    finally:
        isolation.close()
    assert report.how == "killed"
    # Without a bound of its own it would be granted a minute for each of two requests to end.
    assert report.seconds < 30


def test_what_is_opened_can_be_reached_and_nothing_else(tmp_path: Path) -> None:
    isolation = isolation_or_skip()
    outside = Outside(HERE)
    written = tmp_path / "written"
    written.mkdir()
    target = {**outside.addresses(), "file": str(written / "file"), "work": str(tmp_path / "work"), "breed": 0}
    walls = isolation.walls(outside="it needs the network")
    assert walls is not None
    opened = walls.open_to(reads=[outside.paths["path"]], writes=[str(written)])
    try:
        worked = asyncio.run(_start(opened, [sys.executable, str(INTRUDER), json.dumps(target)], tmp_path))
        assert outside.reached() == {"tcp", "udp", "abstract", "path"}
        assert (written / "file").exists()
        assert not any(
            worked[attempt]
            for attempt in ("signals another process", "reads the environment of another process", "privileges")
        )
        assert not (tmp_path / "work").exists()
        assert isolation.account() == {"network": "it needs the network", "processes": None, "files": None}
    finally:
        outside.close()
        isolation.close()


def test_packages_to_which_the_environment_of_the_kit_leads_can_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    isolation = isolation_or_skip()
    with tempfile.TemporaryDirectory(dir="/tmp") as packages:
        Path(packages, "packaged.py").touch()
        monkeypatch.syspath_prepend(packages)
        code = (
            "import importlib.util, json, sys\n"
            f"sys.path.append({packages!r})\n"
            "print(json.dumps({'found': importlib.util.find_spec('packaged') is not None}), flush=True)\n"
            "sys.stdin.read()"
        )
        try:
            assert asyncio.run(_start(isolation.walls(), [sys.executable, "-c", code], tmp_path)) == {"found": True}
        finally:
            isolation.close()


# -- file systems in the way ------------------------------------------------------------------------------------------

MOUNTED = """
mount -t tmpfs none "$1/home/mounted" || exit 99
mount -t overlay overlay -o lowerdir="$1/lower:$1/empty" "$1/first" || exit 99
mount -t overlay overlay -o lowerdir="$1/first:$1/empty" "$1/second" || exit 99
shift
exec "$@"
"""
"""Runs a command where something is mounted below a ``HOME``, and where an overlay lies upon another: the kernel refuses a third."""

LOOKING_AROUND = """
import asyncio, os, socket, sys
from pathlib import Path
from tests.walls import test_walls

folder = Path(sys.argv[1])
os.environ["HOME"] = str(folder / "home")
listening = socket.socket(socket.AF_UNIX)
# A path is short enough for a socket where it is told from its folder.
os.chdir(folder / "home")
listening.bind("socket")
listening.listen()
os.chdir(folder / "cwd")
isolation = test_walls.Isolation("require")
print(asyncio.run(test_walls._start(isolation.walls(), [sys.executable, "-c", test_walls.LOOKS, *sys.argv[1:]], folder / "cwd")))
isolation.close()
"""

LOOKS = """
import json, os, socket, sys
folder, seen = sys.argv[1], {}
try:
    os.chdir(f"{folder}/home")
    socket.socket(socket.AF_UNIX).connect("socket")
    seen["socket"] = True
except OSError:
    seen["socket"] = False
try:
    open("written", "w").close()
    seen["written"] = True
except OSError:
    seen["written"] = False
seen["home"] = os.path.exists("file")
seen["second"] = os.listdir(f"{folder}/second")
print(json.dumps(seen), flush=True)
sys.stdin.read()
"""


@pytest.mark.long
def test_a_home_with_a_mount_below_is_read_only_and_what_no_overlay_can_cover_is_hidden() -> None:
    isolation_or_skip().close()
    if (unshare := shutil.which("unshare")) is None:
        pytest.skip("unshare(1) is not installed")
    with tempfile.TemporaryDirectory(dir=HERE) as name:
        folder = Path(name)
        for part in ("home/mounted", "lower", "empty", "first", "second", "cwd"):
            (folder / part).mkdir(parents=True)
        for part in ("home", "lower"):
            (folder / part / "file").touch()
        done = subprocess.run(
            [
                *(unshare, "--map-current-user", "--keep-caps", "--mount"),
                *("sh", "-c", MOUNTED, "sh", name),
                *(sys.executable, "-c", LOOKING_AROUND, name),
            ],
            cwd=HERE.parents[1],
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
    if done.returncode == 99:
        pytest.skip(f"mounts are refused: {done.stderr.strip()}")
    assert done.stderr == ""
    assert done.stdout == "{'socket': False, 'written': False, 'home': True, 'second': []}\n"


# -- machines that refuse ---------------------------------------------------------------------------------------------

REFUSING = """
import os, sys
from pytest_otmcp.session import walls
walls.enter_user()
for name in sys.argv[1].split(","):
    with open(f"/proc/sys/user/max_{name}_namespaces", "w") as file:
        file.write("0")
os.execv(sys.executable, [sys.executable, *sys.argv[2:]])
"""
"""Runs Python where the kernel has no more namespaces of these kinds, as where an administrator forbids them."""


def refused(kinds: str, *command: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    isolation_or_skip().close()
    return subprocess.run(
        [sys.executable, "-c", REFUSING, kinds, *command],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )


DOCTOR = ("-m", "pytest_otmcp.cli", "doctor", "--subject", "otmcp.toml")


@pytest.fixture
def subject(tmp_path: Path) -> Path:
    """A folder with a subject file of the Modbus reference adapter."""
    (tmp_path / "otmcp.toml").write_text(
        """
[subject]
name = "reference"
version = "1"

[adapter.modbus]
command = ["{python}", "-P", "-m", "pytest_otmcp.reference_adapters", "modbus"]
env = { MODBUS_HOST = "{host}", MODBUS_PORT = "{port}" }
rw = { env = { MODBUS_WRITES_ENABLED = "true" } }
unclaimed = {}
"""
    )
    return tmp_path


LOST = {
    "user": "No wall around network, processes and files: this machine refuses a user namespace (No space left on device); ",
    "net": "No wall around network: this machine refuses a network namespace (No space left on device); ",
    "mnt": "No wall around processes and files: this machine refuses a mount namespace (No space left on device); ",
}


@pytest.mark.parametrize(
    "kinds", [pytest.param(name, marks=() if name == "mnt" else pytest.mark.long) for name in LOST]
)
def test_where_the_machine_refuses_it_goes_without_and_says_so(subject: Path, kinds: str) -> None:
    done = refused(kinds, *DOCTOR, cwd=subject)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stderr.startswith(LOST[kinds])
    assert done.stderr.count("\n") == 1


def test_what_is_required_is_not_gone_without(subject: Path) -> None:
    done = refused("mnt", *DOCTOR, "--isolation=require", cwd=subject)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("otmcp: isolation is required, and this machine refuses a mount namespace (")


@pytest.mark.parametrize("mode", ["require", "auto"])
@pytest.mark.long
def test_a_run_where_the_machine_refuses(subject: Path, mode: str) -> None:
    words = ("-m", "pytest", "--otmcp-reps=1", "-k", "M1", f"--otmcp-isolation={mode}", "-p", "no:cacheprovider")
    done = refused("net", *words, cwd=subject)
    if mode == "require":
        assert done.returncode == 2, done.stdout + done.stderr
        assert "isolation is required, and this machine refuses a network namespace (" in done.stdout
    else:
        assert "note: No wall around network: this machine refuses a network namespace" in " ".join(done.stdout.split())
