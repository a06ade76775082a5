"""The memory of the device, four tables of a hundred cells, and the dynamics of the plant behind them.

The plant moves its input registers, discrete inputs, mode (on a command) and alarm (when it gets hot); every other
cell belongs to the clients. It is deterministic: the same ticks and writes give the same values.

Addresses are those of the PDU, from 0. The cells with a meaning are the paper's ("Mock endpoint fidelity"); the others
are free for use.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

__all__ = ["IDENTIFICATION", "SIZE", "TABLES", "UnitImage"]

SIZE = 100
TABLES = ("holding_registers", "input_registers", "coils", "discrete_inputs")

VALVE, HEATER, FAN, CONVEYOR, RATE, MODE, START, STOP, E_STOP, RESET = range(10)
TEMPERATURE, PRESSURE, FLOW, LEVEL, VIBRATION, PH, HUMIDITY, MOTOR, PRODUCED = range(9)
PUMP, ALARM = 0, 1
E_STOPPED, RUNNING = 0, 1

IDENTIFICATION = {
    0: b"pytest-otmcp",
    1: b"MOCK-MB-1",
    2: b"1.0",
    3: b"https://github.com/pytest-otmcp",
    4: b"Modbus TCP mock plant",
    5: b"MOCK-MB",
    6: b"conformance",
}
"""Objects of Read Device Identification (section 6.21) that a unit starts with."""

_STOPPED_MODE, _RUNNING_MODE, _E_STOP_MODE = 0, 1, 2
_AMBIENT = 20.0
_ALARM_LIMIT = 90.0


class UnitImage:
    """The memory of one unit.

    Scales: temperature, tank level and humidity x10, vibration and pH x100; percentages 0 to 100; the rest as is.

    Attributes:
        identification: objects of Read Device Identification by object id.
    """

    def __init__(self) -> None:
        self.identification = dict(IDENTIFICATION)
        self.holding_registers = [0] * SIZE
        self.input_registers = [0] * SIZE
        self.coils = [False] * SIZE
        self.discrete_inputs = [False] * SIZE
        self._temperature = 25.0
        self._level = 50.0
        self._produced = 0.0
        self._seconds = 0
        self._was_hot = False
        self._given: set[int] = set()
        self.holding_registers[:10] = [50, 30, 40, 60, 100, _RUNNING_MODE, 0, 0, 0, 0]
        self.coils[PUMP] = True
        self.discrete_inputs[RUNNING] = True
        self._publish()

    @property
    def size(self) -> int:
        """Number of cells of each table."""
        return len(self.holding_registers)

    def enlarge(self, size: int) -> None:
        """Give every table so many cells; new ones hold 0."""
        for name in TABLES:
            cells = self.table(name)
            empty: Any = False if name in ("coils", "discrete_inputs") else 0
            cells.extend([empty] * (size - len(cells)))

    def table(self, name: str) -> list[Any]:
        """Return the cells of a table, to be read or changed in place.

        Raises:
            ValueError: there is no such table.
        """
        if name not in TABLES:
            raise ValueError(f"unknown table {name!r}; known are {', '.join(TABLES)}")
        cells: list[Any] = getattr(self, name)
        return cells

    def poke(self, table: str, address: int, values: Sequence[Any]) -> None:
        """Set cells out of band.

        Raises:
            ValueError: no such table, address or value.
        """
        cells = self.table(table)
        if address < 0 or address + len(values) > self.size:
            raise ValueError(f"{table} {address}..{address + len(values) - 1}: the device has 0..{self.size - 1}")
        bits = table in ("coils", "discrete_inputs")
        kind, highest = (bool, 1) if bits else (int, 0xFFFF)
        for value in values:
            if type(value) is not kind or not 0 <= value <= highest:
                raise ValueError(f"{table}: expected {'booleans' if bits else 'integers 0..65535'}, found {value!r}")
        cells[address : address + len(values)] = list(values)

    def dump(self) -> dict[str, Any]:
        """Return a copy of all four tables."""
        return {name: list(self.table(name)) for name in TABLES}

    def tick(self) -> None:
        """Advance by one second: commands, temperature (heater), pressure and flow (pump), production (conveyor)."""
        self._seconds += 1
        self._execute_commands()
        registers, running = self.holding_registers, self.discrete_inputs[RUNNING]
        heating = min(registers[HEATER], 100) * 0.8 if running else 0.0
        cooling = min(registers[FAN], 100) * 0.1
        self._temperature += (_AMBIENT + heating - cooling - self._temperature) * 0.05
        pumping = self.coils[PUMP] and running
        valve = min(registers[VALVE], 100) / 100
        self._level = min(100.0, max(0.0, self._level + (0.4 if pumping else 0.0) - 0.4 * valve))
        if running:
            self._produced += registers[RATE] / 60 * min(registers[CONVEYOR], 100) / 100
        hot = self._temperature > _ALARM_LIMIT
        if hot and not self._was_hot:
            self.coils[ALARM] = True
        self._was_hot = hot
        self._publish()

    def _execute_commands(self) -> None:
        """Execute the command registers.

        E-stop is a switch: as long as its register is not 0, nothing runs. The other commands act when their registers
        leave 0. The plant never changes a register that a client has written.
        """
        registers, inputs = self.holding_registers, self.discrete_inputs
        given = {command for command in (START, STOP, E_STOP, RESET) if registers[command]}
        fresh, self._given = given - self._given, given
        if E_STOP in given:
            if not inputs[E_STOPPED]:
                inputs[E_STOPPED], inputs[RUNNING], registers[MODE] = True, False, _E_STOP_MODE
        elif RESET in fresh:
            inputs[E_STOPPED], inputs[RUNNING], registers[MODE] = False, False, _STOPPED_MODE
        elif STOP in fresh and not inputs[E_STOPPED]:
            inputs[RUNNING], registers[MODE] = False, _STOPPED_MODE
        elif START in fresh and not inputs[E_STOPPED]:
            inputs[RUNNING], registers[MODE] = True, _RUNNING_MODE

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
