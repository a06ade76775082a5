"""The work of the adapters' tools and of the raw clients, defined once so that both do the same."""

from __future__ import annotations

__all__ = [
    "ANALOG_INPUTS",
    "BLOCKS",
    "DB",
    "DB_BYTES",
    "DEVICE",
    "ENTRY",
    "FLOOD",
    "INBOX",
    "INPUT_REGISTERS",
    "OBJECT",
    "OUTSTATION",
    "PARALLEL",
    "PAYLOAD",
    "PDU_REGISTERS",
    "SLAVE",
    "SLOT",
    "STATION",
    "TAG",
    "TEMPERATURE",
    "TOPIC",
]

INPUT_REGISTERS = 4
TEMPERATURE = "ns=2;s=Temperature"
DB, DB_BYTES = 1, 16
OUTSTATION, ANALOG_INPUTS = 10, 4
SLAVE = 5
ENTRY = (1, 0x2001, 6)
"""Position of an EtherCAT slave, index and subindex of a UINT32."""
STATION, SLOT = "kit-device", 1
DEVICE, OBJECT = 12345, ("analog-input", 1)
TAG = "MotorSpeed"
ENTRY = (1, 0x2001, 6)
"""Position of a slave, index and subindex of a UINT32."""
TOPIC, PAYLOAD = "control/pump", '{"pump_speed": 50}'

PDU_REGISTERS = 125
"""The registers that one request may ask for (MODBUS Application Protocol V1.1b3, section 6.3)."""
BLOCKS = (125, 126, 250, 1000, 2000)
"""The numbers of registers that are read by one call."""

PARALLEL = 100
"""Calls that are made at the same time."""

INBOX, FLOOD = "bench/inbox", 20_000
"""The beginning of the topics of a flood, and the number of its messages."""
