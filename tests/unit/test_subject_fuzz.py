"""A subject file with anything in it is understood or refused in one sentence; nothing else comes out of reading it."""

from __future__ import annotations

import copy
import random
import tomllib
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pytest_otmcp.errors import UsageError
from pytest_otmcp.subject import Subject, load_subject, reference_subject

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


def loaded(file: Path) -> tuple[Subject | None, str]:
    try:
        return load_subject(file), ""
    except UsageError as refusal:
        return None, str(refusal)


@pytest.mark.parametrize("which", ["reference", "foreign"])
def test_anything_is_understood_or_refused_in_one_sentence(
    which: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reference = (resources.files("pytest_otmcp.subject") / "reference.toml").read_text(encoding="utf-8")
    document = tomllib.loads(FOREIGN if which == "foreign" else reference)
    file = tmp_path / "otmcp.toml"
    file.write_bytes(b"")
    reference_subject()
    understood = 0
    for seed in range(1500):
        changed = mutated(document, random.Random(seed))
        # TOML cannot say everything that this can, and need not be written to be read.
        loads = SimpleNamespace(loads=lambda text, changed=changed: changed, TOMLDecodeError=tomllib.TOMLDecodeError)
        monkeypatch.setattr("pytest_otmcp.subject.load.tomllib", loads)
        subject, refusal = loaded(file)
        if subject is None:
            assert "\n" not in refusal
            assert str(file) in refusal
            continue
        understood += 1
        for adapter in subject.adapters.values():
            adapter.facts()
            adapter.secret_values()
            for variant in adapter.variants.values():
                variant.for_endpoint({"host": "127.0.0.1", "port": "1"})
    # Neither everything nor nothing: else the mutations, or the reader, would be worth little.
    assert 50 < understood < 1400
