"""A device on a cable of Ethernet: it sends every frame of its kind back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pytest_otmcp.mocks.cable import CableEnd
from pytest_otmcp.mocks.device import Device
from pytest_otmcp.mocks.endpoint import Endpoint, OpenEndpoint
from pytest_otmcp.mocks.frames import Frames

__all__ = ["ENDPOINTS", "create", "warm"]

ENDPOINTS = (Endpoint(name="echo", kind="cable"),)
ETHERTYPE = 0x88B5
"""For experiments (IEEE 802)."""


def warm() -> None:
    """Do nothing: nothing is slow here."""


def create() -> Echo:
    """Return a device that has heard nothing."""
    return Echo()


class Echo(Device):
    """A device that answers frames with themselves."""

    protocol = "echo"

    def __init__(self) -> None:
        super().__init__()
        self.cable = Frames(self.journal, ETHERTYPE, self._received)

    async def serve(self, endpoints: Mapping[str, OpenEndpoint]) -> None:
        end = endpoints["echo"]
        assert isinstance(end, CableEnd)
        self.cable.open(end)

    def _received(self, client: int, frame: bytes) -> None:
        asked = self.journal.event(
            connection=client,
            direction="in",
            kind="ASK",
            request=True,
            state_changing=False,
            said=frame[14:18].decode(),
        )
        if self.cable.carries():
            self.journal.event(connection=client, direction="out", kind="DONE", answers=asked)
        self.cable.send(frame)

    async def aclose(self) -> None:
        self.cable.close()

    def image(self) -> dict[str, Any]:
        return {"points": {}}

    async def poke(self, params: Mapping[str, Any]) -> None:
        self.cable.poke(params)

    def fault(self, rules: list[dict[str, Any]]) -> list[int]:
        return []

    async def reset(self) -> None:
        """Do nothing: it holds nothing."""

    async def tick(self) -> None:
        """Do nothing: it holds nothing."""
