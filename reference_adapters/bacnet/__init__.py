"""The BACnet/IP adapter: 7 tools over one UDP socket.

Environment: ``BACNET_HOST`` and ``BACNET_PORT`` (47808), where devices are asked; ``BACNET_TIMEOUT_S`` (1, per transmission: a question is
sent twice, a write once); ``BACNET_DEADLINE_S`` (5, per call); ``BACNET_WRITES_ENABLED`` (no); ``BACNET_CONFIGURATION_ENABLED`` (no: only
present values may be written); ``BACNET_PRIORITY`` (8, of writes that name none); ``BACNET_ALIAS_MAP`` (a JSON file, see ``aliases``).

The local port is whichever is free, so several adapters and a device may run on one machine. Devices are found by a Who-Is to
``BACNET_HOST``, which answer the sender; the adapter sends no broadcast of its own.
"""

from __future__ import annotations

from .adapter import build

__all__ = ["build"]
