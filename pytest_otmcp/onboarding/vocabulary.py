"""Which tool may perform which operation, and with which arguments: guessed from names, descriptions and schemas. Pure."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import islice, product
from typing import Any

from ..protocols.registry import protocols
from ..subject.model import placeholders

__all__ = ["Guess", "connect_guess", "guesses"]

# Words of a tool's name that speak for an operation, and against it.
_FOR: Mapping[str, Mapping[str, str]] = {
    "modbus": {
        "ping": "ping|status|health|connection|probe|info",
        "read_input": "read|get|input|register|value",
        "read_holding": "read|get|holding|register|value",
        "write_holding": "write|set|holding|register|value",
    },
    "mqtt": {
        "info": "info|status|health|connection|broker|ping",
        "subscribe": "subscribe|subscription|listen|start",
        "messages": "messages|message|receive|received|read|get|inbox|collect",
        "publish": "publish|send|message",
        "device_birth": "birth|dbirth|device|sparkplug",
        "device_data": "data|ddata|device|sparkplug|update",
    },
    "opcua": {
        "read": "read|get|node|value|variable",
        "read_many": "read|get|nodes|multiple|values|many|batch",
        "browse": "browse|children|list|node|nodes",
        "write": "write|set|node|nodes|value",
        "variables": "all|variables|enumerate|list|tree",
    },
}
_AGAINST: Mapping[str, Mapping[str, str]] = {
    "modbus": {
        "ping": "read|write|mask|scan|list|job|template|proxy|listener|frame|log|connect|disconnect|reconnect|command",
        "read_input": "write|set|coil|coils|discrete|mask|file|fifo|exception|information|history|holding",
        "read_holding": "write|set|coil|coils|discrete|mask|file|fifo|exception|information|history|input",
        "write_holding": "read|coil|coils|mask|file",
    },
    "mqtt": {
        "info": "list|publish|subscribe|unsubscribe|spawn|stop|messages|sparkplug|brokers|subscriptions|connect|disconnect",
        "subscribe": "unsubscribe|list|stop|end|subscriptions",
        "messages": "publish|send|subscribe|delete|clear",
        "publish": "subscribe|sparkplug|birth|death|ddata|nbirth|ndata|device|node|command",
        "device_birth": "death|data|node|nbirth|read|list|decode",
        "device_data": "death|birth|node|ndata|read|list|decode",
    },
    "opcua": {
        "read": "write|history|event|events|browse|call|subscribe",
        "read_many": "write|history|event|events|browse|call|subscribe|alarms",
        "browse": "read|write|call|subscribe|history|variables",
        "write": "read|history|call|subscribe",
        "variables": "read|write|call|subscribe|history|multiple",
    },
}
_NEEDED: Mapping[str, Mapping[str, str]] = {
    "modbus": {"read_input": "read|get", "read_holding": "read|get", "write_holding": "write|set"},
    "mqtt": {
        "subscribe": "subscribe|subscription|listen",
        "publish": "publish|send",
        "device_birth": "birth|dbirth|sparkplug",
        "device_data": "data|ddata|sparkplug",
    },
    "opcua": {
        "read": "read|get",
        "read_many": "read|get",
        "browse": "browse|children|list",
        "write": "write|set",
        "variables": "all|variables|variable|enumerate",
    },
}

# An input of an operation to the names that arguments for it have.
_ARGUMENTS: Mapping[str, str] = {
    "address": "address|addr|start|start_address|starting_address|register|register_address|offset|index",
    "count": "count|quantity|num|number|length|size|qty|num_registers|register_count|n",
    "value": "value|data|val|new_value|values|data_value",
    "filter": "topic|topic_filter|filter|pattern|topics|topic_pattern",
    "qos": "qos|quality_of_service",
    "topic": "topic|topic_name",
    "payload": "payload|message|data|content|body|value",
    "node": "node_id|nodeid|node|id|node_ids|nodes",
    "nodes": "node_ids|nodes|nodeids|ids",
    "device": "device_id|device|device_name",
    "metrics": "metrics|values|data",
}
_UNIT = re.compile(r"^(unit|unit_id|unitid|slave|slave_id|slaveid)$", re.IGNORECASE)
_ENDPOINT: tuple[tuple[str, str], ...] = (
    (r"^(host|ip|hostname|broker_host|server_host|address_host)$", "{host}"),
    (r"^(port|broker_port|server_port|tcp_port)$", "{port:int}"),
    (r"^(url|uri|endpoint|server_url|endpoint_url|broker_url|broker)$", "{url}"),
)

# What required arguments of these names may want to be told, when their schema does not say: tried one after the other.
_TRIALS: tuple[tuple[str, Mapping[str, tuple[str, ...]]], ...] = (
    (
        r"^(protocol|proto)$",
        {
            "modbus": ("modbus", "modbus-tcp", "modbus_tcp", "tcp"),
            "mqtt": ("mqtt",),
            "opcua": ("opcua", "opc-ua", "opc_ua"),
        },
    ),
    (
        r"^(conn|connection|connection_string|device|target|resource|endpoint|server)$",
        dict.fromkeys(
            ("modbus", "mqtt", "opcua"), ("tcp:{host}:{port}", "{host}:{port}", "tcp://{host}:{port}", "{url}")
        ),
    ),
    (
        r"^(kind|table|type|register_type|area|source|target)$",
        {
            "read_input": ("input", "ir", "input_register", "input_registers"),
            "read_holding": ("holding", "hr", "holding_register", "holding_registers"),
            "write_holding": ("holding", "hr", "holding_register", "holding_registers"),
        },
    ),
)
_MOST_TRIALS = 24


@dataclass(frozen=True, slots=True, kw_only=True)
class Guess:
    """A tool that may perform an operation.

    Attributes:
        score: higher is likelier.
        arguments: template as a subject file has it.
        convert: input to the type in which the tool seems to want it.
        missing: required arguments that nothing is known to put into.
        trials: further arguments, each with values to try.
    """

    operation: str
    tool: str
    score: float
    arguments: Mapping[str, Any]
    convert: Mapping[str, str]
    missing: tuple[str, ...]
    trials: Mapping[str, tuple[str, ...]]

    def variations(self) -> list[Guess]:
        """This guess with every combination of what there is to try; just itself when there is nothing."""
        names = list(self.trials)
        combinations = islice(product(*self.trials.values()), _MOST_TRIALS)
        return [
            replace(self, arguments={**self.arguments, **dict(zip(names, values, strict=True))}, trials={})
            for values in combinations
        ]


def guesses(protocol: str, operation: str, tools: Mapping[str, Mapping[str, Any]]) -> list[Guess]:
    """The tools that may perform the operation, likeliest first."""
    found = [guess for name, tool in tools.items() if (guess := _guess(protocol, operation, name, tool)) is not None]
    return sorted(found, key=lambda guess: (-guess.score, guess.tool))


def connect_guess(tools: Mapping[str, Mapping[str, Any]]) -> Guess | None:
    """A tool that has to be called before all others, as its name and its arguments suggest."""
    for name, tool in tools.items():
        words = _words(name)
        if "connect" in words and not words & {"disconnect", "status", "info", "list"}:
            properties = _properties(tool)
            arguments = {key: value for key in properties if (value := _endpoint(key, properties[key])) is not None}
            if arguments:
                return Guess(
                    operation="connect", tool=name, score=1.0, arguments=arguments, convert={}, missing=(), trials={}
                )
    return None


def _words(name: str) -> set[str]:
    parts = re.sub(r"([a-z])([A-Z])", r"\1_\2", name).lower()
    return set(re.split(r"[^a-z0-9]+", parts))


def _alternatives(text: str) -> set[str]:
    return set(text.split("|"))


def _properties(tool: Mapping[str, Any]) -> Mapping[str, Any]:
    schema = tool.get("inputSchema") or {}
    properties = _resolved(schema.get("properties") or {}, schema.get("$defs") or {}, 0)
    return properties if isinstance(properties, dict) else {}


def _resolved(value: Any, definitions: Mapping[str, Any], depth: int) -> Any:
    """A schema with its local references replaced, as deep as arguments of tools are nested."""
    if depth > 8:
        return value
    if isinstance(value, Mapping):
        reference = value.get("$ref")
        if isinstance(reference, str) and reference.startswith("#/$defs/"):
            return _resolved(definitions.get(reference.removeprefix("#/$defs/"), {}), definitions, depth + 1)
        return {name: _resolved(member, definitions, depth + 1) for name, member in value.items()}
    if isinstance(value, list):
        return [_resolved(element, definitions, depth + 1) for element in value]
    return value


def _guess(protocol: str, operation: str, name: str, tool: Mapping[str, Any]) -> Guess | None:
    words = _words(name)
    needed = _NEEDED[protocol].get(operation)
    if needed is not None and not words & _alternatives(needed):
        return None
    score = 2.0 * len(words & _alternatives(_FOR[protocol][operation]))
    score -= 3.0 * len(words & _alternatives(_AGAINST[protocol][operation]))
    described = _words(str(tool.get("description") or "")[:400])
    score += 0.25 * len(described & _alternatives(_FOR[protocol][operation]))
    # A call that waits for messages is not proposed: how long it may wait is for whoever knows the adapter to say.
    inputs = tuple(name for name in protocols()[protocol].operations[operation].inputs if name in _ARGUMENTS)
    arguments, convert = _arguments(operation, inputs, tool)
    placed = placeholders(arguments)
    score += 2.0 * len(placed & set(inputs)) - 2.0 * len(
        set(inputs) - placed - set(protocols()[protocol].operations[operation].optional)
    )
    required = (tool.get("inputSchema") or {}).get("required") or []
    trials = {
        str(argument): values
        for argument in required
        if argument not in arguments and (values := _trials(protocol, operation, str(argument)))
    }
    missing = tuple(str(argument) for argument in required if argument not in arguments and argument not in trials)
    score -= 2.0 * len(missing) + 0.5 * len(trials)
    if not inputs:
        score -= 1.0 * len(required)
    if score <= 0:
        return None
    return Guess(
        operation=operation,
        tool=name,
        score=score,
        arguments=arguments,
        convert=convert,
        missing=missing,
        trials=trials,
    )


def _trials(protocol: str, operation: str, argument: str) -> tuple[str, ...]:
    for pattern, values in _TRIALS:
        if re.match(pattern, argument, re.IGNORECASE):
            found = values.get(operation) or values.get(protocol)
            if found:
                return found
    return ()


def _arguments(
    operation: str, inputs: tuple[str, ...], tool: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, str]]:
    properties = _properties(tool)
    arguments: dict[str, Any] = {}
    convert: dict[str, str] = {}
    for name in inputs:
        for argument in _ARGUMENTS[name].split("|"):
            actual = next((key for key in properties if key.lower() == argument and key not in arguments), None)
            if actual is not None:
                arguments[actual] = _template(name, inputs, properties[actual], convert)
                break
    if not arguments:
        arguments |= _batch(inputs, properties, convert)
    required = (tool.get("inputSchema") or {}).get("required") or []
    for key, schema in properties.items():
        if key in arguments:
            continue
        if (choice := _choice(operation, schema)) is not None:
            arguments[key] = choice
        elif _UNIT.match(key):
            arguments[key] = 1
        elif (endpoint := _endpoint(key, schema)) is not None and (key in required or schema.get("default") is None):
            arguments[key] = endpoint
    return arguments, convert


def _batch(inputs: tuple[str, ...], properties: Mapping[str, Any], convert: dict[str, str]) -> dict[str, Any]:
    """An argument that takes a list of objects, each with places for the inputs."""
    for key, schema in properties.items():
        if "array" in _kinds(schema):
            template = _template(inputs[0] if inputs else "", inputs, schema, convert)
            if isinstance(template, list) and isinstance(template[0], dict) and len(template[0]) > 1:
                return {key: template}
    return {}


def _template(name: str, inputs: tuple[str, ...], schema: Mapping[str, Any], convert: dict[str, str]) -> Any:
    kinds = _kinds(schema)
    many = name in ("nodes", "metrics")
    if "array" in kinds and not many and not kinds & {"string", "integer", "number"}:
        items = schema.get("items") or {}
        members = items.get("properties") if isinstance(items, dict) else None
        if isinstance(members, dict) and members:
            element = {}
            for other in inputs:
                for argument in _ARGUMENTS[other].split("|"):
                    key = next((key for key in members if key.lower() == argument and key not in element), None)
                    if key is not None:
                        element[key] = f"${other}"
                        break
            return [element or f"${name}"]
        return [f"${name}"]
    if kinds == {"string"} and name == "value":
        convert[name] = "string"
    return f"${name}"


def _kinds(schema: Mapping[str, Any]) -> set[str]:
    kind = schema.get("type")
    if isinstance(kind, str):
        return {kind}
    if isinstance(kind, list):
        return {entry for entry in kind if entry != "null"}
    kinds: set[str] = set()
    for alternative in schema.get("anyOf") or schema.get("oneOf") or []:
        if isinstance(alternative, dict):
            kinds |= _kinds(alternative) - {"null"}
    return kinds


def _choice(operation: str, schema: Mapping[str, Any]) -> str | None:
    """Of an enumerated argument the value that names the operation's table."""
    wanted = {"read_input": "input", "read_holding": "holding", "write_holding": "holding"}.get(operation)
    values: list[Any] = schema.get("enum") or next(
        (entry["enum"] for entry in schema.get("anyOf") or [] if isinstance(entry, dict) and "enum" in entry), []
    )
    for value in values if wanted is not None else []:
        if (
            isinstance(value, str)
            and wanted is not None
            and wanted in value.lower()
            and "discrete" not in value.lower()
        ):
            return value
    return None


def _endpoint(key: str, schema: Mapping[str, Any]) -> str | None:
    kinds = _kinds(schema)
    for pattern, placeholder in _ENDPOINT:
        if re.match(pattern, key, re.IGNORECASE):
            return "{port}" if placeholder == "{port:int}" and kinds == {"string"} else placeholder
    return None
