"""The guesses of tools and arguments for operations, made from names, descriptions and schemas. Pure."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence, Set
from itertools import permutations
from typing import Any

from ..protocols.protocol import Operation
from ..protocols.registry import protocols
from ..subject.addressing import mentions_address
from ..subject.model import placeholders
from .guess import Guess
from .input_schema import choice, kinds, properties, required, resolved
from .pack import Hints, Pack

__all__ = [
    "commanding_tools",
    "guess_steps",
    "guess_tools",
    "reading_tools",
    "registered",
    "snake",
    "status_tools",
    "words_in",
]

_VERBS: Mapping[str, str] = dict.fromkeys("put store poke".split(), "write") | dict.fromkeys(
    "fetch retrieve peek".split(), "read"
)
"""First words of tools' names, each to the verb that packs know."""

_ARGUMENTS: Mapping[str, str] = {"value": "value data val new_value values data_value on"}
"""Inputs that operations of any protocol have, to the names that tools have for them; packs add their own inputs."""

_CONSTANTS: Mapping[str, object] = {r"^(dry_?run|simulate)$": False}
"""Arguments that tools of any protocol have, to the value that makes the call do something; packs add their own."""

_ENDPOINT: tuple[tuple[str, str], ...] = (
    (r"^(host|ip|hostname|broker_host|server_host|address_host)$", "{host}"),
    (r"^(port|broker_port|server_port|tcp_port)$", "{port:int}"),
    (r"^(url|uri|endpoint|server_url|endpoint_url|broker_url|broker)$", "{url}"),
)
_PROTOCOL = r"^(protocol|proto)$"
_CONNECTION = r"^(conn|connection|connection_string|device|target|resource|endpoint|server)$"
_MOST_UNNAMED = 3
"""Arguments that are tried in each order; more of them are too many calls."""

_CONNECTIONS = ("tcp:{host}:{port}", "{host}:{port}", "tcp://{host}:{port}", "{url}")
"""Forms in which a required argument whose name matches ``_CONNECTION`` may expect the device's address."""


_CHANGES = frozenset(
    """write writes set put publish send force toggle delete remove erase clear purge flush execute invoke actuate operate
    unsubscribe disconnect reconnect acknowledge ack patch insert upload deploy install reboot shutdown kill""".split()
)
"""Words in the names of tools that change something, wherever they stand."""

_MAY_CHANGE = frozenset(
    """add create update modify change rename register unregister start stop restart reset enable disable open close pause
    resume cancel abort lock unlock activate deactivate configure import save load move turn press call trigger command run
    setup establish initialize initialise login logout
    switch adjust dim blink play say speak announce notify display""".split()
)
"""Words that change something unless the name begins with a word of ``_READS``: ``get_start_time`` starts nothing."""

_READS = frozenset(
    "read get list browse is has show describe fetch query check find search enumerate count receive".split()
)
_JOINS = frozenset("and then or".split())

_FOREIGN = re.compile(
    r"(?<![a-z0-9])(canopen|knx|iec104"
    r"|mtconnect|mc|melsec|slmp|fins|hart|twincat)"
    r"(?![a-z0-9])",
    re.IGNORECASE,
)
"""Names of protocols that the kit does not know, in the names and descriptions of tools."""


def guess_tools(
    pack: Pack, operation: str, tools: Mapping[str, Mapping[str, object]], names: Mapping[str, str] | None = None
) -> list[Guess]:
    """Guess the tools that may perform the operation, likeliest first.

    Args:
        names: arguments that name a device which was registered, each with the name.
    """
    found = [
        guess for name, tool in tools.items() if (guess := _guess(pack, operation, name, tool, names or {})) is not None
    ]
    return sorted(found, key=lambda guess: (-guess.score, guess.tool))


def guess_steps(pack: Pack, tools: Mapping[str, Mapping[str, object]]) -> list[Guess]:
    """Guess the tools that may have to be called before all others, because they are told where the device is; likeliest first.

    A tool that registers a device under a name is only one where another tool has to be told that name.
    """
    found = [guess for name, tool in tools.items() if (guess := _step(pack, name, tool)) is not None]
    wanted = {name: {*required(resolved(tool, None))} for name, tool in tools.items()}
    used = [
        guess
        for guess in found
        if guess.score > _REGISTERING
        or any(
            not {*map(snake, keys)}.isdisjoint(registered(guess)) for name, keys in wanted.items() if name != guess.tool
        )
    ]
    return sorted(used, key=lambda guess: -guess.score)


