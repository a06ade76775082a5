"""What the device holds: four tables of a hundred cells, and how the plant behind them moves.

Addresses are those of the PDU, from 0. The cells with a meaning are the paper's ("Mock endpoint fidelity"); the others
are free for use.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

__all__ = ["SIZE", "TABLES", "UnitImage"]

SIZE = 100
TABLES = ("holding_registers", "input_registers", "coils", "discrete_inputs")

VALVE, HEATER, FAN, CONVEYOR, RATE, MODE, START, STOP, E_STOP, RESET = range(10)
TEMPERATURE, PRESSURE, FLOW, LEVEL, VIBRATION, PH, HUMIDITY, MOTOR, PRODUCED = range(9)
PUMP, ALARM = 0, 1
E_STOPPED, RUNNING = 0, 1

_STOPPED_MODE, _RUNNING_MODE, _E_STOP_MODE = 0, 1, 2
_AMBIENT = 20.0


class UnitImage:
    """The memory of one unit.

    Scales: temperature, tank level and humidity x10, vibration and pH x100; percentages 0 to 100; the rest as is.
    """

    def __init__(self) -> None:
        self.holding_registers = [0] * SIZE
        self.input_registers = [0] * SIZE
        self.coils = [False] * SIZE
        self.discrete_inputs = [False] * SIZE
        self._temperature = 25.0
        self._level = 50.0
        self._produced = 0.0
        self._seconds = 0
        self.holding_registers[:10] = [50, 30, 40, 60, 100, _RUNNING_MODE, 0, 0, 0, 0]
        self.coils[PUMP] = True
        self.discrete_inputs[RUNNING] = True
        self._publish()

    def table(self, name: str) -> list[Any]:
        """The cells of a table, to be read or changed in place.

        Raises:
            ValueError: there is no such table.
        """
        if name not in TABLES:
            raise ValueError(f"unknown table {name!r}; known are {', '.join(TABLES)}")
        cells: list[Any] = getattr(self, name)
        return cells

    def poke(self, table: str, address: int, values: Sequence[Any]) -> None:
        """Set cells out of band."""
        cells = self.table(table)
        if address < 0 or address + len(values) > SIZE:
            raise ValueError(f"{table} {address}..{address + len(values) - 1}: the device has 0..{SIZE - 1}")
        if table in ("coils", "discrete_inputs"):
            cells[address : address + len(values)] = [bool(value) for value in values]
            return
        if not all(isinstance(value, int) and 0 <= value <= 0xFFFF for value in values):
            raise ValueError(f"{table}: register values are 0..65535")
        cells[address : address + len(values)] = list(values)

    def dump(self) -> dict[str, Any]:
        """All four tables."""
        return {name: list(self.table(name)) for name in TABLES}

    def tick(self) -> None:
        """One second: commands, heater to temperature, pump to pressure and flow, conveyor to production."""
        self._seconds += 1
        self._obey_commands()
        registers, running = self.holding_registers, self.discrete_inputs[RUNNING]
        heating = min(registers[HEATER], 100) * 0.8 if running else 0.0
        cooling = min(registers[FAN], 100) * 0.1
        self._temperature += (_AMBIENT + heating - cooling - self._temperature) * 0.05
        pumping = self.coils[PUMP] and running
        valve = min(registers[VALVE], 100) / 100
        self._level = min(100.0, max(0.0, self._level + (0.4 if pumping else 0.0) - 0.4 * valve))
        if running:
            self._produced += registers[RATE] / 60 * min(registers[CONVEYOR], 100) / 100
        self.coils[ALARM] = self._temperature > 90.0
        self._publish()

    def _obey_commands(self) -> None:
        registers, inputs = self.holding_registers, self.discrete_inputs
        if registers[E_STOP]:
            inputs[E_STOPPED], inputs[RUNNING], registers[MODE] = True, False, _E_STOP_MODE
        elif registers[RESET]:
            inputs[E_STOPPED], registers[MODE] = False, _STOPPED_MODE
        elif registers[STOP]:
            inputs[RUNNING], registers[MODE] = False, _STOPPED_MODE
        elif registers[START] and not inputs[E_STOPPED]:
            inputs[RUNNING], registers[MODE] = True, _RUNNING_MODE
        # A command is an edge, not a state: it is taken back when it has been obeyed.
        registers[START] = registers[STOP] = registers[E_STOP] = registers[RESET] = 0

    def _publish(self) -> None:
        registers, running = self.holding_registers, self.discrete_inputs[RUNNING]
        wave = math.sin(self._seconds / 10)
        pumping = self.coils[PUMP] and running
        valve = min(registers[VALVE], 100)
        self.input_registers[:9] = [
            round(self._temperature * 10),
            round(100 + (50 if pumping else 0) + 5 * wave),
            round(valve * 1.2) if pumping else 0,
            round(self._level * 10),
            round(100 + 20 * wave) if running else 0,
            round(700 + 5 * wave),
            round(450 + 20 * wave),
            round(min(registers[CONVEYOR], 100) * 15) if running else 0,
            round(self._produced) & 0xFFFF,
        ]


def poke(units: Mapping[int, UnitImage], params: Mapping[str, Any]) -> None:
    """Apply the parameters of a ``poke``: unit (default 1), table, address, values."""
    unit = int(params.get("unit", 1))
    if unit not in units:
        raise ValueError(f"unit {unit} is not configured; configured are {', '.join(map(str, units))}")
    units[unit].poke(str(params["table"]), int(params["address"]), list(params["values"]))
