"""The arguments of the tools with their bounds, and the shapes of their ``data``. Bytes are 0 to 255, times seconds."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field
from typing_extensions import TypedDict

from ..core import LEFT_OUT, AliasName, Arguments, BoundsCode
from ..core.process_data import Value

__all__ = [
    "AddressSet",
    "AliasValue",
    "Communication",
    "DeviceInfo",
    "DeviceList",
    "DeviceMac",
    "DeviceName",
    "Discovery",
    "GsdFile",
    "GsdPath",
    "Identify",
    "IoData",
    "IoDataOf",
    "NameSet",
    "Reachable",
    "RecordData",
    "RecordOf",
    "SetIp",
    "SetName",
    "Signalled",
    "Stations",
    "Status",
    "Subslot",
    "WriteAlias",
    "WriteIo",
    "WriteRecord",
]

Byte = Annotated[int, Field(ge=0, le=255)]
StationName = Annotated[
    str,
    Field(min_length=1, max_length=240, description="name of the station, in lower case"),
]
Mac = Annotated[
    str,
    Field(pattern=r"^[0-9A-Fa-f]{2}(:[0-9A-Fa-f]{2}){5}$", description="hardware address, such as 02:00:5e:00:53:01"),
]
Ip = Annotated[str, Field(pattern=r"^(\d{1,3}\.){3}\d{1,3}$", description="IPv4 address")]
_MOST_BYTES = 1024


# -- arguments ----------------------------------------------------------------------------------------------


class Discovery(Arguments):
    """How long stations are waited for."""

    timeout: float = Field(default=LEFT_OUT, ge=0.1, le=2, description="seconds; the configured time if left out")


class DeviceName(Arguments):
    """A station, by its name."""

    device_name: StationName


class Subslot(DeviceName):
    """A subslot of a station."""

    slot: Annotated[int, Field(ge=0, le=0x7FFF)]
    subslot: Annotated[int, Field(ge=1, le=0x8FFF)] = 1


class IoDataOf(Subslot):
    """The inputs of a subslot, or the first of them."""

    data_length: int = Field(
        default=LEFT_OUT, ge=1, le=_MOST_BYTES, description="how many bytes, from the first one; all if left out"
    )


class WriteIo(Subslot):
    """All outputs of a subslot."""

    data: Annotated[
        list[Byte],
        Field(min_length=1, max_length=_MOST_BYTES, description="all output bytes of the subslot, each 0 to 255"),
        BoundsCode("range_overflow"),
    ]


class RecordOf(Subslot):
    """A record of a subslot."""

    index: Annotated[int, Field(ge=0, le=0xFFFF)]


class WriteRecord(RecordOf):
    """A record and its whole content."""

    data: Annotated[
        list[Byte],
        Field(min_length=1, max_length=_MOST_BYTES, description="all bytes of the record, each 0 to 255"),
        BoundsCode("range_overflow"),
    ]


class DeviceMac(Arguments):
    """A station, by its hardware address."""

    device_mac: Mac


class SetName(DeviceMac):
    """A name for a station."""

    name: StationName


class SetIp(DeviceMac):
    """Addresses for a station."""

    ip_address: Ip
    subnet_mask: Ip = "255.255.255.0"
    gateway: Ip = "0.0.0.0"  # noqa: S104  (no gateway)


class Identify(DeviceMac):
    """How long a station shows itself."""

    duration_s: Annotated[int, Field(ge=1, le=60, description="seconds")] = 3


class GsdPath(Arguments):
    """A GSDML file."""

    filepath: Annotated[str, Field(min_length=1, max_length=200, description="name in the folder of GSDML files")]


class WriteAlias(AliasName):
    """An alias and its value."""

    value: Annotated[int | float | str | bool, Field(description="a number within the alias's type")]


# -- data ---------------------------------------------------------------------------------------------------


class Reachable(TypedDict):
    """A station answers, and which."""

    reachable: bool
    device_name: str


class StationData(TypedDict):
    """What a station says that it is; vendor and device identifier are hexadecimal."""

    device_name: str
    mac: str
    ip_address: str
    vendor: str
    vendor_id: str
    device_id: str


class Stations(TypedDict):
    """The stations that answer."""

    devices: list[StationData]


class DeviceInfo(StationData):
    """The same with the identification I&M0 of the device."""

    order_id: str
    serial_number: str
    hardware_revision: int
    software_revision: str


class NameSet(TypedDict):
    """The name that the station has taken for good."""

    device_mac: str
    name: str


class AddressSet(TypedDict):
    """The addresses that the station has taken, until it is switched off."""

    device_mac: str
    ip_address: str
    subnet_mask: str
    gateway: str


class Signalled(TypedDict):
    """The station shows itself for so many seconds."""

    device_mac: str
    duration_s: int


class IoData(TypedDict):
    """The inputs of a subslot at the moment of the answer, or the outputs that it has."""

    device_name: str
    slot: int
    subslot: int
    bytes: list[int]


class RecordData(IoData):
    """The content of a record."""

    index: int


class GsdFile(TypedDict):
    """What a GSDML file says; identifiers are hexadecimal, as in the device map."""

    vendor: str
    vendor_id: str
    device_id: str
    modules: list[dict[str, Any]]


class DeviceList(TypedDict):
    """The device map and the alias map."""

    devices: list[dict[str, Any]]
    aliases: list[dict[str, Any]]


class AliasValue(Value):
    """An alias's value."""

    alias: str
    device_name: str
    unit: str | None


class Driven(TypedDict):
    """Whether the outputs of a device are kept alive: ``passive``, ``data_exchange`` or ``lost``, and then why."""

    device_name: str
    state: Literal["passive", "data_exchange", "lost"]
    reason: str | None


class Status(TypedDict):
    """This controller: its interface, cycle and watchdog (seconds), and what it does with each device."""

    interface: str
    cycle_s: float
    watchdog_s: float
    devices: list[Driven]


class Communication(TypedDict):
    """What a device says that it is, beside what the device map says; ``matches`` is null for a device that it does not have."""

    device_name: str
    vendor_id: str
    device_id: str
    order_id: str
    matches: bool | None
