"""What a session's frames are taken for."""

from __future__ import annotations

from pytest_otmcp.session.frames import FrameRecorder


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
