"""The description of one OT protocol: everything that the other packages of the kit have to know of it. Pure.

The other packages read descriptions and never name a protocol. A new protocol therefore only adds files: a sub-package here
(its description, decoder and oracles), a mock, a reference adapter and tasks.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ..core.finding import Finding
from ..wire.framing import FrameLength
from .conversation import Conversation
from .exercise import Exercise
from .external import ExternalDevice
from .field import Field
from .journal import Entries, JournalEntry
from .point import Point
from .proof import Proof
from .session_oracle import SessionOracle
from .stamp import Stamp

__all__ = [
    "ACCOUNT",
    "ANY_READ",
    "BOUNDS",
    "CLIENT_CERTIFICATE",
    "COMMANDS",
    "CONTROL_GUARD",
    "FACETS",
    "GOVERNANCE",
    "GUARD",
    "LAUNCHES",
    "READ",
    "READINGS",
    "READ_OR_STATUS",
    "RECOVERY",
    "SECURE",
    "TIMES",
    "TOKENS",
    "Choice",
    "Colour",
    "Composite",
    "Declared",
    "Framing",
    "Operation",
    "Origin",
    "OtProtocol",
    "Simulator",
]

GUARD = "guard"
CONTROL_GUARD = "control_guard"
BOUNDS = "bounds"
TIMES = "times"
SECURE = "secure"
GOVERNANCE = "governance"
TOKENS = "tokens"
CLIENT_CERTIFICATE = "client_certificate"
ACCOUNT = "account"
COMMANDS = "commands"
READINGS = "readings"
RECOVERY = "recovery"

LAUNCHES: Mapping[str, str] = {
    GUARD: "ro",
    CONTROL_GUARD: "no_control",
    BOUNDS: "bounded",
    TIMES: "retimed",
    SECURE: "secure",
    GOVERNANCE: "governed",
    TOKENS: "tokens",
}
"""Facets that are launches of their own, to the variant of the adapter that has the facet."""

FACETS: Mapping[str, tuple[str, str]] = {
    GUARD: ("a switch that disables writes", "the adapter can be launched so that it refuses every write"),
    CONTROL_GUARD: (
        "a switch that disables control of the device",
        "the adapter can be launched so that it writes, and refuses what controls the device itself",
    ),
    BOUNDS: (
        "lists and limits of what may be written",
        "the adapter can be launched with a list of targets that may be written, or with limits of their values",
    ),
    TIMES: (
        "settings of time limits",
        "the adapter can be launched with other time limits and numbers of repetitions than its usual ones",
    ),
    SECURE: (
        "the secure form of the protocol",
        "the adapter can be launched for the secure form of the protocol",
    ),
    GOVERNANCE: (
        "policy, audit log and approval",
        "the adapter can be launched with a policy of what may be written, and what it has of an audit log and approvals",
    ),
    TOKENS: (
        "callers over HTTP with tokens",
        "the adapter can be launched as an HTTP server that takes the tokens of an issuer",
    ),
    CLIENT_CERTIFICATE: (
        "a certificate of the adapter's own",
        "the launch 'secure' is given a certificate of the adapter's own, {cert}",
    ),
    ACCOUNT: (
        "an account of the device",
        "the launch 'secure' is given {user} and {password}, an account of the device",
    ),
    COMMANDS: (
        "named commands",
        "the adapter has tools with a vocabulary of their own, whose effect on the device the subject file states",
    ),
    READINGS: (
        "named readings",
        "the adapter has tools that read under names of their own, whose source at the device the subject file states",
    ),
    RECOVERY: ("outages", "after an outage of the device the same session works again"),
}
"""Facets that are no operations: each in a few words, and what it says of an adapter."""

_VOLUNTARY = FACETS.keys() - {GUARD, RECOVERY}

ANY_READ = "any_read"
"""Facet that tasks need: one of the operations that the device itself has to answer, whichever the subject has."""

READ_OR_STATUS = "read_or_status"
"""Facet that checks need: the operation that the exercise reads with, or else one of :data:`ANY_READ`: whether the device answers again is
all that they read for."""

READ = "read"
"""Facet that checks need: the operation that the exercise reads with, or else the call that waits which takes its place."""

WRITE = "write"
"""Facet that checks need: the operation that the exercise writes with, or else the first of those that may take its place."""


Declared = Mapping[str, Sequence[str]]
"""The lists of its protocol that a subject file has about an adapter, by key."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Operation:
    """One abstract operation: a request of the kit, whatever an adapter calls its tools.

    Inputs are filled into a binding's argument template, outputs are read from the answer by a binding's rules.
    Operations are also the *facets* that a subject claims.

    Attributes:
        meaning: one sentence for the author of a binding.
        inputs: names that an argument template may refer to.
        outputs: names that the kit judges in a successful answer, when the binding says where they are.
        needed: the outputs without which nothing could be judged.
        writes: the operation changes the state of the plant.
        controls: what it changes is the device itself, its mode or its clock; adapters have a switch of its own for that.
        adds: a write that takes nothing away and does something of its own each time, such as a message that is published.
        optional: inputs that a tool may lack; each is a facet of its own, such as ``subscribe.qos``.
        status: it asks whether the device is reachable, which an adapter may know from a moment ago.
        waits: the input that limits how many seconds a call may wait for the messages that it returns; None where no call
            waits.
        requirement: id of the requirement that a call breaks which should succeed and does not, or whose outputs are wrong.
            Default: that the device holds what was written, that the status is true, or that the answer is what the device holds.
        tells: the output that says whether the device can be reached; where it says ``false``, the device could not.
        voluntary: a subject claims the operation by binding it; one that does not bind it says nothing about it.
        voluntary_inputs: further names that an argument template may refer to, each a facet that is claimed by referring to it.
            Where a call does not give one, the argument that stands for it is left out.
        voluntary_outputs: further outputs, each a facet that is claimed by saying where it is.
        defaults: values of voluntary inputs for a tool whose schema requires the argument that stands for them.
        documents: inputs that are texts, and that the effect of a named command may state as a JSON document.
        topic_of: returns, from its inputs, the topic of all messages that a call returns, or None where they may be of several; None for
            an operation that returns no messages.
    """

    meaning: str
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    needed: tuple[str, ...] = ()
    writes: bool = False
    controls: bool = False
    adds: bool = False
    optional: tuple[str, ...] = ()
    status: bool = False
    waits: str | None = None
    requirement: str = ""
    tells: str | None = None
    voluntary: bool = False
    voluntary_inputs: tuple[str, ...] = ()
    voluntary_outputs: tuple[str, ...] = ()
    defaults: Mapping[str, object] = field(default_factory=dict)
    documents: tuple[str, ...] = ()
    topic_of: Callable[[Mapping[str, object]], str | None] | None = None

    def __post_init__(self) -> None:
        if not self.requirement:
            object.__setattr__(self, "requirement", "WR-001" if self.writes else "REC-002" if self.status else "RD-001")

    @property
    def accepted(self) -> tuple[str, ...]:
        """All names that an argument template may refer to."""
        return (*self.inputs, *self.voluntary_inputs)

    @property
    def readable(self) -> tuple[str, ...]:
        """All outputs that a binding may say the place of."""
        return (*self.outputs, *self.voluntary_outputs)


