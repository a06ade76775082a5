"""The subject of a rig: what it states of the adapter, alike for a running adapter and for a stored run. Pure."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, TypeVar

from ..protocols.bounds import Bounds, Governance, Scopes, Times
from ..protocols.protocol import Declared
from ..protocols.registry import protocols
from ..record.schema import AdapterFacts
from ..subject.claims import Claims

__all__ = ["SubjectInRig"]

T = TypeVar("T")


class SubjectInRig:
    """The statements of a subject file about an adapter.

    Args:
        protocol: of the adapter.
        facts: what the run record has of it.
        claims: of the subject.
        addressed_by: keys of the subject file that tell the adapter where its device is.
    """

    def __init__(
        self, protocol: str, facts: AdapterFacts, claims: Claims, *, addressed_by: Sequence[str] | None = None
    ) -> None:
        self._protocol = protocol
        self._facts = facts
        self._claims = claims
        self.addressed_by = facts.get("addressed_by", []) if addressed_by is None else addressed_by

    def claims(self, facet: str) -> bool:
        """Tell whether the subject claims this facet of its adapter."""
        return self._claims.has(f"{self._protocol}.{facet}")

    def blocks(self, operation: str) -> bool:
        """Tell whether the operation is performed by a call that waits for the message that it returns."""
        return operation in self._facts["blocking"]

    def max_age_s(self, operation: str) -> float | None:
        """Return how old the operation's answer may be; None when it must come from the device."""
        return self._facts["cached"].get(operation)

    @property
    def native(self) -> bool:
        """The adapter claims to answer in envelopes of its own."""
        return self._facts["envelope"] == "native"

    @property
    def recovery_s(self) -> float:
        """The time within which work goes on after an outage."""
        return self._facts["recovery_s"]

    @property
    def deadline_s(self) -> float:
        """The time within which every call must have answered."""
        return self._facts["deadline_s"]

    @property
    def declared(self) -> Declared:
        """The lists of the protocol's own keys in the subject file."""
        return self._facts["lists"]

    @property
    def bounds(self) -> Bounds:
        """The targets and limits that the variant ``bounded`` was told."""
        told = self._facts.get("bounds")
        return Bounds() if told is None else Bounds.of_record(told)

    @property
    def times(self) -> Times | None:
        """What follows from what the variant ``retimed`` was told; None where there is no such variant."""
        told = self._facts.get("times")
        return None if told is None else Times.of_record(told)

    @property
    def governance(self) -> Governance:
        """What the variant ``governed`` was told; the steps that ask for it have that launch."""
        return Governance.of_record(self._facts["governance"])

    @property
    def scopes(self) -> Scopes:
        """Those of the callers of the variant ``tokens``; the steps that ask for it have that launch."""
        return Scopes.of_record(self._facts["scopes"])

    @property
    def secured(self) -> Mapping[str, str]:
        """Members that each handshake of the variant ``secure`` has in the journal, as far as the file says what was configured."""
        return self._facts.get("secured", {})

    def probe(self, name: str) -> Any:
        """Return the value of this probe: the input to use where the request must be refused."""
        return self._facts["probes"][name]

    @property
    def reconnects(self) -> bool:
        """After an outage the adapter connects again without being asked to."""
        return self._facts["recovery"] != "connect_step" and "opened_by" not in self._facts

    @property
    def lacks(self) -> Collection[str]:
        """The optional inputs that no binding has a place for, such as ``subscribe.qos``."""
        return self._facts["lacks"]

    def judges(self, output: str) -> bool:
        """Tell whether the subject says where this output is, such as ``messages.topic``, the topics of messages."""
        return output not in self._facts["unjudged"]

    def accepts_input(self, operation: str, name: str) -> bool:
        """Tell whether the operation can be given this optional or voluntary input."""
        if name in protocols()[self._protocol].operations[operation].voluntary_inputs:
            return self.claims(f"{operation}.{name}")
        return f"{operation}.{name}" not in self.lacks

    def expected_if_accepted(self, operation: str, name: str, value: T) -> T | None:
        """Return ``value`` if the tool accepts this optional input, else None: the device may have seen any value."""
        return value if self.accepts_input(operation, name) else None
