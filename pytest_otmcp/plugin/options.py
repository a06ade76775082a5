"""The settings of a run, read from command line and ini, checked once.

The module imports nothing heavy: every pytest run in an environment with the plugin loads it.
"""

from __future__ import annotations

import datetime
import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from ..core.challenge import NONCE, is_nonce, seed_of
from ..core.errors import UsageError
from ..core.matrix import BENCHMARK, FIELD, REQUIREMENTS, SUITES, repetitions
from ..core.site import site
from ..core.walls import AUTO, MODES
from ..protocols.external import BROKER, DEVICE, ExternalDevice, external_devices, in_url

if TYPE_CHECKING:
    import pytest

    from ..protocols.field import Consent
    from ..trial.task import Task

__all__ = ["DEFAULT_REPS", "RunSettings", "add_options", "read_settings"]

DEFAULT_REPS = 3
"""Default of N: small, so that a first look takes seconds; the paper's matrix is 30."""

_OPTIONS = {
    "reps": ("N", f"repetitions N: normal and fault N, stress N/3, recovery 2N/3, rounded up (default {DEFAULT_REPS})"),
    "subject": ("FILE", "subject file of the adapters under test (default: otmcp.toml, else the reference adapters)"),
    "suite": ("NAMES", f"these suites, separated by commas: {', '.join(SUITES)} (default: all but the last)"),
    "only": (
        "ROWS",
        "only the checks of these rows of the catalogue, or these checks, separated by commas, such as WR-003",
    ),
    "protocols": (
        "NAMES",
        "further protocols whose reference adapters are run as well, separated by commas, or all (default: none)",
    ),
    "isolation": (
        "MODE",
        f"walls around the adapters: {', '.join(MODES)} (default auto: as far as the machine allows, see docs/isolation.md)",
    ),
    "report-dir": ("DIR", "directory for run record, tables and figures (default reports/latest)"),
    "baseline": (
        "FILE",
        "run.json of an earlier run: the verdict says which rules are newly broken, and which were mended",
    ),
    "seed": ("N", "seed of the values that repetitions use (default 0)"),
    "challenge": ("NONCE", f"a buyer's question from which the seed follows, in the seed's place: {NONCE}"),
    "era": ("ERA", "MCP protocol era: auto or legacy (default auto)"),
    "time-scale": (
        "X",
        "factor on deadlines and windows, for slow machines; quiet windows are never shortened (default 1)",
    ),
    **{
        device.option: ("URL", f"external {device.noun}, {device.scheme}://host:port, instead of the embedded one")
        for device in external_devices().values()
        if device.option == BROKER
    },
    "consent": (
        "FILE",
        "what a person allows to be written to the real device; without it nothing is (docs/real-devices.md)",
    ),
    "mirror": (
        "FILE",
        "a capture of what goes to the real device, being written, for an adapter whose address for it cannot be changed: the kit stands "
        "beside the wire, and asks for reads alone",
    ),
}

_DEVICE = "a real device, PROTOCOL=URL, read-only in the mock's place; may be given for several protocols"

_SOAK = "the long forms of the checks that have one: thousands of calls, messages and faults (minutes)"


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSettings:
    """The settings of a run.

    Attributes:
        reps: the number N that the user gave.
        repetitions: suite name to number of repetitions.
        subject: subject file, or None for the shipped reference adapters.
        suites: names of the suites to run, in the suite's order.
        only: rows of the catalogue, or ids of checks, to which the requirement suite is narrowed; empty for all.
        protocols: further protocols whose reference adapters are run, or ``all``.
        baseline: record of an earlier run to compare with, or None.
        report_dir: directory of run record, tables and figures.
        seed: seed of the values that repetitions use.
        challenge: the nonce from which it follows, or None.
        era: MCP protocol era, ``auto`` or ``legacy``.
        isolation: the walls around the adapters: ``auto``, ``require`` or ``off``.
        time_scale: factor on deadlines and windows; windows in which nothing may happen are never shortened.
        soak: checks that have a long form take it.
        external: protocol to the URL of the user's device in the mock's place.
        consents: protocol to what may be written to its real device.
        mirror: capture that shows what goes to its one real device, or None.
    """

    reps: int
    repetitions: dict[str, int]
    subject: Path | None
    suites: tuple[str, ...]
    only: tuple[str, ...]
    protocols: tuple[str, ...]
    baseline: Path | None
    report_dir: Path
    seed: int
    challenge: str | None
    era: str
    isolation: str
    time_scale: float
    soak: bool
    external: dict[str, str]
    consents: Mapping[str, Consent]
    mirror: Path | None

    @property
    def devices(self) -> dict[str, dict[str, object]]:
        """The real devices, by protocol, as a run record has them: the URL, and what may be written, or None."""
        return {
            key: {"url": url, "consent": self.consents[key].as_record() if key in self.consents else None}
            for key, url in self.external.items()
            if external_devices()[key].option == DEVICE
        }

    def wants(self, task: Task) -> bool:
        """Tell whether suite and row of a task were asked for."""
        return task.suite in self.suites and (
            task.suite != REQUIREMENTS or not self.only or not {task.id, *task.requirements}.isdisjoint(self.only)
        )


