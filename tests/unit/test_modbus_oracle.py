"""The oracles of Modbus: exchanges of the specification as the tap records them."""

from __future__ import annotations

from typing import Any

import pytest

from pytest_otmcp.protocols.conversation import Direction
from pytest_otmcp.protocols.modbus import oracle
from pytest_otmcp.protocols.modbus.decoder import ModbusConversation
from pytest_otmcp.protocols.modbus.entries import points

from .journals import Entry, decoded


def journal(*exchanges: str) -> list[Entry]:
    """Return the entries of "request -> response" exchanges, PDUs in hex; "-> ?" for no answer."""
    frames: list[tuple[Direction, bytes]] = []
    for number, exchange in enumerate(exchanges, start=1):
        request, _, response = exchange.partition(" -> ")
        frames.append(("in", frame(request, transaction=number)))
        if response != "?":
            frames.append(("out", frame(response, transaction=number)))
    return decoded(ModbusConversation(), *frames)


def frame(pdu: str, *, transaction: int) -> bytes:
    body = bytes.fromhex(pdu)
    return transaction.to_bytes(2) + b"\0\0" + (len(body) + 1).to_bytes(2) + b"\1" + body


READ = "04 0000 0002 -> 04 04 00010002"
WRITE = "06 0001 0028 -> 06 0001 0028"
WRITE_MANY = "10 0001 0001 02 0028 -> 10 0001 0001"
MISSING = "03 270F 0001 -> 83 02"


def words(findings: list[Any]) -> str:
    (finding,) = findings
    return f"{finding.message} [{finding.requirement}] {finding.evidence or ''}"


def test_an_exchange_needs_a_request_and_its_answer() -> None:
    assert oracle.some_exchange(journal(READ)) == []
    assert "it saw none" in words(oracle.some_exchange([]))
    assert "it answered 0 of 1" in words(oracle.some_exchange(journal("03 0000 0001 -> ?")))


def test_a_read_is_fresh_when_requests_cover_what_was_asked_whichever_they_are() -> None:
    def fresh(*exchanges: str, address: int = 0, count: int = 2) -> list[Any]:
        return oracle.read_from_device(journal(*exchanges), function=4, address=address, count=count)

    single, next_one = "04 0000 0001 -> 04 02 00FA", "04 0001 0001 -> 04 02 0096"
    assert fresh(READ) == fresh(READ, READ) == fresh(single, next_one) == fresh(MISSING, READ) == []
    assert fresh(READ, address=1, count=1) == []
    part = words(fresh(single))
    assert "should have been asked for 2 cell(s) from 0 by function 4 during the call, it was not [RD-004]" in part
    assert "FC 04 address 0 quantity 1" in part
    assert fresh("04 0000 0002 -> ?") != []
    assert fresh("03 0000 0002 -> 03 04 00FA 0096") != []


def test_a_refusal_of_something_else_is_found() -> None:
    def other(*exchanges: str, function: int = 3) -> list[Any]:
        return oracle.refused_nothing_else(journal(*exchanges), function=function, address=0x270F, count=1)

    assert other(READ, MISSING) == other() == []
    neighbour = words(other("03 2710 0001 -> 83 02"))
    assert "refused 1 cell(s) from 9999 by function 3, it refused FC 03 address 10000 quantity 1 [ADR-001]" in neighbour
    assert other(MISSING, function=4) != []


def test_a_request_reached_the_device_also_when_it_was_refused() -> None:
    assert oracle.reached(journal(MISSING), function=3, address=0x270F, count=1)
    assert not oracle.reached(journal(READ), function=3, address=0x270F, count=1)


def test_a_read_of_another_address_or_table_is_told_apart_from_none() -> None:
    assert oracle.read_where_asked(journal(READ, READ), function=4, address=1) == []
    assert oracle.read_where_asked([], function=4, address=1) == []
    assert "[ADR-001]" in words(oracle.read_where_asked(journal(READ), function=4, address=2))
    assert "[RD-002]" in words(oracle.read_where_asked(journal(READ), function=3, address=1))
    assert "[RD-002]" in words(oracle.read_from_device(journal(READ), function=3, address=1, count=1))
    assert "[ADR-001]" in words(oracle.read_from_device(journal(READ), function=4, address=2, count=1))
    assert "[RD-004]" in words(oracle.read_from_device([], function=4, address=2, count=1))


def test_a_value_that_was_stored_otherwise_is_told_in_plain_words() -> None:
    (finding,) = oracle.stored_otherwise(image(r1=4464), "holding_registers", 1, 70000, told=70000)
    assert finding.requirement == "ADR-003"
    expected = "asked to write 70000; the adapter said that it wrote 70000; holding register 1 holds 4464"
    assert finding.message == expected
    (finding,) = oracle.stored_otherwise(image(r1=4464), "holding_registers", 1, 70000, told=None)
    assert "the adapter said success" in finding.message


@pytest.mark.parametrize("exchange", [WRITE, WRITE_MANY])
def test_a_write_counts_whichever_function_it_uses(exchange: str) -> None:
    assert oracle.exactly_one_write(journal(READ, exchange), "holding_registers", address=1, values=[40]) == []


