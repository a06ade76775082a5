"""The content of a subject file, as frozen data. ``load`` reads the file; the package ``trial`` runs the adapters."""

from __future__ import annotations

import datetime
import hashlib
import inspect
import json
import os
import re
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, cast

from ..protocols.bounds import Bounds, Governance, Scopes, Times
from ..protocols.protocol import (
    ACCOUNT,
    BOUNDS,
    CLIENT_CERTIFICATE,
    COMMANDS,
    CONTROL_GUARD,
    GOVERNANCE,
    GUARD,
    LAUNCHES,
    READINGS,
    RECOVERY,
    SECURE,
    TIMES,
    TOKENS,
)
from ..protocols.registry import protocols
from ..record.schema import AdapterFacts, BoundsTold, GovernanceTold, ScopesTold, TimesTold
from .command import Command

__all__ = [
    "BOUNDED",
    "CONNECT",
    "GOVERNED",
    "NO_CONTROL",
    "READ_ONLY",
    "READ_WRITE",
    "RETIMED",
    "SECURE_FORM",
    "WITH_TOKENS",
    "Adapter",
    "Answering",
    "Binding",
    "Connect",
    "Deviation",
    "ErrorRule",
    "Function",
    "Governed",
    "OutcomeRule",
    "OutputRule",
    "Ready",
    "Subject",
    "Tokens",
    "Variant",
    "environment_names",
    "handles",
    "placeholders",
    "replace_placeholders",
    "replace_template",
]

READ_WRITE = "rw"
READ_ONLY = LAUNCHES[GUARD]
NO_CONTROL = LAUNCHES[CONTROL_GUARD]
BOUNDED = LAUNCHES[BOUNDS]
RETIMED = LAUNCHES[TIMES]
SECURE_FORM = LAUNCHES[SECURE]
GOVERNED = LAUNCHES[GOVERNANCE]
WITH_TOKENS = LAUNCHES[TOKENS]
"""The variants of an adapter: with writes enabled; with writes disabled; with writes enabled, without control of the device itself; with
writes enabled within bounds; with other limits of time; over the secure form of the protocol; with a policy; and over HTTP, for callers
with tokens. A subject need not have the last six."""

CONNECT = "connect"
"""The step whose handles every later call may take."""

_PLACEHOLDER = re.compile(r"\{(?:env:(?P<env>\w+)|(?P<name>\w+)(?::(?P<int>int))?)\}")

_SECRET_NAME = re.compile(
    r"(^|_)(PASSWORD|PASSWD|PASSPHRASE|PWD|SECRET|TOKEN|API_?KEY|ACCESS_KEY|PRIVATE_KEY|CREDENTIALS?|PSK)$",
    re.IGNORECASE,
)


_TELLING = 12
"""Characters of a fixed secret that is looked for: a shorter one, or a word, may be in what an adapter says for another reason."""


def _is_telling(value: str) -> bool:
    return len(value) >= _TELLING and any(map(str.isalpha, value)) and any(map(str.isdecimal, value))


def replace_placeholders(text: str, values: Mapping[str, str]) -> Any:
    """Replace ``{host}`` and its like, and ``{env:NAME}``; a text that is only ``{port:int}`` becomes a number."""
    whole = _PLACEHOLDER.fullmatch(text)
    if whole is not None and whole["int"] and whole["name"] in values:
        return int(values[whole["name"]])

    def value(match: re.Match[str]) -> str:
        if match["env"] is not None:
            return os.environ.get(match["env"], "")
        return values.get(match["name"], match[0])

    return _PLACEHOLDER.sub(value, text)


def environment_names(text: str) -> set[str]:
    """Return the names of the environment variables that ``{env:NAME}`` stands for in a text."""
    return {match["env"] for match in _PLACEHOLDER.finditer(text) if match["env"] is not None}


