"""The grammar of a subject file: each key with its kind, its meaning and its default, stated once. Pure.

``load`` reads files by it, ``schema`` writes it as JSON Schema for editors, and the tests compare the documentation with it.
The keys about an adapter's operations come from the description of its protocol.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from ..core.error_registry import registry
from ..protocols.protocol import Operation, OtProtocol
from .answers import UNCLASSIFIED
from .command import is_computation
from .kinds import (
    ANYTHING,
    COUNT,
    DATE,
    FLAG,
    NUMBER,
    PATH,
    REASON,
    REGEX,
    SECONDS,
    STRING,
    TEXT,
    Kind,
    OneOf,
    Scalar,
    at_most,
    strings,
)
from .tables import ByType, Key, ListOf, MapOf, Named, Rule, Table, Template

__all__ = ["LONGEST_RECOVERY_S", "OUTPUT_TABLE", "adapter_table", "binding_table", "command_table", "subject_file"]

_VARIANTS = ("rw", "ro")
LONGEST_RECOVERY_S = 5.0
"""Requirement REC-001, the bound of level Silver."""
OLDEST_STATUS_S = 5.0
"""Requirement REC-002: a status may be as old as one keep-alive; no longer one is accepted."""
_ARGV = Named("argv", strings("the argument vector", filled=True))
_TABLE = MapOf(ANYTHING)
_LAUNCH = {
    "command": Key(_ARGV, "The argument vector, instead of the adapter's."),
    "args": Key(strings("further arguments"), "Further arguments.", default=[]),
    "env": Key(MapOf(STRING), "Further environment.", default={}),
    "files": Key(MapOf(STRING), "Further files.", default={}),
}
_VARIANT = Named("variant", Table(_LAUNCH))
_LIMIT = Named(
    "limit",
    Table(
        {
            "lowest": Key(NUMBER, "The lowest number that may be written."),
            "highest": Key(NUMBER, "The highest number that may be written."),
            "step": Key(NUMBER, "The most by which one write may change the number."),
            "every_s": Key(SECONDS, "Seconds that have to lie between two writes."),
        },
        rules=(Rule(holds=bool, objection="expected a limit, found none", described={"minProperties": 1}),),
    ),
)
_BOUNDED = Named(
    "bounded",
    Table(
        {
            **_LAUNCH,
            "allowed": Key(
                strings("names of targets"),
                "Targets that it was told to allow; '10..19' in a name stands for these numbers, '*' for any characters but '/'.",
                default=[],
            ),
            "limits": Key(
                MapOf(_LIMIT), "Target to the limits that it was told, in the device's own terms.", default={}
            ),
        },
        rules=(
            Rule(
                holds=lambda table: bool(table.get("allowed") or table.get("limits")),
                objection="expected 'allowed' or 'limits', which say what the adapter was told",
                described={"anyOf": [{"required": ["allowed"]}, {"required": ["limits"]}]},
            ),
        ),
    ),
)
_RETIMED = Named(
    "retimed",
    Table(
        {
            **_LAUNCH,
            "deadline_s": Key(
                SECONDS, "Time within which a call to a silent device has ended with these settings.", required=True
            ),
            "attempts": Key(COUNT, "How often such a call sends its request, where it is one that reads."),
        }
    ),
)
_FIELDS = {
    "time": "its time, RFC 3339 in UTC",
    "principal": "who has called",
    "tool": "the tool's name",
    "decision": "whether it was allowed",
    "outcome": "what became of it",
}
_AUDIT = Named(
    "audit",
    Table(
        {
            "path": Key(TEXT, "The file with the records, each a JSON object on a line: {work}/NAME."),
            "records": Key(_ARGV, "A command that prints the records so, where the log is no such file."),
            "verify": Key(
                _ARGV,
                "A command that ends with 0 for a log that is whole, and otherwise for any other; {anchor} is what the newest answer has "
                "at 'anchor'.",
            ),
            "anchor": Key(PATH, "JMESPath in an answer: the name of its record.", default="meta.audit_id"),
            "digest": Key(FLAG, "Records have digests of the values that are written.", default=False),
            "fields": Key(
                Table(
                    {
                        name: Key(PATH, f"JMESPath in a record: {meaning}.", default=name)
                        for name, meaning in _FIELDS.items()
                    }
                ),
                "What is where in a record.",
                default={name: name for name in _FIELDS},
            ),
        },
        rules=(
            Rule(
                holds=lambda table: ("path" in table) != ("records" in table),
                objection="expected 'path' or 'records', which say where the records are",
                described={"oneOf": [{"required": ["path"]}, {"required": ["records"]}]},
            ),
            Rule(
                holds=lambda table: re.fullmatch(r"\{work\}/[^/]+", str(table.get("path", "{work}/x"))) is not None,
                objection="expected {work}/NAME: the kit changes this file, and it must be nobody else's",
                at="path",
                described={"properties": {"path": {"pattern": r"^\{work\}/[^/]+$"}}},
            ),
        ),
    ),
)
_APPROVAL = Named(
    "approval",
    Table(
        {
            "target": Key(TEXT, "A target with limits that is written with a person's approval alone.", required=True),
            "by": Key(
                OneOf(("client", "outside")), "Who is asked: the MCP client, or somebody else.", default="client"
            ),
            "form": Key(
                MapOf(ANYTHING), "What the client fills into the form for a yes, beside truth values.", default={}
            ),
            "approve": Key(_ARGV, "A command that approves the request {approval}, for 'outside'."),
            "decline": Key(_ARGV, "A command that declines it, for the console."),
            "id": Key(
                PATH,
                "JMESPath in a refusal, or in its text where that is no JSON: the request's name.",
                default="error.details.approval_id",
            ),
            "expires_s": Key(SECONDS, "Seconds after which an approval has ended."),
        },
        rules=(
            Rule(
                holds=lambda table: table.get("by") != "outside" or "approve" in table,
                objection="by = 'outside' needs 'approve', the command that approves a request",
                described={
                    "if": {"properties": {"by": {"const": "outside"}}, "required": ["by"]},
                    "then": {"required": ["approve"]},
                },
            ),
        ),
    ),
)


def _approves_a_number(table: Mapping[str, Any]) -> bool:
    target = table.get("approval", {}).get("target")
    return target is None or {"lowest", "highest"} <= table.get("limits", {}).get(target, {}).keys()


_SECURED = Named(
    "governed",
    Table(
        {
            **_LAUNCH,
            "allowed": Key(
                strings("names of targets", filled=True),
                "Targets that the policy lets the caller write; as for 'bounded'.",
                required=True,
            ),
            "limits": Key(MapOf(_LIMIT), "Target to its limits in the policy, in the device's own terms.", default={}),
            "viewer": Key(MapOf(STRING), "Further environment with which the caller may write nothing."),
            "audit": Key(_AUDIT, "Where the audit records are, and what is in them."),
            "approval": Key(_APPROVAL, "What needs a person's approval, and how it is given."),
        },
        rules=(
            Rule(
                holds=_approves_a_number,
                objection="the target of 'approval' needs 'lowest' and 'highest' in 'limits': the kit writes numbers within and beyond",
                described={},
            ),
        ),
    ),
)
_TOKENS = Named(
    "tokens",
    Table(
        {
            **_LAUNCH,
            "url": Key(TEXT, "The MCP endpoint, and the audience of tokens: {audience}.", required=True),
            "writes": Key(TEXT, "The scopes, with blanks in between, of a caller who may write.", required=True),
            "reads": Key(TEXT, "The scopes of a caller who may read and not write."),
        }
    ),
)
_CALL_LIMIT = Named(
    "call_limit",
    Table(
        {
            "calls": Key(COUNT, "Number of calls.", required=True),
            "per_s": Key(SECONDS, "In so many seconds.", required=True),
        }
    ),
)
_ISOLATION = Named(
    "isolation",
    Table(
        {
            "network": Key(
                OneOf(("own", "host")),
                "'host' for an adapter that needs more of the network than its device, with the 'reason'.",
                default="own",
            ),
            "reason": Key(REASON, "Why it needs the network of the machine."),
            "read": Key(
                strings("paths"), "Devices, and paths below /tmp, /var/tmp and /run, that it may read.", default=[]
            ),
            "write": Key(strings("paths"), "Files and folders that it may change for good.", default=[]),
        },
        rules=(
            Rule(
                holds=lambda table: table.get("network") != "host" or "reason" in table,
                objection="network = 'host' needs a 'reason', which reports and certificates show",
                described={
                    "if": {"properties": {"network": {"const": "host"}}, "required": ["network"]},
                    "then": {"required": ["reason"]},
                },
            ),
        ),
    ),
)
_ANSWER = Named("answer", OneOf(("envelope", "structured", "json", "text", "texts")))
_OUTCOME_RULE = Table(
    {
        "is_error": Key(FLAG, "The result's isError."),
        "text": Key(REGEX, "Regular expression, searched in the whole text."),
        "path": Key(PATH, "JMESPath over the document; holds when it finds something true."),
        "then": Key(OneOf(("success", "failure")), "What the answer means."),
    },
    rules=(
        Rule(
            holds=lambda table: "then" in table and len(table) > 1,
            objection="expected a condition (is_error, text or path) and 'then'",
            described={"required": ["then"], "minProperties": 2},
        ),
    ),
)
_READY = Named(
    "ready",
    Table(
        {
            "tool": Key(TEXT, "Name of an MCP tool that only reads.", required=True),
            "arguments": Key(MapOf(ANYTHING), "Its arguments; {host} and its like are replaced.", default={}),
            "answer": Key(_ANSWER, "What its answer is; without it as for the adapter."),
            "text": Key(REGEX, "The adapter is ready when this regular expression is found in the whole text."),
            "path": Key(PATH, "The adapter is ready when this JMESPath finds something true in the document."),
        }
    ),
)
_OUTCOME = Named("outcome", ListOf(_OUTCOME_RULE, "a list of rules"))
_ERROR_RULE = Table(
    {
        "text": Key(REGEX, "Regular expression, searched in the failure's text.", required=True),
        "code": Key(OneOf((*registry(), UNCLASSIFIED)), "Code of the failure.", required=True),
    }
)
_ERRORS = Named("errors", ListOf(_ERROR_RULE, "a list of rules"))
_COMPUTATION = Scalar(
    expected="a number made from $value, such as '$value * 10 + 5'",
    accepts=lambda value: isinstance(value, str) and is_computation(value),
    described={"type": "string", "pattern": r"^\$value( ?\* ?-?\d{1,15}(\.\d{1,9})?)?( ?[+-] ?\d{1,15}(\.\d{1,9})?)?$"},
)
OUTPUT_TABLE = Table(
    {
        "path": Key(
            PATH, 'JMESPath over the document; "$name" is the member that is called like the input of that name.'
        ),
        "regex": Key(REGEX, "First group, or whole match, of a regular expression in what was found."),
        "split": Key(TEXT, "Separator that makes a list of it."),
        "wrap": Key(FLAG, "A single value becomes a list of one.", default=False),
        "strip": Key(TEXT, "Prefix that is taken off; of a list, off each element."),
        "as": Key(
            OneOf(("int", "float", "bool", "string", "hex", "bytes", "json", "python", "literal")),
            "The type of the value; of a list, of each element. 'literal' is a literal if it is one, else the text.",
        ),
        "then": Key(PATH, "JMESPath over what 'as' made, with the same names."),
    }
)
_OUTPUT = Named("output", ByType(str, PATH, OUTPUT_TABLE))
_READ_VALUE = Named(
    "read_value",
    ByType(
        str,
        PATH,
        Table(
            {
                **OUTPUT_TABLE.keys,
                "means": Key(
                    ByType(str, _COMPUTATION, MapOf(ANYTHING)),
                    "What is meant by it: a number made from $value, or a table of words, each with what it means.",
                ),
            }
        ),
    ),
)
_KEEP = MapOf(_OUTPUT)
_RANGE = Table(
    {
        "lowest": Key(NUMBER, "The lowest value.", required=True),
        "highest": Key(NUMBER, "The highest value.", required=True),
        "step": Key(NUMBER, "From one value to the next.", default=1),
    }
)
_VALUES = ByType(list, ListOf(ANYTHING, "a list of values", least=1), _RANGE)
_INPUT_TYPE = Named("input_type", OneOf(("string", "int", "float", "bool", "hex", "json", "list")))


def _secured_by(policies: tuple[str, ...]) -> Kind:
    return Named(
        "secure",
        Table(
            {
                **_LAUNCH,
                "policy": Key(OneOf(policies), "The security policy that the launch configures."),
                "mode": Key(OneOf(("Sign", "SignAndEncrypt")), "The message security mode that it configures."),
            }
        ),
    )


def subject_file(protocols: Mapping[str, OtProtocol]) -> Table:
    """Return the grammar of a subject file whose adapters speak these protocols, by key."""
    deviation = Table(
        {
            "item": Key(TEXT, "Id of the item that fails.", required=True),
            "reason": Key(TEXT, "Why it fails.", required=True),
            "expires": Key(DATE, "The last day on which the failure is excused, such as 2027-03-31.", required=True),
        }
    )
    subject = Table(
        {
            "name": Key(TEXT, "Name of the product, as printed in reports.", required=True),
            "version": Key(TEXT, "Its version, as printed in reports.", required=True),
        }
    )
    adapters = Table(
        {
            key: Key(Named(f"adapter.{key}", adapter_table(known)), f"The adapter for {known.name}.")
            for key, known in protocols.items()
        },
        rules=(
            Rule(
                holds=bool, objection=f"expected at least one of {', '.join(protocols)}", described={"minProperties": 1}
            ),
        ),
    )
    return Table(
        {
            "subject": Key(subject, "Who is tested.", required=True),
            "adapter": Key(adapters, "The adapter for each protocol that the subject speaks.", required=True),
            "deviation": Key(
                ListOf(deviation, "[[deviation]] tables"), "Failures that the vendor knows of.", default=[]
            ),
        }
    )


def adapter_table(protocol: OtProtocol) -> Table:
    """Return the grammar of ``[adapter.KEY]`` for one protocol."""
    unclaimed = Table({facet: Key(REASON, "The reason why the adapter does not have it.") for facet in protocol.facets})
    probes = Table({name: Key(ANYTHING, f"Asked for instead of {value!r}.") for name, value in protocol.probes.items()})
    connect = Table(
        {
            "tool": Key(TEXT, "Name of the MCP tool.", required=True),
            "arguments": Key(_TABLE, "Its arguments; {host} and its like are replaced.", default={}),
            "keep": Key(
                _KEEP,
                "Handle to its place in the answer; arguments of later calls take it as $connect.HANDLE.",
                default={},
            ),
        }
    )
    return Table(
        {
            "command": Key(
                _ARGV,
                "The argument vector; {host} {port} {url} {NAME_port} {serial} {interface} {device_mac} {device_ip} {python} {dir} {work} {http_port} {local_port} are "
                "replaced.",
            ),
            "cwd": Key(TEXT, "Working directory, relative to this file."),
            "env": Key(MapOf(STRING), "Environment beyond a short allow-list.", default={}),
            "files": Key(MapOf(STRING), "Files written below {work} before the launch, name to content.", default={}),
            "secrets": Key(
                strings("names of environment variables"),
                "Environment variables whose values are never shown.",
                default=[],
            ),
            "secret_env": Key(
                strings("names of environment variables"),
                "Environment variables that take a secret: each session gets a random value in them, which the adapter must not tell.",
                default=[],
            ),
            "isolation": Key(_ISOLATION, "What the walls around the adapter leave open to it.", default={}),
            "transport": Key(OneOf(("stdio", "http")), "How the adapter is spoken to.", default="stdio"),
            "url": Key(TEXT, 'The MCP endpoint, for transport = "http".'),
            "era": Key(
                OneOf(("auto", "legacy")),
                "'legacy' for a server that must be addressed by the handshake of 2025-11-25, 'auto' for one that need not; "
                "without it as the run says.",
            ),
            "start_timeout_s": Key(SECONDS, "Time for start and handshake.", default=30.0),
            "deadline_s": Key(SECONDS, "Time within which every call must have answered.", default=5.0),
            "rw": Key(_VARIANT, "What the launch with writes enabled has in addition.", default={}),
            "ro": Key(_VARIANT, "What the launch with writes disabled has in addition.", default={}),
            "bounded": Key(
                _BOUNDED,
                "What the launch with a list of targets that may be written, or with limits, has beyond that with writes enabled.",
            ),
            "retimed": Key(
                _RETIMED,
                "What the launch with other time limits, or other numbers of repetitions, has beyond that with writes enabled.",
            ),
            "governed": Key(
                _SECURED,
                "What the launch with a policy, and what the adapter has of an audit log and approvals, has beyond that with writes enabled.",
            ),
            "tokens": Key(
                _TOKENS,
                "What the launch over HTTP for callers with tokens has beyond that with writes enabled; {issuer} is a URL, {issuer_keys} a file.",
            ),
            **(
                {
                    "secure": Key(
                        _secured_by(protocol.policies) if protocol.policies else _VARIANT,
                        "What the launch for the secure form of the protocol has beyond that with writes enabled; {ca} {cert} {key} are files, {user} {password} an account.",
                    )
                }
                if protocol.secure
                else {}
            ),
            **(
                {
                    "no_control": Key(
                        _VARIANT,
                        "What the launch without control of the device itself has beyond that with writes enabled.",
                    )
                }
                if protocol.controls
                else {}
            ),
            "unclaimed": Key(
                Named(f"adapter.{protocol.key}.unclaimed", unclaimed),
                "Facet to the reason why the adapter does not have it.",
                default={},
            ),
            "connect": Key(connect, "A tool call before all others."),
            "ready": Key(_READY, "What each start waits for while the device is there, for start_timeout_s at most."),
            **{
                choice.key: Key(OneOf(tuple(choice.unclaims)), _sentence(choice.meaning), default=choice.default)
                for choice in protocol.choices
            },
            "recovery": Key(
                OneOf(("same_session", "connect_step", "new_session")),
                "How work goes on after an outage.",
                default="same_session",
            ),
            "recovery_s": Key(
                at_most(LONGEST_RECOVERY_S),
                "Time within which work goes on after an outage.",
                default=LONGEST_RECOVERY_S,
            ),
            "call_limit": Key(_CALL_LIMIT, "The most tool calls that the adapter takes within a time."),
            **{name: Key(strings(f"the {name}"), meaning, default=[]) for name, meaning in protocol.lists.items()},
            **_answering("; without it the adapter answers in the kit's own envelope"),
            "probes": Key(probes, "What to ask for where something must be refused.", default={}),
            "bindings": Key(TEXT, "Python file with functions for operations."),
            "commands": Key(
                MapOf(Named(f"adapter.{protocol.key}.command", command_table(protocol))),
                "Tools with a vocabulary of their own, each with its effect on the device.",
                default={},
            ),
            **(
                {
                    "readings": Key(
                        MapOf(Named(f"adapter.{protocol.key}.reading", reading_table(protocol))),
                        "Tools that read under names of their own, each with what it reads.",
                        default={},
                    )
                }
                if protocol.places
                else {}
            ),
            "bind": Key(
                Named(f"adapter.{protocol.key}.bind", _bind(protocol)), "Which tool performs which operation, and how."
            ),
        },
        rules=(_HAS_A_COMMAND, _URL_IS_FOR_HTTP, _HTTP_HAS_A_URL, _CONNECT_STEP_HAS_A_CALL),
    )


def binding_table(operation: Operation) -> Table:
    """Return the grammar of one table that binds a tool to the operation."""
    inputs = operation.accepted
    result = Table(
        {name: Key(_OUTPUT, f"Where '{name}' is.") for name in operation.readable},
        rules=tuple(map(_judged, operation.needed)),
    )
    known = ", ".join(f"${name}" for name in inputs) or "none"
    return Table(
        {
            "tool": Key(TEXT, "Name of the MCP tool."),
            "resource": Key(TEXT, "URI of a resource to read instead."),
            "arguments": Key(Template(inputs), f"Template; inputs: {known}.", default={}),
            "result": Key(result, "Where the outputs are.", default={}, required=bool(operation.needed)),
            "keep": Key(
                _KEEP,
                "Handle to its place in the answer; arguments of later calls take it as $OPERATION.HANDLE.",
                default={},
            ),
            "when": Key(
                _by_input(inputs, ANYTHING),
                "Values of inputs for which this is the tool; a list for any of them.",
                default={},
            ),
            "offset": Key(_by_input(inputs, NUMBER), "Number added to an input.", default={}),
            "names": Key(_by_input(inputs, _TABLE), "The vendor's name for each value of an input.", default={}),
            "as": Key(_by_input(inputs, _INPUT_TYPE), "The type in which the tool wants an input.", default={}),
            "topic": Key(
                OneOf(("told", "subscribed")),
                "'subscribed' for messages without a topic: they are of the topic that is asked for.",
                default="told",
            ),
            "blocking": Key(FLAG, "The call waits for what it answers.", default=False),
            "source": Key(
                OneOf(("device", "cache")), "'cache' for a status that may be a moment old.", default="device"
            ),
            "max_age_s": Key(at_most(OLDEST_STATUS_S), "How old such a status may be."),
            **_answering("; without it as the adapter does"),
        },
        rules=(_HAS_A_TOOL, _RESOURCE_STANDS_ALONE, _CACHE_HAS_AN_AGE)
        + (() if operation.status else (_KNOWN_FROM_THE_DEVICE,))
        + ((_ANSWERS_AT_ONCE,) if operation.waits is None else ())
        + ((_HAS_NO_TOPIC,) if operation.topic_of is None else ()),
    )


def command_table(protocol: OtProtocol) -> Table:
    """Return the grammar of one named command."""
    writing = {name: operation for name, operation in protocol.operations.items() if operation.writes}
    effect: Kind = _one_of(writing)
    recognised = protocol.exercise.recognised if protocol.exercise is not None else {}
    if recognised:
        each = _one_of({name: operation for name, operation in writing.items() if name in recognised})
        effect = ByType(list, ListOf(each, "a list of effects, in their order", least=1), effect)
    return Table(
        {
            **_vocabulary("command"),
            "effect": Key(
                effect,
                "What the device gets: an operation with its inputs, or a list of these, in their order.",
                required=True,
            ),
            "says": Key(
                MapOf(_READ_VALUE),
                "Argument, or input of the effect, to where the answer says its value, and what that means.",
                default={},
            ),
            **_answering("; without it as the adapter does"),
        }
    )


def reading_table(protocol: OtProtocol) -> Table:
    """Return the grammar of one named reading."""
    return Table(
        {
            **_vocabulary("reading"),
            "source": Key(
                _one_of({name: protocol.operations[name] for name in protocol.places if name in protocol.operations}),
                "What is read at the device: an operation with its inputs, which is one value.",
                required=True,
            ),
            "value": Key(_READ_VALUE, "Where the value is in the answer, and what it means.", required=True),
            "holds": Key(
                _VALUES, "What the device may hold there: a list, or a range; without it whatever fits the place."
            ),
            **_answering("; without it as the adapter does"),
        }
    )


def _vocabulary(of: str) -> dict[str, Key]:
    return {
        "tool": Key(TEXT, f"Name of the MCP tool; without it that of the {of}."),
        "arguments": Key(_TABLE, "Template; $name is a value that is drawn.", default={}),
        "draws": Key(MapOf(_VALUES), "Argument to the values that it may be given: a list, or a range.", default={}),
        "means": Key(
            MapOf(ByType(list, ListOf(ANYTHING, "a list of values", least=1), _TABLE)),
            "Argument to a table of its values, each with what it is at the device, or to a list of that for the values in 'draws'.",
            default={},
        ),
    }


def _one_of(operations: Mapping[str, Operation]) -> Table:
    return Table(
        {name: Key(_effect(operation), _sentence(operation.meaning)) for name, operation in operations.items()},
        rules=(
            Rule(
                holds=lambda table: len(table) == 1,
                objection=f"expected one operation, such as {next(iter(operations), 'none')}",
                described={"minProperties": 1, "maxProperties": 1},
            ),
        ),
    )


def _effect(operation: Operation) -> Table:
    needed = set(operation.inputs) - set(operation.optional)
    return Table(
        {
            name: Key(
                ANYTHING, f"The input '{name}'; $name is what a value that is drawn means.", required=name in needed
            )
            for name in operation.accepted
        }
    )


def _bind(protocol: OtProtocol) -> Table:
    bind: dict[str, Key] = {}
    for name, operation in protocol.operations.items():
        table = Named(f"adapter.{protocol.key}.bind.{name}", binding_table(operation))
        bind[name] = Key(ByType(list, ListOf(table, "a table", least=1), table), _sentence(operation.meaning))
    return Table(bind)


def _answering(otherwise: str) -> dict[str, Key]:
    return {
        "answer": Key(_ANSWER, f"What an answer is{otherwise}."),
        "outcome": Key(
            _OUTCOME,
            "Whether an answer is a success; first match wins. Without a match isError decides, and what a structured answer says "
            "of itself: success or ok that is false, an error.",
        ),
        "errors": Key(_ERRORS, "Codes of failures; first match wins."),
    }


def _by_input(inputs: tuple[str, ...], kind: Kind) -> Table:
    return Table({name: Key(kind, f"For the input '{name}'.") for name in inputs})


def _judged(output: str) -> Rule:
    return Rule(
        holds=lambda table: output in table,
        objection=f"lacks {output!r}, without which the operation cannot be judged",
        described={"required": [output]},
    )


def _sentence(meaning: str) -> str:
    return f"{meaning[0].upper()}{meaning[1:]}."


def _has_commands(table: Mapping[str, Any]) -> bool:
    return "command" in table or all("command" in table.get(name, {}) for name in _VARIANTS)


_HAS_A_COMMAND = Rule(
    holds=_has_commands,
    at="command",
    objection="expected a non-empty list of strings, the argument vector, found nothing",
    described={
        "anyOf": [
            {"required": ["command"]},
            {"required": list(_VARIANTS), "properties": {name: {"required": ["command"]} for name in _VARIANTS}},
        ]
    },
)
_SPEAKS_HTTP = {"required": ["transport"], "properties": {"transport": {"const": "http"}}}
_URL_IS_FOR_HTTP = Rule(
    holds=lambda table: "url" not in table or table.get("transport") == "http",
    at="url",
    objection='only an adapter with transport = "http" has a URL',
    described={"if": {"required": ["url"]}, "then": _SPEAKS_HTTP},
)
_HTTP_HAS_A_URL = Rule(
    holds=lambda table: "url" in table or table.get("transport") != "http",
    at="url",
    objection="expected a non-empty string, found nothing",
    described={"if": _SPEAKS_HTTP, "then": {"required": ["url"]}},
)
_CONNECT_STEP_HAS_A_CALL = Rule(
    holds=lambda table: "connect" in table or table.get("recovery") != "connect_step",
    at="recovery",
    objection="'connect_step' needs a 'connect' table",
    described={
        "if": {"required": ["recovery"], "properties": {"recovery": {"const": "connect_step"}}},
        "then": {"required": ["connect"]},
    },
)
_HAS_A_TOOL = Rule(
    holds=lambda table: "tool" in table or "resource" in table,
    at="tool",
    objection="expected a non-empty string, found nothing",
    described={"anyOf": [{"required": ["tool"]}, {"required": ["resource"]}]},
)
_RESOURCE_STANDS_ALONE = Rule(
    holds=lambda table: "resource" not in table or not ("tool" in table or table.get("arguments")),
    at="resource",
    objection="a resource is read without tool and arguments",
    described={
        "if": {"required": ["resource"]},
        "then": {"properties": {"tool": False, "arguments": {"maxProperties": 0}}},
    },
)
_CACHE_HAS_AN_AGE = Rule(
    holds=lambda table: (table.get("source") == "cache") == ("max_age_s" in table),
    at="max_age_s",
    objection='source = "cache" says how old an answer may be, and nothing else does',
    described={
        "if": {"required": ["source"], "properties": {"source": {"const": "cache"}}},
        "then": {"required": ["max_age_s"]},
        "else": {"properties": {"max_age_s": False}},
    },
)
_KNOWN_FROM_THE_DEVICE = Rule(
    holds=lambda table: table.get("source") != "cache",
    at="source",
    objection="only a status may come from a cache",
    described={"properties": {"source": {"const": "device"}}},
)
_HAS_NO_TOPIC = Rule(
    holds=lambda table: table.get("topic") != "subscribed",
    at="topic",
    objection="only messages are of a topic",
    described={"properties": {"topic": {"const": "told"}}},
)
_ANSWERS_AT_ONCE = Rule(
    holds=lambda table: not table.get("blocking"),
    at="blocking",
    objection="only a call for messages may wait for them",
    described={"properties": {"blocking": {"const": False}}},
)
