"""The shape of a run record, ``otmcp-run/3``: the one definition of its members. Pure.

The classes below serve as static types, for the check of every record that is read (:func:`check`), and for the JSON Schema
of the wheel (``otmcp docs run.schema.json``). They are of a record in memory; ``layout`` says what of it is in the file: the evidence, and
apart from it the judgement, which follows from the evidence. ``docs/run-record.md`` explains the members to authors of
other tools.

Times whose names end in ``_ns`` are of one clock, the machine's monotonic clock, in every process of a run. A member that a
reader does not know is no fault: later versions of the kit, and protocols of third parties, may add members.
"""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal, NotRequired, TypedDict, TypeVar

import msgspec

from ..core.journal_entry import JournalEntry, OwnerProcess
from ..core.text import LONGEST_NAME
from ..core.walls import Wall

__all__ = [
    "COUNTED",
    "ROLES",
    "SCHEMA",
    "AdapterFacts",
    "Altered",
    "Around",
    "Call",
    "CallJudgement",
    "Change",
    "Device",
    "DeviceEntry",
    "DeviceEvidence",
    "Ended",
    "EntryEvidence",
    "Environment",
    "Finding",
    "Footer",
    "Footprint",
    "Frames",
    "FreshSession",
    "Header",
    "Item",
    "ItemBody",
    "ItemDevice",
    "ItemHead",
    "ItemJudgement",
    "JournalEntry",
    "Kit",
    "Observation",
    "Phases",
    "Protocol",
    "Role",
    "Run",
    "Sample",
    "SampleJudgement",
    "SessionProof",
    "SessionRemark",
    "SessionStart",
    "Settings",
    "ShapeError",
    "State",
    "StoredBinding",
    "Stranger",
    "Subject",
    "ToldSecret",
    "ToolListing",
    "ToolSurface",
    "ToolsChanged",
    "check",
]

SCHEMA: Final = "otmcp-run/3"

_ONE_LINE = r"^(?![\s\S]*[\u0000-\u001f\u007f-\u009f])"
# The end of a text, alike in Python's and ECMAScript's regular expressions: "$" in Python also matches before a line feed.
_END = r"(?![\s\S])"

_RFC_3339 = (
    rf"^[0-9]{{4}}-[01][0-9]-[0-3][0-9]T[0-2][0-9]:[0-5][0-9]:[0-6][0-9](\.[0-9]+)?(Z|[+-][0-9]{{2}}:[0-9]{{2}}){_END}"
)
_HEXADECIMAL = rf"^[0-9a-f]+( [0-9a-f]+)*{_END}"
_IN_WORDS = {
    _ONE_LINE: "has a control character",
    _RFC_3339: "is no time as RFC 3339 has it",
    _HEXADECIMAL: "is no frame in hexadecimal digits",
}

Name = Annotated[str, msgspec.Meta(pattern=_ONE_LINE, max_length=LONGEST_NAME)]
"""A text that is printed in one line: it holds no control characters."""
Digest = Annotated[str, msgspec.Meta(pattern=rf"^sha256:[0-9a-f]{{64}}{_END}")]
RunId = Annotated[str, msgspec.Meta(pattern=rf"^[0-9a-f]{{32}}{_END}")]
Instant = Annotated[str, msgspec.Meta(pattern=_RFC_3339)]
"""A time of the wall clock as RFC 3339 has it."""
Count = Annotated[int, msgspec.Meta(ge=0)]
Restarts = Annotated[int, msgspec.Meta(ge=0, le=1_000_000)]
"""How often a device was started again: judging again repeats it, so it must be bounded."""
Nanoseconds = Annotated[int, msgspec.Meta(ge=0)]
Deadline = Annotated[float, msgspec.Meta(gt=0, le=300)]
Seconds = Annotated[float, msgspec.Meta(ge=0)]
Factor = Annotated[float, msgspec.Meta(gt=0)]

