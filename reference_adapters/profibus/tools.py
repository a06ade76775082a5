"""The eleven tools of a PROFIBUS DP master."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from pathlib import Path

from ..core import AdapterError, AliasName, Call, NameMap, Nothing, device_text, tool
from ..core.process_data import decode, encode
from .diagnosis import NO_MASTER, Diagnosis
from .gsd import BadGsd, DeviceFile, parse
from .maps import Alias, Slave
from .master import Master
from .shapes import (
    AliasValue,
    Communication,
    DiagnosisData,
    GsdFile,
    GsdPath,
    Inputs,
    InputsOf,
    MasterStatus,
    Outputs,
    Reachable,
    Scan,
    SlaveAddress,
    SlaveList,
    Station,
    Stations,
    StationType,
    WriteAlias,
    WriteOutputs,
)

__all__ = ["Tools"]

_STATION_TYPES: tuple[StationType, ...] = ("slave", "master_not_ready", "master_ready", "master_in_ring")
_LARGEST_FILE = 1_000_000
_LAST_ADDRESS = 125


class Tools:
    """The tools over one master.

    Args:
        master: the master.
        aliases: the alias map.
        slot_s: seconds for which a scan waits at each address.
        baud: bits per second of the line.
        gsd_folder: where GSD files are; None where there are none.
    """

    def __init__(
        self, master: Master, *, aliases: Mapping[str, Alias], slot_s: float, baud: int, gsd_folder: Path | None
    ) -> None:
        self._master = master
        self._aliases = NameMap(aliases, kind="alias", argument="alias", listed_by="list_slaves")
        self._slot_s = slot_s
        self._baud = baud
        self._gsd_folder = gsd_folder

    # -- finding ----------------------------------------------------------------------------------------------

    @tool("profibus.ping")
    async def ping(self, call: Call, arguments: Nothing) -> Reachable:
        """Confirm that a station of the line answers: asks the slaves of the slave map for their FDL status, one after the other, until one
        answers; without a slave map, every address."""
        wait_s = self._master.line.timeout_s if self._master.slaves else self._slot_s
        for address in self._master.slaves or range(_LAST_ADDRESS + 1):
            found = await self._ask(call, address, wait_s)
            if found:
                return {"reachable": True, "slave_address": found[-1]["address"]}
        raise AdapterError("timeout", "no station of the line answers; is it on, and is the baud rate right?")

    @tool("profibus.scan_bus")
    async def scan_bus(self, call: Call, arguments: Scan) -> Stations:
        """Find the stations of the line: asks every address for its FDL status, waiting the slot time at each that is silent. An empty list
        means that none answered."""
        found: dict[int, Station] = {}
        for address in range(arguments.first_address, arguments.last_address + 1):
            found |= {one["address"]: one for one in await self._ask(call, address, self._slot_s)}
        return {"stations": [found[address] for address in sorted(found)]}

    async def _ask(self, call: Call, address: int, wait_s: float) -> list[Station]:
        line = self._master.line
        if address == line.address:
            return []
        answers = await line.ask_status(call, address, wait_s, after_another=call.attempts > 0)
        return [{"address": one.source or 0, "type": _STATION_TYPES[one.control >> 4 & 3]} for one in answers]

    @tool("profibus.list_slaves")
    async def list_slaves(self, call: Call, arguments: Nothing) -> SlaveList:
        """List the slave map and the alias map. Asks the line nothing."""
        slaves = [
            {
                "slave_address": address,
                "name": slave.name,
                "ident": f"{slave.ident:04X}",
                "cfg": slave.cfg.hex(" "),
                "input_length": slave.input_length,
                "output_length": slave.output_length,
            }
            for address, slave in sorted(self._master.slaves.items())
        ]
        return {
            "slaves": slaves,
            "aliases": [{"alias": name, **alias.model_dump()} for name, alias in sorted(self._aliases.items())],
        }

    @tool("profibus.load_gsd")
    async def load_gsd_file(self, call: Call, arguments: GsdPath) -> GsdFile:
        """Read what a GSD file in the folder of GSD files says of a device. Asks the line nothing, and changes no configuration."""
        file = await asyncio.to_thread(self._gsd, arguments.filepath)
        ident = file.number("Ident_Number")

        def text(member: str, keyword: str) -> str | None:
            found = file.text(keyword)
            return None if found is None else device_text(call, f"/data/{member}", found)

        return {
            "vendor": text("vendor", "Vendor_Name"),
            "model": text("model", "Model_Name"),
            "revision": text("revision", "Revision"),
            "ident": None if ident is None else f"{ident:04X}",
            "max_input_length": file.number("Max_Input_Len"),
            "max_output_length": file.number("Max_Output_Len"),
            "baud_rates": file.baud_rates,
            "modules": [
                {"name": device_text(call, f"/data/modules/{number}/name", module.name), "cfg": module.cfg.hex(" ")}
                for number, module in enumerate(file.modules)
            ],
        }

    def _gsd(self, name: str) -> DeviceFile:
        if self._gsd_folder is None:
            message = "there is no folder of GSD files; set PROFIBUS_GSD_FOLDER"
            raise AdapterError("config_error", message)
        folder = self._gsd_folder.resolve()
        try:
            path = (folder / name).resolve()
            if folder not in path.parents or not path.is_file():
                raise FileNotFoundError
            with path.open("rb") as file:
                content = file.read(_LARGEST_FILE + 1)
        except (OSError, ValueError):
            message = "the folder of GSD files has no such file"
            raise AdapterError("illegal_address", message, field="/filepath") from None
        if len(content) > _LARGEST_FILE:
            raise AdapterError("limit_exceeded", f"a GSD file has at most {_LARGEST_FILE} bytes", field="/filepath")
        try:
            return parse(content.decode("latin-1"))
        except BadGsd as fault:
            raise AdapterError("invalid_input", f"this is no GSD file: {fault}", field="/filepath") from None

    # -- reading: class 2, nothing is driven --------------------------------------------------------------------

    @tool("profibus.read_inputs")
    async def read_inputs(self, call: Call, arguments: InputsOf) -> Inputs:
        """Read the inputs of a slave (RD_Inp). Whoever is its master stays so, and its outputs stay as they are."""
        content = await self._master.inputs(call, arguments.slave_address)
        wanted = len(content) if arguments.length is None else arguments.length
        if wanted > len(content):
            message = f"the slave has {len(content)} bytes of inputs"
            raise AdapterError("limit_exceeded", message, field="/length")
        return {"slave_address": arguments.slave_address, "bytes": list(content[:wanted])}

    @tool("profibus.read_diagnosis")
    async def read_diagnosis(self, call: Call, arguments: SlaveAddress) -> DiagnosisData:
        """Read what a slave says of itself (Slave_Diag), in the standard's names."""
        found = await self._master.diagnosis(call, arguments.slave_address)
        return {
            "slave_address": arguments.slave_address,
            "status": list(found.status),
            "master": _master_of(found),
            "ident": f"{found.ident:04X}",
            "extended": found.extended.hex(),
        }

    @tool("profibus.test_slave")
    async def test_slave_communication(self, call: Call, arguments: SlaveAddress) -> Communication:
        """Ask a slave for its diagnosis and its configuration (Slave_Diag, Get_Cfg), and compare them with the slave map."""
        address = arguments.slave_address
        found = await self._master.diagnosis(call, address)
        cfg = await self._master.configuration(call, address)
        slave = self._master.slaves.get(address)
        return {
            "slave_address": address,
            "status": list(found.status),
            "master": _master_of(found),
            "ident": f"{found.ident:04X}",
            "cfg": cfg.hex(" "),
            "matches": None if slave is None else (found.ident, cfg) == (slave.ident, slave.cfg),
        }

    @tool("profibus.read_alias")
    async def read_slave_by_alias(self, call: Call, arguments: AliasName) -> AliasValue:
        """Read the value that an alias stands for: of inputs (RD_Inp), or of the outputs that the slave has now (RD_Outp)."""
        alias = self._aliases.known(arguments.alias)
        read = self._master.inputs if alias.area == "inputs" else self._master.outputs
        content = await read(call, alias.slave_address)
        return {
            "alias": arguments.alias,
            "slave_address": alias.slave_address,
            "unit": alias.unit,
            **decode(content[alias.offset : alias.end], alias.data_type),
        }

    @tool("profibus.master_status")
    async def get_master_status(self, call: Call, arguments: Nothing) -> MasterStatus:
        """Tell what this master does: which slaves it has parameterised, and whether their outputs are kept alive. Asks the line nothing."""
        master = self._master
        return {
            "master_address": master.line.address,
            "baud": self._baud,
            "cycle_s": master.cycle_s,
            "watchdog_s": master.watchdog_s,
            "slaves": [
                {
                    "slave_address": address,
                    "state": exchange.state,
                    "outputs": list(exchange.outputs) if exchange.state == "data_exchange" else None,
                    "reason": exchange.reason,
                }
                for address, exchange in sorted(master.exchanges.items())
            ],
        }

    # -- writing: class 1, the slave is driven ------------------------------------------------------------------

    @tool("profibus.write_outputs", writes=True)
    async def write_outputs(self, call: Call, arguments: WriteOutputs) -> Outputs:
        """Give a slave all its outputs, and keep them alive until this adapter ends. A slave that no master has is parameterised and
        configured before (Set_Prm, Chk_Cfg)."""
        slave = self._known_slave(arguments.slave_address)
        if len(arguments.data) != slave.output_length:
            # A slave that gets another number of bytes leaves data exchange, and its outputs fall.
            message = f"the slave has {slave.output_length} bytes of outputs; say all of them"
            bounds = {"min_length": slave.output_length, "max_length": slave.output_length}
            raise AdapterError("limit_exceeded", message, field="/data", allowed=bounds, outcome="not_sent")
        outputs = f"{arguments.slave_address}.output"
        call.changes(*((f"{outputs}.{place}", byte) for place, byte in enumerate(arguments.data)))
        return await self._written(call, arguments.slave_address, lambda _: bytes(arguments.data))

    @tool("profibus.write_alias", writes=True)
    async def write_slave_by_alias(self, call: Call, arguments: WriteAlias) -> AliasValue:
        """Write the value that an alias stands for, as write_outputs does. The slave's other outputs stay as this master has set them; those
        of a slave that it has not driven yet are 0."""
        alias = self._aliases.writable(arguments.alias)
        content = encode(arguments.value, alias.data_type)
        call.changes((f"{alias.slave_address}.output.{alias.offset}:{alias.data_type}", arguments.value))

        def changed(outputs: bytes) -> bytes:
            return outputs[: alias.offset] + content + outputs[alias.end :]

        held = await self._written(call, alias.slave_address, changed)
        return {
            "alias": arguments.alias,
            "slave_address": alias.slave_address,
            "unit": alias.unit,
            **decode(bytes(held["bytes"][alias.offset : alias.end]), alias.data_type),
        }

    async def _written(self, call: Call, address: int, change: Callable[[bytes], bytes]) -> Outputs:
        held = await self._master.write(call, address, change)
        return {"slave_address": address, "bytes": list(held), "watchdog_s": self._master.watchdog_s}

    def _known_slave(self, address: int) -> Slave:
        slave = self._master.slaves.get(address)
        if slave is None:
            message = "the slave map has no such slave; list_slaves lists them"
            raise AdapterError("illegal_address", message, field="/slave_address", outcome="not_sent")
        if not slave.output_length:
            raise AdapterError("not_writable", "the slave has no outputs", field="/slave_address", outcome="not_sent")
        return slave


def _master_of(found: Diagnosis) -> int | None:
    return None if found.master == NO_MASTER else found.master
