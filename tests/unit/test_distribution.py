"""Which worker of pytest-xdist gets which item."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import chain
from types import SimpleNamespace
from typing import Any

from xdist.remote import Producer

from pytest_otmcp.plugin.distribution import Distribution


class Worker:
    """A worker that executes its items one after the other."""

    def __init__(self, name: str) -> None:
        self.gateway = SimpleNamespace(id=name)
        self.shutting_down = False
        self.items: list[int] = []
        self.done: list[str] = []

    def send_runtest_some(self, indices: list[int]) -> None:
        self.items += indices

    def shutdown(self) -> None:
        self.shutting_down = True


def executed(adapters: Mapping[str, tuple[str, ...]], count: int) -> list[list[str]]:
    """Return the ids of the tasks that each of so many workers has executed, where all items take equally long."""
    collection = [f"conformance/test_normal.py::test_normal[{name}]" for name in adapters]
    config: Any = SimpleNamespace(getvalue=lambda name: ["popen"] * count, getoption=lambda name: 1)
    scheduler = Distribution(config, Producer("test", enabled=False), adapters)
    workers: list[Any] = [Worker(f"gw{number}") for number in range(count)]
    for worker in workers:
        scheduler.add_node(worker)
        scheduler.add_node_collection(worker, collection)
    scheduler.schedule()
    while any(worker.items for worker in workers):
        for worker in workers:
            if worker.items:
                index = worker.items.pop(0)
                worker.done.append(list(adapters)[index])
                scheduler.mark_test_complete(worker, index)
    return [worker.done for worker in workers]


def started(adapters: Mapping[str, tuple[str, ...]], done: list[list[str]]) -> list[int]:
    return [len({name for task in tasks for name in adapters[task]}) for tasks in done]


MANY = {
    f"{letter}{number}": (protocol,)
    for number in range(12)
    for letter, protocol in zip("MQOK", ("modbus", "mqtt", "opcua", "s7"), strict=True)
}


def test_each_worker_has_its_own_protocols_and_its_items_keep_their_order() -> None:
    done = executed(MANY, 2)
    assert sorted(chain(*done)) == sorted(MANY)
    assert started(MANY, done) == [2, 2]
    for tasks in done:
        for letter in {task[0] for task in tasks}:
            assert [task for task in tasks if task[0] == letter] == [f"{letter}{number}" for number in range(12)]


def test_a_worker_without_a_protocol_of_its_own_helps_the_others() -> None:
    done = executed(MANY, 6)
    assert sorted(chain(*done)) == sorted(MANY)
    assert min(map(len, done)) >= 6


def test_an_item_on_several_protocols_goes_where_they_are() -> None:
    adapters = {
        "X1": ("modbus", "mqtt"),
        **{f"M{number}": ("modbus",) for number in range(6)},
        **{f"Q{number}": ("mqtt",) for number in range(6)},
    }
    done = executed(adapters, 1)
    assert done == [list(adapters)]


def test_tests_that_are_no_items_of_the_suite_are_executed_as_well() -> None:
    collection = {**MANY, "of the user": ()}
    assert sorted(chain(*executed(collection, 3))) == sorted(collection)
