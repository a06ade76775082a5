"""Applicability of a task to a subject, and the adapters that take part: pure functions of the facets that the task needs
and that the subject claims."""

from __future__ import annotations

from collections.abc import Mapping

from ..core.verdict import Status
from ..protocols.protocol import LAUNCHES
from ..protocols.registry import protocols
from ..subject.claims import Claims
from ..subject.model import Adapter
from .rig import adapter_name
from .task import Task

__all__ = ["NO_ADAPTER", "applicability", "participants"]

NO_ADAPTER = "the subject has no adapter for "
"""Beginning of the reason for which most items of a subject with one protocol do not apply."""


def applicability(task: Task, adapters: Mapping[str, Adapter]) -> tuple[Status, str] | None:
    """Say why the task cannot be run: NOT_APPLICABLE or NOT_TESTABLE with the reason; None when it can be.

    NOT_TESTABLE, for a facet that is claimed but cannot be exercised, is only said when every facet that the task needs is
    claimed.
    """
    claims = Claims.of_subject(adapters)
    for protocol in dict.fromkeys(facet.partition(".")[0] for facet in task.needs):
        if not claims.has_adapter(protocol):
            return Status.NOT_APPLICABLE, f"{NO_ADAPTER}{protocols()[protocol].name}"
    needs = claims.required(task.needs)
    for facet in needs:
        if (reason := claims.why_not(facet)) is not None:
            return Status.NOT_APPLICABLE, f"{facet} is not claimed: {reason}"
    for facet in needs:
        protocol, _, name = facet.partition(".")
        if (gap := adapters[protocol].why_not_testable(name)) is not None:
            return Status.NOT_TESTABLE, f"{protocol}: {gap}, and {name} is not declared as unclaimed"
    return None


def participants(task: Task, adapters: Mapping[str, Adapter]) -> list[str]:
    """Return the adapter variants of a task that applies: ``protocol``, or ``protocol@ro`` for the read-only variant."""
    claims = Claims.of_subject(adapters)
    beside = [facet.partition(".") for facet in task.guards if claims.has(facet)]
    return [*task.adapters, *(adapter_name(protocol, LAUNCHES[name]) for protocol, _, name in beside)]
