"""The writing of a subject file, with the evidence for every entry as a comment. Pure."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from ..core.text import printable
from ..protocols.protocol import GUARD, Operation
from ..protocols.registry import protocols
from ..subject.answers import interpret, read_answer
from ..subject.command import Draw
from ..subject.model import Answering, placeholders
from .effects import Effect
from .evidence import CONNECT_FAILED, CONNECTION_LOST, TIMEOUT, failure_rules, known_errors, prose_rule
from .proposal import Proposal
from .readiness import Readiness
from .readings import Reading
from .switches import Switch

__all__ = ["Draft", "write_document"]

_LONG_S, _MOST_S = 3.0, 30.0
"""Seconds: a call that took longer needs another deadline than the default of 5, and no certificate is given for a longer one."""

_LONG_START_S = 6.0
"""A start that took longer may take longer than the default of 30 where several start at once."""

_WAITS = "receives by a call that waits"
_NO_ARGUMENT = "its tool has no argument for it"
_FROM_MEMORY = "otmcp init saw no status that the device has a part in"
_NO_TOOL, _NO_SWITCH = "otmcp init found no tool for it", "otmcp init does not know how writes are disabled"
"""Reasons for what is unclaimed; those of what was not found say who has looked."""

_BARE = re.compile(r"[A-Za-z0-9_-]+")


@dataclass(frozen=True, slots=True, kw_only=True)
class Draft:
    """The facts that are known about an adapter.

    Attributes:
        product_version: the version that its package says, and the file that it says it in.
        native: True when its answers are the kit's envelope.
        proposals: operation to its proposal; an operation without a tool is missing.
        commands: named commands by the names of their tools.
        readings: named readings by their names.
        named_reads: proposals that these readings stand for, with what they answered where they had to fail.
        connect: tool and arguments of a connect step.
        readiness: the tool that each start waits for; None where no tool spoke of connecting.
        recovery: how it went on after an outage; None where nothing showed it.
        tools: names of all its tools.
        switch: what was seen to disable and to enable its writes.
        switches: what may do so by its name.
        started_s: how long its start took, with the handshake.
        longest_s: how long the longest call took that was answered.
        errors: error code to patterns of the texts in which the protocol's libraries report it.
        left: sentences on the entries that the user has to fill in; :func:`write_document` adds to it.
    """

    protocol: str
    name: str
    server_version: str
    product_version: tuple[str, str] | None
    command: Sequence[str]
    env: Mapping[str, str]
    files: Mapping[str, str]
    secret_env: Sequence[str]
    era: str | None
    transport_url: str | None
    native: bool
    proposals: Mapping[str, Proposal]
    commands: Mapping[str, Effect]
    connect: tuple[str, Mapping[str, object]] | None
    readiness: Readiness | None
    recovery: str | None
    tools: Sequence[str]
    started_s: float
    longest_s: float
    errors: Mapping[str, Sequence[str]]
    readings: Mapping[str, Reading] = field(default_factory=dict)
    named_reads: Sequence[Proposal] = ()
    choices: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    switch: Switch | None = None
    switches: Sequence[Switch] = ()
    left: list[str] = field(default_factory=list)

    @property
    def lacking(self) -> set[str]:
        """The operations that an adapter with the keys of its protocol as they are proposed need not have."""
        known = protocols()[self.protocol].choices
        chosen = [(choice, self.choices[choice.key][0]) for choice in known if choice.key in self.choices]
        return {
            operation
            for choice, value in chosen
            for operation in (*choice.unclaims[value], *choice.unbound.get(value, {}))
            if operation not in self.proposals
        }

    @property
    def spared(self) -> list[str]:
        """The operations that need not be bound, because a call that waits does their work as well."""
        waiting = {name for name, proposal in self.proposals.items() if proposal.proven and proposal.blocking}
        proven = {name for name, proposal in self.proposals.items() if proposal.proven}
        return [
            facet
            for composite in protocols()[self.protocol].composites.values()
            for operation, instead in composite.if_waiting.items()
            if operation in waiting
            for facet in composite.facets
            if facet not in instead and facet not in proven
        ]


def write_document(draft: Draft, *, into: bool = False) -> str:
    """Return the subject file; add the entries that the user has to fill in to ``draft.left``."""
    form = _form(draft)
    head = [
        "# Proposed by `otmcp init`: guessed from names, tried at a mock device. Read every line; `otmcp docs",
        "# subject-file` prints what each key means.",
        "",
        "[subject]",
        f"name = {_value(draft.name)}",
        *_version(draft),
        "",
    ]
    lines = [
        *([] if into else head),
        f"[adapter.{draft.protocol}]",
        f"command = {_value(list(draft.command))}",
    ]
    if not into and draft.product_version is None:
        draft.left.append("the version of your product")
    if draft.env:
        lines.append(f"env = {_value(dict(draft.env))}")
    if draft.secret_env:
        lines.append(f"secret_env = {_value(list(draft.secret_env))}")
    if draft.files:
        lines.append(f"files = {_value(dict(draft.files))}")
    if draft.era is not None:
        lines.append(f"era = {_value(draft.era)}")
    if draft.started_s > _LONG_START_S:
        lines += [
            f"# Its start took {draft.started_s:.1f} s; the default is 30, and a busy machine takes longer.",
            f"start_timeout_s = {10.0 * math.ceil(draft.started_s / 2.0):.1f}",
        ]
    if draft.longest_s > _LONG_S:
        lines += [
            f"# The longest call took {draft.longest_s:.1f} s; the default is 5.",
            f"deadline_s = {min(_MOST_S, 5.0 * math.ceil(draft.longest_s / 5.0 + 1.0)):.1f}",
        ]
    if draft.transport_url is not None:
        lines += ['transport = "http"', f"url = {_value(draft.transport_url)}"]
    for key, (value, why) in draft.choices.items():
        lines += [f"# {why}", f"{key} = {_value(value)}"]
    lines += _disabling(draft)
    if draft.switch is None:
        hint = (
            f"; with --env {draft.switches[0].name}=VALUE that enables them otmcp init proves it"
            if draft.switches
            else ""
        )
        draft.left.append(f"how writes are disabled: 'ro' and 'rw' (until then 'guard' is declared as unclaimed{hint})")
    if draft.connect is not None:
        tool, arguments = draft.connect
        lines += [
            "# By its name this tool has to be called before all others.",
            f"connect = {_value({'tool': tool, 'arguments': dict(arguments)})}",
        ]
    if draft.recovery not in (None, "same_session"):
        lines += [
            "# After the device had been away nothing else helped. Take the line away when it goes on in the same session.",
            f"recovery = {_value(draft.recovery)}",
        ]
    if draft.readiness is not None:
        lines += [
            f"# Just after its start it said {printable(draft.readiness.before[:60])!r}: each start waits for the answer that came later.",
            f"ready = {_value(dict(draft.readiness.table))}",
        ]
    if not draft.native:
        lines += _answer_rules(draft, form)
    lines += _unclaimed(draft)
    # The file cannot be read without this table, even an empty one.
    lines += [
        "",
        f"# Its tools: {', '.join(draft.tools)}.",
        '# An operation of several calls, or with an argument that is made of others (a channel "H40"), is a Python function:',
        '# bindings = "otmcp_bindings.py" in the table above; the guide to subject files has an example under "What TOML cannot say".',
        f"[adapter.{draft.protocol}.bind]",
    ]
    for operation, known in protocols()[draft.protocol].operations.items():
        if operation in draft.proposals or not (known.voluntary or operation in draft.lacking):
            lines += ["", *_binding(draft, operation, form)]
    for name, reading in draft.readings.items():
        lines += ["", *_reading(draft, name, reading, form)]
    for name, effect in draft.commands.items():
        lines += ["", *_command(draft, name, effect, form)]
    # A comment may repeat the adapter's words: it stays one line, of characters that TOML allows in a comment.
    return "\n".join(printable(line) if line.startswith("#") else line for line in lines) + "\n"


def _version(draft: Draft) -> list[str]:
    if draft.product_version is not None:
        version, file = draft.product_version
        return [f"# By {file}.", f"version = {_value(version)}"]
    return [
        f"# Fill in the version of your product. {_about_version(draft.server_version)}",
        'version = "unknown"',
    ]


def _about_version(version: str) -> str:
    return f"The server says {_value(version)}, which may be its SDK's." if version else "The server says none."


def _disabling(draft: Draft) -> list[str]:
    """Return how writes are disabled, as was seen, or as may be by what is called so."""
    if draft.switch is not None:
        return [
            f"# {draft.switch.name}: launched as `ro` a write failed, and the device saw nothing of it; launched as `rw` it saw the write.",
            *_launches(draft.switch),
        ]
    lines = [
        "# How are writes disabled? The variant `ro` must refuse every write, `rw` must allow them; without that there can be a",
        "# conformant run, but no certificate. For instance:",
    ]
    names = dict.fromkeys(one.name for one in draft.switches)
    for switch in (next(one for one in draft.switches if one.name == name) for name in names):
        lines.append(f"# {switch.name} looks like it, which is not proven:")
        lines += [f"# {line}" for line in _launches(switch)]
    if draft.switches:
        return lines
    return [*lines, '# ro = { args = ["--read-only"] }', '# rw = { env = { WRITES_ENABLED = "true" } }']


def _launches(switch: Switch) -> list[str]:
    return [f"{name} = {_value(entries)}" for name, entries in (("ro", switch.ro), ("rw", switch.rw)) if entries]


def _unclaimed(draft: Draft) -> list[str]:
    """Return what is declared as missing: what a call that waits does as well, and what was not found, which proves nothing."""
    lines = [f"{facet} = {_value(_WAITS)}" for facet in draft.spared]
    lines += [
        "# Not proven, only proposed: take a line away when the adapter has what it names, and say above or below how.",
    ]
    if draft.switch is None:
        lines += ["# The launch with writes disabled is not known yet:", f"{GUARD} = {_value(_NO_SWITCH)}"]
    for operation, asked in protocols()[draft.protocol].operations.items():
        lines += _without_argument(draft, operation, asked)
        if operation in draft.spared or (draft.commands and asked.writes) or _by_reading(draft, operation):
            # It stands above; or the named commands say how the adapter writes, or the named readings how it reads.
            continue
        if operation not in {*draft.proposals, *draft.lacking} and not asked.voluntary:
            lines += [f"# No tool is called like one for it: {asked.meaning}.", f"{operation} = {_value(_NO_TOOL)}"]
        elif (said := _said_without_device(draft, operation)) is not None:
            lines += [f"# {asked.meaning}: {said}.", f"{operation} = {_value(_FROM_MEMORY)}"]
        elif not asked.voluntary and (other := _proven_otherwise(draft, operation)) is not None:
            tool = draft.proposals[operation].guess.tool
            lines += [
                f"# {asked.meaning}: {tool!r} is the likeliest tool, and it is {other}.",
                f"{operation} = {_value(_NO_TOOL)}",
            ]
    return ["", f"[adapter.{draft.protocol}.unclaimed]", *lines]


def _without_argument(draft: Draft, operation: str, asked: Operation) -> list[str]:
    """Return the optional inputs for which the tool of a proven operation has no argument."""
    proposal = draft.proposals.get(operation)
    if proposal is None or not proposal.proven:
        return []
    given = placeholders(proposal.guess.arguments)
    return [
        f"{_key(f'{operation}.{name}')} = {_value(_NO_ARGUMENT)}"
        for name in asked.optional
        if name in asked.inputs and name not in given
    ]


def _skeleton(asked: Operation) -> str:
    """Return a binding in which only what is in capitals has to be said."""
    inputs = [name for name in asked.inputs if name not in (*asked.optional, asked.waits)]
    arguments = ", ".join(f'ARGUMENT_FOR_{name.upper()} = "${name}"' for name in inputs)
    results = ", ".join(f'{name} = "PATH"' for name in asked.needed)
    parts = ['tool = "TOOL"', *([f"arguments = {{ {arguments} }}"] if inputs else [])]
    return f"{{ {', '.join([*parts, *([f'result = {{ {results} }}'] if results else [])])} }}"


def _said_without_device(draft: Draft, operation: str) -> str | None:
    """Return what is known of a status of which the device saw nothing, or that says nothing of the device; None for any other tool."""
    proposal = draft.proposals.get(operation)
    if proposal is None or proposal.proven or not proposal.tried or proposal.guess.missing:
        return None
    tool = proposal.guess.tool
    return f"{tool}: {proposal.evidence[0]}" if protocols()[draft.protocol].operations[operation].status else None


def _proven_otherwise(draft: Draft, operation: str) -> str | None:
    """Return the operation that the tool of an unproven proposal was proven to perform; None where there is none."""
    proposal = draft.proposals.get(operation)
    if proposal is None or proposal.proven:
        return None
    proven = {one.guess.tool: name for name, one in draft.proposals.items() if one.proven}
    return proven.get(proposal.guess.tool)


def _form(draft: Draft) -> str:
    """Return the form that most answers have."""
    found = list(draft.proposals.values())
    forms = Counter(proposal.form for proposal in found if proposal.form is not None)
    forms.update(one.form for one in draft.readings.values())
    if forms:
        return forms.most_common(1)[0][0]
    answers = [proposal.good for proposal in found if proposal.good is not None]
    objects = [isinstance(read_answer(answer, "json")[0], dict) for answer in answers]
    return "json" if any(objects) else "text"


def _outcome_rules(draft: Draft, form: str) -> list[dict[str, object]]:
    """Return the rules that tell the failures that were tried from successes."""
    proven = [proposal for proposal in (*draft.proposals.values(), *draft.named_reads) if proposal.proven]
    successes = [proposal.good for proposal in proven if proposal.good is not None]
    failures = [failure for proposal in proven for _, failure in proposal.failures]
    rules = [rule for failure in failures for rule in failure_rules(failure, successes, form)]
    return [rule for index, rule in enumerate(rules) if rule not in rules[:index]]


def _prose(draft: Draft, success: Mapping[str, object] | None, form: str) -> list[str]:
    """Return the entry of a tool that writes and answers in sentences, for failures that it tells in sentences too."""
    rule = None if draft.native or success is None else prose_rule(success)
    if rule is None:
        return []
    return [
        "# It answers in sentences, and failures may be sentences as well.",
        *_rules("outcome", [*_outcome_rules(draft, form), rule]),
    ]


def _answer_rules(draft: Draft, form: str) -> list[str]:
    lines = [f"answer = {_value(form)}"]
    outcome = _outcome_rules(draft, form)
    proven = [proposal for proposal in (*draft.proposals.values(), *draft.named_reads) if proposal.proven]
    successes = [proposal.good for proposal in proven if proposal.good is not None]
    errors: list[dict[str, str]] = []
    patterns = {
        "connect_failed": CONNECT_FAILED,
        "connection_lost": CONNECTION_LOST,
        "timeout": TIMEOUT,
        **draft.errors,
    }
    failures = [(proposal, *failed) for proposal in proven for failed in proposal.failures]
    for tried, code, failure in failures:
        rules = failure_rules(failure, successes, form)
        # An adapter may not have noticed yet that the device is gone, or that it is silent.
        if not rules and code not in ("connect_failed", "timeout") and interpret(failure, Answering(form=form)).success:
            draft.left.append(
                f"outcome: nothing tells a failure of {tried.guess.tool!r} from a success; see its answer"
            )
        text = json.dumps(failure, ensure_ascii=False)
        found = known_errors(patterns, code, text)
        errors += [rule for rule in found if rule not in errors]
        if not found:
            said = _value(_shortened(interpret(failure, Answering(form=form)).text)) if "result" in failure else text
            lines.append(f"# {tried.guess.tool}: what had to fail as {code} was answered with {_shortened(said)}")
    if outcome:
        lines += ["# Failures that isError does not tell, as tried:", *_rules("outcome", outcome)]
    if errors:
        lines += ["# Codes of failures, as tried; add those of your own:", *_rules("errors", errors)]
    return lines


def _rules(name: str, rules: Sequence[Mapping[str, object]]) -> list[str]:
    return [f"{name} = [", *(f"  {_value(dict(rule))}," for rule in rules), "]"]


def _binding(draft: Draft, operation: str, form: str) -> list[str]:
    asked = protocols()[draft.protocol].operations[operation]
    head = f"[adapter.{draft.protocol}.bind.{operation}]"
    proposal = draft.proposals.get(operation)
    if operation in draft.spared:
        return [f"# {operation}: {asked.meaning}. It is unclaimed above: {_WAITS}."]
    if proposal is None and draft.commands and asked.writes:
        return [f"# {operation}: {asked.meaning}. The named commands below say how it writes."]
    if proposal is None and _by_reading(draft, operation):
        return [f"# {operation}: {asked.meaning}. The named readings below say how it reads."]
    if proposal is None:
        draft.left.append(
            f"{operation} ({asked.meaning}): no tool was found, so it is declared as unclaimed; bind one if there is one"
        )
        return [
            f"# {operation}: {asked.meaning}. No tool was found.",
            f"# {operation} = {_skeleton(asked)}",
        ]
    guess = proposal.guess
    body = [f"tool = {_value(guess.tool)}", f"arguments = {_value({**guess.arguments, **proposal.by_input})}"]
    if proposal.blocking:
        body.append("blocking = true")
    if proposal.offset:
        body.append(f"offset = {_value(dict(proposal.offset))}")
    if guess.convert:
        body.append(f"as = {_value(dict(guess.convert))}")
    if not draft.native and proposal.form is not None and proposal.form != form:
        body.append(f"answer = {_value(proposal.form)}")
    if asked.writes:
        body += _prose(draft, proposal.good, form)
    if proposal.outputs:
        body.append(f"result = {_value({name: _output(rule) for name, rule in proposal.outputs.items()})}")
    lacking = [name for name in asked.needed if name not in proposal.outputs]
    comments = [
        f"# {asked.meaning}",
        *(
            f"# {'likely' if not proposal.tried else 'proven' if proposal.proven and not lacking else 'seen'}: {line}"
            for line in proposal.evidence
        ),
        *(f"# not proven: {line}" for line in proposal.caveats),
        *(f"# tried before: {line}" for line in proposal.likelier),
    ]
    if proposal.proven and not lacking:
        return [*comments, head, *body]
    if asked.voluntary:
        comments.append("# Who binds it claims it. Take the comment signs away when it is right.")
        body += [f'# result = {{ {name} = "JMESPath" }}' for name in lacking[:1]]
    elif _said_without_device(draft, operation) is not None:
        comments.append("# It is unclaimed above; take the comment signs away when it is right.")
    elif proposal.proven:
        draft.left.append(f"{operation}: where {' and '.join(lacking)} is in the answer of {guess.tool!r}")
        body.append(f'# result = {{ {lacking[0]} = "JMESPath" }}')
    elif (other := _proven_otherwise(draft, operation)) is not None:
        draft.left.append(
            f"{operation} ({asked.meaning}): {guess.tool!r} is {other}, so it is declared as unclaimed; bind a tool if there is one"
        )
        comments.append("# It is unclaimed above; take the comment signs away when there is such a tool.")
    else:
        draft.left.append(
            f"{operation} ({asked.meaning}): {guess.tool!r} was the likeliest tool, but the device saw no proof"
        )
        comments.append("# Only a guess; take the comment signs away when it is right.")
    # A binding that is only a guess, or lacks a result, stays a comment.
    return [*comments, *(f"# {line}" for line in (head, *body))]


def _by_reading(draft: Draft, operation: str) -> bool:
    return bool(draft.readings) and operation in protocols()[draft.protocol].places and operation not in draft.proposals


def _reading(draft: Draft, name: str, reading: Reading, form: str) -> list[str]:
    """Return the table of a named reading."""
    operation, inputs = reading.source
    value: object = dict(reading.rule)
    if reading.means is not None:
        value = {**reading.rule, "means": reading.means}
    elif set(reading.rule) == {"path"}:
        value = reading.rule["path"]
    beyond = (
        []
        if reading.otherwise is None
        else [
            f"# While the device held {reading.otherwise} it answered otherwise. If that cannot be at your device, say what it can hold:",
            "# holds = { lowest = 0, highest = 1000 }",
        ]
    )
    rounded = (
        []
        if not reading.step
        else [
            "# The answers are rounded, so that only values so far apart can be told from one another.",
            f"holds = {_value(_grid(reading))}",
        ]
    )
    return [
        f"# proven: {reading.samples} answers followed what the device held, as this table says.",
        f"[adapter.{draft.protocol}.readings.{_key(name)}]",
        *([f"tool = {_value(reading.tool)}"] if reading.tool != name else []),
        *([f"means = {_value(dict(reading.draws))}"] if reading.draws else []),
        f"arguments = {_value(dict(reading.arguments))}",
        *([f"answer = {_value(reading.form)}"] if not draft.native and reading.form != form else []),
        f"source.{operation} = {_value(dict(inputs))}",
        f"value = {_value(value)}",
        *rounded,
        *beyond,
    ]


def _grid(reading: Reading) -> dict[str, int]:
    lowest, highest = reading.bounds or (0, 0)
    step = int(reading.step)
    return {"lowest": -(-lowest // step) * step, "highest": highest // step * step, "step": step}


def _command(draft: Draft, name: str, effect: Effect, form: str) -> list[str]:
    """Return the table of a named command."""
    drawn = effect.command.draws
    ranges = {
        one: list(draw.values)
        or {"lowest": draw.lowest, "highest": draw.highest, **({} if draw.step == 1 else {"step": draw.step})}
        for one, draw in drawn.items()
        if not _by_text(draw)
    }
    means = {
        one: dict(zip(draw.values, draw.means, strict=True)) if _by_text(draw) else list(draw.means)
        for one, draw in drawn.items()
        if draw.means
    }
    return [
        f"# proven: with each of {effect.calls} calls the device saw one {effect.operation}, as this table says.",
        f"[adapter.{draft.protocol}.commands.{_key(name)}]",
        *([f"draws = {_value(ranges)}"] if ranges else []),
        *([f"means = {_value(means)}"] if means else []),
        f"arguments = {_value(dict(effect.arguments))}",
        *_prose(draft, effect.good, form),
        f"effect.{effect.operation} = {_value(dict(effect.command.effect))}",
        # Of a file that reads other parts of the answers nothing is said here.
        *(
            f"says.{_key(one)} = {_value(_output(rule))}"
            for one, rule in effect.says.items()
            if draft.native or effect.form == form
        ),
    ]


def _by_text(draw: Draw) -> bool:
    """Tell whether a table of meanings has the values themselves as its names."""
    return bool(draw.means) and all(isinstance(value, str) for value in draw.values)


def _output(rule: Mapping[str, object]) -> object:
    return rule["path"] if set(rule) == {"path"} else dict(rule)


def _shortened(text: str, width: int = 600) -> str:
    text = " ".join(text.split())
    return text if len(text) <= width else text[:width] + " ..."


def _value(value: object) -> str:
    """Write a value as TOML, tables inline."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # Literal strings keep regular expressions readable; TOML's basic strings escape as JSON's do.
        if "\\" in value and "'" not in value and value.isprintable():
            return f"'{value}'"
        return _quoted(value)
    if isinstance(value, Mapping):
        if not value:
            return "{}"
        members = ", ".join(f"{_key(name)} = {_value(member)}" for name, member in value.items())
        return f"{{ {members} }}"
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    return repr(value)


def _key(name: str) -> str:
    return name if _BARE.fullmatch(name) else _quoted(name)


def _quoted(text: str) -> str:
    escaped = json.dumps(text, ensure_ascii=False)
    return "".join(letter if letter.isprintable() else f"\\U{ord(letter):08x}" for letter in escaped)
