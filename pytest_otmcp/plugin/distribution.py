"""Which worker of pytest-xdist gets which item: each starts as few devices and adapters as it can.

A device and an adapter take about a second of a processor each, and a worker needs those of every protocol that it gets an item of. So it gets the items
of the protocols that it has, then those of protocols that no other worker has, and takes from the others only when nothing else is left. Among
equals the order of the suite decides: the longest come first.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping

import pytest
from xdist.remote import Producer
from xdist.scheduler import LoadScheduling
from xdist.workermanage import WorkerController

__all__ = ["Distribution"]


class Distribution(LoadScheduling):  # type: ignore[misc]
    """The scheduler of ``--dist=load`` with another choice of the next item.

    Args:
        config, log: as of the base class.
        adapters: names of the adapters of each task, by its id.
    """

    def __init__(self, config: pytest.Config, log: Producer, adapters: Mapping[str, Collection[str]]) -> None:
        super().__init__(config, log)
        self._adapters = adapters
        self._has: defaultdict[WorkerController, set[str]] = defaultdict(set)

    def _send_tests(self, node: WorkerController, num: int) -> None:
        for _ in range(min(num, len(self.pending))):
            chosen = min(self.pending, key=lambda index: (self._cost(node, index), index))
            self._has[node] |= self._needed(chosen)
            self.pending.remove(chosen)
            self.pending.insert(0, chosen)
            super()._send_tests(node, 1)

    def _needed(self, index: int) -> set[str]:
        assert self.collection is not None
        return {*self._adapters.get(self.collection[index].rpartition("[")[2].rstrip("]"), ())}

    def _cost(self, node: WorkerController, index: int) -> int:
        lacking = self._needed(index) - self._has[node]
        if not lacking:
            return 0
        taken = set[str]().union(*(has for other, has in self._has.items() if other is not node))
        return 2 if lacking & taken else 1
