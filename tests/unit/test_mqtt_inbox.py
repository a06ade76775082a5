"""Messages that an answer lists: what their payloads stand for."""

from __future__ import annotations

import base64

import pytest

from pytest_otmcp.protocols.mqtt.inbox import listed

TEXT = "22,5 °C"
ENCODED = base64.b64encode(TEXT.encode()).decode()


def contents(messages: object, encodings: object = None) -> list[bytes | None]:
    return [message.content for message in listed({"messages": messages, "encodings": encodings})]


def test_a_payload_is_text_unless_it_is_marked_as_base64() -> None:
    messages = [{"topic": "a", "payload": TEXT}, {"topic": "a", "payload": ENCODED}, {"topic": "a", "payload": ENCODED}]
    assert contents(messages, ["utf-8", "base64", None]) == [TEXT.encode(), TEXT.encode(), ENCODED.encode()]
    assert [message.base64 for message in listed({"messages": messages, "encodings": ["utf-8", "base64", None]})] == [
        False,
        True,
        False,
    ]
    assert contents(messages) == [TEXT.encode(), ENCODED.encode(), ENCODED.encode()]


def test_marks_that_belong_to_no_message_mark_none() -> None:
    assert contents([{"topic": "a", "payload": ENCODED}], ["base64", "base64"]) == [ENCODED.encode()]


def test_what_is_marked_and_no_base64_stands_for_nothing() -> None:
    assert (
        contents([{"topic": "a", "payload": "22,5 °C"}, {"topic": "a", "payload": "abc"}], ["base64"] * 2) == [None] * 2
    )


@pytest.mark.parametrize("messages", [None, "text", {}, 5])
def test_what_is_no_list_lists_nothing(messages: object) -> None:
    assert listed({"messages": messages}) == []


@pytest.mark.parametrize("message", [None, "text", {}, {"topic": 5}, {"payload": 5}])
def test_what_is_no_message_is_listed_without_content(message: object) -> None:
    assert contents([message]) == [None]
