"""A run's account of its time, and the garbage collection that it keeps out of its measurements."""

from __future__ import annotations

import asyncio
import gc
import weakref
from collections.abc import Iterator

import pytest

from pytest_otmcp.session.exchange import Exchange
from pytest_otmcp.subject.model import Answering
from pytest_otmcp.trial.gc_pause import settled, uncollected
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Expectation, Reply, observe


def reply(asked: int, sent: int, received: int | None, returned: int) -> Reply:
    """Return the reply to a call with these times, in milliseconds."""
    exchange = Exchange(
        tool="ping",
        arguments={},
        request=b"{}",
        response=None if received is None else b'{"jsonrpc": "2.0", "id": 1, "result": {"content": []}}',
        sent_ns=sent * 1_000_000,
        received_ns=None if received is None else received * 1_000_000,
        failure="timeout" if received is None else None,
        asked_ns=asked * 1_000_000,
        returned_ns=returned * 1_000_000,
    )
    answering = Answering(form="text")
    expected = Expectation(
        adapter="modbus", variant="rw", operation="ping", deadline_s=1.0, answering=answering, outputs={}
    )
    return observe(exchange, expected)


@pytest.fixture
def repetition() -> Repetition:
    return Repetition("M1", 0, "task", seed=0, time_scale=1.0, rigs=[])


def test_a_call_is_the_wires_and_the_clients_time(repetition: Repetition) -> None:
    repetition.ledger.add(reply(0, 10, 30, 35), {})
    repetition.ledger.add(reply(100, 101, 103, 107), {}, "warmup")
    assert repetition.calls_s() == (pytest.approx(0.022), pytest.approx(0.020))
    assert repetition.duration_ms == pytest.approx(20)


def test_concurrent_calls_count_once(repetition: Repetition) -> None:
    calls = [reply(0, 10, 30, 45), reply(1, 5, 40, 42), reply(2, 12, 35, 50)]

    async def call(one: Reply) -> Reply:
        repetition.ledger.add(one, {})
        return one

    asyncio.run(repetition.together(*map(call, calls)))
    assert repetition.calls_s() == (pytest.approx(0.035), pytest.approx(0.015))
    assert repetition.duration_ms == pytest.approx(35)


def test_an_unanswered_call_is_waited_for_on_the_wire(repetition: Repetition) -> None:
    repetition.ledger.add(reply(0, 1, None, 1000), {})
    assert repetition.calls_s() == (pytest.approx(1.0), 0.0)
    assert repetition.duration_ms == 0


class Knot:
    """An object that refers to itself: only the garbage collector can find it."""

    def __init__(self) -> None:
        self.itself = self


@pytest.fixture
def eager_collector() -> Iterator[None]:
    before = gc.get_threshold()
    gc.set_threshold(1, 1, 1)
    yield
    gc.set_threshold(*before)


@pytest.mark.usefixtures("eager_collector")
def test_nothing_is_collected_in_the_midst_of_a_call_and_nothing_adds_up() -> None:
    with uncollected():
        lost = weakref.ref(Knot())
        assert [bytearray() for _ in range(1000)]
        assert lost() is not None
    assert lost() is None
    assert gc.isenabled()


def test_garbage_that_has_grown_old_is_collected_after_many_pauses() -> None:
    def pause(times: int) -> None:
        for _ in range(times):
            with uncollected():
                pass

    gc.collect()
    kept = Knot()
    lost = weakref.ref(kept)
    pause(3)
    del kept
    pause(1)
    assert lost() is not None
    pause(60)
    assert lost() is None


def test_a_failure_inside_ends_the_truce() -> None:
    with pytest.raises(ZeroDivisionError), uncollected():
        raise ZeroDivisionError
    assert gc.isenabled()


def test_a_collector_that_was_off_stays_off() -> None:
    gc.disable()
    try:
        with uncollected():
            pass
        with settled():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()
        gc.unfreeze()


def test_what_was_settled_is_not_searched_again() -> None:
    try:
        with settled():
            kept = Knot()
        assert not any(found is kept for found in gc.get_objects())
        assert gc.isenabled()
    finally:
        gc.unfreeze()