Role = Literal["task", "control", "setup", "warmup", "recovery"]
"""Purpose of a call or of an execution of steps. Only calls of the role ``task`` count for the benchmark."""
ROLES: tuple[Role, ...] = ("task", "control", "setup", "warmup", "recovery")
Counted = Literal[Role, "check"]
"""What calls are counted as: their role; calls of the role ``task`` in a check of the requirement suite are ``check``."""
COUNTED: tuple[Counted, ...] = (*ROLES, "check")
State = Literal["PASS", "FAIL", "NOT_APPLICABLE", "NOT_TESTABLE", "KIT_ERROR", "INTERRUPTED"]


class Protocol(TypedDict):
    """A protocol of the run. Distribution, version and digest name the package that judges a protocol which is not the kit's own."""

    key: str
    name: Name
    distribution: Name | None
    version: Name | None
    digest: Digest | None


class Kit(TypedDict):
    """The kit that ran and judged: its suite (``suite_digest``), everything that judges (``digest``)."""

    name: Name
    version: Name
    digest: Digest
    suite_digest: Digest
    protocols: list[Protocol]


class Deviation(TypedDict):
    """A failure that the vendor knows of; ``expires`` is the last day on which it is excused."""

    item: str
    reason: str
    expires: str


class StoredOutputRule(TypedDict):
    """The place of an output in an answer; see the subject file."""

    path: str | None
    regex: str | None
    split: str | None
    strip: str | None
    convert: str | None
    then: str | None
    wrap: bool
    means: NotRequired[str | dict[str, Any]]
    grid: NotRequired[list[float]]


class StoredOutcomeRule(TypedDict):
    """The meaning of an answer that looks like this; see the subject file."""

    success: bool
    is_error: bool | None
    text: str | None
    path: str | None


class StoredErrorRule(TypedDict):
    """Which code a failure with this text has; see the subject file."""

    text: str
    code: str


class StoredAnswering(TypedDict):
    """The rules for reading answers; see the subject file."""

    form: str
    outcome: list[StoredOutcomeRule]
    errors: list[StoredErrorRule]


class StoredDraw(TypedDict):
    """The values that the kit may give an argument of a named command, or that a device may hold; see the subject file."""

    values: list[Any]
    means: list[Any]
    lowest: float
    highest: float
    step: float


class StoredEffect(TypedDict):
    """A further request of a named command: an operation and the template of its inputs."""

    operation: str
    effect: dict[str, Any]
    documents: list[str]


class StoredCommand(TypedDict):
    """The effect of a named command, or the source of a named reading; see the subject file. ``then``: what comes after it, in this order.
    ``holds``: what the device may hold where a reading looks."""

    name: str
    draws: dict[str, StoredDraw]
    effect: dict[str, Any]
    documents: list[str]
    then: NotRequired[list[StoredEffect]]
    holds: NotRequired[StoredDraw]


class StoredBinding(TypedDict):
    """The way in which one tool performs an operation, or one case of it; see the subject file."""

    tool: str
    resource: bool
    blocking: bool
    arguments: dict[str, Any]
    outputs: dict[str, StoredOutputRule]
    answering: StoredAnswering
    when: dict[str, Any]
    offset: dict[str, float]
    names: dict[str, dict[str, Any]]
    convert: dict[str, str]
    max_age_s: NotRequired[float | None]
    keep: NotRequired[dict[str, StoredOutputRule]]
    topicless: NotRequired[bool]
    command: NotRequired[StoredCommand | None]


class ToolListing(TypedDict):
    """What ``tools/list`` says of a tool, as far as it is judged: as it came, whatever its shape. ``twice``: there is another entry of
    this name, which says the same (``alike``) or not (``other``); this is the first."""

    inputSchema: Any
    annotations: Any
    twice: NotRequired[Literal["alike", "other"]]


class ToolSurface(TypedDict):
    """What ``tools/list`` gives a model to read of one tool: whether it has a description, code points that a person does not see, the
    names of its arguments, and the bytes of name, title, description and schema."""

    described: bool
    unseen: list[str]
    arguments: list[Name]
    bytes: Count


class CallLimit(TypedDict):
    """The most tool calls that the adapter takes in ``per_s`` seconds, as its subject file declares."""

    calls: Count
    per_s: Deadline