def add_options(parser: pytest.Parser) -> None:
    """Declare every ``--otmcp-…`` option and its ini twin ``otmcp_…``."""
    group = parser.getgroup("otmcp", "conformance of MCP-to-OT adapters")
    for name, (metavar, text) in _OPTIONS.items():
        group.addoption(f"--otmcp-{name}", metavar=metavar, default=None, help=text)
        parser.addini(f"otmcp_{name.replace('-', '_')}", text, default=None)
    group.addoption(f"--otmcp-{DEVICE}", metavar="PROTOCOL=URL", action="append", default=None, help=_DEVICE)
    parser.addini(f"otmcp_{DEVICE}", _DEVICE, type="linelist", default=[])
    group.addoption("--otmcp-soak", action="store_true", default=False, help=_SOAK)
    parser.addini("otmcp_soak", _SOAK, type="bool", default=False)


def _destination(name: str) -> str:
    return f"otmcp_{name.replace('-', '_')}"


def read_settings(config: pytest.Config) -> RunSettings:
    """Read and check the settings of this run.

    Raises:
        UsageError: a value does not fit its option, or its variable of the environment.
    """

    def text(name: str) -> str | None:
        value = config.getoption(_destination(name))
        if value is None:
            value = config.getini(_destination(name)) or None
        return None if value is None else str(value)

    site()  # Reports are written at the end: a wrong address is told now.
    only = _names(text("only"))
    challenge = text("challenge")
    if challenge is not None and not is_nonce(challenge):
        raise UsageError(f"--otmcp-challenge: expected {NONCE}, found {challenge[:40]!a}")
    if challenge is not None and text("seed") is not None:
        raise UsageError("--otmcp-seed: the seed follows from --otmcp-challenge; give one of the two")
    named = config.getoption(_destination(DEVICE)) or config.getini(_destination(DEVICE))
    external = _read_devices(named)
    real, consent = bool(external), text("consent")
    for protocol, device in external_devices().items():
        if device.option == BROKER and (value := text(BROKER)) is not None:
            external[protocol] = _check_url(BROKER, device, value)
    mirror = _existing("mirror", text("mirror"), config.invocation_params.dir)
    if mirror is not None and len(named) != 1:
        raise UsageError(
            f"--otmcp-mirror: it is for one real device, and --otmcp-{DEVICE} names {len(named) or 'none'}"
        )
    reps = _read_whole_number("reps", text("reps"), DEFAULT_REPS, minimum=1, maximum=100_000)
    return RunSettings(
        reps=reps,
        repetitions=repetitions(reps),
        subject=_find_subject(text("subject"), config.rootpath, config.invocation_params.dir),
        suites=(
            *_read_suites(text("suite"), () if real else (REQUIREMENTS,) if only else BENCHMARK),
            *[FIELD] * real,
        ),
        only=only,
        protocols=_names(text("protocols")),
        baseline=_existing("baseline", text("baseline"), config.invocation_params.dir),
        report_dir=_resolve_report_dir(text("report-dir"), config),
        seed=_read_whole_number("seed", text("seed"), 0, minimum=0, maximum=2**63 - 1)
        if challenge is None
        else seed_of(challenge),
        challenge=challenge,
        era=_check_choice("era", text("era") or "auto", ("auto", "legacy")),
        isolation=_check_choice("isolation", text("isolation") or AUTO, MODES),
        time_scale=_read_factor(text("time-scale")),
        soak=config.getoption("otmcp_soak") or config.getini("otmcp_soak"),
        external=external,
        consents={} if consent is None else _read_consents(config.invocation_params.dir / consent, named),
        mirror=mirror,
    )


