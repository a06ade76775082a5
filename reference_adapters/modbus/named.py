"""The Modbus TCP adapter with a vocabulary of its own: sensors, valves, buttons and a pump in the place of coils and registers."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypedDict

from ..core import AdapterServer, Arguments, Call, Nothing, tool
from .adapter import build as build_adapter
from .shapes import Bits, Reachable, Registers, Unit, WriteCoil, WriteRegister
from .tools import Tools

__all__ = ["NamedTools", "build"]

_TEMPERATURES = {"inlet": 10, "outlet": 12}
"""Input registers, in tenths of a degree."""
_VALVES = {"inlet": 4, "outlet": 5}
_START_BUTTON = 10
_PUMP_SPEED, _BATCH_LITRES = 40, 41
_START_BATCH = 12
"""Coils and registers of the plant."""


class Sensor(Arguments):
    """Where a temperature is measured."""

    place: Literal["inlet", "outlet"]


class Temperature(TypedDict):
    """A temperature, in degrees Celsius."""

    place: str
    celsius: float


class ValveName(Arguments):
    """A valve."""

    valve: Literal["inlet", "outlet"]


class Position(TypedDict):
    """Where a valve is."""

    valve: str
    position: Literal["open", "closed"]


class Speed(Arguments):
    """The speed of the pump."""

    percent: Annotated[float, Field(ge=0, le=100, multiple_of=0.5, description="of the full speed")]


class Valve(Arguments):
    """A valve and where it is to go."""

    valve: Literal["inlet", "outlet"]
    position: Literal["open", "closed"]


class Batch(Arguments):
    """How much a batch is to be."""

    litres: Annotated[int, Field(ge=1, le=500)]


class Done(TypedDict):
    """A command that was carried out."""

    done: str


class NamedTools:
    """The tools over those of the adapter."""

    def __init__(self, tools: Tools) -> None:
        self._tools = tools
        self.present = tools.present

    @tool("modbus.ping")
    async def plant_status(self, call: Call, arguments: Nothing) -> Reachable:
        """Confirm that the plant answers."""
        return await self._tools.ping(call, Unit())

    @tool("modbus.read_input")
    async def read_temperature(self, call: Call, arguments: Sensor) -> Temperature:
        """Read a temperature."""
        register = Registers(address=_TEMPERATURES[arguments.place], count=1)
        (tenths,) = (await self._tools.read_input_registers(call, register))["values"]
        return {"place": arguments.place, "celsius": tenths / 10}

    @tool("modbus.read_coils")
    async def valve_position(self, call: Call, arguments: ValveName) -> Position:
        """Say whether a valve is open."""
        coil = Bits(address=_VALVES[arguments.valve], count=1)
        (is_open,) = (await self._tools.read_coils(call, coil))["values"]
        return {"valve": arguments.valve, "position": "open" if is_open else "closed"}

    @tool("modbus.write_holding", writes=True)
    async def set_pump_speed(self, call: Call, arguments: Speed) -> Done:
        """Set the speed of the pump."""
        await self._tools.write_register(call, WriteRegister(address=_PUMP_SPEED, value=round(arguments.percent * 10)))
        return {"done": f"the pump runs at {arguments.percent:g} %"}

    @tool("modbus.write_coil", writes=True)
    async def move_valve(self, call: Call, arguments: Valve) -> Done:
        """Open or close a valve."""
        state = arguments.position == "open"
        await self._tools.write_coil(call, WriteCoil(address=_VALVES[arguments.valve], value=state))
        return {"done": f"the {arguments.valve} valve is {arguments.position}"}

    @tool("modbus.write_coil", writes=True)
    async def press_start(self, call: Call, arguments: Nothing) -> Done:
        """Press the start button."""
        await self._tools.write_coil(call, WriteCoil(address=_START_BUTTON, value=True))
        return {"done": "the start button was pressed"}

    @tool("modbus.write_holding", writes=True)
    async def start_batch(self, call: Call, arguments: Batch) -> Done:
        """Say how much a batch is to be, and start it."""
        # Both before the first is sent: a batch that may not be started is not announced either.
        size = self._tools.targets(Unit(), "holding_registers", _BATCH_LITRES, [arguments.litres])
        call.changes(*size, *self._tools.targets(Unit(), "coils", _START_BATCH, [True]))
        await self._tools.write_register(call, WriteRegister(address=_BATCH_LITRES, value=arguments.litres))
        await self._tools.write_coil(call, WriteCoil(address=_START_BATCH, value=True))
        return {"done": f"a batch of {arguments.litres} litres has begun"}


def build() -> AdapterServer:
    """Build the adapter that the environment configures.

    Raises:
        ConfigError: a setting cannot be used.
    """
    return build_adapter(NamedTools)