def registered(step: Guess | None) -> dict[str, str]:
    """Return the arguments of other tools, in snake case, that may name what a step has registered, each with that name."""
    given = [] if step is None else [snake(key) for key, value in step.arguments.items() if value == _REGISTERED]
    # What is called a name where it is registered is called an id, or the device, where it is used.
    return dict.fromkeys((*given, *(_NAMES if given else ())), _REGISTERED)


_CONNECTING, _OPENING, _REGISTERING = 3.0, 2.0, 1.0
_STATUS = frozenset("status state health ready readiness connection connected".split())
_NO_STEP = frozenset("disconnect reconnect status info list get remove delete close test check".split())
_DEVICES = frozenset(
    "device devices plc controller server endpoint broker connection session target gateway client".split()
)
_OPENS = frozenset("open establish start create setup".split())
_REGISTERS = frozenset("add register define configure create".split())
_REGISTERED = "otmcp"
"""The name under which a device is registered."""
_THINGS = ("device", "plc", "connection", "conn", "server", "controller", "client", "target")
_NAMES = ("name", "id", "alias", "label", *(f"{thing}{end}" for thing in _THINGS for end in ("_id", "_name", "")))

_PLACES: tuple[tuple[str, tuple[str, ...]], ...] = (
    (r"^(\w+_)?port$", ("{port:int}",)),
    (r"^(\w+_)?(url|uri|endpoint)$", ("{url}",)),
    (r"^(\w+_)?(host|hostname|ip|ip_?addr(ess)?|address|addr|broker|server)$", ("{host}", "{host}:{port}", "{url}")),
)
"""Patterns of arguments that tell a step where the device is, to the values they may mean: the first where the port is told beside it."""


def _step(pack: Pack, name: str, tool: Mapping[str, Any]) -> Guess | None:
    score = _steps(words_in(name))
    if not score or _is_foreign(pack.protocol, name, tool):
        return None
    schema = resolved(tool, None)
    known, needed = properties(schema), required(schema)
    ported = any(re.search(r"(^|_)port$", snake(key)) for key in known)
    arguments: dict[str, object] = {}
    trials: dict[str, tuple[str, ...]] = {}
    for key, described in known.items():
        places = next((values for pattern, values in _PLACES if re.match(pattern, snake(key))), ())
        protocol, constant = _named_protocol(pack, described), _constant(pack, key)
        if places and (len(places) == 1 or ported):
            arguments[key] = "{port}" if places[0] == "{port:int}" and kinds(described) == {"string"} else places[0]
        elif places:
            trials[key] = places[1:] + places[:1]
        elif protocol is not None or constant is not None:
            arguments[key] = constant if protocol is None else protocol
        elif key in needed and snake(key) in _NAMES:
            arguments[key] = _REGISTERED
    if not trials and not any(map(mentions_address, arguments.values())):
        return None
    missing = tuple(key for key in needed if key not in arguments and key not in trials)
    return Guess(
        operation="connect", tool=name, score=score, arguments=arguments, convert={}, missing=missing, trials=trials
    )


