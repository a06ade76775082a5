"""How many random bits a question of a proof finds in an answer: another device must not reach enough of them by chance."""

from __future__ import annotations

import random
from collections.abc import Mapping
from typing import Any

import pytest

from pytest_otmcp.protocols.proof import ENOUGH_BITS, Proof, Question
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.subject.addressing import carries_address

MOCK = {"host": "127.0.0.1", "port": "502", "url": "modbus+tcp://127.0.0.1:502"}


def question(protocol: str, operation: str) -> Question:
    proof: Proof = protocols()[protocol].proof
    way = next(way for way in proof.ways if way.operation == operation and not way.weak)
    return way.ask(random.Random(1))


def poked(asked: Question) -> list[Any]:
    """Return the values that are set at the mock, those of the first poke."""
    values = [poke.get("values", [poke.get("value")]) for poke in asked.pokes]
    return list(values[0]) if len(values[0]) > 1 else [value for one in values for value in one]


@pytest.mark.parametrize(("protocol", "operation"), [("modbus", "read_input"), ("opcua", "read_many")])
def test_the_values_of_the_mock_are_enough_and_others_are_nothing(protocol: str, operation: str) -> None:
    asked = question(protocol, operation)
    values = poked(asked)
    assert asked.bits({"values": values[:4]}, []) >= ENOUGH_BITS
    assert asked.bits({"values": [value + 1000 for value in values]}, []) == 0
    assert asked.bits({"values": "no list"}, []) == 0
    assert asked.bits({}, []) == 0


def test_registers_that_all_hold_one_of_the_values_are_one_chance() -> None:
    asked = question("modbus", "read_input")
    same = poked(asked)[0]
    assert 0 < asked.bits({"values": [same] * 4}, []) < ENOUGH_BITS


def test_a_rounded_value_is_worth_less_than_an_exact_one() -> None:
    asked = question("opcua", "read_many")
    first, second = poked(asked)
    exact, rounded = (asked.bits({"values": [value, second + 1]}, []) for value in (first, round(first, 2)))
    assert 0 < rounded < exact < ENOUGH_BITS


@pytest.mark.parametrize(
    ("arguments", "carries"),
    [
        ({"host": "127.0.0.1", "port": 502}, True),
        ({"url": "modbus+tcp://127.0.0.1:502"}, True),
        ({"servers": [{"address": "127.0.0.1:502/1"}]}, True),
        ({"address": "127.0.0.1:5020"}, False),
        ({"address": "10.127.0.0.1:502"}, False),
        ({"address": 5}, False),
    ],
)
def test_the_address_of_the_mock_is_not_that_of_a_device_whose_address_contains_it(
    arguments: Mapping[str, object], carries: bool
) -> None:
    assert carries_address(arguments, MOCK) is carries
