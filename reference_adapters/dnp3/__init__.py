"""The DNP3 adapter: 8 tools over one TCP connection to an outstation, or to several behind one gateway.

Environment: ``DNP3_HOST``, ``DNP3_PORT`` (20000), ``DNP3_OUTSTATION_ADDRESS`` (10, of ``ping``), ``DNP3_MASTER_ADDRESS`` (1),
``DNP3_TIMEOUT_S`` (1, per fragment of an answer), ``DNP3_DEADLINE_S`` (3, per call), ``DNP3_WRITES_ENABLED`` (no),
``DNP3_DIRECT_OPERATE_ENABLED`` (no: outputs are selected before they are operated), ``DNP3_ALIAS_MAP`` (a JSON file, see ``aliases``),
``DNP3_TLS_CA``, ``DNP3_TLS_CERT``, ``DNP3_TLS_KEY`` (see ``core.tls``; with them the port is 19999 by default).

The adapter is a master that asks. It confirms what an outstation sends unasked and hands it on with the next poll; it does not reset the
link, set the time, or turn unsolicited responses on or off. With writes enabled it clears the indication of a restart that it has seen.
"""

from __future__ import annotations

from .adapter import build

__all__ = ["build"]
