"""The end of the calls around an outage: a call that began too late closes a window, a late answer does not."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator
from typing import Any

from pytest_otmcp.session.exchange import Exchange
from pytest_otmcp.subject import reference_subject
from pytest_otmcp.subject.claims import Claims
from pytest_otmcp.subject.model import Answering
from pytest_otmcp.trial.cursor import JournalCursor
from pytest_otmcp.trial.player import Player
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Expectation, Reply, observe
from pytest_otmcp.trial.rig import Rig
from pytest_otmcp.trial.subject_in_rig import SubjectInRig

S = 1_000_000_000


class Scripted(Player):
    """Plays given answers: success, and when the call was sent and answered, in seconds."""

    accepting_ns = 0
    running = True

    def __init__(self, *answers: tuple[bool, float, float]) -> None:
        adapters = reference_subject().adapters
        stated = SubjectInRig("modbus", adapters["modbus"].facts(), Claims.of_subject(adapters))
        super().__init__("modbus", "rw", stated, JournalCursor("modbus"))
        self._answers: Iterator[tuple[bool, float, float]] = iter(answers)

    async def perform(self, operation: str, inputs: Any, altered: Any = None) -> Reply:
        success, sent, received = next(self._answers)
        exchange = Exchange(
            tool=operation,
            arguments={},
            request=b"{}",
            response=json.dumps(
                {"jsonrpc": "2.0", "id": 1, "result": {"content": [], "isError": not success}}
            ).encode(),
            sent_ns=int(sent * S),
            received_ns=int(received * S),
            asked_ns=int(sent * S),
            returned_ns=int(received * S),
        )
        answering = Answering(form="text")
        expected = Expectation(
            adapter="modbus", variant="rw", operation=operation, deadline_s=10.0, answering=answering, outputs={}
        )
        return observe(exchange, expected)

    async def reconnecting(self) -> None:
        pass

    async def pause(self, seconds: float) -> None:
        pass

    def bindings(self, operation: str) -> tuple[()]:
        return ()


# The windows never use the abstract methods that are left.
Scripted.__abstractmethods__ = frozenset()


def at(*answers: tuple[bool, float, float]) -> Rig:
    rig = Rig(Scripted(*answers))
    Repetition("S10", 0, "task", seed=0, time_scale=1.0, rigs=[rig])
    return rig


def successes(*answers: tuple[bool, float, float]) -> list[bool | None]:
    replies = asyncio.run(at(*answers).call_until_success("read_input", window_s=1.0))
    return [reply.success for reply in replies]


def test_an_answer_that_comes_late_does_not_end_the_search_for_success() -> None:
    # The call was made in time, and its answer truthfully says that the adapter could not connect then.
    assert successes((False, 0.1, 1.5), (True, 1.6, 1.7)) == [False, True]


def test_the_first_call_is_never_the_last() -> None:
    assert successes((False, 1.5, 1.6), (True, 1.7, 1.8)) == [False, True]


def test_a_call_that_begins_after_the_window_ends_it() -> None:
    assert successes((False, 0.1, 0.2), (False, 0.9, 0.95), (False, 1.0, 1.1), (True, 1.2, 1.3)) == [False] * 3


def test_an_answer_that_comes_late_is_not_taken_for_a_status_that_stays() -> None:
    scripted = at((True, 0.1, 2.5), (False, 2.0, 2.7))
    assert not asyncio.run(scripted.call_until_failure("read_input", window_s=2.0)).success


def test_a_status_that_stays_after_the_window_is_final() -> None:
    scripted = at((True, 0.1, 0.2), (True, 1.9, 1.95), (True, 2.1, 2.2), (False, 2.3, 2.4))
    assert asyncio.run(scripted.call_until_failure("read_input", window_s=2.0)).success


def test_a_window_from_the_first_call_is_not_over_because_the_device_has_been_there_for_long() -> None:
    scripted = at((False, 20.0, 20.1), (False, 20.4, 20.5), (True, 20.8, 20.9))
    replies = asyncio.run(scripted.call_until_success("read_input", window_s=1.0, from_first_call=True))
    assert [reply.success for reply in replies] == [False, False, True]
