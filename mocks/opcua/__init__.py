"""An OPC UA plant: asyncua's server behind strict checks, with journal, faults and 1 Hz dynamics."""

from __future__ import annotations

import asyncio
import logging

from ..endpoint import Endpoint
from .device import OpcUaDevice
from .plant import Plant
from .server import PlantServer

__all__ = ["ENDPOINTS", "create", "warm"]

ENDPOINTS = (Endpoint(name="opcua", kind="tcp"),)

_warmed: tuple[PlantServer, Plant] | None = None


def warm() -> None:
    """Build the address space: a second of work whose result every device forked later inherits. No loop and no thread
    is left behind, because a fork does not copy them."""
    global _warmed  # noqa: PLW0603  (handed from the launcher to the devices it forks)
    # The library logs refused requests as errors; here the refusals are intended.
    logging.getLogger("asyncua").setLevel(logging.CRITICAL)
    _warmed = asyncio.run(_build())


async def _build() -> tuple[PlantServer, Plant]:
    server = PlantServer()
    await server.init()
    plant = Plant(server)
    await plant.build()
    return server, plant


def create() -> OpcUaDevice:
    """Return a device on the address space that :func:`warm` has built."""
    if _warmed is None:
        warm()
    assert _warmed is not None
    return OpcUaDevice(*_warmed)