@dataclass(frozen=True, slots=True, kw_only=True)
class OutputRule:
    """The place of an output in an answer's document; the attributes are applied in this order.

    Attributes:
        path: JMESPath over the document; None for the document itself. A quoted ``"$name"`` is the member that is called like
            the operation's input of that name, as the tool was told it; for an input that is a list, the list of these members.
        regex: searched in the text found so far; its first group (or the whole match) is the value.
        split: separator that cuts the text into a list.
        strip: prefix that is taken off, as ``2:`` off a browse name.
        convert: ``int``, ``float``, ``bool``, ``string``, ``json``, ``python``, ``literal``, ``hex`` or ``bytes``; for a list, of
            each element.
        then: JMESPath over the result of ``convert``, with the same names.
        wrap: a single value becomes a list of one.
        means: of a named reading: what the value says that the device holds, as a computation such as ``$value * 10``, or as a table of
            words.
        grid: with a computation: the device holds this number, or one that lies some steps of this width from it, so that the nearest of
            these is meant: answers are rounded.
    """

    path: str | None = None
    regex: str | None = None
    split: str | None = None
    strip: str | None = None
    convert: str | None = None
    then: str | None = None
    wrap: bool = False
    means: str | Mapping[str, Any] | None = None
    grid: tuple[float, float] | None = None

    def about(self, told: Mapping[str, object]) -> OutputRule:
        """Return the rule for a call of which the tool was told these inputs."""
        if '"$' not in f"{self.path}{self.then}":
            return self

        def named(path: str | None) -> str | None:
            return None if path is None else _ASKED_MEMBER.sub(lambda match: _member(match, told), path)

        return replace(self, path=named(self.path), then=named(self.then))


_ASKED_MEMBER = re.compile(r'"\$(\w+)"')


def _member(match: re.Match[str], told: Mapping[str, object]) -> str:
    """Return the part of a JMESPath that selects what is called like an input; a name that is no input's is a key like any other."""
    if match[1] not in told:
        return match[0]
    value = told[match[1]]
    names = [json.dumps(_text(each), ensure_ascii=False) for each in (value if isinstance(value, list) else [value])]
    return f"[{', '.join(names)}]" if isinstance(value, list) else names[0]


@dataclass(frozen=True, slots=True, kw_only=True)
class OutcomeRule:
    """The meaning of answers that match; all conditions that are given must hold.

    Attributes:
        success: matching answers claim success, not failure.
        is_error: the result's ``isError``.
        text: regular expression, searched in the answer's whole text.
        path: JMESPath over the document; holds when it finds something true in JMESPath's sense.
    """

    success: bool
    is_error: bool | None = None
    text: str | None = None
    path: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorRule:
    """The code of the error registry for failures whose text matches the regular expression ``text``."""

    text: str
    code: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Answering:
    """The rules by which an adapter's answers are read.

    Attributes:
        form: ``envelope`` (the kit's own envelope), else the place of the document that outcome rules and outputs are
            about: ``structured`` (``structuredContent``), ``json`` (the text of all blocks, as JSON), ``text`` (the text of
            all blocks, as it is), ``texts`` (the list of the blocks, each decoded where it is JSON).
        outcome: first match wins; without a match ``isError`` decides.
        errors: first match wins; without a match the code is ``unclassified``.
    """

    form: str = "envelope"
    outcome: tuple[OutcomeRule, ...] = ()
    errors: tuple[ErrorRule, ...] = ()

    @property
    def native(self) -> bool:
        """The adapter answers in the kit's envelope."""
        return self.form == "envelope"


def _is_one_of(given: object, wanted: object) -> bool:
    return given == wanted or (isinstance(wanted, list) and not isinstance(given, list) and given in wanted)


