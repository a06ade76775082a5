"""The order in which a bench ends its adapters."""

from __future__ import annotations

import asyncio
from typing import Any, cast

import pytest

from pytest_otmcp.plant.devices import Plant
from pytest_otmcp.subject import reference_subject
from pytest_otmcp.trial.bench import Bench, BenchOptions


class Ending:
    """An adapter under test that only notes when its end is asked for, and ends when it is let."""

    def __init__(self, name: str, url: str | None, told: list[str], let: asyncio.Event) -> None:
        self.adapter = type("Adapter", (), {"url_of": lambda _, variant: url})()
        self.variant = "ro" if name.endswith("ro") else "rw"
        self._name, self._told, self._let = name, told, let

    async def close(self) -> None:
        self._told.append(self._name)
        await self._let.wait()
        raise OSError("it could not be ended in good order")


@pytest.mark.asyncio
async def test_adapters_on_the_network_with_writes_enabled_end_before_all_others() -> None:
    told: list[str] = []
    let = asyncio.Event()
    bench = Bench(reference_subject(), BenchOptions(), Plant())
    urls = {
        "stdio rw": None,
        "http ro": "http://127.0.0.1:1/mcp",
        "http rw": "http://127.0.0.1:2/mcp",
        "stdio ro": None,
    }
    bench._adapters = cast(Any, {name: Ending(name, url, told, let) for name, url in urls.items()})
    closing = asyncio.create_task(bench.close())
    for _ in range(10):
        await asyncio.sleep(0)
    assert told == ["http rw"]
    let.set()
    await closing
    assert told == ["http rw", "stdio rw", "http ro", "stdio ro"]
