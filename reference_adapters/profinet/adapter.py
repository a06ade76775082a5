"""The construction of the PROFINET adapter from its settings."""

from __future__ import annotations

from pathlib import Path

from ..core import AdapterServer, ConfigError, Environment
from .controller import Controller
from .maps import load_aliases, load_devices
from .network import Network
from .tools import Tools

__all__ = ["build"]

_CYCLES_MS = (32, 64, 128, 256, 512)
_LONGEST_WATCHDOG_S = 1.92
"""The largest watchdog that a relation can have."""


def build() -> AdapterServer:
    """Build the adapter that the environment configures.

    Raises:
        ConfigError: a setting cannot be used.
    """
    environment = Environment()
    interface = environment.text("PROFINET_INTERFACE")
    cycle_ms = environment.whole("PROFINET_CYCLE_MS", 32, 32, 512)
    if cycle_ms not in _CYCLES_MS:
        raise ConfigError(f"PROFINET_CYCLE_MS: expected one of {', '.join(map(str, _CYCLES_MS))}, found {cycle_ms}")
    watchdog_s = environment.seconds("PROFINET_WATCHDOG_S", 1.9)
    if not 3 * cycle_ms / 1000 <= watchdog_s <= _LONGEST_WATCHDOG_S:
        message = f"expected three cycles at least, and {_LONGEST_WATCHDOG_S:g} s at most, found {watchdog_s:g}"
        raise ConfigError(f"PROFINET_WATCHDOG_S: {message}")
    devices = load_devices(environment)
    aliases = load_aliases(environment, devices)
    network = Network(interface, environment.seconds("PROFINET_TIMEOUT_S", 1.0))
    controller = Controller(network, devices, cycle_s=cycle_ms / 1000, watchdog_s=watchdog_s)
    server = AdapterServer(
        name="profinet-reference",
        version="0.1.0",
        protocol="profinet-io",
        endpoint=f"profinet:///{interface}",
        writes_enabled=environment.writes_enabled("PROFINET_WRITES_ENABLED"),
        switch="PROFINET_WRITES_ENABLED",
        deadline_s=environment.seconds("PROFINET_DEADLINE_S", 5.0),
        close=controller.close,
    )
    folder = environment.optional("PROFINET_GSD_FOLDER")
    server.add(
        Tools(
            controller,
            aliases=aliases,
            station=environment.optional("PROFINET_STATION"),
            discovery_s=environment.seconds("PROFINET_DISCOVERY_S", 0.4),
            gsd_folder=None if folder is None else Path(folder),
        )
    )
    return server