def status_tools(pack: Pack, tools: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return the tools that tell a status and need no arguments, by their names."""
    return [
        name
        for name, tool in tools.items()
        if words_in(name) & _STATUS
        and not required(resolved(tool, None))
        and not _may_change(name, tool, frozenset())
        and not _is_foreign(pack.protocol, name, tool)
    ]


_OWN_AFFAIRS = frozenset(
    """delete remove erase clear purge flush rename register unregister subscribe unsubscribe disconnect connect reconnect add create
    update modify configure config configuration settings import export save load restart reboot reset shutdown kill deploy install firmware ota
    backup join permit pair upload device devices connection session history log cache alias""".split()
)
"""Words in the names of tools that change the adapter itself, or what cannot be changed back."""

_ELSEWHERE = frozenset(
    """run execute invoke eval call shell script program process job workflow query sql email mail sms notify webhook slack post http request
    download file folder directory browser""".split()
)
"""Words in the names of tools that may act on anything but the device."""

_ADDRESSES = ("address", "topic", "filter", "node", "nodes", "items")
"""Inputs of operations that say where something is written: a tool that is told it has no vocabulary of its own."""


def commanding_tools(pack: Pack, tools: Mapping[str, Mapping[str, Any]], taken: Set[str]) -> list[str]:
    """Return the tools that command the plant by their names, and are not told where: no register, topic or node.

    Args:
        taken: tools that are left out.
    """
    return [name for name in _not_told_where(pack, tools, taken) if _may_change(name, tools[name], frozenset())]


def reading_tools(pack: Pack, tools: Mapping[str, Mapping[str, Any]], taken: Set[str]) -> list[str]:
    """Return the tools that change nothing by their names, and are not told where they read.

    Args:
        taken: tools that are left out.
    """
    return [name for name in _not_told_where(pack, tools, taken) if not _may_change(name, tools[name], frozenset())]


def _not_told_where(pack: Pack, tools: Mapping[str, Mapping[str, Any]], taken: Set[str]) -> list[str]:
    inputs = {*" ".join(pack.arguments.get(input, "") for input in _ADDRESSES).split()}
    return [
        name
        for name, tool in tools.items()
        if name not in taken
        and not words_in(name) & (_OWN_AFFAIRS | _ELSEWHERE)
        and not _is_foreign(pack.protocol, name, tool)
        and not {snake(key) for key in properties(resolved(tool, None))} & inputs
    ]


def _steps(words: set[str]) -> float:
    """Return how likely a tool of such a name is a step; 0 for one that is none."""
    if words & _NO_STEP:
        return 0.0
    if "connect" in words:
        return _CONNECTING
    if words & _OPENS and words & {"connection", "session"}:
        return _OPENING
    return _REGISTERING if words & _REGISTERS and words & _DEVICES else 0.0


def _named_protocol(pack: Pack, described: Mapping[str, Any]) -> str | None:
    """Return the choice of an enumerated argument that is the protocol."""
    return choice(
        described, re.compile(rf"^({'|'.join(map(re.escape, (pack.protocol, *pack.names)))})$", re.IGNORECASE)
    )


def snake(name: str) -> str:
    """Return a name in snake case: ``brokerUrl`` is ``broker_url``."""
    return re.sub(r"([a-z])([A-Z])", r"\1_\2", name).lower()


def _in_order(name: str) -> list[str]:
    return re.split(r"[^a-z0-9]+", snake(name))


def _usual(name: str) -> str:
    """Return a tool's name with the verb that packs know: ``put_register`` writes, ``fetchRegister`` reads."""
    first = _in_order(name)[0]
    return _VERBS[first] + name[len(first) :] if first in _VERBS else name


def words_in(name: str) -> set[str]:
    """Return the words of the name of a tool or of an argument, in lower case."""
    return set(_in_order(name))


def _is_foreign(protocol: str, name: str, tool: Mapping[str, Any]) -> bool:
    """Tell whether a tool speaks another protocol: it may reach another device, and is never called.

    Its name decides, and where that names no protocol, its description.
    """
    own = protocols()[protocol].recognise
    others = (*(known.recognise for key, known in protocols().items() if key != protocol), _FOREIGN)
    for text in (name, str(tool.get("description") or "")[:400]):
        if own.search(text):
            return False
        if any(other.search(text) for other in others):
            return True
    return False


def _may_change(name: str, tool: Mapping[str, Any], own: Set[str]) -> bool:
    """Tell whether a tool may change something, by its name and by what it says of itself: it is not tried for reading.

    Args:
        own: words that say what the operation itself does, such as to subscribe.
    """
    words = _in_order(name)
    doubtful = _CHANGES if _only_reads(words) else _CHANGES | _MAY_CHANGE
    return bool(({*words} & doubtful) - own) or (tool.get("annotations") or {}).get("destructiveHint") is True


def _only_reads(words: Sequence[str]) -> bool:
    """Tell whether the first word that can be a verb says that the tool reads, and no other is joined to it."""
    first = next((word for word in words if word in _READS | _CHANGES | _MAY_CHANGE), None)
    return first in _READS and _JOINS.isdisjoint(words)


def _guess(
    pack: Pack, operation: str, name: str, tool: Mapping[str, Any], registered_as: Mapping[str, str]
) -> Guess | None:
    asked, hints = protocols()[pack.protocol].operations[operation], pack.operations[operation]
    usual = _usual(name)
    words, likely = words_in(usual), set(hints.likely.split())
    if hints.needed and not words & set(hints.needed.split()):
        return None
    if hints.named is not None and hints.named.fullmatch(usual) is None:
        return None
    if _is_foreign(pack.protocol, name, tool) or (not asked.writes and _may_change(name, tool, likely)):
        return None
    schema = resolved(tool, hints.choice)
    names = {**_ARGUMENTS, **pack.arguments}
    # What has a default is told where the tool has an argument for it.
    inputs = {name: tuple(names[name].split()) for name in (*asked.inputs, *asked.defaults) if name in names}
    arguments, optional, convert = _arguments(pack, hints, inputs, schema)
    placed = placeholders(arguments)
    needed = required(schema)
    arguments |= {
        key: registered_as[snake(key)] for key in needed if snake(key) in registered_as and key not in arguments
    }
    trials = {
        argument: values
        for argument in required(schema)
        if argument not in arguments and (values := _trials(pack, hints, argument))
    }
    missing = tuple(name for name in required(schema) if name not in arguments and name not in trials)
    can_show = missing and hints.experiment is not None
    orders = _orders(asked, arguments, schema, {*trials}) if can_show and not convert else ()
    if not missing and hints.experiment is not None:
        orders = _the_one_left(asked, arguments, optional, schema)
    if asked.voluntary and (missing or trials or not set(asked.inputs) <= placed):
        # What nobody has to have is only proposed where nothing is open.
        return None
    score = 2.0 * len(words & likely) + 0.25 * len(words_in(str(tool.get("description") or "")[:400]) & likely)
    if asked.waits not in placed:
        # A tool that waits for what it answers may be called after the other half of its work.
        score -= 3.0 * len(words & set(hints.unlikely.split()))
    # Whether a call waits speaks neither for a tool nor against it.
    telling = {*inputs} & {*asked.inputs} - {asked.waits}
    score += 2.0 * len(placed & telling) - 0.5 * len(trials)
    lacking = len(telling - placed - set(asked.optional))
    if orders:
        # An argument whose name says nothing is tried for each of them.
        score -= 2.0 * max(0, lacking - len(missing)) + 0.25 * len(missing)
    else:
        score -= 2.0 * (lacking + len(missing))
    if not inputs:
        score -= 1.0 * len(missing)
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
        orders=orders,
        stand_ins={
            key: name
            for name, pattern in pack.stand_ins.items()
            if name in asked.voluntary_inputs
            for key in properties(schema)
            if key not in needed and re.match(pattern, key, re.IGNORECASE)
        },
    )


