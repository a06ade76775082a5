"""What identifies a run on the first page of its report: when, with which kit, how often, over what. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..core.matrix import BENCHMARK
from . import Run, adapters

__all__ = ["identity"]

_NONE = "—"
_TRANSPORTS = {"stdio": "stdio", "http": "streamable HTTP"}


def identity(run: Run) -> list[tuple[str, str]]:
    """Return the facts that a printed page needs so that nobody takes it for another one, each with its name."""
    sessions, footer, settings = adapters(run), run["footer"], run["settings"]
    revisions = dict.fromkeys(str(facts.get("protocol_version") or _NONE) for facts in sessions.values())
    # A record of an earlier kit does not name the transport.
    transports = dict.fromkeys(_TRANSPORTS.get(facts.get("transport", ""), _NONE) for facts in sessions.values())
    elapsed = footer.get("elapsed_s")
    return [
        ("Date", _moment(str(run["environment"].get("started_at") or _NONE))),
        ("Duration", _NONE if elapsed is None else _duration(elapsed)),
        ("Kit", f"{run['kit'].get('name')} {run['kit'].get('version')}"),
        ("Repetitions", f"N = {settings.get('reps', _NONE)}" if _benchmarked(settings) else "one of each check"),
        ("MCP revision", ", ".join(revisions) or _NONE),
        ("Transport", ", ".join(transports) or _NONE),
    ]


def _benchmarked(settings: Mapping[str, Any]) -> bool:
    return not {*BENCHMARK}.isdisjoint(settings.get("suites", BENCHMARK))


def _moment(text: str) -> str:
    """Write an RFC 3339 time in UTC to the minute."""
    day, _, time = text.partition("T")
    return f"{day} {time[:5]} UTC" if time else text


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes else f"{seconds:.1f} s"
