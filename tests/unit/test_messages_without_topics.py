"""Messages without topics: each is of the topic that was asked for, where it was one and the tool was told it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from pytest_otmcp.replay.reply import restored_bindings
from pytest_otmcp.session.exchange import Exchange
from pytest_otmcp.subject import Adapter, load_subject
from pytest_otmcp.subject.comparison import stored_bindings
from pytest_otmcp.subject.model import Binding
from pytest_otmcp.trial.reply import Expectation, observe

FILE = """
[subject]
name = "x"
version = "1"
[adapter.mqtt]
command = ["x"]
answer = "json"
bind.subscribe = { tool = "watch", arguments = { topic = "$filter" }, keep = { id = "id" } }
bind.messages = { tool = "read", arguments = {ARGUMENTS}, topic = "subscribed", result = { messages = "@" } }
"""

Load = Callable[[str], Adapter]


@pytest.fixture
def load(tmp_path: Path) -> Load:
    def loaded(arguments: str) -> Adapter:
        file = tmp_path / "otmcp.toml"
        file.write_text(FILE.replace("{ARGUMENTS}", arguments), encoding="utf-8")
        return load_subject(file).adapters["mqtt"]

    return loaded


def binding_of(adapter: Adapter) -> Binding:
    bound = adapter.operations["messages"]
    assert isinstance(bound, tuple)
    return bound[0]


def outputs(adapter: Adapter, filter_: str) -> dict[str, object]:
    content = [{"type": "text", "text": json.dumps(["a", "b"])}]
    exchange = Exchange(
        tool="read",
        arguments={},
        response=json.dumps({"jsonrpc": "2.0", "id": 1, "result": {"content": content}}).encode(),
        sent_ns=0,
        received_ns=1,
    )
    expected = Expectation.of(
        binding_of(adapter),
        {"filter": filter_},
        adapter="mqtt",
        variant="rw",
        operation="messages",
        deadline_s=5.0,
        listed=True,
    )
    return observe(exchange, expected).outputs


@pytest.mark.parametrize(
    ("arguments", "filter_", "topic"),
    [
        ('{ of = "$filter" }', "plant/a", "plant/a"),
        ('{ of = "$filter" }', "plant/#", None),
        ('{ of = "$filter" }', "plant/+/a", None),
        ('{ of = "$subscribe.id" }', "plant/a", "plant/a"),
        ("{ }", "plant/a", None),
    ],
)
def test_a_payload_is_of_the_topic_that_was_asked_for(
    load: Load, arguments: str, filter_: str, topic: str | None
) -> None:
    messages = [{"topic": topic, "payload": payload} for payload in ("a", "b")]
    assert outputs(load(arguments), filter_) == {"messages": messages}


def test_a_record_says_that_the_topics_are_not_judged(load: Load) -> None:
    adapter = load('{ of = "$filter" }')
    assert "messages.topic" in adapter.facts()["unjudged"]
    stored = stored_bindings(adapter, "messages")
    assert restored_bindings({"messages": stored}) == {"messages": [binding_of(adapter)]}
