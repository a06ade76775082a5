"""A subject file with random content is understood or refused in one sentence, and the editors' schema agrees."""

from __future__ import annotations

import copy
import datetime
import random
import tomllib
from collections.abc import Callable, Iterator
from importlib import resources
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jsonschema
import pytest

from pytest_otmcp.errors import UsageError
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.subject import Subject, load_subject, reference_subject
from pytest_otmcp.subject.grammar import subject_file
from pytest_otmcp.subject.kinds import ANYTHING, DATE, FLAG, NUMBER, SECONDS, Expression, Kind, OneOf, Scalar
from pytest_otmcp.subject.schema import schema
from pytest_otmcp.subject.tables import ByType, ListOf, MapOf, Named, Table, Template

FOREIGN = """
[subject]
name = "x"
version = "1"
[adapter.mqtt]
command = ["{dir}/adapter", "{env:HOME}"]
files = { "c.json" = "{port}" }
rw = { args = ["--write"] }
connect = { tool = "connect", arguments = { port = "{port:int}" } }
recovery = "connect_step"
unclaimed = { guard = "none" }
answer = "json"
outcome = [{ path = "success == `false`", then = "failure" }]
errors = [{ text = "refused", code = "connect_failed" }]
probes = { bad_qos = 3 }
[[adapter.mqtt.bind.publish]]
tool = "publish"
when = { qos = 0 }
arguments = { messages = [{ topic = "$topic", payload = "$payload" }] }
as = { payload = "string" }
[[adapter.mqtt.bind.publish]]
tool = "publish_acknowledged"
result = { topic = { path = "topic", regex = "(.*)" } }
[[deviation]]
item = "Q1"
reason = "known"
expires = 2030-01-01
"""
JUNK: list[Any] = [
    1, -1, 0, 1.5, float("nan"), True, "", "x", "$y", "{z}", "(", "a.b[", "{env:NOT_SET_ANYWHERE}", "../x", "\0", "é" * 10, {},
    {"a": 1}, {"path": "@"}, {"regex": "("}, {"then": "failure"}, [], [1], ["a"], [[]], [{}],
]  # fmt: skip
NAMES = [
    "command",
    "tool",
    "as",
    "when",
    "result",
    "path",
    "then",
    "blocking",
    "resource",
    "bindings",
    "url",
    "surprise",
]


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    if path:
        yield path
    members = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for name, member in members:
        yield from places(member, (*path, name))


def mutated(document: dict[str, Any], choice: random.Random) -> dict[str, Any]:
    document = copy.deepcopy(document)
    for _ in range(choice.randint(1, 2)):
        *way, last = choice.choice(list(places(document)))
        place: Any = document
        for step in way:
            place = place[step]
        what = choice.random()
        if what < 0.6:
            place[last] = copy.deepcopy(choice.choice(JUNK))
        elif what < 0.8:
            del place[last]
        elif isinstance(place, dict):
            place[choice.choice(NAMES)] = copy.deepcopy(choice.choice(JUNK))
    return document


@pytest.fixture
def load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[dict[str, Any]], tuple[Subject | None, str]]:
    """A function that loads a document without writing it: TOML cannot express every value of these documents."""
    file = tmp_path / "otmcp.toml"
    file.write_bytes(b"")
    reference_subject()

    def loaded(document: dict[str, Any]) -> tuple[Subject | None, str]:
        loads = SimpleNamespace(loads=lambda text: document, TOMLDecodeError=tomllib.TOMLDecodeError)
        monkeypatch.setattr("pytest_otmcp.subject.load.tomllib", loads)
        try:
            return load_subject(file), ""
        except UsageError as refusal:
            return None, str(refusal)

    return loaded


def original(which: str) -> dict[str, Any]:
    reference = (resources.files("pytest_otmcp.subject") / "reference.toml").read_text(encoding="utf-8")
    return tomllib.loads(FOREIGN if which == "foreign" else reference)


@pytest.mark.parametrize("which", [pytest.param("reference", marks=pytest.mark.long), "foreign"])
def test_anything_is_understood_or_refused_in_one_sentence(
    which: str, load: Callable[[dict[str, Any]], tuple[Subject | None, str]]
) -> None:
    document = original(which)
    understood, number = 0, 700 if which == "reference" else 250
    for seed in range(number):
        subject, refusal = load(mutated(document, random.Random(seed)))
        if subject is None:
            assert "\n" not in refusal
            assert "otmcp.toml: " in refusal
            continue
        understood += 1
        for adapter in subject.adapters.values():
            adapter.facts()
            adapter.secret_values()
            for variant in adapter.variants.values():
                variant.for_endpoint({"host": "127.0.0.1", "port": "1"})
    # Some documents are understood and some are not: otherwise the mutations, or the reader, would be worth little.
    assert number / 14 < understood < number * 13 / 14


