"""Pauses of Python's garbage collector, which keep it out of what is measured.

A collection of everything that is loaded takes a tenth of a second. During a call it would be counted as the adapter's
latency.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["settled", "uncollected"]

_YOUNG_PER_FULL = 50
"""Collections of young objects after which everything is collected. Python would do that by itself, but only inside the pauses.

A session that was replaced leaves some 600 objects in cycles, a quarter of a megabyte, which have grown old by then. Beside what
:func:`settled` has exempted there is little to search: 50 ms of processor time after 50 fresh sessions, 2 ms otherwise.
"""


@contextmanager
def settled() -> Iterator[None]:
    """Exempt what is loaded inside the block from garbage collection, while it is loaded and afterwards: it stays anyway."""
    with _disabled():
        yield
        gc.freeze()


@contextmanager
def uncollected() -> Iterator[None]:
    """Allow no collection inside the block; at its end collect the young objects, now and then all of them."""
    with _disabled():
        try:
            yield
        finally:
            gc.collect(2 if gc.get_count()[2] >= _YOUNG_PER_FULL else 1)


@contextmanager
def _disabled() -> Iterator[None]:
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