class LimitTold(TypedDict):
    """Limits of the number that a target holds, in the device's own terms: of itself, of its change by one write, and the seconds that have
    to lie between two writes."""

    lowest: NotRequired[float]
    highest: NotRequired[float]
    step: NotRequired[float]
    every_s: NotRequired[Deadline]


class BoundsTold(TypedDict):
    """What the variant ``bounded`` of an adapter was told: patterns of targets that may be written, and limits by target."""

    allowed: list[str]
    limits: dict[str, LimitTold]


class AuditTold(TypedDict):
    """Where the records of an audit log have what (``fields``), where an answer names its record (``anchor``), whether values are written out
    (``digest``: they are not), whether the log is a file, and whether it has a verifier."""

    fields: dict[str, str]
    anchor: str
    digest: bool
    is_file: bool
    verifies: bool


class ApprovalTold(TypedDict):
    """The target whose writes a person approves, who is asked, what the client fills in for a yes, where a refusal has the number of the request,
    and the seconds after which an approval has ended."""

    target: str
    by: Literal["client", "outside"]
    form: dict[str, Any]
    id: str
    expires_s: NotRequired[Deadline]


class GovernanceTold(BoundsTold):
    """What the variant ``governed`` of an adapter was told: as for ``bounded``, whether there is a caller who may only read, and what it has of
    an audit log and of approvals."""

    viewer: bool
    audit: NotRequired[AuditTold]
    approval: NotRequired[ApprovalTold]


class ScopesTold(TypedDict):
    """The scopes of tokens with which a caller of the variant ``tokens`` may write, and with which it may read alone."""

    writes: str
    reads: NotRequired[str]


class Question(TypedDict):
    """What an adapter has asked the kit's client: a text, and the JSON Schema of the answer."""

    text: str
    form: dict[str, Any]


class TimesTold(TypedDict):
    """What follows from what the variant ``retimed`` of an adapter was told: seconds within which a call to a silent device has ended, and how
    often it sends a request that reads."""

    deadline_s: Deadline
    attempts: NotRequired[int]


class ReadyTold(TypedDict):
    """The tool that each start waits for until it says that the adapter is ready, and for how many seconds at most."""

    tool: Name
    within_s: Deadline


class Tested(TypedDict):
    """What the adapter's command started, as far as the kit can know it.

    ``program``: name of the file that is executed. ``files``: the adapter's own, which are found by its imports. ``packages``: lists of the
    distributions that are installed beside it, or a lock of its packages. ``image``: of a container, if the command names its digest.
    """

    program: Name
    program_sha256: Digest | None
    files: Count
    files_sha256: Digest | None
    packages: Count
    packages_sha256: Digest | None
    image: Name | None


