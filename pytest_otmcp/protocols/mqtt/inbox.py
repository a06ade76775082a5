"""The messages that an answer lists, each with the bytes that its payload stands for. Pure.

A payload is text, or base64 where the output ``encodings`` says so; who compares payloads compares the bytes.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Mapping
from dataclasses import dataclass

__all__ = ["Listed", "decoded", "listed"]

_BASE64 = "base64"


@dataclass(frozen=True, slots=True, kw_only=True)
class Listed:
    """A message as an answer lists it.

    Attributes:
        topic, payload: as the answer says; None where it is no message.
        base64: the answer says that the payload is base64.
        content: the bytes that the payload stands for; None where it is no text, or not the base64 that it is said to be.
    """

    topic: object
    payload: object
    base64: bool
    content: bytes | None


def listed(outputs: Mapping[str, object]) -> list[Listed]:
    """Return the messages in the outputs of an answer, in their order."""
    messages, encodings = outputs.get("messages"), outputs.get("encodings")
    if not isinstance(messages, list):
        return []
    told = encodings if isinstance(encodings, list) and len(encodings) == len(messages) else [None] * len(messages)
    return [_message(message, encoding) for message, encoding in zip(messages, told, strict=True)]


def _message(message: object, encoding: object) -> Listed:
    said = message if isinstance(message, dict) else {}
    payload, is_base64 = said.get("payload"), str(encoding).lower() == _BASE64
    content = None
    if isinstance(payload, str):
        content = decoded(payload) if is_base64 else payload.encode("utf-8", "surrogatepass")
    return Listed(topic=said.get("topic"), payload=payload, base64=is_base64, content=content)


def decoded(payload: object) -> bytes | None:
    """Return the bytes that a text in base64 stands for; None where it is no such text."""
    try:
        return base64.b64decode(payload, validate=True) if isinstance(payload, str) else None
    except (binascii.Error, ValueError):
        return None
