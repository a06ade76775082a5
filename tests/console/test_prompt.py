"""A prompt to an assistant: what it calls is called, and an endpoint that is none ends in a sentence."""

from __future__ import annotations

import asyncio
import re
import socket
from typing import Any

import pytest

from pytest_otmcp.console.bench import Bench
from pytest_otmcp.console.prompt import Assistant, Endpoint
from pytest_otmcp.core.errors import UsageError
from pytest_otmcp.session.isolation import Isolation
from pytest_otmcp.subject import reference_subject

from .chat_endpoint import calling, saying, scripted


def conversation(url: str, prompt: str = "Set register 7 to 42.", key: str = "") -> list[tuple[str, str]]:
    """Put a prompt to an endpoint, with an adapter that is not started, and return what was said."""
    subject = reference_subject()
    bench = Bench(0, subject, subject.adapters["modbus"], Isolation("off"), lambda event: None)
    assistant = Assistant(Endpoint(url=url, model="scripted", key=key), lambda event: None)
    asyncio.run(assistant.ask(bench, prompt))
    said: Any = assistant.state()["said"]
    return [(one["who"], one["text"]) for one in said]


def test_what_the_assistant_calls_is_carried_out_and_what_came_of_it_goes_back() -> None:
    with scripted([calling("write_register", address=7, value=42), saying("I could not.")]) as endpoint:
        said = conversation(endpoint.url, key="secret")
    assert said == [
        ("operator", "Set register 7 to 42."),
        ("call", 'write_register {"address": 7, "value": 42}'),
        ("result", "not sent: the adapter is not started"),
        ("assistant", "I could not."),
    ]
    assert endpoint.keys == ["Bearer secret", "Bearer secret"]
    assert [message["role"] for message in endpoint.asked[1]["messages"]] == ["system", "user", "assistant", "tool"]
    assert endpoint.asked[1]["messages"][-1]["tool_call_id"] == "call-1"


def test_an_assistant_that_calls_for_ever_is_stopped() -> None:
    with scripted([calling("ping")]) as endpoint, pytest.raises(UsageError, match="stopped after 12 answers"):
        conversation(endpoint.url)
    assert len(endpoint.asked) == 12
    assert endpoint.keys[0] is None


@pytest.mark.parametrize(
    ("answer", "status", "sentence"),
    [
        ({}, 200, "answers with no message of the chat interface"),
        ([], 200, "answers with no message of the chat interface"),
        ({"choices": [{"message": "x"}]}, 200, "answers with no message of the chat interface"),
        ({"choices": [{"message": {"tool_calls": "x"}}]}, 200, "answers with no message of the chat interface"),
        ({"choices": [{"message": {"tool_calls": ["x"]}}]}, 200, "calls a tool in a form that is none"),
        ({"error": "no such model"}, 404, "refuses with status 404: "),
    ],
)
def test_an_endpoint_that_answers_with_something_else_is_told_so(answer: object, status: int, sentence: str) -> None:
    with scripted([answer], status) as endpoint, pytest.raises(UsageError, match=sentence):
        conversation(endpoint.url)


def test_an_endpoint_that_is_not_there_and_a_prompt_that_is_empty_end_in_a_sentence() -> None:
    # Whoever is bound to a port and does not listen refuses connections.
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{nobody.getsockname()[1]}/v1"
        with pytest.raises(UsageError, match=f"{re.escape(url)} cannot be asked: "):
            conversation(url)
        with pytest.raises(UsageError, match="there is nothing to ask"):
            conversation(url, " ")