class AdapterFacts(TypedDict):
    """One adapter under test: what its subject file says, and how its server introduced itself.

    ``unclaimed``: facet to the reason why it is not claimed. ``blocking``: operations whose call waits for what it answers.
    ``recovery_s``: the time within which work goes on after an outage. ``call_limit``: the most calls that the adapter takes.
    ``lists``: the lists of the protocol's own keys.
    ``cached``: operations whose answers may come from a cache, and how old they may be, in seconds.
    ``lacks``: inputs that no tool takes. ``offered``: voluntary facets that bindings and launches claim; absent where there are none.
    ``bounds``: what it was told to allow, where the subject file says so; ``times``, ``governance``, ``scopes`` and ``ready`` likewise.
    ``secured``: what each handshake of the variant ``secure`` has to have in the journal, where the subject file says what was configured. ``commands``: its named commands, each with the operation that it
    performs; absent where there are none.
    ``probes``: what is asked for where something must be refused.
    ``bindings``: every operation that was used; None for one that a Python function performs. ``unmet``: requirements of the
    envelope that its own answers do not meet. ``listing``: every tool that was called by a binding. ``unjudged``: outputs that the
    subject file does not say where to find. The members of the server are None when no session was ever opened.
    ``addressed_by``: keys of the subject file that hold the address of the mock device. ``transport``: that of MCP.
    ``calls``: how often each tool that it lists was called, 0 for one that never was; absent where it lists none.
    ``libraries``: known libraries that the adapter's own files import, to the name of the first such file. ``tested``: what its command
    started.
    """

    command: list[str]
    transport: NotRequired[Literal["stdio", "http"]]
    envelope: Literal["native", "synthesised"]
    recovery: str
    recovery_s: NotRequired[Deadline]
    call_limit: NotRequired[CallLimit | None]
    lists: NotRequired[dict[str, list[str]]]
    cached: NotRequired[dict[str, float]]
    deadline_s: Deadline
    unclaimed: dict[str, str]
    blocking: list[str]
    lacks: list[str]
    offered: NotRequired[list[str]]
    bounds: NotRequired[BoundsTold]
    times: NotRequired[TimesTold]
    governance: NotRequired[GovernanceTold]
    scopes: NotRequired[ScopesTold]
    secured: NotRequired[dict[str, str]]
    opened_by: NotRequired[Name]
    ready: NotRequired[ReadyTold]
    commands: NotRequired[dict[str, str]]
    readings: NotRequired[dict[str, str]]
    probes: dict[str, Any]
    bindings: dict[str, list[StoredBinding] | None]
    unjudged: list[str]
    unmet: list[str]
    listing: dict[str, ToolListing]
    server_name: Name | None
    server_version: Name | None
    protocol_version: Name | None
    tools: Count | None
    addressed_by: NotRequired[list[str]]
    calls: NotRequired[dict[str, Count]]
    libraries: NotRequired[dict[str, str]]
    tested: NotRequired[Tested]


class Subject(TypedDict):
    """The subject that was tested; ``adapters`` by key of their protocol."""

    name: Name
    version: Name
    digest: Digest
    deviations: list[Deviation]
    adapters: dict[str, AdapterFacts]


class Environment(TypedDict):
    """Place and time of the run; ``finished_at`` is None as long as the run goes on, and for ever when it was killed.

    ``walls``: None for each wall that the kit saw around every adapter whenever it was started, else why it was not there. A run without
    adapters, or of a kit without walls, has no such member.
    """

    python: Name
    platform: Name
    cpu_count: Count | None
    packages: dict[str, Name | None]
    started_at: Instant
    finished_at: Instant | None
    walls: NotRequired[dict[Wall, str | None]]


class Allowed(TypedDict):
    """Points that may be written, such as ``1/holding_registers/100..103``, and the numbers that may be written there."""

    target: str
    lowest: float
    highest: float


class Consent(TypedDict):
    """What a person allowed to be written to a real device, from the day ``date`` to the day ``expires``; ``outage``: to be cut off as well."""

    name: str
    date: str
    expires: str
    writable: list[Allowed]
    outage: NotRequired[Literal[True]]


class RealDevice(TypedDict):
    """A real device as the user named it: nothing is written without a consent."""

    url: str
    consent: Consent | None


class Settings(TypedDict):
    """The options of the run.

    ``soak``: checks took their long form; a run of a kit without long forms has no such member. ``protocols``: further protocols
    whose reference adapters were asked for; ``not_measured``: those whose adapter could not be started, each with a sentence that
    says why; a run of an earlier kit has neither. ``narrowed``: which options make
    the run say less than a full run, a sentence each. ``challenge``: the nonce that the seed follows from; absent where there is none.
    ``devices``: real devices by protocol, in a field record alone.
    """

    subject: str | None
    reps: Count
    repetitions: dict[str, Count]
    seed: int
    era: Literal["auto", "legacy"]
    time_scale: Factor
    soak: NotRequired[bool]
    suites: list[str]
    protocols: NotRequired[list[str]]
    not_measured: NotRequired[dict[str, str]]
    xdist_workers: Count
    narrowed: list[str]
    challenge: NotRequired[str]
    devices: NotRequired[dict[str, RealDevice]]


class Witnesses(TypedDict):
    """Who saw what at a real device: ``wire`` or ``mirror`` all requests, ``state`` what it holds; ``identity``: what the device says of itself."""

    wire: NotRequired[str]
    mirror: NotRequired[str]
    state: str
    identity: str | None


