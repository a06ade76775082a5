"""What a session's frames are taken for."""

from __future__ import annotations

import itertools

import pytest

from pytest_otmcp.session.frames import META_KEY, FrameRecorder, Measurement


def recorder() -> FrameRecorder:
    made = FrameRecorder()
    made.sent(1, b"", 1, None)
    return made


def test_the_error_of_a_request_whose_id_could_not_be_read_has_none() -> None:
    # JSON-RPC 2.0, section 5: "If there was an error in detecting the id in the Request object, it MUST be Null."
    made = recorder()
    made.received(2, b'{"jsonrpc":"2.0","id":null,"error":{"code":-32700,"message":"Parse error"}}')
    assert (made.unknown_ids, made.repeated_ids, made.stray_count) == ([], [], 0)


def test_an_id_that_no_request_had_is_noted() -> None:
    made = recorder()
    made.received(2, b'{"jsonrpc":"2.0","id":7,"error":{"code":-32700,"message":"Parse error"}}')
    assert made.unknown_ids == ["7"]


def test_a_second_answer_is_noted() -> None:
    made = recorder()
    for now in (2, 3):
        made.received(now, b'{"jsonrpc":"2.0","id":1,"result":{}}')
    assert made.repeated_ids == ["1"]


def answers(made: FrameRecorder, result: str) -> int:
    """Answer calls in this way until the recorder takes no more; return how many it took."""
    for number in itertools.count(1):
        token = made.begin(Measurement())
        made.sent(1, b"", number, {"_meta": {META_KEY: token}})
        made.received(2, f'{{"jsonrpc":"2.0","id":{number},"result":{result}}}'.encode())
        if made.overflow or number == 1000 or made.stray_count:
            return number - made.overflow
    raise AssertionError


def test_a_session_may_be_asked_for_its_tools_without_end() -> None:
    made, page = recorder(), f'{{"tools":[{"0," * 9_000}0]}}'
    for number in range(2, 400):
        made.sent(1, b"", number, None)
        made.listing.renew()
        made.received(2, f'{{"jsonrpc":"2.0","id":{number},"result":{page}}}'.encode())
    assert not made.overflow


@pytest.mark.parametrize(
    ("result", "taken"),
    [
        pytest.param(f'{{"a":"{"a" * 4_190_000}"}}', 8, id="bytes"),
        pytest.param(f'{{"a":[{"0," * 198_000}0]}}', 4, id="values"),
        pytest.param(f'{{"a":"{"a" * 16_000}"}}', 1000, id="small"),
    ],
)
def test_large_answers_that_are_kept_together_are_bounded(result: str, taken: int) -> None:
    assert answers(recorder(), result) == taken


def test_what_is_no_longer_kept_makes_room() -> None:
    made = recorder()
    large = f'{{"a":"{"a" * 4_000_000}"}}'
    for number in range(12):
        made.allowance.renew()
        token = made.begin(Measurement())
        made.sent(1, b"", number, {"_meta": {META_KEY: token}})
        made.received(2, f'{{"jsonrpc":"2.0","id":{number},"result":{large}}}'.encode())
    assert not made.overflow


def test_a_list_of_tools_without_end_is_bounded() -> None:
    made = recorder()
    page = "a" * 4_000_000
    for number in range(10):
        made.sent(1, b"", number, None)
        made.received(2, f'{{"jsonrpc":"2.0","id":{number},"result":{{"tools":"{page}"}}}}'.encode())
    assert made.overflow