@dataclass(frozen=True, slots=True, kw_only=True)
class Binding:
    """The tool call that performs an abstract operation, or one case of the operation.

    Attributes:
        tool: name of the MCP tool, or URI of the resource.
        resource: ``tool`` is the URI of a resource, which is read.
        blocking: the call waits for the messages that it returns.
        topicless: the messages that it returns are payloads without their topics.
        arguments: template; a string ``"$name"`` stands for the operation's input of that name, keeping its type, ``"$step.name"``
            for a handle that an earlier call kept, and ``{host}`` and its like are replaced as in a launch command.
        outputs: output name to its place in the answer.
        when: input values for which this binding is meant, a list for any of them; empty for all.
        offset: number added to an input.
        names: input name to the vendor's name for each of its values.
        convert: input name to the type in which the tool wants it.
        answering: how the tool's answers are read.
        max_age_s: how old an answer may be that comes from a cache, as declared; None for one that must not.
        keep: handle to its place in the answer, for the arguments of later calls of the session.
        command: the effect of a named command, or the source of a named reading; then the template's names are those of the values that it
            draws, and the binding is for the inputs that it can express. None for a tool that is the operation itself.
    """

    tool: str
    arguments: Mapping[str, Any]
    outputs: Mapping[str, OutputRule]
    answering: Answering
    when: Mapping[str, Any]
    offset: Mapping[str, float]
    names: Mapping[str, Mapping[str, Any]]
    convert: Mapping[str, str]
    resource: bool = False
    blocking: bool = False
    topicless: bool = False
    max_age_s: float | None = None
    keep: Mapping[str, OutputRule] = field(default_factory=dict)
    command: Command | None = None

    def fill(
        self,
        inputs: Mapping[str, object],
        endpoint: Mapping[str, str],
        taken: Mapping[str, object] = MappingProxyType({}),
    ) -> dict[str, Any]:
        """Return the tool's arguments for these inputs and handles; the argument for one that is not given is left out."""
        given = {**self._values(inputs), **taken}
        template = _without(self.arguments, (placeholders(self.arguments) | handles(self.arguments)) - given.keys())
        filled: dict[str, Any] = replace_template(template, given, endpoint)
        return filled

    def _values(self, inputs: Mapping[str, object]) -> dict[str, Any]:
        return self.told(inputs) if self.command is None else self.command.arguments(inputs) or {}

    def told(self, inputs: Mapping[str, object]) -> dict[str, Any]:
        """Return these inputs as the tool is told them: with its names, addresses and types."""
        return {name: self._prepared(name, value) for name, value in inputs.items()}

    def outputs_for(self, inputs: Mapping[str, object]) -> Mapping[str, OutputRule]:
        """Return where the outputs are in the answer to a call with these inputs."""
        told = self._values(inputs)
        return {name: rule.about(told) for name, rule in self.outputs.items()}

    def _prepared(self, name: str, value: Any) -> Any:
        if isinstance(value, list) and name in self.names:
            return [self._prepared(name, element) for element in value]
        if name in self.offset:
            value = value + self.offset[name]
        if name in self.names:
            value = self.names[name].get(str(value), value)
        if name in self.convert:
            value = _CONVERSIONS[self.convert[name]](value)
        return value

    def fits(self, inputs: Mapping[str, object]) -> bool:
        """Tell whether this binding is for these inputs."""
        if self.command is not None:
            return self.command.arguments(inputs) is not None
        return all(_is_one_of(inputs.get(name), value) for name, value in self.when.items())

    @property
    def follows(self) -> bool:
        """Whether the call takes a handle that another operation keeps."""
        return any(not name.startswith(f"{CONNECT}.") for name in handles(self.arguments))

    def mentions(self, name: str) -> bool:
        """Tell whether the template, or the effect of a command, has a place for this input."""
        return name in (placeholders(self.arguments) if self.command is None else self.command.effect)


def _text(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value)


_CONVERSIONS: Mapping[str, Callable[[Any], Any]] = {
    "string": _text,
    "int": int,
    "float": float,
    "bool": bool,
    "hex": lambda value: f"{int(value):04x}",
    "json": json.loads,
    "list": lambda value: [value],
}


def replace_template(template: object, inputs: Mapping[str, object], endpoint: Mapping[str, str]) -> Any:
    """Return a template with inputs and endpoint filled in."""
    if isinstance(template, str):
        return inputs[template[1:]] if template.startswith("$") else replace_placeholders(template, endpoint)
    if isinstance(template, Mapping):
        return {key: replace_template(value, inputs, endpoint) for key, value in template.items()}
    if isinstance(template, list):
        return [replace_template(value, inputs, endpoint) for value in template]
    return template


