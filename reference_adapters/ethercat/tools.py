"""The fourteen tools of an EtherCAT master."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from ..core import AdapterError, AliasName, Call, NameMap, Nothing, device_text, tool
from .codec import DataType, Value, decode, encode, width
from .esi import BadEsi, parse
from .maps import Alias
from .segment import Segment
from .shapes import (
    AliasValue,
    Bytes,
    Communication,
    EsiFile,
    EsiPath,
    Identity,
    MasterStatus,
    Object,
    ObjectValue,
    Outputs,
    Reachable,
    ReadPdo,
    SetState,
    Slave,
    SlaveInfo,
    SlaveList,
    Slaves,
    SlaveState,
    WriteAlias,
    WriteObject,
    WritePdo,
)

__all__ = ["Tools"]

_LARGEST_FILE = 10_000_000
_WRITE_ONLY = "not_readable"


class Tools:
    """The tools over one line.

    Args:
        segment: the line.
        aliases: the alias map.
        esi_folder: where ESI files are; None where there are none.
    """

    def __init__(self, segment: Segment, *, aliases: Mapping[str, Alias], esi_folder: Path | None) -> None:
        self._segment = segment
        self._aliases = NameMap(aliases, kind="alias", argument="alias", listed_by="list_slaves")
        self._esi_folder = esi_folder
        self._kinds: dict[str, DataType] = {}
        """Types that objects were last written as, by target: no slave says them."""

    # -- finding ----------------------------------------------------------------------------------------------

    @tool("ethercat.ping")
    async def ping(self, call: Call, arguments: Nothing) -> Reachable:
        """Confirm that a slave of the line answers: asks one after the other for its state until one does."""
        found = await self._segment.ask(call, "ping")
        return {"reachable": True, "slave_position": found["position"], "state": found["state"]}

    @tool("ethercat.scan_network")
    async def scan_network(self, call: Call, arguments: Nothing) -> Slaves:
        """Find the slaves of the line and set them up to SAFEOP. While outputs are kept up, only the slaves that are known are asked."""
        driven = any(one["driven"] for one in (await self._segment.local("status"))["slaves"])
        found = await self._segment.ask(call, "scan")
        slaves = [
            {**_identity(call, one, f"/data/slaves/{number}"), "state": one["state"]}
            for number, one in enumerate(found)
        ]
        return cast(Slaves, {"slaves": slaves, "complete": not driven})

    @tool("ethercat.get_slave_info")
    async def get_slave_info(self, call: Call, arguments: Slave) -> SlaveInfo:
        """Read the state of a slave, with what its EEPROM says of it."""
        found = await self._segment.ask(call, "info", position=arguments.slave_position)
        return {
            **_identity(call, found, "/data"),
            "state": found["state"],
            "al_status": found["al_status"],
            "driven": found["driven"],
        }

    @tool("ethercat.list_slaves")
    async def list_slaves(self, call: Call, arguments: Nothing) -> SlaveList:
        """List the slaves that were found last, and the alias map. Asks the line nothing."""
        found = await self._segment.local("known")
        return {
            "slaves": [_identity(call, one, f"/data/slaves/{number}") for number, one in enumerate(found)],
            "aliases": [{"alias": name, **alias.model_dump()} for name, alias in sorted(self._aliases.items())],
        }

    @tool("ethercat.test_slave")
    async def test_slave_communication(self, call: Call, arguments: Slave) -> Communication:
        """Ask a slave for its state and for the identity in its dictionary (object 1018), and compare that with its EEPROM."""
        position = arguments.slave_position
        found = await self._segment.ask(call, "info", position=position)
        vendor, product = [
            int.from_bytes(
                bytes.fromhex(await self._segment.ask(call, "upload", position=position, index=0x1018, subindex=sub)),
                "little",
            )
            for sub in (1, 2)
        ]
        return {
            "slave_position": position,
            "state": found["state"],
            "vendor_id": vendor,
            "product_code": product,
            "matches": (vendor, product) == (found["vendor"], found["product"]),
        }

    @tool("ethercat.load_esi")
    async def load_esi_file(self, call: Call, arguments: EsiPath) -> EsiFile:
        """Read what an ESI file in the folder of ESI files says of its devices. Asks the line nothing, and changes no configuration."""
        found = await asyncio.to_thread(self._esi, arguments.filepath)
        if found["vendor"] is not None:
            found["vendor"] = device_text(call, "/data/vendor", found["vendor"])
        for number, device in enumerate(found["devices"]):
            if device["type"] is not None:
                device["type"] = device_text(call, f"/data/devices/{number}/type", device["type"])
        return cast(EsiFile, found)

    def _esi(self, name: str) -> dict[str, Any]:
        if self._esi_folder is None:
            raise AdapterError("config_error", "there is no folder of ESI files; set ETHERCAT_ESI_FOLDER")
        folder = self._esi_folder.resolve()
        try:
            path = (folder / name).resolve()
            if folder not in path.parents or not path.is_file():
                raise FileNotFoundError
            with path.open("rb") as file:
                content = file.read(_LARGEST_FILE + 1)
        except (OSError, ValueError):
            message = "the folder of ESI files has no such file"
            raise AdapterError("illegal_address", message, field="/filepath") from None
        if len(content) > _LARGEST_FILE:
            raise AdapterError("limit_exceeded", f"an ESI file has at most {_LARGEST_FILE} bytes", field="/filepath")
        try:
            return parse(content)
        except BadEsi as fault:
            raise AdapterError("invalid_input", f"this is no ESI file: {fault}", field="/filepath") from None

    # -- reading: nothing is driven -----------------------------------------------------------------------------

    @tool("ethercat.read_pdo")
    async def read_pdo(self, call: Call, arguments: ReadPdo) -> Bytes:
        """Read the inputs of a slave out of its memory. No outputs are sent for it, and its state stays as it is."""
        content = bytes.fromhex(await self._segment.ask(call, "inputs", position=arguments.slave_position))
        end = len(content) if arguments.length is None else arguments.offset + arguments.length
        if arguments.offset >= len(content) or end > len(content):
            message = f"the slave has {len(content)} bytes of inputs"
            raise AdapterError("limit_exceeded", message, field="/offset" if arguments.length is None else "/length")
        return {
            "slave_position": arguments.slave_position,
            "offset": arguments.offset,
            "bytes": list(content[arguments.offset : end]),
        }

    @tool("ethercat.read_sdo")
    async def read_sdo(self, call: Call, arguments: Object) -> ObjectValue:
        """Read an object of a slave's dictionary (SDO upload)."""
        return await self._object(call, arguments, arguments.data_type)

    @tool("ethercat.read_alias")
    async def read_slave_by_alias(self, call: Call, arguments: AliasName) -> AliasValue:
        """Read the value that an alias stands for: of an object, of inputs, or of the outputs that this master keeps up."""
        alias = self._aliases.known(arguments.alias)
        return self._named(call, arguments.alias, alias, await self._read(call, alias))

    @tool("ethercat.master_status")
    async def get_master_status(self, call: Call, arguments: Nothing) -> MasterStatus:
        """Tell what this master does: which slaves it drives, and with which outputs. Asks the line nothing."""
        return cast(MasterStatus, await self._segment.local("status"))

    async def _read(self, call: Call, alias: Alias) -> bytes:
        position = alias.slave_position
        if alias.index is not None:
            found = await self._segment.ask(
                call, "upload", position=position, index=alias.index, subindex=alias.subindex
            )
            return bytes.fromhex(found)
        assert alias.area is not None
        content = bytes.fromhex(await self._segment.ask(call, alias.area, position=position))
        return content[alias.offset : alias.end]

    def _named(self, call: Call, name: str, alias: Alias, content: bytes) -> AliasValue:
        value = _told(call, decode(content, alias.data_type))
        return {"alias": name, "slave_position": alias.slave_position, "unit": alias.unit, **value}

    async def _object(self, call: Call, place: Object | Alias, kind: DataType) -> ObjectValue:
        assert place.index is not None
        where: dict[str, Any] = {"position": place.slave_position, "index": place.index, "subindex": place.subindex}
        content = bytes.fromhex(await self._segment.ask(call, "upload", **where))
        value = _told(call, decode(content, kind))
        return {"slave_position": place.slave_position, "index": place.index, "subindex": place.subindex, **value}

    # -- writing ------------------------------------------------------------------------------------------------

    @tool("ethercat.write_sdo", writes=True)
    async def write_sdo(self, call: Call, arguments: WriteObject) -> ObjectValue:
        """Write an object of a slave's dictionary (SDO download), once, and read it back."""
        content = encode(arguments.value, arguments.data_type)
        held = await self._download(call, arguments, arguments.data_type, arguments.value, content)
        value = _told(call, decode(held, arguments.data_type))
        return {
            "slave_position": arguments.slave_position,
            "index": arguments.index,
            "subindex": arguments.subindex,
            **value,
        }

    async def _download(
        self, call: Call, place: Object | Alias, kind: DataType, value: object, content: bytes
    ) -> bytes:
        assert place.index is not None
        where: dict[str, Any] = {"position": place.slave_position, "index": place.index, "subindex": place.subindex}
        number = value if isinstance(value, int | float) and not isinstance(value, bool) else None
        target = f"{place.slave_position}:{place.index:04x}:{place.subindex}"
        self._kinds[target] = kind
        call.changes((target, number))
        await self._segment.ask(call, "download", changes=True, data=content.hex(), **where)
        try:
            held = bytes.fromhex(await self._segment.ask(call, "upload", **where))
        except AdapterError as error:
            if error.code == _WRITE_ONLY:
                return content
            message = f"the slave has taken the value, but the one that it has could not be read: {error.message}"
            raise AdapterError(error.code, message, outcome="unknown") from None
        if held != content and (kind != "STRING" or held.rstrip(b"\0") != content):
            raise AdapterError("verify_failed", "the slave has taken the value, and has another", outcome="applied")
        return held

    @tool("ethercat.write_pdo", writes=True)
    async def write_pdo(self, call: Call, arguments: WritePdo) -> Outputs:
        """Give a slave outputs, and keep them up until this adapter ends. A slave that is not in OP is taken there before; its other
        outputs are 0 then."""
        info = await self._segment.ask(call, "info", position=arguments.slave_position)
        size, offset = info["output_length"], arguments.offset
        if not size:
            raise AdapterError("not_writable", "the slave has no outputs", field="/slave_position", outcome="not_sent")
        wrong = len(arguments.data) != size if offset is None else offset + len(arguments.data) > size
        if wrong:
            message = f"the slave has {size} bytes of outputs; say all of them, or an offset"
            bounds = {"max_length": size}
            raise AdapterError("limit_exceeded", message, field="/data", allowed=bounds, outcome="not_sent")
        place = f"{arguments.slave_position}.output"
        call.changes(*((f"{place}.{at}", byte) for at, byte in enumerate(arguments.data, start=offset or 0)))
        return await self._drive(call, arguments.slave_position, bytes(arguments.data), offset)

    async def _drive(self, call: Call, position: int, data: bytes, offset: int | None) -> Outputs:
        held = await self._segment.ask(call, "drive", changes=True, position=position, data=data.hex(), offset=offset)
        return {
            "slave_position": position,
            "bytes": list(bytes.fromhex(held)),
            "watchdog_s": self._segment.watchdog_s,
        }

    @tool("ethercat.write_alias", writes=True)
    async def write_slave_by_alias(self, call: Call, arguments: WriteAlias) -> AliasValue:
        """Write the value that an alias stands for, as write_sdo or write_pdo do."""
        alias = self._aliases.writable(arguments.alias)
        content = encode(arguments.value, alias.data_type)
        if alias.index is not None:
            held = await self._download(call, alias, alias.data_type, arguments.value, content)
        else:
            call.changes((f"{alias.slave_position}.output.{alias.offset}:{alias.data_type}", arguments.value))
            outputs = await self._drive(call, alias.slave_position, content, alias.offset)
            held = bytes(outputs["bytes"][alias.offset : alias.end])
        return self._named(call, arguments.alias, alias, held)

    async def present(self, call: Call, target: str) -> object:
        """Return what a target of :meth:`Call.changes` holds; None for a state, which is no number."""
        if target in self._kinds:
            position, index, subindex = target.split(":")
            where: dict[str, Any] = {"position": int(position), "index": int(index, 16), "subindex": int(subindex)}
            content = bytes.fromhex(await self._segment.ask(call, "upload", **where))
            return decode(content, self._kinds[target])["value"]
        position, _, place = target.partition(".output.")
        if not place:
            return None
        at, _, kind = place.partition(":")
        known = cast(DataType, kind or "UINT8")
        outputs = bytes.fromhex(await self._segment.ask(call, "outputs", position=int(position)))
        return decode(outputs[int(at) : int(at) + width(known)], known)["value"]

    @tool("ethercat.set_state", writes=True)
    async def set_slave_state(self, call: Call, arguments: SetState) -> SlaveState:
        """Take a slave to another state. A slave that leaves OP clears its outputs."""
        position = arguments.slave_position
        call.changes((f"{position}.state", None))
        await self._segment.ask(call, "set_state", changes=True, position=position, state=arguments.state)
        return {"slave_position": position, "state": arguments.state}


def _identity(call: Call, found: Mapping[str, Any], at: str) -> Identity:
    return {
        "slave_position": found["position"],
        "name": device_text(call, f"{at}/name", found["name"]),
        "vendor_id": found["vendor"],
        "product_code": found["product"],
        "revision": found["revision"],
        "input_length": found["input_length"],
        "output_length": found["output_length"],
    }


def _told(call: Call, value: Value) -> Value:
    """Return a value with a text of the slave's made safe, and marked as the slave's."""
    if isinstance(value["value"], str) and value["type"] == "STRING":
        value["value"] = device_text(call, "/data/value", value["value"])
    return value
