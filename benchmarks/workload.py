"""What both the adapters' tools and the raw clients are asked to do, so that it is the same."""

from __future__ import annotations

__all__ = ["INPUT_REGISTERS", "PAYLOAD", "TEMPERATURE", "TOPIC"]

INPUT_REGISTERS = 4
TEMPERATURE = "ns=2;s=Temperature"
TOPIC, PAYLOAD = "control/pump", '{"pump_speed": 50}'