def _without(template: Any, absent: set[str]) -> Any:
    """Return a template without its places for these inputs."""
    if isinstance(template, Mapping):
        return {key: _without(value, absent) for key, value in template.items() if not _stands_for(value, absent)}
    if isinstance(template, list):
        return [_without(value, absent) for value in template if not _stands_for(value, absent)]
    return template


def _stands_for(template: object, names: set[str]) -> bool:
    return isinstance(template, str) and template.startswith("$") and template[1:] in names


def placeholders(template: object) -> set[str]:
    """Return the names of the inputs that a template has a place for."""
    return {name for name in _names(template) if "." not in name}


def handles(template: object) -> set[str]:
    """Return the handles that a template has a place for, each as ``step.name``."""
    return {name for name in _names(template) if "." in name}


def _names(template: object) -> set[str]:
    if isinstance(template, str):
        return {template[1:]} if template.startswith("$") else set()
    if isinstance(template, Mapping):
        return set().union(*map(_names, template.values()))
    if isinstance(template, list):
        return set().union(*map(_names, template))
    return set()


@dataclass(frozen=True, slots=True, kw_only=True)
class Function:
    """An operation performed by a Python function of the subject's bindings file.

    Attributes:
        call: ``async def operation(tools, **inputs) -> outputs``; see :mod:`pytest_otmcp.subject.functions`.
        parameters: names of its parameters.
        uses: those of them that its code does something with.
    """

    name: str
    call: Callable[..., Awaitable[Mapping[str, Any]]]
    parameters: frozenset[str] = frozenset()
    uses: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True, kw_only=True)
