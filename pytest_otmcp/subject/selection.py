"""The adapters that a run measures: those of the subject file, or reference adapters.

Without a subject file a run has the reference adapters of the protocols that are always part of a run, and those of further
protocols that were asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from importlib import metadata
from pathlib import Path

from ..core.errors import UsageError
from ..core.names import describe_unknown
from ..protocols.protocol import OtProtocol
from ..protocols.registry import protocols
from .load import load_subject, reference_subject
from .model import Subject

__all__ = ["ALL", "Selection", "missing_library", "select", "without_cable"]

ALL = "all"
"""Stands for every protocol that there is a reference adapter for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """The adapters that a run measures.

    Attributes:
        subject: the adapters that are measured.
        not_measured: each protocol that was asked for and whose adapter cannot be started here, to one sentence that says why.
    """

    subject: Subject
    not_measured: Mapping[str, str] = field(default_factory=dict)


def select(source: Path | None, asked: Collection[str] = ()) -> Selection:
    """Select the adapters of a run.

    Args:
        source: the subject file; None for the reference adapters.
        asked: protocols of reference adapters beside those that are always part of a run, or :data:`ALL`.

    Raises:
        UsageError: the subject file is wrong; or there is one and protocols were asked for; or there is no reference adapter for
            a protocol that was asked for by its name, or its library is not installed.
    """
    if source is not None:
        if asked:
            raise UsageError(
                f"--otmcp-protocols is for runs of the reference adapters, and {source} says what is tested: leave the option out"
            )
        return Selection(subject=load_subject(source))
    every = reference_subject()
    for key in asked:
        if key not in (ALL, *every.adapters):
            raise UsageError(f"--otmcp-protocols: {describe_unknown('protocol', key, (ALL, *every.adapters))}")
        if key != ALL and (missing := missing_library(protocols()[key])):
            raise UsageError(f"--otmcp-protocols: {key}: {missing}")
    wanted = {key for key in every.adapters if protocols()[key].always or key in asked or ALL in asked}
    reasons = {
        key: f"{protocols()[key].name} was not measured: {missing}"
        for key in every.adapters
        if key in wanted and (missing := missing_library(protocols()[key]))
    }
    adapters = {key: adapter for key, adapter in every.adapters.items() if key in wanted and key not in reasons}
    return Selection(subject=replace(every, adapters=adapters), not_measured=reasons)


def without_cable(selection: Selection, refused: Callable[[], str | None]) -> Selection:
    """Return a selection without the adapters that need a cable, where the machine refuses one.

    Args:
        refused: says what this machine refuses; it is asked only where an adapter needs a cable.
    """
    needing = [key for key in selection.subject.adapters if protocols()[key].cable]
    if not needing or (why := refused()) is None:
        return selection
    adapters = {key: it for key, it in selection.subject.adapters.items() if key not in needing}
    reasons = {key: f"{protocols()[key].name} was not measured: {why}" for key in needing}
    return Selection(
        subject=replace(selection.subject, adapters=adapters), not_measured={**selection.not_measured, **reasons}
    )


def missing_library(protocol: OtProtocol) -> str | None:
    """Say which packages the reference adapter lacks that an extra of the kit installs, and how; None where nothing is missing."""
    missing = [name for name in protocol.packages if not _is_installed(name)]
    if protocol.always or not missing:
        return None
    return f"{', '.join(missing)} is not installed; pip install 'pytest-otmcp[{protocol.key}]'"


def _is_installed(distribution: str) -> bool:
    try:
        metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return False
    return True
