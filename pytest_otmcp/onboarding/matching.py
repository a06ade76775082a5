"""The guesses of tools and arguments for operations, made from names, descriptions and schemas. Pure."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from ..protocols.registry import protocols
from ..subject.model import placeholders
from .guess import Guess
from .pack import Hints, Pack

__all__ = ["guess_connect", "guess_tools"]

_ARGUMENTS: Mapping[str, str] = {"value": "value data val new_value values data_value"}
"""Inputs that operations of any protocol have, to the names that tools have for them; packs add their own inputs."""

_ENDPOINT: tuple[tuple[str, str], ...] = (
    (r"^(host|ip|hostname|broker_host|server_host|address_host)$", "{host}"),
    (r"^(port|broker_port|server_port|tcp_port)$", "{port:int}"),
    (r"^(url|uri|endpoint|server_url|endpoint_url|broker_url|broker)$", "{url}"),
)
_PROTOCOL = r"^(protocol|proto)$"
_CONNECTION = r"^(conn|connection|connection_string|device|target|resource|endpoint|server)$"
_CONNECTIONS = ("tcp:{host}:{port}", "{host}:{port}", "tcp://{host}:{port}", "{url}")
"""Forms in which a required argument whose name matches ``_CONNECTION`` may expect the device's address."""


_WRITES = frozenset("write writes set put publish send force toggle delete execute invoke actuate".split())
"""Words in the names of tools that write."""

_FOREIGN = re.compile(
    r"(?<![a-z0-9])(ethercat|sdo|pdo|ethernet.?ip|enip|eip|cip|s7|s7comm|profinet|profibus|bacnet|dnp3|canopen|knx|iec104)"
    r"(?![a-z0-9])",
    re.IGNORECASE,
)
"""Names of protocols that the kit does not know, in the names and descriptions of tools."""


def guess_tools(pack: Pack, operation: str, tools: Mapping[str, Mapping[str, object]]) -> list[Guess]:
    """Guess the tools that may perform the operation, likeliest first."""
    found = [guess for name, tool in tools.items() if (guess := _guess(pack, operation, name, tool)) is not None]
    return sorted(found, key=lambda guess: (-guess.score, guess.tool))


def guess_connect(tools: Mapping[str, Mapping[str, object]]) -> Guess | None:
    """Guess the tool that has to be called before all others, by its name and its arguments."""
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


def _properties(tool: Mapping[str, Any]) -> Mapping[str, Any]:
    schema = tool.get("inputSchema") or {}
    properties = _resolved(schema.get("properties") or {}, schema.get("$defs") or {}, 0)
    return properties if isinstance(properties, dict) else {}


def _resolved(value: object, definitions: Mapping[str, object], depth: int) -> object:
    """Replace the local references of a schema, down to the depth to which tools nest arguments."""
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


def _is_foreign(protocol: str, name: str, tool: Mapping[str, Any]) -> bool:
    """Tell whether a tool speaks another protocol: it may reach another device, and is never called."""
    own, text = protocols()[protocol].recognise, f"{name} {tool.get('description') or ''}"[:400]
    if own.search(text):
        return False
    others = (known.recognise for key, known in protocols().items() if key != protocol)
    return any(other.search(text) for other in (*others, _FOREIGN))


def _may_write(words: set[str], tool: Mapping[str, Any]) -> bool:
    """Tell whether a tool may write, by its name and by what it says of itself: it is not tried for reading."""
    return not words.isdisjoint(_WRITES) or (tool.get("annotations") or {}).get("destructiveHint") is True


def _guess(pack: Pack, operation: str, name: str, tool: Mapping[str, Any]) -> Guess | None:
    asked, hints = protocols()[pack.protocol].operations[operation], pack.operations[operation]
    words, likely = _words(name), set(hints.likely.split())
    if hints.needed and not words & set(hints.needed.split()):
        return None
    if _is_foreign(pack.protocol, name, tool) or (not asked.writes and _may_write(words, tool)):
        return None
    score = 2.0 * len(words & likely) - 3.0 * len(words & set(hints.unlikely.split()))
    score += 0.25 * len(_words(str(tool.get("description") or "")[:400]) & likely)
    names = {**_ARGUMENTS, **pack.arguments}
    inputs = {name: tuple(names[name].split()) for name in asked.inputs if name in names}
    arguments, optional, convert = _arguments(pack, hints, inputs, tool)
    placed = placeholders(arguments)
    # Whether a call waits speaks neither for a tool nor against it.
    telling = set(inputs) - {asked.waits}
    score += 2.0 * len(placed & telling) - 2.0 * len(telling - placed - set(asked.optional))
    required = (tool.get("inputSchema") or {}).get("required") or []
    trials = {
        str(argument): values
        for argument in required
        if argument not in arguments and (values := _trials(pack, hints, str(argument)))
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
        optional=optional,
    )


