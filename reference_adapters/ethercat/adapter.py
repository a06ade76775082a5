"""The construction of the EtherCAT adapter from its settings."""

from __future__ import annotations

from pathlib import Path

from ..core import AdapterServer, ConfigError, Environment
from .maps import load_aliases
from .segment import Segment
from .tools import Tools

__all__ = ["build"]

_LONGEST_WATCHDOG_S = 6.5
"""65535 times 100 µs."""


def build() -> AdapterServer:
    """Build the adapter that the environment configures.

    Raises:
        ConfigError: a setting cannot be used.
    """
    environment = Environment()
    interface = environment.text("ETHERCAT_INTERFACE")
    cycle_s = environment.seconds("ETHERCAT_CYCLE_S", 0.01)
    watchdog_s = environment.seconds("ETHERCAT_WATCHDOG_S", 0.1)
    if not 2 * cycle_s <= watchdog_s <= _LONGEST_WATCHDOG_S:
        message = f"expected two cycles at least, and {_LONGEST_WATCHDOG_S:g} s at most, found {watchdog_s:g}"
        raise ConfigError(f"ETHERCAT_WATCHDOG_S: {message}")
    folder = environment.optional("ETHERCAT_ESI_FOLDER")
    timeout_s = environment.seconds("ETHERCAT_TIMEOUT_S", 1.0)
    segment = Segment(interface, timeout_s=timeout_s, cycle_s=cycle_s, watchdog_s=watchdog_s)
    server = AdapterServer(
        name="ethercat-reference",
        version="0.1.0",
        protocol="ethercat",
        endpoint=f"ethercat:///{interface}",
        writes_enabled=environment.writes_enabled("ETHERCAT_WRITES_ENABLED"),
        switch="ETHERCAT_WRITES_ENABLED",
        deadline_s=environment.seconds("ETHERCAT_DEADLINE_S", 5.0),
        close=segment.close,
    )
    server.add(Tools(segment, aliases=load_aliases(environment), esi_folder=None if folder is None else Path(folder)))
    return server