def _names(value: str | None) -> tuple[str, ...]:
    return tuple(name.strip() for name in (value or "").split(",") if name.strip())


def _read_whole_number(name: str, value: str | None, default: int, *, minimum: int, maximum: int) -> int:
    if value is None:
        return default
    try:
        number = int(value)
    except ValueError:
        raise UsageError(f"--otmcp-{name}: expected a whole number, found {value!r}") from None
    if not minimum <= number <= maximum:
        raise UsageError(f"--otmcp-{name}: expected {minimum} to {maximum}, found {number}")
    return number


def _read_factor(value: str | None) -> float:
    if value is None:
        return 1.0
    try:
        number = float(value)
    except ValueError:
        raise UsageError(f"--otmcp-time-scale: expected a number, found {value!r}") from None
    if not 0.1 <= number <= 100:
        raise UsageError(f"--otmcp-time-scale: expected 0.1 to 100, found {value}")
    return number


def _check_choice(name: str, value: str, known: tuple[str, ...]) -> str:
    if value not in known:
        near = difflib.get_close_matches(value, known, 1)
        hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(known)}"
        raise UsageError(f"--otmcp-{name}: {value!r} is unknown; {hint}")
    return value


def _read_suites(value: str | None, default: tuple[str, ...]) -> tuple[str, ...]:
    if value is None:
        return default
    names = _names(value)
    if not names:
        raise UsageError(f"--otmcp-suite: expected one or more of {', '.join(SUITES)}")
    chosen = [_check_choice("suite", name, SUITES) for name in names]
    return tuple(name for name in SUITES if name in chosen)


def _find_subject(value: str | None, root: Path, here: Path) -> Path | None:
    default = root / "otmcp.toml"
    return _existing("subject", value, here) or (default if default.is_file() else None)


def _existing(name: str, value: str | None, here: Path) -> Path | None:
    if value is None:
        return None
    path = here / value
    if not path.is_file():
        raise UsageError(f"--otmcp-{name}: {path}: there is no such file")
    return path


def _resolve_report_dir(value: str | None, config: pytest.Config) -> Path:
    path = config.rootpath / "reports" / "latest" if value is None else config.invocation_params.dir / value
    if path.exists() and not path.is_dir():
        raise UsageError(f"--otmcp-report-dir: {path} exists and is not a directory")
    return path


def _read_devices(named: Sequence[str]) -> dict[str, str]:
    """Return the URLs of real devices by protocol."""
    known = {key: device for key, device in external_devices().items() if device.option == DEVICE}
    found: dict[str, str] = {}
    for value in named:
        key, _, url = value.partition("=")
        if key not in known:
            hint = f"; use --otmcp-{BROKER}" if key in external_devices() else ""
            raise UsageError(f"--otmcp-{DEVICE}: real devices are taken for {', '.join(known)}, not for {key!r}{hint}")
        if key in found:
            raise UsageError(f"--otmcp-{DEVICE}: {key} has two devices; a run is about one")
        found[key] = _check_url(DEVICE, known[key], url)
    return found


def _read_consents(path: Path, named: Sequence[str]) -> Mapping[str, Consent]:
    from ..plant.consent import read_consent

    consent = read_consent(path, datetime.date.today())
    if consent.device not in named:
        raise UsageError(
            f"--otmcp-consent: {path}: it is for {consent.device}, and --otmcp-{DEVICE} names {', '.join(named) or 'none'}"
        )
    return {consent.device.partition("=")[0]: consent}


def _check_url(option: str, device: ExternalDevice, value: str) -> str:
    try:
        parts = urlsplit(value)
        port = parts.port
    except ValueError as error:
        raise UsageError(f"--otmcp-{option}: {value!r} is not a URL ({error})") from None
    # Where to read, behind the port of a real device.
    place = parts.path.removeprefix("/")
    fits = not place or (option == DEVICE and device.is_place(place))
    strange = parts.username or parts.query or parts.fragment
    if parts.scheme != device.scheme or not parts.hostname or port == 0 or strange or not fits:
        raise UsageError(f"--otmcp-{option}: expected {device.scheme}://host:port, found {value!r}")
    return f"{device.scheme}://{in_url(parts.hostname)}:{port or device.default_port}{place and '/' + place}"
