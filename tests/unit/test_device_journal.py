"""The journal of a device: what its entries are, what it keeps, and how it waits; of a mock as of a tap."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from pytest_otmcp.errors import KitError
from pytest_otmcp.plant.device import Device
from pytest_otmcp.plant.endpoint import Endpoint
from pytest_otmcp.plant.journal import DeviceJournal
from pytest_otmcp.plant.mock_device import MockDevice
from pytest_otmcp.plant.tapped_device import TappedDevice
from pytest_otmcp.protocols.oracle import has
from pytest_otmcp.protocols.registry import protocols

pytestmark = pytest.mark.asyncio

READ = bytes.fromhex("0001 0000 0006 01 03 0001 0001")
WRITE = bytes.fromhex("0002 0000 0006 01 06 0001 002A")


def record(journal: DeviceJournal, *values: int | None, **fields: Any) -> None:
    """Record an entry for each value; None leaves the field out."""
    for value in values:
        journal.event(1, "in", "SET", **(fields if value is None else {**fields, "value": value}))


def values(entries: list[Any]) -> list[Any]:
    return [entry.get("value") for entry in entries]


async def test_entries_have_all_fields_of_the_contract() -> None:
    journal = DeviceJournal()
    record(journal, 7)
    record(journal, 8, origin="kit")
    first, second = journal.since(0)
    assert {name: value for name, value in first.items() if name != "t_ns"} == {
        **{"seq": 0, "connection": 1, "direction": "in", "kind": "SET", "request": False, "state_changing": False},
        **{"answers": None, "origin": "client", "value": 7},
    }
    assert (second["seq"], second["origin"]) == (1, "kit")
    assert second["t_ns"] >= first["t_ns"]


async def test_a_slice_begins_where_it_was_asked_to() -> None:
    journal = DeviceJournal()
    assert (journal.first, journal.next, journal.since(0)) == (0, 0, [])
    record(journal, 10, 11, 12)
    assert (journal.first, journal.next) == (0, 3)
    assert values(journal.since(1)) == [11, 12]
    assert journal.since(3) == []
    assert journal.since(99) == []


async def test_what_was_released_is_gone_and_the_numbers_go_on() -> None:
    journal = DeviceJournal()
    record(journal, 10, 11, 12)
    journal.forget(2)
    assert (journal.first, journal.next, journal.dropped) == (2, 3, 0)
    assert values(journal.since(0)) == [12]
    journal.forget(1)
    assert journal.first == 2
    journal.forget(99)
    assert (journal.first, journal.next) == (3, 3)
    record(journal, 13)
    assert [entry["seq"] for entry in journal.since(0)] == [3]


async def test_the_oldest_entries_give_way_at_the_capacity() -> None:
    journal = DeviceJournal(capacity=3)
    record(journal, *range(5))
    assert (journal.first, journal.next, journal.dropped) == (2, 5, 2)
    assert values(journal.since(0)) == [2, 3, 4]
    journal.forget(4)
    record(journal, 5)
    assert (values(journal.since(0)), journal.dropped) == ([4, 5], 2)


async def test_waiting_ends_with_the_last_entry_that_is_wanted() -> None:
    journal = DeviceJournal()
    record(journal, 7, 8)
    waiting = asyncio.create_task(journal.wait(1, {"kind": "SET"}, 3, 60.0))
    await asyncio.sleep(0)
    record(journal, 9)
    record(journal, 10, colour="red")
    assert values(await waiting) == [8, 9, 10]
    assert await journal.wait(0, {"value": 7, "colour": "red"}, 1, 0.0) == []
    assert values(await journal.wait(0, {}, 2, 0.0)) == [7, 8, 9, 10]
    assert await journal.wait(4, {}, 0, 60.0) == []


async def test_a_field_that_an_entry_lacks_equals_nothing() -> None:
    journal = DeviceJournal()
    record(journal, None)
    record(journal, 7, colour=None)
    assert values(await journal.wait(0, {"colour": None}, 2, 0.0)) == [7]
    assert await journal.wait(0, {"missing": None}, 1, 0.0) == []


async def test_waiting_for_what_was_released_gives_what_is_kept() -> None:
    journal = DeviceJournal()
    record(journal, 7, 8)
    journal.forget(1)
    assert values(await journal.wait(0, {}, 1, 0.0)) == [8]


# -- of a mock ----------------------------------------------------------------------------------------------


def told(*records: dict[str, Any], first: int = 0, peers: dict[str, Any] | None = None) -> dict[str, Any]:
    """Return what a mock answers that has these records, numbered from ``first``."""
    common = {
        "t_ns": 1,
        "connection": 1,
        "direction": "in",
        "origin": "client",
        "frame": None,
        "answers": None,
        "fields": {},
    }
    numbered = [{**common, "number": first + index, **one} for index, one in enumerate(records)]
    return {"records": numbered, "first": first, "next": first + len(records), "dropped": first, "peers": peers or {}}


def conversed(*records: dict[str, Any]) -> list[Any]:
    framing = protocols()["modbus"].framing
    assert framing is not None
    journal = DeviceJournal(framing.conversation)
    journal.take(told(*records))
    return journal.since(0)


async def test_a_frame_of_a_mock_is_decoded_and_keeps_what_the_mock_says_of_it() -> None:
    [entry] = conversed({"frame": WRITE.hex(), "fields": {"fault": {"drop": True}}})
    assert (entry["kind"], entry["state_changing"], entry["values"], entry["fault"]) == (
        "request",
        True,
        [42],
        {"drop": True},
    )


async def test_a_mock_says_which_request_it_answers_where_the_answer_names_another() -> None:
    answer = bytes.fromhex("0009 0000 0005 01 03 02 0007").hex()
    asked, wrong, right = conversed(
        {"frame": READ.hex()},
        {"frame": answer, "direction": "out", "answers": 0},
        {"frame": answer.replace("0009", "0001", 1), "direction": "out"},
    )
    assert (wrong["answers"], right["answers"]) == (asked["seq"], asked["seq"])


async def test_a_frame_of_the_plant_or_of_the_kit_is_no_request() -> None:
    for origin in ("plant", "kit"):
        [entry] = conversed({"frame": WRITE.hex(), "origin": origin})
        assert (entry["origin"], entry["request"], entry["state_changing"]) == (origin, False, False)


async def test_an_event_of_a_mock_without_a_decoder_says_itself_what_it_asks() -> None:
    journal = DeviceJournal()
    fields = {"kind": "SET", "request": True, "state_changing": True, "value": 7}
    journal.take(told({"fields": fields}, {"fields": {"kind": "DONE"}, "direction": "out", "answers": 0}))
    asked, answer = journal.since(0)
    assert has(asked, **fields)
    assert (answer["kind"], answer["request"], answer["answers"]) == ("DONE", False, 0)


async def test_a_record_that_was_taken_is_not_taken_again_and_one_that_was_dropped_leaves_a_gap() -> None:
    journal = DeviceJournal()
    journal.take(told(*[{"fields": {"kind": "SET", "value": value}} for value in (7, 8)]))
    journal.take(told({"fields": {"kind": "SET", "value": 8}}, {"fields": {"kind": "SET", "value": 9}}, first=1))
    assert values(journal.since(0)) == [7, 8, 9]
    journal.take(told({"fields": {"kind": "SET", "value": 12}}, first=5))
    assert (journal.first, journal.next, journal.dropped, values(journal.since(0))) == (5, 6, 2, [12])


# -- as the kit sees them -----------------------------------------------------------------------------------


@asynccontextmanager
async def serving(behind_tap: bool) -> AsyncIterator[Device]:
    """Serve the Modbus mock, which is asked directly or through the tap in front of it."""
    mock = MockDevice("modbus")
    device: Device = mock
    await mock.launch()
    try:
        if behind_tap:
            target = Endpoint(name="modbus", kind="tcp", host=mock.host, port=mock.port)
            framing = protocols()["modbus"].framing
            assert framing is not None
            device = TappedDevice("device at the other end", target, framing)
            await device.launch()
        yield device
    finally:
        await device.close()
        await mock.close()


async def exchange(device: Device, *requests: bytes) -> None:
    """Send the requests on one connection, and wait until the device has noticed its end."""
    loop = asyncio.get_running_loop()
    mark = await device.mark()
    with socket.create_connection((device.host, device.port)) as client:
        client.setblocking(False)
        for request in requests:
            await loop.sock_sendall(client, request)
            assert await asyncio.wait_for(loop.sock_recv(client, 300), 60)
    assert await device.wait(mark, {"kind": "DISCONNECTED"}, timeout_s=60.0)


@pytest.mark.parametrize("behind_tap", [False, True], ids=["mock", "tap"])
async def test_the_kit_is_told_what_a_device_no_longer_holds(behind_tap: bool) -> None:
    async with serving(behind_tap) as device:
        await exchange(device, READ, WRITE)
        mark = await device.mark()
        assert mark == 6
        whole = await device.journal(0)
        assert [entry["kind"] for entry in whole.entries] == ["CONNECTED", *["request", "response"] * 2, "DISCONNECTED"]
        assert [entry["answers"] for entry in whole.entries] == [None, None, 1, None, 3, None]
        assert whole.next == mark
        await device.forget(mark - 1)
        refusal = f"no longer goes back to entry 0: the oldest that it holds is {mark - 1}"
        with pytest.raises(KitError, match=refusal):
            await device.journal(0)
        with pytest.raises(KitError, match=refusal):
            await device.wait(0, {"kind": "DISCONNECTED"}, timeout_s=0.0)
        assert [entry["kind"] for entry in (await device.journal(mark - 1)).entries] == ["DISCONNECTED"]
        await device.forget(mark)
        assert (await device.journal(mark)).entries == []
        await exchange(device, READ)
        assert [entry["seq"] for entry in (await device.journal(mark)).entries] == [mark, mark + 1, mark + 2, mark + 3]


@pytest.mark.parametrize("behind_tap", [False, True], ids=["mock", "tap"])
async def test_a_journal_begins_anew_with_its_device(behind_tap: bool) -> None:
    async with serving(behind_tap) as device:
        await exchange(device, READ)
        await device.forget(await device.mark())
        begun = device.accepting_ns
        await device.stop()
        assert not device.running
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection((device.host, device.port))
        await device.start()
        assert device.running
        assert device.accepting_ns > begun
        assert await device.mark() == 0
        await exchange(device, WRITE)
        (request,) = await device.wait(0, {"request": True}, timeout_s=60.0)
        assert (request["seq"], request["state_changing"], request["origin"]) == (1, True, "client")
