"""Applicability of a task to a subject, and the adapters that take part: pure functions of the facets that the task needs
and that the subject claims."""

from __future__ import annotations

from collections.abc import Mapping

from ..core.capability import Capability
from ..core.matrix import FIELD, REQUIREMENTS
from ..core.verdict import Status
from ..protocols.protocol import LAUNCHES
from ..protocols.registry import protocols
from ..subject.claims import Claims
from ..subject.model import Adapter
from .rig import adapter_name
from .task import Task

__all__ = ["NOT_CLAIMED", "NO_ADAPTER", "applicability", "participants", "why_not_in_field"]

NO_ADAPTER = "the subject has no adapter for "
"""Beginning of the reason for which most items of a subject with one protocol do not apply."""

NOT_CLAIMED = " is not claimed: "
"""What stands in a reason between a facet and why it is not claimed."""


_NEVER = {
    "normal": "it sets values at the device past the adapter",
    "fault": "it sets values at the device past the adapter, and makes it fail",
    "stress": "it loads the device and cuts it off",
    "recovery": "it stops and starts the device",
    REQUIREMENTS: "it sets values at the device past the adapter, or makes it fail",
}


def why_not_in_field(task: Task, devices: Mapping[str, Mapping[str, object]]) -> str | None:
    """Say why the task is not done at the real devices of a run; None when they are no obstacle.

    Args:
        devices: by protocol, as a run record has them; none in a run with mocks alone.
    """
    for key in task.protocols:
        name = protocols()[key].name
        if task.suite != FIELD:
            if key in devices:
                return f"{_NEVER[task.suite]}, which is never done to a real one ({name})"
            continue
        if key not in devices:
            return f"no real device was named for {name}"
        consent = devices[key]["consent"]
        allowed = consent if isinstance(consent, Mapping) else {}
        if Capability.OUTAGES in task.capabilities:
            if "outage" not in allowed:
                return f"no consent file has the commands that cut a real device off and bring it back ({name})"
        elif Capability.READING not in task.capabilities and not allowed.get("writable"):
            return f"without a consent file nothing is written to a real device ({name})"
    return None


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
            return Status.NOT_APPLICABLE, f"{facet}{NOT_CLAIMED}{reason}"
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
