"""The claims of a subject: the one place that tells, for a subject file and for a run record, which facets are claimed. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import partial

from ..protocols.protocol import ACCOUNT, CLIENT_CERTIFICATE, COMMANDS, LAUNCHES, READ, READINGS, WRITE
from ..protocols.registry import protocols
from ..record.schema import AdapterFacts
from .model import Adapter

__all__ = ["Claims"]


@dataclass(frozen=True, slots=True)
class _AdapterClaims:
    unclaimed: Mapping[str, str]
    waiting: Collection[str]
    offered: Collection[str]
    commands: Mapping[str, str]
    readings: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Claims:
    """The claims of a subject's adapters; facets are named with their protocol, such as ``modbus.guard``."""

    _adapters: Mapping[str, _AdapterClaims]

    @classmethod
    def of_subject(cls, adapters: Mapping[str, Adapter]) -> Claims:
        """Return the claims of a subject file."""
        return cls(
            {
                key: _AdapterClaims(
                    adapter.unclaimed, adapter.blocking, adapter.offered, adapter.commands, adapter.readings
                )
                for key, adapter in adapters.items()
            }
        )

    @classmethod
    def of_record(cls, adapters: Mapping[str, AdapterFacts]) -> Claims:
        """Return the claims that a run record states in ``subject.adapters``."""
        return cls(
            {
                key: _AdapterClaims(
                    facts["unclaimed"],
                    facts["blocking"],
                    facts.get("offered", ()),
                    facts.get("commands", {}),
                    facts.get("readings", {}),
                )
                for key, facts in adapters.items()
            }
        )

    def has_adapter(self, protocol: str) -> bool:
        """Tell whether the subject has an adapter for this protocol."""
        return protocol in self._adapters

    def why_not(self, facet: str) -> str | None:
        """Return the reason why a facet is not claimed; None when it is. An unclaimed operation has no claimed inputs."""
        protocol, _, name = facet.partition(".")
        if protocol not in self._adapters:
            return f"the subject has no adapter for {protocols()[protocol].name}"
        adapter = self._adapters[protocol]
        operation, _, part = name.partition(".")
        reason = adapter.unclaimed.get(name, adapter.unclaimed.get(operation))
        if reason is None and protocols()[protocol].is_voluntary(name) and name not in adapter.offered:
            if operation in LAUNCHES:
                return f"the subject file has no launch {LAUNCHES[operation]!r}"
            if operation == CLIENT_CERTIFICATE:
                return "the launch 'secure' has no place for {cert}, a certificate of the adapter's own"
            if operation == ACCOUNT:
                return "the launch 'secure' has no place for {user} and {password}, an account of the device"
            if operation == COMMANDS:
                return "the subject file has no named commands"
            if operation == READINGS:
                return "the subject file has no named readings"
            return f"no binding of {operation!r} has {part!r}" if part else "no tool is bound to it"
        return reason

    def is_silent(self, facet: str) -> bool:
        """Tell whether the subject says nothing of a facet: neither a binding that claims it nor a reason why it is not claimed."""
        protocol, _, name = facet.partition(".")
        adapter = self._adapters[protocol]
        stated = not adapter.unclaimed.keys().isdisjoint((name, name.partition(".")[0]))
        return protocols()[protocol].is_voluntary(name) and name not in adapter.offered and not stated

    def has(self, facet: str) -> bool:
        """Tell whether the facet is claimed."""
        return self.why_not(facet) is None

    def required(self, needs: Iterable[str]) -> list[str]:
        """Resolve the facets that a task needs into the facets that a subject claims or not."""
        found: list[str] = []
        for need in needs:
            protocol, _, name = need.partition(".")
            if not name:
                # An adapter for the protocol is needed, and nothing that it claims.
                found += [] if self.has_adapter(protocol) else [need]
                continue
            waiting = self._adapters[protocol].waiting if protocol in self._adapters else ()
            real = protocols()[protocol].required_facets(
                self._by_name(protocol, name), waiting, partial(self._has, protocol)
            )
            found += [f"{protocol}.{facet}" for facet in real]
        return list(dict.fromkeys(found))

    def _by_name(self, protocol: str, facet: str) -> str:
        """Return what takes the place of the operation that the exercise writes or reads with, where a subject does so by named commands or
        readings that are all of other operations: that of the first of them."""
        known, named = protocols()[protocol], self._adapters.get(protocol)
        if known.exercise is None or named is None:
            return facet
        by_name = {
            WRITE: named.commands,
            known.exercise.writing: named.commands,
            READ: named.readings,
            known.exercise.reading: named.readings,
        }.get(facet, {})
        if any(self._has(protocol, name) for name in known.alternatives(facet, ()) or (facet,)):
            return facet
        return next(iter(by_name.values()), facet)

    def _has(self, protocol: str, facet: str) -> bool:
        return self.has(f"{protocol}.{facet}")
