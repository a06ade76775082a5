"""The PROFINET adapter: the 14 tools of a controller and supervisor, and two for records.

Environment: ``PROFINET_INTERFACE``, the network interface; ``PROFINET_STATION``, whose answer a ping waits for (any station's);
``PROFINET_TIMEOUT_S`` (1, per request); ``PROFINET_DISCOVERY_S`` (0.4, how long stations are waited for); ``PROFINET_DEADLINE_S`` (5, per
call); ``PROFINET_WRITES_ENABLED`` (no); ``PROFINET_CYCLE_MS`` (32, how often outputs are repeated: 32, 64, 128, 256 or 512);
``PROFINET_WATCHDOG_S`` (1.9, after which a device gives them up); ``PROFINET_DEVICE_MAP`` and ``PROFINET_ALIAS_MAP`` (JSON files, see
``maps``); ``PROFINET_GSD_FOLDER`` (where GSDML files are).

Reading is passive: inputs and outputs are read as records 8028 and 8029 without a relation, so whoever is the controller stays so. A
record is written over a relation of a supervisor, which lasts as long as the write. Outputs need a relation with cyclic data: the first
write makes it, if no other controller has, and the outputs are repeated until the adapter ends or the device is lost; a lost device is
taken back by the next write of outputs only.

It needs packet sockets (CAP_NET_RAW), and UDP port 34964 while it is a controller. Cyclic data are RT class 1 without any promise of time.
"""

from __future__ import annotations

from .adapter import build

__all__ = ["build"]
