"""Handles: the file says where an answer has them, and which later call takes them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from pytest_otmcp.errors import UsageError
from pytest_otmcp.protocols.mqtt.filters import covers
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.replay.reply import restored_bindings
from pytest_otmcp.subject import Subject, load_subject
from pytest_otmcp.subject.comparison import stored_bindings
from pytest_otmcp.subject.handles import Handles
from pytest_otmcp.subject.model import Binding

HEAD = """
[subject]
name = "x"
version = "1"
[adapter.mqtt]
command = ["x"]
answer = "structured"
connect = { tool = "open", keep = { session = "id" } }
{more}
[adapter.mqtt.bind.subscribe]
tool = "watch"
arguments = { session = "$connect.session", topic = "$filter" }
keep = { watch = { path = "watch", as = "int" } }
[adapter.mqtt.bind.messages]
tool = "read"
arguments = { {taken} }
result.messages = "messages"
"""
TAKEN = 'session = "$connect.session", of = ["$subscribe.watch"]'

Load = Callable[..., Subject]


@pytest.fixture
def load(tmp_path: Path) -> Load:
    def loaded(taken: str = TAKEN, more: str = "", head: str = HEAD) -> Subject:
        file = tmp_path / "otmcp.toml"
        file.write_text(head.replace("{taken}", taken).replace("{more}", more), encoding="utf-8")
        return load_subject(file)

    return loaded


def only(subject: Subject, operation: str) -> Binding:
    bound = subject.adapters["mqtt"].operations[operation]
    assert isinstance(bound, tuple)
    return bound[0]


def test_a_handle_is_an_argument_wherever_the_template_has_it(load: Load) -> None:
    binding = only(load(), "messages")
    taken = {"connect.session": 3, "subscribe.watch": 7}
    assert binding.fill({"filter": "a"}, {}, taken) == {"session": 3, "of": [7]}
    assert binding.fill({"filter": "a"}, {}) == {"of": []}
    assert binding.follows
    assert not only(load(), "subscribe").follows


def test_a_record_has_what_is_kept(load: Load) -> None:
    subject = load()
    stored = {name: stored_bindings(subject.adapters["mqtt"], name) for name in ("subscribe", "messages")}
    assert "keep" not in (stored["messages"] or [{}])[0]
    restored = restored_bindings(stored)
    assert restored == {name: [only(subject, name)] for name in stored}


@pytest.mark.parametrize(
    ("taken", "more", "sentence"),
    [
        (
            'of = "$subscribe.wach"',
            "",
            "adapter.mqtt.bind.messages.arguments: $subscribe.wach is a handle that no call before this one keeps; "
            "did you mean '$subscribe.watch'?",
        ),
        (
            TAKEN,
            'ready = { tool = "state", arguments = { of = "$subscribe.watch" } }',
            "adapter.mqtt.ready.arguments: $subscribe.watch is a handle that no call before this one keeps; "
            "known are $connect.session",
        ),
        (
            TAKEN,
            'commands.ring = { arguments = { of = "$publish.x" }, effect.publish = { topic = "bell", payload = "x" } }',
            "adapter.mqtt.commands.ring.arguments: $publish.x is a handle that no call before this one keeps; "
            "known are $connect.session, $subscribe.watch",
        ),
        ('of = "$wach"', "", "adapter.mqtt.bind.messages.arguments.of: $wach is no input of this operation"),
    ],
)
def test_a_handle_that_nothing_keeps_is_one_sentence(load: Load, taken: str, more: str, sentence: str) -> None:
    with pytest.raises(UsageError) as refused:
        load(taken, more)
    assert str(refused.value).partition(": ")[2].startswith(sentence)


def test_the_connect_step_takes_no_handle(load: Load) -> None:
    head = HEAD.replace('tool = "open",', 'tool = "open", arguments = { of = "$subscribe.watch" },')
    with pytest.raises(UsageError, match=r"connect\.arguments: \$subscribe\.watch is a handle that no call before"):
        load(head=head)


@pytest.mark.parametrize(
    ("asked", "handle"),
    [("a/#", 1), ("a/b", 2), ("a/c", 1), ("a/+/c", 1), ("b", 3)],
    ids=str,
)
def test_a_call_takes_the_handle_of_the_call_that_was_about_the_same(asked: str, handle: int) -> None:
    handles = Handles(protocols()["mqtt"].covers)
    for filter_, value in (("b", 0), ("a/#", 1), ("a/b", 2), ("b", 3)):
        handles.keep("subscribe", "watch", {"filter": filter_, "qos": 0}, {"watch": value})
    assert handles.take({"subscribe.watch"}, {"filter": asked}) == {"subscribe.watch": handle}
    assert handles.take({"subscribe.watch"}, {}) == {"subscribe.watch": 3}


def test_a_connect_step_that_is_repeated_yields_the_handle_anew() -> None:
    handles = Handles(protocols()["modbus"].covers)
    for value in (1, 2):
        handles.keep("connect", "open", {}, {"session": value})
    assert handles.take({"connect.session"}, {"address": 5}) == {"connect.session": 2}


def test_why_there_is_no_handle_is_one_sentence() -> None:
    handles = Handles(protocols()["mqtt"].covers)
    with pytest.raises(LookupError) as gap:
        handles.take({"subscribe.watch"}, {"filter": "a/b"})
    assert gap.value.args == ("$subscribe.watch, and no successful subscribe of this session was for filter='a/b'",)
    handles.keep("subscribe", "watch", {"filter": "a/#"}, {"watch": None})
    with pytest.raises(LookupError) as gap:
        handles.take({"subscribe.watch"}, {"filter": "a/b"})
    assert gap.value.args == ("$subscribe.watch, and the answer of watch has nothing where 'keep' looks for it",)


@pytest.mark.parametrize(
    ("text", "other", "expected"),
    [
        ("a/#", "a", True),
        ("a/#", "a/b/+", True),
        ("a/+", "a/+", True),
        ("a/+", "a/#", False),
        ("a/b", "a/+", False),
        ("a/b", "a/b/c", False),
        ("#", "$SYS/x", False),
    ],
)
def test_a_filter_covers_another_when_it_selects_all_of_it(text: str, other: str, expected: bool) -> None:
    assert covers(text, other) == expected
