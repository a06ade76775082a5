"""The description of one OT protocol: everything that the rooms of the kit have to know of it. Pure.

The rooms read descriptions and never name a protocol. A new protocol is therefore new files: a sub-package here (its
description, decoder and oracles), a mock, a reference adapter and tasks.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field

from ..core.finding import Finding
from .conversation import Conversation
from .external import ExternalDevice
from .framing import FrameLength
from .journal import Entries, JournalEntry
from .session_oracle import SessionOracle

__all__ = [
    "GUARD",
    "RECOVERY",
    "Choice",
    "Colour",
    "Composite",
    "Framing",
    "Operation",
    "Origin",
    "OtProtocol",
    "Simulator",
]

GUARD = "guard"
"""Facet: there is a way to launch the adapter in which it refuses every write (the variant ``ro``)."""

RECOVERY = "recovery"
"""Facet: after an outage of the endpoint the same session works again."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Operation:
    """One abstract operation: what the kit asks for, whatever an adapter calls its tools.

    Inputs are filled into a binding's argument template, outputs are read from the answer by a binding's rules.
    Operations are also the *facets* that a subject claims.

    Attributes:
        meaning: one sentence for the author of a binding.
        inputs: names that an argument template may refer to.
        outputs: names that the kit judges in a successful answer, when the binding says where they are.
        needed: those of the outputs without which nothing could be judged.
        writes: it changes the state of the plant.
        optional: inputs that a tool may lack; each is a facet of its own, such as ``subscribe.qos``.
        waits: the input that says how many seconds a call may wait for what it answers; None where no call waits.
    """

    meaning: str
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    needed: tuple[str, ...] = ()
    writes: bool = False
    optional: tuple[str, ...] = ()
    waits: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Composite:
    """A facet that tasks need and that stands for several facets of a subject.

    Attributes:
        facets: what it stands for.
        if_waiting: operation to what it stands for instead when that operation is performed by a call that waits.
    """

    facets: tuple[str, ...]
    if_waiting: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """A key of its own that a protocol adds to the subject file's ``[adapter.KEY]`` table.

    Attributes:
        key: name of the key.
        default: its value where the file does not have it.
        meaning: one sentence for the author of a subject file.
        unclaims: each possible value, to the facets that an adapter with it does not claim and the reason why.
    """

    key: str
    default: str
    meaning: str
    unclaims: Mapping[str, Mapping[str, str]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Framing:
    """How recorded bytes become journal entries, so that the tap can be the witness.

    Attributes:
        conversation: makes the decoder of one connection.
        frame_length: cuts a stream into frames; None for a protocol that has no streams, whose frames are datagrams.
    """

    conversation: Callable[[], Conversation]
    frame_length: FrameLength | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Colour:
    """The protocol's colour in figures and in the report, on a light and on a dark background, as ``#rrggbb``."""

    light: str
    dark: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Simulator:
    """A mock beside the protocol's device, which is only started by hand: no task has it for a witness.

    Attributes:
        clients: which clients it is for, in words.
        options: its own command line options, without ``--``, each with a metavariable and its help text.
    """

    clients: str
    options: Mapping[str, tuple[str, str]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Origin:
    """Where a protocol comes from that is not the kit's own: its oracles judge, so a record names it.

    Attributes:
        distribution, version: of the installed package; None for what belongs to no package.
        digest: ``sha256:…`` over the files of the package that holds the description.
    """

    distribution: str | None
    version: str | None
    digest: str


@dataclass(frozen=True, slots=True, kw_only=True)
class OtProtocol:
    """One OT protocol.

    Attributes:
        key: identifier in subject files, records, markers and on the command line, such as ``modbus``.
        name: as tables and figures print it, such as ``Modbus``.
        package: that holds the description, its oracles and ``codes.toml``.
        scheme: of an endpoint's URL, as ``{url}`` stands for in a subject file.
        operations: the abstract operations by name.
        composites: facets that tasks need and that are no operation, by name.
        probes: what tasks ask for where something must be refused; a subject file may replace each.
        choices: keys of its own in a subject file.
        framing: how recorded bytes are decoded; None when only the mock can be the witness.
        unsolicited: findings for everything in a journal slice that commands the plant, although the adapter was asked for
            nothing.
        describe: one journal entry in a few words, for findings and the report.
        title: what a journal entry is, for the report's conversations; None where its kind says it.
        mock: name of the mock as ``python -m pytest_otmcp.mocks`` takes it: a folder of the room ``mocks``, or the
            dotted name of a package of the same shape.
        clients: which clients a mock started by hand is for, in words.
        simulators: further mocks to be started by hand, by the name that ``python -m pytest_otmcp.mocks`` takes.
        tasks: dotted name of the module that declares the tasks of the conformance suite.
        onboarding: dotted name of the module whose ``PACK`` holds the words and experiments of ``otmcp init``; None when
            it cannot propose bindings for this protocol.
        recognise: matches text in a command line that names the protocol.
        envelope_names: what ``meta.protocol`` of an envelope may say; only the key when empty.
        packages: distributions whose versions the run record states.
        colour: in figures and reports.
        external: the user's own device in the mock's place; None when there is no such way.
        session_oracles: what is judged over the whole life of a session.
        always: its items are part of every run, as the paper's matrix has it; otherwise only of runs whose subject has
            an adapter for it.
        origin: None for the kit's own protocols.
    """

    key: str
    name: str
    package: str
    scheme: str
    operations: Mapping[str, Operation]
    unsolicited: Callable[[Entries], list[Finding]]
    describe: Callable[[JournalEntry], str]
    mock: str
    clients: str
    tasks: str
    recognise: re.Pattern[str]
    colour: Colour
    composites: Mapping[str, Composite] = field(default_factory=dict)
    probes: Mapping[str, object] = field(default_factory=dict)
    choices: tuple[Choice, ...] = ()
    framing: Framing | None = None
    onboarding: str | None = None
    title: Callable[[JournalEntry], str] | None = None
    simulators: Mapping[str, Simulator] = field(default_factory=dict)
    envelope_names: tuple[str, ...] = ()
    packages: tuple[str, ...] = ()
    external: ExternalDevice | None = None
    session_oracles: tuple[type[SessionOracle], ...] = ()
    always: bool = False
    origin: Origin | None = None

    @property
    def facets(self) -> tuple[str, ...]:
        """Everything that an adapter for this protocol may claim or not."""
        names = [GUARD, RECOVERY]
        for name, operation in self.operations.items():
            names += [name, *(f"{name}.{optional}" for optional in operation.optional)]
        return tuple(names)

    def required_facets(self, facet: str, waiting: Collection[str]) -> tuple[str, ...]:
        """Resolve a facet that a task needs into those that a subject claims or not.

        Args:
            facet: without its protocol.
            waiting: operations that the adapter performs by a call that waits for what it answers.
        """
        composite = self.composites.get(facet)
        if composite is None:
            return (facet,)
        return next((found for name, found in composite.if_waiting.items() if name in waiting), composite.facets)

    def seen(self, entries: Sequence[JournalEntry], most: int = 8) -> str:
        """Describe journal entries for a finding's evidence."""
        shown = "; ".join(self.describe(entry) for entry in entries[:most])
        return shown + (f"; … {len(entries) - most} more" if len(entries) > most else "")