def _orders(
    asked: Operation, arguments: Mapping[str, object], schema: Mapping[str, Any], tried: Set[str]
) -> tuple[Mapping[str, object], ...]:
    """Return the ways to give the inputs of an operation to those required arguments that take one value each, whatever they are called."""
    known, needed = properties(schema), required(schema)
    given = {f"${name}" for name in asked.inputs}
    taking = [
        key
        for key in needed
        if key not in tried
        and (key not in arguments or (isinstance(told := arguments[key], str) and told in given))
        and kinds(known[key]) & {"integer", "number", "string"}
        and "enum" not in known[key]
    ]
    rest = {key: value for key, value in arguments.items() if key not in taking}
    settled = placeholders({key: value for key, value in rest.items() if key in needed})
    telling = [name for name in asked.inputs if name not in settled]
    if not 1 <= len(taking) <= min(_MOST_UNNAMED, len(telling)):
        return ()
    ways: list[Mapping[str, object]] = []
    for chosen in permutations(telling, len(taking)):
        way: dict[str, object] = dict(zip(taking, (f"${name}" for name in chosen), strict=True))
        # What the tool does not require is not told twice.
        way |= {key: value for key, value in rest.items() if value not in way.values()}
        ways.append(way)
    return tuple(ways)


def _the_one_left(
    asked: Operation, arguments: Mapping[str, object], optional: Mapping[str, object], schema: Mapping[str, Any]
) -> tuple[Mapping[str, object], ...]:
    """Return the way to give the one input that has no argument to the one number or text that the tool does not require, whatever that is
    called."""
    left = [name for name in asked.inputs if name not in {*placeholders(arguments), *asked.optional, asked.waits}]
    free = [
        key
        for key, described in properties(schema).items()
        if key not in arguments
        and key not in optional
        and kinds(described) & {"integer", "number", "string"}
        and "enum" not in described
    ]
    return ({**arguments, free[0]: f"${left[0]}"},) if len(left) == len(free) == 1 else ()


