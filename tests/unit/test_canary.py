"""Secrets that an adapter was given are found in what it says, however they are written, and in nothing else."""

from __future__ import annotations

import base64
from urllib.parse import quote

import pytest

from pytest_otmcp.record.redaction import REDACTED, Redactor
from pytest_otmcp.session.canary import CANARY_VARIABLE, Leak, SecretSearch, new_canary, place_of
from pytest_otmcp.session.frames import FrameRecorder, Measurement

CANARY = "0123456789abcdef5a5a0f0f7e7e1d1d"
FIXED = "plant-4711-west"


def found(data: bytes, *, fixed: str = FIXED) -> list[tuple[str, str]]:
    search = SecretSearch({"PASSWORD": CANARY}, {"PIN": fixed})
    search.look(data, lambda: "here")
    return [(leak.variable, leak.form) for leak in search.leaks]


@pytest.mark.parametrize(
    ("said", "form"),
    [
        (f"login as op:{CANARY}@host", "as it is"),
        (f"token {CANARY[:20]}…", "as it is"),
        (f"…{CANARY[12:]}", "as it is"),
        (CANARY.upper(), "in capitals"),
        (CANARY[::-1], "backwards"),
        (CANARY.encode().hex(), "in hexadecimal digits"),
        ("".join(f"%{byte:02X}" for byte in CANARY.encode()), "percent-encoded"),
        *((base64.b64encode(f"{name}:{CANARY}".encode()).decode(), "in base64") for name in ("a", "ab", "abc")),
    ],
)
def test_a_canary_is_found_however_it_is_written(said: str, form: str) -> None:
    assert found(said.encode()) == [("PASSWORD", form)]


@pytest.mark.parametrize(
    "said", ["", "****", CANARY[:4] + "****", "sha256:9f86d081884c7d65", "PASSWORD is set", FIXED[:-1]]
)
def test_a_name_a_mask_and_a_few_characters_are_no_secret(said: str) -> None:
    assert found(said.encode()) == []


def test_a_fixed_secret_is_looked_for_as_a_whole() -> None:
    assert found(f"pin {FIXED}".encode()) == [("PIN", "as it is")]


@pytest.mark.parametrize("cut", [1, 7, 16, 31, 40])
def test_a_secret_is_found_in_a_stream_wherever_its_parts_are_cut(cut: int) -> None:
    search = SecretSearch({"PASSWORD": CANARY})
    take = search.stream("standard error")
    data = f"connecting with {CANARY} to the plant\n".encode()
    for start in range(0, len(data), cut):
        take(data[start : start + cut])
    assert {(leak.variable, leak.place) for leak in search.leaks} == {("PASSWORD", "standard error")}


def test_each_variable_is_told_once_for_each_place() -> None:
    search = SecretSearch({"PASSWORD": CANARY, CANARY_VARIABLE: new_canary()})
    for place in ("one", "one", "two"):
        search.look(CANARY.encode(), lambda place=place: place)  # type: ignore[misc]
    assert search.leaks == [Leak("PASSWORD", "one", "as it is"), Leak("PASSWORD", "two", "as it is")]
    assert search.told == {CANARY}


def test_a_frame_is_named_by_what_it_answers() -> None:
    recorder = FrameRecorder(secrets=SecretSearch({"PASSWORD": CANARY}))
    token = recorder.begin(Measurement())
    request = b'{"jsonrpc":"2.0","id":4,"method":"tools/call","params":{"name":"read_register","arguments":{}}}'
    recorder.sent(1, request, 4, {"_meta": {"pytest-otmcp/exchange": token}})
    for frame in (
        f'{{"jsonrpc":"2.0","id":4,"result":{{"content":[{{"type":"text","text":"{CANARY}"}}]}}}}',
        f'{{"jsonrpc":"2.0","id":3,"result":{{"tools":[{{"name":"{CANARY}"}}]}}}}',
        f'{{"jsonrpc":"2.0","method":"notifications/message","params":{{"data":"{CANARY}"}}}}',
        f"password={CANARY}",
    ):
        recorder.received(2, frame.encode())
    assert [leak.place for leak in recorder.secrets.leaks] == [
        "the answer of read_register",
        "the list of tools",
        "the message notifications/message",
        "a line that is no message",
    ]


@pytest.mark.parametrize("message", [None, [], 7, {"method": {}}, {"id": 1, "error": {"code": 1}}, {"result": "tools"}])
def test_any_message_has_a_place(message: object) -> None:
    assert place_of(message, b"")


def test_what_was_told_is_taken_out_of_the_record() -> None:
    told = [CANARY, base64.b64encode(f"op:{CANARY}".encode()).decode(), CANARY.encode().hex(), quote(CANARY)]
    for text in told:
        kept = Redactor([CANARY]).text(f"said {text} at the end")
        assert REDACTED in kept
        assert found(kept.encode()) == []
