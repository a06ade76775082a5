"""The tools of a PROFINET controller and supervisor."""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from ..core import AdapterError, AliasName, Call, NameMap, Nothing, device_text, tool
from ..core.process_data import DataType, decode, encode, width
from .controller import Controller
from .gsdml import BadGsdml, DeviceFile, parse
from .maps import Alias, ModuleEntry
from .network import Station
from .shapes import (
    AddressSet,
    AliasValue,
    Communication,
    DeviceInfo,
    DeviceList,
    DeviceName,
    Discovery,
    GsdFile,
    GsdPath,
    Identify,
    IoData,
    IoDataOf,
    NameSet,
    Reachable,
    RecordData,
    RecordOf,
    SetIp,
    SetName,
    Signalled,
    StationData,
    Stations,
    Status,
    WriteAlias,
    WriteIo,
    WriteRecord,
)
from .wire import IP, NAME, SIGNAL

__all__ = ["Tools"]

_LARGEST_FILE = 5_000_000
_SIGNAL_S = 3
"""Seconds for which a station shows itself after one Signal."""
_NAME = re.compile(r"(?=.{1,240}$)[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?(\.[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?)*")
_HELD = re.compile(
    r"(?P<slot>\d+)\.(?P<subslot>\d+)\.(?:output|record\.(?P<index>\d+))(?:\.(?P<at>\d+))?(?::(?P<kind>\w+))?"
)
"""A byte, or a value of a type, of the outputs or of a record: the second part of the name of a target."""
_NO_NAME = re.compile(r"port-\d{3}.*|\d+\.\d+\.\d+\.\d+")


