"""One row of a fleet: its environment is built with the network, its adapter certified without, and its verdict kept.

Exit code 0 says that the row has a verdict, or a reason for none that another try would not change; 3, that the kit, its machine
or the installation failed, so that the engine tries again.
"""

from __future__ import annotations

import argparse
import os
import re
import secrets
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..core.errors import ExhaustedError, KitError, UsageError
from ..core.text import one_line
from ..core.verdict import ExitCode
from ..fleet.outcome import Outcome, Result, Tries, judged, pack, write_result
from ..fleet.plan import Row, read_row
from . import Refusal, cut, show
from .certify import interruptible, run_suite
from .confined import Bounds, confined
from .issuing import concluded, write, write_pages
from .verify import examination

__all__ = ["run"]

_INSTALL_S = 900
_LOG, _SAID = "log.txt", 400
_KEPT = (
    "PATH",
    "HOME",
    "USER",
    "LANG",
    "TMPDIR",
    "LD_LIBRARY_PATH",
    "SSL_CERT_FILE",
    "REQUESTS_CA_BUNDLE",
    "NODE_EXTRA_CA_CERTS",
)
_KEPT_PREFIXES = (
    "PIP_",
    "UV_",
    "PYENV_",
    "NPM_CONFIG_",
    "npm_config_",
    "GIT_CONFIG_",
    "http_",
    "https_",
    "no_",
    "HTTP",
    "NO_PROXY",
)
"""Variables that an installation may need: where programs, indexes and proxies are. The rest, secrets among it, stays outside."""
_EXIT = re.compile(r"^! _pytest\.outcomes\.Exit: (.*) !$", re.MULTILINE)
_ENGINES = ("podman", "docker")


class _Fault(Exception):
    """The row has to be tried again; the message says why."""


def run(args: argparse.Namespace) -> int:
    """Carry out the row.

    Raises:
        UsageError: the row is none of this kit, or the folder is not the row's own.
    """
    row, out = read_row(args.row), args.out.absolute()
    if out.name != row.key:
        raise UsageError(
            f"--out {args.out}: it is emptied before the run, so it must be called {row.key}, as the row is"
        )
    if row.image is not None and not args.contained:
        return _in_container(row, args.row.absolute(), out, args.attempt)
    out.mkdir(parents=True, exist_ok=True)
    # In a container it is a mount point, which cannot be removed itself.
    for path in out.iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()
    tries = Tries.of(out.parent.parent, row.key)
    tries.begin()
    try:
        with interruptible(), _home(row, out) as home:
            result = _carried_out(row, home, out)
    except (_Fault, KitError, ExhaustedError, OSError) as reason:
        tries.fail(cut(one_line(str(reason))))
        show(f"{row.id} {row.version}: {Outcome.FAULT}: {one_line(str(reason))}")
        return ExitCode.INDETERMINATE
    except KeyboardInterrupt:
        tries.fail("interrupted", interrupted=True)
        raise
    # From here on the row is done: what is interrupted now would be carried out again.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Where the machines share no folder, each try begins without the notes of the others; then the engine counts.
    result = replace(result, tries=max(tries.read()[0], args.attempt))
    write_result(out, result)
    show(one_line(f"{row.id} {row.version}: {result.outcome}" + (f": {result.reason}" if result.reason else "")))
    return ExitCode.CONFORMANT


@contextmanager
def _home(row: Row, out: Path) -> Iterator[Path]:
    """Make the folder in which subject and environment lie as long as the row lasts: not below /tmp, which walls hide."""
    home = out.parent.parent / "work" / row.key
    shutil.rmtree(home, ignore_errors=True)
    home.mkdir(parents=True)
    try:
        for name, content in row.files.items():
            path = home / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(content, encoding="utf-8", newline="")
        yield home
    finally:
        shutil.rmtree(home, ignore_errors=True)


def _carried_out(row: Row, home: Path, out: Path) -> Result:
    own = {name: value.replace("{dir}", str(home)) for name, value in row.env.items()}
    with (out / _LOG).open("wb") as log:
        _install(row, home, own, log)
        os.environ.update(own)
        os.chdir(home)
        began = time.monotonic()
        options = (
            f"--otmcp-reps={row.reps}",
            f"--otmcp-seed={secrets.randbelow(2**32)}",
            f"--otmcp-isolation={row.isolation}",
        )
        try:
            ended = run_suite(home / row.subject, out, *options, log=log, limit_s=row.limit_minutes * 60)
        except subprocess.TimeoutExpired:
            ended = None
        seconds = round(time.monotonic() - began, 1)
    result = Result(key=row.key, id=row.id, version=row.version, outcome=Outcome.OUT_OF_TIME, seconds=seconds)
    if ended is None:
        _packed(out)
        return replace(result, reason=f"not done within {row.limit_minutes} minutes")
    reason = None
    try:
        record, statement = concluded(out, ended)
        with (out / _LOG).open("a", encoding="utf-8") as words, redirect_stdout(words):
            write(out, statement)
            write_pages(out, record, statement, signed=False)
    except UsageError:
        return replace(result, outcome=Outcome.WRONG_SUBJECT, reason=_refusal(out, home))
    except Refusal as refusal:
        reason = str(refusal).removeprefix("no certificate: ")
    examined = _examined(out, certified=reason is None)
    outcome = judged(examined["run"])
    if outcome is Outcome.FAULT:
        raise _Fault(examined["run"]["reason"] or "the verdict is INDETERMINATE")
    digest, packed = _packed(out)
    told = reason
    if outcome is Outcome.DID_NOT_START:
        told = examined["run"]["causes"][0]["message"]
    elif outcome is Outcome.NOT_CONFORMANT:
        # What failed is in the causes of the verdict.
        told = None
    return replace(
        result,
        outcome=outcome,
        reason=told,
        verdict=examined["run"],
        certificate=reason is None,
        record=digest,
        packed=packed,
    )


