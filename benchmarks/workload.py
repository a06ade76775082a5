"""The work of the adapters' tools and of the raw clients, defined once so that both do the same."""

from __future__ import annotations

__all__ = ["INPUT_REGISTERS", "PAYLOAD", "TEMPERATURE", "TOPIC"]

INPUT_REGISTERS = 4
TEMPERATURE = "ns=2;s=Temperature"
TOPIC, PAYLOAD = "control/pump", '{"pump_speed": 50}'
