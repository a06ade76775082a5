"""The work of the adapters' tools and of the raw clients, defined once so that both do the same."""

from __future__ import annotations

__all__ = ["INPUT_REGISTERS", "MANY_FOLDER", "PAYLOAD", "TEMPERATURE", "TOPIC"]

INPUT_REGISTERS = 4
TEMPERATURE = "ns=2;s=Temperature"
MANY_FOLDER = "ns=2;s=Many.Folder"
TOPIC, PAYLOAD = "control/pump", '{"pump_speed": 50}'
