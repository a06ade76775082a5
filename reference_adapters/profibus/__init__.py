"""The PROFIBUS DP adapter: 11 tools of a master on one serial line.

Environment: ``PROFIBUS_SERIAL``, the path of the line; ``PROFIBUS_BAUD`` (19200); ``PROFIBUS_MASTER_ADDRESS`` (2); ``PROFIBUS_TIMEOUT_S``
(1, per telegram); ``PROFIBUS_SLOT_S`` (0.01, how long a scan waits at each address); ``PROFIBUS_DEADLINE_S`` (5, per call);
``PROFIBUS_WRITES_ENABLED`` (no); ``PROFIBUS_CYCLE_S`` (0.1, how often outputs are repeated); ``PROFIBUS_WATCHDOG_S`` (1, after which a
slave gives them up); ``PROFIBUS_SLAVE_MAP`` and ``PROFIBUS_ALIAS_MAP`` (JSON files, see ``maps``); ``PROFIBUS_GSD_FOLDER`` (where GSD
files are).

Reading is passive: inputs and outputs are asked for as a class 2 master does (RD_Inp, RD_Outp), and no slave is parameterised for it. A
write parameterises and configures its slave, if another master has not, and from then on the outputs are repeated until the adapter
ends or the slave is lost; a lost slave is taken back by the next write only.

The adapter is the only master of its line: it has no token to pass on.
"""

from __future__ import annotations

from .adapter import build

__all__ = ["build"]