class Tools:
    """The tools over one controller.

    Args:
        controller: the controller.
        aliases: the alias map.
        station: whose answer a ping waits for; None for any.
        discovery_s: seconds for which stations are waited for.
        gsd_folder: where GSDML files are; None where there are none.
    """

    def __init__(
        self,
        controller: Controller,
        *,
        aliases: Mapping[str, Alias],
        station: str | None,
        discovery_s: float,
        gsd_folder: Path | None,
    ) -> None:
        self._controller = controller
        self._aliases = NameMap(aliases, kind="alias", argument="alias", listed_by="list_devices")
        self._station = station
        self._discovery_s = discovery_s
        self._gsd_folder = gsd_folder
        self._signals: set[asyncio.Task[None]] = set()

    # -- finding ----------------------------------------------------------------------------------------------

    @tool("profinet.ping")
    async def ping(self, call: Call, arguments: Nothing) -> Reachable:
        """Confirm that the configured station answers an Identify; without one, that any does."""
        if self._station is None:
            found = await self._controller.any_station(call)
        else:
            found = await self._controller.station(call, self._station, fresh=True)
        return {"reachable": True, "device_name": device_text(call, "/data/device_name", found.name)}

    @tool("profinet.discover")
    async def discover_devices(self, call: Call, arguments: Discovery) -> Stations:
        """Find the stations of the network (DCP Identify to all). An empty list means that none answered in time."""
        wait_s = self._discovery_s if arguments.timeout is None else arguments.timeout
        found = sorted(await self._controller.discover(call, wait_s), key=lambda one: one.name)
        return {"devices": [_told(call, f"/data/devices/{number}", one) for number, one in enumerate(found)]}

    @tool("profinet.get_device_info")
    async def get_device_info(self, call: Call, arguments: DeviceName) -> DeviceInfo:
        """Ask a station who it is: its addresses (DCP Identify), and its order number, serial number and revisions (I&M0)."""
        station = await self._controller.station(call, arguments.device_name, fresh=True)
        body = await self._controller.identification(call, arguments.device_name)
        return {
            **_told(call, "/data", station),
            "order_id": device_text(call, "/data/order_id", body[2:22].strip()),
            "serial_number": device_text(call, "/data/serial_number", body[22:38].strip()),
            "hardware_revision": int.from_bytes(body[38:40]),
            "software_revision": f"{chr(body[40]) if 32 < body[40] < 127 else '?'}{body[41]}.{body[42]}.{body[43]}",
        }

    @tool("profinet.identify")
    async def identify_device(self, call: Call, arguments: Identify) -> Signalled:
        """Let a station show itself, by a blinking light, for some seconds (DCP Signal). It goes on while the next call is made."""
        mac = _mac(arguments.device_mac)
        await self._controller.set(call, mac, SIGNAL, b"\0\0\1\0", changes=False)
        if arguments.duration_s > _SIGNAL_S:
            task = asyncio.create_task(self._signal(mac, arguments.duration_s - _SIGNAL_S), name="signal")
            self._signals.add(task)
            task.add_done_callback(self._signals.discard)
        return {"device_mac": arguments.device_mac, "duration_s": arguments.duration_s}

    async def _signal(self, mac: bytes, seconds: int) -> None:
        for _ in range(0, seconds, _SIGNAL_S):
            await asyncio.sleep(_SIGNAL_S)
            again = Call(protocol="", operation="", endpoint="", writes=False)
            with contextlib.suppress(AdapterError):
                await self._controller.set(again, mac, SIGNAL, b"\0\0\1\0", changes=False)

    @tool("profinet.list_devices")
    async def list_devices(self, call: Call, arguments: Nothing) -> DeviceList:
        """List the device map and the alias map. Asks the network nothing."""
        devices = [
            {
                "device_name": name,
                "vendor_id": f"{one.vendor_id:04X}",
                "device_id": f"{one.device_id:04X}",
                "modules": [module.model_dump() for module in one.modules],
            }
            for name, one in sorted(self._controller.devices.items())
        ]
        return {
            "devices": devices,
            "aliases": [{"alias": name, **alias.model_dump()} for name, alias in sorted(self._aliases.items())],
        }

    @tool("profinet.load_gsd")
    async def load_gsd_file(self, call: Call, arguments: GsdPath) -> GsdFile:
        """Read what a GSDML file in the folder of GSDML files says of a device. Asks the network nothing, and changes no configuration."""
        file = await asyncio.to_thread(self._gsd, arguments.filepath)
        return {
            "vendor": device_text(call, "/data/vendor", file.vendor),
            "vendor_id": f"{file.vendor_id:04X}",
            "device_id": f"{file.device_id:04X}",
            "modules": [
                {
                    "name": device_text(call, f"/data/modules/{number}/name", one.name),
                    "module": f"{one.module:08X}",
                    "submodule": None if one.submodule is None else f"{one.submodule:08X}",
                    "inputs": one.inputs,
                    "outputs": one.outputs,
                }
                for number, one in enumerate(file.modules)
            ],
        }

    def _gsd(self, name: str) -> DeviceFile:
        if self._gsd_folder is None:
            raise AdapterError("config_error", "there is no folder of GSDML files; set PROFINET_GSD_FOLDER")
        folder = self._gsd_folder.resolve()
        try:
            path = (folder / name).resolve()
            if folder not in path.parents or not path.is_file():
                raise FileNotFoundError
            with path.open("rb") as file:
                content = file.read(_LARGEST_FILE + 1)
        except (OSError, ValueError):
            message = "the folder of GSDML files has no such file"
            raise AdapterError("illegal_address", message, field="/filepath") from None
        if len(content) > _LARGEST_FILE:
            raise AdapterError("limit_exceeded", f"a GSDML file has at most {_LARGEST_FILE} bytes", field="/filepath")
        try:
            return parse(content)
        except BadGsdml as fault:
            raise AdapterError("invalid_input", f"this is no GSDML file: {fault}", field="/filepath") from None

    # -- reading: nothing is driven -----------------------------------------------------------------------------

    @tool("profinet.read_inputs")
    async def read_io_data(self, call: Call, arguments: IoDataOf) -> IoData:
        """Read the inputs of a subslot (record 8028). Whoever is the controller stays so, and the outputs stay as they are."""
        place = arguments.slot, arguments.subslot
        call.trace |= {"service": "Read", "slot": place[0], "subslot": place[1], "index": 0x8028}
        content = await self._controller.inputs(call, arguments.device_name, place)
        wanted = len(content) if arguments.data_length is None else arguments.data_length
        if wanted > len(content):
            message = f"the subslot has {len(content)} bytes of inputs"
            raise AdapterError("limit_exceeded", message, field="/data_length")
        return _data(arguments, content[:wanted])

    @tool("profinet.read_record")
    async def read_record(self, call: Call, arguments: RecordOf) -> RecordData:
        """Read a record of a subslot."""
        place = arguments.slot, arguments.subslot
        call.trace |= {"service": "Read", "slot": place[0], "subslot": place[1], "index": arguments.index}
        content = await self._controller.read(call, arguments.device_name, place, arguments.index)
        return {**_data(arguments, content), "index": arguments.index}

    @tool("profinet.read_alias")
    async def read_device_by_alias(self, call: Call, arguments: AliasName) -> AliasValue:
        """Read the value that an alias stands for: of inputs, of the outputs that the device has now, or of a record."""
        alias = self._aliases.known(arguments.alias)
        place = alias.slot, alias.subslot
        if alias.area == "record":
            content = await self._controller.read(call, alias.device_name, place, alias.index)
            if len(content) != alias.end:
                message = f"the record has {len(content)} bytes, the alias {alias.end}"
                raise AdapterError("type_mismatch", message)
        else:
            read = self._controller.inputs if alias.area == "inputs" else self._controller.outputs
            content = await read(call, alias.device_name, place)
        return self._value(arguments.alias, alias, content[alias.offset : alias.end])

    @tool("profinet.status")
    async def get_connection_status(self, call: Call, arguments: Nothing) -> Status:
        """Tell what this controller does: which devices it has, and whether their outputs are kept alive. Asks the network nothing."""
        controller = self._controller
        return {
            "interface": controller.network.interface,
            "cycle_s": controller.cycle_s,
            "watchdog_s": controller.watchdog_s,
            "devices": [
                {"device_name": name, "state": one.state, "reason": one.reason}
                for name, one in sorted(controller.exchanges.items())
            ],
        }

    @tool("profinet.test_device")
    async def test_device_communication(self, call: Call, arguments: DeviceName) -> Communication:
        """Ask a device who it is (DCP Identify, I&M0), and compare that with the device map."""
        station = await self._controller.station(call, arguments.device_name, fresh=True)
        body = await self._controller.identification(call, arguments.device_name)
        known = self._controller.devices.get(arguments.device_name)
        return {
            "device_name": arguments.device_name,
            "vendor_id": f"{station.vendor:04X}",
            "device_id": f"{station.device:04X}",
            "order_id": device_text(call, "/data/order_id", body[2:22].strip()),
            "matches": None
            if known is None
            else (known.vendor_id, known.device_id) == (station.vendor, station.device),
        }

    # -- writing --------------------------------------------------------------------------------------------------

    @tool("profinet.write_outputs", writes=True)
    async def write_io_data(self, call: Call, arguments: WriteIo) -> IoData:
        """Give a subslot all its outputs, and keep them alive until this adapter ends. The adapter becomes the device's controller, if no
        other one is."""
        place = arguments.slot, arguments.subslot
        held = self._known_subslot(arguments.device_name, place)
        if len(arguments.data) != held.outputs:
            message = f"the subslot has {held.outputs} bytes of outputs; say all of them"
            bounds = {"min_length": held.outputs, "max_length": held.outputs}
            raise AdapterError("limit_exceeded", message, field="/data", allowed=bounds, outcome="not_sent")
        call.changes(*_targets(arguments, "output", arguments.data))
        content = await self._controller.drive(call, arguments.device_name, place, lambda _: bytes(arguments.data))
        return _data(arguments, content)

    @tool("profinet.write_record", writes=True)
    async def write_record(self, call: Call, arguments: WriteRecord) -> RecordData:
        """Write a whole record of a subslot, as a supervisor."""
        call.changes(*_targets(arguments, f"record.{arguments.index}", arguments.data))
        place = arguments.slot, arguments.subslot
        await self._controller.write(call, arguments.device_name, place, arguments.index, bytes(arguments.data))
        return {**_data(arguments, bytes(arguments.data)), "index": arguments.index}

    @tool("profinet.write_alias", writes=True)
    async def write_device_by_alias(self, call: Call, arguments: WriteAlias) -> AliasValue:
        """Write the value that an alias stands for: as write_record does, or as write_io_data does. Other outputs of the subslot stay as this
        controller has set them; those of a device that it has not driven yet are 0."""
        alias = self._aliases.writable(arguments.alias)
        content = encode(arguments.value, alias.data_type)
        place = alias.slot, alias.subslot
        area = f"record.{alias.index}" if alias.area == "record" else f"output.{alias.offset}"
        target = f"{alias.device_name}/{alias.slot}.{alias.subslot}.{area}:{alias.data_type}"
        call.changes((target, arguments.value))
        if alias.area == "record":
            await self._controller.write(call, alias.device_name, place, alias.index, content)
            return self._value(arguments.alias, alias, content)

        def changed(outputs: bytes) -> bytes:
            return outputs[: alias.offset] + content + outputs[alias.end :]

        held = await self._controller.drive(call, alias.device_name, place, changed)
        return self._value(arguments.alias, alias, held[alias.offset : alias.end])

    async def present(self, call: Call, target: str) -> object:
        """Return what a target of :meth:`Call.changes` holds; None for the name or the addresses of a station, which are no numbers."""
        where, _, held = target.partition("/")
        parts = _HELD.fullmatch(held)
        if parts is None:
            return None
        place = int(parts["slot"]), int(parts["subslot"])
        if parts["index"] is None:
            content = await self._controller.outputs(call, where, place)
        else:
            content = await self._controller.read(call, where, place, int(parts["index"]))
        at, kind = int(parts["at"] or 0), cast(DataType, parts["kind"] or "UINT8")
        if len(content) < at + width(kind):
            raise AdapterError("type_mismatch", f"there are {len(content)} bytes")
        return decode(content[at : at + width(kind)], kind)["value"]

    @tool("profinet.set_name", writes=True)
    async def set_device_name(self, call: Call, arguments: SetName) -> NameSet:
        """Give a station a name for good (DCP Set). Names are in lower case, as those of hosts are."""
        if not _NAME.fullmatch(arguments.name) or _NO_NAME.fullmatch(arguments.name):
            message = "no name of a station: labels of a-z, 0-9 and -, at most 63 each, between dots; no address and no port-NNN"
            raise AdapterError("invalid_input", message, field="/name", outcome="not_sent")
        call.changes((f"{arguments.device_mac.lower()}.name", None))
        mac = _mac(arguments.device_mac)
        await self._controller.set(call, mac, NAME, b"\0\1" + arguments.name.encode(), changes=True)
        return {"device_mac": arguments.device_mac, "name": arguments.name}

    @tool("profinet.set_ip", writes=True)
    async def set_device_ip(self, call: Call, arguments: SetIp) -> AddressSet:
        """Give a station addresses until it is switched off (DCP Set)."""
        given = {"ip_address": arguments.ip_address, "subnet_mask": arguments.subnet_mask, "gateway": arguments.gateway}
        packed = b""
        for name, text in given.items():
            try:
                packed += ipaddress.IPv4Address(text).packed
            except ValueError:
                raise AdapterError("invalid_input", "no IPv4 address", field=f"/{name}", outcome="not_sent") from None
        call.changes((f"{arguments.device_mac.lower()}.ip", None))
        await self._controller.set(call, _mac(arguments.device_mac), IP, b"\0\0" + packed, changes=True)
        return {
            "device_mac": arguments.device_mac,
            "ip_address": arguments.ip_address,
            "subnet_mask": arguments.subnet_mask,
            "gateway": arguments.gateway,
        }

    def _value(self, name: str, alias: Alias, content: bytes) -> AliasValue:
        told = decode(content, alias.data_type)
        return {"alias": name, "device_name": alias.device_name, "unit": alias.unit, **told}

    def _known_subslot(self, name: str, place: tuple[int, int]) -> ModuleEntry:
        device = self._controller.devices.get(name)
        held = None if device is None else device.subslots.get(place)
        if held is None:
            message = "the device map has no such subslot of such a device; list_devices lists them"
            raise AdapterError("illegal_address", message, field="/slot", outcome="not_sent")
        if not held.outputs:
            raise AdapterError("not_writable", "the subslot has no outputs", field="/slot", outcome="not_sent")
        return held


def _mac(text: str) -> bytes:
    return bytes.fromhex(text.replace(":", ""))


def _told(call: Call, pointer: str, station: Station) -> StationData:
    return {
        "device_name": device_text(call, f"{pointer}/device_name", station.name),
        "mac": station.mac.hex(":"),
        "ip_address": station.ip,
        "vendor": device_text(call, f"{pointer}/vendor", station.maker),
        "vendor_id": f"{station.vendor:04X}",
        "device_id": f"{station.device:04X}",
    }


def _data(arguments: Any, content: bytes) -> IoData:
    return {
        "device_name": arguments.device_name,
        "slot": arguments.slot,
        "subslot": arguments.subslot,
        "bytes": list(content),
    }


def _targets(arguments: Any, area: str, data: list[int]) -> list[tuple[str, object]]:
    place = f"{arguments.device_name}/{arguments.slot}.{arguments.subslot}.{area}"
    return [(f"{place}.{number}", byte) for number, byte in enumerate(data)]
