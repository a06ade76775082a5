"""Honest adapters that keep a list of targets, or limits, in a way of their own."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from pytest_otmcp.reference_adapters.core import AdapterError, AdapterServer, Call
from pytest_otmcp.reference_adapters.core import bounds as core_bounds
from pytest_otmcp.reference_adapters.core.bounds import Bounds
from pytest_otmcp.reference_adapters.defects.defect import failing

from pytest_otmcp.protocols.bounds import Bounds as Told

from .choice import choices

if TYPE_CHECKING:
    from pytest_otmcp.subject import Adapter

__all__ = ["CHOICES"]

_MODBUS, modbus = choices("modbus")
_MQTT, mqtt = choices("mqtt")
_OPCUA, opcua = choices("opcua")


@modbus(
    "refuses a register that is not on its list as one that it does not know",
    "what an adapter does not offer need not have a name",
)
def knows_no_other_registers(server: AdapterServer) -> None:
    def change(call: Call, error: AdapterError) -> AdapterError | None:
        # What the device denies is no matter of the list.
        if error.code != "access_denied" or "exception_code" in call.trace:
            return None
        return AdapterError("illegal_address", "there is no such register that may be written", outcome="not_sent")

    failing(change=change)(server)


@modbus(
    "counts a write that it has refused when it looks whether the next one comes too soon",
    "what was refused was tried, and somebody who tries again and again is slowed down",
)
def counts_what_it_refused(server: AdapterServer) -> None:
    genuine = Bounds.check

    def check(self: Bounds, changes: Sequence[tuple[str, object]]) -> None:
        try:
            genuine(self, changes)
        finally:
            now = time.monotonic()
            self._last |= {name: (self._last[name][0], now) for name, _ in changes if name in self._last}

    Bounds.check = check  # type: ignore[method-assign]


def _by_prefix(adapter: Adapter) -> Adapter:
    prefixes = ("control/pump", "control/line-1", "control/limited", "control/paced")
    covered = [f"{prefix}{rest}" for prefix in prefixes for rest in ("", "*", "*/*", "*/*/*")]
    assert adapter.bounds is not None
    return dataclasses.replace(adapter, bounds=Told(allowed=covered, limits=adapter.bounds.limits))


@mqtt(
    "has a list of beginnings of topics, and every topic that begins so may be written",
    "what a list covers is its author's choice, and the subject file says it",
    described=_by_prefix,
)
def lists_beginnings(server: AdapterServer) -> None:
    core_bounds.covers = lambda pattern, topic: topic.startswith(pattern.replace("*/speed", "line-1"))


@opcua(
    "compares a step with the number that the server holds, which it reads before each write",
    "somebody else may have changed it meanwhile",
)
def steps_from_what_is_held(server: AdapterServer) -> None:
    from pytest_otmcp.reference_adapters.opcua.services import Services

    genuine = Services.write

    async def write(self: Services, nodes: Any, values: Any) -> Any:
        bounds = server._bounds
        if bounds is not None:
            for node, held in zip(nodes, await self.read(nodes), strict=True):
                if isinstance(held.Value.Value, float):
                    last = bounds._last.get(node.to_string(), (0.0, -math.inf))
                    bounds._last[node.to_string()] = (held.Value.Value, last[1])
        return await genuine(self, nodes, values)

    Services.write = write  # type: ignore[method-assign]


CHOICES = {**_MODBUS, **_MQTT, **_OPCUA}