BY_KIT_ALONE = (
    "not a JMESPath expression",
    "not a regular expression",
    "is no input of this operation",
    "an input stands alone",
    "an adapter that answers in envelopes needs no such rules",
    "without 'when' it hides the tables after it",
    "expected 'bind' tables",
    "has a function for this operation as well",
    "there is no such file",
    "is not there",
    "expected TOPIC=PAYLOAD",
    "cannot be imported",
    "is not a directory",
    "the environment variable NOT_SET_ANYWHERE is not set",
    "must be a name below {work}",
    "the target of 'approval' needs",
    "expected http:// with a loopback address",
    "expected a date",
    "more than one for the item",
    ", found nan",
    "is no value that is drawn",
    "is given to no argument of the tool",
    "has no part in it",
    "which is no number for each of its values",
    "two values of an argument are the same at the device",
    "'draws' has values for this argument as well",
    "expected a 'highest' that is not below 'lowest'",
    "that every reader of JSON reads alike",
    "found an empty table",
    "expected as many values as the list of this argument",
    "has this effect as well",
    "read the same place",
    "has no such place, or it holds more than one value",
    "is what none of the words in 'value.means' means",
    "what is always the same shows no reading",
    "is no value that the place in 'source' can hold",
)
"""Refusals beyond the schema: languages inside of strings, other files, rules about several tables, TOML's types."""


def drawn(kind: Kind, choice: random.Random) -> Any:
    """Draw a value that the grammar allows; its rules about several tables together are left to chance."""
    match kind:
        case Named() | MapOf():
            value = drawn(kind.kind, choice)
            return {"ns=2;s=a": value} if isinstance(kind, MapOf) else value
        case ByType():
            return drawn(choice.choice([kind.kind, kind.otherwise]), choice)
        case ListOf():
            return [drawn(kind.kind, choice) for _ in range(choice.randint(max(1, kind.least), 2))]
        case OneOf():
            return choice.choice(kind.known)
        case Template():
            return {"a": [f"${name}" for name in kind.inputs]}
        case Expression():
            return choice.choice(["a", "a.b", "@"]) if "JMESPath" in kind.language else choice.choice(["a", "(a)|b"])
        case Table():
            few = [name for name, key in kind.keys.items() if key.required or choice.random() < 2 / len(kind.keys)]
            few += [name for name in ("command", "tool", "path", "then") if name in kind.keys and name not in few]
            return {name: drawn(kind.keys[name].kind, choice) for name in choice.sample(few, len(few))}
        case Scalar() if kind in (NUMBER, SECONDS):
            return choice.choice([1, 0.5, 300])
        case Scalar() if kind is DATE:
            return datetime.date(2030, 1, choice.randint(1, 31))
        case Scalar() if kind is FLAG:
            return choice.choice([True, False])
        case Scalar() if "$value" in kind.expected:
            return choice.choice(["$value", "$value * 0.1 - 40"])
        case Scalar() if kind is ANYTHING:
            return choice.choice([1, "a", [True], {}])
        case Scalar():
            return ["a", "{port}"] if "list" in kind.expected else choice.choice(["a", "{port}"])
    raise AssertionError(f"no example of {kind}")


@pytest.mark.parametrize(
    "which",
    [
        pytest.param("reference", marks=[pytest.mark.long, pytest.mark.weekly]),
        pytest.param("foreign", marks=pytest.mark.long),
        "drawn",
    ],
)
def test_the_editors_schema_and_the_kit_agree(
    which: str, load: Callable[[dict[str, Any]], tuple[Subject | None, str]]
) -> None:
    validator = jsonschema.Draft202012Validator(schema(protocols()))
    grammar = subject_file(protocols())
    understood, refused = 0, 0
    for seed in range(240 if which == "drawn" else 160):
        choice = random.Random(seed)
        document = drawn(grammar, choice) if which == "drawn" else original(which)
        if which != "drawn" or seed % 2:
            document = mutated(document, choice)
        subject, refusal = load(document)
        errors = [error.message for error in validator.iter_errors(document)]
        if subject is not None:
            understood += 1
            assert not errors, (seed, errors)
        elif errors:
            refused += 1
        else:
            assert any(sentence in refusal for sentence in BY_KIT_ALONE), (seed, refusal)
    assert min(understood, refused) > 25
