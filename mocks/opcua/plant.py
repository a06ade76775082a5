"""The address space of the plant and its dynamics: sensors, actuators, status, methods in one namespace.

Node identifiers are the browse names: ``ns=2;s=Temperature``.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from types import MappingProxyType
from typing import Any

from asyncua import Server, ua

from .values import finite, fits, variant

__all__ = ["NAMESPACE", "Method", "MethodRefusal", "Plant", "Variable"]

NAMESPACE = "urn:otmcp:plant"

SENSORS = {
    "Temperature": 25.0,
    "Pressure": 1.5,
    "FlowRate": 60.0,
    "TankLevel": 50.0,
    "Vibration": 1.0,
    "PhLevel": 7.0,
    "Humidity": 45.0,
    "MotorSpeed": 900.0,
}
ACTUATORS: dict[str, bool | float] = {
    "PumpEnabled": True,
    "ValvePosition": 50.0,
    "HeaterPower": 30.0,
    "FanSpeed": 40.0,
    "ConveyorSpeed": 60.0,
    "AlarmActive": False,
}
STATUS: dict[str, tuple[Any, ua.VariantType]] = {
    "Mode": ("RUNNING", ua.VariantType.String),
    "EmergencyStop": (False, ua.VariantType.Boolean),
    "ProductionCount": (0, ua.VariantType.UInt32),
    "ProductionRate": (100.0, ua.VariantType.Double),
    "Uptime": (0, ua.VariantType.UInt32),
    "BatchName": ("batch-1", ua.VariantType.String),
}

MAX_RATE = 1000.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Variable:
    """The fixed properties of a data variable.

    Attributes:
        start: its value when the plant starts.
        rank, dimensions: ValueRank and ArrayDimensions (OPC 10000-3, 5.6.2).
        range: lowest and highest number that a client may write; None for any.
    """

    browse_name: str
    parent: ua.NodeId
    kind: ua.VariantType
    start: ua.Variant
    writable: bool
    rank: int = -1
    dimensions: tuple[int, ...] = ()
    range: tuple[float | None, float | None] = (None, None)


@dataclass(frozen=True, slots=True, kw_only=True)
class Method:
    """A method: the object that it belongs to, its arguments by name with their types, and the function that performs it.
    The function takes the values of the inputs, returns those of the outputs and may raise :class:`MethodRefusal`."""

    owner: ua.NodeId
    inputs: Mapping[str, ua.VariantType]
    outputs: Mapping[str, ua.VariantType]
    function: Callable[..., Awaitable[list[Any]]]


class MethodRefusal(Exception):
    """The error for a method call that is answered with a Bad status and not performed."""

    def __init__(self, code: int, arguments: Sequence[int] = ()) -> None:
        super().__init__(code)
        self._code = code
        self._arguments = arguments

    def result(self) -> ua.CallMethodResult:
        """Return the answer to the client, with a status per argument if one is at fault (OPC 10000-4, 5.12.2.4)."""
        return ua.CallMethodResult(
            StatusCode=ua.StatusCode(self._code),
            InputArgumentResults=[ua.StatusCode(code) for code in self._arguments],
        )


class Plant:
    """The nodes of the plant and their values.

    Attributes:
        variables: the data variables by node id.
        folders: browse name to node id.
        methods: the methods by node id.
        calls: node id of a method to the number of times that it was performed.
    """

    def __init__(self, server: Server) -> None:
        self._server = server
        self.namespace = 0
        self.variables: dict[ua.NodeId, Variable] = {}
        self.folders: dict[str, ua.NodeId] = {}
        self.methods: dict[ua.NodeId, Method] = {}
        self.calls: dict[ua.NodeId, int] = {}
        self._produced = 0.0

    async def build(self) -> None:
        """Create all nodes."""
        self.namespace = await self._server.register_namespace(NAMESPACE)
        plant = await self._server.nodes.objects.add_folder(self._id("Plant"), self._name("Plant"))
        self.folders["Plant"] = plant.nodeid
        for name in ("Sensors", "Actuators", "Status", "Methods"):
            folder = await plant.add_folder(self._id(name), self._name(name))
            self.folders[name] = folder.nodeid
        for name, start in SENSORS.items():
            await self._variable("Sensors", name, ua.Variant(start, ua.VariantType.Double), writable=False)
        for name, value in ACTUATORS.items():
            kind = ua.VariantType.Boolean if isinstance(value, bool) else ua.VariantType.Double
            await self._variable("Actuators", name, ua.Variant(value, kind), writable=True)
        for name, (value, kind) in STATUS.items():
            await self._variable("Status", name, ua.Variant(value, kind), writable=False)
        double = ua.VariantType.Double
        await self._method("StartProduction", self._start_production)
        await self._method("StopProduction", self._stop_production)
        await self._method("TriggerEmergencyStop", self._emergency_stop)
        await self._method("ResetAlarms", self._reset_alarms)
        await self._method("SetProductionRate", self._set_rate, {"Rate": double}, {"PreviousRate": double})

    def _id(self, name: str) -> ua.NodeId:
        return ua.NodeId(name, self.namespace)

    def _name(self, name: str) -> ua.QualifiedName:
        return ua.QualifiedName(name, self.namespace)

    async def _variable(self, folder: str, name: str, value: ua.Variant, *, writable: bool) -> None:
        parent = self._server.get_node(self.folders[folder])
        node = await parent.add_variable(self._id(name), self._name(name), value)
        if writable:
            await node.set_writable()
        self.variables[node.nodeid] = Variable(
            browse_name=name, parent=parent.nodeid, kind=value.VariantType, start=value, writable=writable
        )

    async def _method(
        self,
        name: str,
        function: Callable[..., Awaitable[list[Any]]],
        inputs: Mapping[str, ua.VariantType] = MappingProxyType({}),
        outputs: Mapping[str, ua.VariantType] = MappingProxyType({}),
    ) -> None:
        method = Method(owner=self.folders["Methods"], inputs=inputs, outputs=outputs, function=function)
        await self.add_method(self._id(name), self._name(name), method)

    async def add_method(self, node: ua.NodeId, name: ua.QualifiedName, method: Method) -> ua.NodeId:
        """Create the node of a method. Sessions perform the method themselves; the library never does."""
        parent = self._server.get_node(method.owner)
        await parent.add_method(node, name, _never, _arguments(method.inputs), _arguments(method.outputs))
        self.methods[node] = method
        self.calls[node] = 0
        return node

    # -- values -------------------------------------------------------------------------------------------

    def node(self, name: str) -> ua.NodeId:
        """Return the data variable with this browse name or node id.

        Raises:
            ValueError: there is no such variable.
        """
        node = self._id(name)
        if node not in self.variables:
            with contextlib.suppress(ua.UaError):
                node = ua.NodeId.from_string(name)
        if node not in self.variables:
            raise ValueError(f"the plant has no variable {name!r}")
        return node

    def data_value(self, node: ua.NodeId) -> ua.DataValue:
        """Return the value that the server holds for a node now."""
        return self._server.iserver.aspace[node].attributes[ua.AttributeIds.Value].value

    def value(self, name: str) -> Any:
        """Return the value of a variable by its browse name."""
        return self.data_value(self._id(name)).Value.Value

    async def put(
        self, name: str, value: Any, status: int = ua.StatusCodes.Good, **timestamps: datetime | None
    ) -> None:
        """Set a variable from inside, without a journal entry; ``timestamps`` as of :meth:`hold`.

        Raises:
            ValueError: there is no such variable, or the value does not fit its type.
        """
        node = self.node(name)
        variable = self.variables[node]
        held = variant(value, variable.kind)
        if not fits(held, variable.kind, variable.rank, list(variable.dimensions)):
            raise ValueError(f"{name}: {value!r} does not fit the variable's rank and dimensions")
        await self.hold(node, held, status, **timestamps)

    async def hold(
        self, node: ua.NodeId, value: ua.Variant, status: int = ua.StatusCodes.Good, **timestamps: datetime | None
    ) -> None:
        """Set a value without a check; ``source_timestamp`` and ``server_timestamp`` are the present time if they are not given."""
        now = datetime.now(UTC)
        data = ua.DataValue(
            value,
            ua.StatusCode(status),
            SourceTimestamp=timestamps.get("source_timestamp", now),
            ServerTimestamp=timestamps.get("server_timestamp", now),
        )
        await self._server.iserver.write_attribute_value(node, data)

    async def restore(self) -> None:
        """Restore the start-up values; no method counts as performed."""
        for node, variable in self.variables.items():
            await self.hold(node, variable.start)
        for node in self.calls:
            self.calls[node] = 0
        self._produced = 0.0

    # -- methods ------------------------------------------------------------------------------------------

    async def _start_production(self) -> list[Any]:
        if self.value("EmergencyStop"):
            raise MethodRefusal(ua.StatusCodes.BadInvalidState)
        await self.put("Mode", "RUNNING")
        return []

    async def _stop_production(self) -> list[Any]:
        # Only ResetAlarms ends an emergency stop.
        if not self.value("EmergencyStop"):
            await self.put("Mode", "STOPPED")
        return []

    async def _emergency_stop(self) -> list[Any]:
        await self.put("EmergencyStop", True)
        await self.put("Mode", "EMERGENCY_STOP")
        return []

    async def _reset_alarms(self) -> list[Any]:
        await self.put("AlarmActive", False)
        if self.value("EmergencyStop"):
            await self.put("EmergencyStop", False)
            await self.put("Mode", "STOPPED")
        return []

    async def _set_rate(self, rate: float) -> list[Any]:
        if not finite(rate) or not 0 <= rate <= MAX_RATE:
            raise MethodRefusal(ua.StatusCodes.BadInvalidArgument, [ua.StatusCodes.BadOutOfRange])
        previous = self.value("ProductionRate")
        await self.put("ProductionRate", rate)
        return [previous]

    # -- dynamics -----------------------------------------------------------------------------------------

    async def tick(self) -> None:
        """Advance by one second: heater and fan change the temperature; pump and valve change pressure, flow and level.

        Actuators are only read: what a client wrote stays.
        """
        seconds = (self._number("Uptime") + 1) % 2**32
        await self.put("Uptime", seconds)
        running = self.value("Mode") == "RUNNING"
        pumping = running and self.value("PumpEnabled")
        valve = self._share("ValvePosition")
        conveyor = self._share("ConveyorSpeed")
        wave = math.sin(seconds / 10)
        heating = 80 * self._share("HeaterPower") if running else 0.0
        target = 20.0 + heating - 10 * self._share("FanSpeed")
        temperature = self._number("Temperature")
        await self.put("Temperature", temperature + (target - temperature) * 0.05)
        await self.put("Pressure", 1.0 + (0.5 if pumping else 0.0) + 0.05 * wave)
        await self.put("FlowRate", 120 * valve if pumping else 0.0)
        level = self._number("TankLevel") + (0.4 if pumping else 0.0) - 0.4 * valve
        await self.put("TankLevel", min(100.0, max(0.0, level)))
        await self.put("Vibration", 1.0 + 0.2 * wave if running else 0.0)
        await self.put("PhLevel", 7.0 + 0.05 * wave)
        await self.put("Humidity", 45.0 + 2 * wave)
        await self.put("MotorSpeed", 1500 * conveyor if running else 0.0)
        if running:
            self._produced += self._number("ProductionRate") / 60 * conveyor
            whole = int(self._produced)
            self._produced -= whole
            await self.put("ProductionCount", (self._number("ProductionCount") + whole) % 2**32)

    def _number(self, name: str) -> Any:
        """Return the number that a variable holds, or its start value if a Bad status or a poke left no number."""
        value = self.value(name)
        usable = value is not None and math.isfinite(value)
        return value if usable else self.variables[self._id(name)].start.Value

    def _share(self, name: str) -> float:
        """Return a percentage as a number from 0 to 1."""
        return min(100.0, max(0.0, float(self._number(name)))) / 100


def _arguments(types: Mapping[str, ua.VariantType]) -> list[ua.Argument]:
    """Return what clients read in InputArguments or OutputArguments (OPC 10000-3, 8.6): scalars."""
    return [ua.Argument(Name=name, DataType=ua.NodeId(kind.value), ValueRank=-1) for name, kind in types.items()]


async def _never(parent: ua.NodeId, *arguments: ua.Variant) -> None:
    raise NotImplementedError