def _trials(pack: Pack, hints: Hints, argument: str) -> tuple[str, ...]:
    known = ((_PROTOCOL, pack.names), (_CONNECTION, _CONNECTIONS), *hints.trials.items())
    return next(
        (values for pattern, values in known if values and re.match(pattern, snake(argument), re.IGNORECASE)), ()
    )


Inputs = Mapping[str, tuple[str, ...]]
"""The inputs of an operation, to the names that tools have for them."""


def _arguments(
    pack: Pack, hints: Hints, inputs: Inputs, schema: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, Any], dict[str, str]]:
    known = properties(schema)
    arguments: dict[str, Any] = {}
    optional: dict[str, Any] = {}
    convert: dict[str, str] = {}
    for name in inputs:
        actual = _named(inputs[name], known, arguments)
        if actual is not None:
            arguments[actual] = _template(pack, name, inputs, known[actual], convert)
    if not arguments:
        arguments |= _batch(pack, inputs, known, convert)
    for key, described in known.items():
        if key in arguments:
            continue
        chosen, constant, endpoint = choice(described, hints.choice), _constant(pack, key), _endpoint(key, described)
        if chosen is not None:
            # What an enumeration is about, such as a table, has to be said in any case.
            arguments[key] = chosen
        elif (value := endpoint if constant is None else constant) is not None:
            # So has what the tool takes for the opposite when it is not said, such as whether this is a dry run.
            said = key in required(schema) or (isinstance(value, bool) and described.get("default") is (not value))
            (arguments if said else optional)[key] = value
    return arguments, optional, convert


def _named(names: tuple[str, ...], known: Mapping[str, object], taken: Mapping[str, object]) -> str | None:
    """Find the property for these names; earlier names take precedence."""
    free = [key for key in known if key not in taken]
    return next((key for name in names for key in free if name in (key.lower(), snake(key))), None)


def _batch(pack: Pack, inputs: Inputs, known: Mapping[str, Any], convert: dict[str, str]) -> dict[str, Any]:
    """Find an argument that takes a list of objects, each with places for the inputs."""
    for key, schema in known.items():
        if "array" in kinds(schema):
            template = _template(pack, next(iter(inputs), ""), inputs, schema, convert)
            if isinstance(template, list) and isinstance(template[0], dict) and len(template[0]) > 1:
                return {key: template}
    return {}


def _template(pack: Pack, name: str, inputs: Inputs, schema: Mapping[str, object], convert: dict[str, str]) -> object:
    possible = kinds(schema)
    if "array" in possible and name not in pack.lists and not possible & {"string", "integer", "number"}:
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
    if possible == {"string"} and name == "value":
        convert[name] = "string"
    return f"${name}"


def _constant(pack: Pack, key: str) -> object:
    known = {**_CONSTANTS, **pack.constants}
    return next((value for pattern, value in known.items() if re.match(pattern, key, re.IGNORECASE)), None)


def _endpoint(key: str, schema: Mapping[str, object]) -> str | None:
    for pattern, placeholder in _ENDPOINT:
        if re.match(pattern, snake(key), re.IGNORECASE):
            return "{port}" if placeholder == "{port:int}" and kinds(schema) == {"string"} else placeholder
    return None