@dataclass(frozen=True, slots=True, kw_only=True)
class Composite:
    """A facet that tasks need and that stands for several facets of a subject.

    Attributes:
        facets: the facets that it stands for.
        if_waiting: operation to the facets that it stands for instead when a call that waits performs that operation.
        one_of: it stands for the first of these that the subject claims, and where it claims none of them for the first.
    """

    facets: tuple[str, ...] = ()
    if_waiting: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    one_of: tuple[str, ...] = ()


def _nothing(facet: str) -> bool:
    return False


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """A key that a protocol adds to the subject file's ``[adapter.KEY]`` table.

    Attributes:
        key: name of the key.
        default: its value where the file does not have it.
        meaning: one sentence for the author of a subject file.
        unclaims: each possible value, to the facets that an adapter with it does not claim and the reason why.
        unbound: values, to the operations that an adapter with it may lack: those that are not bound it does not claim, and the
            reason why.
    """

    key: str
    default: str
    meaning: str
    unclaims: Mapping[str, Mapping[str, str]]
    unbound: Mapping[str, Mapping[str, str]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Framing:
    """The functions that turn recorded frames into journal entries, those of a mock as those of a tap.

    Attributes:
        conversation: makes the decoder of one connection.
        frame_length: cuts a stream into frames; None for a protocol without streams, whose frames are datagrams.
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
    """A further mock beside the protocol's device, which is only started by hand: no task uses it as a witness.

    Attributes:
        clients: the clients that it is for, in words.
        options: its own command line options, without ``--``, each with a metavariable and its help text; it needs all of them.
    """

    clients: str
    options: Mapping[str, tuple[str, str]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Origin:
    """The origin of a protocol that is not the kit's own: its oracles judge, so a record names it.

    Attributes:
        distribution, version: of the installed package; None when the protocol belongs to no distribution.
        digest: ``sha256:…`` over the files of the package that holds the description.
    """

    distribution: str | None
    version: str | None
    digest: str


def _state_changing(entries: Entries) -> list[JournalEntry]:
    return [entry for entry in entries if entry["state_changing"]]


def _one(request: JournalEntry) -> int:
    return 1


def _assumed(request: JournalEntry, answer: JournalEntry | None) -> bool:
    return True


def _declares_nothing(operation: str, effect: Mapping[str, str]) -> Mapping[str, Sequence[str]]:
    return {}


def _no_presets(declared: Declared) -> Sequence[Mapping[str, object]]:
    return ()


def _nothing_wider(name: str, kept: object, asked: object) -> bool:
    return False


def _nothing_to_say(entries: Entries, found: Entries) -> str:
    return ""


def _no_stamps(entries: Entries) -> Iterable[Stamp]:
    return ()


@dataclass(frozen=True, slots=True, kw_only=True)
class OtProtocol:
    """One OT protocol.

    Attributes:
        key: identifier in subject files, records, markers and on the command line, such as ``modbus``.
        name: as tables and figures print it, such as ``Modbus``.
        package: name of the package that holds the description, its oracles and ``codes.toml``.
        scheme: of an endpoint's URL, for which ``{url}`` stands in a subject file.
        operations: the abstract operations by name.
        composites: facets that tasks need and that are no operation, by name.
        probes: values that tasks ask for where the request must be refused; a subject file may replace each.
        choices: keys that the protocol adds to a subject file.
        lists: further keys in a subject file whose values are lists of strings, each with its meaning.
        declares: returns what a named command adds to these lists, from the operation that it performs and the texts of its effect, with
            ``+`` in the place of each level, between slashes, that an argument has a part in.
        presets: returns the pokes by which a mock gets what these lists say is there before an adapter comes.
        covers: tells whether a call with one value of an input, of this name, is about all that another one with another value is about.
        framing: decoding of recorded frames; None where the mock says itself what each message is, and no tap can be the witness.
        unsolicited: returns findings for everything in a journal slice that commands the plant, although the adapter was
            asked for nothing.
        changes: returns the requests among entries that may change the plant, each once: what a client of the protocol delivers
            again, and marks so, is the same request.
        parts: how many of the writes for which one call may ask together are in a state-changing request.
        carried_out: tells whether the device did what a state-changing request asked for, from the request and its answer, which
            is None as long as there is none; None if that cannot be told without the answer.
        describe: describes one journal entry in a few words, for findings and the report.
        title: names a journal entry, for the report's conversations; None where the entry's kind is name enough.
        again: says in one clause, of requests for the same thing among entries, what a client and a device have made of the protocol's own
            rules for delivering a request again; empty where the protocol has none, or there was no occasion.
        events: kinds of entries without a frame that its mock records, beside those of every witness.
        facts: what a journal entry says of members of ``meta.trace``, by name (``a.b`` for a member of a member): the values
            that the wire has for it, and ``UNTOLD`` where a message stands for one that it does not have; None where nothing is known
            of traces.
        stamps: returns the wall-clock times that the adapter has put into entries.
        mock: name of the mock as ``python -m pytest_otmcp.mocks`` takes it: a folder of ``mocks``, or the dotted name of
            a package of the same shape.
        clients: the clients that a mock started by hand is for, in words.
        simulators: further mocks to be started by hand, by the name that ``python -m pytest_otmcp.mocks`` takes.
        tasks: dotted name of the module that declares the tasks of the conformance suite.
        onboarding: dotted name of the module whose ``PACK`` holds the words and experiments of ``otmcp init``; None when
            ``otmcp init`` cannot propose bindings for this protocol.
        recognise: matches text in a command line that names the protocol.
        envelope_names: values that ``meta.protocol`` of an envelope may have; only the key when empty.
        packages: distributions whose versions the run record states.
        colour: in figures and reports.
        external: the user's device in the mock's place; None when the mock cannot be replaced.
        real: what may be done at a real device; None where the kit takes none of this protocol.
        session_oracles: the oracles that judge the whole life of a session.
        proof: what shows that a session talks to the mock device, before anything is written through it.
        exercise: what checks that hold for every protocol do on this one; None where there are no such checks.
        always: the protocol's items are part of every run, as the paper's matrix has it; otherwise only of runs whose
            subject has an adapter for it.
        places: by operation, returns the place at the mock that a read with these inputs tells, which is one value; None where there is no
            such place. Named readings have these operations.
        delayed: conditions of the mock's fault rules, one each, that together concern every request that is answered.
        cable: it is spoken on Ethernet itself, so that its device and adapters have a cable of their own.
        secure: the protocol has a secure form, which its mock speaks.
        accounts: its mock knows an account in that form, by user and password.
        application: URI of the mock's application, where certificates have one.
        policies: names of the security policies of which a client is told one, without those that are deprecated.
        discovery: kinds of entries by which a client finds out how to connect securely; none of them needs security.
        introduction: further kinds that a client may send before it has checked who the device is.
        origin: None for the kit's own protocols.
    """

    key: str
    name: str
    package: str
    scheme: str
    operations: Mapping[str, Operation]
    unsolicited: Callable[[Entries, Declared], list[Finding]]
    describe: Callable[[JournalEntry], str]
    mock: str
    clients: str
    tasks: str
    recognise: re.Pattern[str]
    colour: Colour
    changes: Callable[[Entries], Sequence[JournalEntry]] = _state_changing
    parts: Callable[[JournalEntry], int] = _one
    carried_out: Callable[[JournalEntry, JournalEntry | None], bool | None] = _assumed
    again: Callable[[Entries, Entries], str] = _nothing_to_say
    events: Collection[str] = ()
    stamps: Callable[[Entries], Iterable[Stamp]] = _no_stamps
    composites: Mapping[str, Composite] = field(default_factory=dict)
    probes: Mapping[str, object] = field(default_factory=dict)
    choices: tuple[Choice, ...] = ()
    lists: Mapping[str, str] = field(default_factory=dict)
    declares: Callable[[str, Mapping[str, str]], Mapping[str, Sequence[str]]] = _declares_nothing
    presets: Callable[[Declared], Sequence[Mapping[str, object]]] = _no_presets
    covers: Callable[[str, object, object], bool] = _nothing_wider
    framing: Framing | None = None
    onboarding: str | None = None
    title: Callable[[JournalEntry], str] | None = None
    facts: Callable[[JournalEntry], Mapping[str, Sequence[object]]] | None = None
    simulators: Mapping[str, Simulator] = field(default_factory=dict)
    envelope_names: tuple[str, ...] = ()
    packages: tuple[str, ...] = ()
    external: ExternalDevice | None = None
    real: Field | None = None
    session_oracles: tuple[type[SessionOracle], ...] = ()
    proof: Proof = field(default_factory=Proof)
    exercise: Exercise | None = None
    always: bool = False
    places: Mapping[str, Callable[[Mapping[str, Any]], Point | None]] = field(default_factory=dict)
    delayed: tuple[Mapping[str, object], ...] = ({},)
    cable: bool = False
    secure: bool = False
    accounts: bool = False
    application: str = ""
    policies: tuple[str, ...] = ()
    discovery: Collection[str] = ()
    introduction: Collection[str] = ()
    origin: Origin | None = None

    @property
    def has_connections(self) -> bool:
        """Whether clients have connections, which a device that is gone refuses; over datagrams it is silent."""
        return self.framing is None or self.framing.frame_length is not None

    @property
    def controls(self) -> bool:
        """Whether there are operations that control the device itself."""
        return any(operation.controls for operation in self.operations.values())

    @property
    def facets(self) -> tuple[str, ...]:
        """Facets that an adapter for this protocol may claim or not."""
        names = [GUARD, RECOVERY, BOUNDS, TIMES, GOVERNANCE, TOKENS, COMMANDS]
        names += [READINGS] if self.places else []
        names += [CONTROL_GUARD] if self.controls else []
        names += [SECURE, CLIENT_CERTIFICATE] if self.secure else []
        names += [ACCOUNT] if self.accounts else []
        for name, operation in self.operations.items():
            names += [name, *(f"{name}.{optional}" for optional in operation.optional)]
            names += (
                f"{name}.{voluntary}" for voluntary in (*operation.voluntary_inputs, *operation.voluntary_outputs)
            )
        return tuple(names)

    def is_voluntary(self, facet: str) -> bool:
        """Tell whether only a binding, a launch, a named command or a named reading claims this facet: nothing is said of a subject that
        has none."""
        if facet in _VOLUNTARY:
            return True
        name, _, part = facet.partition(".")
        operation = self.operations.get(name)
        if operation is None:
            return False
        return operation.voluntary or part in (*operation.voluntary_inputs, *operation.voluntary_outputs)

    def required_facets(
        self, facet: str, waiting: Collection[str], has: Callable[[str], bool] = _nothing
    ) -> tuple[str, ...]:
        """Resolve a facet that a task needs into the facets that a subject claims or not.

        Args:
            facet: without its protocol.
            waiting: operations that the adapter performs by a call that waits for the messages that it returns.
            has: tells whether the subject claims a facet.
        """
        if alternatives := self.alternatives(facet, waiting):
            return (next(filter(has, alternatives), alternatives[0]),)
        composite = self.composites.get(facet)
        if composite is None:
            return (facet,)
        return next((found for name, found in composite.if_waiting.items() if name in waiting), composite.facets)

    def alternatives(self, facet: str, waiting: Collection[str]) -> tuple[str, ...]:
        """Return the facets of which a task needs any one, the best first; none where ``facet`` leaves no choice."""
        if facet == READ_OR_STATUS and self.exercise is not None:
            return tuple(dict.fromkeys((self.exercise.reading, *self.alternatives(ANY_READ, waiting))))
        if facet == READ and self.exercise is not None:
            instead = self.exercise.waiting
            return (
                self.exercise.reading,
                *([] if instead is None or instead.operation not in waiting else [instead.operation]),
            )
        if facet == WRITE and self.exercise is not None:
            return (self.exercise.writing, *(other.operation for other in self.exercise.otherwise))
        if facet != ANY_READ:
            return self.composites[facet].one_of if facet in self.composites else ()
        # A call that does not wait for messages returns what came before, so the device need not be there.
        names = dict.fromkeys(way.operation for way in self.proof.unreachable)
        return tuple(name for name in names if self.operations[name].waits is None or name in waiting)

    def seen(self, entries: Sequence[JournalEntry], most: int = 8) -> str:
        """Describe journal entries for a finding's evidence."""
        shown = "; ".join(self.describe(entry) for entry in entries[:most])
        return shown + (f"; … {len(entries) - most} more" if len(entries) > most else "")
