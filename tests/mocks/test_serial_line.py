"""A serial line: nothing that was sent is overlooked, and whose it was is known when the sender has gone."""

from __future__ import annotations

import asyncio
import os
import random
import signal
import sys

import pytest
from mock_program import PATIENCE_S, MockProgram
from profibus_tools import Master, request
from pytest_otmcp.mocks.terminal_marks import Marks

MOCK = "profibus"

# Sends what it is told, one line after the other, and closes the terminal with its end.
SENDER = """
import os, sys, tty
terminal = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
tty.setraw(terminal)
for line in sys.stdin:
    os.write(terminal, bytes.fromhex(line))
"""


def test_what_was_sent_around_marks_is_read_without_them() -> None:
    for seed in range(300):
        chance = random.Random(seed)
        marks = Marks()
        stream = expected = b""
        number = 0
        for _ in range(chance.randrange(6)):
            number, mark = marks.next()
            # Clients may send anything, also the beginning of a mark.
            sent = chance.randbytes(chance.randrange(40)) + mark[: chance.randrange(17)]
            stream += sent + mark
            expected += sent
        read = b""
        while stream:
            size = chance.randint(1, len(stream))
            read, stream = read + marks.without(stream[:size]), stream[size:]
        assert (read, marks.passed) == (expected, number), seed


def test_after_the_last_mark_nothing_is_kept_back() -> None:
    marks = Marks()
    _, mark = marks.next()
    assert marks.without(b"1" + mark[:5]) == b"1"
    assert marks.without(mark[5:] + mark[:5]) == mark[:5]
    assert marks.without(mark[:5]) == mark[:5]


def test_a_mark_that_was_discarded_is_replaced_by_the_next() -> None:
    marks = Marks()
    marks.next()
    number, mark = marks.next()
    assert marks.without(b"1" + mark + b"2") == b"12"
    assert marks.passed == number


@pytest.mark.asyncio(loop_scope="module")
async def test_the_journal_has_what_was_sent_before_it_was_asked_for(device: MockProgram) -> None:
    master = Master(device)
    try:
        for count in range(1, 40):
            since = await device.control.next()
            for _ in range(count):
                # Nobody answers at this address.
                master.send(request(99, None, control=0x49))
            assert len(await device.control.journal(since, direction="in")) == count
    finally:
        master.close()


@pytest.mark.asyncio(loop_scope="module")
async def test_what_a_client_sent_before_it_closed_the_terminal_is_that_clients(device: MockProgram) -> None:
    path = next(iter(device.ready_event["endpoints"].values()))["path"]
    number = (await device.control.ask("ready"))["pid"]
    telegram = request(99, None, control=0x49).hex().encode() + b"\n"
    sender = await asyncio.create_subprocess_exec(
        sys.executable, "-c", SENDER, path, stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE
    )
    assert sender.stdin is not None
    sender.stdin.write(telegram)
    await device.control.wait(count=1, direction="in")
    os.kill(number, signal.SIGSTOP)
    try:
        await asyncio.wait_for(sender.communicate(telegram), PATIENCE_S)
    finally:
        os.kill(number, signal.SIGCONT)
    answer = await device.control.ask("journal", since=0)
    first, second = (entry["connection"] for entry in answer["records"] if entry["direction"] == "in")
    assert first == second
    assert answer["peers"][str(first)]["process"]["pid"] == sender.pid