class Endpoint(TypedDict):
    """One place where adapters reached a device: a port of a host, the path of a pseudo terminal, or a cable, whose ``path`` is the adapters' interface
    and whose ``host`` and ``mac`` are the device's addresses."""

    name: str
    kind: Literal["tcp", "udp", "pty", "cable"]
    host: str
    port: Count
    path: str
    mac: NotRequired[str]


VariantName = Literal["rw", "ro", "no_control", "bounded", "retimed", "secure", "governed", "tokens"]
"""With writes enabled; disabled; enabled without control of the device itself; enabled within bounds; enabled with other limits of
time; enabled over the secure form of the protocol."""


class Device(TypedDict):
    """One device of the run: which adapter variant had it, in which process of pytest, and where it listened.

    ``endpoints``: the main one first. ``placeholders``: what ``{host}``, ``{port}`` and ``{url}`` of the subject file stood for.
    ``first``: sequence number at which its journal begins to be the run's; 0 for a device that the run itself has started.
    ``witnesses``: of a real device alone; a device without is a mock, or a broker.
    """

    protocol: str
    variant: VariantName
    worker: str
    endpoints: list[Endpoint]
    placeholders: dict[str, str]
    first: Count
    witnesses: NotRequired[Witnesses]


class Finding(TypedDict):
    """One fault of the adapter. ``cause``: what found the same cause first, None when this did; only MUST turns an item red."""

    code: str
    message: str
    requirement: str | None
    evidence: str | None
    strength: Literal["MUST", "SHOULD"]
    cause: str | None


class Frames(TypedDict):
    """The frames of a call, cut off after 16 KiB each; ``complaint`` is the official client's, ``faults`` are the reply's own."""

    request: str
    response: str | None
    failure: str | None
    complaint: str | None
    faults: list[Finding]


class Altered(TypedDict):
    """A change to the arguments that a binding makes: ``given`` ones, those that are ``left_out``, another ``tool``."""

    given: dict[str, Any]
    left_out: list[str]
    tool: str | None


class CallJudgement(TypedDict):
    """What follows of a call: its role, whether it met what was expected, and the outputs that were found in the answer."""

    role: Role
    ok: bool
    outputs: dict[str, Any]


class Call(CallJudgement):
    """One tool call.

    ``operation`` and ``inputs``: what the steps asked for; ``tool`` and ``arguments``: what the subject file makes of it.
    ``altered``: how the steps changed these arguments. ``taken``: the handles of earlier calls that they hold, by ``step.name``. ``group``: calls of the same number were made at the same time.
    ``starved_ns``: of a late answer, for how long the machine kept the adapter, or the kit, waiting for a processor meanwhile. ``frames``: where the envelope does not say it all; ``frames_sha256`` is the digest of these frames as they were,
    before any was cut off. ``envelope``: of the answer; with frames it was read from them. ``latency_ms`` and ``error_code`` are not in the
    file: they follow from the times and the envelope. Nor is ``variant`` where it is ``rw``, ``native`` and ``listed`` where they are true.
    """

    adapter: str
    variant: str
    operation: str
    inputs: dict[str, Any]
    tool: str
    arguments: dict[str, Any]
    group: Count
    sent_ns: Nanoseconds
    received_ns: Nanoseconds | None
    starved_ns: NotRequired[Nanoseconds]
    latency_ms: float | None
    envelope: dict[str, Any] | None
    native: bool
    listed: bool
    error_code: str | None
    altered: NotRequired[Altered]
    taken: NotRequired[dict[str, Any]]
    frames_sha256: NotRequired[str]
    frames: NotRequired[Frames]


class DeviceEntry(JournalEntry):
    """A journal entry and the device that has it; no ``variant`` is the one with writes enabled."""

    protocol: str
    variant: NotRequired[str]