def _trials(pack: Pack, hints: Hints, argument: str) -> tuple[str, ...]:
    known = ((_PROTOCOL, pack.names), (_CONNECTION, _CONNECTIONS), *hints.trials.items())
    return next((values for pattern, values in known if values and re.match(pattern, argument, re.IGNORECASE)), ())


Inputs = Mapping[str, tuple[str, ...]]
"""The inputs of an operation, to the names that tools have for them."""


def _arguments(
    pack: Pack, hints: Hints, inputs: Inputs, tool: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, Any], dict[str, str]]:
    properties = _properties(tool)
    arguments: dict[str, Any] = {}
    optional: dict[str, Any] = {}
    convert: dict[str, str] = {}
    for name in inputs:
        actual = _named(inputs[name], properties, arguments)
        if actual is not None:
            arguments[actual] = _template(pack, name, inputs, properties[actual], convert)
    if not arguments:
        arguments |= _batch(pack, inputs, properties, convert)
    required = (tool.get("inputSchema") or {}).get("required") or []
    for key, schema in properties.items():
        if key in arguments:
            continue
        choice, constant, endpoint = _choice(hints, schema), _constant(pack, key), _endpoint(key, schema)
        if choice is not None:
            # What an enumeration is about, such as a table, has to be said in any case.
            arguments[key] = choice
        elif (value := endpoint if constant is None else constant) is not None:
            (arguments if key in required else optional)[key] = value
    return arguments, optional, convert


def _named(names: tuple[str, ...], properties: Mapping[str, object], taken: Mapping[str, object]) -> str | None:
    """Find the property for these names; earlier names take precedence."""
    free = [key for key in properties if key not in taken]
    return next((key for name in names for key in free if key.lower() == name), None)


def _batch(pack: Pack, inputs: Inputs, properties: Mapping[str, Any], convert: dict[str, str]) -> dict[str, Any]:
    """Find an argument that takes a list of objects, each with places for the inputs."""
    for key, schema in properties.items():
        if "array" in _kinds(schema):
            template = _template(pack, next(iter(inputs), ""), inputs, schema, convert)
            if isinstance(template, list) and isinstance(template[0], dict) and len(template[0]) > 1:
                return {key: template}
    return {}


def _template(pack: Pack, name: str, inputs: Inputs, schema: Mapping[str, object], convert: dict[str, str]) -> object:
    kinds = _kinds(schema)
    if "array" in kinds and name not in pack.lists and not kinds & {"string", "integer", "number"}:
        items = schema.get("items") or {}
        members = items.get("properties") if isinstance(items, dict) else None
        if isinstance(members, dict) and members:
            element: dict[str, str] = {}
            for other, names in inputs.items():
                key = _named(names, members, element)
                if key is not None:
                    element[key] = f"${other}"
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


def _choice(hints: Hints, schema: Mapping[str, Any]) -> str | None:
    """Find the value of an enumerated argument that names the operation's subject, such as a table."""
    values: list[Any] = schema.get("enum") or next(
        (entry["enum"] for entry in schema.get("anyOf") or [] if isinstance(entry, dict) and "enum" in entry), []
    )
    return next(
        (value for value in values if isinstance(value, str) and hints.choice and hints.choice.search(value)), None
    )


def _constant(pack: Pack, key: str) -> object:
    return next((value for pattern, value in pack.constants.items() if re.match(pattern, key, re.IGNORECASE)), None)


def _endpoint(key: str, schema: Mapping[str, object]) -> str | None:
    kinds = _kinds(schema)
    for pattern, placeholder in _ENDPOINT:
        if re.match(pattern, key, re.IGNORECASE):
            return "{port}" if placeholder == "{port:int}" and kinds == {"string"} else placeholder
    return None
