"""Python's garbage collector, kept out of what is measured.

A collection of everything that is loaded takes a tenth of a second. In the midst of a call it would be counted as the
adapter's latency.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["settled", "uncollected"]


@contextmanager
def settled() -> Iterator[None]:
    """What is loaded inside the block stays: it is not searched while it is loaded, nor by any collection afterwards."""
    with _disabled():
        yield
        gc.freeze()


@contextmanager
def uncollected() -> Iterator[None]:
    """No collection inside the block; at its end one of what is young, so that garbage does not add up."""
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