class Connect:
    """A tool call that is made before all others.

    Attributes:
        again: the call is repeated after an outage.
        keep: as of a binding.
    """

    tool: str
    arguments: Mapping[str, Any]
    again: bool
    keep: Mapping[str, OutputRule] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Ready:
    """A tool that says, after a start, when the adapter can work.

    Attributes:
        answering: the rules by which its answer is read; a success says that the adapter is ready.
    """

    tool: str
    arguments: Mapping[str, Any]
    answering: Answering


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant:
    """One way to launch an adapter.

    Attributes:
        command: argument vector; ``{host} {port} {url} {NAME_port} {serial} {interface} {device_mac} {device_ip} {python} {dir} {work}
            {http_port} {local_port}``, and for the secure form of a protocol ``{ca} {cert} {key} {user} {password}``, for tokens ``{issuer} {issuer_keys}
            {audience}``, are replaced.
        env: environment beyond the kit's allow-list, with the same replacements.
        cwd: working directory, or None for the kit's.
        files: name below ``{work}``, a fresh directory, to content with the same replacements.
    """

    command: tuple[str, ...]
    env: Mapping[str, str]
    cwd: Path | None
    files: Mapping[str, str]

    def for_endpoint(self, values: Mapping[str, str]) -> Variant:
        """Return this variant with the placeholders replaced."""

        def texts(table: Mapping[str, str]) -> dict[str, str]:
            return {name: str(replace_placeholders(value, values)) for name, value in table.items()}

        return Variant(
            command=tuple(str(replace_placeholders(part, values)) for part in self.command),
            env=texts(self.env),
            cwd=self.cwd,
            files=texts(self.files),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Openings:
    """What the walls around an adapter leave open to it.

    Attributes:
        why_outside: why it needs the network of the machine; empty where it does not.
        reads, writes: paths.
    """

    why_outside: str = ""
    reads: tuple[Path, ...] = ()
    writes: tuple[Path, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class CallLimit:
    """The most tool calls that an adapter takes within a time; it refuses what is more.

    Attributes:
        calls: number of calls.
        per_s: in so many seconds.
    """

    calls: int
    per_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Governed:
    """The launch with a policy.

    Attributes:
        told: what is stated of it, as far as it is judged.
        viewer: environment with which the caller may write nothing; None where there is no such caller.
        log: the file with the audit records; empty where there is none.
        records, verify, approve, decline: commands that print them, verify the log, and approve or decline a request; empty where there
            is none.
    """

    told: Governance
    viewer: Mapping[str, str] | None
    log: str = ""
    records: tuple[str, ...] = ()
    verify: tuple[str, ...] = ()
    approve: tuple[str, ...] = ()
    decline: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Tokens:
    """The launch over HTTP for callers with tokens.

    Attributes:
        url: of the MCP endpoint, which is the audience of tokens.
        scopes: of the callers.
    """

    url: str
    scopes: Scopes


@dataclass(frozen=True, slots=True, kw_only=True)
class Adapter:
    """One adapter under test.

    Attributes:
        protocol: its key.
        directory: of the subject file.
        variants: ``rw`` (writes enabled) and ``ro`` (writes disabled), and those of ``no_control``, ``bounded``,
            ``retimed``, ``secure``, ``governed`` and ``tokens`` that the file has.
        bounds: what the variant ``bounded`` was told; None where there is none.
        times: what follows from what the variant ``retimed`` was told; None where there is none.
        governed: what the variant ``governed`` was told; None where there is none.
        secured: what the journal has of each handshake of the variant ``secure``, as far as the file says what was configured.
        tokens: where the variant ``tokens`` is, and for whom; None where there is none.
        operations: abstract operation name to the bindings that perform it, in the order in which they are tried, or to a
            function.
        answering: how answers are read where a binding does not say otherwise.
        unclaimed: facet to the reason why the adapter does not have it.
        connect: the tool call before all others, or None.
        ready: what each start waits for, or None.
        recovery: after an outage work goes on in the ``same_session``, after the ``connect_step``, or in a ``new_session``.
        recovery_s: the time within which work goes on after an outage.
        call_limit: the most tool calls that the adapter takes in a time, or None.
        lists: the lists of the protocol's own keys, such as ``command_topics``, by key.
        probes: name to the input that tasks use where the adapter must refuse.
        secrets: names of environment variables whose values must not be shown.
        secret_env: names of environment variables that get a random value in each session.
        transport: ``stdio`` or ``http``.
        url: of the MCP endpoint, when the transport is ``http``.
        era: MCP protocol era of the adapter's sessions, or None for that of the run.
        deadline_s: the time within which every call must have answered.
        start_timeout_s: the time within which the adapter must have finished its handshake.
        openings: in the walls around the adapter.
    """

    protocol: str
    directory: Path
    variants: Mapping[str, Variant]
    operations: Mapping[str, tuple[Binding, ...] | Function]
    answering: Answering
    unclaimed: Mapping[str, str]
    connect: Connect | None
    recovery: str
    recovery_s: float
    call_limit: CallLimit | None
    lists: Mapping[str, tuple[str, ...]]
    probes: Mapping[str, Any]
    secrets: tuple[str, ...]
    secret_env: tuple[str, ...]
    transport: Literal["stdio", "http"]
    url: str | None
    era: str | None
    deadline_s: float
    start_timeout_s: float
    bounds: Bounds | None = None
    times: Times | None = None
    governed: Governed | None = None
    secured: Mapping[str, str] = field(default_factory=dict)
    tokens: Tokens | None = None
    ready: Ready | None = None
    openings: Openings = field(default_factory=Openings)

    def url_of(self, variant: str) -> str | None:
        """Return the MCP endpoint of a variant; None for one over stdio."""
        return self.tokens.url if variant == WITH_TOKENS and self.tokens is not None else self.url

    def why_not_testable(self, facet: str) -> str | None:
        """Return what is missing for a claimed facet to be exercised; None when nothing is."""
        operation, _, optional = facet.partition(".")
        if operation in (*LAUNCHES, RECOVERY, COMMANDS, READINGS, CLIENT_CERTIFICATE, ACCOUNT):
            return None
        bound = self.operations.get(operation)
        if bound is None:
            return f"no tool is bound to the operation {operation!r}"
        if optional and isinstance(bound, tuple) and not self._has_place(operation, optional):
            return f"no binding of {operation!r} has a place for ${optional}"
        return None

    def secret_values(self) -> set[str]:
        """Return the values that must not be shown: of variables that are declared secret or are named like secrets."""
        found: set[str] = set()
        for variant in self.variants.values():
            named = {name: str(replace_placeholders(value, {})) for name, value in variant.env.items()}
            texts = (*variant.command, *variant.env.values(), *variant.files.values())
            named |= {name: os.environ.get(name, "") for name in set().union(*map(environment_names, texts))}
            found |= {
                value
                for name, value in named.items()
                if (name in self.secrets or _SECRET_NAME.search(name)) and not _PLACEHOLDER.fullmatch(value)
            }
        return found

    def telling_secrets(self, env: Mapping[str, str]) -> dict[str, str]:
        """Return those of the declared secrets in an environment that cannot be meant by anything else an adapter says."""
        return {name: value for name in self.secrets if _is_telling(value := env.get(name, ""))}

    @property
    def write_switch(self) -> str | None:
        """The environment variable whose value is all that tells the variants apart; None where there is no such one."""
        enabled, disabled = self.variants[READ_WRITE], self.variants[READ_ONLY]
        if replace(enabled, env=disabled.env) != disabled:
            return None
        names = enabled.env.keys() | disabled.env.keys()
        differing = [name for name in names if enabled.env.get(name) != disabled.env.get(name)]
        return differing[0] if len(differing) == 1 else None

    @property
    def blocking(self) -> tuple[str, ...]:
        """The operations that are performed by a call that waits for the messages that it returns."""
        return tuple(
            name
            for name, bound in self.operations.items()
            if isinstance(bound, tuple) and any(binding.blocking for binding in bound)
        )

    @property
    def cached(self) -> dict[str, float]:
        """The operations whose answers may come from a cache, and how old they may be."""
        return {
            name: case.max_age_s
            for name, bound in self.operations.items()
            if isinstance(bound, tuple)
            for case in bound
            if case.max_age_s is not None
        }

    @property
    def commands(self) -> dict[str, str]:
        """The named commands, each with the operation that it performs."""
        return self._named(readings=False)

    @property
    def readings(self) -> dict[str, str]:
        """The named readings, each with the operation that it performs."""
        return self._named(readings=True)

    def _named(self, *, readings: bool) -> dict[str, str]:
        return {command.name: operation for operation, command in self.vocabulary(readings=readings)}

    def vocabulary(self, *, readings: bool) -> list[tuple[str, Command]]:
        """Return the named readings, or else the named commands, each with the operation that it performs."""
        return [
            (name, case.command)
            for name, bound in self.operations.items()
            if isinstance(bound, tuple)
            for case in bound
            if case.command is not None and (case.command.holds is not None) == readings
        ]

    @property
    def offered(self) -> tuple[str, ...]:
        """The voluntary facets that bindings, launches, named commands and named readings claim."""
        known = protocols()[self.protocol]
        return tuple(
            facet for facet in known.facets if known.is_voluntary(facet) and self._has_place(*facet.partition(".")[::2])
        )

    def _has_place(self, operation: str, part: str) -> bool:
        if operation in LAUNCHES:
            return LAUNCHES[operation] in self.variants
        if operation == COMMANDS:
            return bool(self.commands)
        if operation == READINGS:
            return bool(self.readings)
        if operation == CLIENT_CERTIFICATE:
            return SECURE_FORM in self.variants and "{cert}" in str(self.variants[SECURE_FORM])
        if operation == ACCOUNT:
            launch = str(self.variants.get(SECURE_FORM, ""))
            return "{user}" in launch and "{password}" in launch
        bound = self.operations.get(operation)
        if bound is None:
            return False
        if not part:
            return True
        if isinstance(bound, Function):
            return part in bound.parameters
        return any(binding.mentions(part) or part in binding.outputs for binding in bound)

    def facts(self) -> AdapterFacts:
        """Return what ``run.json`` says about the test of this adapter; its server's facts are added later."""
        facts: AdapterFacts = {
            "command": list(self.variants["rw"].command),
            "transport": self.transport,
            "envelope": "native" if self.answering.native else "synthesised",
            "recovery": self.recovery,
            "recovery_s": self.recovery_s,
            "call_limit": None if (limit := self.call_limit) is None else {"calls": limit.calls, "per_s": limit.per_s},
            "lists": {key: list(values) for key, values in self.lists.items()},
            "cached": self.cached,
            "deadline_s": self.deadline_s,
            "unclaimed": dict(self.unclaimed),
            "blocking": list(self.blocking),
            "lacks": sorted(self.missing_inputs()),
            "probes": dict(self.probes),
            "bindings": {},
            "unjudged": sorted(self.unjudged()),
            "unmet": [],
            "listing": {},
            "server_name": None,
            "server_version": None,
            "protocol_version": None,
            "tools": None,
        }
        if self.offered:
            facts["offered"] = list(self.offered)
        if self.commands:
            facts["commands"] = self.commands
        if self.readings:
            facts["readings"] = self.readings
        if self.bounds is not None:
            facts["bounds"] = cast(BoundsTold, self.bounds.as_record())
        if self.times is not None:
            facts["times"] = cast(TimesTold, self.times.as_record())
        if self.governed is not None:
            facts["governance"] = cast(GovernanceTold, self.governed.told.as_record())
        if self.secured:
            facts["secured"] = dict(self.secured)
        if self.tokens is not None:
            facts["scopes"] = cast(ScopesTold, self.tokens.scopes.as_record())
        if self.connect is not None and self.connect.keep:
            facts["opened_by"] = self.connect.tool
        if self.ready is not None:
            facts["ready"] = {"tool": self.ready.tool, "within_s": self.start_timeout_s}
        return facts

    def missing_inputs(self) -> set[str]:
        """Return the inputs that no binding has a place for, such as ``subscribe.qos``."""
        bound = {
            name: operation
            for name, operation in protocols()[self.protocol].operations.items()
            if name in self.operations
        }
        optional = {
            f"{name}.{optional}"
            for name, operation in bound.items()
            for optional in operation.optional
            if self.why_not_testable(f"{name}.{optional}") is not None
        }
        return optional | {
            f"{name}.{given}"
            for name, operation in bound.items()
            for given in operation.inputs
            if given != operation.waits and not self._takes(self.operations[name], given)
        }

    @staticmethod
    def _takes(bound: Function | tuple[Binding, ...], given: str) -> bool:
        """Tell whether what a tool is asked depends on an input."""
        if isinstance(bound, Function):
            return given in bound.uses
        return any(
            case.command is not None or case.resource or case.mentions(given) or given in case.when for case in bound
        )

    def unjudged(self) -> set[str]:
        """Return the outputs that tasks could judge if the subject file said where they are, and ``messages.topic`` where messages have none."""
        topicless = {
            f"{name}.topic"
            for name, bound in self.operations.items()
            if isinstance(bound, tuple) and any(binding.topicless for binding in bound)
        }
        return topicless | {
            f"{name}.{output}"
            for name, bound in self.operations.items()
            if isinstance(bound, tuple)
            for output in protocols()[self.protocol].operations[name].outputs
            if any(output not in binding.outputs for binding in bound)
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Deviation:
    """A failure that the vendor knows of.

    Attributes:
        item: id of the item that fails.
        reason: why it fails.
        expires: the last day on which it is excused.
    """

    item: str
    reason: str
    expires: datetime.date


@dataclass(frozen=True, slots=True, kw_only=True)
class Subject:
    """The subject under test: one adapter for each protocol it speaks.

    Attributes:
        name, version: as printed in reports.
        adapters: protocol to adapter.
        source: the subject file.
        deviations: failures that the vendor knows of.
        digest: ``sha256:…`` over the subject file and its bindings files.
    """

    name: str
    version: str
    adapters: Mapping[str, Adapter]
    source: Path
    deviations: tuple[Deviation, ...] = ()
    digest: str = "sha256:" + hashlib.sha256(b"").hexdigest()

    def sources(self) -> list[Path]:
        """Return the subject file and its bindings files."""
        functions = [
            operation
            for adapter in self.adapters.values()
            for operation in adapter.operations.values()
            if isinstance(operation, Function)
        ]
        return [self.source, *dict.fromkeys(Path(inspect.getfile(function.call)) for function in functions)]
