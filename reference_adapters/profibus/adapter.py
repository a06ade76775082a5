"""The construction of the PROFIBUS DP adapter from its settings."""

from __future__ import annotations

from pathlib import Path

from ..core import AdapterServer, ConfigError, Environment
from .line import BAUD_RATES, Line
from .maps import load_aliases, load_slaves
from .master import Master
from .tools import Tools

__all__ = ["build"]

_LONGEST_WATCHDOG_S = 650.0
"""Two factors of up to 255, times 10 ms."""


def build() -> AdapterServer:
    """Build the adapter that the environment configures.

    Raises:
        ConfigError: a setting cannot be used.
    """
    environment = Environment()
    path = environment.text("PROFIBUS_SERIAL")
    baud = environment.whole("PROFIBUS_BAUD", 19200, 9600, 12_000_000)
    if baud not in BAUD_RATES:
        raise ConfigError(f"PROFIBUS_BAUD: expected one of {', '.join(map(str, BAUD_RATES))}, found {baud}")
    cycle_s = environment.seconds("PROFIBUS_CYCLE_S", 0.1)
    watchdog_s = environment.seconds("PROFIBUS_WATCHDOG_S", 1.0)
    if not 2 * cycle_s <= watchdog_s <= _LONGEST_WATCHDOG_S:
        message = f"expected two cycles at least, and {_LONGEST_WATCHDOG_S:g} s at most, found {watchdog_s:g}"
        raise ConfigError(f"PROFIBUS_WATCHDOG_S: {message}")
    slaves = load_slaves(environment)
    aliases = load_aliases(environment, slaves)
    folder = environment.optional("PROFIBUS_GSD_FOLDER")
    address = environment.whole("PROFIBUS_MASTER_ADDRESS", 2, 0, 125)
    if address in slaves:
        raise ConfigError(f"PROFIBUS_MASTER_ADDRESS: {address} is a slave's")
    line = Line(path, baud, address, environment.seconds("PROFIBUS_TIMEOUT_S", 1.0))
    master = Master(line, slaves, cycle_s=cycle_s, watchdog_s=watchdog_s)
    server = AdapterServer(
        name="profibus-reference",
        version="0.1.0",
        protocol="profibus-dp",
        endpoint=f"profibus://{path}",
        writes_enabled=environment.writes_enabled("PROFIBUS_WRITES_ENABLED"),
        switch="PROFIBUS_WRITES_ENABLED",
        deadline_s=environment.seconds("PROFIBUS_DEADLINE_S", 5.0),
        close=master.close,
    )
    slot_s = environment.seconds("PROFIBUS_SLOT_S", 0.01)
    gsd_folder = None if folder is None else Path(folder)
    server.add(Tools(master, aliases=aliases, slot_s=slot_s, baud=baud, gsd_folder=gsd_folder))
    return server