def test_a_write_that_is_repeated_or_another_one_is_found() -> None:
    twice = words(oracle.exactly_one_write(journal(WRITE, WRITE), "holding_registers", address=1, values=[40]))
    assert "one write of [40] to holding_registers 1, it saw 2" in twice
    assert "[WR-003]" in twice
    for address, values, problem in (
        (2, [40], "it saw the same write to 1 [ADR-001]"),
        (1, [41], "it saw a write of [40] to 1 [WR-001]"),
        (1, [0x2800], "it saw a write of [40] to 1 [ENC-001]"),
    ):
        found = oracle.exactly_one_write(journal(WRITE), "holding_registers", address=address, values=values)
        assert problem in words(found)
    assert "it saw 0" in words(oracle.exactly_one_write(journal(READ), "holding_registers", address=1, values=[40]))
    coil = journal("05 0001 FF00 -> 05 0001 FF00")
    assert oracle.exactly_one_write(coil, "coils", address=1, values=[True]) == []
    assert oracle.exactly_one_write(coil, "coils", address=1, values=[1]) != []


@pytest.mark.parametrize(
    "pdu", ["05 0001 FF00", "06 0001 0028", "0F 0000 0001 01 01", "10 0001 0001 02 0028", "16 0001 0000 FFFF",
            "17 0000 0001 0001 0001 02 0028"]
)  # fmt: skip
def test_every_state_changing_function_is_a_write_also_without_an_answer(pdu: str) -> None:
    assert oracle.no_state_changing_request(journal(READ, MISSING)) == []
    assert "should have seen no state-changing request, it saw 1" in words(
        oracle.no_state_changing_request(journal(f"{pdu} -> ?"))
    )


def test_an_exception_is_seen_by_its_code() -> None:
    assert oracle.refused_with(journal(MISSING), 2) == []
    assert "exception 03, its answers had 02" in words(oracle.refused_with(journal(MISSING), 3))
    assert "exception 02, its answers had none" in words(oracle.refused_with([], 2))


def test_an_exception_of_the_device_stands_for_its_codes() -> None:
    assert oracle.codes_of_refusals(journal(MISSING)) == ("illegal_address",)
    assert oracle.codes_of_refusals([]) == ()


def image(**changes: int) -> dict[str, Any]:
    registers = [0] * 10
    for name, value in changes.items():
        registers[int(name.removeprefix("r"))] = value
    cells = points("holding_registers", 0, registers) | points("coils", 0, [False, True])
    return {"points": cells}


def test_images_are_compared_cell_by_cell() -> None:
    assert oracle.only_changed(image(), image(r1=40), points("holding_registers", 1, [40])) == []
    assert oracle.only_changed(image(r3=7), image(r3=7), {}) == []
    neighbour = oracle.only_changed(image(), image(r1=40, r2=40), points("holding_registers", 1, [40]))
    assert "1/holding_registers/2 should hold 0, the device holds 40 [WR-002]" in words(neighbour)
    unwritten = oracle.only_changed(image(), image(), points("holding_registers", 1, [40]))
    assert "should hold 40, the device holds 0 [WR-001]" in words(unwritten)
    assert len(oracle.only_changed(image(), {"points": points("holding_registers", 0, [1] * 10)}, {})) == 5


def test_the_image_is_asked_for_values_of_the_right_type() -> None:
    assert oracle.image_holds(image(r1=40, r2=41), "holding_registers", 1, [40, 41]) == []
    assert oracle.image_holds(image(), "coils", 1, [True]) == []
    assert "1/coils/1 should hold 1, the device holds True" in words(oracle.image_holds(image(), "coils", 1, [1]))
    nowhere = oracle.image_holds(image(), "holding_registers", 1, [0], unit=9)
    assert "9/holding_registers/1 should hold 0, the device has no such point" in words(nowhere)


COILS = "0F 0005 000A 02 0501 -> 0F 0005 000A"
MASK = "16 0014 FF00 000F -> 16 0014 FF00 000F"


def test_one_write_of_many_coils_is_judged_bit_by_bit() -> None:
    wanted: list[object] = [True, False, True, *[False] * 5, True, False]
    assert oracle.exactly_one_write(journal(COILS), "coils", address=5, values=wanted) == []
    other = oracle.exactly_one_write(journal(COILS), "coils", address=5, values=[True, *[False] * 9])
    assert "it saw a write of [True" in words(other)
    assert "it saw 2" in words(oracle.exactly_one_write(journal(COILS, COILS), "coils", address=5, values=wanted))
    assert "[ADR-001]" in words(oracle.exactly_one_write(journal(COILS), "coils", address=4, values=wanted))


def test_a_mask_write_is_the_device_s_own_function_with_both_masks() -> None:
    def judged(*exchanges: str, address: int = 20, or_mask: int = 15) -> list[Any]:
        return oracle.exactly_one_mask_write(journal(*exchanges), address, and_mask=0xFF00, or_mask=or_mask)

    assert judged(MASK) == []
    assert "the masks 65280 and 15 [WR-001]" in words(judged(MASK, or_mask=16))
    assert "it saw one of 20 [ADR-001]" in words(judged(MASK, address=21))
    assert "it saw 2 [WR-003]" in words(judged(MASK, MASK))
    assert "it saw 0 [WR-001]" in words(judged(READ))
    read_modify_write = "06 0014 000F -> 06 0014 000F"
    assert "it saw FC 06 address 20" in words(judged("03 0014 0001 -> 03 02 0000", read_modify_write))


def test_an_identification_was_asked_for_and_answered() -> None:
    request = "2B 0E 02 00"
    assert oracle.identified(journal(f"{request} -> 2B 0E 02 82 00 00 01 00 01 41")) == []
    assert "should have been asked for its identification" in words(oracle.identified(journal(f"{request} -> ?")))
    assert oracle.identified(journal(READ)) != []