class EntryEvidence(TypedDict):
    """What a record keeps of a journal entry: of a message its ``frame`` and what that does not say, of an event every member.

    Members are those of the entry that a reader makes of it, see ``JournalEntry``. An event has members of its kind beside these, and so
    has a message whose frame held a secret, or of a protocol whose frames the kit does not decode.
    """

    seq: Count
    t_ns: Nanoseconds
    connection: Count
    direction: Literal["in", "out"]
    origin: Literal["client", "former", "stranger", "unknown", "plant", "kit"]
    process: NotRequired[OwnerProcess]
    frame: NotRequired[Annotated[str, msgspec.Meta(pattern=_HEXADECIMAL)]]
    told: NotRequired[dict[str, Any]]
    kind: NotRequired[str]
    request: NotRequired[bool]
    state_changing: NotRequired[bool]
    answers: NotRequired[Count | None]


class DeviceEvidence(EntryEvidence):
    """What a record keeps of a journal entry, and the device that has it; see ``DeviceEntry``."""

    protocol: str
    variant: NotRequired[str]


class Started(TypedDict):
    """A device that was started again: how long it took, and when it accepted connections."""

    ms: float
    accepting_ns: Nanoseconds


SessionStart = tuple[Count, Count]
"""Number of a session among those of its adapter, and the sequence number of the device's journal at which it began."""


class FreshSession(TypedDict):
    """A session that replaced another one.

    ``opened``: sequence number of the device's journal at which it began. ``ended``: how the process before it ended, None when
    there was none, after ``seconds``.
    """

    spawned_ns: Nanoseconds
    opened: Count
    ended: str | None
    seconds: float


Change = tuple[list[str | int], Any]
"""A place in a device image, and its value there."""


class Footprint(TypedDict):
    """Figures of a session's processes together: resident memory in KiB, open descriptors, threads, processes.

    ``lazy_heap``: one of them takes memory up to a limit of its own before it frees any, as virtual machines do; absent where none does.
    """

    rss_kib: Count
    descriptors: Count
    threads: Count
    processes: Count
    lazy_heap: NotRequired[bool]


class HandshakeEra(TypedDict):
    """A start of the adapter in MCP's era of the handshake.

    ``opened``: number of the journal's entry at which the session began; None when it was not tried, because the session is of that
    era already or the adapter has shown that it does not speak it. ``revision``: that was agreed on; None without a session.
    """

    opened: Count | None
    revision: Name | None


class Observation(TypedDict):
    """One look at a device, between ``asked_ns`` and ``seen_ns``; ``at`` names the adapter: its protocol, with ``@ro`` for the one with writes disabled.

    It has one further member, which says what was seen without repeating what the record has elsewhere:

    ``session``: the adapter has another session. ``journal``: the slice, up to before the
    entry of this number. ``session_journal``: the entries from the first to before the second number. ``followed``: the session
    oracles have seen everything before this number. ``wait``: so many entries had matched when the waiting was over. ``image``:
    a device image; ``changes``: what differs in one from the last whole image of the device. ``stop``: the device was stopped,
    milliseconds; ``start``: it was started, its journal counts from 0 again. ``fresh_session``: the session was replaced.
    ``garbled``: number of the entry at which a session with a write switch that means nothing, or without the adapter's own certificate, began;
    None where there was none.
    ``handshake_era``: the session was replaced by one of MCP's era of the handshake, if the adapter speaks it.
    ``end``: the slice ends before this number, the next one begins there. ``process``: figures of the adapter's processes.
    ``tools``: digests of the tools that the adapter lists, and of their order. ``line_sent``: whether a line could be written to its standard input as it is.
    ``stderr``: the adapter's newest lines there. ``made_file``: whether a file was there that a shell makes of a text. ``listed``: the tools of the session, name to entry.
    ``surface``: what is to be read of each tool of the session.
    ``refuses``: whether a call of a tool that does not exist was answered by a failure; None where there was no answer.
    ``asked``: what the adapter has asked its client since the last look. ``audit``: the lines of its audit log that are new since then.
    ``verified``: whether its verifier takes the log for whole, by what was done to the log. ``cramped``: whether the log can grow no more.
    ``approved``: whether an approval outside of MCP was given. ``listens_beyond``: whether the adapter's HTTP server is open at an address of this
    machine that it was not told.
    """

    at: str
    asked_ns: Nanoseconds
    seen_ns: Nanoseconds
    session: NotRequired[SessionStart]
    journal: NotRequired[Count]
    session_journal: NotRequired[tuple[Count, Count]]
    followed: NotRequired[Count]
    wait: NotRequired[Count]
    image: NotRequired[dict[str, Any]]
    changes: NotRequired[list[Change]]
    stop: NotRequired[float]
    start: NotRequired[Started]
    fresh_session: NotRequired[FreshSession]
    garbled: NotRequired[Count | None]
    handshake_era: NotRequired[HandshakeEra]
    end: NotRequired[Count]
    process: NotRequired[Footprint]
    tools: NotRequired[str]
    line_sent: NotRequired[bool]
    stderr: NotRequired[list[str]]
    made_file: NotRequired[bool]
    refuses: NotRequired[bool | None]
    listed: NotRequired[dict[str, ToolListing]]
    surface: NotRequired[dict[str, ToolSurface]]
    asked: NotRequired[list[Question]]
    audit: NotRequired[list[str]]
    verified: NotRequired[dict[str, bool]]
    cramped: NotRequired[bool]
    approved: NotRequired[bool]
    listens_beyond: NotRequired[bool]


