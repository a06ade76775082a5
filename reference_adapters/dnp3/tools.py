"""The eight DNP3 tools. Points have the standard's names and flags."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from dnp3.core.enums import FunctionCode
from dnp3.core.flags import IIN

from ..core import AdapterError, AliasName, BadReply, Call, NameMap, Nothing, device_text, tool
from .aliases import Alias
from .commands import ANALOG_VARIATIONS, AnalogType, binary_command, echoed_status, octets_written
from .connection import Response
from .conversions import command_for, entry, exactly, holds, shown, text
from .link import Link
from .objects import Point, range_request
from .refusals import command_refused, status_name
from .shapes import (
    AliasList,
    AliasValue,
    AliasWritten,
    PointRange,
    Points,
    PollClass,
    Polled,
    Reachable,
    WriteAlias,
    WriteBinaryOutput,
    Written,
)

__all__ = ["Tools"]

# Group and variation that a read asks for. Variation 0 lets the outstation choose: asking it for whole numbers would cut fractions off.
# Binary points are asked for with flags, since packed bits have none.
_STATIC = {
    "binary_input": (1, 2),
    "binary_output": (10, 2),
    "counter": (20, 0),
    "analog_input": (30, 0),
    "analog_output": (40, 0),
    "octet_string": (110, 0),
}
_CLASS_DATA = 60
_NO_STATE = ("illegal_address", "unsupported_operation")


class Tools:
    """The tools over one connection.

    Args:
        link: the way to the outstations.
        outstation: link address of the one that ``ping`` asks.
        aliases: the alias map.
        direct_operate: outputs may be operated without being selected before.
    """

    def __init__(self, link: Link, *, outstation: int, aliases: Mapping[str, Alias], direct_operate: bool) -> None:
        self._link = link
        self._outstation = outstation
        self._aliases = NameMap(aliases, kind="alias", argument="alias", listed_by="list_points")
        self._direct_operate = direct_operate

    # -- reading ------------------------------------------------------------------------------------------

    @tool("dnp3.ping")
    async def ping(self, call: Call, arguments: Nothing) -> Reachable:
        """Confirm that the configured outstation answers: asks its data link layer for the status."""
        await self._link.status(call, self._outstation)
        return {"reachable": True, "outstation_address": self._outstation}

    @tool("dnp3.read_binary")
    async def read_binary_inputs(self, call: Call, arguments: PointRange) -> Points:
        """Read binary inputs with their flags. A point that the outstation does not vouch for makes the call a failure that tells all."""
        return await self._read_range(call, "binary_input", arguments)

    @tool("dnp3.read_analog")
    async def read_analog_inputs(self, call: Call, arguments: PointRange) -> Points:
        """Read analog inputs with their flags. A point that the outstation does not vouch for makes the call a failure that tells all."""
        return await self._read_range(call, "analog_input", arguments)

    @tool("dnp3.poll", idempotent=False)
    async def poll_class(self, call: Call, arguments: PollClass) -> Polled:
        """Ask for the events of a class, or with class 0 for the present values of all points, and confirm them: the outstation forgets
        events that have been confirmed. Points that it does not vouch for are among them, see their flags."""
        outstation = arguments.outstation_address
        asked = bytes([_CLASS_DATA, arguments.event_class + 1, 0x06])
        response = await self._link.ask(call, outstation, FunctionCode.READ, asked)
        return {
            "outstation_address": outstation,
            "event_class": arguments.event_class,
            "points": [shown(point) for point in response.points],
            "unsolicited": [shown(point) for point in self._link.kept(outstation)],
            "overflow": bool(response.indications & IIN.EVENT_BUFFER_OVERFLOW),
        }

    @tool("dnp3.list_points")
    async def list_points(self, call: Call, arguments: Nothing) -> AliasList:
        """List the alias map: names, points and units. Asks no outstation."""
        return {"points": [entry(name, alias) for name, alias in sorted(self._aliases.items())]}

    @tool("dnp3.read_alias")
    async def read_point_by_alias(self, call: Call, arguments: AliasName) -> AliasValue:
        """Read the point that an alias of the alias map stands for."""
        alias = self._aliases.known(arguments.alias)
        response = await self._ask(
            call, alias.outstation_address, alias.point_type, alias.index, data_type=alias.data_type
        )
        (point,) = exactly(response, alias.point_type, range(alias.index, alias.index + 1))
        told = shown(point)
        doubtful = not point.is_reliable or bool(response.indications & IIN.DEVICE_TROUBLE)
        if alias.point_type == "octet_string":
            told["value"] = device_text(call, "/data/partial/value" if doubtful else "/data/value", text(point))
        if doubtful:
            message = "the outstation does not vouch for the value; see its flags and the indications"
            raise AdapterError("bad_quality", message, partial=told)
        return {
            "alias": arguments.alias,
            "unit": alias.unit,
            "outstation_address": alias.outstation_address,
            **told,
        }

    async def _read_range(self, call: Call, kind: str, asked: PointRange) -> Points:
        response = await self._ask(call, asked.outstation_address, kind, asked.start_index, asked.count)
        points = exactly(response, kind, range(asked.start_index, asked.start_index + asked.count))
        told: Points = {
            "outstation_address": asked.outstation_address,
            "points": [shown(point) for point in points],
        }
        bad = [point.index for point in points if not point.is_reliable]
        if response.indications & IIN.DEVICE_TROUBLE or len(bad) == len(points):
            message = "the outstation does not vouch for the values; see data.partial and the indications"
            raise AdapterError("bad_quality", message, partial=told)
        if bad:
            message = f"the outstation does not vouch for {len(bad)} of {len(points)} points; see data.partial"
            raise AdapterError("partial_failure", message, partial=told, details={"indexes": bad})
        return told

    async def _ask(
        self,
        call: Call,
        outstation: int,
        kind: str,
        start: int,
        count: int = 1,
        *,
        data_type: AnalogType | None = None,
    ) -> Response:
        group, variation = _STATIC[kind]
        if data_type is not None:
            # An outstation may by itself tell as a whole number what was commanded as a fraction.
            variation = ANALOG_VARIATIONS[data_type]
        asked = range_request(group, variation, start, start + count - 1)
        return await self._link.ask(call, outstation, FunctionCode.READ, asked)

    # -- writing ------------------------------------------------------------------------------------------

    @tool("dnp3.write_binary", writes=True)
    async def write_binary_output(self, call: Call, arguments: WriteBinaryOutput) -> Written:
        """Switch a binary output: select it, operate it once, and read its status. A command that the outstation accepts and does not
        follow is a failure: verify_failed. mode direct_operate leaves the select out."""
        direct = arguments.mode == "direct_operate"
        if direct and not self._direct_operate:
            message = (
                "outputs are selected before they are operated; set DNP3_DIRECT_OPERATE_ENABLED=true to allow less"
            )
            raise AdapterError("writes_disabled", message, field="/mode", outcome="not_sent")
        code, index = arguments.control, arguments.index
        call.changes((f"{arguments.outstation_address}/binary_output/{index}", None))
        objects = binary_command(index, code, arguments.count, arguments.on_time_ms, arguments.off_time_ms)
        status = await self._operate(call, arguments.outstation_address, objects, direct=direct)
        state = None
        if code.startswith("latch"):
            found = await self._verified(
                call,
                arguments.outstation_address,
                "binary_output",
                index,
                lambda point: point.value is arguments.value,
            )
            state = None if found is None else bool(found.value)
        return {
            "outstation_address": arguments.outstation_address,
            "index": index,
            "value": arguments.value,
            "code": code,
            "mode": arguments.mode,
            "status": status_name(status),
            "state": state,
        }

    @tool("dnp3.write_alias", writes=True)
    async def write_point_by_alias(self, call: Call, arguments: WriteAlias) -> AliasWritten:
        """Write the point that an alias of the alias map stands for: an output is selected, operated once and read, an octet string
        written and read."""
        alias, value = self._aliases.writable(arguments.alias), arguments.value
        status = None
        place = f"{alias.outstation_address}/{alias.point_type}/{alias.index}"
        if alias.point_type == "octet_string":
            objects = octets_written(alias.index, value)
            call.changes((place, None))
            await self._link.command(
                call, alias.outstation_address, [(FunctionCode.WRITE, objects)], lambda response: None
            )
        else:
            objects = command_for(alias, value)
            call.changes((place, value))
            status = status_name(await self._operate(call, alias.outstation_address, objects))
        found = await self._verified(
            call,
            alias.outstation_address,
            alias.point_type,
            alias.index,
            holds(alias, objects, value),
            alias.data_type,
        )
        state = None
        if found is not None:
            state = device_text(call, "/data/state", text(found)) if alias.point_type == "octet_string" else found.value
        return {
            "alias": arguments.alias,
            "unit": alias.unit,
            "outstation_address": alias.outstation_address,
            "point_type": alias.point_type,
            "index": alias.index,
            "value": value,
            "status": status,
            "state": state,
        }

    async def present(self, call: Call, target: str) -> object:
        """Return what a target of :meth:`Call.changes` holds."""
        outstation, kind, index = target.split("/")
        response = await self._ask(call, int(outstation), kind, int(index))
        (point,) = exactly(response, kind, range(int(index), int(index) + 1))
        return point.value

    async def _operate(self, call: Call, outstation: int, objects: bytes, *, direct: bool = False) -> int:
        """Operate an output, after selecting it unless ``direct``; return the status, which is that of success."""
        functions = [FunctionCode.DIRECT_OPERATE] if direct else [FunctionCode.SELECT, FunctionCode.OPERATE]

        def check(response: Response) -> None:
            try:
                call.trace["status"] = status = echoed_status(objects, response.blocks)
            except BadReply as fault:
                message = f"the answer is not the one to the command: {fault}"
                raise AdapterError("protocol_error", message) from None
            if status:
                raise command_refused(call, status)

        await self._link.command(call, outstation, [(function, objects) for function in functions], check)
        status: int = call.trace["status"]
        return status

    async def _verified(
        self,
        call: Call,
        outstation: int,
        kind: str,
        index: int,
        holds: Callable[[Point], bool],
        data_type: AnalogType | None = None,
    ) -> Point | None:
        """Read a point after a command that the outstation says it has carried out; None where it has no such point to read."""
        of_command = dict(call.trace)
        try:
            response = await self._ask(call, outstation, kind, index, data_type=data_type)
            (point,) = exactly(response, kind, range(index, index + 1))
        except AdapterError as error:
            if error.code in _NO_STATE:
                _restore(call, of_command)
                return None
            message = f"the outstation has carried the command out, but its point could not be read: {error.message}"
            raise AdapterError(error.code, message, outcome="unknown") from None
        _restore(call, of_command)
        if not (point.is_reliable and holds(point)):
            message = "the outstation says that it has carried the command out, and its point tells something else"
            details = {"state": point.value, "flags": list(point.flags or ())}
            raise AdapterError("verify_failed", message, outcome="applied", details=details)
        return point


def _restore(call: Call, trace: Mapping[str, Any]) -> None:
    """Let the trace say again what the outstation said of the command, not of the read that followed."""
    call.trace.update({name: trace[name] for name in ("iin", "indications")})
