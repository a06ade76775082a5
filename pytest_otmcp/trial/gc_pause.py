"""Pauses of Python's garbage collector, which keep it out of what is measured.

A collection of everything that is loaded takes a tenth of a second. During a call it would be counted as the adapter's
latency.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["settled", "uncollected"]


@contextmanager
def settled() -> Iterator[None]:
    """Exempt what is loaded inside the block from garbage collection, while it is loaded and afterwards: it stays anyway."""
    with _disabled():
        yield
        gc.freeze()


@contextmanager
def uncollected() -> Iterator[None]:
    """Allow no collection inside the block; at its end collect the young objects, so that garbage does not add up."""
    with _disabled():
        try:
            yield
        finally:
            gc.collect(1)


@contextmanager
def _disabled() -> Iterator[None]:
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