class Phases(TypedDict):
    """Phases of a recovery trial in milliseconds; None for what did not happen."""

    warm_call: float | None
    stop: float | None
    detect: float | None
    restart: float | None
    same_session: float | None
    same_session_attempts: Count
    same_session_ok: bool
    fresh_session: float | None
    fresh_session_ok: bool | None


class SampleJudgement(TypedDict):
    """What follows of a repetition."""

    ok: bool
    duration_ms: float
    findings: list[Finding]
    phases: Phases | None


class Sample(SampleJudgement):
    """One repetition: its calls, what its devices saw (``device``), what was looked at, and what was found."""

    repetition: Count
    calls: list[Call]
    device: list[DeviceEntry]
    observations: list[Observation]


class Around(TypedDict):
    """Set-up, warm-up or closing checks: executed like a repetition, but none; its findings are the item's."""

    role: Role
    calls: list[Call]
    device: list[DeviceEntry]
    observations: list[Observation]


class SessionProof(TypedDict):
    """How far a session is proven to talk to its mock device.

    ``proven``: the operation whose call proved it, None when none did. ``preferred``: the operation that proved a session of the
    adapter last. ``refused``: the item that could not prove it, and why; then nothing is written through it.
    """

    proven: str | None
    preferred: str | None
    refused: tuple[str, str] | None


class ItemDevice(TypedDict):
    """A device as an item found it.

    ``device``: its name in the run's ``devices``. ``begin``: sequence number at which the item began, seen between ``asked_ns``
    and ``seen_ns``. ``starts``: how often the device had been started again before. ``before``: the entries from the end of the
    last item that had the device to this one. ``missed``: entries before that which an item has taken that ended before it could keep them:
    nothing is judged by them, what came after them is read with them. ``quiet``: nobody called the adapter meanwhile. ``session``: its session, None when
    there was none yet. ``proof``: absent as long as no session of the adapter was to be proven.
    """

    device: str
    begin: Count
    asked_ns: Nanoseconds
    seen_ns: Nanoseconds
    accepting_ns: Nanoseconds
    starts: Restarts
    before: list[JournalEntry]
    missed: NotRequired[list[JournalEntry]]
    quiet: bool
    session: SessionStart | None
    proof: NotRequired[SessionProof]


class ToldSecret(TypedDict):
    """A secret that the adapter has told; the secret itself is not kept.

    ``variable``: of the adapter's environment. ``place``: where it was told. ``form``: how it was written.
    """

    variable: str
    place: str
    form: str


ToolsChanged = Literal["changed", "announced", "order"]
"""How the list of tools was another one at the end of a session: something else, something else as the adapter had announced, or the
same in another order."""