def _install(row: Row, home: Path, own: dict[str, str], log: Any) -> None:
    """Run the commands that build the environment.

    Raises:
        _Fault: one of them failed, for want of a package or of a network: nobody can tell which.
    """
    kept = {name: value for name, value in os.environ.items() if name in _KEPT or name.startswith(_KEPT_PREFIXES)}
    # uv, where it is installed beside the kit.
    kept["PATH"] = f"{kept.get('PATH', os.defpath)}{os.pathsep}{Path(sys.executable).parent}"
    for command in row.install:
        words = [
            word.replace("{version}", row.version).replace("{python}", sys.executable) for word in shlex.split(command)
        ]
        try:
            code, output, errors = _ended(words, home, {**kept, **own})
        except FileNotFoundError:
            raise _Fault(f"not installed: there is no {words[0]}") from None
        except subprocess.TimeoutExpired:
            raise _Fault(f"not installed: {command} took longer than {_INSTALL_S} s") from None
        log.write(output + errors)
        if code:
            lines = errors.decode(errors="replace").split("\n") + output.decode(errors="replace").split("\n")
            said = " ".join(line.strip() for line in lines if line.strip())[-_SAID:]
            raise _Fault(f"not installed: {command} ended with {code}: {said}")
    log.flush()


def _ended(words: list[str], home: Path, env: dict[str, str]) -> tuple[int, bytes, bytes]:
    """Run a command in a session of its own, which ends with an interruption or a time-out; return its exit code and what it printed."""
    with subprocess.Popen(
        words,
        cwd=home,
        env=env,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    ) as process:
        try:
            output, errors = process.communicate(timeout=_INSTALL_S)
        except BaseException:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            raise
    return process.returncode, output, errors


def _examined(out: Path, *, certified: bool) -> dict[str, Any]:
    """Judge the record, and the certificate if there is one, again in a process of its own.

    Raises:
        _Fault: the record does not hold, which is a fault of the kit: nothing but the kit has written it.
    """
    path, certificate = out / "run.json", out / "certificate.json"
    asked = examination(path, (certificate, certificate.read_bytes()) if certified else None)
    try:
        return confined("examination", asked, Bounds.of(path.stat().st_size), path.name)
    except Refusal as reason:
        raise _Fault(str(reason)) from None


def _packed(out: Path) -> tuple[str, str] | tuple[None, None]:
    """Keep of a run what the fleet shows; tables and figures can be made again from the record."""
    for name in ("tables", "figures"):
        shutil.rmtree(out / name, ignore_errors=True)
    return pack(out / "run.json") if (out / "run.json").is_file() else (None, None)


def _refusal(out: Path, home: Path) -> str:
    """Return the sentence with which the suite refused to begin."""
    text = (out / _LOG).read_text(encoding="utf-8", errors="replace")
    found = _EXIT.findall(text) or [line for line in text.splitlines() if line.strip("= ")]
    return cut(one_line(found[-1] if found else "the suite did not begin").replace(f"{home}/", ""))


def _in_container(row: Row, file: Path, out: Path, attempt: int) -> int:
    """Carry out the row in its container, without a network and with bounded memory and processors."""
    engine = next(filter(None, map(shutil.which, _ENGINES)), None)
    if engine is None:
        raise UsageError(f"{row.id} {row.version} is a container, and there is neither {' nor '.join(_ENGINES)}")
    assert row.image is not None
    out.mkdir(parents=True, exist_ok=True)
    limits = ["--network=none", "--cpus=2", "--memory=2g", "--pids-limit=1024", "--cap-drop=all"]
    mounts = [f"--volume={file}:/fleet/{file.name}:ro", f"--volume={out}:/fleet/runs/{row.key}"]
    words = ["--contained", f"--out=/fleet/runs/{row.key}", f"--attempt={attempt}"]
    inside = ["otmcp", "fleet", "row", f"/fleet/{file.name}", *words]
    return subprocess.run([engine, "run", "--rm", *limits, *mounts, row.image, *inside], check=False).returncode
