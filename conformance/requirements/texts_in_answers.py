"""Texts of a device in answers: where they are, and what a terminal or a model sees of them. Pure.

A host takes the JSON of the message away and shows a text block as it is, in a terminal or to a model. So a text block is judged as it is then:
``\\u001b`` that is still six characters moves no cursor. ``structuredContent`` is for programs, which decode it; only an envelope promises
that its texts are clean after that.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.core.strict_json import parse_strict
from pytest_otmcp.protocols.journal import JournalEntry
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.stored import KEPT_OF_A_FRAME

__all__ = [
    "blocks",
    "carries",
    "interpreted",
    "left_raw",
    "not_said_to_be_changed",
    "not_said_to_be_cut",
    "outside_of_data",
    "shows",
]

Place = tuple[str, str]
"""A JSON Pointer, and the text there."""

_PASSWORDS = "root:x:0:"
"""How the file of the accounts begins on many systems, at the end of a path out of every folder."""


def _message(reply: Reply) -> Any:
    """Return the message of an answer; None for one that is longer than a record keeps, which could not be judged again."""
    response = reply.exchange.response or b""
    return None if len(response) > KEPT_OF_A_FRAME else _read(response)


def _result(reply: Reply) -> Mapping[str, Any]:
    message = _message(reply)
    result = message.get("result") if isinstance(message, Mapping) else None
    return result if isinstance(result, Mapping) else {}


def _read(text: bytes | str) -> Any:
    try:
        return parse_strict(text)
    except ValueError:
        return None


def blocks(reply: Reply) -> list[str]:
    """Return the texts of an answer as a host shows them: the text blocks, or the message of a JSON-RPC error."""
    message = _message(reply)
    error = message.get("error") if isinstance(message, Mapping) else None
    if isinstance(error, Mapping) and isinstance(error.get("message"), str):
        return [error["message"]]
    result = _result(reply)
    content = result.get("content") or result.get("contents")
    return [
        block["text"]
        for block in (content if isinstance(content, list) else [])
        if isinstance(block, Mapping) and isinstance(block.get("text"), str)
    ]


def _documents(reply: Reply) -> Iterator[Any]:
    """Yield what of an answer is JSON: the structured content, and text blocks."""
    structured = reply.envelope if reply.native else _result(reply).get("structuredContent")
    if structured is not None:
        yield structured
    yield from (document for text in blocks(reply) if isinstance(document := _read(text), Mapping | list))


def _texts(document: object) -> Iterator[Place]:
    """Yield every text of a document, the names of members as well; the pointer of a name is that of its member."""
    left: list[tuple[str, object]] = [("", document)]
    while left:
        pointer, value = left.pop()
        if isinstance(value, str):
            yield pointer, value
        elif isinstance(value, Mapping):
            for name, member in value.items():
                inner = f"{pointer}/{str(name).replace('~', '~0').replace('/', '~1')}"
                yield inner, str(name)
                left.append((inner, member))
        elif isinstance(value, Sequence):
            left += [(f"{pointer}/{index}", member) for index, member in enumerate(value)]


def _data(reply: Reply) -> Iterator[str]:
    """Yield the texts that an answer has as data: of an envelope its texts, else its text blocks."""
    if reply.native and reply.envelope is not None:
        yield from (text for _, text in _texts(reply.envelope.get("data")))
    else:
        yield from blocks(reply)


def shows(reply: Reply, nonce: str) -> bool:
    """Tell whether the answer has this text as data."""
    return any(nonce in text for text in _data(reply))


# -- INJ-001 ----------------------------------------------------------------------------------------------------------


def outside_of_data(reply: Reply, nonce: str, place: str) -> list[Finding]:
    """Expect a text of the device in data alone, at places that ``meta.untrusted`` lists; without an envelope, not in a failure.

    Args:
        nonce: that is in the text and in no argument of the call.
        place: where the device has the text.
    """
    if not (reply.native and reply.envelope is not None):
        said = reply.success is False and any(nonce in text for text in blocks(reply))
        return [_strays(reply, place, "the words of a failure")] if said else []
    listed = reply.member("meta", "untrusted")
    untrusted = [pointer for pointer in listed if isinstance(pointer, str)] if isinstance(listed, list) else []
    for pointer, text in _texts(reply.envelope):
        # The pointer to a member has the name of the member in it.
        if (
            nonce in text
            and not pointer.startswith("/meta/untrusted/")
            and (pointer == "/error/message" or not _below(pointer, untrusted))
        ):
            where = (
                "error.message"
                if pointer == "/error/message"
                else f"{pointer[:200]}, which meta.untrusted does not list"
            )
            return [_strays(reply, place, where)]
    if any(nonce in text and _read(text) is None for text in blocks(reply)):
        return [_strays(reply, place, "a text block that is prose", strength="SHOULD")]
    return []


def _below(pointer: str, listed: Sequence[str]) -> bool:
    return any(pointer == one or pointer.startswith(f"{one}/") for one in listed)


def _strays(reply: Reply, place: str, where: str, *, strength: Any = "MUST") -> Finding:
    message = f"{reply.label}: a text that the device has as {place} is in {where}"
    return Finding(code="device_text", message=message, requirement="INJ-001", strength=strength)


# -- INJ-002 ----------------------------------------------------------------------------------------------------------


def left_raw(reply: Reply, characters: str, place: str) -> list[Finding]:
    """Expect none of these characters in what a terminal or a model sees of an answer, and in the data of an envelope."""
    seen = [*blocks(reply), *_data(reply)]
    found = sorted({character for text in seen for character in characters if character in text})
    if not found:
        return []
    named = ", ".join(f"U+{ord(character):04X}" for character in found)
    message = f"{reply.label}: the answer has {named} as it is, from a text that the device has as {place}"
    return [Finding(code="raw_text", message=message, requirement="INJ-002")]


def not_said_to_be_changed(reply: Reply, place: str) -> list[Finding]:
    """Expect of an envelope with a text that was changed that it says so."""
    if not reply.native or reply.member("meta", "sanitised") is True:
        return []
    message = f"{reply.label}: a text that the device has as {place} was changed, meta.sanitised is not true"
    return [Finding(code="changed_text", message=message, requirement="INJ-002")]


def not_said_to_be_cut(reply: Reply, begin: str, end: str, place: str) -> list[Finding]:
    """Expect of an envelope with the beginning of a text, and not its end, that it says so.

    An envelope may have the whole text: what was asked for is the value, and half of a JSON document is of no use.
    """
    if not reply.native or not shows(reply, begin) or shows(reply, end):
        return []
    if reply.member("meta", "sanitised") is True or reply.member("meta", "truncated") is not None:
        return []
    message = f"{reply.label}: a text that the device has as {place} was cut off, neither meta.truncated nor meta.sanitised says so"
    return [Finding(code="changed_text", message=message, requirement="INJ-002")]


# -- INJ-003 ----------------------------------------------------------------------------------------------------------


def interpreted(reply: Reply, what: str, *, member: str, product: str, plain: Reply | None = None) -> list[Finding]:
    """Expect that nothing in an answer shows that a text was taken for something else than a text.

    Args:
        what: the text, in words.
        member: name of a member of JSON that the text would add.
        product: of the multiplication that the text asks for in several languages.
        plain: the answer to the same call with a text that means nothing in any language.
    """
    documents = list(_documents(reply))
    told = [text for document in documents for _, text in _texts(document)] + blocks(reply)
    if any(text == member for document in documents for text in _names(document)):
        problem = "it is a member of the answer's JSON"
    elif any(product in text for text in told):
        problem = "the answer has the result of the multiplication in it"
    elif any(_PASSWORDS in text for text in told):
        problem = "the answer has the file that it names as a path"
    elif plain is not None and _is_json(plain) and any(_broken(text) for text in blocks(reply)):
        problem = "the answer is no JSON any more"
    else:
        return []
    return [Finding(code="interpreted", message=f"{reply.label}: {what}: {problem}", requirement="INJ-003")]


def _names(document: object) -> Iterator[str]:
    left = [document]
    while left:
        value = left.pop()
        if isinstance(value, Mapping):
            yield from map(str, value)
            left += value.values()
        elif isinstance(value, list):
            left += value


def _is_json(reply: Reply) -> bool:
    texts = blocks(reply)
    return bool(texts) and all(_read(text) is not None for text in texts)


def _broken(text: str) -> bool:
    return text.lstrip().startswith(("{", "[")) and _read(text) is None


def carries(entry: JournalEntry, text: str) -> bool:
    """Tell whether a request has this text in it, whole: as it is, as bytes in hexadecimal or base64, or within such bytes, also within a
    document of JSON there."""
    shown = json.dumps(entry, ensure_ascii=False, default=str)
    content = text.encode("utf-8", "surrogatepass")
    forms = (json.dumps(text, ensure_ascii=False)[1:-1], base64.b64encode(content).decode(), content.hex())
    within = (
        content,
        *(json.dumps(text, ensure_ascii=only)[1:-1].encode("utf-8", "surrogatepass") for only in (True, False)),
    )
    decoded = [data for value in entry.values() if (data := _decoded(value)) is not None]
    return any(form in shown for form in forms) or any(form in data for data in decoded for form in within)


def _decoded(value: object) -> bytes | None:
    try:
        return base64.b64decode(value, validate=True) if isinstance(value, str) else None
    except ValueError:
        return None