class SessionRemark(TypedDict):
    """The remarkable facts about a session apart from its replies, at the item's inspection of this number.

    ``unknown_ids``: of responses to requests that were never sent. ``repeated_ids``: of requests that were answered more than once.
    ``too_deep``: how many messages were nested deeper than can be read. ``leaks``: secrets that were told. ``tools_changed``: how the
    list of tools was another one at the end.
    """

    inspection: Count
    protocol: str
    overflow: bool
    died: str | None
    overstayed: str | None
    unknown_ids: list[str]
    repeated_ids: NotRequired[list[str]]
    too_deep: NotRequired[Count]
    stray_lines: Count
    first_stray: str
    leaks: NotRequired[list[ToldSecret]]
    tools_changed: NotRequired[ToolsChanged]


class Stranger(TypedDict):
    """A program other than the adapter under test that was at a device during an item; it was left out of the judgement.

    ``at``: name of the adapter whose device it is. ``origin``: as in the journal's entries. ``program``: its name; None if that
    cannot be known. ``connections``, ``messages``: how many it made and sent. ``sent``: the first of them in words.
    """

    at: str
    origin: Literal["former", "stranger", "unknown"]
    program: Name | None
    connections: Count
    messages: Count
    sent: list[str]


class Ended(TypedDict):
    """Why an item ended before its time, and whose fault that was."""

    fault_of: Literal["subject", "binding", "kit"]
    code: str
    message: str


class RequirementRow(TypedDict):
    """The result of an item for one requirement of the catalogue."""

    id: str
    status: str


class ItemJudgement(TypedDict):
    """What follows of an item, from the suite and from what was seen."""

    suite: str
    family: str
    title: str
    capabilities: list[str]
    requirements: list[str]
    status: State
    reason: str | None
    findings: list[Finding]
    requirement_rows: list[RequirementRow]
    strangers: NotRequired[list[Stranger]]


class ItemBody(ItemJudgement):
    """An item as its trial knows it, without the samples.

    ``began_ns``, ``ended_ns``: of its ``worker``, whose items follow one another. ``devices``: by the adapter's name in
    observations.
    """

    id: str
    planned: Count
    worker: str
    started_at: Instant
    finished_at: Instant
    began_ns: Nanoseconds
    ended_ns: Nanoseconds
    timing_ms: dict[str, float]
    devices: dict[str, ItemDevice]
    around: list[Around]
    sessions: list[SessionRemark]
    ended: Ended | None


class ItemHead(ItemBody):
    """An item without its samples. ``run_id``: of the run, again. ``order``: its place in the suite."""

    run_id: RunId
    order: Count


class Item(ItemHead):
    """One item of the suite."""

    samples: list[Sample]


class Footer(TypedDict):
    """Verdict and times, and what a reader counts: ``items``, ``samples`` and ``tool_calls`` are not in the file. Of a run that did not end
    there is only what is not optional here."""

    complete: bool
    reason: str | None
    items: Count
    samples: Count
    tool_calls: dict[Counted, Count]
    verdict: NotRequired[str]
    deviations: NotRequired[dict[str, list[str]]]
    elapsed_s: NotRequired[Seconds]
    breakdown_s: NotRequired[dict[str, float]]
    timing_valid: NotRequired[bool]
    digest: NotRequired[Digest]


class Header(TypedDict):
    """A run record without items and footer."""

    schema: Literal["otmcp-run/3"]
    run_id: RunId
    kit: Kit
    subject: Subject
    environment: Environment
    settings: Settings
    devices: dict[str, Device]


class Run(Header):
    """A run record: everything that the kit's reports, tables and certificates are made from."""

    items: list[Item]
    footer: Footer


class ShapeError(Exception):
    """A value does not have the shape of its definition; the message says where."""


T = TypeVar("T")


def check(value: object, shape: type[T], where: str) -> T:
    """Check a value, as read from JSON, against a class of this module; return it as it is.

    Args:
        where: name of the value in the error.

    Raises:
        ShapeError: the value has another shape.
    """
    try:
        msgspec.convert(value, shape)
    except msgspec.ValidationError as error:
        reason, _, place = str(error).partition(" - at `$")
        reason = next((words for pattern, words in _IN_WORDS.items() if repr(pattern) in reason), reason)
        raise ShapeError(f"{where}{place.rstrip('`')}: {reason[:1].lower()}{reason[1:]}") from None
    # The value that msgspec returns is a copy without the members that it does not know.
    return value  # type: ignore[return-value]
