"""The EtherCAT adapter: 14 tools of a master on one network interface, on pysoem (SOEM).

Environment: ``ETHERCAT_INTERFACE``, the network interface; ``ETHERCAT_TIMEOUT_S`` (1, per object); ``ETHERCAT_DEADLINE_S`` (5, per call);
``ETHERCAT_WRITES_ENABLED`` (no); ``ETHERCAT_CYCLE_S`` (0.01, how often process data are exchanged while a slave is in OP);
``ETHERCAT_WATCHDOG_S`` (0.1, after which a slave gives its outputs up); ``ETHERCAT_ALIAS_MAP`` (a JSON file, see ``maps``);
``ETHERCAT_ESI_FOLDER`` (where ESI files are).

The library blocks, so it has a process of its own (``worker``). Slaves are set up to SAFEOP, in which they take no outputs; reading is
passive. A write of outputs takes its slave to OP, and from then on its process data are exchanged until the adapter ends, or the slave has
left OP; it is not taken back by itself. When the adapter ends, however it ends, the watchdogs of the slaves clear their outputs.

The adapter is the only master of its line.
"""

from __future__ import annotations

from .adapter import build

__all__ = ["build"]
