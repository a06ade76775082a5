"""Re-export of the handles of mock devices, the documented import path."""

from .plugin.fixtures.bacnet_handles import AsyncBacnetDevice, BacnetDevice, BacnetEntry
from .plugin.fixtures.device_handles import (
    AnyDevice,
    AsyncAnyDevice,
    AsyncDevice,
    Device,
    JournalEntry,
    KitError,
    SubjectError,
    UsageError,
)
from .plugin.fixtures.dnp3_handles import AsyncDnp3Device, Dnp3Device, Dnp3Entry
from .plugin.fixtures.ethercat_handles import AsyncEthercatDevice, EthercatDevice, EthercatEntry
from .plugin.fixtures.ethernetip_handles import AsyncEthernetIpDevice, EthernetIpDevice, EthernetIpEntry
from .plugin.fixtures.modbus_handles import AsyncModbusDevice, ModbusDevice, ModbusEntry
from .plugin.fixtures.mqtt_handles import AsyncBroker, Broker, MqttEntry
from .plugin.fixtures.opcua_handles import AsyncOpcUaPlant, OpcUaEntry, OpcUaPlant
from .plugin.fixtures.profibus_handles import AsyncProfibusDevice, ProfibusDevice, ProfibusEntry
from .plugin.fixtures.profinet_handles import AsyncProfinetDevice, ProfinetDevice, ProfinetEntry
from .plugin.fixtures.s7_handles import AsyncS7Device, S7Device, S7Entry

__all__ = [
    "AnyDevice",
    "AsyncAnyDevice",
    "AsyncBacnetDevice",
    "AsyncBroker",
    "AsyncDevice",
    "AsyncDnp3Device",
    "AsyncEthercatDevice",
    "AsyncEthernetIpDevice",
    "AsyncModbusDevice",
    "AsyncOpcUaPlant",
    "AsyncProfibusDevice",
    "AsyncProfinetDevice",
    "AsyncS7Device",
    "BacnetDevice",
    "BacnetEntry",
    "Broker",
    "Device",
    "Dnp3Device",
    "Dnp3Entry",
    "EthercatDevice",
    "EthercatEntry",
    "EthernetIpDevice",
    "EthernetIpEntry",
    "JournalEntry",
    "KitError",
    "ModbusDevice",
    "ModbusEntry",
    "MqttEntry",
    "OpcUaEntry",
    "OpcUaPlant",
    "ProfibusDevice",
    "ProfibusEntry",
    "ProfinetDevice",
    "ProfinetEntry",
    "S7Device",
    "S7Entry",
    "SubjectError",
    "UsageError",
]
